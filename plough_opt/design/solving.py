"""From a program to its certified optimum: local solve, global search, refinement, report."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca
import numpy as np

from plough_opt.design.basin import near_optimum
from plough_opt.design.curvature import flat_directions, minimum_from
from plough_opt.design.declarations import in_words
from plough_opt.design.derivatives import with_sure_derivatives
from plough_opt.design.effort import Search, effort_of, searched
from plough_opt.design.exploring import Explored, Explorer, Progress
from plough_opt.design.infeasible import feasible_from
from plough_opt.design.ipopt import Point, Vector, decides
from plough_opt.design.landscape import Landscape, Seen
from plough_opt.design.optimum import Limit, LocalOptimum, Optimum
from plough_opt.design.polishing import AS_FOUND, as_it_is, polished, to_the_last_digit
from plough_opt.design.program import Program
from plough_opt.design.record import Search as SearchRecord
from plough_opt.design.rounding import rounded
from plough_opt.design.sensitivity import Sensitivities
from plough_opt.design.tolerance import Judge, judgement, spread
from plough_opt.design.verify import TightEvaluation
from plough_opt.errors import InputError, NotConverged
from plough_opt.motion.judgement import remarks
from plough_opt.motion.simulation import repeat
from plough_opt.scene import Scene

_NO_COMPILER = "no C compiler was found ($CC, cc, gcc, clang): the model is interpreted, which takes longer"
_REFINEMENTS = 4
# Of the gap before, to which half as many steps more bring it at least, by a method of order 8.
_FALLS = 0.5
_FINER = 1.5
# Above this gap a design by a method with its own setting carries a warning.
_COARSE = 1e-6
# Basins that are optimised, the best first.
_MOST_POLISHED = 8
# The same where each takes longer, of more variables than so many, with the part by which their judged values may be
# above the best.
_MOST_OF_MANY, _FEW_VARIABLES, _CAN_WIN = 3, 3, 0.15
# Two scaled optima nearer than this are one.
_SAME = 1e-4
# An objective below this part of the program's scale is next to nothing, and errors are relative to the scale.
_SMALL = 0.25
# Mounts whose frequencies differ by less than this part are named as one, and of more than so many the first.
_ONE_MOUNT, _MOST_MOUNTS = 0.02, 4
_NUMBER = re.compile(r"\d[\d.e+-]*")


def solve_program(
    program: Program, p: Vector, how: tuple[Search, Judge, int], progress: Progress, started: float
) -> Optimum:
    """Return the best optimum of a program; ``how`` is search, judge and seed of `Design.solve`."""
    search, judge, seed = how
    variables = program.declared.variables
    vary = searched(search, variables)
    progress("preparing the model", 0.0)
    program.prepare(p, any_guess=bool(vary))
    landscape = Landscape(program, p)
    # What the algebra gives for a design is not searched.
    given = {variable.number for variable in landscape.settled}
    vary = tuple(k for k in vary if k not in given) or vary
    explored: Explored | None = None
    if vary:
        explored, points = _searched(program, landscape, p, how, vary, progress)
    else:
        progress("solving from the guess", 0.0)
        points = [near_optimum(program, landscape, p, program.start())]
    points, missed = _refined(program, p, points, progress)
    progress("checking", 0.0)
    points, unsure = with_sure_derivatives(program, p, _ranked(landscape, judge, points))
    missed += unsure
    scenes = [_scenes(program, point, p) for point in points]
    names = _names(program, [[scene for _, scene in own] for own in scenes])
    last = to_the_last_digit(program, p, points[0])
    points[0] = minimum_from(program, p, last, landscape.lower_from if landscape.vectorised else None)
    optima = [_local_optimum(program, p, point, name, landscape) for point, name in zip(points, names, strict=True)]
    directions = [] if points[0].status == AS_FOUND else flat_directions(program, p, points[0])
    best = optima[0]
    return Optimum(
        **{name: getattr(best, name) for name in LocalOptimum.__dataclass_fields__},
        status="unconfirmed" if points[0].status == AS_FOUND else "not unique" if directions else "solved",
        over=program.over,
        flat_directions=tuple(_in_units(program, points[0], d) for d in directions),
        local_optima=tuple(optima),
        search=_record(program, landscape, (search, seed), vary, explored, len(points), time.perf_counter() - started),
        seconds=time.perf_counter() - started,
        warnings=(
            *missed,
            *_valueless(explored),
            *_unconfirmed(points[0]),
            *_judged(best),
            *_warnings(program, points[0], p, scenes[0]),
        ),
        evaluate=partial(_evaluated, program, p, program.values(points[0].y)),
        sensitivities=Sensitivities(program, p, points[0]),
        rounder=partial(
            rounded, program, p, judge, points[0], best, partial(_report, program, p), partial(_evaluated, program, p)
        ),
    )


def _searched(
    program: Program,
    landscape: Landscape,
    p: Vector,
    how: tuple[Search, Judge, int],
    vary: tuple[int, ...],
    progress: Progress,
) -> tuple[Explored, list[Point]]:
    """Return what a search over some variables saw, and the local optima of the basins that can be best.

    Raises:
        InfeasibleDesign: no design was found that meets the requirements.
        NotConverged: no design has a value, or IPOPT made none of those that were found an optimum.
    """
    search, judge, seed = how
    start = program.start()
    effort = effort_of(search, len(vary), program.population.runs, landscape.vectorised)
    judged = judgement(landscape, judge)
    explored = Explorer(landscape, start, vary, judged, progress, seed).explored(effort)
    if not len(explored.bottoms.f):
        raise NotConverged(
            f"none of {landscape.tried} designs between the bounds has a value: tighten the bounds, or shorten the"
            " duration",
            "no value",
        )
    bottoms, points = explored.bottoms, []
    if np.any(bottoms.feasible) or not program.declared.requirements:
        points = _optima(program, landscape, p, bottoms, (judged, len(vary), effort.rounds), progress)
    if not points and program.declared.requirements:
        progress("looking for a design that meets the requirements", 0.0)
        y = feasible_from(program, landscape, p, explored.sample, start)
        bottoms = landscape.descend(y) if landscape.vectorised else landscape(y[None])
        points = _optima(program, landscape, p, bottoms, (judged, len(vary), effort.rounds), progress)
        if not points and (met := as_it_is(program, p, y)).solved:
            points = [met]
    if not points:
        place = program.declared.describe(program.values(bottoms.points[0]))
        raise NotConverged(
            f"no optimum was found; the best design that was seen is {place}: check the bounds, or search more"
            " thoroughly",
            "no optimum",
        )
    return explored, points


def _optima(
    program: Program,
    landscape: Landscape,
    p: Vector,
    bottoms: Seen,
    size: tuple[Callable[[Vector], Vector], int, int],
    progress: Progress,
) -> list[Point]:
    """Return the local optima of the bottoms that can be best.

    Args:
        program: the design's program.
        landscape: in which the bottoms lie.
        p: parameters.
        bottoms: of basins.
        size: what they are judged by, number of variables, and rounds of the search.
        progress: called with what is being done.
    """
    judged, variables, rounds = size
    program.scale_by(float(bottoms.f[np.argmin(bottoms.merit)]) * landscape.objective_scale)
    chosen = _that_can_win(judged(bottoms.points), variables <= _FEW_VARIABLES, rounds)
    program.build(p, starts=list(bottoms.points[chosen]))
    points: list[Point] = []
    for number, k in enumerate(chosen):
        progress(f"optimising basin {number + 1} of {len(chosen)}", number / len(chosen))
        point = polished(program, p, bottoms.points[k])
        if point.solved and not any(np.max(np.abs(point.y - other.y)) < _SAME for other in points):
            points.append(point)
    return points


def _that_can_win(judged: Vector, few: bool, rounds: int) -> list[int]:
    """Return which bottoms to optimise: the best, and of many variables only those that are little worse."""
    order = np.argsort(judged, kind="stable")
    if few:
        return [int(k) for k in order[: _MOST_POLISHED * rounds]]
    limit = judged[order[0]] + _CAN_WIN * abs(judged[order[0]])
    return [int(k) for k in order if judged[k] <= limit][: _MOST_OF_MANY * rounds]


def _ranked(landscape: Landscape, judge: Judge, points: list[Point]) -> list[Point]:
    """Return optima by what they are judged by, the best first; of equal ones the lower objective."""
    values = judgement(landscape, judge)(np.array([point.y for point in points]))
    order = sorted(range(len(points)), key=lambda k: (round(float(values[k]), 9), points[k].f))
    return [points[k] for k in order]


def _record(
    program: Program,
    landscape: Landscape,
    asked: tuple[Search, int],
    vary: tuple[int, ...],
    explored: Explored | None,
    polished: int,
    seconds: float,
) -> SearchRecord:
    """Return the record of a search, or of none."""
    own = [k for k, v in enumerate(program.declared.variables) if not v.auxiliary]
    n = len(program.declared.variables)
    sample = explored.sample if explored else Seen(np.empty((0, n)), np.empty(0), np.empty(0))
    return SearchRecord(
        asked=str(asked[0]),
        variables=tuple(program.declared.variables[k].name for k in vary),
        designs=landscape.tried if explored else 0,
        one_by_one=not landscape.vectorised,
        basins=len(explored.bottoms.f) if explored else 1,
        polished=polished,
        followed=explored.followed if explored else 0,
        reached=explored.reached if explored else 0,
        seed=asked[1],
        seconds=seconds,
        values=np.array([program.values(y) for y in sample.points]).reshape(-1, n)[:, own],
        objective=sample.f * landscape.objective_scale,
        violation=sample.violation,
    )


def _valueless(explored: Explored | None) -> tuple[str, ...]:
    """Return what a reader must know of designs between the bounds that a search could not look at."""
    if explored is None or not (part := np.mean(np.isnan(explored.sample.f))):
        return ()
    return (
        f"{100.0 * part:.2g} % of the designs tried between the bounds have no value, and were passed over: the model"
        " ends, the share runs away, or it oscillates too fast to be followed; tighten the bounds, shorten the"
        " duration, or take the quasi-static scene",
    )


def _unconfirmed(point: Point) -> tuple[str, ...]:
    """Return what a reader must know of a design that the optimiser did not confirm."""
    if point.status != AS_FOUND:
        return ()
    return (
        "the design is the best that was seen, but the optimiser did not confirm it as an optimum: objective or"
        " requirements are not smooth there (a kink, noise, a needle), or leave no room to move",
    )


def _judged(best: LocalOptimum) -> tuple[str, ...]:
    """Return what a reader must know of the best design as it is made."""
    spread = best.spread
    if spread is None or not spread.needle:
        return ()
    return (
        f"the best design is a needle: within its tolerances the objective is {spread.median:.6g} in the middle of the"
        f" cases, where {best.objective:.6g} was found; no workshop can hit it",
    )


def _refined(
    program: Program, p: Vector, points: list[Point], progress: Progress
) -> tuple[list[Point], tuple[str, ...]]:
    """Take more integration steps until the optimiser's objective is that of the tight integration."""
    wanted = program.wanted_error
    if wanted is None:
        gap = max(_gap(program, p, point) for point in points)
        coarse = f"the optimiser's objective is off by a relative {gap:.1e}: take more steps or a tighter tolerance"
        return points, (coarse,) if gap > _COARSE else ()
    last = math.inf
    for refinement in range(1, _REFINEMENTS + 1):
        gaps = [_gap(program, p, point) for point in points]
        if max(gaps) <= wanted:
            return points, ()
        if max(gaps) > _FALLS * last:  # a motion too sensitive for any number of steps
            break
        last = max(gaps)
        progress(f"refining: error {max(gaps):.1e}", refinement / _REFINEMENTS)
        program.build(p, _FINER**refinement, [point.y for point in points])
        for k, gap in enumerate(gaps):
            again = program.solve(points[k].y, p, near=True, exact=False, enough=True) if gap > wanted else points[k]
            if again.solved:
                points[k] = again
    gap = max(_gap(program, p, point) for point in points)
    if gap <= wanted:
        return points, ()
    return points, (f"the wanted relative error {wanted:.1e} of the objective was not reached: it is {gap:.1e}",)


