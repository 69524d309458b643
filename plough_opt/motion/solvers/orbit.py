"""The periodic orbit under strength waves, and where a share that starts from equilibrium ends up.

Under waves of the soil's strength that repeat themselves every length ell, a motion may repeat itself with the period
T = ell/V0. Newton's method on the return map, by steps of order 8, finds the state to which one period returns. It
begins at the linear response to the waves about steady sliding.

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

from plough_opt.core.expressions import Column, sqrt, stacked
from plough_opt.motion.effects import wave_names
from plough_opt.motion.equation import Equation, Structure, equation_of
from plough_opt.motion.run import Run, Settled
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.plan import numbers_of
from plough_opt.motion.solvers.steps import Array, Timeline, run_from, step

# For a root that it does not find, CasADi would print a page. Here such a root becomes NaN, which the caller reports as
# an IntegrationError.
MOST_ITERATIONS: Final = 60
_NEWTON_OPTIONS = {"abstol": 1e-12, "max_iter": MOST_ITERATIONS, "error_on_fail": False, "show_eval_warnings": False}
# Samples of the resistance in the shortest wavelength. Harmonics up to the 14th do not alias onto the first one.
_SAMPLES = 16


def orbit_map(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return the Function of one period of the orbit: see `plough_opt.motion.solvers.integrators.Integration`.

    The duration, its last parameter, must be the period ell/V0.
    """
    p = ca.MX.sym("p", len(equation.names) + 1)
    results = run_from(equation, timeline)(orbit_start(equation, timeline)(p), p)
    return ca.Function("orbit", [p], list(results), {"never_inline": True})


@lru_cache(maxsize=32)
def orbit_start(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return parameters -> state to which a period returns, by Newton's method; NaN if it finds none."""
    p, x = ca.MX.sym("p", len(equation.names) + 1), ca.MX.sym("x", 2)
    guess, unit = near_orbit(equation)(p)
    miss = (run_from(equation, timeline)(x * unit, p)[0][:, -1] - x * unit) / unit
    solver = ca.rootfinder("orbit", "newton", {"x": x, "p": p, "g": miss}, _NEWTON_OPTIONS)
    root = solver(x0=guess / unit, p=p)["x"]
    remaining = ca.Function("remaining", [x, p], [miss])(root, p)
    # Largest residual of a root, in units of `near_orbit`.
    state = ca.if_else(ca.norm_inf(remaining) < 1e-8, root, np.nan) * unit
    return ca.Function("orbit_start", [p], [state])


@lru_cache(maxsize=32)
def near_orbit(equation: Equation) -> ca.Function:
    """Return parameters -> state (w [m], w' [m/s]) of the linear response at time 0, and the units of states.

    On the steady path L = V0 t, with theta = omega t, the resistance is Fm + sum of Fs sin(n theta) + Fc cos(n theta),
    where each wave makes n turns in the common length. The response solves M w'' + d w' + k0 w = that series, delayed
    by the phase 2 pi z0/ell of the start deflection, with d = c + dF/dL'. The unit of w is the deflection by the waves'
    forces, slightly above zero.
    """
    wave = equation.structure.wave
    assert wave is not None  # every scene with an orbit has one
    p, known = equation.symbols(ca.MX)
    turns = sorted({*(wave.turns or (1,))})
    repeats: Column = wave.repeats(known)
    omega, n = 2.0 * math.pi * known["tow_speed"] / repeats, ca.DM(turns)
    count = _SAMPLES * turns[-1]
    phases = 2.0 * math.pi * np.arange(count) / count
    forces, slopes = equation.sliding.map(count)(ca.DM(phases).T / (2.0 * math.pi) * repeats, ca.repmat(p, 1, count))
    along_sine, along_cosine = ((forces @ ca.DM(2.0 / count * f(np.outer(phases, turns)))).T for f in (np.sin, np.cos))
    damped = (equation.structure.pull(known, 0.0, 1.0) + ca.sum2(slopes) / count) * n * omega
    spring = known["stiffness"] - known["inertia"] * (n * omega) ** 2
    sine = (spring * along_sine + damped * along_cosine) / (spring**2 + damped**2)
    cosine = (spring * along_cosine - damped * along_sine) / (spring**2 + damped**2)
    lag: Column = n * (2.0 * math.pi / repeats * equation.structure.start_deflection(known))
    w = ca.sum2(forces) / count / known["stiffness"] + ca.sum1(cosine * ca.cos(lag) - sine * ca.sin(lag))
    turning = omega * ca.dot(n, sine * ca.cos(lag) + cosine * ca.sin(lag))
    # The unit of the unknowns is proportional to the wave amplitude only above this value, so that derivatives exist at
    # 0.
    amplitude = sqrt(sum(known[wave_names(k)[0]] ** 2 for k in range(wave.count)) + 1e-3**2)
    size = amplitude * known["static"] / known["stiffness"] + 1e-30
    return ca.Function("near_orbit", [p], [stacked(w, turning), stacked(size, size * omega)])


@lru_cache(maxsize=32)
def monodromy(equation: Equation, timeline: Timeline) -> ca.Function:
    """Return (state at time 0, parameters) -> derivative of the state after one period by the state at time 0."""
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(equation.names) + 1)
    last = run_from(equation, timeline)(first, p)[0][:, -1]
    return ca.Function("monodromy", [first, p], [ca.jacobian(last, first)])


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


MOST_STEPS: Final = 50_000
"""Steps of order 8 after which a share that has not settled is given up; they take some tenths of a second."""

# Distance from the orbit, in half ranges of the orbit, within which linear theory certainly holds; and within which it
# is enough that the deviation shrinks. Deviations that change the character of the motion are of order one.
_NEAR: Final = 1e-2
# Largest difference of states one period apart in a motion that repeats itself, in half ranges of the orbit. A largest
# multiplier that differs from 1 by less counts as 1.
_REPEATS: Final = 1e-6


