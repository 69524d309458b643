"""The layout: imports go one way, files stay short, links lead somewhere."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "plough_opt").rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_imports_go_one_way_only():
    lint = Path(sys.prefix) / "bin" / "lint-imports"
    done = subprocess.run([lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_about_one_idea(source):
    assert len(source.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_and_named_tests_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (page.parent / target).exists(), target
    for named in re.findall(r"`(tests/[\w/]+(?:\.py)?/?)`", text):
        assert (ROOT / named).exists(), named


def test_importing_the_package_leaves_heavy_libraries_alone():
    heavy = ("matplotlib", "pint", "pydantic", "scipy", "rich")
    code = f"import sys, plough_opt; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_names_imported_later_are_listed_without_importing_them():
    code = (
        "import sys, plough_opt as po; listed = dir(po);"
        "print(sorted(set(po.__all__) - set(listed)), len(listed) == len(set(listed)), 'pydantic' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] True False"
