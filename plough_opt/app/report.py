"""Tables on the screen, each value in the unit that the problem file uses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from plough_opt.core.quantities import quantities
from plough_opt.core.units import Display
from plough_opt.design import Limit, LocalOptimum, Optimum
from plough_opt.laws.penetration import cone_index
from plough_opt.motion import Run
from plough_opt.motion.effect_costs import EffectCost
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import Problem
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.studies.accuracy.result import AccuracyStudy
    from plough_opt.studies.crosscheck import Comparison

_DEGREES = Display("deg", math.pi / 180.0)
_RANDOM = (
    ("stationary RMS of the mount force", "stationary_force_rms"),
    ("stationary RMS of the deflection", "stationary_displacement_rms"),
)
_KILO = {"N": Display("kN", 1e3), "W": Display("kW", 1e3), "Pa": Display("kPa", 1e3), "N/m": Display("kN/m", 1e3)}


def shown(problem: Problem, key: str, value: float, unit: str) -> str:
    """Return an SI value in the unit that the file gives the key in, or in a customary one."""
    display = problem.displays.get(key)
    if display is None:
        display = _DEGREES if unit == "rad" else _KILO.get(unit, Display(unit, 1.0))
    return display.text(value)


def print_soils(console: Console, soils: Sequence[Soil]) -> None:
    """Print the named soils, then where their values come from."""
    table = Table(title="Named soils (engineering choices inside published brackets; none measured as a set)")
    for heading in ("name", "density", "locked density", "ratio b1", "cohesion", "friction angle", "tool friction",
                    "cone index"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "name" else "right")
    for soil in soils:
        table.add_row(
            soil.name,
            f"{soil.density:.0f} kg/m^3",
            f"{soil.density / soil.density_ratio:.0f} kg/m^3",
            f"{soil.density_ratio:.3f}",
            f"{soil.cohesion / 1e3:.0f} kPa",
            f"{math.degrees(soil.friction_angle):.0f} deg",
            f"{soil.tool_friction:.2f}",
            f"{cone_index(soil) / 1e3:.0f} kPa",
        )
    console.print(table)
    for soil in soils:
        console.print(f"[bold]{soil.name}[/]: {soil.source}")
    console.print("Ambient pressure of all: 101.325 kPa. Soil with open pores: set soil.ambient_pressure.")


def print_run(console: Console, problem: Problem, run: Run) -> None:
    """Print a run of numbers."""
    console.print(f"[bold]{escape(problem.title)}[/]")
    console.print(_scene_table(problem, run.scene))
    console.print(_run_table(problem, run))
    _print_footer(console, (*run.warnings,), f"relative error about {run.error_estimate:.0e}, {run.seconds:.2f} s")


def print_optimum(console: Console, problem: Problem, best: Optimum, run: Run) -> None:
    """Print the best design, its response, what decided it and the other local optima."""
    console.print(f"[bold]{escape(problem.title)}[/]")
    console.print(_variables_table(problem, best))
    console.print(_run_table(problem, run))
    if any(limit.kind == "requirement" for limit in best.limits):
        console.print(_limits_table(problem, best))
    if best.over:
        console.print(f"Within the tolerances: {best.over}.")
    if len(best.local_optima) > 1:
        console.print(_optima_table(problem, best))
    for direction in best.flat_directions:
        moves = ", ".join(_move(problem, name, change) for name, change in direction.items() if change)
        console.print(f"[yellow]The optimum is not unique:[/] nothing changes along {moves}: fix one of these.")
    if best.spread is not None:
        console.print(_spread_text(best))
    if best.search is not None:
        console.print(str(best.search))
    trust = (
        f"objective re-integrated tightly: gap {best.gap:.0e}, error estimate {best.error_estimate:.0e};"
        f" {best.seconds:.2f} s"
    )
    _print_footer(console, (*best.warnings, *run.warnings), trust)


def print_check(console: Console, problem: Problem) -> None:
    """Print what a file's scene contains and how it would be integrated."""
    scene = problem.scene()
    console.print(f"[bold]{escape(problem.title)}[/]: {escape(problem.name)} is right.")
    console.print(_scene_table(problem, scene))
    table = Table(title="What is simulated", show_header=False)
    table.add_column()
    table.add_column()
    if scene.effects.motion:
        equation = equation_of_motion(Structure.of(scene))
        table.add_row("equation of motion", f"2 states, {equation.function.n_nodes()} nodes")
        table.add_row("its parameters", ", ".join(equation.names))
        frequency = float(scene.natural_frequency) / (2.0 * math.pi)
        if scene.effects.printed.repelling_spring:
            table.add_row("growth under the print's repelling spring", f"exp({float(scene.natural_frequency):.4g}/s t)")
        else:
            table.add_row("natural frequency", f"{frequency:.4g} Hz")
    else:
        table.add_row("quasi-static", "no equation of motion")
    for wave in scene.effects.waves:
        table.add_row("frequency of the strength wave", f"{float(scene.tow_speed / wave.wavelength):.4g} Hz")
    if scene.effects.random_strength is not None:
        table.add_row("random strength", f"{100.0 * float(scene.effects.random_strength.variance) ** 0.5:.3g} % RMS")
        for label, name in _RANDOM:
            table.add_row(label, shown(problem, name, float(getattr(scene, name)), MEASURES[name].unit.symbol))
    console.print(table)
    if problem.variables:
        verb = "optimise" if problem.table.minimise or problem.table.trade_off is None else "tradeoff"
        console.print(f"{len(problem.variables)} variables, {len(problem.table.require)} requirements: "
                      f"plough-opt {verb} {escape(problem.name)}")  # fmt: skip
    if problem.table.uncertain is not None:
        names = ", ".join(key for key in problem.table.uncertain if key.startswith("soil."))
        console.print(f"Uncertain: {escape(names)}: optimise designs for them, all else takes the nominal soil.",
                      soft_wrap=True)  # fmt: skip
    _print_footer(console, scene.warnings(), "")


