"""Layout of the project: imports go downwards, files are short, links are valid, signatures read well."""

import csv
import importlib.metadata
import inspect
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from helpers.extras import needs

import plough_opt as po

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


BUDGET = tomllib.loads((ROOT / "tests" / "budget.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("folder", ["plough_opt", "tests"])
def test_rooms_keep_to_the_budget_of_lines(folder):
    # To raise a number, lower another one in the same commit.
    counted = runpy.run_path(str(ROOT / ".ci" / "lines.py"))
    lines = counted["rooms"](ROOT / folder)
    assert {room: count for room, count in lines.items() if count > BUDGET[folder].get(room, 0)} == {}
    assert {room for room in BUDGET[folder] if room not in lines} == set()
    pieces = counted["pieces"](ROOT / folder)
    assert {name: pieces[name] for name, most in BUDGET["pieces"][folder].items() if pieces[name] > most} == {}


def test_the_list_of_thinned_tests_names_tests():
    tests = Path(__file__).parent
    thinned = tomllib.loads((tests / "thinned.toml").read_text(encoding="utf-8"))
    for key in [*thinned["long"], *thinned["one_of"]]:
        file, _, name = key.partition("::")
        assert (f"def {name}(" if name else "def test") in (tests / f"{file}.py").read_text(encoding="utf-8"), key


# Pattern of calls that change process-wide settings -> the files that may contain it, for the toolkit's own processes.
SWITCHES = {
    r"catch_warnings|simplefilter|filterwarnings|chdir\(|setrecursionlimit|set_printoptions": set(),
    r"redirect_std": {"core/process.py"},
    r"seterr\(|random\.seed|rcParams|rc_context|setlocale|umask|set_int_max|putenv|environ\[[^]]*\] *=": set(),
    r"dup2\(": {"app/main.py"},
    r"sys\.std\w+ *=(?!=)": set(),
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


# What a user's program runs, and the libraries that it leaves alone.
HEAVY = {
    "listed = dir(po); assert {*po.__all__} <= {*listed}; assert len({*listed}) == len(listed)":
        {"casadi", "matplotlib", "numpy", "pint", "pydantic", "rich", "scipy"},
    """share = po.Wedge(angle=0.6, chisel_angle=0.2, height=0.25)
print(po.simulate(po.Scene(po.named_soil("serozem"), share, stiffness=5e4, mass=30.0, tow_speed=2.0), duration=0.5))""":
        {"matplotlib", "pint", "pydantic", "rich", "scipy"},
    """from pathlib import Path
for name in ("cotton_subsoiler", "field"):
    po.read_problem(Path("problems", f"{name}.toml")).scene()""": {"pint"},
}  # fmt: skip


@pytest.mark.parametrize("code", HEAVY, ids=["import", "run", "problems"])
def test_heavy_libraries_are_loaded_where_they_are_needed(code):
    line = [sys.executable, "-c", f"import sys, plough_opt as po\n{code}\nprint(*sys.modules)"]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True)
    assert not HEAVY[code] & {*done.stdout.splitlines()[-1].split()}


def test_the_version_and_its_date_are_everywhere_those_of_the_project():
    version = PROJECT["version"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    (released,) = re.findall(rf"^## \[{re.escape(version)}\] - ([0-9-]+)$", changes, re.MULTILINE)
    cited = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE))
    assert (cited["version"], cited["date-released"]) == (version, released)
    assert re.findall(r"^## \[([^]]+)", changes, re.MULTILINE)[0] in (version, "Unreleased")


LICENCES = [*csv.DictReader((ROOT / ".ci" / "recipe" / "licences.csv").read_text(encoding="utf-8").splitlines())]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FAMILIES = ("MIT", "BSD", "Apache", "MPL", "LGPL", "PSF")
# Libraries whose metadata do not contain a machine-readable licence.
SILENT = {"fmpy": "BSD", "matplotlib": "PSF", "casadi": "LGPL"}


def test_the_licence_of_every_library_is_listed():
    libraries = [row for row in LICENCES if not row["part of"]]
    extras = {k: v for k, v in PROJECT["optional-dependencies"].items() if k not in ("test", "full", "bench", "docs")}
    needed = [(extra, line) for extra, lines in {"": PROJECT["dependencies"], **extras}.items() for line in lines]
    named = sorted((extra, re.match(r"[\w-]+", line)[0]) for extra, line in needed)
    assert sorted((row["extra"], row["library"]) for row in libraries) == named
    for name, licence in {row["library"]: row["licence"] for row in libraries}.items():
        try:
            about = importlib.metadata.metadata(name)
        except importlib.metadata.PackageNotFoundError:
            continue  # an extra that is not installed here
        fields = ("License-Expression", "License", "Classifier")
        said = SILENT.get(name) or " ".join(text for field in fields for text in about.get_all(field, []))
        assert any(family in said and family in licence for family in FAMILIES), (name, said[:200])
    bundled = {row["library"]: row["licence"] for row in LICENCES if row["part of"] == "plough_opt"}
    texts = (ROOT / "plough_opt" / "app" / "assets" / "LICENSES.txt").read_text(encoding="utf-8")
    assert all(name in texts for name in bundled)
    assert set(PROJECT["license"].split(" AND ")) == {"MIT", *bundled.values()}


def test_the_recipe_needs_what_the_project_needs():
    recipe = (ROOT / ".ci" / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.findall(r"^    - ([\w-]+) >=([\d.]+)$", recipe.partition("  run:")[2].partition("tests:")[0], re.MULTILINE)
    names = {"matplotlib-base": "matplotlib", "lazy-loader": "lazy_loader"}  # conda-forge's
    assert [f"{names.get(name, name)}>={version}" for name, version in run] == PROJECT["dependencies"]
    assert f'python_min: "{PROJECT["requires-python"].removeprefix(">=")}"' in recipe
    assert f'version: "{PROJECT["version"]}"' in recipe
    assert f"license: {PROJECT['license']}" in recipe


@pytest.mark.parametrize("name", [name for name in po.__all__ if inspect.ismodule(getattr(po, name))])
def test_a_public_module_lists_its_public_names(name):
    if name == "export":
        needs("openmdao.api")
    module = getattr(po, name)
    of_its_own = {key for key, x in vars(module).items() if getattr(x, "__module__", "") == module.__name__}
    assert {key for key in of_its_own if not key.startswith("_")} <= {*module.__all__}
    assert all(hasattr(module, key) for key in module.__all__)
