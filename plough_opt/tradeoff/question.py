"""`trade_off`: two objectives of a design in, their front out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from plough_opt.design import Design, Progress
from plough_opt.design.ipopt import Point
from plough_opt.design.search import scanned_variables
from plough_opt.errors import InputError, NotConverged
from plough_opt.expressions import Expression, is_count
from plough_opt.tradeoff.caveats import caveats
from plough_opt.tradeoff.certificate import FrontPoint, certify
from plough_opt.tradeoff.goal import Axis, Goal
from plough_opt.tradeoff.plane import efficient, gaps, spread
from plough_opt.tradeoff.program import FrontProgram
from plough_opt.tradeoff.result import Hole, TradeOff
from plough_opt.tradeoff.tracing import Failure, Sample, Tracer

_FEWEST, _MOST = 5, 1000
_REFINEMENTS = 4
# Relative ranges of an objective below the first are rounding, below the second hardly a conflict.
_NONE, _HARDLY = 1e-5, 0.02


def trade_off(
    design: Design,
    first: Goal | Expression,
    second: Goal | Expression,
    *others: Goal | Expression,
    points: int = 40,
    search: str | Sequence[str] = "auto",
    compiled: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> TradeOff:
    """Return the designs of which none is better in one objective without being worse in the other.

    By the normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003): from the optima of either objective
    alone, both ways, at positions that are evenly spread in the normalised objectives. Unlike a weighted sum it finds
    the concave parts of a front. Every local optimum of an anchor, and of three positions between them, is the start of
    a branch, so that a front's parts beside a ridge are all followed. For example::

        radius = po.Goal("loosened radius", po.loosened_radius(cone, soil), unit="m", maximise=True)
        front = po.trade_off(d, po.Goal("draft", run.mean_draft, unit="N"), radius)

    Args:
        design: variables, parameters at their declared values, and requirements; its own objective takes no part.
        first: an objective: an expression to minimise, or a `Goal` with a name, a unit and a direction.
        second: the other objective.
        others: none; more than two objectives are refused.
        points: number of positions, the anchors included, from 5 to 1000. Parts that end between positions get their
            ends beside these.
        search: as in `Design.solve`: which variables are scanned for further local optima. Without a scan the anchors
            are those that the guess leads to, and parts of the front that lie elsewhere stay unknown.
        compiled: as in `Design.solve`.
        title: of the question, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: more than two objectives, one that is no scalar expression of this design, or nothing to vary.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: an objective alone has no optimum that the optimiser finds, or no point could be certified.
    """
    started = time.perf_counter()
    if others:
        raise InputError(
            f"{2 + len(others)} objectives were given: a front is drawn of two; put the others into requirements"
        )
    if not is_count(points) or not _FEWEST <= points <= _MOST:
        raise InputError(f"points = {points!r} must be a whole number from {_FEWEST} to {_MOST}")
    goals = (_goal(first, "first objective"), _goal(second, "second objective"))
    if goals[0].name == goals[1].name:
        raise InputError(f"both objectives are named '{goals[0].name}': give each its own name")
    told = progress or _silent
    told("building the model", 0.0)
    front = FrontProgram(design, goals, compiled=compiled)
    tracer = Tracer(front, scanned_variables(front.program, search), int(points), told)
    anchors = _anchors(front, tracer)
    single = _conflict(front, anchors)
    if single is None:
        _trace(tracer, front, anchors, told)
    else:
        tracer.keep_anchors(single, anchors[single][:1])
    told("checking", 0.0)
    return _report(front, tracer, goals, title, started)


def _anchors(front: FrontProgram, tracer: Tracer) -> tuple[list[Point], list[Point]]:
    """Return all local optima of either objective alone, with enough integration steps for the wanted error."""
    found = (tracer.anchors(0), tracer.anchors(1))
    wanted = front.program.wanted_error
    for _ in range(_REFINEMENTS):
        if wanted is None or max(front.gap(point.y) for points in found for point in points) <= wanted:
            break
        front.refine()
        found = (tracer.anchors(0), tracer.anchors(1))
    return found


def _conflict(front: FrontProgram, anchors: tuple[list[Point], list[Point]]) -> int | None:
    """Normalise the objectives; return the anchor that is best in both of them, or None where they conflict."""
    ends = [front.objectives(points[0].y) for points in anchors]
    front.normalise(*ends)
    sizes = np.maximum(1e-3, np.max(np.abs(ends), axis=0))
    for objective, span in enumerate(front.span / sizes):
        if span < _NONE:
            front.low, front.span = np.zeros(2), np.ones(2)
            return 1 - objective
    return None


def _trace(tracer: Tracer, front: FrontProgram, anchors: tuple[list[Point], list[Point]], told: Progress) -> None:
    """Follow every branch from every optimum both ways, and look into what gaps are left."""
    starts = [(sample, 1 - k) for k in (0, 1) for sample in tracer.keep_anchors(k, anchors[k])]
    for number, (sample, objective) in enumerate(starts):
        told(f"following branch {number + 1} of {len(starts)}", number / len(starts))
        tracer.follow(sample, objective)
    tracer.search_inside()
    tracer.fill_gaps()
    _refine(tracer, front, told)
    tracer.look_inward()


def _refine(tracer: Tracer, front: FrontProgram, told: Progress) -> None:
    """Take more integration steps until the front is that of the tight integration."""
    wanted = front.program.wanted_error
    for refinement in range(1, _REFINEMENTS + 1):
        if wanted is None or max(front.gap(sample.point.y) for sample in tracer.front()) <= wanted:
            return
        told("refining", refinement / _REFINEMENTS)
        front.refine()
        tracer.solve_again()


def _report(front: FrontProgram, tracer: Tracer, goals: tuple[Goal, Goal], title: str, started: float) -> TradeOff:
    """Certify what was found, and return the efficient points in order with their parts and holes."""
    signs = np.array([goal.sign for goal in goals])
    certified: list[tuple[Sample, FrontPoint]] = []
    failures = [Failure(_own(front, failure.objectives, signs), failure.reason) for failure in tracer.failures]
    for sample in tracer.samples:
        point = certify(front, sample, signs)
        if point.doubt:
            failures.append(Failure(point.objectives, point.doubt))
        else:
            certified.append((sample, point))
    if not certified:
        raise NotConverged(f"no point of the front could be certified: {failures[-1].reason}", "Not_Certified")
    at = np.array([front.normalised(np.array(point.objectives) * signs / front.scales) for _, point in certified])
    order = efficient(at)
    efficient_ones = set(order.tolist())
    kept = order[spread(at[order], tracer.step)]
    points = tuple(certified[k][1] for k in kept)
    breaks = gaps(at[kept], tracer.step)
    bounds = [0, *(k + 1 for k in breaks), len(points)]
    program = front.program
    return TradeOff(
        title=title,
        goals=(Axis(goals[0].name, goals[0].unit, goals[0].maximise),
               Axis(goals[1].name, goals[1].unit, goals[1].maximise)),
        variables=tuple(
            Axis(v.name, v.unit, log=v.log, lower=v.lower, upper=v.upper) for v in program.declared.variables
        ),
        points=points,
        dominated=tuple(point for k, (_, point) in enumerate(certified) if k not in efficient_ones),
        failures=tuple(failures),
        parts=tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
        holes=tuple(_hole(points[k], points[k + 1], failures, signs) for k in breaks),
        notes=(*_notes(front, goals, points), *caveats(front, [certified[k][0].point.y for k in kept])),
        seconds=time.perf_counter() - started,
    )  # fmt: skip


def _hole(before: FrontPoint, after: FrontPoint, failures: Sequence[Failure], signs: np.ndarray) -> Hole:
    """Return a hole; it is not settled where the optimiser failed within."""
    low, high = (np.array(point.objectives) * signs for point in (before, after))
    within = [
        failure
        for failure in failures
        if low[0] <= failure.objectives[0] * signs[0] <= high[0]
        and high[1] <= failure.objectives[1] * signs[1] <= low[1]
        and not failure.reason.startswith("Infeasible_Problem_Detected")
    ]
    return Hole(before.objectives, after.objectives, settled=not within)


def _notes(front: FrontProgram, goals: tuple[Goal, Goal], points: tuple[FrontPoint, ...]) -> tuple[str, ...]:
    """Return sentences on objectives that hardly conflict, and on an error that is larger than wanted."""
    notes = []
    names = [f"'{goal.name}'" for goal in goals]
    values = np.array([point.objectives for point in points])
    ranges = np.ptp(values, axis=0) / np.maximum(np.max(np.abs(values), axis=0), np.finfo(float).tiny)
    if len(points) == 1:
        notes.append(f"{names[0]} and {names[1]} do not conflict: one design is best in both")
    elif np.max(ranges) < _HARDLY:
        notes.append(
            f"{names[0]} and {names[1]} hardly conflict: along the whole front they change by"
            f" {100 * ranges[0]:.2g} % and {100 * ranges[1]:.2g} %"
        )
    wanted, gap = front.program.wanted_error, max(point.gap for point in points)
    if wanted is not None and gap > wanted:
        notes.append(f"the wanted relative error {wanted:.1e} was not reached everywhere: the largest is {gap:.1e}")
    return tuple(notes)


def _own(front: FrontProgram, normalised: tuple[float, float], signs: np.ndarray) -> tuple[float, float]:
    """Return normalised objectives in their own units and directions."""
    first, second = (np.array(normalised) * front.span + front.low) * front.scales * signs
    return float(first), float(second)


def _goal(given: Goal | Expression, name: str) -> Goal:
    return given if isinstance(given, Goal) else Goal(name, given)


def _silent(_stage: str, _fraction: float) -> None:
    """Report nothing."""
