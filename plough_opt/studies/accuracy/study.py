"""`study_accuracy` and `study_design`: what accuracy costs in time, and what to choose.

The reference of an optimum is not a contestant. It starts from the best design that any search found; IPOPT, with four
times the steps, stops a little inside the active limits, and from there Newton's method leads onto them, with gradients
by an integrator that the searches do not use.
"""

import contextlib
import copy
import math
import platform
import time
import timeit
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from statistics import median
from typing import Final, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import (
    NOT_NUMBERS,
    check_callable,
    check_domain,
    check_kind,
    check_switch,
    check_text,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.compiler import interpretation_warning
from plough_opt.core.errors import InfeasibleDesign, InputError, NotConverged, PloughError
from plough_opt.core.expressions import Expression, as_number, holds_casadi, map_expressions
from plough_opt.core.plain_data import Array
from plough_opt.core.process import available, without_notices
from plough_opt.core.saving import versions
from plough_opt.design import Design, Optimum, Progress
from plough_opt.design.declarations import Declarations
from plough_opt.design.model.ipopt import Point, SolveOptions
from plough_opt.design.model.nlp import averages_only, split
from plough_opt.design.model.optimality import decides, newton_step, symmetric
from plough_opt.design.model.program import Program
from plough_opt.design.search.effort import Search
from plough_opt.design.search.explore import notifier
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.scene import Scene, duration_of
from plough_opt.motion.solvers.integrators import integration
from plough_opt.motion.solvers.plan import MOST_ADAPTIVE, MOST_OUTPUTS, phase, steps_for
from plough_opt.motion.solvers.steps import Timeline
from plough_opt.studies.accuracy.methods import Task, gradients, integrators, models, periodic_orbit_of
from plough_opt.studies.accuracy.reference import HAS_EXTENDED, Reference, reference_gradient, reference_run
from plough_opt.studies.accuracy.result import (
    AUTO,
    DERIVATIVES,
    LASTING,
    MOTION,
    OPTIMUM,
    SEARCH,
    VARIABLES,
    AccuracyStudy,
    MethodResult,
    Thoroughness,
)

DEFAULT: Final = ("interpreted", "auto")
"""Method and setting of `Design.solve` without arguments."""

# Efforts of the searches, from the basin of the guess to four times the default.
_EFFORTS: Final[tuple[Search, ...]] = ("near", 250, 1000, "auto", "thorough")
# Number of seeds for each effort, and in a thin study.
_SEEDS, _THIN_SEEDS = 8, 3
# Objectives or medians with a smaller relative difference belong to the same optimum: medians come from rough runs.
_SAME_RANK = 1e-5
# Factor on the number of steps of a solve for the reference. With order 8 the error is smaller by 4^8.
_FINER = 4.0
# Gradients of the reference: tolerance of the adaptive method; for a periodic orbit phase in a step of order 8 [rad].
_TIGHT_TOLERANCE = 1e-12
_TIGHT_PHASE = 0.1
_MOST_NEWTON_STEPS = 6
# Newton's steps stop farther than this from where IPOPT stopped, in scaled variables: they lead to another point.
_FAR = 1e-4
# Newton's steps diverge if one is longer than the shortest before it by this factor.
_DIVERGES = 1e3
# Least size that errors of the objective are relative to, in units of its scale.
_LEAST_OBJECTIVE = 1e-12
# Singular values below this part of the largest belong to directions in which the optimum is not unique.
_FLAT = 1e-10


# --- searches ---


@dataclass(frozen=True)
class SearchTrial:
    """Searches of one effort with several seeds.

    Attributes:
        method: "interpreted" or "compiled".
        search: effort as an argument of `Design.solve`.
        optima: optimum that each seed led to, or None.
        seconds: median time of a search [s].
        setup: time to build the program of this effort once, with that of a compiler [s].
    """

    method: str
    search: Search
    optima: tuple[Optimum | None, ...]
    seconds: float
    setup: float

    @property
    def setting(self) -> str:
        """The effort as text."""
        return f"{self.search} designs" if isinstance(self.search, int) else str(self.search)

    @property
    def found(self) -> list[Optimum]:
        """The optima."""
        return [optimum for optimum in self.optima if optimum is not None]

    def entry(self, reference: "OptimumReference") -> MethodResult:
        """Return the entry of the effort, with the largest error of any seed."""
        errors = [reference.errors(optimum) for optimum in self.found]
        if not errors:
            return MethodResult(SEARCH, self.method, self.setting, np.inf, failure="no seed led to an optimum")
        largest = {name: max(of_seed[name] for of_seed in errors) for name in errors[0]}
        return MethodResult(SEARCH, self.method, self.setting, self.seconds, self.setup, largest)

    def thoroughness(self, best: Optimum) -> Thoroughness:
        """Return how often the effort finds the best optimum.

        A search is right if it finds the best optimum that any of the searches found, since no other truth is known.
        """
        least = ranked_value(best)
        right = sum(ranked_value(optimum) <= least + _SAME_RANK * abs(least) for optimum in self.found)
        designs = int(median([optimum.search.designs for optimum in self.found if optimum.search] or [0]))
        return Thoroughness(self.setting, designs, len(self.optima), right, self.seconds)


def search_trials(design: Design, *, limit: float, thin: bool, progress: Progress) -> list[SearchTrial]:
    """Return the searches of all efforts, interpreted and, if that is possible, compiled.

    Args:
        design: design with an objective.
        limit: time of one search [s] above which an effort is tried with one seed only, and larger ones not at all.
        thin: whether to take fewer seeds.
        progress: called with what is being done and the fraction done.

    Raises:
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser stopped without an optimum.
    """
    trials = list[SearchTrial]()
    # The first solve of a process also imports libraries. The copies have programs of their own, so that the design's
    # stays as it is.
    progress("building the program", 0.0)
    copy.copy(design).solve(search="near")
    for part, method in enumerate(("interpreted", "compiled")):
        copied, compiled = copy.copy(design), method == "compiled"
        for number, search in enumerate(_EFFORTS):
            progress(f"searching, {method}: {search}", (part + number / len(_EFFORTS)) / 2.0)
            first, built = _solved(copied, search, 0, compiled=compiled)
            if first is not None and interpretation_warning() in first.warnings:
                return trials
            # Repeated, it finds its program built, and translated by the compiler.
            runs = [_solved(copied, search, 0, compiled=compiled)]
            seconds = runs[0][1]
            seeds = 1 if search == "near" or seconds > limit else _THIN_SEEDS if thin else _SEEDS
            runs += [_solved(copied, search, seed, compiled=compiled) for seed in range(1, seeds)]
            optima, times = zip(*runs, strict=True)
            trials.append(SearchTrial(method, search, optima, median(times), max(built - seconds, 0.0)))
            if seconds > limit:
                break
    return trials


def _solved(design: Design, search: Search, seed: int, *, compiled: bool) -> tuple[Optimum | None, float]:
    """Return the optimum that a search finds, or None, and its time [s]."""
    began, best = time.perf_counter(), None
    with contextlib.suppress(InfeasibleDesign, NotConverged):
        best = design.solve(search=search, seed=seed, compiled=compiled)
    return best, time.perf_counter() - began


def ranked_value(best: Optimum) -> float:
    """Return the value by which `Design.solve` ranks optima: the median over tolerances, or else the objective."""
    return best.objective if best.spread is None else best.spread.median


# --- the reference ---


@dataclass(frozen=True)
class OptimumReference:
    """Local optimum known much more accurately than by any search.

    Attributes:
        declared: the design's declarations.
        variables: name -> value, SI units.
        objective: objective by a tight integration.
        size: what errors of the objective are relative to.
        floor: relative error of the objective, below which searches do not differ [-].
        y: scaled variables.
        off: error of the scaled variables: the next of Newton's steps, at least the rounding of a double [-].
    """

    declared: Declarations
    variables: Mapping[str, float]
    objective: float
    size: float
    floor: float
    y: Array
    off: float

    def errors(self, optimum: Optimum) -> dict[str, float]:
        """Return the relative error of an optimum's objective, and the largest error of its scaled variables [-]."""
        off = np.abs(_scaled(self.declared, optimum.variables) - self.y)
        return {"objective": abs(optimum.objective - self.objective) / self.size, "variables": float(np.max(off))}


def reference_optimum(declared: Declarations, best: Optimum) -> OptimumReference:
    """Return the accurate optimum near the best one that was found.

    Args:
        declared: the design's declarations; its parameters have their declared values.
        best: the best optimum found.

    Raises:
        InputError: the objective is over the tolerance box.
        NotConverged: IPOPT loses the optimum when the steps are refined.
    """
    if best.over:
        raise InputError(f"{best.over}, whose optimum is not known more accurately")
    p = declared.parameter_values({})
    program = Program.of(declared).with_steps(p, _FINER)
    point = program.solve(_scaled(declared, best.variables), p, SolveOptions(near=True))
    if not point.solved:
        raise NotConverged("the reference was lost when the steps were refined: tighten the bounds", point.status)
    y, residual, off = _polished(program, p, point)
    objective, check = (float(values[0].item()) for values in program.exact_values(y, p))
    size = max(abs(objective), program.objective_scale * _LEAST_OBJECTIVE)
    # The error of an objective at its optimum is the residual times the error of the variables.
    rounding = float(np.finfo(float).eps)
    floor = max(abs(objective - check) / size, residual * max(off, residual), rounding)
    variables = {v.name: float(x) for v, x in zip(declared.variables, program.values(y), strict=True)}
    return OptimumReference(declared, variables, objective, size, floor, y, max(off, rounding))


def _scaled(declared: Declarations, values: Mapping[str, float]) -> Array:
    return np.array([v.scaled(values[v.name]) for v in declared.variables])


def _polished(program: Program, p: Array, point: Point) -> tuple[Array, float, float]:
    """Return scaled variables on the active limits, the residual of the conditions there, and the next step."""
    y, n = point.y, len(point.y)
    slopes = _tight_slopes(program, p, y)
    g = np.asarray(program.built.nlp.values(y, p)[1]).ravel()
    active, limits = _active_limits(program, point, g)
    hessian = symmetric(np.asarray(program.built.nlp.hess_lag(y, p, 1.0, point.lam_g)))
    best = (y, np.inf, np.inf)
    for _ in range(_MOST_NEWTON_STEPS):
        gradient, g, jacobian = (np.asarray(result) for result in slopes(y))
        rows = np.vstack([jacobian, np.eye(n)])[active]
        margins = np.r_[g.ravel(), y][active] - limits
        move, pulls = newton_step(hessian, gradient.ravel(), rows, margins, _FLAT)
        left = np.r_[gradient.ravel() - rows.T @ pulls, margins]
        residual, step = float(np.max(np.abs(left))), float(np.max(np.abs(move)))
        if step < best[2]:
            best = (y, residual, step)
        y = y + move
        if not step < best[2] * _DIVERGES or np.max(np.abs(y - point.y)) > _FAR:
            break
    return best


def _active_limits(program: Program, point: Point, g: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the numbers of active limits, of requirements and after them of variables, and the limits themselves.

    Multipliers where IPOPT stopped show which limit is active: they are negative at a lower limit.
    """
    low = np.r_[program.low, np.zeros(len(point.y))]
    high = np.r_[program.high, np.ones(len(point.y))]
    pulls = np.r_[point.lam_g, point.lam_y]
    limits = np.asarray(np.where(pulls < 0.0, low, high), dtype=float)
    margins = np.abs(np.r_[g, point.y] - limits)
    chosen = np.flatnonzero(np.vectorize(decides)(margins, np.abs(pulls)) | (low == high))
    return chosen, limits[chosen]


def _tight_slopes(program: Program, p: Array, at: Array) -> ca.Function:
    """Return y -> (gradient of the objective, requirements, their Jacobian), with runs integrated as suits a design."""
    y = ca.MX.sym("y", len(at))
    parts = split(program.scaled(y, ca.MX(ca.DM(p))), [y])
    whole = ca.Function("whole", [y, *parts.results], list(parts.expressions))
    results = []
    for k, (run, result) in enumerate(zip(parts.runs, parts.results, strict=True)):
        spec = run.integration
        accuracy = Accuracy("erk", tolerance=_TIGHT_TOLERANCE)
        if spec.structure.orbit != "transient":
            *values, duration = np.asarray(ca.Function("inputs", [y], [run.inputs])(at)).ravel()
            steps = steps_for(phase(dict(zip(spec.names, values, strict=True)), duration), _TIGHT_PHASE)
            accuracy = Accuracy("dop853", steps=steps)
        outputs = 1 if averages_only(run, whole, 1 + k) else spec.timeline.outputs
        timeline = Timeline(outputs, accuracy.steps or MOST_ADAPTIVE, spec.timeline.kinks)
        used = ca.veccat(*integration(spec.structure, accuracy, timeline).function.call([run.inputs]))
        # Outputs that the design does not use are left out of the integration.
        results.append(ca.vertcat(ca.MX.zeros(result.numel() - used.numel()), used))
    f, g = whole(y, *results)
    return ca.Function("slopes", [y], [ca.gradient(f, y), g, ca.jacobian(g, y)])


OUTPUTS = 40
"""Default number of intervals between output times: few, so that coarse steps can compete."""

ALLOWANCE = 1.0
"""Default time that one use of a method may take [s]."""

_T = TypeVar("_T")


@without_notices()
def study_accuracy(
    scene: Scene,
    duration: float | None = None,
    *,
    wanted: float = 1e-6,
    outputs: int = OUTPUTS,
    allowance: float = ALLOWANCE,
    derivatives: bool = True,
    thin: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error against time of every method and model that can simulate a scene.

    Args:
        scene: scene with numbers.
        duration: simulated time [s]; None for a periodic orbit.
        wanted: relative error that the advice is for [-], from 1e-15 to 0.1.
        outputs: number of equal intervals between output times, at which mount forces are compared.
        allowance: time that one use of a method may take [s]; slower settings are left out, with an entry that says so.
        derivatives: whether to measure derivatives of the averages too.
        thin: whether to leave out every other setting except the finest; the advice stays the same.
        title: title of the scene, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the scene holds symbols, the duration is missing or is given for a periodic orbit, an argument has
            the wrong type, or ``outputs`` is out of range.
        DomainError: the duration, the wanted error or the allowance is out of range.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False).duration
        0.1
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    _check(wanted, title, derivatives=derivatives, thin=thin)
    if holds_casadi(scene):
        scene = map_expressions(scene, lambda value: float(as_number(value)))
    check_domain("time allowed to a method", plain_number("allowance", allowance), "s", above=0.0)
    whole_number("outputs", outputs, 1, MOST_OUTPUTS)
    duration = plain_number("duration", duration_of(scene, duration))
    task = Task(scene, float(duration), int(outputs), float(allowance), thin, wanted)
    entries, floors, notes = _contests(task, notifier(progress), derivatives=derivatives)
    defaults = {MOTION: (AUTO, f"error {DEFAULT_ERROR:.0e}"), DERIVATIVES: (AUTO, "default")}
    return AccuracyStudy(title, duration, wanted, tuple(entries), floors, tuple(notes), defaults, _versions())


@without_notices()
def study_design(
    design: Design,
    *,
    wanted: float = 1e-6,
    limit: float = 10.0,
    thin: bool = False,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error of the optimum against time of searches of growing effort, interpreted and compiled.

    Every effort is an argument of `Design.solve`, with several seeds and the declared values of the parameters. The
    study also reports how often each effort finds the best optimum that any of them finds.

    Args:
        design: design with an objective.
        wanted: relative error of objective and variables that the advice is for [-], from 1e-15 to 0.1.
        limit: time of one search [s] above which an effort is tried with one seed only, and larger ones not at all.
        thin: whether to take fewer seeds.
        title: title of the design, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the design has no objective or no variables.
        DomainError: an argument is outside its range.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser stopped without an optimum.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> study = po.study_design(design, thin=True)  # doctest: +SKIP
    """
    check_kind("the design", design, Design, "a Design")
    _check(wanted, title, thin=thin)
    check_domain("time allowed to a search", plain_number("limit", limit), "s", above=0.0)
    trials = search_trials(design, limit=limit, thin=thin, progress=notifier(progress))
    best = min((optimum for trial in trials for optimum in trial.found), key=ranked_value)
    entries, floors, notes = list[MethodResult](), dict[str, float](), list[str]()
    try:
        reference = reference_optimum(design.declared, best)
        # More effort does not always take longer; the advice takes entries of a method from the cheapest on.
        entries = sorted((trial.entry(reference) for trial in trials), key=lambda entry: entry.seconds)
        floors = {OPTIMUM: reference.floor, VARIABLES: reference.off}
    except PloughError as error:
        notes.append(f"no reference for the optimum: {error}")
    if all(trial.method != "compiled" for trial in trials):
        entries.append(MethodResult(SEARCH, "compiled", "", math.inf, failure=interpretation_warning()))
    efforts = tuple(trial.thoroughness(best) for trial in trials if trial.method == DEFAULT[0])
    defaults = dict.fromkeys(floors, DEFAULT)
    return AccuracyStudy(title, None, wanted, tuple(entries), floors, tuple(notes), defaults, _versions(), efforts)


def _contests(
    task: Task, progress: Progress, *, derivatives: bool
) -> tuple[list[MethodResult], dict[str, float], list[str]]:
    """Return the entries of all contests for a scene; by name of the reference its error; and notes.

    Notes say what has no reference.
    """
    scene, entries, floors, notes = task.scene, list[MethodResult](), dict[str, float](), list[str]()
    if not scene.effects.motion:
        return [], {}, ["a quasi-static scene has no motion to integrate, and so there is no method to choose"]

    def found(name: str, find: Callable[[], _T]) -> _T | None:
        try:
            return find()
        except PloughError as error:
            notes.append(f"no reference for the {name.replace('lasting', 'periodic')}: {error}")
            return None

    def reference(name: str, of: Scene, duration: float | None) -> Reference | None:
        run = found(name, partial(reference_run, of, duration, outputs=task.outputs))
        if run is not None:
            floors.update({name: run.errors["averages"], f"{name}, trajectory": run.errors["trajectory"]})
        return run

    progress("integrating the reference", 0.0)
    motion, around = reference(MOTION, scene, task.given), periodic_orbit_of(scene)
    transient = scene.effects.orbit == "transient"
    periodic = reference(LASTING, around, None) if transient and around is not None else None
    if motion is not None:
        progress("integrators", 0.1)
        entries += integrators(task, motion)
    if motion is not None or periodic is not None:
        progress("models", 0.5)
        entries += models(task, motion, periodic)
    if derivatives:
        progress("derivatives", 0.7)
        gradient = found(DERIVATIVES, partial(reference_gradient, scene, task.given))
        if gradient is not None:
            floors[DERIVATIVES] = gradient.error
            entries += gradients(task, gradient)
    if not HAS_EXTENDED:
        notes.append("this machine has no floats wider than a double, so the references are not more exact")
    return entries, floors, notes


def _versions() -> dict[str, str]:
    """Return versions of packages, and the machine."""
    machine = {"platform": platform.platform(), "processors": str(available())}
    return {**versions(), "scipy": version("scipy"), **machine}


def _check(wanted: float, title: str, **switches: bool) -> None:
    """Raise InputError or DomainError if an argument has the wrong type or the wanted error is out of range."""
    check_text("title", title)
    for name, value in switches.items():
        check_switch(name, value)
    check_domain("wanted error", plain_number("wanted", wanted), at_least=1e-15, at_most=0.1)


# Evaluations of which the median time is taken.
_REPEATS = 5
# Relative error that is due to rounding, so that further refinement gains nothing.
_LEAST_ERROR = 1e-14


@dataclass(frozen=True)
class Refinement:
    """Error and time of a result at several sizes; prints as a table.

    Attributes:
        sizes: orders, or numbers of knots, ascending.
        errors: largest difference from the result at twice the largest size, relative to that result's largest value.
        seconds: median time of one evaluation, after a warm-up [s].

    Example:
        >>> import plough_opt as po
        >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32])
        >>> found.sizes
        (8, 16, 32)
    """

    sizes: tuple[int, ...]
    errors: NDArray[np.float64]
    seconds: NDArray[np.float64]

    @property
    def cost(self) -> NDArray[np.float64]:
        """Times as multiples of the shortest."""
        return np.asarray(self.seconds / np.min(self.seconds))

    def size_for(self, error: float) -> int:
        """Return the smallest size whose relative error does not exceed the given one.

        Raises:
            InputError: the error is invalid, or not reached at any size.

        Example:
            >>> import plough_opt as po
            >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32, 64])
            >>> found.size_for(0.005)
            16
        """
        error = plain_number("error", error, at_least=0.0)
        if reach := [size for size, own in zip(self.sizes, self.errors, strict=True) if own <= error]:
            return reach[0]
        raise InputError(f"no size up to {self.sizes[-1]} reaches a relative error of {error:g}: try larger sizes")

    def __str__(self) -> str:
        """Return the table, and the size beyond which refinement gains nothing."""
        every = [*zip(self.sizes, self.errors, self.cost, strict=True)]
        rows = [f"{'size':>6} {'relative error':>16} {'time, fastest = 1':>18}"]
        rows += [f"{size:>6} {error:>16.1e} {cost:>18.1f}" for size, error, cost in every]
        if enough := [size for size, error, _ in every if error <= _LEAST_ERROR]:
            rows.append(f"At {enough[0]} only rounding errors remain; larger sizes gain nothing.")
        return "\n".join(rows)


def refine(quantity: Callable[[int], Expression], sizes: Sequence[int]) -> Refinement:
    """Evaluate a result at several sizes, and compare with the result at twice the largest size.

    The size may be, for instance, the order of a density profile's quadrature or the number of knots of a profile::

        refine(lambda order: resistance(cone, soil.with_density_profile(rho, order=order), 2.0, 0.0), [4, 8, 16])
        refine(lambda n: elastic.wedge_stress(0.1, 0.1, elastic.knots(h, 0.5, n), soil, 2.0).yy, [8, 16, 32])

    Args:
        quantity: function of the size that returns a number or an array.
        sizes: sizes to try, at least one, each at least 1.

    Raises:
        InputError: there are no sizes, a size is below 1, or a result is not finite.

    Example:
        >>> import plough_opt as po
        >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32])
        >>> bool(found.errors[0] > found.errors[2])
        True
    """
    check_callable("the quantity", quantity, "of the size")
    check_kind("sizes", sizes, Sequence | np.ndarray, "a list of positive integers")
    tried = tuple(sorted({whole_number("a size", size, 1) for size in sizes}))
    if not tried:
        raise InputError("there are no sizes: give one or more positive integers")
    reference = _value(quantity, 2 * tried[-1])
    largest = float(np.max(np.abs(reference)))
    errors, seconds = [], []
    for size in tried:
        errors.append(float(np.max(np.abs(_value(quantity, size) - reference))) / (largest or 1.0))
        seconds.append(float(np.median(timeit.repeat(partial(quantity, size), number=1, repeat=_REPEATS))))
    return Refinement(tried, np.array(errors), np.array(seconds))


def _value(quantity: Callable[[int], Expression], size: int) -> NDArray[np.float64]:
    result = quantity(size)
    try:
        value = as_number(result)
    except InputError:
        raise
    except NOT_NUMBERS:
        raise InputError(f"the quantity returned {shown(result)} at size {size}, but must return numbers") from None
    if not np.all(np.isfinite(value)):
        raise InputError(f"the result at size {size} is not finite: refine a quantity that is finite at every size")
    return value
