"""What the accuracy of an optimum costs: transcriptions, integrators, derivatives and compiled functions.

Each method solves the same design locally from the same start. Its error has several faces: of the objective that it
reports; of the objective in truth, at the design that it found; of the variables; and how far that design breaks a
requirement in truth.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import casadi as ca
import numpy as np

from plough_opt.accuracy import Accuracy, Method
from plough_opt.accuracy_study.contest import Entry, median_time
from plough_opt.accuracy_study.local_solve import (
    Derivatives,
    Found,
    Functions,
    Solve,
    Start,
    compiled,
    functions_of,
    solve_nlp,
    solve_transcribed,
    without_derivatives,
)
from plough_opt.accuracy_study.transcription import (
    Collocation,
    MultipleShooting,
    Points,
    Question,
    SingleShooting,
    Transcription,
    transcribe,
)
from plough_opt.design import Design
from plough_opt.design.curvature import minimum_from
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.nlp import Nlp, build_nlp
from plough_opt.design.program import Program
from plough_opt.design.solving import first_optimum
from plough_opt.errors import NotConverged, PloughError
from plough_opt.motion.integrators import quiet_events
from plough_opt.motion.plan import phase, steps_for

REPORTED = "objective as reported"
TRUE = "objective in truth"
VARIABLES = "variables"
REQUIREMENTS = "requirements"

# The reference takes this many times the steps of a solve: of order 8, an error smaller by 4^8.
_FINER = 4.0
# Tolerance of the adaptive method that certifies the reference, by derivatives of its own.
_CERTIFYING = 1e-12
# Scaled points nearer than this are one optimum; a coarse method may be further off and yet lead there.
_SAME = 1e-4
# Move of each scaled variable, towards the middle, to a start beside the optimum.
_BESIDE = 0.02
# A method whose derivatives are noisy cannot meet the toolkit's 1e-10.
_NOISY = 1e-6
# Phase [rad] of the fastest oscillation in a step of order 8, as a design takes it.
_TOOLKIT = 0.8
_SEGMENTS = (4, 16)
# Points, degree, and phases in an interval, coarse to fine.
_MESHES: tuple[tuple[Points, int, tuple[float, ...]], ...] = (
    ("radau", 3, (1.0, 0.5)),
    ("radau", 5, (2.0, 1.0)),
    ("legendre", 4, (1.5, 0.75)),
)
# Phases in a step, coarse to fine, and tolerances.
_FIXED: tuple[tuple[Method, tuple[float, ...]], ...] = (
    ("dop853", (2.0, 1.2, 0.8, 0.5)),
    ("rk", (0.2, 0.1)),
    ("collocation", (1.0, 0.5)),
)
_ADAPTIVE: tuple[tuple[Method, tuple[float, ...]], ...] = (
    ("erk", (1e-6, 1e-9)),
    ("cvodes", (1e-6, 1e-9)),
    ("rosenbrock", (1e-6,)),
)
_HESSIAN, GRADIENT = "exact Hessian, carried along", "exact gradient, L-BFGS"
_COMPILED: tuple[tuple[Derivatives, str, str], ...] = (
    ("exact", _HESSIAN, "-O1"),
    ("gradient", GRADIENT, "-O1"),
    ("gradient", GRADIENT, "-O3"),
)
_DIFFERENCES: tuple[Literal["central", "forward"], ...] = ("central", "forward")


@dataclass(frozen=True)
class TightOptimum:
    """A local optimum found and checked much more tightly than any contestant's.

    Attributes:
        variables: name -> value, SI units.
        objective: tightly re-integrated.
        check: relative difference of two tight integrations of the objective, of which one checks the other [-].
        residual: largest component of the scaled optimality conditions, by the derivatives of another integrator [-].
        y: scaled variables.
    """

    variables: dict[str, float]
    objective: float
    check: float
    residual: float
    y: Vector

    @property
    def floor(self) -> float:
        """Relative error below which contestants cannot be told apart [-]."""
        return max(self.check, self.residual)


@dataclass(frozen=True)
class DesignContest:
    """What accuracy costs for a design.

    Attributes:
        optima: the reference first; then further local optima in which a contestant ended.
        entries: a row for each contestant; one that ended elsewhere is measured by the optimum there, and says so.
    """

    optima: tuple[TightOptimum, ...]
    entries: tuple[Entry, ...]


def design_entries(design: Design, *, budget: float = 0.5, limit: float = 10.0, near: bool = False) -> list[Entry]:
    """Return the rows of `design_contest`."""
    return list(design_contest(design, budget=budget, limit=limit, near=near).entries)


def design_contest(
    design: Design,
    *,
    budget: float = 0.5,
    limit: float = 10.0,
    near: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> DesignContest:
    """Solve a design locally by every method, and measure error and time of each.

    Args:
        design: with something to minimise; its parameters have their declared values.
        budget: time [s] after which a solve is not repeated more than thrice for its median, as in `median_time`.
        limit: time [s] after which IPOPT gives up; the row says so.
        near: start beside the optimum, as a solve with slightly changed parameters would, instead of at the guess.
        progress: called with the method that is next and the fraction done.

    Raises:
        InputError: nothing to minimise or to vary.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the reference was not found.
    """
    judge = _Judge(design)
    best = judge.reference()
    question = judge.question
    y = best.y + _BESIDE * np.where(best.y < 0.5, 1.0, -1.0) if near else question.program.start()
    start = Start(y, near, limit)
    methods = _methods(question, best, start)
    entries = []
    for k, method in enumerate(methods):
        if progress is not None:
            progress(f"{method.family}: {method.name}, {method.setting}", k / len(methods))
        entries.append(judge.entry(method, budget))
    return DesignContest(tuple(judge.optima), tuple(entries))


@dataclass(frozen=True)
class _Method:
    """A contestant: what it is called, and what builds its solve."""

    family: str
    name: str
    setting: str
    build: Callable[[], Solve]


class _Judge:
    """Knows the tight optima, and measures a contestant by the one in whose basin it ended."""

    def __init__(self, design: Design) -> None:
        """Build the program, and the question that contestants put in their own form."""
        declared = design.declared
        self._p = np.array([parameter.value for parameter in declared.parameters])
        self._tight = Program(declared)
        self._tight.build(self._p)
        self.question = Question.of(self._tight, self._p)
        self._certificate = self._certifying()
        self.optima: list[TightOptimum] = []

    def reference(self) -> TightOptimum:
        """Return the local optimum to which the guess leads, by the toolkit's steps and then by finer ones."""
        program = self._tight
        first = minimum_from(program, self._p, first_optimum(program, self._p))
        program.build(self._p, _FINER)
        point = program.solve(first.y, self._p, near=True)
        if not point.solved:
            raise NotConverged("the reference was lost when the steps were refined: tighten the bounds", point.status)
        self.optima.append(self._certified(point))
        return self.optima[0]

    def entry(self, method: _Method, budget: float) -> Entry:
        """Return the row of a contestant."""
        named = (method.family, method.name, method.setting)
        started = time.perf_counter()
        setup = 0.0
        try:
            solve = method.build()
            setup = time.perf_counter() - started
            found = solve()
            errors, elsewhere = self._errors(found)
        except (PloughError, RuntimeError) as error:
            return Entry(*named, float("inf"), setup, {}, _in_a_line(error))
        seconds = median_time(solve, budget=budget, warm=True)
        return Entry(*named, seconds, setup, errors, elsewhere=elsewhere)

    def _errors(self, found: Found) -> tuple[dict[str, float], str]:
        """Return a contestant's errors, and a clause that tells where it ended if not in the reference."""
        number = self._basin(found.y)
        best, program = self.optima[number], self._tight
        values, _ = program.exact_values(found.y, self._p)
        size = max(abs(best.objective), program.objective_scale * 1e-12)
        limits = [r.margin(v) for r, v in zip(program.declared.requirements, values[1:], strict=True)]
        broken = [max(0.0, -margin) / scale for margin, scale in zip(limits, program.scales, strict=True)]
        errors = {
            REPORTED: abs(found.f * program.objective_scale - best.objective) / size,
            TRUE: abs(float(values[0].item()) - best.objective) / size,
            VARIABLES: float(np.max(np.abs(found.y - best.y))),
            REQUIREMENTS: max(broken, default=0.0),
        }
        if number == 0:
            return errors, ""
        return errors, f"ended in another optimum, {best.objective:.7g} instead of {self.optima[0].objective:.7g}"

    def _basin(self, y: Vector) -> int:
        """Return the number of the tight optimum to which a design leads; one that is new is added."""
        for number, optimum in enumerate(self.optima):
            if np.max(np.abs(y - optimum.y)) < _SAME:
                return number
        point = self._tight.solve(y, self._p, near=True)
        if not point.solved:
            raise NotConverged("it stopped at a design that leads to no optimum of the tight model", point.status)
        for number, optimum in enumerate(self.optima):
            if np.max(np.abs(point.y - optimum.y)) < _SAME:
                return number
        self.optima.append(self._certified(point))
        return len(self.optima) - 1

    def _certified(self, point: Point) -> TightOptimum:
        """Return a point of the tight program with its objective and optimality by other means."""
        program = self._tight
        found, check = (float(values[0].item()) for values in program.exact_values(point.y, self._p))
        gradient, jacobian = (np.asarray(result) for result in self._certificate(point.y))
        residual = gradient.ravel() + jacobian.T @ point.lam_g + point.lam_y
        return TightOptimum(
            variables={
                v.name: float(x) for v, x in zip(program.declared.variables, program.values(point.y), strict=True)
            },
            objective=found,
            check=abs(found - check) / max(abs(found), program.objective_scale * 1e-12),
            residual=float(np.max(np.abs(residual))),
            y=point.y,
        )

    def _certifying(self) -> ca.Function:
        """Return y -> gradient and Jacobian through an integrator that shares nothing with the tight program's."""
        own = transcribe(self.question, SingleShooting(Accuracy("erk", tolerance=_CERTIFYING)))
        return ca.Function("certifying", [own.x], [ca.gradient(own.f, own.x), ca.jacobian(own.g[0], own.x)])


