"""Pages, docstrings and notebooks: their code runs as they say, tables are the code's, formulas survive Markdown."""

import csv
import dataclasses
import doctest
import importlib
import importlib.util
import inspect
import math
import os
import pkgutil
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path

import nbformat
import pytest
from helpers.commands import call, line_of_a_page, printed
from helpers.extras import needs
from nbclient import NotebookClient

import plough_opt as po
from plough_opt.core import quantities, saving, tables, units
from plough_opt.design.search import effort
from plough_opt.exchange.export.formats import FORMATS
from plough_opt.laws import LAWS
from plough_opt.motion.effects import OWN_EFFECTS
from plough_opt.motion.methods import METHODS
from plough_opt.motion.solvers import plan
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.problem_file import reading, schema, source
from plough_opt.soil.elastic import medium
from plough_opt.studies.calibration.measurements import measurable
from plough_opt.studies.sweep.points import MOST_POINTS
from plough_opt.studies.tradeoff import assembly
from plough_opt.studies.uncertainty import distribution

ROOT = Path(__file__).parents[1]
TEXTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").rglob("*.md"))}


@dataclass(frozen=True)
class Page:
    """Expected output and files of a page's code, and how to shorten its computations by default.

    Attributes:
        prints: pieces of the output.
        writes: files, each of at least 500 bytes.
        least: word in the blocks that run briefly; then make docs runs all blocks, as make slow does of other pages.
        shorter: text in Python blocks -> the text that replaces it by default.
        briefly: function from a shell line to the changes by --set, or other arguments, added by default.
        scripts: whether each Python block must run as a file in its own process, because it starts processes.
        holds: function from the variables of the Python blocks to whether they are right.
    """

    prints: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    least: str = ""
    shorter: dict[str, str] = field(default_factory=dict)
    briefly: Callable[[str], list[str]] = lambda _: []
    scripts: bool = False
    holds: Callable[[dict], bool] = lambda _: True


def few_points(line):
    """Return arguments for a small front, of a surface with a fixed mount."""
    if "oscillation" in line:
        return ["--points", "5", "--set", "scene.stiffness=100 kN/m"]
    return ["--points", "5", "--set", "scene.duration=0.1 s"]


def short_motion(line):
    """Return a shorter duration for the exports but the one whose optimum is compared."""
    return [] if "openmdao" in line else ["--set", "scene.duration=0.1 s"]


FIXED_SHARE = ["--set", "share.wedge_angle=39 deg", "--set", "share.height=0.26 m"]


def short_search(line):
    """Return parts of the guesses."""
    return [] if "--at" in line else ["--at", "guess"]


def tolerances_cost_something(names):
    best, made, found = names["best"], names["made"], names["found"]
    assert found.screened == found.combinations == 6 * 51
    return made.spread.kept > 0.95 and made.objective >= best.objective


PAGES = {
    "accuracy": Page(
        least="po.Batch", shorter={"100_000": "1_000"}, holds=lambda names: names["result"].error_estimate.max() < 1e-6
    ),
    "calibration": Page(("soil.cohesion", "Scatter about the fit"), ("out/residuals.png", "out/fit.json")),
    "component": Page(("share.height [m] 0.2 to 0.3, value 0.25",), shorter={"duration=2.0": "duration=0.2"}),
    "crosscheck": Page(("McKyes-Ali does not include soil that moves with the share",)),
    "effects": Page(holds=lambda names: names["orbit"].force_rms > 0.0),
    "explore": Page(
        writes=("out/explore.html", "out/scene.html", "out/design.html", "out/share.gif", "out/share.html"),
        briefly=lambda _line: FIXED_SHARE,
    ),
    # OpenMDAO at the global optimum of R1.
    "exports": Page(("jac_share", "True [0.82500571] [39.1146985"), ("out/r1.mjs",), briefly=short_motion),
    # The page's other block needs CMake.
    "fmu": Page(("mount force from",), least="share.fmu", holds=lambda names: names["found"]["time"][-1] == 2.0),
    "graphs": Page(shorter={"scene, 2.0": "scene, 0.2", "steps=400": "steps=40"}),
    "part": Page(
        (f"{1e4 * po.Wedge(po.deg(39.1), po.deg(15), 0.254).area:.1f} cm^2 of faces",),
        ("out/share.dxf", "out/cone.stl"),
        briefly=short_search,
        holds=lambda names: names["plate"].volume < names["block"].volume,
    ),
    "results": Page(
        ("at least 120 mm", "'lower': 0.1", "2 results side by side"),
        ("both.png",),
        holds=lambda names: names["best"].to_dataframe().attrs["units"] == {"height": "m", "stiffness": "N/m"},
    ),
    "shares": Page(("tow power",)),
    "soils": Page(("5.737", "0.992465")),
    "sweeps": Page(least="import", shorter={"kPa:9": "kPa:2", "3.0, 5": "3.0, 2"}, scripts=True),
    "tolerances": Page(holds=tolerances_cost_something),
    "trade_offs": Page(
        ("Front of", "1 % less draft costs", "half angle", "1 % more tow speed costs"),
        ("out/loosening.png", "out/loosening.csv", "out/deflection.json", "out/surface.png"),
        shorter={"points=12": "points=7, search='near'", "(10e3, 20e3)": "(20e3,)"},
        briefly=few_points,
    ),
    "uncertain_soil": Page(("radius, probability of at least 0.15 m",), least="import"),
}

