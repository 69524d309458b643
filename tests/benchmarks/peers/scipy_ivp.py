"""SciPy's integrators with the equation of motion of R1 as a user writes it."""

import math

import numpy as np
from peers import r1
from scipy.integrate import odeint, solve_ivp

_TURN = 2.0 * math.pi / r1.WAVELENGTH


def solve(p, method, tolerance, outputs=None, averages=True):
    """Return mean and RMS force (None if not integrated) and the mount force at the outputs."""
    static, drag, inertia, stiffness, z0 = (float(x) for x in p)

    def rates(t, y):
        w, v = y[0], y[1]
        force = static * r1.AMPLITUDE * math.sin(_TURN * (r1.SPEED * t - z0 - w))
        a = (force + drag * v * (v - 2.0 * r1.SPEED) - stiffness * w) / inertia
        return (v, a, w, w * w) if averages else (v, a)

    times = None if outputs is None else np.linspace(0.0, r1.DURATION, outputs + 1)
    start = np.zeros(4 if averages else 2)
    absolute = tolerance * np.array([z0, r1.SPEED, z0, z0**2])[: len(start)]
    if method == "odeint":
        y = odeint(rates, start, times, rtol=tolerance, atol=absolute, tfirst=True).T
    else:
        y = solve_ivp(rates, (0.0, r1.DURATION), start, method, t_eval=times, rtol=tolerance, atol=absolute).y
    force = stiffness * (z0 + y[0])
    if not averages:
        return None, None, force
    mean, square = y[2:, -1] / r1.DURATION
    return stiffness * (z0 + mean), stiffness * math.sqrt(square - mean**2), force
