"""References that do not compete: a motion in the machine's widest floats, and gradients of its averages.

Each smooth piece of the motion is a chain of Chebyshev polynomials over time, found by Picard iteration. Their last
coefficients show how accurate a step is. An event ends a piece at the root of its polynomial, to all digits, and
averages are quadratures of the polynomials by the rule of Clenshaw and Curtis. Clenshaw, Norton: The solution of
nonlinear ordinary differential equations in Chebyshev series, Computer Journal 6 (1963), 88-92.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final, TypeAlias

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev

from plough_opt.core.compiler import instructions
from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.motion import Run, simulate
from plough_opt.motion.batch.series import EXPRESSIONS, Interpreter
from plough_opt.motion.equation import GAP, SLIP, STICK, Structure, equation_of, lightest_mass, parameters
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.integrators import assemble
from plough_opt.motion.solvers.plan import rates_of

LONGDOUBLE: Final = np.longdouble
"""Widest float type of the machine: 64 bits of mantissa on x86, elsewhere often the 53 of a double."""

EPS: Final = np.finfo(LONGDOUBLE).eps
"""Relative spacing of `LONGDOUBLE` at 1."""

HAS_EXTENDED: Final = bool(np.finfo(LONGDOUBLE).eps < np.finfo(np.float64).eps)
"""Whether the machine has floats wider than a double."""

PI: Final = LONGDOUBLE("3.14159265358979323846264338327950288419716939937511")

LongDouble: TypeAlias = Any
"""Number or array of `LONGDOUBLE` floats."""

Rates: TypeAlias = Callable[[LongDouble, LongDouble], LongDouble]
"""Function (times, states) -> rates of the states, a row each."""

DEGREE: Final = 24
"""Degree of the polynomials of a reference."""

CHECK_DEGREE: Final = 18
"""Degree of the polynomials of the solution whose difference estimates the error of a reference."""

QUANTITIES: Final = ("stiffness", "mass", "tow_speed")
"""Quantities of a scene that gradients are taken with respect to."""

AVERAGES: Final = ("mean_draft", "force_rms")
"""Averages whose gradients are taken."""

# Weights of f(k) for k = -4 to -1 and 1 to 4 in the derivative at 0: central differences of order 8.
_HALF: Final = (LONGDOUBLE(4) / 5, -LONGDOUBLE(1) / 5, LONGDOUBLE(4) / 105, -LONGDOUBLE(1) / 280)
_PLACES: Final = (-4, -3, -2, -1, 1, 2, 3, 4)
_WEIGHTS: Final = np.sign(_PLACES) * np.array([*_HALF[::-1], *_HALF])
# Most steps of a whole motion; they take minutes.
_MOST_STEPS = 400_000
# Number of steps between two checks whether that will be enough.
_CHECKED_EVERY = 2000
# Events at one time after which the motion counts as stuck there.
_MOST_AT_ONCE = 12
# Shortest step, in parts of the duration.
_SHORTEST = 1e-16
# Part of a step's coefficients that should be above rounding. The length of the next step is chosen for that.
_USED = 0.9
# A smaller mismatch of a periodic orbit, in units in the last place, is rounding once it no longer shrinks.
_ORBIT_STALLED = 1e4
# Most iterations of Newton's method for a periodic orbit.
_MOST_NEWTON = 20
# Names of the events that end each mode of contact: with stick-slip, and for an entering share without it.
_ENDS_OF_CONTACT: Final = {SLIP: "stop", STICK: "move", GAP: "recapture"}
_ENDS_OF_ENTRY: Final = {SLIP: "retreat", GAP: "advance"}
# Most Picard iterations of a step.
_MOST_PICARD = 60
# Changes by an iteration, in units in the last place. It has converged at or below this.
_CONVERGED = 4.0
# Below this it has converged, too, if the changes no longer shrink: they are rounding.
_PICARD_STALLED = 1e4
# From here on it diverges.
_DIVERGED = 1e40
# A coefficient below this many units in the last place is rounding.
_NO_COEFFICIENT = 4.0
# Values below this many units in the last place of the largest value have no certain sign.
_NO_SIGN = 1e3
# Degree of the polynomial that locates events in a step.
_EVENT_DEGREE = 48
# Parts of each subdivision of the interval around an event, and subdivisions: enough for one unit in the last place.
_PARTS, _SUBDIVISIONS = 32, 14

# Operations that NumPy has for the widest floats: all but the error function, which is SciPy's.
_OPERATIONS: Final = {*EXPRESSIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT} - {ca.OP_ERF}

# --- errors and estimates of errors ---


def errors_of(run: Any, reference: Any) -> dict[str, float]:
    """Return the relative errors of averages and mount forces by name [-].

    Errors of mean draft and RMS are relative to the larger of the two, and ``"averages"`` is the larger of both errors.
    Errors of mount forces are relative to the largest of the forces.

    Args:
        run: a run, or another object with ``mean_draft``, ``force_rms`` and, at the outputs, ``mount_force`` [N].
        reference: the same kind of object with the same output times.
    """
    size = max(abs(reference.mean_draft), reference.force_rms)
    averages = {
        "mean draft": _over(abs(run.mean_draft - reference.mean_draft), size),
        "RMS": _over(abs(run.force_rms - reference.force_rms), size),
    }
    peak = np.max(np.abs(reference.mount_force))
    wrong = np.abs(np.asarray(run.mount_force) - reference.mount_force)
    forces = {"last force": _over(wrong[-1], peak), "trajectory": _over(np.max(wrong), peak)}
    return {"averages": max(averages.values()), **averages, **forces}


def _over(difference: Any, size: Any) -> float:
    return float(difference / size) if size > 0 else float(difference)


@dataclass(frozen=True)
class Reference:
    """Motion of a scene in the widest floats.

    Attributes:
        run: its results, like those of any run.
        events: time [s] and name of each event.
        errors: estimates of its own relative errors, by the names of `errors_of` [-]. They are the differences from a
            solution by polynomials of another degree, and so with other steps; at least the rounding of the floats.
    """

    run: Run
    events: tuple[tuple[LongDouble, str], ...]
    errors: Mapping[str, float]

    @property
    def error(self) -> float:
        """Largest of its errors [-]."""
        return max(self.errors.values())


def reference_run(scene: Scene, duration: float | None = None, *, outputs: int = 400) -> Reference:
    """Return the motion of a scene in the widest floats.

    Args:
        scene: scene with numbers and a motion; ``orbit`` is ``"transient"`` or ``"periodic"``.
        duration: simulated time [s]; ignored for a periodic orbit, which has its own.
        outputs: number of equal intervals between output times.

    Raises:
        InputError: the scene has no reference; the message says why.
        IntegrationError: the motion could not be integrated.
    """
    motion_of = _integrator(scene, duration)
    motion, check = (motion_of(scene, outputs, degree) for degree in (DEGREE, CHECK_DEGREE))
    run = motion.run()
    errors = {name: max(float(EPS), error) for name, error in errors_of(check.run(), run).items()}
    return Reference(run, motion.events, errors)


def _integrator(scene: Scene, duration: float | None) -> Callable[[Scene, int, int], IntegratedMotion]:
    """Return (scene like this one, outputs, degree) -> its motion or, if the scene asks for it, its periodic orbit."""
    if scene.effects.motion and scene.effects.orbit == "periodic":
        # A simulation decides which orbit is found, not its digits.
        run, first = simulate(scene, outputs=1), Structure.of(scene).start_deflection(parameters(scene))
        guess = np.array([run.deflection[0] - first, float(scene.tow_speed) - run.speed[0]], LONGDOUBLE)
        return lambda like, outputs, degree: periodic_orbit(Motion(like), guess, outputs, degree)
    if scene.effects.orbit == "transient" and duration is None:
        raise InputError("the duration is missing: give the simulated time of the reference in seconds")
    return lambda like, outputs, degree: integrate(Motion(like), LONGDOUBLE(duration), outputs, degree)


@dataclass(frozen=True)
class ReferenceGradient:
    """Logarithmic derivatives x d/dx of averages.

    Attributes:
        values: derivatives of `AVERAGES`, a row each, by `QUANTITIES`, a column each [N].
        error: their estimated error, relative to the largest of them [-].
    """

    values: LongDouble
    error: float


def reference_gradient(scene: Scene, duration: float | None) -> ReferenceGradient:
    """Return the gradient of mean draft and RMS by central differences of order 8 of the reference motion.

    The error is estimated from differences with two lengths of steps.

    Args:
        scene: scene with numbers.
        duration: simulated time [s]; None for a periodic orbit.

    Raises:
        InputError: as for `reference_run`.
        IntegrationError: as for `reference_run`, or the events change within the steps of the differences.
    """
    motion_of = _integrator(scene, duration)

    def difference(name: str, h: LongDouble) -> LongDouble:
        values = [LONGDOUBLE(getattr(scene, name)) * (1 + k * h) for k in _PLACES]
        motions = [motion_of(replace(scene, **{name: value}), 1, DEGREE) for value in values]
        if len({tuple(event for _, event in motion.events) for motion in motions}) > 1:
            raise IntegrationError("the events change with the quantities of the scene, so there is no gradient")
        runs = [motion.run() for motion in motions]
        return _WEIGHTS @ np.array([[getattr(run, average) for average in AVERAGES] for run in runs]) / h

    def differences(h: LongDouble) -> LongDouble:
        return np.array([difference(name, h) for name in QUANTITIES]).T

    # The quantities shift the phase of oscillation and wave, so the step shrinks with the whole phase. An orbit has one
    # turn.
    phase = 2.0 * math.pi if duration is None else rates_of(scene).fastest * duration
    h = LONGDOUBLE(2.0 ** -(7 + math.ceil(math.log2(1.0 + phase / 8.0))))
    coarse, fine = differences(h), differences(h / 4)
    size = np.max(np.abs(fine))
    # The error with the longer steps is 4^8 times as large. Dividing by only 4^4 leaves a margin of 4^4.
    wrong = np.max(np.abs(fine - coarse)) / (size if size > 0 else 1) / 4.0**4
    return ReferenceGradient(fine, float(max(wrong, 100 * EPS / h)))


# --- a motion and a periodic orbit ---


@lru_cache(maxsize=8)
def _graphs(structure: Structure) -> tuple[dict[str, LongDoubleGraph], tuple[str, ...]]:
    """Return a structure's rate, signals, start and events in wide floats, and the names of their parameters."""
    equation = equation_of(structure)
    graphs = {name: in_long_double(getattr(equation, name)) for name in ("rate", "signals", "start")}
    if equation.events is not None:
        graphs |= {name: in_long_double(equation.events, k) for k, name in enumerate(("zero", "after"))}
    return graphs, equation.names


