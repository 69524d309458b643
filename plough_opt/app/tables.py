"""Tables that commands print, with each value in the unit that the problem file uses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.errors import DomainError, InputError, NotConverged
from plough_opt.core.expressions import as_number
from plough_opt.core.quantities import quantities
from plough_opt.core.tables import Grid, Page, Part
from plough_opt.core.units import customary
from plough_opt.laws import LAWS, ShareInSoil
from plough_opt.laws.forces import cone_index
from plough_opt.laws.law import without_pressure
from plough_opt.motion import Run
from plough_opt.motion.effect_costs import EffectCost
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import Problem
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.design import Optimum, Progress, Sensitivity

ROUNDING: Final = 1e-9
"""An elasticity, or a margin in SI units, below this is rounding."""


def shown(problem: Problem, key: str, value: float, unit: str) -> str:
    """Return an SI value as text in the unit that the file uses for the key, or in a customary one."""
    return problem.origin.display(key, unit, value).text(value)


def soils_page(soils: Sequence[Soil]) -> Page:
    """Return a table of the named soils, and the sources of their values."""
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
    sources = (f"{soil.name}: {soil.source}" for soil in soils)
    pores = "All have an ambient pressure of 101.325 kPa. For soil with open pores set soil.ambient_pressure."
    return Page("", (table, *sources), footer=pores)


def run_page(problem: Problem, run: Run) -> Page:
    """Return the page of a numeric run with its scene."""
    page = run.page()
    return replace(page, parts=(_whole_scene(problem, run.scene), *page.parts, *further_results(problem, run)))


def further_results(problem: Problem, run: Run) -> tuple[Grid, ...]:
    """Return a table of the results with a label of their own; empty if the law of resistance gives none."""
    rows = [
        (measure.label, shown(problem, name, float(measure.of(run)), measure.unit.symbol))
        for name, measure in MEASURES.items()
        if measure.label and measure.given_by(run.scene.law)
    ]
    return (Grid.pairs("Further results", *rows),) if rows else ()


def check_page(problem: Problem, drafts: Mapping[str, Mapping[str, Any]]) -> Page:
    """Return the contents of a file's scene, the equation of motion that would be integrated, and drafts by law.

    Args:
        problem: the file.
        drafts: its `drafts_by_law`.
    """
    scene = problem.scene()
    parts: list[Part] = [_whole_scene(problem, scene), _simulated(problem, scene), _laws_table(drafts)]
    if problem.variables:
        verb = "optimise" if problem.table.minimise or problem.table.trade_off is None else "tradeoff"
        counts = f"{len(problem.variables)} variables, {len(problem.table.require)} requirements"
        parts.append(f"{counts}: plough-opt {verb} {problem.name}")
    if problem.table.uncertain is not None:
        names = ", ".join(problem.table.uncertain.soil)
        parts.append(
            f"Uncertain: {names}. plough-opt optimise allows for this; all other commands use the nominal soil."
        )
    notes = (*scene.warnings(), *problem.reliance)
    return Page("", tuple(parts), notes, title=f"{problem.title}: {problem.name} is valid.")


def _simulated(problem: Problem, scene: Scene) -> Grid:
    """Return a table of the equation of motion of a scene and of its excitation."""
    rows = []
    if scene.effects.motion:
        equation = equation_of(Structure.of(scene))
        rows.append(("equation of motion", f"2 states, {equation.rate.n_nodes()} nodes"))
        rows.append(("its parameters", ", ".join(equation.names)))
        natural = float(scene.natural_frequency)
        if scene.effects.printed.repelling_spring:
            rows.append(("growth under the print's repelling spring", f"exp({natural:.4g}/s t)"))
        else:
            rows.append(("natural frequency", f"{natural / (2.0 * math.pi):.4g} Hz"))
    else:
        rows.append(("quasi-static", "no equation of motion"))
    if (course := scene.effects.tow_profile) is not None:
        largest = shown(problem, "scene.tow_speed", float(scene.tow_speed), "m/s")
        rows.append(("tow speed", f"varies until {course.times[-1]:.4g} s, at most {largest}"))
    for wave in scene.effects.waves:
        rows.append(("frequency of the strength wave", f"{float(scene.tow_speed / wave.wavelength):.4g} Hz"))
    if scene.effects.random_strength is not None:
        rows.append(("random strength", f"{100.0 * float(scene.effects.random_strength.variance) ** 0.5:.3g} % RMS"))
    return Grid.pairs("What is simulated", *rows)


def effects_parts(costs: Sequence[EffectCost]) -> tuple[Part, ...]:
    """Return what each effect adds to the equation of motion, and refusals."""
    table = Grid.of("What each effect adds to this scene", "effect", "", "nodes", "states", "events")
    for cost in costs:
        sizes = [f"{size:+d}" for size in (cost.nodes, cost.states, cost.events)]
        cells = ("", "", "impossible, see below") if cost.refused else sizes
        table.row(cost.name, "on" if cost.on else "off", *cells)
    return (table, *(f"{cost.name}: {cost.refused}." for cost in costs if cost.refused))


def drafts_by_law(scene: Scene) -> dict[str, dict[str, object]]:
    """Return label -> draft of the share at the tow speed [N], None outside the law's domain, and a remark on it.

    Each law in `LAWS` takes what the scene does not give from the share; the scene's own law is as the scene gives it.
    """
    at = ShareInSoil(scene.share, scene.cone, scene.soil, scene.tow_speed)
    at = at if scene.effects.ambient_pressure else without_pressure(at)
    drafts: dict[str, dict[str, object]] = {}
    for kind in dict.fromkeys((*LAWS.values(), type(scene.law))):
        law = scene.law if isinstance(scene.law, kind) else kind()
        try:
            drafts[law.label] = {"draft": float(as_number(law.reaction(at).at(at.speed))), "standing": law.standing}
        except (InputError, DomainError) as error:
            drafts[law.label] = {"draft": None, "standing": f"outside its domain: {error}"}
    return drafts


def _laws_table(drafts: Mapping[str, Mapping[str, Any]]) -> Grid:
    """Return a table of the drafts by all laws, and of what is not verified in each."""
    table = Grid.of(
        "Draft of the share by each law: calculated, not measured", "law", "draft", "remark", left=["remark"]
    )
    for label, row in drafts.items():
        draft = "-" if row["draft"] is None else f"{row['draft'] / 1e3:.3g} kN"
        table.row(label.removeprefix("the "), draft, row["standing"])
    table.caption = "Agreement of two laws validates neither: docs/explanation/crosscheck.md says why they differ."
    return table


def scene_table(problem: Problem, scene: Scene, values: Mapping[str, Any], title: str) -> Grid:
    """Return a table of some quantities of a scene, key -> SI value, and of what follows from them."""
    rows = [("soil", scene.soil.name)]
    if not scene.law.lacks("cone_index"):
        rows.append(("cone index", problem.readings or f"{float(cone_index(scene.soil)) / 1e3:.4g} kPa"))
    for key, value in values.items():
        if not key.startswith("soil."):
            rows.append((key, shown(problem, key, float(value), quantities()[key].symbol)))
    effects = problem.table.effects
    rows += [(name, getattr(effects, name).replace("_", " ")) for name in ("contact", "start", "orbit")]
    rows.append(("half angle of the equivalent cone", customary("rad").text(float(scene.cone.half_angle))))
    rows.append(("moving mass with the share", f"{float(scene.mass):.5g} kg"))
    if not scene.law.lacks("added_mass"):
        rows.append(("added mass of soil", f"{float(scene.reaction.added_mass):.4g} kg"))
    if not scene.law.lacks("ambient_pressure"):
        rows.append(("part of the static draft due to ambient pressure", f"{100.0 * float(scene.ambient_share):.0f} %"))
    if scene.medium != "plastic":
        rows.append(("law of resistance", scene.law.label))
    return Grid.pairs(title, *rows)


def _whole_scene(problem: Problem, scene: Scene) -> Grid:
    title = "Scene, variables at their guesses" if problem.variables else "Scene"
    return scene_table(problem, scene, problem.values(), title)


def sensitivities_of(best: Optimum, notify: Progress) -> tuple[tuple[Sensitivity, ...], str]:
    """Return all sensitivities of an optimum, and the reason if it has none."""
    notify("sensitivities", 1.0)
    try:
        return best.every_sensitivity(), ""
    except (InputError, NotConverged) as error:
        return (), str(error)


def sensitivity_table(problem: Problem, found: Sequence[Sensitivity]) -> Grid:
    """Return a table of elasticities and of the range over which the same limits are active."""
    names = [key.rpartition(".")[2] for key in problem.variables]
    table = Grid.of(
        "Change of the optimum in per cent for one per cent more; range in which the same limits stay active",
        "quantity or limit", "value", "objective", *names, "same limits from", "to", fold=("quantity or limit",),
    )  # fmt: skip
    for item in found:
        moves = [_percent(item.elasticity), *(_percent(item.elasticities[key]) for key in problem.variables)]
        key = item.name.partition(" ")[0]
        ends = [_end(problem, key, item, end) for end in (item.valid_from, item.valid_to)]
        table.row(item.name, shown(problem, key, item.value, item.unit), *moves, *ends)
    return table


def _percent(elasticity: float | None) -> str:
    if elasticity is None:
        return "value 0"
    return "0" if abs(elasticity) < ROUNDING else f"{elasticity:+.3g}"


def _end(problem: Problem, key: str, item: Sensitivity, end: float | None) -> str:
    """Return an end of a range as text; "" if its sign differs from the value's, which a file would not accept."""
    return "" if end is None or end * item.value <= 0.0 else shown(problem, key, end, item.unit)
