"""The periodic orbit under strength waves: by shooting, or approximated by the linear response or harmonic balance.

Under waves of the soil's strength that repeat themselves every length ell, a motion may repeat itself with the period
T = ell/V0; if that orbit is stable, shares come to it. Shooting finds the state to which one period of steps of order 8
returns, and CasADi differentiates the root by the implicit function theorem. Both approximations are Fourier series:
the linear response to the waves about steady sliding, in closed form, and the harmonics that balance the equation of
motion.
"""

import math
from functools import lru_cache

import casadi as ca
import numpy as np

from plough_opt.core.expressions import Column, stacked
from plough_opt.motion.effects import StrengthWaves, wave_names
from plough_opt.motion.equation import equation_of_motion, signals
from plough_opt.motion.runge_kutta import run_from
from plough_opt.motion.terms import Structure, pull, resistance_change, start_deflection
from plough_opt.motion.timeline import Timeline

# For a root that it does not find, CasADi would print a page. Here such a root becomes NaN, which the caller reports as
# an IntegrationError.
_NEWTON_OPTIONS = {"abstol": 1e-12, "max_iter": 60, "error_on_fail": False, "show_eval_warnings": False}
# Largest residual of a root, in units of `_size`.
_LARGEST_RESIDUAL = 1e-8
# The unit of the unknowns is proportional to the wave amplitude only above this value, so that derivatives exist at 0.
_LEAST_AMPLITUDE = 1e-3
# Samples of the resistance in the shortest wavelength. Harmonics up to the 14th do not alias onto the first one.
_SAMPLES = 16


def orbit_map(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return the Function of one period of the orbit, as `plough_opt.motion.integrators.Integration` describes it.

    The duration, its last parameter, must be the period ell/V0.
    """
    if structure.orbit == "periodic":
        return _shooting(structure, timeline)
    series = _linear(structure) if structure.orbit == "linearised" else _balanced(structure)
    return _from_series(structure, timeline, series)


@lru_cache(maxsize=32)
def monodromy(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return (state at time 0, parameters) -> derivative of the state after one period by the state at time 0."""
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(signals(structure).parameters) + 1)
    last = run_from(structure, timeline)(first, p)[0][:, -1]
    return ca.Function("monodromy", [first, p], [ca.jacobian(last, first)])


def _response(structure: Structure, p: dict[str, Column]) -> tuple[Column, Column, Column]:
    """Return the mean, the sine and the cosine coefficients of w [m] in the linear response about steady sliding.

    On the steady path L = V0 t, with theta = omega t, the resistance is Fm + sum of Fs sin(n theta) + Fc cos(n theta),
    where each wave makes n turns in the common length. The response solves M w'' + d w' + k0 w = that series, delayed
    by the phase 2 pi z0/ell of the start deflection, with d = c + dF/dL'. The coefficients are columns by the number n
    from 1 on.
    """
    names, repeats = signals(structure).parameters, _wave(structure).repeats(p)
    omega = _frequency(structure, p)
    mean, along_sine, along_cosine, slope = _series(structure)(stacked(*(p[name] for name in names)))
    turns = _turns(structure)
    n = ca.DM(turns)
    damping = pull(structure, p, 0.0, 1.0) + slope
    spring, damped = p["stiffness"] - p["inertia"] * (n * omega) ** 2, damping * n * omega
    size = 1.0 / (spring**2 + damped**2)
    sine: Column = size * (spring * along_sine + damped * along_cosine)
    cosine: Column = size * (spring * along_cosine - damped * along_sine)
    lag: Column = n * (2.0 * math.pi / repeats * start_deflection(structure, p))
    every = ca.DM.eye(turns[-1])[:, [turn - 1 for turn in turns]]
    sines = ca.mtimes(every, sine * ca.cos(lag) + cosine * ca.sin(lag))
    return mean / p["stiffness"], sines, ca.mtimes(every, cosine * ca.cos(lag) - sine * ca.sin(lag))


def _wave(structure: Structure) -> StrengthWaves:
    """Return the strength waves, which every scene with an orbit has."""
    assert structure.wave is not None
    return structure.wave


def _frequency(structure: Structure, p: dict[str, Column]) -> Column:
    """Return the angular frequency of an orbit [rad/s]."""
    found: Column = 2.0 * math.pi * p["tow_speed"] / _wave(structure).repeats(p)
    return found


def _turns(structure: Structure) -> list[int]:
    """Return how many turns each wave makes in the common length, ascending, each number once."""
    return sorted({*(_wave(structure).turns or (1,))})


