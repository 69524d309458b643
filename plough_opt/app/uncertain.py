"""The command `optimise` for a file with an uncertain soil: the robust optimum beside the nominal one."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from plough_opt.app.report import shown
from plough_opt.app.terminal import console, progress, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import quantities
from plough_opt.core.units import Display
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import Problem

if TYPE_CHECKING:
    from plough_opt.studies.uncertainty.picture import Panel
    from plough_opt.studies.uncertainty.result import RobustOptimum
    from plough_opt.studies.uncertainty.verification import Check

# Results that hardly vary make no picture.
_MOST_PANELS = 4
# Parts of a variance that are none.
_NONE = 5e-4
# Margins below this are the optimiser's last rounding.
_ROUNDING = 1e-9


def optimise_uncertain(problem: Problem, options: argparse.Namespace) -> None:
    """Solve the robust design, verify it, and report it beside the nominal one."""
    if options.sensitivity:
        raise InputError(
            "--sensitivity is of an optimum for one soil: leave it out, for what the results owe to the uncertain"
            " properties is reported anyway, or leave out the table [uncertain]"
        )
    from plough_opt.problem_file.robust_design import optimise_robust  # scipy.stats is slow to import

    with progress() as told:
        found = optimise_robust(problem, told)
    if options.json:
        from plough_opt.studies.uncertainty.result import SavedRobust

        print(SavedRobust.of(found, problem.title).to_json())
    else:
        _print(console(), problem, found)
    if options.plot:
        from plough_opt.app import plots
        from plough_opt.studies.uncertainty.picture import plot_spread

        values = {"nominal design": found.nominal_fresh.values, "robust design": found.fresh.values}
        wrote(plots.save(plot_spread(values, _panels(problem, found)), options.plot))


def _print(to: Console, problem: Problem, found: RobustOptimum) -> None:
    to.print(f"[bold]{escape(problem.title)}[/]")
    to.print(_soil_table(problem, found))
    to.print(_design_table(problem, found))
    if any(limit.kind == "requirement" for limit in found.best.limits):
        to.print(_limits_table(problem, found))
    if len(found.best.local_optima) > 1:
        to.print(_optima_table(problem, found))
    checks = [replace(check, text=_measure(problem, check)) for check in found.fresh.checks]
    to.print(_checks_table(problem, checks, found))
    for check in checks:
        if check.worse is not None:
            to.print(f"* {escape(check.result)}, {check.text}: of the fresh samples {check.note}.", soft_wrap=True)
        if check.width:
            width, rounding = _value(problem, check, check.width, True), _value(problem, check, check.rounding)
            text = f"rounded off over {width}, which changes it by {rounding}"
            to.print(f"* {escape(check.result)}, {check.text}: {text}.", soft_wrap=True)
    if found.indices:
        to.print("Sobol indices of the robust design: part of each result's variance, alone / with others")
        to.print(_indices_table(found))
    if note := next((own.note for own in found.indices.values() if own.note), ""):
        to.print(f"In that table {note}.", soft_wrap=True)
    from plough_opt.studies.uncertainty.verification import in_words

    to.print(f"[bold]In the robust design {escape(in_words(checks))}.[/]", soft_wrap=True)
    for text in dict.fromkeys((*found.best.warnings, *found.failures)):
        to.print(f"[yellow]Note:[/] {escape(text)}.", soft_wrap=True)
    if found.fresh.failures:
        to.print(f"[yellow]Note:[/] {len(found.fresh.failures)} fresh soils have no result and are left out.")
    to.print(
        f"{len(found.robust.samples)} samples in one program; robust objective re-integrated tightly: gap"
        f" {found.best.gap:.0e}; {found.best.seconds:.1f} s, nominal {found.nominal.seconds:.1f} s, verified in"
        f" {found.fresh.seconds:.1f} s"
    )


def _soil_table(problem: Problem, found: RobustOptimum) -> Table:
    field = found.robust.field
    table = Table(title=f"Uncertain soil: {escape(field.soil.name)}")
    for heading in ("property", "nominal", "mean", "standard deviation", "correlated with"):
        table.add_column(heading, justify="left" if heading in ("property", "correlated with") else "right")
    for name, (mean, spread) in field.moments.items():
        key, unit = f"soil.{name}", quantities()[f"soil.{name}"].symbol
        numbers = [shown(problem, key, x, unit) for x in (float(getattr(field.soil, name)), mean, spread)]
        pairs = [(pair, value) for pair, value in field.correlation.items() if name in pair]
        others = ", ".join(f"{pair[0] if pair[1] == name else pair[1]} {value:+.2g}" for pair, value in pairs)
        table.add_row(key, *numbers, others)
    return table


def _design_table(problem: Problem, found: RobustOptimum) -> Table:
    table = Table(title=f"Design: robust objective {found.best.objective:.9g} ({found.best.status})")
    for heading in ("variable", "robust", "nominal", "bounds", ""):
        table.add_column(heading, justify="left" if heading == "variable" else "right")
    active = {limit.name for limit in found.best.limits if limit.kind == "bound" and limit.active}
    for key, v in problem.variables.items():
        values = [v.display.text(optimum.variables[key], 6) for optimum in (found.best, found.nominal)]
        bounds = f"{v.display.text(v.lower)} to {v.display.text(v.upper)}"
        table.add_row(key, *values, bounds, "[yellow]at its bound[/]" if key in active else "")
    return table


def _limits_table(problem: Problem, found: RobustOptimum) -> Table:
    table = Table(title="Requirements of the robust design")
    for heading in ("requirement", "limits", "in", "value", "margin", ""):
        table.add_column(heading, justify="left" if heading in ("requirement", "in") else "right")
    varying = {check.result for check in found.fresh.checks}
    for limit in found.best.limits:
        own = problem.table.require.get(limit.name)
        if limit.kind != "requirement" or own is None:
            continue
        limits = ", ".join(f"{side.replace('_', ' ')} {written}" for side, written in own.sides.items())
        how = f"{100 * own.probability:g} % of the soils" if own.probability is not None else own.measure
        if limit.name not in varying:
            how = "the nominal soil" if own.measure == "nominal" else "every soil alike"
        margin = 0.0 if abs(limit.margin) < _ROUNDING else limit.margin
        numbers = [shown(problem, limit.name, x, limit.unit) for x in (limit.value, margin)]
        table.add_row(limit.name, limits, how or "every sample", *numbers, "[yellow]decides[/]" if limit.active else "")
    return table


def _optima_table(problem: Problem, found: RobustOptimum) -> Table:
    table = Table(title="All robust optima found")
    table.add_column("")
    for heading in ("objective", *problem.variables):
        table.add_column(heading, justify="right")
    for optimum in found.best.local_optima:
        cells = [v.display.text(optimum.variables[key], 6) for key, v in problem.variables.items()]
        table.add_row(optimum.name, f"{optimum.objective:.9g}", *cells)
    return table


def _measure(problem: Problem, check: Check) -> str:
    """Return a measure in words, a limit in it as the file writes it."""
    own = problem.table.require.get(check.result)
    if own is None or not check.text.startswith("probability"):
        return check.text
    sides = [f"{side.replace('_', ' ')} {written}" for side, written in own.sides.items()]
    return f"probability of {' and '.join(sides)}"


def _checks_table(problem: Problem, checks: Sequence[Check], found: RobustOptimum) -> Table:
    table = Table(title=f"What {found.fresh.samples} fresh samples say, of the robust design and of the nominal one")
    for heading in ("result", "measure", "the optimiser saw", "fresh samples", "95 % interval", "nominal design", ""):
        left, whole = heading in ("result", "measure"), heading == "result"
        table.add_column(heading, justify="left" if left else "right", overflow="fold", no_wrap=whole)
    for check, nominal in zip(checks, found.nominal_fresh.checks, strict=True):
        ends = [None if end is None else _value(problem, check, end) for end in (check.low, check.high)]
        interval = "" if None in ends else f"{ends[0]} to {ends[1]}"
        numbers = [_value(problem, check, x) for x in (check.seen, check.fresh)]
        verdict = "[green]confirmed[/]" if check.confirmed else f"[yellow]{check.verdict}[/]"
        table.add_row(check.result, check.text, *numbers, interval, _value(problem, nominal, nominal.fresh), verdict)
    return table


def _value(problem: Problem, check: Check, value: float, of_result: bool = False) -> str:
    """Return a measure's value, or with ``of_result`` one in the result's own unit, as the file shows it."""
    if check.text.startswith("probability") and not of_result:
        return f"{100.0 * value:.2f} %"
    return shown(problem, check.result, value, MEASURES[check.result].unit.symbol)


def _indices_table(found: RobustOptimum) -> Table:
    names = next(iter(found.indices.values())).names
    table = Table()
    table.add_column("result")
    for name in names:
        table.add_column(name, justify="right", overflow="fold")
    for own in found.indices.values():
        parts = [f"{_percent(a)} / {_percent(b)}" for a, b in zip(own.first, own.total, strict=True)]
        table.add_row(own.result, *parts)
    return table


def _percent(part: float) -> str:
    return "0 %" if abs(part) < _NONE else f"{100.0 * part:.1f} %"


def _panels(problem: Problem, found: RobustOptimum) -> list[Panel]:
    """Return the panels of the picture: what varies, with the limits that the file sets."""
    from plough_opt.studies.uncertainty.picture import Panel  # as above

    panels = []
    for name in dict.fromkeys(check.result for check in found.fresh.checks):
        unit, own = MEASURES[name].unit, problem.table.require.get(name)
        display = problem.displays.get(name, Display(unit.symbol, 1.0))
        sides = {side: unit.parse(written) for side, written in own.sides.items()} if own is not None else {}
        label = f"{name.replace('_', ' ')} [{display.symbol}]"
        panels.append(Panel(name, label, display.factor, sides.get("at_least"), sides.get("at_most")))
    return panels[:_MOST_PANELS]
