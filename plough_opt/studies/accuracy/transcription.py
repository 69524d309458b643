"""Transcriptions of a design: its program with runs by single shooting, multiple shooting or collocation.

Each run in the design's expressions is replaced by results that are expressions of the design's variables alone (single
shooting), or of further unknowns too, which equalities tie to the equation of motion (direct multiple shooting, direct
collocation). Betts: Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, 2nd ed., 2010,
chapters 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import stacked
from plough_opt.design.ipopt import Vector
from plough_opt.design.nlp import averages_only
from plough_opt.design.program import Program
from plough_opt.design.split import EmbeddedRun, Split, split
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.equation import equation_of_motion, signals, start_state
from plough_opt.motion.integrators import integration
from plough_opt.motion.plan import MOST_ADAPTIVE, phase, with_setting
from plough_opt.motion.runge_kutta import step
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline
from plough_opt.studies.accuracy.methods import refused

Points = Literal["radau", "legendre"]

# Steps of order 8 in the run that further unknowns start from; states between its steps are interpolated.
_START_STEPS = 2000


@dataclass(frozen=True)
class Mesh:
    """Mesh over the duration whose states between intervals are unknowns: multiple shooting or collocation.

    Attributes:
        intervals: wanted number of intervals; at least one for each output that the design uses is taken.
        steps: steps of order 8 in each interval for multiple shooting; 0 for collocation.
        degree: degree of the polynomial of collocation. Its states at all points are unknowns too and satisfy the
            equation of motion there. The order is 2 degree - 1 with Radau's points, and 2 degree with Legendre's.
        points: ``"radau"`` or ``"legendre"``.
    """

    intervals: int
    steps: int = 0
    degree: int = 0
    points: Points = "radau"


Transcription = Accuracy | Mesh
"""Single shooting with a method of integration, or a mesh."""


@dataclass(frozen=True)
class Question:
    """Scaled program of a design before its runs are transcribed.

    Attributes:
        program: the program, with scales, bounds and the tight integration.
        p: values of the design's parameters.
        y: symbol of the scaled variables.
        parts: scaled objective and requirements (a column) over y, split around their runs.
        steps: for each run the steps of order 8 that `Design.solve` takes; harmonics for a periodic orbit; None for
            events.
    """

    program: Program
    p: Vector
    y: ca.MX
    parts: Split
    steps: tuple[int | None, ...]

    @classmethod
    def of(cls, program: Program, p: Vector) -> Question:
        """Return the question of a program as `Design.solve` builds it, at values of its parameters."""
        y = ca.MX.sym("y", len(program.declared.variables))
        return cls(program, p, y, split(program.scaled(y, ca.MX(ca.DM(p))), [y]), tuple(program.built.steps))

    @cached_property
    def full(self) -> ca.Function:
        """Function (y, results of the runs) -> (objective, requirements)."""
        return ca.Function("full", [self.y, *self.parts.results], list(self.parts.expressions))

    @property
    def structures(self) -> list[Structure]:
        """Structure of each run's motion."""
        return [run.integration.structure for run in self.parts.runs]

    @property
    def orbits(self) -> bool:
        """Whether any run is a periodic orbit."""
        return any(structure.orbit != "transient" for structure in self.structures)

    def refusal(self, method: str) -> str:
        """Return the reason why a method cannot integrate the runs; empty if it can."""
        return refused(method, orbits=self.orbits, events=any(structure.events for structure in self.structures))

    def phase(self, y: Vector) -> float:
        """Return the phase of the fastest oscillation of any run at scaled variables [rad]."""
        exact = self.program.exact
        found = [0.0]
        for k, run in enumerate(exact.runs):
            inputs, _ = exact.inputs(k, [*self.program.values(y), *self.p])
            found.append(phase(dict(zip(run.integration.names, inputs[:-1], strict=True)), inputs[-1]))
        return max(found)

    def outputs_used(self, run: int) -> int:
        """Return the number of intervals between the outputs of a run that the design uses; 1 for averages only."""
        own = self.parts.runs[run]
        return 1 if averages_only(own, self.full, 1 + run) else own.integration.timeline.outputs

    def intervals(self, wanted: int) -> int:
        """Return the number of intervals taken for a wanted number, so that intervals end at every output used."""
        outputs = max((self.outputs_used(k) for k in range(len(self.parts.runs))), default=1)
        return len(Timeline(outputs, wanted).nodes) - 1