class Motion:
    """Equation of motion of a scene in the widest floats.

    Attributes:
        scene: the scene, with wide numbers.
        structure: terms of its equation of motion.
        p: parameters by name.
        swing: inverse of the largest angular frequency of the share on its mount [s].
        scales: sizes of the deviation w [m] and its rate w' [m/s], to which rounding is relative.
        kinks: times [s] at which the strut's motion is not smooth, unless they are events.
        start: state at time 0.
    """

    def __init__(self, scene: Scene) -> None:
        """Compute the parameters and the start of a scene with numbers.

        Raises:
            InputError: the scene is quasi-static.
        """
        if not scene.effects.motion:
            raise InputError("a quasi-static scene has no motion to integrate")
        speed = LONGDOUBLE(scene.tow_speed)
        self.scene = replace(scene, stiffness=LONGDOUBLE(scene.stiffness), mass=LONGDOUBLE(scene.mass), tow_speed=speed)
        self.structure = Structure.of(scene)
        self._graph, names = _graphs(self.structure)
        self.p = {name: LONGDOUBLE(value) for name, value in parameters(self.scene).items()}
        self._numbers = [self.p[name] for name in names]
        stiffness = abs(self.p["stiffness"])
        hardness = np.sqrt(stiffness * lightest_mass(self.p))
        self.swing = hardness / stiffness
        # Rounding comes from the forces and, unless the start is steady, from the speed that the mount must take up.
        # Soil without resistance leaves the rounding of the latter.
        steady = self.structure.start == "equilibrium" and not self.structure.accelerates
        least = speed * hardness * (EPS if steady else 1)
        force = self.structure.start_resistance(self.p) + least
        self.scales = np.array([force / stiffness, force / hardness])
        self.kinks: list[LongDouble] = []
        if self.structure.profile is not None:
            self.kinks = [LONGDOUBLE(time) for time in self.structure.profile.profile.times]
        elif "ramp_time" in self.p and not self.structure.ends_ramp:
            self.kinks = [self.p["ramp_time"]]
        self.start: LongDouble = self._graph["start"](self._numbers)[:, 0]

    def rates(self, times: LongDouble, states: LongDouble) -> LongDouble:
        """Return the rates of the states, a row each, at times."""
        return self._graph["rate"]([times], states, self._numbers)

    def signals(self, times: LongDouble, states: LongDouble) -> LongDouble:
        """Return the signals that are averaged, a row each, at times."""
        return self._graph["signals"]([times], states, self._numbers)

    def names(self, state: LongDouble) -> list[str]:
        """Return the names of the events that can end the piece of motion beginning with a state."""
        if not self.structure.events:
            return []
        ends = _ENDS_OF_CONTACT if self.structure.sticks else _ENDS_OF_ENTRY
        counted = (term.state for term in self.structure.ending)
        return [ends[round(float(state[3]))], *("buried" if name == "entered" else str(name) for name in counted)]

    def next_event(self, state: LongDouble, done: Step, end: LongDouble) -> tuple[LongDouble, int | None]:
        """Return time and number of the event that ends a piece of motion in a step; without one, its end and None.

        Args:
            state: at the start of the piece, which decides the possible events.
            done: the step.
            end: of the step, or earlier [s].

        Raises:
            IntegrationError: a force that decides on the event is not finite.
        """

        def until(kind: int, times: LongDouble) -> LongDouble:
            values = self._graph["zero"]([times], done.at(times), self._numbers)[kind]
            if not np.all(np.isfinite(values)):
                raise _stopped("stops", done.start, "a force is not finite there")
            return values

        first = None
        for kind in range(len(self.names(state))):
            sooner = first_end(partial(until, kind), done.start, end - done.start)
            if sooner is not None and (first is None or sooner < end):
                end, first = sooner, kind
        return end, first

    def after(self, kind: int, time: LongDouble, state: LongDouble) -> LongDouble:
        """Return the state after an event.

        Args:
            kind: number of the event.
            time: of the event [s].
            state: before the event.
        """
        columns = self._graph["after"]([np.array([time])], state[:, None], self._numbers)
        return columns.reshape(-1, len(state))[kind]


