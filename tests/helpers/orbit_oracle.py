"""The motion of a share under a strength wave by SciPy, from equation (27), and its periodic orbit."""

from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp

from helpers.differences import order_4
from helpers.forces import Forces


def rates(scene):
    """Return the function (t, (z, z')) -> (z', z'') of the spring's deflection."""
    share = Forces(scene)
    inertia = share.m + share.added

    def rates(t, state):
        z, rate = state
        soil = share.soil(share.v0 * t - z, share.v0 - rate)
        return [rate, (soil - share.k * z - share.c * rate) / inertia]

    return rates


def follow(scene, first, duration, times=None, rtol=1e-12):
    """Return the solution from a state (z, z')."""
    size = np.array([abs(first[0]), 1e-3 * scene.tow_speed])
    # SciPy interpolates outputs between its steps, which must then be short.
    longest = np.inf if times is None else times[1] - times[0]
    options = {"method": "DOP853", "rtol": rtol, "atol": 1e-15 * size, "max_step": longest}
    return solve_ivp(rates(scene), (0.0, duration), first, t_eval=times, **options).y


def period(scene):
    return scene.effects.strength_wave.wavelength / scene.tow_speed


def monodromy(scene, first):
    """Return the derivative of the state after one period by the state, by differences of order 4."""
    size = np.array([abs(first[0]), scene.tow_speed])

    def after(shift):
        return follow(scene, first + shift, period(scene))[:, -1]

    columns = [order_4(lambda part, axis=axis: after(part * axis), 0.0, 1e-4) for axis in np.diag(size)]
    return np.column_stack(columns) / size


def orbit(scene, guess, outputs):
    """Return the orbit near a state: its states and mount force at the outputs, and its monodromy matrix."""
    first = np.array(guess, float)
    for _ in range(10):
        slope = monodromy(scene, first)
        change = np.linalg.solve(slope - np.eye(2), first - follow(scene, first, period(scene))[:, -1])
        first = first + change
        if np.all(np.abs(change) < 1e-12 * np.array([abs(first[0]), scene.tow_speed])):
            break
    times = np.linspace(0.0, period(scene), outputs + 1)
    z, rate = follow(scene, first, period(scene), times)
    force = scene.stiffness * z + (scene.effects.damping or 0.0) * rate
    return SimpleNamespace(deflection=z, rate=rate, force=force, monodromy=slope)
