"""SciPy's SLSQP on R1 with whatever simulates it."""

from collections import OrderedDict

import numpy as np
from peers import r1
from scipy.optimize import minimize

_CONVERGED = 1e-11


class Question:
    """Objective and requirements of a scaled design; an evaluation serves all that ask for the same design."""

    def __init__(self, values, jacobian=None):
        self._values, self._jacobian = values, jacobian
        self._known = OrderedDict()

    def _at(self, function, y):
        key = (function is self._values, y.tobytes())
        if key not in self._known:
            self._known[key] = np.asarray(function(y))
            if len(self._known) > 16:
                self._known.popitem(last=False)
        return self._known[key]

    def local(self, start):
        """Return the design and objective to which SLSQP goes from a start; by differences without derivatives."""
        self._known.clear()
        value, exact = self._values, self._jacobian
        gradient = {} if exact is None else {"jac": lambda y: self._at(exact, y)[0]}
        slopes = {} if exact is None else {"jac": lambda y: self._at(exact, y)[1:]}
        found = minimize(
            lambda y: float(self._at(value, y)[0]),
            r1.scaled(start),
            method="SLSQP",
            bounds=[(0.0, 1.0)] * 3,
            constraints={"type": "ineq", "fun": lambda y: self._at(value, y)[1:], **slopes},
            options={"ftol": _CONVERGED, "maxiter": 200},
            **gradient,
        )
        return np.array(r1.unscaled(found.x)), float(found.fun)

    def best(self):
        """Return the best of all starts."""
        return min((self.local(start) for start in r1.STARTS), key=lambda found: found[1])


def from_averages(averages):
    """Return the question of a function from F0, Fd, M, k, z0 to mean draft and RMS force."""

    def values(y):
        x = [float(a) for a in r1.unscaled(y)]
        mean, rms = averages(*(float(a) for a in r1.equation(*x)))
        return np.array([(mean + rms) / 1e3, *r1.requirements(*x, mean)])

    return Question(values)


def by_scipy(method, tolerance):
    """Return the question by one of SciPy's integrators."""
    from peers import scipy_ivp

    return from_averages(lambda *p: scipy_ivp.solve(p, method, tolerance)[:2])


def by_numba(steps):
    """Return the question by Numba."""
    from peers import numba_rk4

    def averages(static, drag, inertia, stiffness, z0):
        mean, spread = numba_rk4.averages(static, drag, inertia, stiffness, z0, steps)
        return stiffness * (z0 + mean), stiffness * spread

    return from_averages(averages)


def by_jax(steps):
    """Return the question by JAX's own loop, with its derivatives."""
    from peers import jax_rk4

    return Question(*jax_rk4.by_rk4(steps))


def by_diffrax(tolerance):
    """Return the question by diffrax, with its derivatives."""
    from peers import jax_rk4

    return Question(*jax_rk4.by_tsit5(tolerance))
