"""The periodic orbit under strength waves, and where a share that starts from equilibrium ends up.

Under waves of the soil's strength that repeat themselves every length ell, a motion may repeat itself with the period
T = ell/V0. Shooting finds the state to which one period of steps of order 8 returns, and CasADi differentiates the root
by the implicit function theorem. Both approximations are Fourier series: the linear response to the waves about steady
sliding, in closed form, and the harmonics that balance the equation of motion.

Several motions can persist: the orbit that repeats itself every wavelength, others that repeat themselves after
several, and some that never do. The Floquet multipliers of an orbit show whether a small deviation decays, but only an
integration from the start shows where the start leads. `which_motion` follows the share from wavelength to wavelength,
by the steps of the orbit, and compares its state at the end of each with the orbit's and with earlier ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.expressions import Column, stacked
from plough_opt.motion.effects import StrengthWaves, wave_names
from plough_opt.motion.equation import Equation, Structure, equation_of
from plough_opt.motion.run import Run, Settled
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.plan import numbers_of
from plough_opt.motion.solvers.steps import Array, Timeline, run_from, step

# For a root that it does not find, CasADi would print a page. Here such a root becomes NaN, which the caller reports as
# an IntegrationError.
MOST_ITERATIONS: Final = 60
_NEWTON_OPTIONS = {"abstol": 1e-12, "max_iter": MOST_ITERATIONS, "error_on_fail": False, "show_eval_warnings": False}
# Largest residual of a root, in units of `_size`.
_LARGEST_RESIDUAL = 1e-8
# The unit of the unknowns is proportional to the wave amplitude only above this value, so that derivatives exist at 0.
_LEAST_AMPLITUDE = 1e-3
# Samples of the resistance in the shortest wavelength. Harmonics up to the 14th do not alias onto the first one.
_SAMPLES = 16


def orbit_map(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return the Function of one period of the orbit: see `plough_opt.motion.solvers.integrators.Integration`.

    The duration, its last parameter, must be the period ell/V0.
    """
    if equation.structure.orbit == "periodic":
        return _shooting(equation, timeline)
    series = _linear(equation) if equation.structure.orbit == "linearised" else _balanced(equation)
    return _from_series(equation, timeline, series)


