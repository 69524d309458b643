"""Layout of the project: imports go downwards, files are short, links are valid."""

import ast
import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "plough_opt").rglob("*.py"))
PAGES = [*ROOT.glob("[RCA]*.md"), *sorted((ROOT / "docs").rglob("*.md"))]


def test_imports_go_one_way_only():
    lint = Path(sys.prefix) / "bin" / "lint-imports"
    done = subprocess.run([lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_files_are_about_one_story():
    for path in SOURCES:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len([line for line in lines if not line.lstrip().startswith((">>> ", "... "))]) <= 700, path


def test_constants_of_designs_have_names_of_their_own():
    named = re.compile(r"^(_?[A-Z][A-Z0-9_]*)(?:: Final)? = [-0-9(.]", re.MULTILINE)
    designs = (ROOT / "plough_opt" / "design").rglob("*.py")
    names = [name for path in designs for name in named.findall(path.read_text(encoding="utf-8"))]
    assert len(names) > 50
    assert sorted(names) == sorted({*names})


def test_the_list_of_thinned_tests_names_tests():
    tests = Path(__file__).parent
    (listed,) = re.findall(r"^ONE_OF = ({.*?^})", (tests / "conftest.py").read_text(), re.DOTALL | re.MULTILINE)
    (long,) = re.findall(r'^LONG = """(.*?)"""', (tests / "conftest.py").read_text(), re.DOTALL | re.MULTILINE)
    for key in [*ast.literal_eval(listed), *long.split()]:
        file, _, name = key.partition("::")
        assert (f"def {name}(" if name else "def test") in (tests / f"{file}.py").read_text(encoding="utf-8"), key


# Pattern of calls that change process-wide settings -> the files that may contain it, for the toolkit's own processes.
SWITCHES = {
    r"catch_warnings|simplefilter|filterwarnings|chdir\(|redirect_std|setrecursionlimit|set_printoptions": set(),
    r"seterr\(|random\.seed|rcParams|rc_context|setlocale|umask|set_int_max|putenv|environ\[[^]]*\] *=": set(),
    r"dup2\(": {"app/main.py", "studies/sweep/pool.py"},
    r"sys\.std\w+ *=(?!=)": {"core/process.py", "studies/sweep/pool.py"},
}


@pytest.mark.parametrize("switch", SWITCHES)
def test_process_wide_settings_are_not_changed(switch):
    found = {one.relative_to(ROOT / "plough_opt").as_posix() for one in SOURCES if re.search(switch, one.read_text())}
    assert found == SWITCHES[switch]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_and_named_tests_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (page.parent / target).exists(), target
    for named in re.findall(r"`(\w+/[\w/]+\.py|tests/[\w/]*)`", text):
        assert any((ROOT / room / named).exists() for room in (".", "plough_opt")), named


def test_names_are_listed_and_heavy_libraries_left_alone_by_an_import():
    heavy = ("casadi", "matplotlib", "numpy", "pint", "pydantic", "rich", "scipy")
    code = (
        "import sys, plough_opt as po; listed = dir(po); print(sorted({*po.__all__} - {*listed}),"
        f"len(listed) - len({{*listed}}), [name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "0", "[]"]


TESTS = sorted((ROOT / "tests").rglob("*.py"))


def test_folders_of_tests_run_alone_and_together():
    packages = [path.parent for path in TESTS if path.name == "__init__.py"]
    modules = [path for path in TESTS if path.name != "conftest.py" and not set(path.parents) & set(packages)]
    helpers = [*packages, *modules]
    # pytest puts folders of tests on the module path, where of two modules with one name only one could be imported.
    assert len({path.stem for path in helpers}) == len(helpers)
    places = {path.stem: path.parent for path in helpers}
    for source in TESTS:
        found = set(re.findall(r"^ *(?:from|import) (\w+)", source.read_text(encoding="utf-8"), flags=re.MULTILINE))
        assert "conftest" not in found, source
        for name in found & places.keys():
            assert places[name] in source.parents, (source, name)


LICENCES = {
    name: row.split("|")[2]
    for row in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Licences")[2].splitlines()
    if row.startswith("| ")
    for name in row.split("|")[1].strip().split(", ")
}
FAMILIES = ("MIT", "BSD", "Apache", "MPL", "LGPL", "PSF")
# Libraries whose metadata do not contain a machine-readable licence.
SILENT = {"fmpy": "BSD", "matplotlib": "PSF"}


def test_the_licence_of_every_library_is_listed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {k: v for k, v in project["optional-dependencies"].items() if k not in ("test", "bench")}
    needed = {re.match(r"[\w-]+", line)[0] for line in sum(extras.values(), project["dependencies"])}
    assert needed <= set(LICENCES)
    for name in needed - {"build123d"}:  # which tests do without
        about = importlib.metadata.metadata(name)
        fields = ("License-Expression", "License", "Classifier")
        said = SILENT.get(name) or " ".join(text for field in fields for text in about.get_all(field, []))
        assert any(family in said and family in LICENCES[name] for family in FAMILIES), (name, said[:200])