# Libraries of the extra `full` in the code of pages.
FULL = ("openmdao", "fmpy")


def cases():
    """Yield each page briefly, every second one and those that start processes in make docs alone, and whole."""
    for number, name in enumerate(PAGES):
        later = number % 2 or PAGES[name].scripts
        yield pytest.param(name, False, marks=[pytest.mark.site] if later else (), id=f"{name}-briefly")
        yield pytest.param(name, True, marks=pytest.mark.site if PAGES[name].least else pytest.mark.slow, id=name)


# FMPy leaves its temporary folder to the garbage collector.
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
@pytest.mark.filterwarnings("ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("name", "whole"), [*cases()])
def test_its_code_runs(name, whole, tmp_path, monkeypatch, capsys):
    page, printed, names = PAGES[name], "", {}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv("OPENMDAO_REPORTS", "0")
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    for language, text in re.findall(r"```(sh|python)\n(.*?)```", TEXTS[name], flags=re.DOTALL):
        if not whole and page.least not in text:
            continue
        for library in FULL:
            if library in text:
                needs(library)
        for old, new in ({} if whole or language == "sh" else page.shorter).items():
            text = text.replace(old, new)
        if language == "sh":
            for line in text.splitlines():
                printed += line_of_a_page(line, *([] if whole else page.briefly(line)))
        elif page.scripts:
            (tmp_path / "script.py").write_text(text, encoding="utf-8")
            done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, check=True)
            printed += done.stdout
        else:
            exec(compile(text, f"{name}.md", "exec"), names)  # the page's own text
        printed += capsys.readouterr().out
    sys.modules.pop("share", None)  # which the page on embedding writes and imports
    assert printed
    assert [words for words in page.prints if words not in printed] == []
    assert [file for file in page.writes if (tmp_path / file).stat().st_size < 500] == []
    assert page.holds(names)


# --- theory.md: every equation has its function and its test ---

ROW = r"^\| \((\d+)\) \| (.+) \| `([\w.]+)` \| \[.+\]\(\.\./\.\./(.+)\) \| `(tests/[\w/.]+)` \|$"
EQUATIONS = re.findall(ROW, TEXTS["theory"], flags=re.MULTILINE)
LETTER = (ROOT / "tests" / "test_source_equations.py").read_text(encoding="utf-8")


def test_the_table_has_every_equation_once():
    assert [int(number) for number, *_ in EQUATIONS] == list(range(1, 28))


@pytest.mark.parametrize(("number", "what", "function", "file", "test"), EQUATIONS, ids=[row[0] for row in EQUATIONS])
def test_an_equation_has_its_function_and_its_test(number, what, function, file, test):
    assert what.strip()
    defined = reduce(getattr, function.split("."), po)
    source = (ROOT / file).read_text(encoding="utf-8")
    home = inspect.getsourcefile(inspect.unwrap(getattr(defined, "fget", defined)))
    assert home == str(ROOT / file) or f"({number})" in source
    assert re.search(rf"def test_equation_{number}(_|\()", LETTER)
    assert (ROOT / test).exists()


NAMED = r"`((?:plastic|elastic|plots|laws)\.\w+)`"


