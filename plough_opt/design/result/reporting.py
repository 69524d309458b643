"""Reports on local optima: their limits, names and warnings."""

from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np

from plough_opt.core.compiler import interpretation_warning
from plough_opt.design.confirmation import SMALL, gap_of, spread
from plough_opt.design.model.ipopt import Point, Vector
from plough_opt.design.model.optimality import decides
from plough_opt.design.model.program import Program
from plough_opt.design.result.optimum import Limit, LocalOptimum
from plough_opt.design.search.landscape import Landscape
from plough_opt.design.search.polish import AS_FOUND
from plough_opt.motion.run import without_repetition
from plough_opt.motion.scene import Scene
from plough_opt.motion.simulation import repeat
from plough_opt.motion.solvers.checks import remarks as remarks_on_run

# A limit of a law that does not decide is named if its margin is within this part of its scale.
_NEARLY_MET: Final = 0.05


def remarks(sampled: Vector, point: Point, best: LocalOptimum, options: Collection[str]) -> Iterator[str]:
    """Yield warnings about designs that could not be evaluated, an unconfirmed optimum, and a needle.

    Args:
        sampled: objectives of a search's sample, NaN where there is none; empty without a search.
        point: the best point.
        best: its report.
        options: names of the options of IPOPT that the user gave.
    """
    if part := np.mean(np.isnan(sampled)) if len(sampled) else 0.0:
        yield (
            f"{100.0 * part:.2g} % of the designs tried between the bounds could not be evaluated and were skipped:"
            " they leave the model's domain, or the share runs away or oscillates too fast; tighten the bounds, shorten"
            " the duration, or use the quasi-static scene"
        )
    if point.status == AS_FOUND:
        names = ", ".join(name.removeprefix("ipopt.") for name in options)
        yield (
            "the design is the best one found, but the optimiser did not confirm it as an optimum: objective or"
            " requirements are not smooth there (a kink, noise, a needle), or leave no room to move"
            + (f"; or the options given to it stop it ({names}): solve without them" if names else "")
        )
    if best.spread is not None and best.spread.needle:
        yield (
            f"the best design is a needle: its objective is {best.objective:.6g}, but the median within its tolerances"
            f" is {best.spread.median:.6g}; no workshop can hit it"
        )


def reports(
    program: Program, landscape: Landscape, points: Sequence[Point]
) -> tuple[tuple[LocalOptimum, ...], tuple[str, ...]]:
    """Return the reports on points, each with its own name, and the warnings about the runs of the first."""
    p = landscape.p
    numbers = [[*program.values(point.y), *p] for point in points]
    runs = [[program.exact.inputs(k, own) for k in range(len(program.exact.runs))] for own in numbers]
    names = _names_of(program, [[scene for _, scene in own] for own in runs])
    optima = [_local_optimum(program, landscape, point, name) for point, name in zip(points, names, strict=True)]
    return tuple(optima), _warnings_at(program, numbers[0], runs[0])


def _local_optimum(program: Program, landscape: Landscape, point: Point, name: str) -> LocalOptimum:
    """Return the report on a point, from tightly integrated runs."""
    p = landscape.p
    found, check = program.exact_values(point.y, p), program.exact_values(point.y, p, check=True)
    objective = float(found[0].item())
    values = program.values(point.y)
    return LocalOptimum(
        name=name,
        objective=objective,
        variables=program.declared.named(values),
        limits=(*requirements_at(program, point, found[1:]), *bounds_at(program, point, values)),
        gap=gap_of(program, p, point),
        error_estimate=abs(objective - float(check[0].item())) / max(abs(objective), SMALL * program.objective_scale),
        iterations=point.iterations,
        spread=spread(landscape, point.y, objective),
    )


def requirements_at(program: Program, point: Point, found: Sequence[Vector]) -> list[Limit]:
    """Return the requirements at a point, from their tightly integrated values."""
    limits, owner, multipliers = [], np.array(program.owner), np.abs(point.lam_g)
    for k, (r, value) in enumerate(zip(program.declared.requirements, found, strict=True)):
        numbers, own, scale = value.ravel(), multipliers[owner == k], program.scales[k]
        margins = r.margins(numbers)
        worst = int(np.argmin(margins))
        margin, multiplier = float(margins[worst]), float(np.sum(own) * program.objective_scale / scale)
        active = decides(margin / scale, float(np.max(own)))
        at = (float(numbers[worst]), r.limits_text(), margin, multiplier, active)
        trivial = k >= len(program.own_requirements) and not active and margin > _NEARLY_MET * scale
        limits.append(Limit(r.name, "requirement", *at, r.unit, r.shown, r.at_least, r.at_most, trivial))
    return limits


def bounds_at(program: Program, point: Point, values: Vector) -> list[Limit]:
    """Return the bounds at a point, where the variables have certain values."""
    limits = []
    sizes = np.abs(point.lam_y).tolist()
    for v, x, y, size in zip(program.declared.variables, values.tolist(), point.y, sizes, strict=True):
        text = f"{v.shown.text(v.lower)} to {v.shown.text(v.upper)}"
        margin, multiplier = min(x - v.lower, v.upper - x), float(size * program.objective_scale / v.slope(float(y)))
        active = decides(float(min(y, 1.0 - y)), size)
        limits.append(Limit(v.name, "bound", x, text, margin, multiplier, active, v.unit, v.shown, v.lower, v.upper))
    return limits


def _warnings_at(program: Program, numbers: Sequence[float], runs: Sequence[tuple[Vector, Scene]]) -> tuple[str, ...]:
    """Return the warnings about the runs at a point, each once."""
    moving: list[str] = []
    for k, (parameters, scene) in enumerate(runs):
        if scene.effects.orbit == "transient":
            moving += (*scene.warnings(), *remarks_on_run(program.exact.followed(k, parameters, scene)))
        else:
            moving += repeat(scene, float(parameters[-1])).warnings
    still = program.exact.quasi_static_scenes(numbers)
    slow = (interpretation_warning(),) if program.compiled and program.built.nlp is program.built.plain else ()
    return (*slow, *without_repetition([*moving, *(text for scene in still for text in scene.warnings())]))


def _names_of(program: Program, scenes: Sequence[Sequence[Scene]]) -> list[str]:
    """Return a different name for each optimum: under a strength wave its branch, softer or stiffer than resonance.

    Args:
        program: the design's program.
        scenes: for each optimum, the scenes of its runs, of which the first under a wave gives the name.
    """
    waves = (k for k, run in enumerate(program.exact.runs) if run.integration.structure.wave)
    first = next((k for k in waves if all(own[k].branch for own in scenes)), None)
    if first is None:
        return ["optimum"] if len(scenes) == 1 else [f"optimum {k + 1}" for k in range(len(scenes))]
    names = [
        f"{scene.branch} branch, {float(scene.natural_frequency / scene.wave_frequency):.2f} of the wave's frequency"
        for scene in (own[first] for own in scenes)
    ]
    return [name if names.count(name) == 1 else f"{name} ({names[:k].count(name) + 1})" for k, name in enumerate(names)]
