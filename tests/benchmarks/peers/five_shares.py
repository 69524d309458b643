"""Five shares of R1 across a field that hardens: ten variables, coupled by what they loosen together."""

import math

import numpy as np
from peers import r1
from scipy.optimize import minimize

COHESIONS = tuple(r1.COHESION * (0.8 + 0.1 * k) for k in range(5))
STIFFNESS = 5e4
# Angles, then heights.
LOWER, UPPER, START = (np.repeat(x[:2], len(COHESIONS)) for x in (r1.LOWER, r1.UPPER, r1.START))
MEAN_RADIUS = 0.12
_CONVERGED = 1e-11


def requirements(angles, heights, means):
    """Return what must not be negative: mean loosened radius, mean deflections and half angles by their limits."""
    parts = np.array([r1.requirements(*x, STIFFNESS, mean) for *x, mean in zip(angles, heights, means, strict=True)])
    radii, deflections, half_angles = parts.T
    return np.array([np.mean(radii), *deflections, *half_angles])


def by_numba(steps):
    """Return how SLSQP solves it on Numba's Runge-Kutta, with differences: () -> (angles and heights, objective)."""
    from peers import numba_rk4

    def values(y):
        angles, heights = np.split(LOWER + y * (UPPER - LOWER), 2)
        means, total = [], 0.0
        for angle, height, cohesion in zip(angles, heights, COHESIONS, strict=True):
            p = [float(x) for x in r1.equation(float(angle), float(height), STIFFNESS, math, cohesion)]
            mean, spread = numba_rk4.averages(*p, steps)
            means.append(STIFFNESS * (p[4] + mean))
            total += means[-1] + STIFFNESS * spread
        return np.array([total / 1e3, *requirements(angles, heights, means)])

    def solve():
        # The two functions are asked for the same designs.
        known = {}

        def at(y):
            key = y.tobytes()
            if key not in known:
                known[key] = values(y)
            return known[key]

        found = minimize(
            lambda y: float(at(y)[0]),
            (START - LOWER) / (UPPER - LOWER),
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(START),
            constraints={"type": "ineq", "fun": lambda y: at(y)[1:]},
            options={"ftol": _CONVERGED, "maxiter": 200},
        )
        return LOWER + found.x * (UPPER - LOWER), float(found.fun)

    return solve
