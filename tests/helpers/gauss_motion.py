"""Motion of a share in the deflection z by Gauss collocation of order 16, exact to rounding where it is smooth.

For scenes without events. Averages are quadratures over the same nodes, with a second pass for deviations.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

import plough_opt as po

STAGES = 8


def _tableau():
    nodes, weights = np.polynomial.legendre.leggauss(STAGES)
    c, b = (nodes + 1.0) / 2.0, weights / 2.0

    def lagrange(j, x):
        return np.prod([(x - c[m]) / (c[j] - c[m]) for m in range(STAGES) if m != j], axis=0)

    # The rule integrates polynomials of degree 7 from 0 to c_i exactly.
    return np.array([[ci * (b @ lagrange(j, ci * c)) for j in range(STAGES)] for ci in c]), b, c


A, B, C = _tableau()


@dataclass(frozen=True)
class Motion:
    """State at the end of a motion, and averages."""

    deflection: float
    speed: float
    mean_draft: float
    force_rms: float
    mean_deflection: float
    displacement_rms: float
    tow_power: float


def smooth_step(u):
    """Return the step of `plough_opt.Smooth`, whose first four derivatives vanish at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u**5 * (126.0 - 420.0 * u + 540.0 * u**2 - 315.0 * u**3 + 70.0 * u**4)


def strut(scene, t):
    """Return path, speed and acceleration of the strut."""
    v, ramp = scene.tow_speed, scene.effects.tow_ramp
    if not ramp:
        return v * t, v + 0.0 * t, 0.0 * t
    u = np.minimum(t / ramp, 1.0)
    path = v * (t - ramp * u + ramp * (2.5 * u**4 - 3.0 * u**5 + u**6))
    return path, v * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5), v / ramp * 30.0 * u**2 * (1.0 - u) ** 2


def _resistance(scene, travel, speed):
    e, reaction = scene.effects, scene.reaction
    force = reaction.static * (1.0 + (e.rate_term or 0.0) * speed**2)
    if e.strength_wave is not None:
        force = force * (1.0 + e.strength_wave.amplitude * np.sin(2.0 * math.pi * travel / e.strength_wave.wavelength))
    force = force + reaction.drag * speed**2
    return smooth_step(speed / e.contact.width) * force if isinstance(e.contact, po.Smooth) else force


def _start(scene):
    """Return deflection and its rate at time 0."""
    first = float(strut(scene, np.zeros(1))[1][0])
    if scene.effects.start == "rest":
        return np.array([0.0, first])
    if scene.effects.start == "towed":
        return np.zeros(2)
    calm = scene.effects.strength_wave.wavelength if scene.effects.strength_wave else 0.0
    return np.array([_resistance(scene, calm, first) / scene.stiffness, 0.0])


def follow(scene, duration, steps=60, kinks=()):
    """Return the `Motion` of a numeric scene; steps end at the end of the tow ramp and at given kinks."""
    k, c, inertia = scene.stiffness, scene.effects.damping or 0.0, scene.inertia

    def rates(t, z, rate):
        path, speed, acceleration = strut(scene, t)
        force = _resistance(scene, path - z, speed - rate) - k * z - c * rate
        return np.array([rate, acceleration + force / inertia])

    breaks = sorted({0.0, duration, *(t for t in (scene.effects.tow_ramp or 0.0, *kinks) if 0.0 < t < duration)})
    state, nodes = _start(scene), []
    for start, end in itertools.pairwise(breaks):
        count = math.ceil(steps * (end - start) / duration)
        size = (end - start) / count
        for i in range(count):
            t = start + (i + C) * size
            slopes = np.repeat(rates(np.array([start + i * size]), *state[:, None]), STAGES, axis=1)
            for _ in range(100):
                stages = state[:, None] + size * slopes @ A.T
                before, slopes = slopes, rates(t, *stages)
                if np.max(np.abs(slopes - before)) <= 4e-16 * np.max(np.abs(slopes)):
                    break
            state = state + size * slopes @ B
            nodes.append((t, *stages, size * B / duration))
    t, z, rate, weights = np.concatenate(nodes, axis=1)
    force = k * z + c * rate
    mean_force, mean_z = weights @ force, weights @ z
    return Motion(
        deflection=float(state[0]),
        speed=float(strut(scene, np.array([duration]))[1][0] - state[1]),
        mean_draft=float(mean_force),
        force_rms=math.sqrt(weights @ (force - mean_force) ** 2),
        mean_deflection=float(mean_z),
        displacement_rms=math.sqrt(weights @ (z - mean_z) ** 2),
        tow_power=float(weights @ (force * strut(scene, t)[1])),
    )