def _gap(program: Program, p: Vector, point: Point) -> float:
    exact = float(program.exact_values(point.y, p)[0][0].item())
    return abs(point.f * program.objective_scale - exact) / max(abs(exact), _SMALL * program.objective_scale)


def _report(program: Program, p: Vector, point: Point) -> tuple[LocalOptimum, tuple[str, ...]]:
    """Return the report on a point, named as if it were alone, and its warnings."""
    scenes = _scenes(program, point, p)
    (name,) = _names(program, [[scene for _, scene in scenes]])
    return _local_optimum(program, p, point, name, Landscape(program, p)), _warnings(program, point, p, scenes)


def _local_optimum(program: Program, p: Vector, point: Point, name: str, landscape: Landscape) -> LocalOptimum:
    """Return the report on a point, from the tightly integrated model."""
    found, check = program.exact_values(point.y, p)
    objective = float(found[0].item())
    values = program.values(point.y)
    return LocalOptimum(
        name=name,
        objective=objective,
        variables={
            v.name: float(x) for v, x in zip(program.declared.variables, values, strict=True) if not v.auxiliary
        },
        limits=(*_requirements(program, point, found[1:]), *_bounds(program, point, values)),
        gap=_gap(program, p, point),
        error_estimate=abs(objective - float(check[0].item())) / max(abs(objective), _SMALL * program.objective_scale),
        iterations=point.iterations,
        spread=spread(landscape, point.y, objective),
    )