@dataclass(frozen=True)
class IntegratedMotion:
    """Integrated motion.

    Attributes:
        motion: its equation.
        times: output times [s].
        states: states at the output times, a row each.
        events: time and name of each event.
        moments: means of the signals, and variances of those with an RMS.
    """

    motion: Motion
    times: LongDouble
    states: LongDouble
    events: tuple[tuple[LongDouble, str], ...]
    moments: tuple[LongDouble, LongDouble]

    def run(self) -> Run:
        """Return the run of the scene that has these states and averages."""
        motion, duration = self.motion, self.times[-1]
        fractions = self.times / duration
        return assemble(motion.scene, motion.p, duration, fractions, self.states, *self.moments, Accuracy())


def integrate(
    motion: Motion, duration: LongDouble, outputs: int, degree: int, first: LongDouble | None = None
) -> IntegratedMotion:
    """Integrate a motion once.

    Args:
        motion: equation of motion.
        duration: simulated time [s].
        outputs: number of equal intervals between output times.
        degree: degree of the polynomials.
        first: state at the start; default that of the scene.

    Raises:
        IntegrationError: steps or pauses between events become too short, or too many steps are needed.
    """
    state = motion.start if first is None else first
    times = duration * np.arange(outputs + 1) / LONGDOUBLE(outputs)
    # Rounding may put the last output behind the end, which no step reaches.
    times[-1] = duration
    states: list[LongDouble] = []
    integrals: list[tuple[LongDouble, LongDouble]] = []
    events: list[tuple[LongDouble, str]] = []
    now, size, at_once, steps = LONGDOUBLE(0), motion.swing, 0, 0
    while now < duration:
        stop = next((kink for kink in motion.kinks if now < kink < duration), duration)
        # The last step is a little longer rather than leaving almost nothing for another one.
        whole = stop - now <= size * LONGDOUBLE(1.001)
        done = step(degree, now, stop - now if whole else size, state, motion.rates, motion.scales)
        if done is None:
            size = min(size, stop - now) / 2
            if size < _SHORTEST * duration:
                raise _stopped("stops", now, "the forces are not smooth there")
            continue
        steps += 1
        if steps % _CHECKED_EVERY == 0 and now * _MOST_STEPS < steps * duration:
            raise _stopped(f"would take more than {_MOST_STEPS} steps", now, "the forces change too fast there")
        end, kind = motion.next_event(state, done, stop if whole else now + size)
        states += list(done.at(times[len(states) : int(np.searchsorted(times, end, "right"))]).T)
        integrals.append(_integrands(motion, done, end))
        at_once = at_once + 1 if kind is not None and end - now <= 4 * EPS * end else 0
        if at_once > _MOST_AT_ONCE:
            raise _stopped("hangs", now, "events repeat endlessly")
        names = motion.names(state)
        now, state = end, done.at(np.array([end]))[:, 0]
        if kind is not None:
            events.append((now, names[kind]))
            state = motion.after(kind, now, state)
        if not whole or done.used > _USED:
            size = done.size * LONGDOUBLE(min(2.0, max(0.5, _USED / max(done.used, 0.1))))
    return IntegratedMotion(motion, times, np.array(states), tuple(events), _moments(motion, integrals))


