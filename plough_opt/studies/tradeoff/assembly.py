"""`trade_off`: returns the front of two or three objectives, assembled from certified candidates."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import is_
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from plough_opt.core.checks import check_kind, check_switch, check_text, mapping_of, whole_number
from plough_opt.core.errors import Counted, InputError, NotConverged, count, counted, listed
from plough_opt.core.expressions import Expression
from plough_opt.core.plain_data import Array
from plough_opt.core.saving import Origin
from plough_opt.design import Design, Progress
from plough_opt.design.confirmation import curvatures_at
from plough_opt.design.model.ipopt import Point
from plough_opt.design.model.optimality import Zero
from plough_opt.design.result.reporting import bounds_at, requirements_at
from plough_opt.design.search.effort import Search
from plough_opt.design.search.explore import notifier
from plough_opt.motion.solvers.checks import remarks
from plough_opt.studies.tradeoff.archive import MATTERS, Archive, Tracer
from plough_opt.studies.tradeoff.front import Axis, FrontCandidate, FrontPoint, Goal, Hole, MissingPoint
from plough_opt.studies.tradeoff.program import FrontProgram, declarations
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.tracers import CurveTracer, SurfaceTracer

# A hole is widened by this part of its size, so that a failure at one of its ends counts as inside.
_HOLE_EDGE = 1e-3
# Normalised objectives that differ by less are equal.
_NO_WORSE = 1e-4
# Relative range of all objectives below which they hardly conflict.
_HARDLY = 0.02
# Relative range of one objective below which its conflict is too small to act on.
_WEAK = 1e-3
# Relative range below which it is rounding.
_NOT_IGNORED = 1e-8


def assembled(tracer: Tracer, goals: Sequence[Goal], title: str) -> TradeOff:
    """Return the efficient candidates as a front: certified, in order, with parts and holes.

    Only the candidates that the front shows are certified. If a certificate casts doubt on one, another takes its
    place. If all candidates are needles, the needles are shown.

    Raises:
        NotConverged: no point could be certified.
    """
    front, certified = tracer.front, dict[FrontCandidate, FrontPoint]()
    left = tracer.without_needles() or tracer.candidates
    while True:
        arrangement = tracer.arrange(left)
        if not (fresh := [candidate for candidate in arrangement.shown if candidate not in certified]):
            break
        tracer.solve_exactly(fresh)
        certified |= {candidate: certificate(front, candidate) for candidate in fresh}
        left = [candidate for candidate in left if candidate not in certified or not certified[candidate].doubt]
    shown = arrangement.shown
    failures = _failures(tracer, shown, certified)
    if not shown:
        why = failures[-1].reason if failures else "none of the designs found lies on it"
        raise NotConverged(f"no point of the front could be certified: {why}", "Not_Certified")
    efficient = set(arrangement.efficient)
    others = [candidate for candidate in tracer.candidates if candidate not in efficient]
    fresh = [candidate for candidate in others if candidate not in certified]
    certified |= {candidate: certificate(front, candidate, beaten=True) for candidate in fresh}
    points = _with_medians(tracer, shown, certified)
    beaten = _with_medians(tracer, [candidate for candidate in others if not certified[candidate].doubt], certified)
    variables = front.program.declared.variables
    return TradeOff(
        title=title,
        goals=tuple(Axis(goal.name, goal.unit, goal.maximise) for goal in goals),
        variables=tuple(Axis(v.name, v.unit, log=v.log, lower=v.lower, upper=v.upper) for v in variables),
        points=points,
        dominated=tuple(point for point in beaten if not point.needle),
        needles=tuple(point for point in beaten if point.needle),
        failures=failures,
        parts=arrangement.parts,
        holes=tuple(hole(points[a], points[b], failures, front.signs) for a, b in arrangement.holes),
        notes=(*notes_on(tracer, goals, points), *warnings_of(front, [candidate.point.y for candidate in shown])),
        search=search_in_words(tracer),
        origin=_origin(front, goals, title),
    )


def _with_medians(
    tracer: Tracer, candidates: Sequence[FrontCandidate], certified: Mapping[FrontCandidate, FrontPoint]
) -> tuple[FrontPoint, ...]:
    """Return the certificates of candidates, with the medians of their objectives over the tolerances."""
    medians = tracer.archive.medians(np.array([candidate.point.y for candidate in candidates])) if candidates else None
    points = [certified[candidate] for candidate in candidates]
    if medians is not None:
        needles, rows = (bool(candidate.needle) for candidate in candidates), (medians * tracer.front.units).tolist()
        pairs = zip(points, rows, needles, strict=True)
        points = [replace(point, medians=tuple(row), needle=needle) for point, row, needle in pairs]
    return tuple(points)


def _failures(
    tracer: Tracer, shown: Sequence[FrontCandidate], certified: Mapping[FrontCandidate, FrontPoint]
) -> tuple[MissingPoint, ...]:
    """Return the positions without a design, with objectives in their units.

    Failures next to a design that another beats are left out, since the front misses nothing there. So are doubtful
    candidates that a certified design replaces.
    """
    front, missing = tracer.front, list[MissingPoint]()
    everywhere = tracer.objectives_of(tracer.candidates)
    for failure in tracer.failures:
        objectives = np.array(failure.objectives)
        no_worse = np.all(everywhere <= objectives + _NO_WORSE, axis=1)
        if not np.any(no_worse & np.any(everywhere < objectives - MATTERS, axis=1)):
            missing.append(replace(failure, objectives=tuple((front.scaled(objectives) * front.units).tolist())))
    for candidate, point in certified.items():
        if point.doubt and not any(np.all(other.objectives <= candidate.objectives + MATTERS) for other in shown):
            missing.append(MissingPoint(point.objectives, point.doubt))
    return tuple(missing)


def _origin(front: FrontProgram, goals: Sequence[Goal], title: str) -> Origin:
    """Return the origin of a front: the design's declarations, with the goals in place of the design's objective."""
    displays = {v.name: v.display for v in front.declared.variables if v.display is not None}
    plain = front.declared.plain(front.values)
    declared = {name: entry for name, entry in plain.items() if entry["kind"] != "objective"}
    aims = {goal.name: ("maximise" if goal.maximise else "minimise", goal.unit) for goal in goals}
    declared |= {name: {"kind": "objective", "aim": aim, "unit": unit} for name, (aim, unit) in aims.items()}
    return Origin(title, displays, declarations=declared).now()


def hole(before: FrontPoint, after: FrontPoint, failures: Sequence[MissingPoint], signs: Array) -> Hole:
    """Return the hole between two points, settled unless the optimiser failed inside.

    Args:
        before: where one part ends.
        after: where the next part begins.
        failures: positions without a design; those without a feasible design do not count.
        signs: -1 for each objective that is maximised, else 1.
    """
    ends = np.array([before.objectives, after.objectives]) * signs
    low, high = ends.min(axis=0), ends.max(axis=0)
    # Failures are located by the optimiser's integration, ends by the tight one.
    low, high = low - _HOLE_EDGE * (high - low), high + _HOLE_EDGE * (high - low)
    failed = [failure for failure in failures if not failure.reason.startswith("Infeasible_Problem_Detected")]
    objectives = np.array([failure.objectives for failure in failed]).reshape(-1, len(signs)) * signs
    inside = np.all((low <= objectives) & (objectives <= high), axis=1)
    return Hole(before.objectives, after.objectives, settled=not np.any(inside))


# --- certificates ---------------------------------------------------------------------------------------------


def certificate(front: FrontProgram, candidate: FrontCandidate, *, beaten: bool = False) -> FrontPoint:
    """Return the certificate of a candidate by a tight integration.

    Args:
        front: the program.
        candidate: a candidate.
        beaten: whether it is not on the front; its curvature and branch are left out then.
    """
    program, point, corrector = front.program, candidate.point, front.correctors[candidate.exact]
    scaled, found = front.tight(point.y)
    values = program.values(point.y)
    requirements = requirements_at(program, point, found)[: len(front.declared.requirements)]
    bounds = bounds_at(program, point, values)
    overruns = (-limit.margin / scale for limit, scale in zip(requirements, program.scales, strict=False))
    weights = _weights(front, candidate)
    scenes = [] if beaten else front.scenes(point.y)
    waved = [scene.branch for scene in scenes if scene.effects.strength_wave]
    curvature = None
    if candidate.confirmed and not beaten:
        exact = front.correctors[True].slopes(point.y, candidate.p)
        curvatures, _ = curvatures_at(program, candidate.p, point, (exact.g, exact.jacobian))
        curvature = float(curvatures[0]) if curvatures.size else None
    return FrontPoint(
        objectives=tuple((scaled * front.units).tolist()),
        variables=program.declared.named(values),
        margins={limit.name: limit.margin for limit in requirements},
        active=tuple(limit.name for limit in (*requirements, *bounds) if limit.active),
        rate=-weights[0] / weights[1] if weights is not None and front.count == 2 else None,
        branch=next(filter(None, waved), ""),
        residual=corrector.residual(point, candidate.p),
        violation=max((0.0, *overruns)),
        gap=front.gap(point.y, exact=candidate.exact),
        curvature=curvature,
        weights=weights,
        confirmed=candidate.confirmed,
    )


def _weights(front: FrontProgram, candidate: FrontCandidate) -> tuple[float, ...] | None:
    """Return the weight of each objective per unit at a candidate; in units of the ranges they add up to 1."""
    point, p = candidate.inner_neighbour or (candidate.point, candidate.p)
    weights = front.weights_at(point, p) * front.span
    # If the position constraints are inactive, the weights are merely those with which the subproblem was posed.
    if not front.position_decides(point) or np.any(weights < -Zero.multiplier) or not weights[-1] > Zero.multiplier:
        return None
    return tuple((weights / np.sum(weights) / (front.span * front.units)).tolist())


# --- sentences ------------------------------------------------------------------------------------------------


def notes_on(tracer: Tracer, goals: Sequence[Goal], points: Sequence[FrontPoint]) -> tuple[str, ...]:
    """Return sentences on objectives that hardly conflict, needles, unconfirmed points, and a wanted error missed."""
    needles, unconfirmed = sum(point.needle for point in points), sum(not point.confirmed for point in points)
    wanted = tracer.front.program.wanted_error
    gap = max((point.gap for point in points if point.confirmed), default=0.0)
    notes = {
        f"{tracer.archive.needles_beyond} designs beyond the front were left out: they are needles, which no workshop"
        " can hit within their tolerances": tracer.archive.needles_beyond,
        f"{needles} of {len(points)} designs are needles: no workshop can hit them within their tolerances": needles,
        f"{unconfirmed} of {len(points)} designs are unconfirmed: simulated, and better than every optimum found that"
        " can be made, but not optima themselves": unconfirmed,
        f"the wanted relative error {wanted or 0.0:.1e} was not reached everywhere: the largest is {gap:.1e}":
            wanted is not None and gap > wanted,
    }  # fmt: skip
    return (*_conflict_notes(tracer, goals, points), *(note for note, holds in notes.items() if holds))


def _conflict_notes(tracer: Tracer, goals: Sequence[Goal], points: Sequence[FrontPoint]) -> list[str]:
    """Return sentences on objectives that do not or hardly conflict."""
    names = [f"'{goal.name}'" for goal in goals]
    values = np.array([point.objectives for point in points])
    ranges = np.ptp(values, axis=0) / np.maximum(np.max(np.abs(values), axis=0), np.finfo(float).tiny)
    if len(points) == 1:
        best = "both" if len(goals) == 2 else "all three"
        ignored = tracer.front.ignored_conflict
        within = f", to within {100.0 * ignored:.2g} %" if ignored > _NOT_IGNORED else ""
        where = "" if tracer.archive.vary else " in the basin of the guess"
        return [f"{listed(names)} do not conflict{where}: one design is best in {best}{within}"]
    if np.max(ranges) < _HARDLY:
        how = listed([f"{100 * change:.2g} %" for change in ranges])
        return [f"{listed(names)} hardly conflict: along the whole front they change by {how}"]
    return [
        f"{name} hardly conflicts with the rest: along the whole front it changes by {100 * change:.2g} % of its value"
        for name, change in zip(names, ranges, strict=True)
        if change < _WEAK
    ]


def search_in_words(tracer: Tracer) -> str:
    """Return a sentence on what was searched."""
    archive, vary = tracer.archive, tracer.archive.vary
    if not vary:
        return "Only the basin of the guess was searched: other branches, and better ends, may be missing."
    over = ", ".join(archive.front.program.declared.variables[k].name for k in vary)
    slow = "" if archive.vectorised else ", few because their runs are integrated one by one"
    return f"{archive.tried} designs tried over {over}{slow}."


def warnings_of(front: FrontProgram, designs: Sequence[Array]) -> tuple[str, ...]:
    """Return the warnings of the designs' scenes and runs, each kind once, with the ranges of its numbers.

    Args:
        front: the program.
        designs: the efficient designs, in order, as scaled variables.
    """
    notes: Counted = {}
    for y in designs:
        texts = [text for run in front.runs(y) for text in (*run.scene.warnings(), *remarks(run))]
        texts += [text for scene in front.still_scenes(y) for text in scene.warnings()]
        count(notes, texts)
    return counted(((text, points) for text, _, points in notes.values()), len(designs), "designs")


_FEWEST_POINTS, _MOST_POINTS = 5, 1000
# Most refinements of the integration steps.
_REFINEMENTS = 4
# Relative change of an objective between the anchors below which it is rounding, and the objective conflicts with none.
_NO_CONFLICT = 1e-5
# That change is relative to the objective's size in scaled units, and at least to this.
_LEAST_END = 1e-3
# Least range of an objective where one design is best in all, in units of the objective's size at the guess. An
# objective may be zero there.
_RANGE_OF_ONE = 0.01
_NAMES = ("first objective", "second objective", "third objective")

# For each design the program built last, with the expressions and options that it was built from.
_BUILT: WeakKeyDictionary[Design, tuple[tuple[object, ...], tuple[object, ...], FrontProgram]] = WeakKeyDictionary()


def trade_off(
    design: Design,
    first: Goal | Expression,
    second: Goal | Expression,
    *others: Goal | Expression,
    points: int = 40,
    parameters: Mapping[str, Any] | None = None,
    search: Search = "auto",
    seed: int = 0,
    compiled: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> TradeOff:
    """Return the front of two or three objectives: designs that cannot improve in one without getting worse in another.

    The normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003; Messac and Mattson 2004) starts from the
    optima of each objective alone, the anchors. It spreads positions evenly in the normalised objectives: on a line
    for two, and for three on a lattice that extends beyond the triangle of the anchors to the edges of the surface.
    Unlike a weighted sum it finds the concave parts of a front.

    Anchors and branches come from a sample of all variables, evolution and descents. Then every design tried that is
    better than the front by 0.05 % of the ranges, or than the triangles of a surface by 0.5 %, is followed to an
    optimum, except needles. If there is no optimum near it, the design becomes an unconfirmed point of the front.
    What no search saw stays unknown. For example::

        radius = po.Goal("loosened radius", po.loosened_radius(cone, soil), unit="m", maximise=True)
        front = po.trade_off(d, po.Goal("draft", run.mean_draft, unit="N"), radius)

    Args:
        design: variables, parameters and requirements; its own objective is ignored.
        first: an objective: an expression to minimise, or a `Goal` with a name, a unit and a direction.
        second: another objective.
        others: a third objective, if any.
        points: number of positions, from 5 to 1000. For two objectives it includes the anchors; for three it is the
            least number between them. Parts that end between positions have their ends there in addition.
        parameters: values of parameters that differ from the declared ones, by name. The program is built once for a
            design and its objectives, and reused for further fronts.
        search: as in `Design.solve`: "auto", "thorough", names of variables, a number of designs, or a text such as
            "20 s"; the objectives share it. With "near" the anchors are those to which the guess leads, and parts of
            the front that lie elsewhere stay unknown.
        seed: seed of the samples.
        compiled: as in `Design.solve`.
        title: title of the design question, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: there are more than three objectives, one is not a scalar expression of this design, a parameter is
            unknown, or the design has no variables.
        InfeasibleDesign: no design was found that meets the requirements.
        DomainError: the bounds exceed the model's domain, or a motion is too fast to integrate.
        NotConverged: no design has a value, the optimiser finds no optimum of an objective alone, or no point could be
            certified.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> goals = po.Goal("draft", 5e4 * height**2, "N"), po.Goal("radius", height / 2.0, "m", maximise=True)
        >>> front = po.trade_off(design, *goals, points=5, search="local")
        >>> front.goals[1].maximise
        True
    """
    started = time.perf_counter()
    positions = whole_number("points", points, _FEWEST_POINTS, _MOST_POINTS)
    check_kind("the design", design, Design, "a Design")
    check_switch("compiled", compiled)
    check_text("title", title)
    parameters = mapping_of("parameters", parameters, "name -> value")
    notify, goals = notifier(progress), _goals((first, second, *others))
    notify("building the model", 0.0)
    front = _built(design, goals, compiled)
    front.prepare(front.declared.parameter_values(parameters))
    building = time.perf_counter() - started
    kind = CurveTracer if len(goals) == 2 else SurfaceTracer
    tracer = kind(Archive(front, search, notify, whole_number("seed", seed)), positions)
    anchors = _anchors(front, tracer)
    idle = _normalise(front, anchors)
    if len(idle) == 1 and len(goals) == 3:
        conflicting = [goal for k, goal in enumerate(goals) if k not in idle]
        result = trade_off(design, *conflicting, points=points, parameters=parameters, search=search, seed=seed,
                          compiled=compiled, title=title, progress=progress)  # fmt: skip
        note = f"'{goals[idle[0]].name}' does not conflict with the others: it is at its best all along their front"
        return replace(result, notes=(note, *result.notes), seconds=time.perf_counter() - started)
    if idle:
        # One design is best in all. An objective that conflicts with none may not determine it, so take another's.
        number = next((k for k in range(len(anchors)) if k // (len(anchors) // len(goals)) not in idle), 0)
        best = anchors[number][0]
        sizes = np.abs(front.scaled(front.objectives(best.y)))
        front.normalise(np.zeros(len(goals)), np.maximum(sizes, _RANGE_OF_ONE))
        tracer.recorded(best, tracer.anchor_parameters()[number])
    else:
        tracer.trace(anchors)
        _refine(tracer, front, notify)
        tracer.find_inner_neighbours()
        tracer.add_unconfirmed()
    notify("checking", 0.0)
    result = assembled(tracer, goals, title)
    return replace(result, seconds=time.perf_counter() - started, building=building + front.building)


def _built(design: Design, goals: Sequence[Goal], compiled: bool) -> FrontProgram:
    """Return the program of a design and its objectives, reused if the last one was built from the same parts."""
    declared = declarations(design, goals)
    parts = (*declared.variables, *declared.parameters, *declared.requirements, *(goal.expression for goal in goals))
    flags = (compiled, *((goal.name, goal.maximise) for goal in goals))
    if design in _BUILT:
        parts_before, flags_before, front = _BUILT[design]
        if flags_before == flags and len(parts_before) == len(parts) and all(map(is_, parts_before, parts)):
            return front
    front = FrontProgram(declared, goals, compiled=compiled)
    _BUILT[design] = (parts, flags, front)
    return front


def _anchors(front: FrontProgram, tracer: Tracer) -> list[list[Point]]:
    """Return all local optima of each anchor's subproblem.

    Raises:
        NotConverged: the optimiser finds no optimum of an objective alone.
    """
    anchors = tracer.all_anchors(tracer.begin())
    if [] in anchors:
        number = 1 + anchors.index([]) * front.count // len(anchors)
        why = f"the optimiser finds no optimum of objective number {number} alone"
        raise NotConverged(f"{why}: check the bounds, or search more thoroughly", "no optimum")
    return anchors


def _normalise(front: FrontProgram, anchors: Sequence[Sequence[Point]]) -> list[int]:
    """Normalise the objectives by the anchors, unless some are equally good at all anchors; return these."""
    ends = np.array([front.scaled(front.objectives(points[0].y)) for points in anchors])
    low, high = ends.min(axis=0), ends.max(axis=0)
    change = (high - low) / np.maximum(_LEAST_END, np.max(np.abs(ends), axis=0))
    front.ignored_conflict = float(np.max(change[change < _NO_CONFLICT], initial=0.0))
    idle = [int(k) for k in np.flatnonzero(change < _NO_CONFLICT)]
    if not idle:
        front.normalise(low, high - low)
    return idle


def _refine(tracer: Tracer, front: FrontProgram, notify: Progress) -> None:
    """Solve the points of the front exactly, with as many integration steps as the wanted error takes."""
    for refinement in range(_REFINEMENTS):
        chosen = tracer.arrange(tracer.without_needles()).shown
        tracer.solve_exactly(chosen)
        wanted = front.program.wanted_error
        if wanted is None or all(front.gap(candidate.point.y) <= wanted for candidate in chosen if candidate.exact):
            return
        notify("refining", refinement / _REFINEMENTS)
        front.refine()
        tracer.solve_exactly(tracer.candidates, again=True)


def _goals(given: Sequence[Goal | Expression]) -> list[Goal]:
    """Return the objectives as goals, named by their order if they have no names.

    Raises:
        InputError: there are more than three objectives, or two have the same name.
    """
    if len(given) > len(_NAMES):
        raise InputError(f"{len(given)} objectives were given, not two or three: put the others into requirements")
    goals = [g if isinstance(g, Goal) else Goal(name, g) for g, name in zip(given, _NAMES, strict=False)]
    for k, goal in enumerate(goals):
        if goal.name in [other.name for other in goals[:k]]:
            raise InputError(f"two objectives have the same name '{goal.name}': give each its own")
    return goals