def _requirements(program: Program, point: Point, found: Sequence[Vector]) -> list[Limit]:
    limits, owner, pulls = [], np.array(program.owner), np.abs(point.lam_g)
    for k, (r, value) in enumerate(zip(program.declared.requirements, found, strict=True)):
        if r.auxiliary:
            continue
        numbers, own = value.ravel(), pulls[owner == k]
        margins = np.minimum(numbers - r.low, r.high - numbers)
        worst = int(np.argmin(margins))
        margin = float(margins[worst])
        limits.append(
            Limit(
                name=r.name,
                kind="requirement",
                value=float(numbers[worst]),
                limits=r.limits_text(),
                margin=margin,
                multiplier=float(np.sum(own) * program.objective_scale / program.scales[k]),
                active=decides(margin / program.scales[k], float(np.max(own))),
                unit=r.unit,
            )
        )
    return limits


def _bounds(program: Program, point: Point, values: Vector) -> list[Limit]:
    limits = []
    for v, value, y, multiplier in zip(program.declared.variables, values, point.y, point.lam_y, strict=True):
        if v.auxiliary:
            continue
        slope = value * math.log(v.upper / v.lower) if v.log else v.upper - v.lower
        limits.append(
            Limit(
                name=v.name,
                kind="bound",
                value=float(value),
                limits=f"{in_words(v.lower, v.unit)} to {in_words(v.upper, v.unit)}",
                margin=float(min(value - v.lower, v.upper - value)),
                multiplier=float(abs(multiplier) * program.objective_scale / slope),
                active=decides(float(min(y, 1.0 - y)), float(abs(multiplier))),
                unit=v.unit,
            )
        )
    return limits