@lru_cache(maxsize=32)
def _series(structure: Structure) -> ca.Function:
    """Return parameters -> Fourier coefficients of the resistance on the steady path, and its slope.

    The parameters are those of `signals`. The results are the mean change since the start [N], the sine and the cosine
    coefficients [N], columns by `_turns`, and the mean derivative by the speed [N s/m].
    """
    names, turns = signals(structure).parameters, _turns(structure)
    given, travel, gain = ca.SX.sym("given", len(names)), ca.SX.sym("travel"), ca.SX.sym("gain")
    known = dict(zip(names, ca.vertsplit(given), strict=True))
    change: Column = resistance_change(structure, known, travel, gain)
    force = ca.SX(change)
    slope = ca.substitute(ca.jacobian(force, gain), gain, 0.0)
    at = ca.Function("at", [travel, given], [ca.densify(ca.substitute(force, gain, 0.0)), ca.densify(slope)])
    count = _SAMPLES * turns[-1]
    phases = 2.0 * math.pi * np.arange(count) / count
    p = ca.MX.sym("p", len(names))
    repeats: Column = _wave(structure).repeats(dict(zip(names, ca.vertsplit(p), strict=True)))
    forces, slopes = at.map(count)(ca.DM(phases).T / (2.0 * math.pi) * repeats, ca.repmat(p, 1, count))
    sines, cosines = (2.0 / count * function(np.outer(phases, turns)) for function in (np.sin, np.cos))
    found = [ca.sum2(forces) / count, *((forces @ ca.DM(b)).T for b in (sines, cosines)), ca.sum2(slopes) / count]
    return ca.Function("series", [p], found)


def _size(structure: Structure, p: dict[str, Column]) -> Column:
    """Return the unit [m] of an orbit's unknowns: the deflection by the waves' forces, slightly above zero."""
    amplitude = ca.sqrt(sum(p[wave_names(k)[0]] ** 2 for k in range(_wave(structure).count)) + _LEAST_AMPLITUDE**2)
    return amplitude * p["static"] / p["stiffness"] + 1e-30


def _shooting(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return the Function of the orbit whose state returns to itself after one period of steps."""
    (p, known), x = signals(structure).symbols(ca.MX), ca.MX.sym("x", 2)
    mean, sines, cosines = _response(structure, known)
    omega = _frequency(structure, known)
    size = _size(structure, known)
    unit = stacked(size, size * omega)
    once = run_from(structure, Timeline(1, timeline.steps))
    miss = (once(x * unit, p)[0][:, -1] - x * unit) / unit
    turning = omega * ca.dot(ca.DM(range(1, sines.numel() + 1)), sines)
    first = _root(x, p, miss, stacked(mean + ca.sum1(cosines), turning) / unit) * unit
    results = run_from(structure, timeline)(first, p)
    return ca.Function("orbit", [p], list(results), {"never_inline": True})


def _linear(structure: Structure) -> ca.Function:
    """Return parameters -> Fourier coefficients of the linear response: mean, cosines, sines [m]."""
    p, known = signals(structure).symbols(ca.MX)
    mean, sines, cosines = _response(structure, known)
    return ca.Function("linear", [p], [stacked(mean, cosines, sines)])


@lru_cache(maxsize=32)
def _balanced(structure: Structure) -> ca.Function:
    """Return parameters -> Fourier coefficients for which all harmonics kept balance the equation of motion."""
    count = structure.harmonics
    samples = 4 * count + 12
    phases = 2.0 * math.pi * np.arange(samples) / samples
    basis, slope, bend = _basis(count, phases)
    (p, known), x = signals(structure).symbols(ca.MX), ca.MX.sym("x", 2 * count + 1)
    mean, sines, cosines = _response(structure, known)
    omega = _frequency(structure, known)
    size = _size(structure, known)
    w, rate, acceleration = (size * ca.mtimes(ca.DM(b), x) for b in (basis, slope, bend))
    rate, acceleration = rate * omega, acceleration * omega**2
    motion = equation_of_motion(structure)
    given = stacked(*(known[name] for name in motion.names))
    states = stacked(w.T, rate.T)
    forced = motion.function.map(samples)(ca.DM(phases).T / omega, states, ca.repmat(given, 1, samples))[1, :].T
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


def _from_series(structure: Structure, timeline: Timeline, series: ca.Function) -> ca.Function:
    """Return parameters -> states at the outputs, means and variances of a Fourier series of w."""
    p, known = signals(structure).symbols(ca.MX)
    omega = _frequency(structure, known)
    x = series(p)
    count = (x.numel() - 1) // 2
    basis, slope, _ = _basis(count, 2.0 * math.pi * timeline.output_fractions)
    states = ca.horzcat(ca.mtimes(ca.DM(basis), x), omega * ca.mtimes(ca.DM(slope), x)).T
    cosines, sines = x[1 : count + 1], x[count + 1 :]
    means: list[Column] = [x[0]]
    variances = [ca.sumsqr(x[1:]) / 2.0]
    if structure.damper:
        k, c = known["stiffness"], known["damping"] * omega * ca.DM(np.arange(1, count + 1))
        means.append(k * x[0])
        variances.append((ca.sumsqr(k * cosines + c * sines) + ca.sumsqr(k * sines - c * cosines)) / 2.0)
    return ca.Function("series", [p], [states, stacked(*means), stacked(*variances)], {"never_inline": True})
