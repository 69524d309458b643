"""Function `trade_off`, which returns the front of two or three objectives of a design."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import is_
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from plough_opt.core.checks import check_callable, check_kind, check_switch, check_text, mapping_of, shown, whole_number
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.expressions import Expression, is_count
from plough_opt.design import Design, Progress
from plough_opt.design.effort import Search
from plough_opt.design.exploring import silent
from plough_opt.design.ipopt import Point
from plough_opt.studies.tradeoff.archive import Archive
from plough_opt.studies.tradeoff.assembly import assembled
from plough_opt.studies.tradeoff.curve import CurveTracer
from plough_opt.studies.tradeoff.front import Goal
from plough_opt.studies.tradeoff.program import FrontProgram, declarations
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.surface import SurfaceTracer
from plough_opt.studies.tradeoff.tracer import Tracer

_FEWEST_POINTS, _MOST_POINTS = 5, 1000
# Most refinements of the integration steps.
_REFINEMENTS = 4
# Relative change of an objective between the anchors below which it is rounding, and the objective conflicts with none.
_NO_CONFLICT = 1e-5
# That change is relative to the objective's size in scaled units, and at least to this.
_LEAST_SIZE = 1e-3
# Least range of an objective where one design is best in all, in units of the objective's size at the guess. An
# objective may be zero there.
_LEAST_RANGE = 0.01
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
    if not is_count(points) or not _FEWEST_POINTS <= points <= _MOST_POINTS:
        raise InputError(f"points = {shown(points)} must be a whole number from {_FEWEST_POINTS} to {_MOST_POINTS}")
    check_kind("the design", design, Design, "a Design")
    check_switch("compiled", compiled)
    check_text("title", title)
    parameters = mapping_of("parameters", parameters, "name -> value")
    if progress is not None:
        check_callable("progress", progress, "of what is being done and the fraction done")
    goals = _goals((first, second, *others))
    notify = progress or silent
    notify("building the model", 0.0)
    front = _built(design, goals, compiled)
    front.prepare(front.declared.parameter_values(parameters))
    building = time.perf_counter() - started
    kind = CurveTracer if len(goals) == 2 else SurfaceTracer
    tracer = kind(Archive(front, search, notify, whole_number("seed", seed)), int(points), notify)
    anchors = _anchors(front, tracer)
    idle = _normalise(front, anchors)
    if len(idle) == 1 and len(goals) == 3:
        conflicting = [goal for k, goal in enumerate(goals) if k not in idle]
        found = trade_off(design, *conflicting, points=points, parameters=parameters, search=search, seed=seed,
                          compiled=compiled, title=title, progress=progress)  # fmt: skip
        note = f"'{goals[idle[0]].name}' does not conflict with the others: it is at its best all along their front"
        return replace(found, notes=(note, *found.notes), seconds=time.perf_counter() - started)
    if idle:
        # One design is best in all. An objective that conflicts with none may not determine it, so take another's.
        number = next((k for k in range(len(anchors)) if k // (len(anchors) // len(goals)) not in idle), 0)
        best = anchors[number][0]
        sizes = np.abs(front.scaled(front.objectives(best.y)))
        front.normalise(np.zeros(len(goals)), np.maximum(sizes, _LEAST_RANGE))
        tracer.recorded(best, tracer.anchor_parameters()[number])
    else:
        tracer.trace(anchors)
        _refine(tracer, front, notify)
        tracer.find_inner_neighbours()
        tracer.add_unconfirmed()
    notify("checking", 0.0)
    found = assembled(tracer, goals, title)
    return replace(found, seconds=time.perf_counter() - started, building=building + front.building)


def _built(design: Design, goals: Sequence[Goal], compiled: bool) -> FrontProgram:
    """Return the program of a design and its objectives, reused if the last one was built from the same parts."""
    declared = declarations(design, goals)
    parts = (*declared.variables, *declared.parameters, *declared.requirements, *(goal.expression for goal in goals))
    flags = (compiled, *((goal.name, goal.maximise) for goal in goals))
    if design in _BUILT:
        known, known_flags, front = _BUILT[design]
        if known_flags == flags and len(known) == len(parts) and all(map(is_, known, parts)):
            return front
    front = FrontProgram(declared, goals, compiled=compiled)
    _BUILT[design] = (parts, flags, front)
    return front


def _anchors(front: FrontProgram, tracer: Tracer) -> list[list[Point]]:
    """Return all local optima of each anchor's subproblem.

    Raises:
        NotConverged: the optimiser finds no optimum of an objective alone.
    """
    found = tracer.all_anchors(tracer.begin())
    for number, points in enumerate(found):
        if not points:
            raise NotConverged(
                f"the optimiser finds no optimum of objective number {1 + number * front.count // len(found)} alone:"
                " check the bounds, or search more thoroughly",
                "no optimum",
            )
    return found


def _normalise(front: FrontProgram, anchors: Sequence[Sequence[Point]]) -> list[int]:
    """Normalise the objectives by the anchors, unless some are equally good at all anchors; return these."""
    ends = np.array([front.scaled(front.objectives(points[0].y)) for points in anchors])
    low, high = ends.min(axis=0), ends.max(axis=0)
    change = (high - low) / np.maximum(_LEAST_SIZE, np.max(np.abs(ends), axis=0))
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
        if wanted is None or all(front.gap(one.point.y) <= wanted for one in chosen if one.exact):
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
        raise InputError(
            f"{len(given)} objectives were given, but a front takes two or three: put the others into requirements"
        )
    goals = [g if isinstance(g, Goal) else Goal(name, g) for g, name in zip(given, _NAMES, strict=False)]
    for k, goal in enumerate(goals):
        if goal.name in [other.name for other in goals[:k]]:
            raise InputError(f"two objectives have the same name '{goal.name}': give each its own")
    return goals
