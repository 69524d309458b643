"""docs/*.md: code runs in the order of the page and gives what the page says, formulas survive GitHub's Markdown."""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from plough_opt.app import main

ROOT = Path(__file__).parents[1]
TEXTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}


@dataclass(frozen=True)
class Page:
    """What the code of a page prints and writes.

    Attributes:
        prints: pieces of the output.
        writes: file -> least size [B].
        least: a word of the blocks that run by default; all of them run with the slow tests.
        briefly: a line of the shell -> arguments that are added by default.
        scripts: Python blocks are files of their own, as those that begin processes must be.
        holds: whether the variables of the Python blocks are as they should be.
    """

    prints: tuple[str, ...] = ()
    writes: dict[str, int] = field(default_factory=dict)
    least: str = ""
    briefly: Callable[[str], list[str]] = lambda _: []
    scripts: bool = False
    holds: Callable[[dict], bool] = lambda _: True


def few_points(line):
    key = "effects.orbit=linearised" if "oscillation" in line else "scene.duration=0.1 s"
    return ["--points", "5", "--set", key]


def tolerances_cost_something(names):
    best, worst, found = (names[name] for name in ("best", "worst", "found"))
    assert found.screened == found.combinations == 6 * 51
    return worst.spread.kept == 1.0 and worst.objective >= best.objective and found.cost_percent > 0.0


PAGES = {
    "calibration": Page(
        ("soil.cohesion", "What to measure next"), {"out/residuals.png": 10_000, "out/fit.json": 1_000}
    ),
    "crosscheck": Page(("McKyes-Ali says nothing of soil that moves with the share",), {"out/drafts.png": 10_000}),
    "embedding": Page(
        # OpenMDAO at the global optimum of R1, and CasADi's Jacobian.
        ("share.height [m] 0.2 to 0.3, value 0.25", "True [0.82500571] [39.1146985", "jac_share")
    ),
    "soils": Page(("5.737", "0.992465")),
    "sweeps": Page(least="def response", scripts=True),
    "tolerances": Page(holds=tolerances_cost_something),
    "trade_offs": Page(
        ("Front of", "1 % less draft costs", "half angle", "1 % more tow speed costs"),
        {
            "out/loosening.png": 10_000,
            "out/loosening.csv": 500,
            "out/deflection.json": 1_000,
            "out/surface.png": 10_000,
        },
        briefly=few_points,
    ),
    "uncertain_soil": Page(("radius, probability of at least 0.15", "variance of draft"), least="import"),
}


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
        if language == "sh":
            for line in text.splitlines():
                program, *arguments = shlex.split(line)
                assert program == "plough-opt"
                assert main([*arguments, *([] if whole else page.briefly(line))]) == 0, line
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
    assert [file for file, size in page.writes.items() if (tmp_path / file).stat().st_size < size] == []
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
