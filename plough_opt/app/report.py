"""Tables on the screen, each value in the unit that the problem file uses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from plough_opt.app.terminal import LOG
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.quantities import quantities
from plough_opt.core.tables import Grid, Page
from plough_opt.core.units import customary
from plough_opt.design import Optimum, Progress, Sensitivity
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.motion.effect_costs import EffectCost
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.machine import Machine
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.problem_file import Problem
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.studies.crosscheck import Comparison

# Smaller elasticities are the rounding of none.
_NONE = 1e-9


def shown(problem: Problem, key: str, value: float, unit: str) -> str:
    """Return an SI value in the unit that the file gives the key in, or in a customary one."""
    return problem.origin.display(key, unit, value).text(value)


def print_soils(console: Console, soils: Sequence[Soil]) -> None:
    """Print the named soils, then where their values come from."""
    table = Grid.of(
        "Named soils (engineering choices inside published brackets; none measured as a set)",
        "name", "density", "locked density", "ratio b1", "cohesion", "friction angle", "tool friction", "cone index",
    )  # fmt: skip
    for soil in soils:
        table.row(
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


def run_page(problem: Problem, run: Run | Machine) -> Page:
    """Return a numeric run, or those of several shares, with each scene."""
    page, runs = run.page(), runs_of(run)
    scenes = [_scene_table(part, runs[name].scene, name) for name, part in problem.parts.items()]
    return replace(page, parts=(*scenes, *page.parts, *own_results(problem, run)))


def runs_of(run: Run | Machine) -> Mapping[str, Run]:
    """Return the runs of several shares by name; one by itself under ""."""
    return run.runs if isinstance(run, Machine) else {"": run}


def own_results(problem: Problem, run: Run | Machine) -> tuple[Grid, ...]:
    """Return a table of the results that a file computes itself, and of those with a label; none where it has none."""
    rows = [
        (name, own, [float(own.of(one)) for one in runs_of(run).values()])
        for name, own in measures_of(problem.table).items()
        if name in problem.table.measures
        or (own.label and all(own.given_by(one.scene.law) for one in runs_of(run).values()))
    ]
    grid = Grid.of("Results of this file" if problem.table.measures else "Further results", "", *problem.parts)
    for name, own, values in rows:
        grid.row(own.label or name.replace("_", " "), *(shown(problem, name, x, own.unit.symbol) for x in values))
    return (grid,) if rows else ()


def print_check(console: Console, problem: Problem) -> None:
    """Print what the scenes of a file contain and how they would be integrated."""
    console.print(f"[bold]{escape(problem.title)}[/]: {escape(problem.name)} is valid.")
    for name, part in problem.parts.items():
        console.print(_scene_table(part, part.scene(), name))
        console.print(_simulated(part, part.scene()))
    if problem.variables:
        verb = "optimise" if problem.table.minimise or problem.table.trade_off is None else "tradeoff"
        console.print(f"{len(problem.variables)} variables, {len(problem.table.require)} requirements: "
                      f"plough-opt {verb} {escape(problem.name)}")  # fmt: skip
    if problem.shares:
        console.print(f"{len(problem.shares)} shares, designed as one machine: drafts, powers and masses are limited"
                      " together, all else for each share; the objective is the sum over the shares.",
                      soft_wrap=True)  # fmt: skip
    if problem.table.uncertain is not None:
        names = ", ".join(key for key in problem.table.uncertain if key.startswith("soil."))
        console.print(f"Uncertain: {escape(names)}: optimise designs for them, all else takes the nominal soil.",
                      soft_wrap=True)  # fmt: skip
    for warning in warnings_of(problem):
        console.print(f"[yellow]Note:[/] {escape(warning)}.")


def warnings_of(problem: Problem) -> tuple[str, ...]:
    """Return what a reader must know of the scenes of a file, each sentence once."""
    return tuple(dict.fromkeys(text for part in problem.parts.values() for text in part.scene().warnings()))


def _simulated(problem: Problem, scene: Scene) -> Grid:
    """Return how a scene would be integrated."""
    rows = []
    if scene.effects.motion:
        equation = equation_of_motion(Structure.of(scene))
        rows.append(("equation of motion", f"2 states, {equation.function.n_nodes()} nodes"))
        rows.append(("its parameters", ", ".join(equation.names)))
        frequency = float(scene.natural_frequency) / (2.0 * math.pi)
        if scene.effects.printed.repelling_spring:
            growth = f"exp({float(scene.natural_frequency):.4g}/s t)"
            rows.append(("growth under the print's repelling spring", growth))
        else:
            rows.append(("natural frequency", f"{frequency:.4g} Hz"))
    else:
        rows.append(("quasi-static", "no equation of motion"))
    for wave in scene.effects.waves:
        rows.append(("frequency of the strength wave", f"{float(scene.tow_speed / wave.wavelength):.4g} Hz"))
    if scene.effects.random_strength is not None:
        rows.append(("random strength", f"{100.0 * float(scene.effects.random_strength.variance) ** 0.5:.3g} % RMS"))
        for quantity, name, unit in (
            ("mount force", "stationary_force_rms", "N"),
            ("deflection", "stationary_displacement_rms", "m"),
        ):
            value = float(getattr(scene, name))
            rows.append((f"stationary RMS of the {quantity}", shown(problem, name, value, unit)))
    return Grid.pairs("What is simulated", *rows)


def print_effects(console: Console, costs: Sequence[EffectCost]) -> None:
    """Print what each effect adds to the differential equation and to the operations of a run."""
    headings = ("effect", "", "nodes", "states", "events", "operations, with it over without")
    table = Grid.of("What each effect adds to this scene", *headings)
    for cost in costs:
        sizes = [f"{size:+d}" for size in (cost.nodes, cost.states, cost.events)]
        ratio = "a search" if cost.operations is None else f"{cost.operations:.3g}"
        found = ("", "", "", "not here, see below") if cost.refused else (*sizes, ratio)
        table.row(cost.name, "on" if cost.on else "off", *found)
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


def _scene_table(problem: Problem, scene: Scene, share: str = "") -> Grid:
    rows = [("soil", scene.soil.name)]
    if not scene.law.lacks("cone_index"):
        rows.append(("cone index", problem.readings or f"{float(cone_index(scene.soil)) / 1e3:.4g} kPa"))
    for key, value in problem.values().items():
        if not key.startswith("soil."):
            rows.append((key, shown(problem, key, float(value), quantities()[key].symbol)))
    rows.append(("half angle of the equivalent cone", customary("rad").text(float(scene.cone.half_angle))))
    rows.append(("moving mass with the share", f"{float(scene.mass):.5g} kg"))
    if not scene.law.lacks("added_mass"):
        rows.append(("added mass of soil", f"{float(scene.reaction.added_mass):.4g} kg"))
    if not scene.law.lacks("ambient_pressure"):
        rows.append(("ambient pressure's part of the static draft", f"{100.0 * float(scene.ambient_share):.0f} %"))
    if scene.medium != "plastic":
        rows.append(("law of resistance", scene.law.label))
    title = f"Scene of the share '{share}'" if share else "Scene"
    return Grid.pairs(f"{title}, variables at their guesses" if problem.variables else title, *rows)


def sensitivities_of(best: Optimum, notify: Progress) -> tuple[Sensitivity, ...]:
    """Return all sensitivities of an optimum, or none and a note that says why it has none."""
    notify("sensitivities", 1.0)
    try:
        return best.every_sensitivity()
    except (InputError, NotConverged) as error:
        LOG.info("note: no sensitivities: %s", error)
        return ()


def with_sensitivities(page: Page, problem: Problem, found: Sequence[Sensitivity]) -> Page:
    """Return a page with elasticities of the best objective and of the variables, by size, and how far they hold."""
    if not found:
        return page
    names = [key.rpartition(".")[2] for key in problem.variables]
    table = Grid.of(
        "Change in per cent for one per cent more, solved again; the same limits decide from ... to ...",
        "quantity or limit", "value", "objective", *names, "same limits from", "to", fold=("quantity or limit",),
    )  # fmt: skip
    for item in found:
        moves = [_percent(item.elasticity), *(_percent(item.elasticities[key]) for key in problem.variables)]
        key = item.name.partition(" ")[0]
        ends = [_end(problem, key, item, end) for end in (item.valid_from, item.valid_to)]
        table.row(item.name, shown(problem, key, item.value, item.unit), *moves, *ends)
    met = dict.fromkeys(name for item in found for name in item.touching)
    notes = (f"{name} is just met: the figures are for values that grow" for name in met)
    return replace(page, parts=(*page.parts, table), notes=(*page.notes, *notes))


def _percent(elasticity: float | None) -> str:
    if elasticity is None:
        return "value 0"
    return "0" if abs(elasticity) < _NONE else f"{elasticity:+.3g}"


def _end(problem: Problem, key: str, item: Sensitivity, end: float | None) -> str:
    """Return an end of a range; none where it is beyond zero, where no quantity of a file can go."""
    return "" if end is None or end * item.value <= 0.0 else shown(problem, key, end, item.unit)