def _stopped(what: str, now: LongDouble, why: str) -> IntegrationError:
    return IntegrationError(f"the reference {what} at t = {float(now):.6g} s: {why}")


def _integrands(motion: Motion, done: Step, end: LongDouble) -> tuple[LongDouble, LongDouble]:
    """Return weights of an integral over a step up to its end or an event [s], and the signals at its nodes.

    The rule of Clenshaw and Curtis has twice the degree of the polynomials, because variances are squares.
    """
    basis = Basis.of(2 * done.coefficients.shape[1] - 2)
    half = (end - done.start) / 2
    inner = done.start + half * (basis.nodes + 1)
    return half * basis.integral[-1], motion.signals(inner, done.at(inner))


def _moments(motion: Motion, integrals: list[tuple[LongDouble, LongDouble]]) -> tuple[LongDouble, LongDouble]:
    """Return means and variances of the signals; two passes avoid cancellation."""
    weights, values = (np.concatenate(parts, axis=-1) for parts in zip(*integrals, strict=True))
    shares = weights / np.sum(weights)
    means = values @ shares
    return means, (values - means[:, None])[: equation_of(motion.structure).squared] ** 2 @ shares


def periodic_orbit(motion: Motion, guess: LongDouble, outputs: int, degree: int) -> IntegratedMotion:
    """Return the periodic orbit near a state, by Newton's method on the motion over one period.

    Args:
        motion: equation of motion.
        guess: state near the orbit's start.
        outputs: number of equal intervals between output times.
        degree: degree of the polynomials.

    Raises:
        IntegrationError: no orbit was found.
    """
    period, speed, state = motion.scene.wave_period, motion.scene.tow_speed, guess
    unit = np.array([abs(state[0]) + speed * period / (2 * PI), speed])

    def after(first: LongDouble) -> LongDouble:
        return integrate(motion, period, 1, degree, first).states[-1]

    nudges = np.diag(LONGDOUBLE(math.sqrt(EPS)) * unit)
    columns = [(after(guess + nudge) - after(guess - nudge)) / (2 * np.max(nudge)) for nudge in nudges]
    slope, least = np.array(columns, float).T - np.eye(2), np.inf
    for _ in range(_MOST_NEWTON):
        miss = after(state) - state
        size = float(np.max(np.abs(miss) / unit))
        if size <= 2 * EPS or (size < _ORBIT_STALLED * EPS and size >= least):
            return integrate(motion, period, outputs, degree, state)
        least = size
        # The guess and a step have the digits of a double: each step adds as many again.
        state = state - np.linalg.solve(slope, miss.astype(float))
    raise IntegrationError("no periodic orbit was found near that of the simulation")


