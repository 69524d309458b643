"""Contest for the optimum of a design: transcriptions, integrators, derivatives and compiled functions.

Each method solves the same design locally from the same start. It has four errors: of the objective that it reports; of
the true objective at the design that it found; of the variables; and the true violation of a requirement there.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import NotConverged
from plough_opt.design import Design
from plough_opt.design.basin import first_optimum
from plough_opt.design.exploring import Progress, silent
from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.nlp import Nlp, build_nlp
from plough_opt.design.optimality import decides, newton_step, symmetric
from plough_opt.design.polishing import minimum_from
from plough_opt.design.program import Program
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.methods import METHODS, is_stepped
from plough_opt.motion.plan import steps_for
from plough_opt.studies.accuracy.contest import Contestant, Entry, measured, refuse
from plough_opt.studies.accuracy.local_solve import (
    Derivatives,
    Solve,
    Start,
    compiled,
    solve_nlp,
    solve_transcribed,
)
from plough_opt.studies.accuracy.methods import text
from plough_opt.studies.accuracy.transcription import Mesh, Points, Question, Transcription, transcribe

REPORTED = "objective as reported"
"""Key of the error of the objective that a method reports."""

TRUE = "objective in truth"
"""Key of the error of the true objective at the design that a method found."""

VARIABLES = "variables"
"""Key of the error of the scaled variables."""

REQUIREMENTS = "requirements"
"""Key of the largest true violation of a requirement, relative to its limit."""

# Factor on the number of steps of a solve for the reference. With order 8 the error is smaller by 4^8.
_FINER = 4.0
# Scaled designs closer than this are the same optimum; a coarse method may end farther away and yet lead to it.
_SAME = 1e-4
# Distance of a near start from the optimum in each scaled variable, towards the middle of its range.
_NEAR_START = 0.02
# IPOPT's tolerance in `Design.solve`, and one that can be met with noisy derivatives.
_TIGHT: Final = 1e-10
_NOISY: Final = 1e-6
# Single shooting: phase of the fastest oscillation in a step of order 8 [rad], or the tolerance if there are events.
_SINGLE_PHASE = 0.8
_SINGLE_TOLERANCE = 1e-10
# Numbers of segments of multiple shooting.
_SEGMENTS = (4, 16)
# Collocation: points, degree, and phases in an interval from coarse to fine [rad].
_MESHES: tuple[tuple[Points, int, tuple[float, ...]], ...] = (
    ("radau", 3, (1.0, 0.5)),
    ("radau", 5, (2.0, 1.0)),
    ("legendre", 4, (1.5, 0.75)),
)
# Methods with fixed steps: phases in a step from coarse to fine [rad].
_FIXED: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("dop853", (2.0, 1.2, 0.8, 0.5)),
    ("rk", (0.2, 0.1)),
    ("collocation", (1.0, 0.5)),
)
# Adaptive methods: tolerances from coarse to fine.
_ADAPTIVE: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("erk", (1e-6, 1e-9)),
    ("cvodes", (1e-6, 1e-9)),
    ("rosenbrock", (1e-6,)),
)
_HESSIAN, GRADIENT = "exact Hessian, carried along", "exact gradient, L-BFGS"
_OF_GRAPH = "exact Hessian, of the graph"
# Derivatives of the program of `Design.solve`, with IPOPT's tolerance.
_CARRIED: tuple[tuple[str, Derivatives, float], ...] = (
    (_HESSIAN, "exact", _TIGHT),
    (GRADIENT, "gradient", _TIGHT),
    ("central differences, L-BFGS", "central", _NOISY),
    ("forward differences, L-BFGS", "forward", _NOISY),
)
_NO_CODE = "finds the periodic orbit by Newton's method, which CasADi does not translate into C"
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


@dataclass(frozen=True)
class TightOptimum:
    """Local optimum known much more accurately than by any contestant.

    Attributes:
        variables: name -> value, SI units.
        objective: objective by a tight integration.
        floor: its relative error, below which contestants do not differ [-].
        y: scaled variables.
        off: error of the scaled variables: the next of Newton's steps, which is rounding [-].
    """

    variables: dict[str, float]
    objective: float
    floor: float
    y: Vector
    off: float


@dataclass(frozen=True)
class DesignContest:
    """Errors and times of every method for a design.

    Attributes:
        best: the reference.
        entries: entry of each contestant.
    """

    best: TightOptimum
    entries: tuple[Entry, ...]


def design_contest(
    design: Design,
    *,
    wanted: float = 1e-6,
    budget: float = 0.5,
    limit: float = 10.0,
    near: bool = False,
    thin: bool = False,
    progress: Progress = silent,
) -> DesignContest:
    """Return error and time of every method that can solve a design locally.

    Args:
        design: design with an objective; its parameters have their declared values.
        wanted: relative error of the objective; the methods that reach it soonest are timed again [-].
        budget: time of a solve's repetitions after which no further one begins [s].
        limit: time after which IPOPT gives up [s]; the entry says so.
        near: whether to start near the optimum, as after a small change of parameters, instead of at the guess.
        thin: whether to leave out every other setting of a method.
        progress: called with the method that is next and the fraction done.

    Raises:
        InputError: the design has no objective or no variables.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the reference was not found.
    """
    judge = _Judge(design)
    best, question = judge.best, judge.question
    y = best.y + _NEAR_START * np.where(best.y < 0.5, 1.0, -1.0) if near else question.program.start()
    settings: dict[tuple[str, str], list[tuple[str, Callable[[], Solve]]]] = {}
    total = max(map(question.phase, (best.y, y)))
    for family, name, words, build in _Settings(question, Start(y, near, limit), total).rows():
        settings.setdefault((family, name), []).append((words, build))
    contestants = [
        Contestant(
            family, name, lambda setting: setting[1](), judge.errors, own[:: 2 if thin else 1],
            label=lambda setting: setting[0], patience=lambda _: math.inf, elsewhere=judge.elsewhere,
        )
        for (family, name), own in settings.items()
    ]  # fmt: skip
    entries = measured(contestants, REPORTED, wanted, 10.0 * budget, progress=progress)
    return DesignContest(best, tuple(entries))


class _Judge:
    """The accurate optimum to which the guess leads, and the errors of each contestant relative to it.

    IPOPT, which every contestant uses, stops a little inside the active limits. From there Newton's method leads onto
    them, with gradients by an integrator that shares nothing with those of the contestants.

    Attributes:
        question: program of the design as `Design.solve` builds it.
        best: the optimum.
    """

    def __init__(self, design: Design) -> None:
        """Find the optimum to which the guess leads, with the steps of `Design.solve` and then with finer ones."""
        declared = design.declared
        p = self._p = np.array([parameter.value for parameter in declared.parameters])
        program = self._tight = Program(declared)
        program.build(p)
        self.question = Question.of(program, p)
        first = minimum_from(program, p, first_optimum(program, p))
        program.build(p, _FINER)
        point = program.solve(first.y, p, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged("the reference was lost when the steps were refined: tighten the bounds", point.status)
        self._slopes = _tight_slopes(self.question, point.y)
        self.best = self._optimum(point)

    def errors(self, found: Point) -> Mapping[str, float]:
        """Return the errors of the point that a contestant found."""
        best, program = self.best, self._tight
        values, _ = program.exact_values(found.y, self._p)
        size = max(abs(best.objective), program.objective_scale * _LEAST_SIZE)
        limits = [r.margin(v) for r, v in zip(program.declared.requirements, values[1:], strict=True)]
        broken = [max(0.0, -margin) / scale for margin, scale in zip(limits, program.scales, strict=True)]
        return {
            REPORTED: abs(found.f * program.objective_scale - best.objective) / size,
            TRUE: abs(float(values[0].item()) - best.objective) / size,
            VARIABLES: float(np.max(np.abs(found.y - best.y))),
            REQUIREMENTS: max(broken, default=0.0),
        }

    def elsewhere(self, found: Point) -> str:
        """Return a clause on where a contestant ended; empty if in the reference."""
        if self._near(found.y):
            return ""
        point = self._tight.solve(found.y, self._p, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged("it stopped at a design that leads to no true optimum", point.status)
        own = point.f * self._tight.objective_scale
        return (
            "" if self._near(point.y) else f"ended in another optimum, {own:.7g} instead of {self.best.objective:.7g}"
        )

    def _near(self, y: Vector) -> bool:
        return bool(np.max(np.abs(y - self.best.y)) < _SAME)

    def _optimum(self, point: Point) -> TightOptimum:
        """Return the accurate optimum near the point where IPOPT stopped on the tight program."""
        program = self._tight
        y, residual, off = self._polished(point)
        found, check = (float(values[0].item()) for values in program.exact_values(y, self._p))
        apart = abs(found - check) / max(abs(found), program.objective_scale * _LEAST_SIZE)
        variables = zip(program.declared.variables, program.values(y), strict=True)
        # The error of an objective at its optimum is the residual times the error of the variables.
        floor = max(apart, residual * max(off, residual), float(np.finfo(float).eps))
        return TightOptimum({v.name: float(x) for v, x in variables}, found, floor, y, off)

    def _polished(self, point: Point) -> tuple[Vector, float, float]:
        """Return scaled variables on the active limits, the residual of the conditions there, and the next step."""
        program, y, n = self._tight, point.y, len(point.y)
        g = np.asarray(program.nlp.values(y, self._p)[1]).ravel()
        active, limits = _active_limits(program, point, g)
        hessian = symmetric(np.asarray(program.nlp.hess_lag(y, self._p, 1.0, point.lam_g)))
        best = (y, np.inf, np.inf)
        for _ in range(_MOST_NEWTON_STEPS):
            gradient, g, jacobian = (np.asarray(result) for result in self._slopes(y))
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


def _tight_slopes(question: Question, y: Vector) -> ca.Function:
    """Return y -> (gradient of the objective, requirements, their Jacobian), with steps that suit one design."""
    accuracy = Accuracy("erk", tolerance=_TIGHT_TOLERANCE)
    if question.orbits:
        accuracy = Accuracy("dop853", steps=question.intervals(steps_for(question.phase(y), _TIGHT_PHASE)))
    own = transcribe(question, accuracy)
    return ca.Function("slopes", [own.x], [ca.gradient(own.f, own.x), own.g[0], ca.jacobian(own.g[0], own.x)])


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


_Row = tuple[str, str, str, Callable[[], Solve]]
"""Family, method, setting as text, and a function that builds its solve."""


@dataclass(frozen=True)
class _Settings:
    """Settings of all contestants. A design without a motion has nothing to transcribe or integrate.

    Attributes:
        question: program of the design.
        start: start of every solve.
        total: largest phase of a run at the start and at the reference [rad].
    """

    question: Question
    start: Start
    total: float

    def rows(self) -> Iterator[_Row]:
        """Yield all settings of all methods."""
        if self.question.parts.runs:
            yield from self._transcriptions()
            yield from self._integrators()
        yield from self._derivatives()

    def _steps(self, angle: float) -> int:
        """Return the number of steps of a run, each of a phase [rad]."""
        return self.question.intervals(steps_for(self.total, angle))

    def _transcriptions(self) -> Iterator[_Row]:
        """Yield the transcriptions of the program, each with exact derivatives by CasADi."""
        count = self._steps(_SINGLE_PHASE)
        single, words = Accuracy("dop853", steps=count), f"{count} steps of order 8"
        if self.question.refusal("dop853"):
            single, words = Accuracy("erk", tolerance=_SINGLE_TOLERANCE), f"erk, tolerance {_SINGLE_TOLERANCE:.0e}"
        forms: list[tuple[str, str, Transcription]] = [("single shooting", words, single)]
        for segments in dict.fromkeys(map(self.question.intervals, _SEGMENTS)):
            each = math.ceil(count / segments)
            words = f"{segments} segments of {each} step{'s' * (each > 1)}"
            forms.append(("multiple shooting", words, Mesh(segments, steps=each)))
        for points, degree, angles in _MESHES:
            for intervals in dict.fromkeys(map(self._steps, angles)):
                words = f"{intervals} intervals of degree {degree}"
                forms.append((f"collocation, {points.title()}", words, Mesh(intervals, degree=degree, points=points)))
        for name, words, form in forms:
            yield "transcription", name, words, partial(self._by_casadi, form)

    def _integrators(self) -> Iterator[_Row]:
        """Yield single shooting by other integrators, each with an exact gradient and limited-memory BFGS."""
        others = {name: METHODS[name].finer for name in METHODS if is_stepped(name) and name not in ("auto", "dop853")}
        fixed = (*_FIXED, *((name, (1.0 / by, 0.5 / by)) for name, by in others.items()))
        counts = [(method, dict.fromkeys(map(self._steps, angles))) for method, angles in fixed]
        settings = [Accuracy(method, steps=count) for method, own in counts for count in own]
        settings += [Accuracy(method, tolerance=tolerance) for method, own in _ADAPTIVE for tolerance in own]
        for accuracy in settings:
            tolerance = _TIGHT if accuracy.steps else _NOISY
            build = partial(self._by_casadi, accuracy, exact=False, tolerance=tolerance)
            if reason := self.question.refusal(accuracy.method):
                build = partial(refuse, reason)
            yield "integrator", accuracy.method, text(accuracy), build

    def _derivatives(self) -> Iterator[_Row]:
        """Yield the choices of derivatives, interpreted and compiled, of the program that `Design.solve` uses."""
        question = self.question
        counts = [count for count in question.steps if count is not None]
        unit = "harmonics" if question.orbits else "steps of order 8"
        words = ", ".join(f"{count} {unit}" for count in dict.fromkeys(counts))

        def built(derivatives: Derivatives, tolerance: float, change: Callable[[Nlp], Nlp] = lambda nlp: nlp) -> Solve:
            # In this program derivatives are carried along the steps of a run.
            nlp = build_nlp(question.parts, question.y, ca.MX.sym("p", 0), list(question.steps))
            return solve_nlp(change(nlp), question, self.start, derivatives, tolerance)

        for name, derivatives, tolerance in _CARRIED:
            yield "derivatives", name, words, partial(built, derivatives, tolerance)
        if counts and not question.orbits:
            of_graph = partial(self._by_casadi, Accuracy("dop853", steps=max(counts)))
            yield "derivatives", _OF_GRAPH, words, of_graph
        build = partial(refuse, _NO_CODE) if question.orbits else partial(built, "gradient", _TIGHT, compiled)
        yield "compiled", f"{GRADIENT}, compiled", words, build

    def _by_casadi(self, form: Transcription, *, exact: bool = True, tolerance: float = _TIGHT) -> Solve:
        """Return the solve of a transcription. Collocation, with its many small pieces, is expanded into scalars."""
        own = transcribe(self.question, form, self.start.y)
        scalar = isinstance(form, Mesh) and not form.steps
        return solve_transcribed(own, self.start, exact=exact, tolerance=tolerance, scalar=scalar)