def _scenes(program: Program, point: Point, p: Vector) -> list[tuple[Vector, Scene]]:
    """Return the parameters, the duration last [s], and the scenes of the program's runs at a point, with numbers."""
    numbers = [*program.values(point.y), *p]
    return [program.exact.inputs(k, numbers) for k in range(len(program.exact.runs))]


def _warnings(program: Program, point: Point, p: Vector, scenes: Sequence[tuple[Vector, Scene]]) -> tuple[str, ...]:
    """Return what a reader of the results at a point must know, each sentence once."""
    moving: list[str] = []
    for k, (parameters, scene) in enumerate(scenes):
        if scene.effects.orbit == "transient":
            moving += (*scene.warnings(), *remarks(program.exact.followed(k, parameters, scene)))
        else:
            moving += repeat(scene, float(parameters[-1])).warnings
    still = program.exact.quasi_static_scenes([*program.values(point.y), *p])
    slow = (_NO_COMPILER,) if program.compiled and program.interpreted else ()
    return (*slow, *_alike_once([*moving, *(text for scene in still for text in scene.warnings())]))


def _alike_once(sentences: Sequence[str]) -> list[str]:
    """Return sentences each once; of those that differ in numbers only, the first, which says of how many it speaks."""
    alike: dict[str, list[str]] = {}
    for text in dict.fromkeys(sentences):
        alike.setdefault(_NUMBER.sub("#", text), []).append(text)
    return [
        own[0] if len(own) == 1 else f"{own[0]}; and with other numbers in {len(own) - 1} further scenes of this design"
        for own in alike.values()
    ]


