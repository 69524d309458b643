"""From candidates to a front: certified, put in order, with its parts, holes and sentences."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from plough_opt.core.errors import NotConverged
from plough_opt.core.saving import Origin
from plough_opt.design.ipopt import Vector
from plough_opt.design.optimality import PULLS, decides
from plough_opt.motion.judgement import remarks
from plough_opt.studies.tradeoff.candidates import MATTERS, Candidate
from plough_opt.studies.tradeoff.domination import Array
from plough_opt.studies.tradeoff.front import Axis, Failure, FrontPoint, Goal, Hole
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.tracer import Tracer

# Of a hole's size: nearer to its ends is at them.
_EDGE = 1e-3
# Normalised objectives that differ by less are equal.
_SAME = 1e-4
# Relative ranges of all objectives below this are hardly a conflict, of one of them below the second too small to act
# on; below the third they are rounding.
_HARDLY, _SMALL, _ROUNDING = 0.02, 1e-3, 1e-8
_NUMBER = re.compile(r"[-+]?[0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?")


def assembled(tracer: Tracer, goals: Sequence[Goal], title: str) -> TradeOff:
    """Certify what was found, and return the efficient points in order with their parts and holes.

    Of the many that no other dominates, only those are certified that the front shows; where that casts doubt on one,
    another takes its place. Where all candidates are needles, they are shown as such.

    Raises:
        NotConverged: no point could be certified.
    """
    front, certified = tracer.front, dict[Candidate, FrontPoint]()
    left = tracer.sound() or tracer.found
    while True:
        order = tracer.order(left)
        if not (fresh := [one for one in order.kept if one not in certified]):
            break
        tracer.to_the_last_digits(fresh)
        certified |= {one: certify(front, one) for one in fresh}
        left = [one for one in left if one not in certified or not certified[one].doubt]
    failures = _failures(tracer, order.kept, certified)
    if not order.kept:
        raise NotConverged(f"no point of the front could be certified: {failures[-1].reason}", "Not_Certified")
    others = [one for one in tracer.found if one not in set(order.efficient)]
    certified |= {one: certify(front, one, beaten=True) for one in others if one not in certified}
    points = _with_medians(tracer, order.kept, certified)
    beaten = _with_medians(tracer, [one for one in others if not certified[one].doubt], certified)
    variables = front.program.declared.variables
    return TradeOff(
        title=title,
        goals=tuple(Axis(goal.name, goal.unit, goal.maximise) for goal in goals),
        variables=tuple(Axis(v.name, v.unit, log=v.log, lower=v.lower, upper=v.upper) for v in variables),
        points=points,
        dominated=tuple(point for point in beaten if not point.needle),
        needles=tuple(point for point in beaten if point.needle),
        failures=failures,
        parts=order.parts,
        holes=tuple(hole(points[a], points[b], failures, front.signs) for a, b in order.holes),
        notes=(*notes_on(tracer, goals, points), *caveats(front, [one.point.y for one in order.kept])),
        search=looked_at(tracer),
        origin=_origin(front, goals, title),
    )


def _with_medians(
    tracer: Tracer, candidates: Sequence[Candidate], certified: Mapping[Candidate, FrontPoint]
) -> tuple[FrontPoint, ...]:
    """Return the certificates of candidates, with what becomes of them within their tolerances."""
    medians = tracer.archive.medians(np.array([one.point.y for one in candidates])) if candidates else None
    if medians is None:
        return tuple(certified[one] for one in candidates)
    return tuple(
        replace(certified[one], medians=tuple((row * tracer.front.units).tolist()), needle=bool(one.needle))
        for one, row in zip(candidates, medians, strict=True)
    )


def _failures(
    tracer: Tracer, kept: Sequence[Candidate], certified: Mapping[Candidate, FrontPoint]
) -> tuple[Failure, ...]:
    """Return what failed, in the objectives' own units; beside a design that another beats nothing is missing."""
    front, found = tracer.front, list[Failure]()
    places = tracer.places(tracer.found)
    for failure in tracer.failures:
        at = np.array(failure.objectives)
        if not np.any(np.all(places <= at + _SAME, axis=1) & np.any(places < at - MATTERS, axis=1)):
            found.append(replace(failure, objectives=tuple((front.scaled(at) * front.units).tolist())))
    for one, point in certified.items():
        # One that a certified design is as good as leaves no place without one.
        if point.doubt and not any(np.all(other.at <= one.at + MATTERS) for other in kept):
            found.append(Failure(point.objectives, point.doubt))
    return tuple(found)


