"""A front on the screen: its designs by parts, what a little more costs, what decides where, and what has no result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from plough_opt.app.report import shown
from plough_opt.problem_file import Problem

if TYPE_CHECKING:
    from plough_opt.studies.tradeoff import TradeOff


def print_front(console: Console, problem: Problem, front: TradeOff) -> None:
    """Print a front: its points by parts, its holes, what a little more costs, and what has no result."""
    console.print(f"[bold]{escape(front.title)}[/]")
    everywhere = [name for name in front.points[0].active if all(name in point.active for point in front.points)]
    console.print(_table(problem, front, everywhere))
    for hole in front.holes:
        start, end = (_place(problem, front, place) for place in (hole.start, hole.end))
        doubt = "" if hole.settled else "; the optimiser failed within, so that some may be missing"
        console.print(f"Hole: no efficient design between {start}, and {end}{doubt}.", soft_wrap=True)
    if front.knee is not None:
        number = front.points.index(front.knee)
        costs = "; ".join(front.in_words(number, of, by).partition(": ")[2] for of, by in _pairs(front))
        place = _place(problem, front, front.knee.objectives)
        console.print(f"Knee (bold), at {place}: {escape(costs)}.", soft_wrap=True)
    if everywhere:
        console.print(f"Limits that decide every design: {', '.join(everywhere)}.", soft_wrap=True)
    if front.search:
        console.print(escape(front.search), soft_wrap=True)
    for note in front.notes:
        console.print(f"[yellow]Note:[/] {escape(note)}.", soft_wrap=True)
    for reason, places in _failures(problem, front).items():
        console.print(f"[yellow]No certified design[/] near {'; '.join(places)}: {escape(reason)}.", soft_wrap=True)
    gap, residual = (max(getattr(point, name) for point in front.points) for name in ("gap", "residual"))
    console.print(
        f"{len(front.dominated)} further local optima are dominated, {len(front.needles)} are needles; first-order"
        f" conditions met to {residual:.0e},"
        f" re-integrated tightly: gap {gap:.0e}; {front.seconds:.1f} s, {front.building:.1f} s of them for building"
    )


def _table(problem: Problem, front: TradeOff, everywhere: Sequence[str]) -> Table:
    """Return the table of a front, its knee bold.

    Args:
        problem: where units come from.
        front: the front.
        everywhere: limits that decide every design, which no row repeats.
    """
    pairs = _pairs(front)
    what = [f"of {front.goals[of].name} for 1 % {_more(front, by)}" for of, by in pairs]
    heads = ["1 % costs"] if len(pairs) == 1 else [f"cost ({letter})" for letter in "abc"]
    lines = [f"{head}: {text}" for head, text in zip(heads, what, strict=True)]
    limits = list(dict.fromkeys(name for point in front.points for name in point.active if name not in everywhere))
    if limits:
        lines.append("limits: " + ", ".join(f"{k} {name}" for k, name in enumerate(limits, start=1)))
    table = Table(title=f"Front of {len(front.points)} designs", caption="\n".join(lines))
    branches = any(point.branch for point in front.points)
    rows = {k: _numbers(problem, front, k) for part in front.parts for k in part}
    costs = {k: ["" if (cost := front.cost(k, *pair)) is None else f"{cost:.3g}" for pair in pairs] for k in rows}
    units = [text.partition(" ")[2] for text in next(iter(rows.values()))]
    names = [axis.name for axis in (*front.goals, *front.variables)]
    numbers = {k: [*(text.partition(" ")[0] for text in rows[k]), *costs[k]] for k in rows}
    # What a surface has is just as wide as 120 characters with headings of one word in a line.
    between = " " if len(pairs) == 1 else "\n"
    for name, unit in zip((*names, *heads), (*units, *("%" for _ in pairs)), strict=True):
        table.add_column(_heading(name, unit, between), justify="right", overflow="fold")
    if branches:
        table.add_column("branch", overflow="fold")
    if limits:
        table.add_column("limits")
    for part in front.parts:
        for k in part:
            point = front.points[k]
            values = numbers[k] + ([point.branch] if branches else [])
            decided = " ".join(str(number) for number, name in enumerate(limits, start=1) if name in point.active)
            values += [decided] if limits else []
            table.add_row(*values, style="bold" if point is front.knee else None, end_section=k == part[-1])
    return table


def _numbers(problem: Problem, front: TradeOff, number: int) -> list[str]:
    """Return objectives and variables of a point with their units, which are the same at every point."""
    point = front.points[number]
    variables = [shown(problem, v.name, point.variables[v.name], v.unit) for v in front.variables]
    return [*_cells(problem, front, point.objectives), *variables]


def _heading(name: str, unit: str, between: str) -> Text:
    """Return a heading in words, with what stands between them."""
    words = name.rpartition(".")[2].replace("_", " ")
    return Text((f"{words} [{unit}]" if unit else words).replace(" ", between))


def _failures(problem: Problem, front: TradeOff) -> dict[str, list[str]]:
    """Return why the optimiser failed, in words, and near which places."""
    found: dict[str, list[str]] = {}
    for failure in front.failures:
        # Before the colon is IPOPT's own word.
        reason = failure.reason.partition(": ")[2] or failure.reason
        found.setdefault(reason, []).append(_place(problem, front, failure.objectives))
    return found


def _pairs(front: TradeOff) -> list[tuple[int, int]]:
    """Return pairs of objectives: the one that gives way, and the one that gains."""
    count = len(front.goals)
    return [(of, by) for by in range(count) for of in range(by + 1, count)]


def _more(front: TradeOff, number: int) -> str:
    goal = front.goals[number]
    return f"{'more' if goal.maximise else 'less'} {goal.name}"


def _place(problem: Problem, front: TradeOff, values: Sequence[float]) -> str:
    *first, last = _cells(problem, front, values)
    return f"{', '.join(first)} and {last}"


def _cells(problem: Problem, front: TradeOff, values: Sequence[float]) -> list[str]:
    return [shown(problem, goal.name, x, goal.unit) for goal, x in zip(front.goals, values, strict=True)]