@lru_cache(maxsize=32)
def monodromy(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return (state at time 0, parameters) -> derivative of the state after one period by the state at time 0."""
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(equation.names) + 1)
    last = run_from(equation, timeline)(first, p)[0][:, -1]
    return ca.Function("monodromy", [first, p], [ca.jacobian(last, first)])


def _response(equation: Equation, column: ca.MX, p: dict[str, Column]) -> tuple[Column, Column, Column]:
    """Return the mean, the sine and the cosine coefficients of w [m] in the linear response about steady sliding.

    On the steady path L = V0 t, with theta = omega t, the resistance is Fm + sum of Fs sin(n theta) + Fc cos(n theta),
    where each wave makes n turns in the common length. The response solves M w'' + d w' + k0 w = that series, delayed
    by the phase 2 pi z0/ell of the start deflection, with d = c + dF/dL'. The coefficients are columns by the number n
    from 1 on.

    Args:
        equation: the equation of motion.
        column: its parameters with the duration last.
        p: the same by name.
    """
    repeats, omega, turns = _wave(equation).repeats(p), _frequency(equation, p), _turns(equation)
    mean, along_sine, along_cosine, slope = _series(equation)(column)
    n = ca.DM(turns)
    damping = equation.structure.pull(p, 0.0, 1.0) + slope
    spring, damped = p["stiffness"] - p["inertia"] * (n * omega) ** 2, damping * n * omega
    size = 1.0 / (spring**2 + damped**2)
    sine: Column = size * (spring * along_sine + damped * along_cosine)
    cosine: Column = size * (spring * along_cosine - damped * along_sine)
    lag: Column = n * (2.0 * math.pi / repeats * equation.structure.start_deflection(p))
    every = ca.DM.eye(turns[-1])[:, [turn - 1 for turn in turns]]
    sines = ca.mtimes(every, sine * ca.cos(lag) + cosine * ca.sin(lag))
    return mean / p["stiffness"], sines, ca.mtimes(every, cosine * ca.cos(lag) - sine * ca.sin(lag))


def _wave(equation: Equation) -> StrengthWaves:
    """Return the strength waves, which every scene with an orbit has."""
    assert equation.structure.wave is not None
    return equation.structure.wave


def _frequency(equation: Equation, p: dict[str, Column]) -> Column:
    """Return the angular frequency of an orbit [rad/s]."""
    found: Column = 2.0 * math.pi * p["tow_speed"] / _wave(equation).repeats(p)
    return found


def _turns(equation: Equation) -> list[int]:
    """Return how many turns each wave makes in the common length, ascending, each number once."""
    return sorted({*(_wave(equation).turns or (1,))})


@lru_cache(maxsize=32)
def _series(equation: Equation) -> ca.Function:
    """Return parameters -> Fourier coefficients of the resistance on the steady path, and its slope.

    The duration is the last of the parameters. The results are the mean change since the start [N], the sine and the
    cosine coefficients [N], columns by `_turns`, and the mean derivative by the speed [N s/m].
    """
    turns, (p, known) = _turns(equation), equation.symbols(ca.MX)
    count = _SAMPLES * turns[-1]
    phases = 2.0 * math.pi * np.arange(count) / count
    repeats: Column = _wave(equation).repeats(known)
    forces, slopes = equation.sliding.map(count)(ca.DM(phases).T / (2.0 * math.pi) * repeats, ca.repmat(p, 1, count))
    sines, cosines = (2.0 / count * function(np.outer(phases, turns)) for function in (np.sin, np.cos))
    found = [ca.sum2(forces) / count, *((forces @ ca.DM(b)).T for b in (sines, cosines)), ca.sum2(slopes) / count]
    return ca.Function("series", [p], found)


def _size(equation: Equation, p: dict[str, Column]) -> Column:
    """Return the unit [m] of an orbit's unknowns: the deflection by the waves' forces, slightly above zero."""
    amplitude = ca.sqrt(sum(p[wave_names(k)[0]] ** 2 for k in range(_wave(equation).count)) + _LEAST_AMPLITUDE**2)
    return amplitude * p["static"] / p["stiffness"] + 1e-30


@lru_cache(maxsize=32)
def near_orbit(equation: Equation) -> ca.Function:
    """Return parameters -> state (w [m], w' [m/s]) of the linear response at time 0, and the units of states."""
    p, known = equation.symbols(ca.MX)
    mean, sines, cosines = _response(equation, p, known)
    omega, size = _frequency(equation, known), _size(equation, known)
    turning = omega * ca.dot(ca.DM(range(1, sines.numel() + 1)), sines)
    state, unit = stacked(mean + ca.sum1(cosines), turning), stacked(size, size * omega)
    return ca.Function("near_orbit", [p], [state, unit])


def _shooting(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return the Function of the orbit whose state returns to itself after one period of steps."""
    p, x = ca.MX.sym("p", len(equation.names) + 1), ca.MX.sym("x", 2)
    guess, unit = near_orbit(equation)(p)
    once, whole = (run_from(equation, each) for each in (Timeline(1, timeline.steps), timeline))
    miss = (once(x * unit, p)[0][:, -1] - x * unit) / unit
    first = _root(x, p, miss, guess / unit) * unit
    return ca.Function("orbit", [p], list(whole(first, p)), {"never_inline": True})


# Change of a state, in units of `near_orbit`, by which the map of a period is differentiated. Curvature leaves
# errors of about 1e-6, rounding of 1e-10.
DIFFERENCE: Final = 1e-6
_SHIFTS: Final = DIFFERENCE * np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
# A step of Newton's method below this, in the same units, leaves about 1e-13.
LAST_STEP: Final = 1e-7


def returning(once: Callable[[NDArray[np.int64], Array], Array], guess: Array, unit: Array) -> tuple[Array, Array]:
    """Return the states to which one period returns, by Newton's method for many designs side by side.

    A step that does not bring a state nearer to its return is halved.

    Args:
        once: (numbers of the designs, states with a row each) -> states after one period.
        guess: states near the orbits, a row for each design.
        unit: of the states.

    Returns:
        The states, NaN where no orbit was found, and the derivatives of the states after one period by those at time 0,
        both in their units: (design, component after, component before).
    """
    found, slopes = np.full_like(guess, np.nan), np.full((*guess.shape, 2), np.nan)
    which = np.flatnonzero(np.isfinite(guess / unit).all(axis=1))
    # Of the designs that are still sought: the nearest states, Newton's steps from there, distances and slopes.
    best, nearest, slope, unit = (guess / unit)[which], np.full(len(which), np.inf), slopes[which], unit[which]
    change = np.zeros_like(best)
    for _ in range(MOST_ITERATIONS if len(which) else 0):
        tried = best + change
        with np.errstate(all="ignore"):
            shifted = ((tried + _SHIFTS) * unit).reshape(-1, 2)
            after = once(np.concatenate([which] * 3), shifted).reshape(3, -1, 2) / unit
            miss = tried - after[0]
            apart = np.hypot(miss[:, 0], miss[:, 1])
            slope_here = ((after[1:] - after[0]) / DIFFERENCE).transpose(1, 2, 0)
            step = (inverse(slope_here - np.eye(2)) @ miss[..., None])[..., 0]
        nearer = apart < nearest
        best, nearest = np.where(nearer[:, None], tried, best), np.where(nearer, apart, nearest)
        slope = np.where(nearer[:, None, None], slope_here, slope)
        change = np.where(nearer[:, None], step, change / 2.0)
        # A guess from which no motion returns is not nearer than infinity, and its change is 0.
        moves = np.abs(change).max(axis=1) >= LAST_STEP
        if moves.all():
            continue
        done = nearer & ~moves
        found[which[done]], slopes[which[done]] = ((best + change) * unit)[done], slope[done]
        which, best, change, nearest, slope, unit = (one[moves] for one in (which, best, change, nearest, slope, unit))
        if not len(which):
            break
    return found, slopes


def inverse(matrices: Array) -> Array:
    """Return the inverses of matrices of two rows, one for each design; not finite where a matrix is singular."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    with np.errstate(all="ignore"):
        return np.asarray(np.array([[d, -b], [-c, a]]) / (a * d - b * c)).transpose(2, 0, 1)


def without_orbit(scene: Scene) -> str:
    """Return the message of a scene for which no orbit was found."""
    return (
        f"no periodic orbit of a {scene.describe()} was found from its linear response: damp the mount, or use"
        " orbit = 'transient' to see whether the motion settles"
    )


def _linear(equation: Equation) -> ca.Function:
    """Return parameters -> Fourier coefficients of the linear response: mean, cosines, sines [m]."""
    p, known = equation.symbols(ca.MX)
    mean, sines, cosines = _response(equation, p, known)
    return ca.Function("linear", [p], [stacked(mean, cosines, sines)])


@lru_cache(maxsize=32)
def _balanced(equation: Equation) -> ca.Function:
    """Return parameters -> Fourier coefficients for which all harmonics kept balance the equation of motion."""
    count = equation.structure.harmonics
    samples = 4 * count + 12
    phases = 2.0 * math.pi * np.arange(samples) / samples
    basis, slope, bend = _basis(count, phases)
    (p, known), x = equation.symbols(ca.MX), ca.MX.sym("x", 2 * count + 1)
    mean, sines, cosines = _response(equation, p, known)
    omega = _frequency(equation, known)
    size = _size(equation, known)
    w, rate, acceleration = (size * ca.mtimes(ca.DM(b), x) for b in (basis, slope, bend))
    rate, acceleration = rate * omega, acceleration * omega**2
    states = stacked(w.T, rate.T)
    forced = equation.rate.map(samples)(ca.DM(phases).T / omega, states, ca.repmat(p[:-1], 1, samples))[1, :].T
    weights = np.where(np.arange(2 * count + 1) == 0, 1.0, 2.0)[:, None] * basis.T / samples
    # In units of the spring's and the inertia's accelerations, so that the residual is of order one.
    stiff = known["stiffness"] / known["inertia"] + omega**2
    out_of_balance = ca.mtimes(ca.DM(weights), acceleration - forced) / (size * stiff)
    higher = ca.MX.zeros(count - sines.numel())
    guess = stacked(mean / size, cosines / size, higher, sines / size, higher)
    return ca.Function("balanced", [p], [_root(x, p, out_of_balance, guess) * size])


def _root(x: ca.MX, p: ca.MX, residual: ca.MX, guess: ca.MX) -> ca.MX:
    """Return the x at which a residual vanishes, as a function of p; NaN if Newton's method does not find it."""
    solver = ca.rootfinder("orbit", "newton", {"x": x, "p": p, "g": residual}, _NEWTON_OPTIONS)
    found = solver(x0=guess, p=p)
    remaining = ca.Function("remaining", [x, p], [residual])(found["x"], p)
    return ca.if_else(ca.norm_inf(remaining) < _LARGEST_RESIDUAL, found["x"], np.nan)


def _basis(count: int, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return 1, cosines and sines at the phases, a column each, and their first and second derivatives by the phase."""
    k = np.arange(1, count + 1)
    angle = np.outer(phases, k)
    cosine, sine, zero = np.cos(angle), np.sin(angle), np.zeros((len(phases), 1))
    return (
        np.hstack([zero + 1.0, cosine, sine]),
        np.hstack([zero, -k * sine, k * cosine]),
        np.hstack([zero, -(k**2) * cosine, -(k**2) * sine]),
    )


def _from_series(equation: Equation, timeline: Timeline, series: ca.Function) -> ca.Function:
    """Return parameters -> states at the outputs, means and variances of a Fourier series of w."""
    p, known = equation.symbols(ca.MX)
    omega = _frequency(equation, known)
    x = series(p)
    count = (x.numel() - 1) // 2
    basis, slope, _ = _basis(count, 2.0 * math.pi * timeline.output_fractions)
    states = ca.horzcat(ca.mtimes(ca.DM(basis), x), omega * ca.mtimes(ca.DM(slope), x)).T
    cosines, sines = x[1 : count + 1], x[count + 1 :]
    means: list[Column] = [x[0]]
    variances = [ca.sumsqr(x[1:]) / 2.0]
    if equation.structure.damper:
        k, c = known["stiffness"], known["damping"] * omega * ca.DM(np.arange(1, count + 1))
        means.append(k * x[0])
        variances.append((ca.sumsqr(k * cosines + c * sines) + ca.sumsqr(k * sines - c * cosines)) / 2.0)
    return ca.Function("series", [p], [states, stacked(*means), stacked(*variances)], {"never_inline": True})


MOST_STEPS: Final = 50_000
"""Steps of order 8 after which a share that has not settled is given up; they take some tenths of a second."""

# Most and fewest wavelengths that one call integrates.
_MOST_AT_ONCE: Final = 32
_FEWEST_AT_ONCE: Final = 4
# Limit on the wavelengths if no deviation decays or grows: more would show nothing new.
_UNDAMPED: Final = 64
# Most wavelengths over which a motion is averaged that does not repeat itself.
_AVERAGED: Final = 256
# Distance from the orbit, in half ranges of the orbit, within which linear theory certainly holds. Deviations that
# change the character of the motion are of order one.
_NEAR: Final = 1e-2
# Within this distance it is enough that the deviation shrinks nearly as linear theory says ...
_NEAR_ENOUGH: Final = 0.3
# ... that is, to no more than this factor times the predicted deviation.
_NEARLY: Final = 1.5
# Longest period that is looked for [wavelengths].
_LONGEST_PERIOD: Final = 32
# Largest difference of states one period apart in a motion that repeats itself, in half ranges of the orbit. A largest
# multiplier that differs from 1 by less counts as 1.
_REPEATS: Final = 1e-6
# Relative rounding of states, which a chaotic motion would amplify: states that differ by less are the same.
_ROUNDING_OF_STATES: Final = 1e-13
# Factor on the orbit's steps for the averages of another motion, which may be faster.
_FINER_AVERAGES: Final = 2
# A multiplier that exceeds 1 by less may be that of an undamped mount, rounded.
_MARGINAL_MULTIPLIER = 1e-8
# Smallest unit of distances, as a part of the steady deflection: without a wave the orbit is a point.
_SMALLEST_UNIT: Final = 1e-9


def which_motion(run: Run) -> tuple[tuple[complex, ...], Settled, tuple[str, ...]]:
    """Return the Floquet multipliers [-] of a periodic orbit, where a share from equilibrium ends up, and warnings.

    Args:
        run: numeric run of the orbit.
    """
    path = _Path(run)
    # Derivatives by the start state are less exact than the states, so they take twice the orbit's steps.
    once = Timeline(1, 2 * path.steps)
    found = np.linalg.eigvals(monodromy(path.equation, once)(path.orbit, path.p).full())
    multipliers, largest = tuple(complex(value) for value in found), float(np.max(np.abs(found)))
    warnings: tuple[str, ...] = ()
    if largest > 1.0 + _MARGINAL_MULTIPLIER:
        grows = f"a deviation grows {largest:.4g} times in every wavelength, so no share stays on it"
        warnings = (f"the orbit is unstable: {grows}",)
    settled = _settled(path, largest)
    return multipliers, settled, (*warnings, *_warnings(settled, largest))


def _settled(path: _Path, largest: float) -> Settled:
    """Follow a share from equilibrium and return the motion in which it ends up.

    It is followed until it settles, for as many wavelengths as `MOST_STEPS` allow, and for 4 at least.

    Args:
        path: the share.
        largest: absolute value of the orbit's largest multiplier [-].
    """
    limit = MOST_STEPS // path.steps if abs(largest - 1.0) > _REPEATS else _UNDAMPED
    stable, distances = largest < 1.0 - _REPEATS, [math.inf]
    while True:
        path.follow()
        distance = path.distance
        if not math.isfinite(distance):
            return Settled(False, path.count, None, math.inf, path.count, math.inf, retreats=True)
        near = stable and distance < _NEAR and distance <= distances[-1]
        spent = path.count >= limit
        distances.append(distance)
        if near or (spent and stable and _shrinks(distances, largest ** (len(distances) // 2 * path.at_once))):
            return Settled(True, path.count, 1, float(path.run.force_rms), 1, distance, retreats=False)
        if period := path.period(largest):
            return Settled(False, path.count, period, *path.last(period, distance))
        if spent:
            return Settled(None, path.count, None, *path.last(min(_AVERAGED, path.count // 2), distance))


def _shrinks(distances: list[float], factor: float) -> bool:
    """Return whether the distance is small and has nearly shrunk by a factor in the second half of the time."""
    return distances[-1] < _NEAR_ENOUGH and distances[-1] < _NEARLY * factor * distances[len(distances) // 2]


def _warnings(settled: Settled, largest: float) -> tuple[str, ...]:
    """Return a warning unless a share from equilibrium comes to the orbit."""
    if settled.orbit:
        return ()
    if largest < 1.0 - _REPEATS:
        why = f", although the orbit is stable: a small deviation shrinks to {largest:.4g} in every wavelength"
    else:
        why = "" if largest > 1.0 + _REPEATS else ": nothing damps a deviation from the orbit"
    return (f"a share that starts from equilibrium {settled.text}{why}",)


class _Path:
    """A share that is followed from equilibrium, as its states at the ends of wavelengths.

    Attributes:
        run: the orbit.
        equation: the equation of motion.
        numbers: the equation's parameters by name.
        p: the same as a column, the period last.
        steps: of the orbit.
        unit: of distances in w and w': half ranges of the orbit.
        orbit: the orbit's state at time 0.
        states: of the share, a row for each wavelength followed and one for the start.
    """

    def __init__(self, run: Run) -> None:
        """Begin at equilibrium."""
        self.run, self.equation, self.numbers = run, equation_of(Structure.of(run.scene)), numbers_of(run.scene)
        self.steps = run.accuracy.steps or 1
        self.p = ca.DM(self.equation.column(self.numbers, float(run.duration)))
        first = float(self.equation.structure.start_deflection(self.numbers))
        w, rate = run.deflection - first, run.scene.tow_speed - run.speed
        frequency = max(float(run.scene.wave_frequency), float(run.scene.natural_frequency))
        range_of_w = max(float(np.ptp(w)) / 2.0, float(np.ptp(rate)) / 2.0 / frequency, _SMALLEST_UNIT * abs(first))
        self.unit: Array = np.array([1.0, frequency]) * (range_of_w or 1.0)
        self.orbit: Array = np.array([w[0], rate[0]])
        self.states: Array = np.zeros((1, 2))

    @property
    def count(self) -> int:
        """Number of wavelengths followed."""
        return len(self.states) - 1

    @property
    def at_once(self) -> int:
        """Number of wavelengths that one call of `follow` integrates: at most a quarter of what `MOST_STEPS` allow."""
        return max(_FEWEST_AT_ONCE, min(_MOST_AT_ONCE, MOST_STEPS // (4 * self.steps)))

    @property
    def distance(self) -> float:
        """Largest distance from the orbit at the ends of the last wavelengths, half as many as one call integrates."""
        return float(np.max(np.abs((self.states[-self.at_once // 2 :] - self.orbit) / self.unit)))

    def follow(self) -> None:
        """Integrate some more wavelengths."""
        ends = _wavelengths(self.equation, self.steps, self.at_once)(self.states[-1], self.p)
        self.states = np.vstack([self.states, ends.full().T])

    def period(self, largest: float) -> int | None:
        """Return the period [wavelengths] with which the last states repeat themselves away from the orbit, if any."""
        distance = self.distance
        # States near a slowly attracting orbit differ little too: by about (1 - multiplier) times their distance.
        least = _REPEATS * min(1.0, max(distance, _NEAR)) * min(1.0, max(abs(1.0 - largest), _REPEATS))
        scaled = self.states / self.unit
        least = max(least, _ROUNDING_OF_STATES * float(np.max(np.abs(scaled))))
        for period in range(1, min(_LONGEST_PERIOD, self.count // 2) + 1):
            apart = np.abs(scaled[-period:] - scaled[-2 * period : -period])
            if distance > _NEAR and float(np.max(apart)) < least:
                return period
        return None

    def last(self, count: int, distance: float) -> tuple[float, int, float, bool]:
        """Return the last attributes of `Settled`, from another integration of the last wavelengths.

        Args:
            count: number of wavelengths.
            distance: from the orbit, returned as it is.

        Returns:
            RMS of the mount force [N], number of wavelengths, distance, and whether the share retreats.
        """
        steps = count * _FINER_AVERAGES * self.steps
        timeline = Timeline(steps, steps)
        p = ca.vertcat(self.p[:-1], count * float(self.run.duration))
        found = run_from(self.equation, timeline)(self.states[-1 - count], p)
        states, means, variances = (np.asarray(result) for result in found)
        _, force_rms, *_ = self.equation.structure.averages(self.numbers, means.ravel(), variances.ravel())
        return float(force_rms), count, distance, bool(np.max(states[1]) > self.run.scene.tow_speed)


@lru_cache(maxsize=32)
def _wavelengths(equation: Equation, steps: int, count: int) -> ca.Function:
    """Return (state, parameters with the wave's period last) -> states at the ends of the next wavelengths.

    Time restarts with each of them, because the soil repeats itself every wavelength.
    """
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(equation.names) + 1)
    fractions = np.arange(steps) / steps
    spans = ca.DM(np.vstack([fractions, np.full(steps, 1.0 / steps)]))
    states, _ = step(equation).mapaccum(steps)(first, spans, ca.repmat(p, 1, steps))
    once = ca.Function("wavelength", [first, p], [states[:, -1]])
    return ca.Function("wavelengths", [first, p], [once.mapaccum(count)(first, ca.repmat(p, 1, count))])