@pytest.mark.parametrize("name", sorted({name for page in TEXTS.values() for name in re.findall(NAMED, page)}))
def test_a_named_function_exists(name):
    assert reduce(getattr, name.split("."), po) is not None


# --- calibration.md ---


def test_results_that_can_be_measured_are_listed():
    (listed,) = re.findall(r"the measured result, one per file: (.*?) \|", TEXTS["calibration"])
    assert set(re.findall(r"\w+_\w+", listed)) == set(measurable())


# --- limits.md: every figure is the constant by which the code refuses ---


def most_outputs():
    """Return the schema's bound of a file's output intervals."""
    return schema.SceneTable.model_json_schema()["properties"]["outputs"]["maximum"]


LIMITS = {
    "Problem files and `--set`": (
        source._MAX_BYTES, source._MAX_LINE_LENGTH, source.MOST_TABLES, source._MAX_INTEGER_BITS, units._LONGEST,
        reading._MAX_LENGTH, source._MAX_LISTED,
        most_outputs(),
        quantities.MOST_WAVES,
    ),
    "CSV files of measurements and penetrometer readings": (
        tables._MOST_BYTES, tables._MOST_LISTED,
    ),
    "Saved results (`po.load`)": (saving._MOST_BYTES,),
    "Studies and runs": (
        MOST_POINTS, distribution.MOST_SAMPLES,
        schema.UncertainTable.model_json_schema()["properties"]["fresh"]["maximum"],
        assembly._MOST_POINTS, effort._MOST_ACCEPTED, medium._MOST_PIECES, plan.MOST_OUTPUTS,
    ),
    "Phase of a motion": (plan.MOST_RINGING, plan.MOST_FORCED, plan.MOST_PANELLED, plan.MOST_SHOT),
}  # fmt: skip


def figures(table):
    """Return the figures in a table's second column, sizes in bytes."""
    _, _, rest = TEXTS["limits"].partition(f"| {table} | at most |\n|---|---|\n")
    assert rest, f"no table {table}"
    rows = [line.split("|")[2].strip() for line in rest.partition("\n\n")[0].splitlines()]
    scales = {"": 1, " kB": 1_000, " MB": 1_000_000}
    found = [re.fullmatch(r"([\d,]+)( kB| MB|)", row) for row in rows]
    return tuple(int(one[1].replace(",", "")) * scales[one[2]] for one in found)


@pytest.mark.parametrize("table", LIMITS)
def test_figures_of_limits_are_the_codes(table):
    assert figures(table) == LIMITS[table]


def test_every_table_of_limits_is_tested():
    assert TEXTS["limits"].count("| at most |") == len(LIMITS)


# --- soils.md and effects.md: their numbers match the code ---


def test_the_table_of_cone_indices_matches_the_code():
    rows = re.findall(r"^\| ([a-z ]+) \| ([\d.]+) kPa \| ([\d.]+) kPa \|$", TEXTS["soils"], flags=re.MULTILINE)
    assert tuple(name for name, *_ in rows) == po.soil_names()
    for name, *values in rows:
        soils = [replace(po.named_soil(name), ambient_pressure=pressure) for pressure in (101325.0, 5e3)]
        assert [*map(float, values)] == pytest.approx([po.cone_index(soil) / 1e3 for soil in soils], rel=4e-4)  # digits