def _origin(front: FrontProgram, goals: Sequence[Goal], title: str) -> Origin:
    """Return what made a front: the design's declarations, and the objectives in the place of its own."""
    displays = {v.name: v.display for v in front.declared.variables if v.display is not None}
    found = front.declared.plain(front.own_values())
    del found["objective"]
    for goal in goals:
        aim = "maximise" if goal.maximise else "minimise"
        found[goal.name] = {"kind": "objective", "aim": aim, "unit": goal.unit}
    return Origin.now(title, displays, declarations=found)


def hole(before: FrontPoint, after: FrontPoint, failures: Sequence[Failure], signs: Array) -> Hole:
    """Return a hole; it is not settled where the optimiser failed within."""
    ends = np.array([before.objectives, after.objectives]) * signs
    low, high = ends.min(axis=0), ends.max(axis=0)
    # Failures are found by the optimiser's integration, ends by the tight one.
    low, high = low - _EDGE * (high - low), high + _EDGE * (high - low)
    failed = [failure for failure in failures if not failure.reason.startswith("Infeasible_Problem_Detected")]
    places = np.array([failure.objectives for failure in failed]).reshape(-1, len(signs)) * signs
    within = np.all((low <= places) & (places <= high), axis=1)
    return Hole(before.objectives, after.objectives, settled=not np.any(within))


# --- certificates ---------------------------------------------------------------------------------------------


def certify(front: FrontProgram, one: Candidate, *, beaten: bool = False) -> FrontPoint:
    """Return a candidate's report from the tightly integrated model.

    Args:
        front: the program.
        one: the candidate.
        beaten: whether it is not on the front, so that its curvature and branch are left out.
    """
    program, point, level = front.program, one.point, front.levels[one.exact]
    scaled, found = front.tight(point.y)
    margins, violation, active = {}, 0.0, []
    for k, (r, value) in enumerate(zip(front.declared.requirements, found, strict=False)):
        margin = r.margin(value.ravel())
        pull = float(np.max(np.abs(point.lam_g[np.array(program.owner) == k])))
        margins[r.name] = margin
        violation = max(violation, -margin / program.scales[k])
        if decides(margin / program.scales[k], pull):
            active.append(r.name)
    for v, y, multiplier in zip(program.declared.variables, point.y, point.lam_y, strict=True):
        if decides(float(min(y, 1.0 - y)), float(abs(multiplier))):
            active.append(v.name)
    weights = _weights(front, one)
    waved = [] if beaten else [run.scene.branch for run in front.runs(point.y) if run.scene.effects.strength_wave]
    return FrontPoint(
        objectives=tuple((scaled * front.units).tolist()),
        variables={v.name: float(x) for v, x in zip(program.declared.variables, program.values(point.y), strict=True)},
        margins=margins,
        active=tuple(active),
        rate=-weights[0] / weights[1] if weights is not None and front.count == 2 else None,
        branch=next(filter(None, waved), ""),
        residual=level.residual(point, one.p),
        violation=violation,
        gap=front.gap(point.y, exact=one.exact),
        curvature=None if beaten or not one.confirmed else level.least_curvature(point, one.p),
        weights=weights,
        confirmed=one.confirmed,
    )


