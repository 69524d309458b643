"""From candidates to a front: certified, put in order, with its parts, holes and sentences."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.core.kept import Origin
from plough_opt.studies.tradeoff.candidates import MATTERS, Candidate, Failure
from plough_opt.studies.tradeoff.certificate import FrontPoint, certify
from plough_opt.studies.tradeoff.domination import Array
from plough_opt.studies.tradeoff.front import Hole
from plough_opt.studies.tradeoff.goal import Axis, Goal
from plough_opt.studies.tradeoff.notes import caveats, looked_at, notes_on
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.tracer import Tracer

# Of a hole's size: nearer to its ends is at them.
_EDGE = 1e-3
# Normalised objectives that differ by less are equal.
_SAME = 1e-4


@dataclass(frozen=True)
class Times:
    """When a front was begun, and how long its program took to build [s]."""

    started: float
    building: float


def assembled(front: FrontProgram, tracer: Tracer, goals: Sequence[Goal], title: str, times: Times) -> TradeOff:
    """Certify what was found, and return the efficient points in order with their parts and holes.

    Raises:
        NotConverged: no point could be certified.
    """
    certified = _Certified(front, tracer)
    order, failures = certified.order, certified.failures()
    if not certified.kept:
        raise NotConverged(f"no point of the front could be certified: {failures[-1].reason}", "Not_Certified")
    points, others = certified.points(certified.kept), certified.points(certified.others())
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
        holes=tuple(hole(points[a], points[b], failures, front.signs) for a, b in order.holes),
        notes=(*notes_on(tracer, goals, points), *caveats(front, [one.point.y for one in certified.kept])),
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
    """The candidates that make up a front, with their certificates.

    Of the many that no other dominates, only those are certified that the front shows; where that casts doubt on one,
    another takes its place. Where all candidates are needles, they are shown as such.

    Attributes:
        order: how the candidates without a doubt make up the front.
        kept: those of the front, in order.
    """

    def __init__(self, front: FrontProgram, tracer: Tracer) -> None:
        """Certify the candidates that make up the front."""
        self._front, self._tracer = front, tracer
        self._points: dict[int, FrontPoint] = {}
        self._left = tracer.sound() or tracer.found
        while True:
            self.order = tracer.order(self._left)
            self.kept = [self._left[k] for k in self.order.kept]
            if not (fresh := [one for one in self.kept if id(one) not in self._points]):
                break
            tracer.to_the_last_digits(fresh)
            self._points |= {id(one): certify(front, one) for one in fresh}
            self._left = [one for one in self._left if not self._doubt(one)]

    def _doubt(self, one: Candidate) -> str:
        """Return what casts doubt on a candidate, as far as that was asked."""
        return self._points[id(one)].doubt if id(one) in self._points else ""

    def others(self) -> list[Candidate]:
        """Return the needles, and the candidates that others dominate, as far as they can be certified."""
        shown = {id(self._left[k]) for k in self.order.efficient}
        found = [one for one in self._tracer.found if id(one) not in shown]
        fresh = [one for one in found if id(one) not in self._points]
        self._points |= {id(one): certify(self._front, one, beaten=True) for one in fresh}
        return [one for one in found if not self._doubt(one)]

    def points(self, candidates: Sequence[Candidate]) -> tuple[FrontPoint, ...]:
        """Return the certificates of candidates, with what becomes of them within their tolerances."""
        found = [self._points[id(one)] for one in candidates]
        medians = self._tracer.archive.medians(np.array([one.point.y for one in candidates])) if candidates else None
        if medians is None:
            return tuple(found)
        return tuple(
            replace(point, medians=tuple((row * self._front.units).tolist()), needle=bool(one.needle))
            for one, point, row in zip(candidates, found, medians, strict=True)
        )

    def failures(self) -> tuple[Failure, ...]:
        """Return what failed, in the objectives' own units; beside a design that another beats nothing is missing."""
        front, found = self._front, list[Failure]()
        places = self._tracer.places(self._tracer.found)
        for failure in self._tracer.failures:
            at = np.array(failure.objectives)
            if not np.any(np.all(places <= at + _SAME, axis=1) & np.any(places < at - MATTERS, axis=1)):
                found.append(replace(failure, objectives=tuple((front.scaled(at) * front.units).tolist())))
        for one in self._tracer.found:
            # One that a certified design is as good as leaves no place without one.
            if self._doubt(one) and not any(np.all(other.at <= one.at + MATTERS) for other in self.kept):
                found.append(Failure(self._points[id(one)].objectives, self._doubt(one)))
        return tuple(found)


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