def print_effects(console: Console, costs: Sequence[EffectCost]) -> None:
    """Print what each effect adds to the differential equation and to the operations of a run."""
    table = Table(title="What each effect adds to this scene")
    for heading in ("effect", "", "nodes", "states", "events", "operations, with it over without"):
        table.add_column(heading, justify="left" if heading == "effect" else "right")
    for cost in costs:
        if cost.refused:
            table.add_row(cost.name, "on" if cost.on else "off", "", "", "", "not here, see below")
            continue
        sizes = (f"{size:+d}" for size in (cost.nodes, cost.states, cost.events))
        ratio = "a search" if cost.operations is None else f"{cost.operations:.3g}"
        table.add_row(cost.name, "on" if cost.on else "off", *sizes, ratio)
    console.print(table)
    for cost in costs:
        if cost.refused:
            console.print(f"{cost.name}: {escape(cost.refused)}.", soft_wrap=True)


def print_comparison(console: Console, comparison: Comparison) -> None:
    """Print what other draft models give, what was estimated for them, why they differ and what is not verified."""
    console.print(comparison.table())
    for title, sentences in (
        ("Outside the domain", comparison.refusals),
        ("Assumed", comparison.estimates),
        ("Why they differ", comparison.reasons),
        ("What is not verified, and sources", comparison.standings),
    ):
        if sentences:
            console.print(f"[bold]{title}[/]")
        for sentence in sentences:
            console.print(f"* {escape(sentence)}", soft_wrap=True)


def print_accuracy(console: Console, study: AccuracyStudy) -> None:
    """Print a study: a table for each question, what had no result and why, and the advice."""
    if study.title:
        console.print(f"[bold]{escape(study.title)}[/]")
    for question in study.questions:
        console.print(study.table(question))
        console.print()
    timed = "one local solve; ≠ ended in another optimum"
    if study.duration is not None:
        timed = "a named method integrates once, auto is all of simulate, which checks itself"
    console.print(f"Times are medians after a warm-up: {timed}. Set-up is done once.", soft_wrap=True)
    if study.thoroughness:
        console.print(_thoroughness_table(study))
        console.print("Found is the best design that any of these searches came to.")
    for refusal in study.refusals:
        console.print(escape(refusal), soft_wrap=True)
    for note in study.notes:
        console.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)
    for question in study.questions:
        console.print(f"[bold]{escape(study.advise(question))}[/]", soft_wrap=True)
    console.print(", ".join(f"{name} {value}" for name, value in study.versions.items()), soft_wrap=True)


def _thoroughness_table(study: AccuracyStudy) -> Table:
    table = Table(title="What thoroughness costs")
    table.add_column("search")
    for heading in ("designs tried", "found the best", "time"):
        table.add_column(heading, justify="right")
    for row in study.thoroughness:
        table.add_row(row.search, str(row.designs), f"{row.right} of {row.asked}", f"{row.seconds:.2f} s")
    return table


