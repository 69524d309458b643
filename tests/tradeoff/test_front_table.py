"""A front on the screen: whole numbers, units in the headings, failures in words."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

import plough_opt as po
from plough_opt.app.terminal import print_page
from plough_opt.studies.tradeoff.front import Failure


@pytest.fixture(scope="module")
def surface():
    """A surface of three objectives and four variables, with names and values as long as those of a problem file."""
    d = po.Design()
    names = {"share.wedge_angle": 1.0, "share.height": 0.1, "scene.stiffness": 1e5, "scene.tow_speed": 1.0}
    x = [d.variable(name, guess=0.7 * size, lower=0.0, upper=1.5 * size, unit="") for name, size in names.items()]
    x = [own / size for own, size in zip(x, names.values(), strict=True)]
    d.require("outside", sum(own**2 for own in x[:3]), at_least=1.0)
    goals = ("mean_draft", "N", 4321.09876), ("force_rms", "N", 12.3456789), ("loosened_radius", "m", 0.0123456)
    spread = [size * (own + 0.1 * (x[3] - 0.5) ** 2 + 0.1) for own, (*_, size) in zip(x, goals, strict=False)]
    return po.trade_off(d, *(po.Goal(n, f, u) for (n, u, _), f in zip(goals, spread, strict=True)), points=10)


def printed(front, width=120):
    """Return the lines of a front."""
    out = io.StringIO()
    print_page(Console(file=out, width=width), front.page())
    return out.getvalue().splitlines()


@pytest.mark.slow
def test_a_surface_fits_into_120_characters_with_every_number_whole(surface):
    lines = printed(surface)
    table = [line for line in lines if line.startswith("│")]
    assert len(table) == len(surface.points)
    assert all(len(line) <= 120 for line in table)
    first = [cell.strip() for cell in table[0].split("│")[1:-1]]
    point = surface.points[0]
    shown = [point.objectives[0] / 1e3, point.objectives[1] / 1e3, 1e3 * point.objectives[2]]
    shown += [point.variables[axis.name] / (1e3 if axis.unit == "N/m" else 1.0) for axis in surface.variables]
    assert first[: len(shown)] == [f"{value:.5g}" for value in shown]
    headings = "".join(line for line in lines if line.startswith("┃"))
    for word in ("[kN]", "loosened", "stiffness", "(c)", "[%]"):
        assert word in headings


def test_on_a_narrow_terminal_no_digit_is_lost(surface):
    lines = [line for line in printed(surface, 60) if line.startswith("│")]
    assert "…" not in "".join(lines)
    columns = [
        "".join(cell.strip() for cell in column) for column in zip(*(line.split("│") for line in lines), strict=True)
    ]
    order = [k for part in surface.parts for k in part]
    assert columns[1] == "".join(f"{surface.points[k].objectives[0] / 1e3:.5g}" for k in order)


def test_failures_are_told_in_words_and_each_reason_once(surface):
    at = [point.objectives for point in surface.points[:3]]
    reasons = ("Infeasible_Problem_Detected: no design near the start meets the requirements",) * 2
    failures = tuple(map(Failure, at, (*reasons, "Odd_Status: the optimiser stopped without an optimum")))
    told = [line for line in printed(replace(surface, failures=failures), 1000) if "No certified design" in line]
    assert len(told) == 2
    assert told[0].endswith(": no design near the start meets the requirements.")
    assert told[0].count(" kN and ") + told[0].count(" m;") >= 2
    assert "_Problem_Detected" not in "".join(told)
    assert "Odd_Status" not in "".join(told)


def test_the_knee_is_told_in_the_units_of_the_table(surface, monkeypatch):
    point = surface.points[len(surface.points) // 2]
    monkeypatch.setattr(po.TradeOff, "knee", property(lambda _: point))
    (line,) = [line for line in printed(surface, 1000) if line.startswith("Knee")]
    assert f"at {point.objectives[0] / 1e3:.5g} kN, " in line
    assert line.count(" N") == 0
    assert len(line.split(";")) == 3
