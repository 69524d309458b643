"""From local optima to a front: certified, put in order, with its parts, holes and sentences."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from plough_opt.errors import NotConverged
from plough_opt.tradeoff.caveats import caveats
from plough_opt.tradeoff.certificate import FrontPoint, certify
from plough_opt.tradeoff.goal import Axis, Goal
from plough_opt.tradeoff.notes import against_the_search, looked_at, notes_on
from plough_opt.tradeoff.plane import Array, efficient, gaps, needed, spread
from plough_opt.tradeoff.program import FrontProgram
from plough_opt.tradeoff.result import Hole, TradeOff
from plough_opt.tradeoff.samples import MATTERS, Failure, Sample, Samples
from plough_opt.tradeoff.space import covering, lattice, parts_of, uncrowded, undominated
from plough_opt.tradeoff.surface import IN_TURN, SurfaceTracer
from plough_opt.tradeoff.tracing import Tracer

# Of six anchors none has to stay where it lies beside another.
_LAST = np.full(6, 1)
# Of a hole's size: nearer to its ends is at them.
_EDGE = 1e-3
# Steps between points of a surface that are not on positions.
_ROOM = 0.7
# Normalised objectives that differ by less are equal.
_SAME = 1e-4
# Steps, in the objectives: no efficient design that was found is farther from a point of a surface.
_COVERED = 1.0


@dataclass(frozen=True)
class Times:
    """When a front was begun, and how long its program took to build [s]."""

    started: float
    building: float


@dataclass(frozen=True)
class Order:
    """Rows of a front.

    Attributes:
        efficient: those that no other dominates.
        kept: those of them that do not crowd, in order.
        parts: numbers of kept rows.
        holes: pairs of kept rows between which there is none.
    """

    efficient: frozenset[int]
    kept: tuple[int, ...]
    parts: tuple[tuple[int, ...], ...]
    holes: tuple[tuple[int, int], ...]


def assembled(
    front: FrontProgram, tracer: Tracer | SurfaceTracer, goals: Sequence[Goal], title: str, times: Times
) -> TradeOff:
    """Certify what was found, and return the efficient points in order with their parts and holes.

    Raises:
        NotConverged: no point could be certified.
    """
    signs = np.array([goal.sign for goal in goals])
    every, failures = _certified(front, tracer, signs)
    if not every:
        raise NotConverged(f"no point of the front could be certified: {failures[-1].reason}", "Not_Certified")
    # A needle beats no design that can be made; where there is nothing else it is named.
    certified = [own for own in every if not own[1].needle] or every
    needles = tuple(point for _, point in every if point.needle)
    at = np.array([front.normalised(np.array(point.objectives) * signs / front.scales) for _, point in certified])
    if isinstance(tracer, SurfaceTracer):
        order = _surface(at, [tracer.is_efficient(sample) for sample, _ in certified], tracer.step)
    else:
        order = _curve(at, [sample.extra for sample, _ in certified], tracer.step)
    points = tuple(certified[k][1] for k in order.kept)
    variables = front.program.declared.variables
    return TradeOff(
        title=title,
        goals=tuple(Axis(goal.name, goal.unit, goal.maximise) for goal in goals),
        variables=tuple(Axis(v.name, v.unit, log=v.log, lower=v.lower, upper=v.upper) for v in variables),
        points=points,
        dominated=tuple(point for k, (_, point) in enumerate(certified) if k not in order.efficient),
        needles=needles if certified is not every else (),
        failures=tuple(failures),
        parts=order.parts,
        holes=tuple(hole(points[a], points[b], failures, signs) for a, b in order.holes),
        notes=(
            *notes_on(tracer, goals, points),
            *against_the_search(tracer, at[list(order.kept)]),
            *_caveats(front, [certified[k][0] for k in order.kept]),
        ),
        search=looked_at(tracer),
        seconds=time.perf_counter() - times.started,
        building=times.building + front.building,
    )


def _certified(
    front: FrontProgram, tracer: Samples, signs: Array
) -> tuple[list[tuple[Sample, FrontPoint]], list[Failure]]:
    """Return samples with their certificates, and what failed, in the objectives' own units."""
    found: list[tuple[Sample, FrontPoint]] = []
    doubtful: list[tuple[Sample, FrontPoint]] = []
    failures = []
    places = np.array([sample.at for sample in tracer.found])
    for failure in tracer.failures:
        # Beside a design that another beats nothing is missing.
        at = np.array(failure.objectives)
        if np.any(np.all(places <= at + _SAME, axis=1) & np.any(places < at - MATTERS, axis=1)):
            continue
        own = (np.array(failure.objectives) * front.span + front.low) * front.scales * signs
        failures.append(replace(failure, objectives=tuple(own.tolist())))
    for sample in tracer.found:
        sample.scenes = front.scenes(sample.point.y)
        point = certify(front, sample, signs)
        (doubtful if point.doubt else found).append((sample, point))
    for sample, point in doubtful:
        # One that a certified design is as good as leaves no place without one.
        if not any(np.all(other.at <= sample.at + MATTERS) for other, _ in found):
            failures.append(Failure(point.objectives, point.doubt))
    return _with_medians(front, tracer, found, signs), failures