def _scene_table(problem: Problem, scene: Scene) -> Table:
    table = Table(title="Scene, variables at their guesses" if problem.variables else "Scene", show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_row("soil", escape(scene.soil.name))
    if scene.medium == "plastic":
        table.add_row("cone index", escape(problem.readings) or f"{float(cone_index(scene.soil)) / 1e3:.4g} kPa")
    for key, value in problem.values().items():
        if not key.startswith("soil."):
            table.add_row(key, shown(problem, key, float(value), quantities()[key].symbol))
    table.add_row("half angle of the equivalent cone", _DEGREES.text(float(scene.cone.half_angle)))
    table.add_row("moving mass with the share", f"{float(scene.mass):.5g} kg")
    if scene.medium == "plastic":
        table.add_row("added mass of soil", f"{float(scene.reaction.added_mass):.4g} kg")
        table.add_row("ambient pressure's part of the static draft", f"{100.0 * float(scene.ambient_share):.0f} %")
    else:
        table.add_row("medium", "linear elastic")
    return table


def _run_table(problem: Problem, run: Run) -> Table:
    table = Table(title="Response", show_header=False)
    table.add_column()
    table.add_column(justify="right")
    chosen = (
        ("mean draft", "mean_draft"),
        ("RMS of the mount force", "force_rms"),
        ("mean deflection", "mean_deflection"),
        ("RMS of the deflection", "displacement_rms"),
        ("tow power", "tow_power"),
        ("draft per loosened section", "specific_draft"),
        ("loosened radius", "loosened_radius"),
    )
    for label, name in (*chosen, *(_RANDOM if run.scene.effects.random_strength is not None else ())):
        if run.scene.medium == "plastic" or not MEASURES[name].plastic:
            table.add_row(label, shown(problem, name, float(MEASURES[name].of(run)), MEASURES[name].unit.symbol))
    table.add_row("peak mount force", shown(problem, "mount_force", run.peak_force, "N"))
    table.add_row("peak deflection", shown(problem, "deflection", run.peak_deflection, "m"))
    if run.scene.effects.orbit == "periodic":
        table.add_row("largest Floquet multiplier", f"{max(map(abs, run.floquet)):.4g}")
        comes = {True: "comes to this orbit", False: "comes to another motion", None: "has not settled"}
        table.add_row("a share from equilibrium", comes[run.settles.orbit])
    return table


def _variables_table(problem: Problem, best: Optimum) -> Table:
    table = Table(title=f"Best design: objective {best.objective:.9g} ({best.status})")
    for heading in ("variable", "best", "bounds", ""):
        table.add_column(heading, justify="left" if heading == "variable" else "right")
    for limit in best.limits:
        if limit.kind == "bound":
            v = problem.variables[limit.name]
            bounds = f"{v.display.text(v.lower)} to {v.display.text(v.upper)}"
            value = v.display.text(limit.value, 7)
            table.add_row(limit.name, value, bounds, "[yellow]at its bound[/]" if limit.active else "")
    return table


def _limits_table(problem: Problem, best: Optimum) -> Table:
    table = Table(title="Requirements")
    for heading in ("requirement", "limits", "value", "margin", ""):
        table.add_column(heading, justify="left" if heading == "requirement" else "right")
    for limit in best.limits:
        if limit.kind != "requirement":
            continue
        value, margin = (shown(problem, limit.name, x, limit.unit) for x in (limit.value, _rounded(limit.margin)))
        table.add_row(
            limit.name, _limits_text(problem, limit), value, margin, "[yellow]decides[/]" if limit.active else ""
        )
    return table


def _limits_text(problem: Problem, limit: Limit) -> str:
    """Return limits as the file writes them; what a theory in it requires is not in the file."""
    own = problem.table.require.get(limit.name)
    if own is None:
        return "of the theory"
    sides = (("at least", own.at_least), ("at most", own.at_most))
    return ", ".join(f"{word} {written}" for word, written in sides if written is not None)


def _optima_table(problem: Problem, best: Optimum) -> Table:
    table = Table(title="Local optima found")
    table.add_column("")
    table.add_column("objective", justify="right")
    judged = all(optimum.spread is not None for optimum in best.local_optima)
    if judged:
        table.add_column("as made", justify="right")
    for key in problem.variables:
        table.add_column(key, justify="right")
    for optimum in best.local_optima:
        made = [f"{optimum.spread.median:.6g}"] if judged and optimum.spread is not None else []
        table.add_row(optimum.name, f"{optimum.objective:.9g}", *made, *_cells(problem, optimum))
    return table


def _spread_text(best: Optimum) -> str:
    """Return what becomes of the best design within its tolerances."""
    spread = best.spread
    assert spread is not None  # the caller has looked
    kept = f"; {100.0 * spread.kept:.0f} % of the designs keep all requirements" if spread.margins else ""
    return (
        f"As it is made, within the tolerances: objective {spread.median:.6g} in the middle of the cases,"
        f" {spread.worst:.6g} at worst{kept}."
    )


def _cells(problem: Problem, optimum: LocalOptimum) -> list[str]:
    return [v.display.text(optimum.variables[key], 7) for key, v in problem.variables.items()]


def _move(problem: Problem, name: str, change: float) -> str:
    display = problem.variables[name].display
    return f"{name} {'+' if change > 0 else '-'}{display.text(abs(change), 3)}"


def _rounded(margin: float) -> float:
    """Return a margin without the optimiser's last rounding, which reads as a violation of 1e-13."""
    return 0.0 if abs(margin) < 1e-9 else margin


def _print_footer(console: Console, warnings: Sequence[str], trust: str) -> None:
    for warning in dict.fromkeys(warnings):
        console.print(f"[yellow]Note:[/] {warning}.")
    if trust:
        console.print(trust)
