"""A front on the screen: its designs by parts, what a little more costs, what decides where, and what has no result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from plough_opt.cli.report import shown
from plough_opt.problem_file import Problem

if TYPE_CHECKING:
    from plough_opt.tradeoff import TradeOff


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
        for of, by in _pairs(front):
            console.print(f"Knee (bold): {escape(front.in_words(number, of, by))}.", soft_wrap=True)
    if everywhere:
        console.print(f"Limits that decide every design: {', '.join(everywhere)}.", soft_wrap=True)
    for note in front.notes:
        console.print(f"[yellow]Note:[/] {escape(note)}.", soft_wrap=True)
    for failure in front.failures:
        place = _place(problem, front, failure.objectives)
        console.print(f"[yellow]No certified design[/] near {place}: {escape(failure.reason)}.", soft_wrap=True)
    gap, residual = (max(getattr(point, name) for point in front.points) for name in ("gap", "residual"))
    console.print(
        f"{len(front.dominated)} further local optima are dominated; first-order conditions met to {residual:.0e},"
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
    heads = ["1 % costs"] if len(pairs) == 1 else [f"1 % costs ({letter})" for letter in "abc"]
    lines = [f"{head}: {text}" for head, text in zip(heads, what, strict=True)]
    limits = list(dict.fromkeys(name for point in front.points for name in point.active if name not in everywhere))
    if limits:
        lines.append("limits: " + ", ".join(f"{k} {name}" for k, name in enumerate(limits, start=1)))
    table = Table(title=f"Front of {len(front.points)} designs", caption="\n".join(lines))
    branches = any(point.branch for point in front.points)
    for heading in (*(axis.name for axis in (*front.goals, *front.variables)), *heads):
        table.add_column(heading, justify="right", overflow="fold")
    if branches:
        table.add_column("branch")
    if limits:
        table.add_column("limits")
    for part in front.parts:
        for k in part:
            point = front.points[k]
            costs = [front.cost(k, of, by) for of, by in pairs]
            values = _cells(problem, front, point.objectives)
            values += [shown(problem, v.name, point.variables[v.name], v.unit) for v in front.variables]
            values += ["" if cost is None else f"{cost:.3g} %" for cost in costs]
            values += [point.branch] if branches else []
            decided = " ".join(str(number) for number, name in enumerate(limits, start=1) if name in point.active)
            values += [decided] if limits else []
            table.add_row(*values, style="bold" if point is front.knee else None, end_section=k == part[-1])
    return table


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
