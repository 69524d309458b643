"""SciPy's SLSQP with finite differences, on R1, with any simulation."""

import numpy as np
from peers import r1
from scipy.optimize import minimize

_CONVERGED = 1e-11


def minimised(values, start):
    """Return SLSQP's design and objective from a start.

    Args:
        values: design between 0 and 1 -> objective, and what must not be negative.
        start: a design between 0 and 1.
    """
    known = {}

    def at(y):  # SLSQP evaluates objective and constraints at the same designs
        key = y.tobytes()
        if key not in known:
            known[key] = np.asarray(values(y))
        return known[key]

    found = minimize(
        lambda y: float(at(y)[0]),
        start,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * len(start),
        constraints={"type": "ineq", "fun": lambda y: at(y)[1:]},
        options={"ftol": _CONVERGED, "maxiter": 200},
    )
    return found.x, float(found.fun)


def scipy_averages(method, tolerance):
    """Return a function from F0, Fd, M, k, z0 to mean and RMS force, by one of SciPy's integrators."""
    from peers import scipy_ivp

    return lambda *p: scipy_ivp.solve(p, method, tolerance)[:2]


def numba_averages(steps):
    """Return the same by Numba's Runge-Kutta steps."""
    from peers import numba_rk4

    def averages(static, drag, inertia, stiffness, z0):
        mean, spread = numba_rk4.averages(static, drag, inertia, stiffness, z0, steps)
        return stiffness * (z0 + mean), stiffness * spread

    return averages


def local(averages, start=r1.START):
    """Return design and objective of R1 from a start."""

    def values(y):
        x = [float(a) for a in r1.unscaled(y)]
        mean, rms = averages(*(float(a) for a in r1.equation(*x)))
        return [(mean + rms) / 1e3, *r1.requirements(*x, mean)]

    found, objective = minimised(values, r1.scaled(start))
    return np.array(r1.unscaled(found)), objective


def best(averages):
    """Return the best of all starts of R1."""
    return min((local(averages, start) for start in r1.STARTS), key=lambda found: found[1])