# --- CasADi graphs, steps and events in the widest floats ---

LongDoubleGraph: TypeAlias = Callable[..., LongDouble]
"""Function with one sequence of elements for each argument, each a number or an array over places.

It returns an array with a row for each element of the result and a column for each place.
"""


def in_long_double(function: ca.Function, result: int = 0) -> LongDoubleGraph:
    """Return a CasADi Function of scalars as one that computes in the widest floats.

    Args:
        function: the Function, of SX.
        result: number of its result that is computed.

    Raises:
        InputError: the graph has an operation without a counterpart here, such as the lookup in a table.
    """
    arguments = function.sx_in()
    graph = ca.Function("graph", arguments, [ca.densify(function.call(arguments)[result])])
    if not {code for code, *_ in instructions(graph)} <= _OPERATIONS:
        raise InputError("an effect of your own uses a function that wide floats cannot compute, such as a table")
    interpreter = Interpreter(graph)

    def evaluate(*given: Sequence[LongDouble]) -> LongDouble:
        places = max(np.size(element) for argument in given for element in argument)
        found = np.empty((graph.numel_out(0), places), LONGDOUBLE)
        interpreter.evaluate(*given, found)
        return found

    return evaluate


@dataclass(frozen=True)
class Basis:
    """Chebyshev nodes of a degree on [-1, 1], with matrices for values at the nodes.

    Attributes:
        nodes: nodes from -1 to 1, both ends included.
        coefficients: matrix from values at the nodes to Chebyshev coefficients.
        integral: matrix from values at the nodes to integrals from -1 to each node.
    """

    nodes: LongDouble
    coefficients: LongDouble
    integral: LongDouble

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, degree: int) -> Basis:
        """Return the basis of a degree."""
        k = np.arange(degree + 1)
        nodes = -np.cos(PI * k / degree)
        ends = np.where((k == 0) | (k == degree), LONGDOUBLE(0.5), LONGDOUBLE(1.0))
        coefficients = 2 * np.cos(PI * np.outer(k, degree - k) / degree) * ends[:, None] * ends[None, :] / degree
        antiderivative = chebyshev.chebint(coefficients, lbnd=-1)
        return cls(nodes, coefficients, chebyshev.chebvander(nodes, degree + 1) @ antiderivative)