def _weights(front: FrontProgram, one: Candidate) -> tuple[float, ...] | None:
    """Return how much each objective weighs per its unit, those on a range of the front together 1."""
    point, p = one.inward or (one.point, one.p)
    own = front.slopes(point, p) * front.span
    # Where positions do not decide, the weights are those of the question.
    if not front.holds(point) or np.any(own < -PULLS) or not own[-1] > PULLS:
        return None
    return tuple((own / np.sum(own) / (front.span * front.units)).tolist())


# --- sentences ------------------------------------------------------------------------------------------------


def notes_on(tracer: Tracer, goals: Sequence[Goal], points: Sequence[FrontPoint]) -> tuple[str, ...]:
    """Return sentences on objectives that hardly conflict, needles, points that are not optima, and the error."""
    front = tracer.front
    notes = []
    names = [f"'{goal.name}'" for goal in goals]
    listed = _listed(names)
    values = np.array([point.objectives for point in points])
    ranges = np.ptp(values, axis=0) / np.maximum(np.max(np.abs(values), axis=0), np.finfo(float).tiny)
    small = [k for k, change in enumerate(ranges) if change < _SMALL]
    if len(points) == 1:
        best = "both" if len(goals) == 2 else "all three"
        given_up = front.rounded_off
        within = f", to within {100.0 * given_up:.2g} %" if given_up > _ROUNDING else ""
        where = "" if tracer.archive.vary else " in the basin of the guess"
        notes.append(f"{listed} do not conflict{where}: one design is best in {best}{within}")
    elif np.max(ranges) < _HARDLY:
        how = _listed([f"{100 * change:.2g} %" for change in ranges])
        notes.append(f"{listed} hardly conflict: along the whole front they change by {how}")
    elif small:
        for k in small:
            notes.append(
                f"{names[k]} hardly conflicts with the rest: along the whole front it changes by"
                f" {100 * ranges[k]:.2g} % of its value"
            )
    if tracer.archive.needles_beyond:
        notes.append(
            f"{tracer.archive.needles_beyond} designs beyond the front were seen that are needles: within their"
            " tolerances no workshop can hit them"
        )
    if any(point.needle for point in points):
        count = sum(point.needle for point in points)
        notes.append(f"{count} of {len(points)} designs are needles: within their tolerances no workshop can hit them")
    if unconfirmed := sum(not point.confirmed for point in points):
        notes.append(
            f"{unconfirmed} of {len(points)} designs are unconfirmed: simulated, and better than every optimum that"
            " was found and can be made, but not optima themselves"
        )
    wanted, gap = front.program.wanted_error, max((point.gap for point in points if point.confirmed), default=0.0)
    if wanted is not None and gap > wanted:
        notes.append(f"the wanted relative error {wanted:.1e} was not reached everywhere: the largest is {gap:.1e}")
    return tuple(notes)


def looked_at(tracer: Tracer) -> str:
    """Return what was looked at."""
    archive, vary = tracer.archive, tracer.archive.vary
    if not vary:
        return "Only the basin of the guess was looked at: other branches, and better ends, may be missing."
    over = ", ".join(archive.front.program.declared.variables[k].name for k in vary)
    slow = "" if archive.vectorised else ", few because their runs are integrated one by one"
    return f"{archive.tried} designs tried over {over}{slow}."


def caveats(front: FrontProgram, designs: Sequence[Vector]) -> tuple[str, ...]:
    """Return the warnings that designs' scenes and runs carry, each kind once with the first design's numbers.

    Args:
        front: the program.
        designs: the efficient ones, in order, as scaled variables.
    """
    first, often = dict[str, str](), Counter[str]()
    for y in designs:
        texts = [text for run in front.runs(y) for text in (*run.scene.warnings(), *remarks(run))]
        texts += [text for scene in front.still_scenes(y) for text in scene.warnings()]
        kinds = {_NUMBER.sub("", text): text for text in texts}
        first = kinds | first
        often.update(kinds.keys())
    return tuple(f"at {often[kind]} of {len(designs)} designs: {text}" for kind, text in first.items())


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}"