def which_motion(run: Run) -> tuple[tuple[complex, ...], Settled, tuple[str, ...]]:
    """Return the Floquet multipliers [-] of a periodic orbit, where a share from equilibrium ends up, and warnings.

    Args:
        run: numeric run of the orbit.
    """
    structure, numbers = Structure.of(run.scene), numbers_of(run.scene)
    equation = equation_of(structure)
    p, steps = ca.DM(equation.column(numbers, float(run.duration))), run.accuracy.steps or 1
    orbit = np.array([run.deflection[0] - structure.start_deflection(numbers), run.scene.tow_speed - run.speed[0]])
    # Derivatives by the start state are less exact than the states, so they take twice the orbit's steps.
    slopes = monodromy(equation, Timeline(1, 2 * steps))(orbit, p)
    multipliers = tuple(complex(value) for value in np.linalg.eigvals(slopes.full()))
    largest = max(map(abs, multipliers))
    settled, warnings = _settled(run, equation, p, orbit, largest), []
    # A multiplier that exceeds 1 by less may be that of an undamped mount, rounded.
    if largest > 1.0 + 1e-8:
        grows = f"a deviation grows {largest:.4g} times in every wavelength, so no share stays on it"
        warnings.append(f"the orbit is unstable: {grows}")
    if not settled.orbit:
        why = "" if largest > 1.0 + _REPEATS else ": nothing damps a deviation from the orbit"
        if largest < 1.0 - _REPEATS:
            why = f", although the orbit is stable: a small deviation shrinks to {largest:.4g} in every wavelength"
        warnings.append(f"a share that starts from equilibrium {settled.text}{why}")
    return multipliers, settled, tuple(warnings)


def _settled(run: Run, equation: Equation, p: ca.DM, orbit: Array, largest: float) -> Settled:
    """Follow a share from equilibrium and return the motion in which it ends up.

    It is followed until it settles, for as many wavelengths as `MOST_STEPS` allow, and for 4 at least.

    Args:
        run: the orbit.
        equation: the equation of motion.
        p: its parameters, the period last.
        orbit: the orbit's state at time 0.
        largest: absolute value of its largest multiplier [-].
    """
    steps, stable = run.accuracy.steps or 1, largest < 1.0 - _REPEATS
    # Limit on the wavelengths if no deviation decays or grows: more would show nothing new.
    limit = MOST_STEPS // steps if abs(largest - 1.0) > _REPEATS else 64
    at_once = max(4, min(32, MOST_STEPS // (4 * steps)))
    follow, unit = _wavelengths(equation, steps, at_once), _half_ranges(run)
    states, distances = np.zeros((1, 2)), [math.inf]
    while True:
        states = np.vstack([states, follow(states[-1], p).full().T])
        count = len(states) - 1
        distance = float(np.max(np.abs((states[-at_once // 2 :] - orbit) / unit)))
        if not math.isfinite(distance):
            return Settled(False, count, None, math.inf, count, math.inf, retreats=True)
        spent, nearer = count >= limit, distance <= distances[-1]
        shrinks = spent and distance < 0.3 and distance < distances[len(distances) // 2]
        if stable and ((nearer and distance < _NEAR) or shrinks):
            return Settled(True, count, 1, float(run.force_rms), 1, distance, retreats=False)
        distances.append(distance)
        period = _period(states / unit, largest) if distance > _NEAR else None
        if period or spent:
            # Most wavelengths over which a motion is averaged that does not repeat itself.
            averaged = period or min(256, count // 2)
            force_rms, retreats = _last(run, equation, p, states[-1 - averaged], averaged)
            return Settled(False if period else None, count, period, force_rms, averaged, distance, retreats)


def _half_ranges(run: Run) -> Array:
    """Return the half ranges of the orbit's states, in which distances from it are measured, above zero."""
    frequency = max(float(run.scene.wave_frequency), float(run.scene.natural_frequency))
    least = 1e-9 * float(np.max(np.abs(run.deflection)))  # without a wave the orbit is a point
    size = max(float(np.ptp(run.deflection)) / 2.0, float(np.ptp(run.speed)) / 2.0 / frequency, least) or 1.0
    return np.array([1.0, frequency]) * size


def _period(states: Array, largest: float) -> int | None:
    """Return the period [wavelengths] with which the last states, in half ranges, repeat themselves, if any.

    States near a slowly attracting orbit differ little too: by about (1 - multiplier) times their distance. States that
    differ by less than rounding, which a chaotic motion would amplify, are the same.
    """
    least = max(_REPEATS * min(1.0, max(abs(1.0 - largest), _REPEATS)), 1e-13 * float(np.max(np.abs(states))))
    # Longest period that is looked for [wavelengths].
    for period in range(1, min(32, (len(states) - 1) // 2) + 1):
        if float(np.max(np.abs(states[-period:] - states[-2 * period : -period]))) < least:
            return period
    return None


def _last(run: Run, equation: Equation, p: ca.DM, first: Array, count: int) -> tuple[float, bool]:
    """Return the RMS of the mount force [N] over so many wavelengths from a state on, and whether the share retreats.

    It takes twice the orbit's steps, for another motion may be faster.
    """
    steps = 2 * count * (run.accuracy.steps or 1)
    whole = ca.vertcat(p[:-1], count * float(run.duration))
    states, means, variances = (np.asarray(part) for part in run_from(equation, Timeline(steps, steps))(first, whole))
    averages = equation.structure.averages(numbers_of(run.scene), means.ravel(), variances.ravel())
    return float(averages[1]), bool(np.max(states[1]) > run.scene.tow_speed)


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
