"""Motion of a share under an own resistance that jumps: integrated by SciPy from one jump to the next."""

import math

import numpy as np
from scipy.integrate import solve_ivp


def averages(scene, own, switch, duration):
    """Return mean and RMS [N] of the mount force.

    Args:
        scene: without damper and ramp, under contact "resisting", and with one strength wave.
        own: side -> force [N] of the own resistance, where the side is True while the switch is above 0.
        switch: function of travel and speed that changes its sign at the jump, and not at the start.
        duration: [s].
    """
    k, mass, pace, reaction = scene.stiffness, float(scene.inertia), scene.tow_speed, scene.reaction
    wave = scene.effects.strength_wave

    def resistance(travel, speed, side):
        strength = 1.0 + wave.amplitude * math.sin(2.0 * math.pi * travel / wave.wavelength)
        return float(reaction.static) * strength + float(reaction.drag) * speed**2 + own(side)

    def rates(t, x, side):
        pull = k * (pace * t - x[0])
        return [x[1], (pull - resistance(x[0], x[1], side)) / mass, pull, pull**2]

    def event(_, x, __):
        return switch(*x[:2])

    event.terminal = True
    rest = scene.effects.start == "rest"
    side = switch(0.0, 0.0 if rest else pace) > 0.0
    x = np.array([0.0 if rest else -resistance(0.0, pace, side) / k, 0.0 if rest else pace, 0.0, 0.0])
    now, tight = 0.0, {"method": "DOP853", "rtol": 2e-13, "atol": 1e-15, "max_step": 0.02}
    while now < duration:
        event.direction = -1 if side else 1
        part = solve_ivp(rates, (now, duration), x, args=(side,), events=event, **tight)
        now, x, side = part.t[-1], part.y[:, -1], side != (part.status == 1)
    mean = x[2] / duration
    return mean, math.sqrt(max(x[3] / duration - mean**2, 0.0))