def _in_a_line(error: Exception) -> str:
    """Return a failure's reason; of CasADi's own, which go over many lines, the last."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


# --- contestants -----------------------------------------------------------------------------------------


def _methods(question: Question, best: TightOptimum, start: Start) -> list[_Method]:
    """Return the contestants; without a moving run there is nothing to transcribe or to integrate."""
    runs = question.parts.runs
    if not runs:
        return _derivatives(question, start, None)
    total = max(_phase(question, y) for y in (best.y, start.y))

    def steps(angle: float) -> int:
        return question.intervals(steps_for(total, angle))

    plain = not any(run.integration.structure.events or run.integration.structure.orbit != "transient" for run in runs)
    return [
        *_transcriptions(question, start, steps),
        *(_integrators(question, start, steps) if plain else []),
        *_derivatives(question, start, steps(_TOOLKIT) if plain else None),
    ]


def _phase(question: Question, y: Vector) -> float:
    """Return the phase [rad] of the fastest oscillation of any run at a design."""
    exact = question.program.exact
    found = []
    for k, run in enumerate(exact.runs):
        inputs, _ = exact.inputs(k, [*question.program.values(y), *question.p])
        found.append(phase(dict(zip(run.integration.names, inputs[:-1], strict=True)), inputs[-1]))
    return max(found)


def _transcriptions(question: Question, start: Start, steps: Callable[[float], int]) -> list[_Method]:
    """Return the forms of the program, each with exact derivatives by CasADi."""
    count = steps(_TOOLKIT)
    forms: list[tuple[str, str, Transcription]] = [
        ("single shooting", f"{count} steps of order 8", SingleShooting(Accuracy("dop853", steps=count)))
    ]
    for segments in dict.fromkeys(map(question.intervals, _SEGMENTS)):
        each = math.ceil(count / segments)
        forms.append(("multiple shooting", f"{segments} segments of {each} steps", MultipleShooting(segments, each)))
    for points, degree, angles in _MESHES:
        for intervals in dict.fromkeys(map(steps, angles)):
            form = Collocation(intervals, degree, points)
            forms.append((f"collocation, {points.title()}", f"{intervals} intervals of degree {degree}", form))
    return [
        _Method("transcription", name, text, partial(_by_casadi, question, form, start, "exact", 1e-10))
        for name, text, form in forms
    ]


def _integrators(question: Question, start: Start, steps: Callable[[float], int]) -> list[_Method]:
    """Return single shooting by other integrators, each with an exact gradient and limited-memory BFGS."""
    methods = []
    for method, angles in _FIXED:
        for count in dict.fromkeys(map(steps, angles)):
            form = SingleShooting(Accuracy(method, steps=count))
            build = partial(_by_casadi, question, form, start, "gradient", 1e-10)
            methods.append(_Method("integrator", method, f"{count} steps", build))
    for method, tolerances in _ADAPTIVE:
        for tolerance in tolerances:
            form = SingleShooting(Accuracy(method, tolerance=tolerance))
            build = partial(_by_casadi, question, form, start, "gradient", _NOISY)
            methods.append(_Method("integrator", method, f"tolerance {tolerance:.0e}", build))
    return methods


def _derivatives(question: Question, start: Start, steps: int | None) -> list[_Method]:
    """Return choices of derivatives, interpreted and compiled, of one program: steps of order 8 where it has runs."""
    nlp = partial(_carried, question, steps)

    def built(use: Derivatives, change: Callable[[Functions], Functions] | None = None, tol: float = 1e-10) -> Solve:
        own = functions_of(nlp(), use)
        return solve_nlp(own if change is None else change(own), question, start, use, tol)

    text = "" if steps is None else f"{steps} steps of order 8"
    rows: list[tuple[str, str, Callable[[], Solve]]] = [
        ("derivatives", _HESSIAN, partial(built, "exact")),
        ("derivatives", GRADIENT, partial(built, "gradient")),
    ]
    if steps is not None:
        form = SingleShooting(Accuracy("dop853", steps=steps))
        build = partial(_by_casadi, question, form, start, "exact", 1e-10)
        rows.append(("derivatives", "exact Hessian, of the graph", build))
    for differences in _DIFFERENCES:
        blind = partial(without_derivatives, variables=len(start.y), method=differences)
        name = f"{differences} differences, L-BFGS"
        rows.append(("derivatives", name, partial(built, differences, blind, _NOISY)))
    for use, name, flag in _COMPILED:
        code = partial(compiled, flags=[flag])
        rows.append(("compiled", f"{name}, cc {flag}", partial(built, use, code)))
    return [_Method(family, name, text, build) for family, name, build in rows]


def _carried(question: Question, steps: int | None) -> Nlp:
    """Return the toolkit's own program: derivatives carried along the steps."""
    with quiet_events():
        return build_nlp(question.parts, question.y, ca.MX.sym("p", 0), [steps] * len(question.parts.runs))


def _by_casadi(
    question: Question, form: Transcription, start: Start, derivatives: Derivatives, tolerance: float
) -> Solve:
    """Return the solve of a transcription; collocation, of many small pieces, as scalar operations."""
    own = transcribe(question, form, start.y)
    return solve_transcribed(own, start, derivatives, tolerance, scalar=isinstance(form, Collocation))