def _names(program: Program, scenes: Sequence[Sequence[Scene]]) -> list[str]:
    """Return a name for each optimum, no two alike: under a strength wave its branch, soft or stiff beside resonance.

    Args:
        program: the design's program.
        scenes: for each optimum, the scenes of its runs.
    """
    mounts = _mounts(program, scenes)
    names = [
        "; ".join(
            f"{f'mount {number + 1}: ' if len(mounts) > 1 else ''}{branch} branch, {ratio:.2f} of the wave's frequency"
            for number, (branch, ratio) in enumerate(own)
        )
        for own in zip(*mounts, strict=True)
    ]
    if not names:
        return ["optimum"] if len(scenes) == 1 else [f"optimum {k + 1}" for k in range(len(scenes))]
    return [name if names.count(name) == 1 else f"{name} ({names[:k].count(name) + 1})" for k, name in enumerate(names)]


def _mounts(program: Program, scenes: Sequence[Sequence[Scene]]) -> list[list[tuple[str, float]]]:
    """Return for each mount under a wave that differs from the others, of each optimum, its branch and frequency ratio.

    Many samples of one share's soil have mounts that hardly differ; the first stands for them.
    """
    found: list[list[tuple[str, float]]] = []
    for k, run in enumerate(program.exact.runs):
        if not run.integration.structure.wave or not all(own[k].branch for own in scenes):
            continue
        ratios = [float(own[k].natural_frequency / own[k].wave_frequency) for own in scenes]
        mount = [(str(own[k].branch), ratio) for own, ratio in zip(scenes, ratios, strict=True)]
        if not any(np.allclose(ratios, [ratio for _, ratio in other], rtol=_ONE_MOUNT) for other in found):
            found.append(mount)
    return found if len(found) <= _MOST_MOUNTS else found[:1]


def _in_units(program: Program, point: Point, direction: Vector) -> dict[str, float]:
    """Return a scaled direction as changes of the variables, for a step of 1 % of the range of the one that leads."""
    step = 0.01 * direction / np.max(np.abs(direction))
    change = program.values(np.clip(point.y + step, 0.0, 1.0)) - program.values(point.y)
    return {v.name: float(x) for v, x in zip(program.declared.variables, change, strict=True)}


def _evaluated(program: Program, p: Vector, values: Vector, expression: ca.MX) -> Vector:
    """Return an expression of the design's symbols at numbers, its runs integrated tightly."""
    if isinstance(expression, ca.SX):
        raise InputError("an SX expression cannot be of this design, whose variables are MX")
    symbols = program.declared.symbols()
    expression = ca.MX(expression)
    if strangers := program.declared.strangers(expression):
        raise InputError(f"the expression holds symbols that are not of this design: {', '.join(strangers)}")
    (value,), _ = TightEvaluation([expression], symbols, beside=program.exact)([*values, *p])
    return np.squeeze(value)