@dataclass(frozen=True)
class Step:
    """Solution of a step: Chebyshev polynomials over time.

    Attributes:
        start: start of the step [s].
        size: length of the step [s].
        coefficients: Chebyshev coefficients, a row for each state.
        used: number of the second state's coefficients above rounding, divided by the degree; 1 if only the last is
            not.
    """

    start: LongDouble
    size: LongDouble
    coefficients: LongDouble
    used: float

    def at(self, times: LongDouble) -> LongDouble:
        """Return the states, a row each, at times within the step."""
        places = 2 * (times - self.start) / self.size - 1
        return chebyshev.chebval(places, self.coefficients.T)


def step(
    degree: int, start: LongDouble, size: LongDouble, first: LongDouble, rates: Rates, scales: LongDouble
) -> Step | None:
    """Return the solution of one step, or None if the step is too long for the degree.

    Args:
        degree: degree of the polynomials.
        start: start of the step [s].
        size: length of the step [s].
        first: states at the start; the second is the rate of the first.
        rates: rates of the states.
        scales: sizes of the first two states, to which rounding is relative.
    """
    basis = Basis.of(degree)
    times = start + size * (basis.nodes + 1) / 2
    # A step that is too long may overflow before its divergence is detected.
    with np.errstate(over="ignore", invalid="ignore"):
        states = _solved(size / 2 * basis.integral, times, first, rates, scales)
    if states is None:
        return None
    coefficients = states @ basis.coefficients.T
    largest = max(scales[1], np.max(np.abs(states[1])))
    above = np.flatnonzero(np.abs(coefficients[1]) > _NO_COEFFICIENT * EPS * largest)
    used = (1.0 + above[-1]) / degree if above.size else 0.0
    return None if used > 1.0 else Step(start, size, coefficients, used)


