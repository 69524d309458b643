"""From local optima to a front: certified, put in order, with its parts, holes and sentences."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.core.origin import Origin
from plough_opt.studies.tradeoff.caveats import caveats
from plough_opt.studies.tradeoff.certificate import FrontPoint, certify
from plough_opt.studies.tradeoff.front import Hole
from plough_opt.studies.tradeoff.goal import Axis, Goal
from plough_opt.studies.tradeoff.notes import looked_at, notes_on
from plough_opt.studies.tradeoff.plane import Array
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.samples import MATTERS, Failure, Sample
from plough_opt.studies.tradeoff.surface import SurfaceTracer
from plough_opt.studies.tradeoff.tracing import Tracer

# Of a hole's size: nearer to its ends is at them.
_EDGE = 1e-3
# Normalised objectives that differ by less are equal.
_SAME = 1e-4


@dataclass(frozen=True)
class Times:
    """When a front was begun, and how long its program took to build [s]."""

    started: float
    building: float


def assembled(
    front: FrontProgram, tracer: Tracer | SurfaceTracer, goals: Sequence[Goal], title: str, times: Times
) -> TradeOff:
    """Certify what was found, and return the efficient points in order with their parts and holes.

    Raises:
        NotConverged: no point could be certified.
    """
    signs = np.array([goal.sign for goal in goals])
    certified = _Certified(front, tracer, signs)
    order, samples, failures = certified.order, certified.kept, certified.failures()
    if not samples:
        raise NotConverged(f"no point of the front could be certified: {failures[-1].reason}", "Not_Certified")
    points = certified.points(samples)
    others = certified.points(certified.others())
    variables = front.program.declared.variables
    return TradeOff(
        title=title,
        goals=tuple(Axis(goal.name, goal.unit, goal.maximise) for goal in goals),
        variables=tuple(Axis(v.name, v.unit, log=v.log, lower=v.lower, upper=v.upper) for v in variables),
        points=points,
        dominated=tuple(point for point in others if not point.needle),
        needles=tuple(point for point in others if point.needle),
        failures=failures,
        parts=order.parts,
        holes=tuple(hole(points[a], points[b], failures, signs) for a, b in order.holes),
        notes=(
            *notes_on(tracer, goals, points),
            *_caveats(front, samples),
        ),
        search=looked_at(tracer),
        seconds=time.perf_counter() - times.started,
        building=times.building + front.building,
        origin=_origin(front, goals, title),
    )


def _origin(front: FrontProgram, goals: Sequence[Goal], title: str) -> Origin:
    """Return what made a front: the design's declarations, and the objectives in the place of its own."""
    variables = front.program.declared.variables
    displays = {v.name: v.display for v in variables if v.display is not None}
    declarations = front.program.declared.plain(front.own_values())
    position = front.program.declared.requirements[-1].name  # made for the front
    found = {name: own for name, own in declarations.items() if name not in ("objective", position)}
    for goal in goals:
        aim = "maximise" if goal.maximise else "minimise"
        found[goal.name] = {"kind": "objective", "aim": aim, "unit": goal.unit}
    return Origin.now(title, displays, declarations=found)


class _Certified:
    """The samples that make up a front, with their certificates.

    Of the many that no other dominates, only those are certified that the front shows; where that casts doubt on one,
    another takes its place.

    Attributes:
        order: of `left`, how they make up the front.
        kept: the samples of the front, in order.
    """

    def __init__(self, front: FrontProgram, tracer: Tracer | SurfaceTracer, signs: Array) -> None:
        """Certify the samples that make up the front."""
        self._front, self._tracer, self._signs = front, tracer, signs
        self._points: dict[int, FrontPoint] = {}
        self._doubtful: list[tuple[Sample, FrontPoint]] = []
        self._left = tracer.sound()
        while True:
            self.order = tracer.order(self._left)
            self.kept = [self._left[k] for k in self.order.kept]
            if not (fresh := [sample for sample in self.kept if id(sample) not in self._points]):
                break
            tracer.to_the_last_digits(fresh)
            self._certify(fresh)

    def _certify(self, samples: Sequence[Sample]) -> None:
        """Certify samples, and set those aside that are in doubt."""
        for sample in samples:
            sample.scenes = self._front.scenes(sample.point.y)
            point = certify(self._front, sample, self._signs)
            self._points[id(sample)] = point
            if point.doubt:
                self._doubtful.append((sample, point))
        aside = {id(sample) for sample, _ in self._doubtful}
        self._left = [sample for sample in self._left if id(sample) not in aside]

    def others(self) -> list[Sample]:
        """Return the needles, and the samples that others dominate, as far as they can be certified."""
        shown = {id(self._left[k]) for k in self.order.efficient}
        found = [sample for sample in self._tracer.found if id(sample) not in shown]
        self._certify([sample for sample in found if id(sample) not in self._points])
        return [sample for sample in found if not self._points[id(sample)].doubt]

    def points(self, samples: Sequence[Sample]) -> tuple[FrontPoint, ...]:
        """Return the certificates of samples, with what becomes of them within their tolerances."""
        found = [self._points[id(sample)] for sample in samples]
        medians = self._tracer.cloud.medians(np.array([sample.point.y for sample in samples])) if samples else None
        if medians is None:
            return tuple(found)
        own = medians * np.array(self._front.scales) * self._signs
        return tuple(
            replace(point, medians=tuple(row.tolist()), needle=bool(sample.needle))
            for sample, point, row in zip(samples, found, own, strict=True)
        )

    def failures(self) -> tuple[Failure, ...]:
        """Return what failed, in the objectives' own units; beside a design that another beats nothing is missing."""
        front = self._front
        found = []
        places = np.array([sample.at for sample in self._tracer.found])
        for failure in self._tracer.failures:
            at = np.array(failure.objectives)
            if np.any(np.all(places <= at + _SAME, axis=1) & np.any(places < at - MATTERS, axis=1)):
                continue
            own = front.scaled(at) * front.scales * self._signs
            found.append(replace(failure, objectives=tuple(own.tolist())))
        for sample, point in self._doubtful:
            # One that a certified design is as good as leaves no place without one.
            if not any(np.all(other.at <= sample.at + MATTERS) for other in self.kept):
                found.append(Failure(point.objectives, point.doubt))
        return tuple(found)


def _caveats(front: FrontProgram, samples: Sequence[Sample]) -> tuple[str, ...]:
    still = [front.still_scenes(sample.point.y) for sample in samples]
    return caveats([sample.scenes for sample in samples], still)


def hole(before: FrontPoint, after: FrontPoint, failures: Sequence[Failure], signs: Array) -> Hole:
    """Return a hole; it is not settled where the optimiser failed within."""
    ends = np.array([before.objectives, after.objectives]) * signs
    low, high = ends.min(axis=0), ends.max(axis=0)
    # Failures are found by the optimiser's integration, ends by the tight one.
    low, high = low - _EDGE * (high - low), high + _EDGE * (high - low)
    within = [
        failure
        for failure in failures
        if np.all(low <= failure.objectives * signs)
        and np.all(failure.objectives * signs <= high)
        and not failure.reason.startswith("Infeasible_Problem_Detected")
    ]
    return Hole(before.objectives, after.objectives, settled=not within)
