"""Cost of the accuracy of an optimum: transcriptions, integrators, derivatives and compiled functions.

Each method solves the same design locally from the same start. Its error has several faces: of the objective that it
reports; of the objective in truth, at the design that it found; of the variables; and how far that design breaks a
requirement in truth.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, NotConverged, PloughError
from plough_opt.design import Design
from plough_opt.design.basin import first_optimum
from plough_opt.design.curvature import minimum_from
from plough_opt.design.ipopt import SolveOptions, Vector
from plough_opt.design.nlp import Nlp, build_nlp
from plough_opt.design.program import Program
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.methods import METHODS, is_stepped
from plough_opt.motion.plan import steps_for
from plough_opt.studies.accuracy.contest import Entry, median_time
from plough_opt.studies.accuracy.local_solve import (
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
from plough_opt.studies.accuracy.tight_optimum import Certificate, TightOptimum
from plough_opt.studies.accuracy.transcription import (
    Collocation,
    MultipleShooting,
    Points,
    Question,
    SingleShooting,
    Transcription,
    transcribe,
)

REPORTED = "objective as reported"
TRUE = "objective in truth"
VARIABLES = "variables"
REQUIREMENTS = "requirements"

# The reference takes this many times the steps of a solve: of order 8, an error smaller by 4^8.
_FINER = 4.0
# Scaled points nearer than this are one optimum; a coarse method may be further off and yet lead there.
_SAME = 1e-4
# Move of each scaled variable, towards the middle, to a start beside the optimum.
_BESIDE = 0.02
# A method whose derivatives are noisy cannot meet the toolkit's 1e-10.
_NOISY = 1e-6
# Phase [rad] of the fastest oscillation in a step of order 8, and tolerance where it has events, of single shooting.
_SINGLE = 0.8
_TIGHTER = 1e-10
_SEGMENTS = (4, 16)
# Points, degree, and phases in an interval, coarse to fine.
_MESHES: tuple[tuple[Points, int, tuple[float, ...]], ...] = (
    ("radau", 3, (1.0, 0.5)),
    ("radau", 5, (2.0, 1.0)),
    ("legendre", 4, (1.5, 0.75)),
)
# Phases in a step, coarse to fine, and tolerances.
_FIXED: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("dop853", (2.0, 1.2, 0.8, 0.5)),
    ("rk", (0.2, 0.1)),
    ("collocation", (1.0, 0.5)),
)
_ADAPTIVE: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("erk", (1e-6, 1e-9)),
    ("cvodes", (1e-6, 1e-9)),
    ("rosenbrock", (1e-6,)),
)
_HESSIAN, GRADIENT = "exact Hessian, carried along", "exact gradient, L-BFGS"
_OF_GRAPH = "exact Hessian, of the graph"
_COMPILED: tuple[tuple[Derivatives, str, str], ...] = (
    ("exact", _HESSIAN, "-O1"),
    ("gradient", GRADIENT, "-O1"),
    ("gradient", GRADIENT, "-O3"),
)
_NO_CODE = "finds the lasting orbit by Newton's method, which CasADi does not translate into C"
_DIFFERENCES: tuple[Literal["central", "forward"], ...] = ("central", "forward")


@dataclass(frozen=True)
class DesignContest:
    """Cost of accuracy for a design.

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
    thin: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> DesignContest:
    """Solve a design locally by every method, and measure error and time of each.

    Args:
        design: with something to minimise; its parameters have their declared values.
        budget: time [s] after which a solve is not repeated more than thrice for its median, as in `median_time`.
        limit: time [s] after which IPOPT gives up; the row says so.
        near: start beside the optimum, as a solve with slightly changed parameters would, instead of at the guess.
        thin: leave out every other setting of a method.
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
    if thin:
        names = dict.fromkeys((method.family, method.name) for method in methods)
        alike = [[method for method in methods if (method.family, method.name) == name] for name in names]
        methods = [method for settings in alike for method in settings[::2]]
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
        self._certificate = Certificate(self.question)
        self.optima: list[TightOptimum] = []

    def reference(self) -> TightOptimum:
        """Return the local optimum to which the guess leads, by the toolkit's steps and then by finer ones."""
        program = self._tight
        first = minimum_from(program, self._p, first_optimum(program, self._p))
        program.build(self._p, _FINER)
        point = program.solve(first.y, self._p, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged("the reference was lost when the steps were refined: tighten the bounds", point.status)
        self.optima.append(self._certificate.tight(point))
        return self.optima[0]

    def entry(self, method: _Method, budget: float) -> Entry:
        """Return the row of a contestant."""
        named = (method.family, method.name, method.setting)
        started = time.perf_counter()
        setup = 0.0
        try:
            solve = method.build()
            setup = time.perf_counter() - started
            started = time.process_time()
            found = solve()
            seconds = time.process_time() - started
            errors, elsewhere = self._errors(found)
        except (PloughError, RuntimeError) as error:
            return Entry(*named, float("inf"), setup, {}, _in_a_line(error))
        # A repetition may take just longer than the limit that the first just kept.
        with contextlib.suppress(PloughError, RuntimeError):
            seconds = median_time(solve, budget=budget, warm=True)
        return Entry(*named, seconds, setup, errors, elsewhere=elsewhere)

    def _errors(self, found: Found) -> tuple[dict[str, float], str]:
        """Return a contestant's errors, and a clause on where it ended if not in the reference."""
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
        point = self._tight.solve(y, self._p, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged("it stopped at a design that leads to no optimum of the tight model", point.status)
        for number, optimum in enumerate(self.optima):
            if np.max(np.abs(point.y - optimum.y)) < _SAME:
                return number
        self.optima.append(self._certificate.tight(point))
        return len(self.optima) - 1


def _in_a_line(error: Exception) -> str:
    """Return a failure's reason; of CasADi's own, which go over many lines, the last."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reason = lines[-1] if lines else type(error).__name__
    return reason if isinstance(error, PloughError) else f"CasADi gave up: {reason}"


# --- contestants -----------------------------------------------------------------------------------------


def _methods(question: Question, best: TightOptimum, start: Start) -> list[_Method]:
    """Return the contestants; without a moving run there is nothing to transcribe or to integrate."""
    runs = question.parts.runs
    if not runs:
        return _derivatives(question, start)
    total = max(question.phase(y) for y in (best.y, start.y))

    def steps(angle: float) -> int:
        return question.intervals(steps_for(total, angle))

    return [
        *_transcriptions(question, start, steps),
        *_integrators(question, start, steps),
        *_derivatives(question, start),
    ]


def _transcriptions(question: Question, start: Start, steps: Callable[[float], int]) -> list[_Method]:
    """Return the forms of the program, each with exact derivatives by CasADi."""
    count = steps(_SINGLE)
    single, text = Accuracy("dop853", steps=count), f"{count} steps of order 8"
    if question.refusal("dop853"):
        single, text = Accuracy("erk", tolerance=_TIGHTER), f"erk, tolerance {_TIGHTER:.0e}"
    forms: list[tuple[str, str, Transcription]] = [("single shooting", text, SingleShooting(single))]
    for segments in dict.fromkeys(map(question.intervals, _SEGMENTS)):
        each = math.ceil(count / segments)
        forms.append(
            (
                "multiple shooting",
                f"{segments} segments of {each} step{'s' * (each > 1)}",
                MultipleShooting(segments, each),
            )
        )
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
    settings: list[tuple[Accuracy, str, float]] = []
    others = {name: METHODS[name].finer for name in METHODS if is_stepped(name) and name not in ("auto", "dop853")}
    for method, angles in (*_FIXED, *((name, (1.0 / by, 0.5 / by)) for name, by in others.items())):
        counts = dict.fromkeys(map(steps, angles))
        settings += [(Accuracy(method, steps=count), f"{count} steps", 1e-10) for count in counts]
    for method, tolerances in _ADAPTIVE:
        settings += [(Accuracy(method, tolerance=t), f"tolerance {t:.0e}", _NOISY) for t in tolerances]
    for accuracy, text, tolerance in settings:
        reason = question.refusal(accuracy.method)
        build = partial(_by_casadi, question, SingleShooting(accuracy), start, "gradient", tolerance)
        methods.append(_Method("integrator", accuracy.method, text, partial(_refuse, reason) if reason else build))
    return methods


def _refuse(reason: str) -> Solve:
    raise InputError(reason)


def _derivatives(question: Question, start: Start) -> list[_Method]:
    """Return choices of derivatives, interpreted and compiled, of the program that `Design.solve` takes."""

    def built(use: Derivatives, change: Callable[[Functions], Functions] | None = None, tol: float = 1e-10) -> Solve:
        own = functions_of(_carried(question), use)
        return solve_nlp(own if change is None else change(own), question, start, use, tol)

    counts = [count for count in question.steps if count is not None]
    unit = "harmonics" if question.orbits else "steps of order 8"
    text = ", ".join(f"{count} {unit}" for count in dict.fromkeys(counts))
    rows: list[tuple[str, str, Callable[[], Solve]]] = [
        ("derivatives", _HESSIAN, partial(built, "exact")),
        ("derivatives", GRADIENT, partial(built, "gradient")),
    ]
    if counts and not question.orbits:
        form = SingleShooting(Accuracy("dop853", steps=max(counts)))
        rows.append(("derivatives", _OF_GRAPH, partial(_by_casadi, question, form, start, "exact", 1e-10)))
    for differences in _DIFFERENCES:
        blind = partial(without_derivatives, variables=len(start.y), method=differences)
        name = f"{differences} differences, L-BFGS"
        rows.append(("derivatives", name, partial(built, differences, blind, _NOISY)))
    for use, name, flag in _COMPILED:
        build = partial(_refuse, _NO_CODE) if question.orbits else partial(built, use, partial(compiled, flags=[flag]))
        rows.append(("compiled", f"{name}, cc {flag}", build))
    return [_Method(family, name, text, build) for family, name, build in rows]


def _carried(question: Question) -> Nlp:
    """Return the toolkit's own program: derivatives carried along the steps."""
    return build_nlp(question.parts, question.y, ca.MX.sym("p", 0), list(question.steps))


def _by_casadi(
    question: Question, form: Transcription, start: Start, derivatives: Derivatives, tolerance: float
) -> Solve:
    """Return the solve of a transcription; collocation, of many small pieces, as scalar operations."""
    own = transcribe(question, form, start.y)
    return solve_transcribed(own, start, derivatives, tolerance, scalar=isinstance(form, Collocation))