def _with_medians(
    front: FrontProgram, tracer: Samples, found: list[tuple[Sample, FrontPoint]], signs: Array
) -> list[tuple[Sample, FrontPoint]]:
    """Return points with what becomes of them within their tolerances."""
    y = np.array([sample.point.y for sample, _ in found]).reshape(len(found), -1)
    medians = tracer.cloud.medians(y)
    if medians is None:
        return found
    scaled = np.array([point.objectives for _, point in found]).reshape(len(found), -1) * signs / front.scales
    needles = tracer.cloud.needles(y, scaled)
    own = medians * np.array(front.scales) * signs
    return [
        (sample, replace(point, medians=tuple(row.tolist()), needle=bool(needle)))
        for (sample, point), row, needle in zip(found, own, needles, strict=True)
    ]


def _caveats(front: FrontProgram, samples: Sequence[Sample]) -> tuple[str, ...]:
    still = [front.still_scenes(sample.point.y) for sample in samples]
    return caveats([sample.scenes for sample in samples], still)


def _curve(at: Array, extra: Sequence[bool], step: float) -> Order:
    """Return the order of the points between two objectives.

    Args:
        at: their normalised objectives.
        extra: whether a point lies between positions.
        step: between positions.
    """
    order = efficient(at)
    own = order[needed(at[order], [extra[k] for k in order], step)]
    kept = own[spread(at[own], step)]
    breaks = gaps(at[kept], step)
    bounds = [0, *(k + 1 for k in breaks), len(kept)]
    return Order(
        frozenset(order.tolist()),
        tuple(kept.tolist()),
        tuple(tuple(range(i, j)) for i, j in pairwise(bounds)),
        tuple((k, k + 1) for k in breaks),
    )


def _surface(at: Array, willing: Sequence[bool], step: float) -> Order:
    """Return the order of the points between three objectives, from the best in the first one on.

    Args:
        at: their normalised objectives.
        willing: whether no objective of a point would rather be worse.
        step: between positions.
    """
    own = np.flatnonzero(willing)
    order = own[undominated(at[own])]
    parts, ends = parts_of(at[order], step)
    anchors = np.argmin(at[order] @ IN_TURN.T, axis=0)
    rank = lattice(at[order], round(1.0 / step))
    apart = anchors[uncrowded(at[order[anchors]], _LAST, _ROOM * step)]
    rank[[*apart, *(row for pair in ends for row in pair)]] = 0
    kept = covering(at[order], uncrowded(at[order], rank, _ROOM * step), _COVERED * step)
    kept = kept[np.lexsort(at[order[kept]].T[::-1])]
    number = {int(row): k for k, row in enumerate(kept)}
    return Order(
        frozenset(order.tolist()),
        tuple(order[kept].tolist()),
        tuple(tuple(sorted(number[row] for row in part if row in number)) for part in parts),
        tuple((number[a], number[b]) for a, b in ends),
    )


def hole(before: FrontPoint, after: FrontPoint, failures: Sequence[Failure], signs: Array) -> Hole:
    """Return a hole; it is not settled where the optimiser failed within."""
    ends = np.array([before.objectives, after.objectives]) * signs
    low, high = ends.min(axis=0), ends.max(axis=0)
    # Failures are told by the optimiser's integration, ends by the tight one.
    low, high = low - _EDGE * (high - low), high + _EDGE * (high - low)
    within = [
        failure
        for failure in failures
        if np.all(low <= failure.objectives * signs)
        and np.all(failure.objectives * signs <= high)
        and not failure.reason.startswith("Infeasible_Problem_Detected")
    ]
    return Hole(before.objectives, after.objectives, settled=not within)
