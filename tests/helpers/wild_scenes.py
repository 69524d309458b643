"""Scenes sampled over the whole domain and all combinations of effects, and the errors of their runs."""

import math

import numpy as np

import plough_opt as po
from helpers import three_modes
from helpers.scenes import Shank
from plough_opt.motion.solvers.plan import numbers_of, phase

# Largest phase [rad] of the fastest oscillation; the reference, in Python, then takes seconds.
MOST_PHASE = 1500.0
# Rounding of forces, deflections and speeds in double precision, relative to the largest ones of the motion.
ROUNDING = 1e-13
# Outputs this close to an event, relative to the duration, may lie on either side of its jump.
BESIDE = 1e-9


def sampled(seed, most_phase=MOST_PHASE, speed_term=False):
    """Return a scene with a motion, its duration [s] and its outputs; None if it is refused or oscillates too often."""
    random = np.random.default_rng([seed, 20])

    def log(low, high):
        return float(10.0 ** random.uniform(low, high))

    def pick(*values):
        return values[int(random.integers(len(values)))]

    def maybe(value):
        return value if random.random() < 0.4 else None

    soil = po.Soil(
        density=log(2.5, 3.5),
        density_ratio=pick(float(random.uniform(0.5, 0.95)), log(-6, -1), 1.0 - log(-6, -1)),
        cohesion=pick(0.0, log(3, 5), log(0, 6.3)),
        friction_angle=pick(0.0, float(random.uniform(0.1, 0.8))),
        tool_friction=pick(0.0, float(random.uniform(0.0, 1.5))),
        ambient_pressure=pick(0.0, log(2, 6)),
    )
    share = po.Wedge(
        pick(float(random.uniform(0.02, 1.45)), log(-5, -2)), float(random.uniform(0.0, 1.0)), log(-2, 0.3)
    )
    law = pick("resisting", po.Smooth(log(-2, 0)), po.StickSlip(pick(1.0, float(random.uniform(1.0, 3.0)))))
    start = pick("equilibrium", "rest", "towed")
    effects = {
        "inertial_drag": random.random() < 0.7,
        "added_mass": random.random() < 0.7,
        "ambient_pressure": random.random() < 0.7,
        "contact": law,
        "start": start,
        "entry": start != "equilibrium" and random.random() < 0.4,
        "strength_wave": pick(None, po.StrengthWave(float(random.uniform(0.0, 1.0)), log(-1.5, 0.5))),
        "tow_ramp": maybe(log(-2.5, 0.3)),
        "damping": pick(None, log(-1, 4)),
        "rate_term": maybe(log(-3, 0)),
        "own": (Shank(log(0, 3), log(0, 3)),) if random.random() < 0.15 and not isinstance(law, po.StickSlip) else (),
        "formulation": "printed" if random.random() < 0.04 else "derived",
    }
    mount = pick(log(3, 6), log(1, 8)), pick(log(0, 2), log(-1, 3)), log(-2, 0.8)
    duration, outputs = pick(log(-1.5, 0.3), log(-4, -1.5)), pick(1, 5, 40, 100, 400)
    effects["speed_term"] = maybe(log(-3, 0)) if speed_term else None
    try:
        scene = po.Scene(soil, share, *mount, po.Effects(**effects))
    except po.PloughError:
        return None
    return (scene, duration, outputs) if phase(numbers_of(scene), duration) < most_phase else None


def truth(scene, duration, outputs=400):
    """Return the motion of a scene by SciPy, with the errors of its own results.

    A tolerance a hundred times as large changes them by ten times as much at least.
    """
    exact, rough = (three_modes.follow(scene, duration, outputs, tolerance) for tolerance in (1e-13, 1e-11))
    rough.scene, rough.duration, exact.errors = scene, duration, {}
    exact.errors = {name: 0.1 * error for name, error in errors(rough, exact).items()}
    return exact


def errors(run, truth):
    """Return the errors of a run's results by name, relative to the scale of each, beyond those of the truth.

    The rounding of doubles is left out.
    """
    scene, stiffness = run.scene, run.scene.stiffness

    def peak(name):
        return float(np.max(np.abs(getattr(truth, name))))

    speed, hardness = peak("speed") + scene.tow_speed, math.sqrt(stiffness * scene.inertia)
    # The truth's travel is rounded to some 1e-14 of itself, which the spring turns into force.
    force = max(peak("mount_force"), peak("soil_resistance")) + hardness * speed + 0.1 * stiffness * peak("travel")
    apart = ~truth.near_a_change(BESIDE * run.duration)
    size, size_z = max(abs(truth.mean_draft), truth.force_rms), max(abs(truth.mean_deflection), truth.displacement_rms)
    # The path of the strut is that of the share plus the deflection.
    path = truth.travel + truth.deflection
    power = max(abs(truth.tow_power), size * float(path[-1] - path[0]) / run.duration)
    # Name -> scale, and what rounds to `ROUNDING`.
    compared = {
        "mount_force": (peak("mount_force"), force),
        "soil_resistance": (peak("soil_resistance"), force),
        "deflection": (peak("deflection"), force / stiffness),
        "speed": (peak("speed"), speed + force / hardness),
        "travel": (max(peak("travel"), peak("deflection")), force / stiffness),
        "mean_draft": (size, force),
        "force_rms": (truth.force_rms, force),
        "mean_deflection": (size_z, force / stiffness),
        "displacement_rms": (truth.displacement_rms, force / stiffness),
        "tow_power": (power, force * scene.tow_speed),
    }
    found = {}
    for name, (scale, rounded) in compared.items():
        wrong = np.abs(getattr(run, name) - getattr(truth, name))
        # These jump where the share changes its mode.
        wrong = wrong * apart if name in ("soil_resistance", "speed") else wrong
        beyond = float(np.max(wrong)) - ROUNDING * rounded
        found[name] = max(beyond / float(scale) - truth.errors.get(name, 0.0), 0.0) if beyond > 0.0 else 0.0
    return found