@dataclass(frozen=True)
class Transcribed:
    """Nonlinear program: minimise f over x with limits on g and x.

    Attributes:
        x: unknowns: the scaled variables, then those that the transcription adds, of order 1.
        f: scaled objective.
        g: blocks of constraints: the scaled requirements; then for each run the equalities of its motion, whose rows
            depend on few unknowns, and those of its averages, whose rows depend on all.
        given: bounds of x and g, and the start (a design, and the states of its run), by CasADi's names.
    """

    x: ca.MX
    f: ca.MX
    g: tuple[ca.MX, ...]
    given: dict[str, Vector]

    @classmethod
    def of(cls, question: Question, x: ca.MX, f: ca.MX, g: tuple[ca.MX, ...], start: Vector) -> Transcribed:
        """Return the program with the limits of a design: further unknowns are free, further constraints are zero."""
        low, high = question.program.low, question.program.high
        variables = question.y.numel()
        free, zeros = np.full(len(start) - variables, np.inf), np.zeros(sum(block.numel() for block in g) - len(low))
        bounds = {"lbx": np.r_[np.zeros(variables), -free], "ubx": np.r_[np.ones(variables), free]}
        return cls(x, f, g, {"x0": start, **bounds, "lbg": np.r_[low, zeros], "ubg": np.r_[high, zeros]})


@dataclass(frozen=True)
class _Lift:
    """Results of a run in a transcription.

    Attributes:
        results: results of the run, stacked, as expressions of the variables and of further unknowns.
        unknowns: the further unknowns.
        ties: blocks of equalities, zero at a solution, that determine the further unknowns.
        start: initial values of the further unknowns.
    """

    results: ca.MX
    unknowns: ca.MX = field(default_factory=lambda: ca.MX(0, 1))
    ties: tuple[ca.MX, ...] = ()
    start: Vector = field(default_factory=lambda: np.zeros(0))


def transcribe(question: Question, form: Transcription, first: Vector | None = None) -> Transcribed:
    """Return a design's program with its runs transcribed.

    Args:
        question: the program.
        form: transcription of the runs.
        first: scaled variables to start from; default the guesses.

    Raises:
        InputError: a run with events or a periodic orbit is to be put on a mesh.
    """
    first = question.program.start() if first is None else first
    lifts = [
        _shot_once(run, form, question.outputs_used(k))
        if isinstance(form, Accuracy)
        else _meshed(run, form, question.outputs_used(k), ca.Function("inputs", [question.y], [run.inputs])(first))
        for k, run in enumerate(question.parts.runs)
    ]
    f, g = question.full(question.y, *(lift.results for lift in lifts))
    ties = (block for lift in lifts for block in lift.ties)
    x = ca.vertcat(question.y, *(lift.unknowns for lift in lifts))
    return Transcribed.of(question, x, f, (g, *ties), np.concatenate([first, *(lift.start for lift in lifts)]))


def _shot_once(run: EmbeddedRun, accuracy: Accuracy, outputs: int) -> _Lift:
    """Return the results of a run integrated from start to end, which needs no further unknowns."""
    own = run.integration
    accuracy = with_setting(accuracy, 1, outputs)
    timeline = Timeline(outputs, accuracy.steps or MOST_ADAPTIVE, own.timeline.kink)
    results = integration(own.structure, accuracy, timeline).function.call([run.inputs])
    return _Lift(_as_written(run, [ca.vec(result) for result in results]))


def _as_written(run: EmbeddedRun, results: list[ca.MX]) -> ca.MX:
    """Return results padded to the number of outputs that the run was declared with; unused outputs are zero."""
    stacked = ca.vertcat(*results)
    return ca.vertcat(ca.MX.zeros(sum(output.numel() for output in run.outputs) - stacked.numel()), stacked)


def _meshed(run: EmbeddedRun, form: Mesh, outputs: int, inputs: ca.DM) -> _Lift:
    """Return the results of a run on a mesh.

    Unknowns are the states at all nodes except the first and inside the intervals, and means and variances. The latter
    are sums over the whole run; as unknowns they keep the Hessian sparse.

    Args:
        run: the run.
        form: the mesh.
        outputs: number of intervals between the outputs that the design uses.
        inputs: inputs of the run at the start design.
    """
    structure = run.integration.structure
    if structure.events or structure.orbit != "transient":
        what = "events" if structure.events else "a periodic orbit"
        raise InputError(f"a run with {what} cannot be put on a mesh: use single shooting")
    observed, kink = signals(structure), run.integration.timeline.kink
    function, points = _segment(structure, form.steps) if form.steps else _collocated(structure, form)
    mesh = Timeline(outputs, form.intervals, kink)
    lengths = np.diff(mesh.nodes)
    # In each interval the unknowns are the state at its end, and those at the points inside it.
    places = (mesh.nodes[:-1, None] + lengths[:, None] * np.r_[1.0, points]).ravel()
    path, unit, averages, size = _path(structure, inputs, kink, places)
    count, each = len(lengths), 2 * (1 + len(points))
    unknowns, averaged = ca.MX.sym("states", each * count), ca.MX.sym("averages", len(size))

    units = ca.repmat(ca.DM(unit), 1 + len(points), count)
    own = ca.reshape(unknowns, each, count) * units
    states = ca.horzcat(start_state(structure, observed.named(run.inputs)), own[:2, :])
    following, residual, means, spreads = function.map(count)(
        states[:, :count],
        own[2:, :],
        ca.DM(np.vstack([mesh.nodes[:-1], lengths])),
        ca.repmat(run.inputs, 1, count),
    )
    found = averaged * size
    drift = means[: observed.squared, :] - ca.repmat(found[: observed.squared], 1, count)
    pooled = ca.vertcat(means, spreads + drift**2) @ ca.DM(lengths) / size - averaged
    return _Lift(
        results=_as_written(run, [ca.vec(states[:, mesh.output_columns]), found]),
        unknowns=ca.vertcat(unknowns, averaged),
        ties=(ca.vec(ca.vertcat(following - states[:, 1:], residual) / units), pooled),
        start=np.concatenate([path, averages / size]),
    )