def _solved(
    integral: LongDouble, times: LongDouble, first: LongDouble, rates: Rates, scales: LongDouble
) -> LongDouble | None:
    """Return the states at the nodes by Picard iteration, or None if it does not converge."""
    states = first[:, None] + np.zeros(len(times), LONGDOUBLE)
    states[0] += first[1] * (times - times[0])
    last = np.inf
    for _ in range(_MOST_PICARD):
        new = first[:, None] + rates(times, states) @ integral.T
        new[0] = first[0] + integral @ new[1]
        sizes = np.maximum(scales, np.max(np.abs(new[:2]), axis=1))
        moved = float(np.max(np.max(np.abs(new - states)[:2], axis=1) / sizes) / EPS)
        states = new
        if not moved < _DIVERGED:
            return None
        if moved <= _CONVERGED or (moved < _PICARD_STALLED and moved >= last):
            return states
        last = moved
    return None


def first_end(function: Callable[[LongDouble], LongDouble], start: LongDouble, size: LongDouble) -> LongDouble | None:
    """Return the first time in a step after which a smooth function is negative, or None.

    The roots of its Chebyshev interpolant, in doubles, part the step into pieces without a change of sign. Repeated
    subdivision around one of them adds the digits of wide floats.

    Args:
        function: function of an array of times; positive or zero at the start.
        start: start of the step [s].
        size: length of the step [s].
    """

    def at(places: LongDouble) -> LongDouble:
        return function(start + size * (places + 1) / 2)

    basis = Basis.of(_EVENT_DEGREE)
    values = at(basis.nodes)
    zero = _NO_SIGN * EPS * np.max(np.abs(values))
    series = chebyshev.chebtrim((basis.coefficients @ values).astype(float), float(zero))
    if series[0] > np.sum(np.abs(series[1:])):
        return None
    # Keep complex roots too: rounding may make them of two real ones, and one piece more does no harm.
    roots = chebyshev.chebroots(series).real
    ends = np.concatenate([[-1.0], np.sort(roots[np.abs(roots) < 1.0]), [1.0]])
    middles = (ends[1:] + ends[:-1]) / LONGDOUBLE(2)
    negative = np.flatnonzero(at(middles) < -zero)
    if not negative.size:
        return None
    if not negative[0]:
        return start
    low, high = middles[negative[0] - 1], middles[negative[0]]
    for _ in range(_SUBDIVISIONS):
        places = low + (high - low) * np.arange(_PARTS + 1) / LONGDOUBLE(_PARTS)
        first = max(1, int(np.argmax(at(places) < 0.0)))
        low, high = places[first - 1], places[first]
    return start + size * (high + 1) / 2