def test_its_problem_file_tables_are_valid(tmp_path):
    pages = TEXTS["soils"] + TEXTS["effects"]
    tables, tested, waves, random = re.findall(r"```toml\n(.*?)```", pages, flags=re.DOTALL)
    soil, uncertain = tables.split("\n\n")
    file = (ROOT / "problems" / "cotton_subsoiler.toml").read_text(encoding="utf-8")
    start = file.index("[soil]")
    rest = file[file.index("\n[", start) :].replace("[effects]", waves, 1)
    left_out = ("deflection", "strength_wave = { amplitude = 0.3")
    lines = [line for line in rest.splitlines() if not line.startswith(left_out)]
    path = tmp_path / "share.toml"
    path.write_text(file[:start] + soil + "\n" + "\n".join(lines) + "\n" + uncertain, encoding="utf-8")
    shutil.copy(ROOT / "problems" / "insertions.csv", tmp_path)
    problem = po.read_problem(path)
    readings = po.read_penetrometer(ROOT / "problems" / "insertions.csv", (0.25, 0.45))
    assert po.cone_index(problem.scene().soil) == pytest.approx(readings.mean, rel=1e-12)
    assert [wave.wavelength for wave in problem.scene().effects.waves] == [0.73, 2.1]
    path.write_text(file[:start] + tested + file[file.index("\n[", start) :], encoding="utf-8")
    # At 60 kPa, between 50 and 100 kPa, the logarithm of the lost volume is linear in that of the pressure.
    lost = 0.021 * (60.0 / 50.0) ** (math.log(0.039 / 0.021) / math.log(2.0))
    assert po.read_problem(path).scene().soil.density_ratio == pytest.approx(1.0 - lost, rel=1e-14)
    _, effects, minimise = re.split(r"\[\w+\]\n", random)
    given = effects.replace("# random", "random").splitlines()
    shutil.copy(ROOT / "problems" / "transect.csv", tmp_path)
    for line in given[:2]:
        text = file.replace('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }', line)
        path.write_text(text.replace("[minimise]\n", f"[minimise]\n{minimise}"), encoding="utf-8")
        assert po.read_problem(path).scene().stationary_force_rms > 0.0


def test_the_quoted_draft_and_band_match_the_command():
    own, low, high = map(
        float, re.findall(r"^([\d.]+) kN beside ([\d.]+) to ([\d.]+) kN", TEXTS["soils"], flags=re.MULTILINE)[0]
    )
    scene = po.read_problem(ROOT / "problems" / "field.toml").scene()
    at = po.ShareInSoil(scene.share, scene.cone, scene.soil, 5 / 3.6)
    draft = po.laws.AsabeD497("fine", depth=0.45).reaction(at).at(at.speed)
    shown = (dataclasses.replace(scene, tow_speed=5 / 3.6).steady_resistance, 0.5 * draft, 1.5 * draft)
    assert (own, low, high) == pytest.approx([value / 1e3 for value in shown], abs=0.05)


def test_the_synthetic_readings_match_their_script():
    script = runpy.run_path(str(ROOT / "problems" / "make_field_data.py"))
    for name in ("insertions", "transect"):
        text = (ROOT / "problems" / f"{name}.csv").read_text(encoding="utf-8")
        assert text == script[name]()
        assert "synthetic" in text.splitlines()[0]


# --- README.md: every code block runs ---


README = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
PYTHON = [text for language, text in README if language == "python"]
LINES = [line for language, text in README if language == "sh" for line in text.splitlines() if line]
ENVIRONMENT = Path(sys.prefix)