_Piece: TypeAlias = tuple[ca.Function, Vector]
"""Function of one interval of a mesh, and the points inside it whose states are unknowns, as fractions of the interval.

The function maps (state, states at the points, start and size of the interval as fractions of the duration, parameters
with the duration last) to (next state, residual of the equation of motion at the points, mean of each signal, mean
square about that mean of each signal with an RMS).
"""


def _segment(structure: Structure, steps: int) -> _Piece:
    """Return a segment of multiple shooting with a number of steps of order 8; it has no inner points."""
    observed = signals(structure)
    state, inner, span = ca.MX.sym("state", 2), ca.MX.sym("inner", 0), ca.MX.sym("span", 2)
    p = ca.MX.sym("p", len(observed.parameters) + 1)
    fractions = ca.DM(np.arange(steps) / steps).T
    spans = ca.vertcat(span[0] + span[1] * fractions, ca.repmat(span[1] / steps, 1, steps))
    states, moments = step(structure).mapaccum(steps)(state, spans, ca.repmat(p, 1, steps))
    means = moments[: observed.count, :]
    mean = ca.sum2(means) / steps
    drift = means[: observed.squared, :] - ca.repmat(mean[: observed.squared], 1, steps)
    spread = ca.sum2(moments[observed.count :, :] + drift**2) / steps
    function = ca.Function("segment", [state, inner, span, p], [states[:, -1], ca.MX(0, 1), mean, spread])
    return function, np.zeros(0)


def _collocated(structure: Structure, form: Mesh) -> _Piece:
    """Return an interval of collocation; its inner states follow one another in one column."""
    degree = form.degree
    motion, observed = equation_of_motion(structure), signals(structure)
    nodes = ca.collocation_points(degree, form.points)
    slopes, ends, weights = ca.collocation_coeff(nodes)
    state, inner, span = ca.SX.sym("state", 2), ca.SX.sym("inner", 2 * degree), ca.SX.sym("span", 2)
    p = ca.SX.sym("p", len(observed.parameters) + 1)
    known = observed.named(p)
    own = stacked(*(known[name] for name in motion.names))
    size = span[1] * p[-1]
    states = ca.reshape(inner, 2, degree)
    rates, values = [], []
    for k, node in enumerate(nodes):
        time = span[0] * p[-1] + node * size
        rates.append(motion.function(time, states[:, k], own))
        values.append(observed.function(time, states[:, k], p[:-1]))
    polynomial = ca.horzcat(state, states)
    residual = size * ca.horzcat(*rates) - ca.mtimes(polynomial, slopes)
    signal = ca.horzcat(*values)
    mean = ca.mtimes(signal, weights)
    spread = ca.mtimes((signal - ca.repmat(mean, 1, degree))[: observed.squared, :] ** 2, weights)
    following = ca.mtimes(polynomial, ends)
    results = [following, ca.vec(residual), mean, spread]
    return ca.Function("interval", [state, inner, span, p], results), np.array(nodes)


def _path(
    structure: Structure, inputs: ca.DM, kink: float | None, places: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return the run of the start design, which gives the further unknowns their initial values and units.

    Args:
        structure: structure of the run's motion.
        inputs: numeric inputs of the run.
        kink: fraction of the duration at which the motion is not smooth, or None.
        places: times as fractions of the duration.

    Returns:
        States at the times in their units, one time after another; the largest value of each state; means and variances
        of the signals; and their sizes, from the root mean square of each signal. A unit that would be 0 is 1.
    """
    timeline = Timeline(_START_STEPS, _START_STEPS, kink)
    solver = integration(structure, Accuracy("dop853", steps=_START_STEPS), timeline)
    states, means, variances = (np.asarray(result) for result in solver.function.call([inputs]))
    averages, squares = np.concatenate([means.ravel(), variances.ravel()]), means.ravel() ** 2
    squares[: variances.size] += variances.ravel()
    size = np.concatenate([np.sqrt(squares), squares[: variances.size]])
    unit, size = (np.where(sizes > 0.0, sizes, 1.0) for sizes in (np.max(np.abs(states), axis=1), size))
    rows = [np.interp(places, timeline.output_fractions, row) for row in states]
    return (np.array(rows) / unit[:, None]).ravel(order="F"), unit, averages, size
