"""Optimum of a design: what searches of growing effort cost, interpreted and compiled, and the reference they miss.

The reference is not a contestant. It starts from the best design that any search found; IPOPT, with four times the
steps, stops a little inside the active limits, and from there Newton's method leads onto them, with gradients by an
integrator that the searches do not use.
"""

import contextlib
import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import interpretation_warning
from plough_opt.core.errors import InfeasibleDesign, InputError, NotConverged
from plough_opt.design import Design, Optimum, Progress
from plough_opt.design.declarations import Declarations
from plough_opt.design.effort import Search
from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.nlp import averages_only
from plough_opt.design.optimality import decides, newton_step, symmetric
from plough_opt.design.program import Program
from plough_opt.design.split import split
from plough_opt.motion.integrators import integration
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.plan import MOST_ADAPTIVE, phase, steps_for
from plough_opt.motion.steps import Timeline
from plough_opt.studies.accuracy.result import SEARCH, Entry, Thoroughness

DEFAULT: Final = ("interpreted", "auto")
"""Method and setting of `Design.solve` without arguments."""

# Efforts of the searches, from the basin of the guess to four times the default.
_EFFORTS: Final[tuple[Search, ...]] = ("near", 250, 1000, "auto", "thorough")
# Number of seeds for each effort, and in a thin study.
_SEEDS, _THIN_SEEDS = 8, 3
# Objectives or medians with a smaller relative difference belong to the same optimum: medians come from rough runs.
_SAME = 1e-5
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
_LEAST_SIZE = 1e-12
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

    def entry(self, reference: "OptimumReference") -> Entry:
        """Return the entry of the effort, with the largest error of any seed."""
        errors = [reference.errors(optimum) for optimum in self.found]
        if not errors:
            return Entry(SEARCH, self.method, self.setting, np.inf, failure="no seed led to an optimum")
        largest = {name: max(one[name] for one in errors) for name in errors[0]}
        return Entry(SEARCH, self.method, self.setting, self.seconds, self.setup, largest)

    def thoroughness(self, best: Optimum) -> Thoroughness:
        """Return how often the effort finds the best optimum.

        A search is right if it finds the best optimum that any of the searches found, since no other truth is known.
        """
        least = ranked_value(best)
        right = sum(ranked_value(optimum) <= least + _SAME * abs(least) for optimum in self.found)
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
        own, compiled = copy.copy(design), method == "compiled"
        for number, search in enumerate(_EFFORTS):
            progress(f"searching, {method}: {search}", (part + number / len(_EFFORTS)) / 2.0)
            first, built = _solved(own, search, 0, compiled=compiled)
            if first is not None and interpretation_warning() in first.warnings:
                return trials
            # Repeated, it finds its program built, and translated by the compiler.
            runs = [_solved(own, search, 0, compiled=compiled)]
            seconds = runs[0][1]
            seeds = 1 if search == "near" or seconds > limit else _THIN_SEEDS if thin else _SEEDS
            runs += [_solved(own, search, seed, compiled=compiled) for seed in range(1, seeds)]
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
    y: Vector
    off: float

    def errors(self, found: Optimum) -> dict[str, float]:
        """Return the relative error of an optimum's objective, and the largest error of its scaled variables [-]."""
        y = _scaled(self.declared, found.variables)
        return {
            "objective": abs(found.objective - self.objective) / self.size,
            "variables": float(np.max(np.abs(y - self.y))),
        }


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
    size = max(abs(objective), program.objective_scale * _LEAST_SIZE)
    # The error of an objective at its optimum is the residual times the error of the variables.
    rounding = float(np.finfo(float).eps)
    floor = max(abs(objective - check) / size, residual * max(off, residual), rounding)
    named = zip(declared.variables, program.values(y), strict=True)
    variables = {v.name: float(x) for v, x in named}
    return OptimumReference(declared, variables, objective, size, floor, y, max(off, rounding))


def _scaled(declared: Declarations, values: Mapping[str, float]) -> Vector:
    return np.array([v.scaled(values[v.name]) for v in declared.variables])


def _polished(program: Program, p: Vector, point: Point) -> tuple[Vector, float, float]:
    """Return scaled variables on the active limits, the residual of the conditions there, and the next step."""
    y, n = point.y, len(point.y)
    slopes = _tight_slopes(program, p, y)
    g = np.asarray(program.nlp.values(y, p)[1]).ravel()
    active, limits = _active_limits(program, point, g)
    hessian = symmetric(np.asarray(program.nlp.hess_lag(y, p, 1.0, point.lam_g)))
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


def _active_limits(program: Program, point: Point, g: Vector) -> tuple[NDArray[np.intp], Vector]:
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


def _tight_slopes(program: Program, p: Vector, at: Vector) -> ca.Function:
    """Return y -> (gradient of the objective, requirements, their Jacobian), with runs integrated as suits a design."""
    y = ca.MX.sym("y", len(at))
    parts = split(program.scaled(y, ca.MX(ca.DM(p))), [y])
    whole = ca.Function("whole", [y, *parts.results], list(parts.expressions))
    results = []
    for k, (run, result) in enumerate(zip(parts.runs, parts.results, strict=True)):
        own = run.integration
        accuracy = Accuracy("erk", tolerance=_TIGHT_TOLERANCE)
        if own.structure.orbit != "transient":
            *known, duration = np.asarray(ca.Function("inputs", [y], [run.inputs])(at)).ravel()
            steps = steps_for(phase(dict(zip(own.names, known, strict=True)), duration), _TIGHT_PHASE)
            accuracy = Accuracy("dop853", steps=steps)
        outputs = 1 if averages_only(run, whole, 1 + k) else own.timeline.outputs
        timeline = Timeline(outputs, accuracy.steps or MOST_ADAPTIVE, own.timeline.kink)
        used = ca.veccat(*integration(own.structure, accuracy, timeline).function.call([run.inputs]))
        # Outputs that the design does not use are left out of the integration.
        results.append(ca.vertcat(ca.MX.zeros(result.numel() - used.numel()), used))
    f, g = whole(y, *results)
    return ca.Function("slopes", [y], [ca.gradient(f, y), g, ca.jacobian(g, y)])


def best_of(trials: Sequence[SearchTrial]) -> Optimum:
    """Return the best optimum of any search."""
    return min((optimum for trial in trials for optimum in trial.found), key=ranked_value)
