"""heyoka.py as an expert writes it: Taylor series of adaptive order and step, compiled by LLVM for vector registers."""

import math
from functools import lru_cache

import heyoka as hy
import numpy as np
from peers import r1

WIDTH = hy.recommended_simd_size()
_TURN = 2.0 * math.pi / r1.WAVELENGTH


def _system():
    """Return the equations of w, w' and the integrals of w and w^2, with F0, Fd, M, k, z0 as parameters."""
    w, v, total, squares = hy.make_vars("w", "v", "total", "squares")
    static, drag, inertia, stiffness, z0 = (hy.par[k] for k in range(5))
    force = static * r1.AMPLITUDE * hy.sin(_TURN * (r1.SPEED * hy.time - z0 - w))
    acceleration = (force + drag * v * (v - 2.0 * r1.SPEED) - stiffness * w) / inertia
    return [(w, v), (v, acceleration), (total, w), (squares, w**2)]


@lru_cache(maxsize=64)
def _single(tolerance):
    return hy.taylor_adaptive(_system(), [0.0] * 4, tol=tolerance)


@lru_cache(maxsize=64)
def _vector(tolerance):
    return hy.taylor_adaptive_batch(_system(), np.zeros((4, WIDTH)), tol=tolerance)


def forces(p, tolerance, outputs):
    """Return mean and RMS force, and the mount force at equal intervals."""
    integrator = _single(tolerance)
    integrator.time, integrator.state[:], integrator.pars[:] = 0.0, 0.0, p
    y = integrator.propagate_grid(np.linspace(0.0, r1.DURATION, outputs + 1))[-1]
    stiffness, z0 = p[3:]
    mean, square = y[-1, 2:] / r1.DURATION
    return stiffness * (z0 + mean), stiffness * math.sqrt(square - mean**2), stiffness * (z0 + y[:, 0])


def batch(p, tolerance):
    """Return mean and standard deviation of w of designs, a column each; their number is a multiple of `WIDTH`."""
    integrator, out = _vector(tolerance), np.empty((2, p.shape[1]))
    # Designs in one register wait for the slowest of them.
    for part in np.argsort(p[3] / p[2]).reshape(-1, WIDTH):
        integrator.set_time(0.0)
        integrator.state[:], integrator.pars[:] = 0.0, p[:, part]
        integrator.propagate_until(r1.DURATION)
        out[:, part] = integrator.state[2:]
    mean, square = out / r1.DURATION
    return np.array([mean, np.sqrt(square - mean**2)])
