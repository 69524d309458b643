"""The lasting orbit under strength waves: one period of it, by shooting, and two cheap stand-ins for it.

Under a wave of the soil's strength, or several with a common length ell, a share comes to repeat itself with the
period T = ell/V0 (where that orbit is stable). Shooting finds the state to which one period of steps of order 8
returns; CasADi differentiates the root by the implicit function theorem. Both stand-ins see the share's motion as a
Fourier series: of the waves' own terms, in closed form, about steady sliding; or of several that balance the equation.
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

# The residual is in units of `_size`. CasADi prints every input of a root that it fails to find; here such a root
# becomes NaN, which is reported once, as an IntegrationError.
_OPTIONS = {"abstol": 1e-12, "max_iter": 60, "error_on_fail": False, "show_eval_warnings": False}
_FOUND = 1e-8
# Wave amplitude below which the unit of the unknowns no longer follows it, so that it has derivatives at 0.
_LEAST_AMPLITUDE = 1e-3
# Places in the shortest wavelength at which the resistance is looked at: enough for its first harmonic beside 14 more.
_SAMPLES = 16


def orbit_map(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return one wavelength of the orbit, with the interface of `plough_opt.motion.integrators.Integration`.

    The duration, its last parameter, is the period ell/V0.
    """
    if structure.orbit == "periodic":
        return _shooting(structure, timeline)
    series = _linear(structure) if structure.orbit == "linearised" else _balanced(structure)
    return _from_series(structure, timeline, series)


@lru_cache(maxsize=32)
def monodromy(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return (state at time 0, parameters) -> derivative of the state one period later by that at time 0."""
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(signals(structure).parameters) + 1)
    last = run_from(structure, timeline)(first, p)[0][:, -1]
    return ca.Function("monodromy", [first, p], [ca.jacobian(last, first)])


def _response(structure: Structure, p: dict[str, Column]) -> tuple[Column, Column, Column]:
    """Return mean, sine and cosine coefficients [m] of w in the linear forced response about steady sliding.

    On the steady path L = V0 t, theta = omega t, the resistance is a series Fm + sum of Fs sin(n theta) + Fc cos(n
    theta), with an n for each wave's turns in the common length; so M w'' + d w' + k0 w is that series at the lag
    2 pi z0/ell, with d = c + dF/dL'. Coefficients are columns by n.
    """
    names, repeats = signals(structure).parameters, _wave(structure).repeats(p)
    omega: Column = 2.0 * math.pi * p["tow_speed"] / repeats
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
    """Return the soil's strength along the path, which an orbit has."""
    assert structure.wave is not None
    return structure.wave


def _turns(structure: Structure) -> list[int]:
    """Return the numbers of turns of the waves in the common length, ascending."""
    return sorted({*(_wave(structure).turns or (1,))})


@lru_cache(maxsize=32)
def _series(structure: Structure) -> ca.Function:
    """Return of the resistance on the steady path: mean change since the start, sines, cosines, mean slope by speed.

    A Function of the parameters of `signals`, in N and N s/m; sines and cosines are columns by `_turns`.
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
    """Return the unit [m] of an orbit's unknowns: the waves' deflection of the spring."""
    amplitude = ca.sqrt(sum(p[wave_names(k)[0]] ** 2 for k in range(_wave(structure).count)) + _LEAST_AMPLITUDE**2)
    return amplitude * p["static"] / p["stiffness"] + 1e-30


def _shooting(structure: Structure, timeline: Timeline) -> ca.Function:
    """Return the orbit to which one period of steps returns."""
    (p, known), x = signals(structure).symbols(ca.MX), ca.MX.sym("x", 2)
    mean, sines, cosines = _response(structure, known)
    omega: Column = 2.0 * math.pi * known["tow_speed"] / _wave(structure).repeats(known)
    size = _size(structure, known)
    unit = stacked(size, size * omega)
    once = run_from(structure, Timeline(1, timeline.steps))
    miss = (once(x * unit, p)[0][:, -1] - x * unit) / unit
    turning = omega * ca.dot(ca.DM(range(1, sines.numel() + 1)), sines)
    first = _root(x, p, miss, stacked(mean + ca.sum1(cosines), turning) / unit) * unit
    results = run_from(structure, timeline)(first, p)
    return ca.Function("orbit", [p], list(results), {"never_inline": True})


def _linear(structure: Structure) -> ca.Function:
    """Return the Fourier coefficients of the linear response: mean, cosines, sines."""
    p, known = signals(structure).symbols(ca.MX)
    mean, sines, cosines = _response(structure, known)
    return ca.Function("linear", [p], [stacked(mean, cosines, sines)])


@lru_cache(maxsize=32)
def _balanced(structure: Structure) -> ca.Function:
    """Return the Fourier coefficients for which no harmonic of the equation of motion is out of balance."""
    count = structure.harmonics
    samples = 4 * count + 12
    phases = 2.0 * math.pi * np.arange(samples) / samples
    basis, slope, bend = _basis(count, phases)
    (p, known), x = signals(structure).symbols(ca.MX), ca.MX.sym("x", 2 * count + 1)
    mean, sines, cosines = _response(structure, known)
    omega: Column = 2.0 * math.pi * known["tow_speed"] / _wave(structure).repeats(known)
    size = _size(structure, known)
    w, rate, acceleration = (size * ca.mtimes(ca.DM(b), x) for b in (basis, slope, bend))
    rate, acceleration = rate * omega, acceleration * omega**2
    motion = equation_of_motion(structure)
    own = stacked(*(known[name] for name in motion.names))
    states = stacked(w.T, rate.T)
    forced = motion.function.map(samples)(ca.DM(phases).T / omega, states, ca.repmat(own, 1, samples))[1, :].T
    weights = np.where(np.arange(2 * count + 1) == 0, 1.0, 2.0)[:, None] * basis.T / samples
    # Scaled by the spring, whose force on the response is of order one.
    stiff = known["stiffness"] / known["inertia"] + omega**2
    out_of_balance = ca.mtimes(ca.DM(weights), acceleration - forced) / (size * stiff)
    rest = ca.MX.zeros(count - sines.numel())
    guess = stacked(mean / size, cosines / size, rest, sines / size, rest)
    return ca.Function("balanced", [p], [_root(x, p, out_of_balance, guess) * size])


def _root(x: ca.MX, p: ca.MX, residual: ca.MX, guess: ca.MX) -> ca.MX:
    """Return the x at which a residual of p vanishes, or NaN where none was found from the guess."""
    solver = ca.rootfinder("orbit", "newton", {"x": x, "p": p, "g": residual}, _OPTIONS)
    found = solver(x0=guess, p=p)
    left = ca.Function("left", [x, p], [residual])(found["x"], p)
    return ca.if_else(ca.norm_inf(left) < _FOUND, found["x"], np.nan)


def _basis(count: int, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean, cosines and sines at phases, a column each, and their first and second derivatives by the phase."""
    k = np.arange(1, count + 1)
    angle = np.outer(phases, k)
    cosine, sine, zero = np.cos(angle), np.sin(angle), np.zeros((len(phases), 1))
    return (
        np.hstack([zero + 1.0, cosine, sine]),
        np.hstack([zero, -k * sine, k * cosine]),
        np.hstack([zero, -(k**2) * cosine, -(k**2) * sine]),
    )


def _from_series(structure: Structure, timeline: Timeline, series: ca.Function) -> ca.Function:
    """Return states at the outputs, means and variances of a Fourier series."""
    p, known = signals(structure).symbols(ca.MX)
    omega: Column = 2.0 * math.pi * known["tow_speed"] / _wave(structure).repeats(known)
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