def shell(line: str) -> str:
    """Run a line in the present folder, one of the toolkit's commands in this process; return what it prints."""
    if line.startswith("plough-opt "):
        return line_of_a_page(line)
    environment = os.environ | {"PATH": f"{ENVIRONMENT / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(line, shell=True, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def rehearsed(line: str, brief: bool) -> str:
    """Return what stands for a line that would set up an environment, or test the tests, anew."""
    words = shlex.split(line)
    if line == "make run" and not brief:
        # The environment that runs this test is ready: -o keeps make from building another.
        return f"make run VENV={ENVIRONMENT} -o {ENVIRONMENT}/.plough_opt-installed -o {ENVIRONMENT}/.core-installed"
    if words[0] == "make":
        return f"make --dry-run {words[1]}"
    if words[0].endswith("python3") and words[1:3] == ["-m", "venv"]:
        return f"{sys.executable} -m venv --without-pip .venv"
    if words[0] == ".venv/bin/pip":
        rest = line.removeprefix(".venv/bin/pip install")
        return f"{sys.executable} -m pip install --dry-run --no-deps --no-build-isolation {rest}"
    return line.replace(".venv/bin/", "")


@pytest.mark.parametrize("block", PYTHON, ids=range(len(PYTHON)))
def test_python_block_runs(block, capsys):
    exec(compile(block, "README.md", "exec"), {})  # the README's own text
    assert capsys.readouterr().out


@pytest.mark.parametrize("brief", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_shell_lines_run_in_order_and_print_the_figures(tmp_path, monkeypatch, brief):
    assert {language for language, _ in README} == {"python", "sh"}  # blocks of other languages would not run
    work = tmp_path / "clone"
    shutil.copytree(ROOT, work, ignore=shutil.ignore_patterns(".git", ".venv", ".*_cache", "out", "__pycache__"))
    monkeypatch.chdir(work)
    printed = {line: shell(rehearsed(line, brief)) for line in LINES}
    # What `make run` does beside the same optimum is to draw it, as a line further down does.
    assert "--plot out/cotton_subsoiler.png" in printed["make run"] or (work / "out" / "cotton_subsoiler.png").exists()
    assert (work / "my_share.png").stat().st_size > 10_000
    assert '"schema": 3' in (work / "my_share.json").read_text(encoding="utf-8")
    for figure in ("39.11 deg", "0.2541 m", "50.77 kN/m", "3.941 kN", "0.6531 kN", "0.0103 m", "73 %"):
        assert figure in printed[".venv/bin/plough-opt optimise problems/cotton_subsoiler.toml"]


# --- CONTRIBUTING.md: its five additions are taken from the page, added from outside the package, and used ---


TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
INTRODUCTION, *PARTS = re.split(r"^### ", TEXT, flags=re.MULTILINE)
SECTIONS = {part.partition("\n")[0]: BLOCKS.findall(part) for part in PARTS}
REGISTRIES = (OWN_EFFECTS, LAWS, MEASURES, FORMATS, METHODS)


def module_of(section):
    """Return the name and the text of the one file that a section adds."""
    (text,) = (text for language, text in SECTIONS[section] if language == "python" and text.startswith("# "))
    return re.match(r"# (\w+)\.py\n", text)[1], text


@pytest.fixture
def workshop(tmp_path, monkeypatch):
    """Return a function that puts a section's modules and files where a user would, and removes what they add."""
    before, known = [dict(registry) for registry in REGISTRIES], {*sys.modules}
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    kinds = dict(BLOCKS.findall(INTRODUCTION[INTRODUCTION.index("The examples below") :]))

    def install(section):
        name, text = module_of(section)
        # An installed package, as its entry points are found.
        Path("mine-1.0.dist-info").mkdir()
        for file, content in {
            "tine.toml": kinds["toml"],
            "scene_of_mine.py": kinds["python"],
            f"{name}.py": text,
            "mine-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n",
            "mine-1.0.dist-info/entry_points.txt": f"[plough_opt]\n{name} = {name}\n",
        }.items():
            Path(file).write_text(content, encoding="utf-8")
        return name

    yield install
    for registry, own in zip(REGISTRIES, before, strict=True):
        registry.clear()
        registry.update(own)
    for name in {*sys.modules} - known:
        if str(tmp_path) in (getattr(sys.modules[name], "__file__", None) or ""):
            del sys.modules[name]


def use(section, capsys):
    """Run a section's other blocks in order, but for the line that takes long; return what each of them printed."""
    said = []
    for language, text in SECTIONS[section]:
        if language == "sh":
            lines = [line for line in text.splitlines() if "accuracy tine" not in line]
            said.append("".join(map(line_of_a_page, lines)))
        elif not text.startswith("# "):
            exec(compile(text, f"CONTRIBUTING.md, {section}", "exec"), {})  # the page's own text
            said.append(capsys.readouterr().out)
    return said


def refused(line, told):
    """Check that a command refuses its arguments with some words."""
    done = call(*shlex.split(line))
    assert done.status == 2
    assert told in done.said


def test_effect(workshop, capsys):
    workshop("An effect")
    first, second = use("An effect", capsys)[0].splitlines()
    slides, sticks = map(float, first.split())
    bare = po.Scene(po.named_soil("serozem"), po.Wedge(po.deg(30), po.deg(35), 0.25), 2e5, 40.0, 2.0)
    assert slides == pytest.approx(bare.steady_resistance + 150.0 + 160.0, rel=1e-12)
    # From rest and over a short time.
    assert sticks > bare.steady_resistance / 2
    assert "viscous" in second
    shank = "[{effect='shank', static='150 N', viscous='80 N*s/m'}]"
    own = po.read_problem("tine.toml", [f"effects.own={shank}"])
    # 80 N s/m at 2 m/s.
    rise = own.simulate().mean_draft - po.read_problem("tine.toml").simulate().mean_draft
    assert rise == pytest.approx(150.0 + 160.0, rel=1e-9)
    for wrong, told in (
        ("[{static='150 N'}]", "must be a table such as { effect = "),
        ("[{effect='shank', static='150 m', viscous='1 N*s/m'}]", "'static' = \"150 m\" has the wrong unit"),
        ("[{effect='shank', statik='150 N'}]", "'statik' is not a quantity of Shank: did you mean 'static'"),
    ):
        refused(f'check tine.toml --set effects.own="{wrong}"', told)


def test_resistance_law(workshop, capsys):
    workshop("A resistance law")
    script, command = use("A resistance law", capsys)
    assert "a fit per width and depth: fitted from 1 to 3 m/s" in script
    assert "does not include soil that moves with the share" in script
    assert "law of resistance" in command or "share.height" in command
    own = po.read_problem("tine.toml", ["scene.medium={law='per_width', width='12 cm'}"])
    # 250 kPa on 12 cm by 25 cm, and a twentieth of that per (m/s)^2.
    assert own.simulate().mean_draft == pytest.approx(250e3 * 0.12 * 0.25 * 1.2, rel=1e-9)
    refused("check tine.toml --set scene.medium='per_with'", "did you mean 'per_width'")


def test_measure(workshop, capsys):
    workshop("A measure")
    objective, *_ = use("A measure", capsys)[0].split()
    assert called("work_per_metre at_most") == "towing work per metre, at most"
    # At a steady speed the work per metre is the draft.
    own = po.read_problem("tine.toml").optimise()[0].objective
    assert float(objective) == pytest.approx(own, rel=1e-7)
    lines = Path("swept.csv").read_text(encoding="utf-8").splitlines()
    rows = [*csv.DictReader(line for line in lines if not line.startswith("#"))]
    assert len(rows) == 3
    for row in rows:
        found = {heading.partition(" ")[0]: value for heading, value in row.items()}
        assert float(found["work_per_metre"]) == pytest.approx(float(found["mean_draft"]), rel=1e-9)
    assert "towing work per metre" in printed("simulate", "tine.toml")
    told = po.Measurements("work_per_metre", [3e3, 4e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=100.0)
    assert told.result == "work_per_metre"
    wrong = "check tine.toml --set 'require.work_per_meter.at_most=5 kN'"
    refused(wrong, "did you mean 'work_per_metre'")


def test_export_format(workshop, capsys):
    workshop("An export format")
    use("An export format", capsys)
    rows = csv.DictReader(Path("tine.csv").read_text(encoding="utf-8").splitlines())
    values = {row["name"]: float(row["value"]) for row in rows}
    assert values["share.height"] == 0.25
    assert values["mean_draft"] == pytest.approx(po.read_problem("tine.toml").simulate().mean_draft, rel=1e-6)
    refused("export tine.toml --to table --output a.txt", "end in .csv")
    refused("export tine.toml --to table --output a.csv --strut speed", "--strut cannot be used with --to table")


def test_integrator(workshop, capsys):
    workshop("An integrator")
    script, _ = use("An integrator", capsys)
    draft, error = map(float, script.splitlines()[0].split())
    assert 0.0 < error < 1e-6
    assert draft > 0.0
    design = po.Design()
    height = design.variable("height", guess=0.25, lower=0.2, upper=0.3)
    shaken = po.Effects(strength_wave=po.StrengthWave(0.3, 0.2), damping=400.0)
    scene = po.Scene(po.named_soil("serozem"), po.Wedge(po.deg(30), po.deg(35), height), 2e5, 40.0, 2.0, shaken)
    design.minimise(po.simulate(scene, 0.5, accuracy=po.Accuracy("three_eighths", steps=2000)).mean_draft / 1e3)
    assert design.solve(search="near").variables["height"] == pytest.approx(0.2, rel=1e-6)
    refused("simulate tine.toml --set accuracy.method=three_eights", "did you mean 'three_eighths'")


# --- examples in docstrings: every public name has one, and all give the results shown ---


def examples():
    """Return every docstring of the package that has an example, by its full name."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    names = [name for _, name, _ in pkgutil.walk_packages(po.__path__, "plough_opt.")]
    left_out = "__main__" if importlib.util.find_spec("openmdao") else ("__main__", "export.openmdao")
    modules = [name for name in names if not name.endswith(left_out)]
    found = [one for name in modules for one in finder.find(importlib.import_module(name)) if one.examples]
    return {one.name: one for one in found}


EXAMPLES = examples()


# Methods of public classes that saving, notebooks, designs and OpenMDAO call, and users do not.
HOOKS = {
    "also_saved", "check_saved", "shown_page", "picture", "check_bounds", "setup", "compute", "compute_partials",
}  # fmt: skip


def within(name, thing):
    """Yield name and value of a public name and of the toolkit's functions, classes and methods that it holds."""
    yield name, thing
    held = thing.__all__ if inspect.ismodule(thing) else dir(thing) if inspect.isclass(thing) else ()
    for key in held:
        inner = getattr(thing, key) if inspect.ismodule(thing) else inspect.getattr_static(thing, key)
        inner = getattr(inner, "__func__", inner)
        kind = inspect.isroutine(inner) or inspect.isclass(inner)
        ours = str(getattr(inspect.unwrap(inner), "__module__", "")).startswith("plough_opt") if kind else False
        if ours and not key.startswith("_") and key not in HOOKS:
            yield from within(f"{name}.{key}", inner)


@pytest.mark.parametrize("name", po.__all__)
def test_each_public_name_has_an_example(name):
    """Properties without arguments are read as the attributes of a class are."""
    if name == "export":
        needs("openmdao.api")
    thing = getattr(po, name)
    assert inspect.getdoc(thing)
    every = [*within(name, thing)][inspect.ismodule(thing) :]
    assert [key for key, one in every if ">>> " not in inspect.getdoc(one)] == []


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run_as_shown(name, monkeypatch):
    monkeypatch.chdir(ROOT)  # where its problem files are
    one = EXAMPLES[name]
    # Run as a user's program, because some warnings appear only for values that a user passes.
    one.globs = {**one.globs, "__name__": "__main__"}
    said = []
    results = doctest.DocTestRunner().run(one, out=said.append)
    assert results.failed == 0, "".join(said)


# --- the notebooks run from top to bottom ---


NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
QUICKEST = next(path for path in NOTEBOOKS if path.stem == "02_from_paper_to_code")


def code_of(path):
    """Return the code cells of a notebook."""
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


# ipykernel and its event loop warn about themselves at start-up and shut-down; the notebook's own warnings
# stay in the kernel, where its first cell turns them into errors.
@pytest.mark.site
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_prints_what_it_is_stored_with(path):
    notebook = nbformat.read(path, as_version=4)
    stored = [printed_by(cell) for cell in notebook.cells]
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(path.parent)}}).execute()
    assert any(cell.get("outputs") for cell in notebook.cells if cell.cell_type == "code")
    for (words, numbers), cell in zip(stored, notebook.cells, strict=True):
        now, values = printed_by(cell)
        assert now == words
        assert values == pytest.approx(numbers, rel=1e-2, abs=1e-9)  # other machines round otherwise


