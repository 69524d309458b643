"""pymoo's NSGA-II on the front of R1 with a damper, with whole populations simulated by NumPy."""

import math

import numpy as np
from peers import r1
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.optimize import minimize

DAMPING, SOFTEST = 400.0, 3e3
_TURN = 2.0 * math.pi / r1.WAVELENGTH


def averages(designs, steps):
    """Return mean and RMS of the deflection of designs, a row each, by the classical Runge-Kutta method.

    The damper acts on the mount, so that it carries part of the force; a population is one array operation.
    """
    static, drag, inertia, stiffness, z0 = r1.equation(*designs.T)
    strong, lead = static * r1.AMPLITUDE / inertia, _TURN * z0
    pull, damp, spring = drag / inertia, DAMPING / inertia, stiffness / inertia
    h = r1.DURATION / steps
    w, v = np.zeros_like(z0), np.zeros_like(z0)
    total, squares = np.zeros_like(z0), np.zeros_like(z0)

    def force(w, v):
        return stiffness * w + DAMPING * v

    def rate(t, w, v):
        wave = strong * np.sin((_TURN * r1.SPEED * t - lead) - _TURN * w)
        return wave + (pull * (v - 2.0 * r1.SPEED) - damp) * v - spring * w

    for i in range(steps):
        t = i * h
        a1 = rate(t, w, v)
        w2, v2 = w + 0.5 * h * v, v + 0.5 * h * a1
        a2 = rate(t + 0.5 * h, w2, v2)
        w3, v3 = w + 0.5 * h * v2, v + 0.5 * h * a2
        a3 = rate(t + 0.5 * h, w3, v3)
        w4, v4 = w + h * v3, v + h * a3
        a4 = rate(t + h, w4, v4)
        total += w + 2.0 * (w2 + w3) + w4
        squares += force(w, v) ** 2 + 2.0 * (force(w2, v2) ** 2 + force(w3, v3) ** 2) + force(w4, v4) ** 2
        w = w + h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
        v = v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    mean = total / (6.0 * steps)
    # The mean of the damper's force is c times the change of the deflection over the run, divided by its duration.
    middle = stiffness * mean + DAMPING * w / r1.DURATION
    return z0 + mean, np.sqrt(np.maximum(squares / (6.0 * steps) - middle**2, 0.0))


class Mount(Problem):
    """Minimises mean deflection and RMS force, with a least radius and a largest half angle."""

    def __init__(self, steps):
        self.steps = steps
        low, high = r1.LOWER.copy(), r1.UPPER.copy()
        low[2], high[2] = math.log(SOFTEST), math.log(high[2])
        super().__init__(n_var=3, n_obj=2, n_ieq_constr=2, xl=low, xu=high)

    def designs(self, x):
        """Return designs from pymoo's variables, one of which is the logarithm of the stiffness."""
        return np.column_stack([x[:, 0], x[:, 1], np.exp(x[:, 2])])

    def _evaluate(self, x, out, *_, **__):
        designs = self.designs(x)
        out["F"] = np.column_stack(averages(designs, self.steps))
        # The second one is the limit of R1 on the deflection, which is an objective here.
        radius, _, half_angle = r1.requirements(*designs.T, np.zeros(len(designs)))
        out["G"] = -np.column_stack([radius, half_angle])


def front(steps, generations=100, population=100, seed=1):
    """Return the objectives of the efficient designs in the last population."""
    return minimize(Mount(steps), NSGA2(pop_size=population), ("n_gen", generations), seed=seed).F
