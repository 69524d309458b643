"""Motion of a share under own resistances that jump: integrated by SciPy from one jump to the next."""

import math
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

# A switch below this value [m, m/s or s] is at its jump: the integrator locates events to rounding.
_AT_JUMP = 1e-11
# Times after the start [s] at which a switch that begins at zero must have the side that its motion was computed with.
_SOON = (1e-6, 1e-5, 1e-4)


def _value(switch, t, x):
    return switch(t, *x[:2])


def averages(scene, own, switches, duration):
    """Return mean and RMS [N] of the mount force.

    Args:
        scene: without damper and ramp, under contact "resisting", and with at most one strength wave.
        own: (travel, speed, sides) -> force [N] of all own resistances, where a side is 1 while its switch is above 0.
        switches: functions of (time, travel, speed) that change their sign at a jump.
        duration: [s].
    """
    k, mass, pace, reaction = scene.stiffness, float(scene.inertia), scene.tow_speed, scene.reaction
    wave = scene.effects.strength_wave

    def resistance(travel, speed, sides):
        strength = 1.0 + wave.amplitude * math.sin(2.0 * math.pi * travel / wave.wavelength) if wave else 1.0
        return float(reaction.static) * strength + float(reaction.drag) * speed**2 + own(travel, speed, sides)

    def integrated(sides, span, x, **options):
        def rates(t, x):
            pull = k * (pace * t - x[0])
            return [x[1], (pull - resistance(x[0], x[1], sides)) / mass, pull, pull**2]

        return solve_ivp(rates, span, x, method="DOP853", rtol=2e-13, atol=1e-15, max_step=0.02, **options)

    x = np.array([0.0, 0.0 if scene.effects.start == "rest" else pace, 0.0, 0.0])
    if scene.effects.start == "equilibrium":
        x[0] = -resistance(0.0, pace, [int(switch(0.0, 0.0, pace) > 0.0) for switch in switches]) / k
    sides = [int(switch(0.0, *x[:2]) > 0.0) for switch in switches]
    for number, switch in enumerate(switches):
        if abs(switch(0.0, *x[:2])) < _AT_JUMP:
            soon = integrated(sides, (0.0, _SOON[-1]), x, t_eval=_SOON)
            values = [switch(t, *y[:2]) for t, y in zip(soon.t, soon.y.T, strict=True)]
            sides[number] = int(values[-1] > 0.0)
    now = 0.0
    while now < duration:
        events = []
        for side, switch in zip(sides, switches, strict=True):
            event = partial(_value, switch)
            event.terminal, event.direction = True, -1 if side else 1
            events.append(event)
        part = integrated(sides, (now, duration), x, events=events)
        now, x = part.t[-1], part.y[:, -1]
        if part.status == 1:
            at = [abs(switch(now, *x[:2])) < _AT_JUMP for switch in switches]
            reached = [flip or len(times) > 0 for flip, times in zip(at, part.t_events, strict=True)]
            sides = [1 - side if flip else side for side, flip in zip(sides, reached, strict=True)]
    mean = x[2] / duration
    return mean, math.sqrt(max(x[3] / duration - mean**2, 0.0))