NUMBER = re.compile(r"[-+]?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?")
# Of text with times, on which its rows, marks and sentences depend too, only that it is printed is compared.
TIMES = re.compile(r"[0-9] (?:s|ms|µs)\b|\btimes?\b")


def printed_by(cell):
    """Return the words that a cell prints, and its numbers; both sorted, and neither if it prints times."""
    outputs = cell.get("outputs", [])
    text = "".join(one.get("text", "") or one.get("data", {}).get("text/plain", "") + "\n" for one in outputs)
    text = re.sub("<Figure size.*>", "<Figure>", text)
    # Searches end after a processor time, and rounding decides which of two equal designs counts.
    text = re.sub("[0-9]+ designs", "designs", text)
    if TIMES.search(text):
        return ["times"], []
    return sorted(NUMBER.sub("", text).split()), sorted(map(float, NUMBER.findall(text)))


def test_the_quickest_notebook_runs_without_a_kernel(monkeypatch, capsys):
    """It calls what the others call; a kernel would take three times as long to start as its cells to run."""
    monkeypatch.chdir(QUICKEST.parent)
    monkeypatch.setattr(sys, "path", [*sys.path])
    names = {}
    for cell in code_of(QUICKEST):
        source = "\n".join(line for line in cell.source.splitlines() if not line.startswith("%matplotlib"))
        exec(compile(source, QUICKEST.name, "exec"), names)  # the notebook's own text
    assert capsys.readouterr().out


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_with_its_outputs_and_in_order(path):
    cells = code_of(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)
