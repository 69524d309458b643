"""Numba as an expert writes it: classical Runge-Kutta of order 4 with a fixed number of steps."""

import math

import numba
import numpy as np
from peers import r1

_TURN = 2.0 * math.pi / r1.WAVELENGTH


@numba.njit(fastmath=True)
def averages(static, drag, inertia, stiffness, z0, steps):
    """Return mean and standard deviation of the deviation w from the steady deflection z0."""
    return _run(static, drag, inertia, stiffness, z0, steps, np.empty(0))


@numba.njit(fastmath=True)
def forces(static, drag, inertia, stiffness, z0, steps, outputs):
    """Return mean and RMS force, and the mount force at equal intervals; steps is a multiple of outputs."""
    w = np.empty(outputs + 1)
    mean, spread = _run(static, drag, inertia, stiffness, z0, steps, w)
    return stiffness * (z0 + mean), stiffness * spread, stiffness * (z0 + w)


@numba.njit(fastmath=True)
def batch(p, steps):
    """Return mean and standard deviation of w of designs, a column each."""
    out = np.empty((2, p.shape[1]))
    for j in range(p.shape[1]):
        out[0, j], out[1, j] = averages(p[0, j], p[1, j], p[2, j], p[3, j], p[4, j], steps)
    return out


@numba.njit(fastmath=True)
def _run(static, drag, inertia, stiffness, z0, steps, kept):
    strong, drag, spring, lead = static * r1.AMPLITUDE / inertia, drag / inertia, stiffness / inertia, _TURN * z0
    h = r1.DURATION / steps
    w = v = total = squares = 0.0
    every = steps // (len(kept) - 1) if len(kept) else steps + 1
    if len(kept):
        kept[0] = 0.0
    for i in range(steps):
        t = i * h
        a1 = _rate(t, w, v, strong, drag, spring, lead)
        w2, v2 = w + 0.5 * h * v, v + 0.5 * h * a1
        a2 = _rate(t + 0.5 * h, w2, v2, strong, drag, spring, lead)
        w3, v3 = w + 0.5 * h * v2, v + 0.5 * h * a2
        a3 = _rate(t + 0.5 * h, w3, v3, strong, drag, spring, lead)
        w4, v4 = w + h * v3, v + h * a3
        a4 = _rate(t + h, w4, v4, strong, drag, spring, lead)
        total += w + 2.0 * (w2 + w3) + w4
        squares += w * w + 2.0 * (w2 * w2 + w3 * w3) + w4 * w4
        w += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
        v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
        if (i + 1) % every == 0:
            kept[(i + 1) // every] = w
    mean = total / (6.0 * steps)
    return mean, math.sqrt(squares / (6.0 * steps) - mean * mean)


@numba.njit(fastmath=True)
def _rate(t, w, v, strong, drag, spring, lead):
    return strong * math.sin(_TURN * (r1.SPEED * t - w) - lead) + drag * v * (v - 2.0 * r1.SPEED) - spring * w
