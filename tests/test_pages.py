"""docs/*.md: code runs and gives what the page says, tables are the code's, formulas survive GitHub's Markdown."""

import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

import pytest
from helpers.commands import line_of_a_page

import plough_opt as po
from plough_opt.core import quantities, saving, tables, units
from plough_opt.core.quantities import EVERY
from plough_opt.design.search import effort
from plough_opt.motion import plan
from plough_opt.motion.effects import MOST_HARMONICS
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import measures, reading, schema, source, uncertain
from plough_opt.soil.elastic import medium
from plough_opt.studies.calibration.measurements import measurable
from plough_opt.studies.sweep import points
from plough_opt.studies.tradeoff import assembly
from plough_opt.studies.uncertainty import distribution

ROOT = Path(__file__).parents[1]
TEXTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}


@dataclass(frozen=True)
class Page:
    """Expected output and files of a page's code, and how to shorten its computations by default.

    Attributes:
        prints: pieces of the output.
        writes: files, each of at least 500 bytes.
        least: word in the blocks that run by default; the slow tests run all blocks.
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
    """Return arguments for a small front, of a surface with a fixed mount on a linearised orbit."""
    if "oscillation" in line:
        return ["--points", "5", "--set", "effects.orbit=linearised", "--set", "scene.stiffness=100 kN/m"]
    return ["--points", "5", "--set", "scene.duration=0.1 s"]


def short_motion(line):
    """Return a shorter duration for the exports; the page gives figures of the OpenMDAO component."""
    return [] if "openmdao" in line else ["--set", "scene.duration=0.1 s"]


def short_search(line):
    """Return a report of two variables fewer, and parts of the guesses."""
    fixed = ["--no-accuracy", "--set", "share.wedge_angle=39 deg", "--set", "share.height=0.26 m"]
    return fixed if "report" in line else [] if "--at" in line else ["--at", "guess"]


def tolerances_cost_something(names):
    best, worst, found = (names[name] for name in ("best", "worst", "found"))
    assert found.screened == found.combinations == 6 * 51
    return worst.spread.kept == 1.0 and worst.objective >= best.objective and found.cost_percent > 0.0


PAGES = {
    "calibration": Page(("soil.cohesion", "What to measure next"), ("out/residuals.png", "out/fit.json")),
    "crosscheck": Page(("McKyes-Ali does not include soil that moves with the share",), ("out/drafts.png",)),
    "embedding": Page(
        # OpenMDAO at the global optimum of R1, and CasADi's Jacobian.
        ("share.height [m] 0.2 to 0.3, value 0.25", "True [0.82500571] [39.1146985", "jac_share"),
        shorter={"scene, 2.0": "scene, 0.2", "steps=400": "steps=40", "duration=2.0": "duration=0.2"},
        briefly=short_motion,
    ),
    # The page's other block needs CMake.
    "fmu": Page(("mount force from",), least="share.fmu", holds=lambda names: names["found"]["time"][-1] == 2.0),
    "report": Page(
        (f"{1e4 * po.Wedge(po.deg(39.1), po.deg(15), 0.254).area:.1f} cm^2 of faces",),
        ("out/report.html", "out/share.dxf", "out/cone.stl", "out/share.gif", "out/share.html"),
        briefly=short_search,
        holds=lambda names: names["plate"].volume < names["block"].volume,
    ),
    "results": Page(
        ("at least 120 mm", "'lower': 0.1", "2 results side by side"),
        ("both.png",),
        holds=lambda names: names["best"].to_dataframe().attrs["units"] == {"height": "m", "stiffness": "N/m"},
    ),
    "soils": Page(("5.737", "0.992465")),
    "sweeps": Page(least="def response", shorter={"samples=64": "samples=4, workers=1"}, scripts=True),
    "tolerances": Page(holds=tolerances_cost_something),
    "trade_offs": Page(
        ("Front of", "1 % less draft costs", "half angle", "1 % more tow speed costs"),
        ("out/loosening.png", "out/loosening.csv", "out/deflection.json", "out/surface.png"),
        shorter={"points=12": "points=7"},
        briefly=few_points,
    ),
    "uncertain_soil": Page(("radius, probability of at least 0.15", "variance of draft"), least="import"),
}


# FMPy leaves its temporary folder to the garbage collector.
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
@pytest.mark.filterwarnings("ignore:Exception ignored in:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("whole", [pytest.param(False, id="briefly"), pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", PAGES)
def test_its_code_runs(name, whole, tmp_path, monkeypatch, capsys):
    page, printed, names = PAGES[name], "", {}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv("OPENMDAO_REPORTS", "0")
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    for language, text in re.findall(r"```(sh|python)\n(.*?)```", TEXTS[name], flags=re.DOTALL):
        if not whole and page.least not in text:
            continue
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


@pytest.mark.parametrize("name", TEXTS)
def test_formulas_survive_markdown(name):
    """A display formula is a fenced block; in a line a backslash before punctuation needs the backquoted form."""
    prose = re.sub(r"```.*?```", "", TEXTS[name], flags=re.DOTALL)
    assert "$$" not in prose
    for formula in re.findall(r"\$([^$\n]+)\$", re.sub(r"\$`[^`\n]+`\$", "", prose)):
        assert not re.search(r"\\[^A-Za-z]|\*", formula), formula
        assert formula.count("{") == formula.count("}"), formula
    for formula in re.findall(r"```math\n(.*?)```", TEXTS[name], flags=re.DOTALL):
        assert formula.count(r"\left") == formula.count(r"\right")
        assert formula.count("{") == formula.count("}")


# --- theory.md: every equation has its function and its test ---

ROW = r"^\| \((\d+)\) \| (.+) \| `([\w.]+)` \| \[.+\]\(\.\./(.+)\) \| `(tests/[\w/.]+)` \|$"
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


NAMED = r"`((?:plastic|elastic|plots|crosscheck)\.\w+)`"


@pytest.mark.parametrize("name", sorted({name for page in TEXTS.values() for name in re.findall(NAMED, page)}))
def test_a_named_function_exists(name):
    assert reduce(getattr, name.split("."), po) is not None


def test_links_within_the_page_lead_to_headings():
    headings = {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")
                for heading in re.findall(r"^#+ (.+)$", TEXTS["theory"], flags=re.MULTILINE)}  # fmt: skip
    assert set(re.findall(r"\]\(#([\w-]+)\)", TEXTS["theory"])) <= headings


# --- calibration.md ---


def test_results_that_can_be_measured_are_listed():
    (listed,) = re.findall(r"the measured result, one per file: (.*?) \|", TEXTS["calibration"])
    assert set(re.findall(r"\w+_\w+", listed)) == set(measurable())


# --- embedding.md ---


def test_the_tables_of_embedding_hold_every_name_and_no_other():
    rows = re.findall(r"^\| ([^|]*`[^|]*) \| ([^|]*) \|$", TEXTS["embedding"], flags=re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`([\w.]+)`", names)} - {"steel_density"}
    # Further strength waves are named in a sentence.
    assert named == {name for name in (*EVERY, *MEASURES) if not re.search(r"wave_\d", name)}
    units = {unit.strip() for _, column in rows for unit in column.split(";")}
    known = {one.unit for one in EVERY.values()} | {one.unit.symbol for one in MEASURES.values()}
    assert {unit or "1" for unit in known} == units


# --- limits.md: every figure is the constant by which the code refuses ---


def most_outputs():
    """Return the schema's bound of a file's output intervals."""
    field = schema.SceneTable.model_json_schema()["properties"]["outputs"]
    return field["maximum"]


LIMITS = {
    "Problem files and `--set`": (
        source._MAX_BYTES, source._MAX_LINE_LENGTH, source.MOST_TABLES, source._MAX_INTEGER_BITS, units._LONGEST,
        reading._MAX_LENGTH, source._MAX_LISTED,
        most_outputs(),
        quantities.MOST_WAVES,
        measures._MAX_LENGTH, measures._MAX_DEPTH, measures._MAX_POWER,
    ),
    "CSV files of measurements and penetrometer readings": (
        tables._MOST_BYTES, tables._LONGEST_LINE, tables._MOST_LISTED,
    ),
    "Saved results (`po.load`)": (saving._MOST_BYTES,),
    "Studies and runs": (
        points.MOST_VALUES, points.MOST_SAMPLES, distribution._MOST_SAMPLES, uncertain._COUNTS["fresh"][1],
        assembly._MOST_POINTS, effort._MOST_ACCEPTED, MOST_HARMONICS, medium._MOST_PIECES, plan.MOST_OUTPUTS,
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
