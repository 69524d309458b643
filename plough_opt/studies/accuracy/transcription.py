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
    """Nonlinear program: minimise f over x with low <= g <= high and lower <= x <= upper.

    Attributes:
        x: unknowns: the scaled variables, then those that the transcription adds, of order 1.
        f: scaled objective.
        g: blocks of constraints: the scaled requirements; then for each run the equalities of its motion, whose rows
            depend on few unknowns, and those of its averages, whose rows depend on all.
        low: lower limits of g.
        high: upper limits of g.
        lower: lower bounds of x.
        upper: upper bounds of x.
        start: initial x: a design, and the states of its run.
    """

    x: ca.MX
    f: ca.MX
    g: tuple[ca.MX, ...]
    low: Vector
    high: Vector
    lower: Vector
    upper: Vector
    start: Vector


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
    ties = [block for lift in lifts for block in lift.ties]
    start = np.concatenate([first, *(lift.start for lift in lifts)])
    free = np.full(len(start) - len(first), np.inf)
    zeros = np.zeros(sum(block.numel() for block in ties))
    return Transcribed(
        x=ca.vertcat(question.y, *(lift.unknowns for lift in lifts)),
        f=f,
        g=(g, *ties),
        low=np.r_[question.program.low, zeros],
        high=np.r_[question.program.high, zeros],
        lower=np.r_[np.zeros(len(first)), -free],
        upper=np.r_[np.ones(len(first)), free],
        start=start,
    )


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
    path = _Path.of(structure, inputs, kink)
    function, points = _segment(structure, form.steps) if form.steps else _collocated(structure, form)
    mesh = Timeline(outputs, form.intervals, kink)
    lengths = np.diff(mesh.nodes)
    count, inner = len(lengths), 2 * len(points)
    nodes, within = ca.MX.sym("nodes", 2 * count), ca.MX.sym("within", inner * count)
    mean, variance = ca.MX.sym("mean", observed.count), ca.MX.sym("variance", observed.squared)

    unit, inner_unit = ca.DM(path.units), ca.DM(np.tile(path.units, len(points)))
    scaled = ca.reshape(nodes, 2, count) * ca.repmat(unit, 1, count)
    states = ca.horzcat(start_state(structure, observed.named(run.inputs)), scaled)
    following, residual, means, spreads = function.map(count)(
        states[:, :count],
        ca.reshape(within, inner, count) * ca.repmat(inner_unit, 1, count),
        ca.DM(np.vstack([mesh.nodes[:-1], lengths])),
        ca.repmat(run.inputs, 1, count),
    )
    size, square = ca.DM(path.sizes), ca.DM(path.sizes[: observed.squared] ** 2)
    drift = means[: observed.squared, :] - ca.repmat((mean * size)[: observed.squared], 1, count)
    gaps = (following - states[:, 1:]) / ca.repmat(unit, 1, count)
    motion = ca.vertcat(ca.vec(gaps), ca.vec(residual / ca.repmat(inner_unit, 1, count)))
    pooled = [means @ ca.DM(lengths) / size - mean, (spreads + drift**2) @ ca.DM(lengths) / square - variance]
    places = (mesh.nodes[:-1, None] + lengths[:, None] * points).ravel()
    averages = [path.means / path.sizes, path.variances / path.sizes[: observed.squared] ** 2]
    return _Lift(
        results=_as_written(run, [ca.vec(states[:, mesh.output_columns]), mean * size, variance * square]),
        unknowns=ca.vertcat(nodes, within, mean, variance),
        ties=(motion, ca.vertcat(*pooled)),
        start=np.concatenate([path.at(mesh.nodes[1:]), path.at(places), *averages]),
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


@dataclass(frozen=True)
class _Path:
    """Run of the start design, which gives the further unknowns their initial values and units.

    Attributes:
        fractions: times as fractions of the duration.
        states: states at these times, a row for each state.
        means: means of the signals.
        variances: variances of the signals with an RMS.
        units: largest value of each state; 1 if it is always zero.
        sizes: root mean square of each signal; 1 if it is always zero.
    """

    fractions: Vector
    states: Vector
    means: Vector
    variances: Vector
    units: Vector
    sizes: Vector

    @classmethod
    def of(cls, structure: Structure, inputs: ca.DM, kink: float | None) -> _Path:
        """Return the path of a run with numeric inputs."""
        timeline = Timeline(_START_STEPS, _START_STEPS, kink)
        solver = integration(structure, Accuracy("dop853", steps=_START_STEPS), timeline)
        states, means, variances = (np.asarray(result) for result in solver.function.call([inputs]))
        squares = means.ravel() ** 2
        squares[: len(variances)] += variances.ravel()
        largest, sizes = np.max(np.abs(states), axis=1), np.sqrt(squares)
        units, sizes = (np.where(found > 0.0, found, 1.0) for found in (largest, sizes))
        return cls(timeline.output_fractions, states, means.ravel(), variances.ravel(), units, sizes)

    def at(self, fractions: Vector) -> Vector:
        """Return the states at some fractions of the duration, in their units, one time after another."""
        rows = [np.interp(fractions, self.fractions, row) for row in self.states]
        return (np.array(rows) / self.units[:, None]).ravel(order="F")
