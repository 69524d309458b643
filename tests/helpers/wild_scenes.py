"""Scenes sampled over the whole domain and all combinations of effects, and the errors of their runs."""

import math

import numpy as np

import plough_opt as po
from helpers.scenes import Shank
from plough_opt.motion.plan import numbers_of, phase

# Largest phase [rad] of the fastest oscillation; the reference, in Python and the widest floats, then takes seconds.
MOST_PHASE = 1500.0
# Rounding of forces, deflections and speeds in double precision, relative to the largest ones of the motion.
ROUNDING = 1e-13
# Outputs this close to an event, relative to the duration, may lie on either side of its jump.
BESIDE = 1e-9


def sampled(seed, most_phase=MOST_PHASE):
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
    try:
        scene = po.Scene(soil, share, *mount, po.Effects(**effects))
    except po.PloughError:
        return None
    return (scene, duration, outputs) if phase(numbers_of(scene), duration) < most_phase else None


def errors(run, reference):
    """Return the errors of a run's results by name, relative to the scale of each, without the rounding of doubles."""
    truth = reference.run
    scene = run.scene
    stiffness, speed = scene.stiffness, float(np.max(np.abs(truth.speed))) + scene.tow_speed
    hardness = math.sqrt(stiffness * scene.inertia)
    force = max(float(np.max(np.abs(x))) for x in (truth.mount_force, truth.soil_resistance)) + hardness * speed
    rounding = {
        "force": ROUNDING * force,
        "z": ROUNDING * force / stiffness,
        "speed": ROUNDING * (speed + force / hardness),
    }
    moments = np.array([float(moment) for moment, _ in reference.events] or [-math.inf])
    apart = np.min(np.abs(run.time[:, None] - moments), axis=1) > BESIDE * run.duration
    peak_z = float(np.max(np.abs(truth.deflection)))
    found = {}

    def note(name, error, scale, kind):
        beyond = max(0.0, float(error) - rounding[kind])
        found[name] = beyond / float(scale) if beyond > 0.0 else 0.0

    forces = dict.fromkeys(("mount_force", "soil_resistance"), "force")
    for name, kind in (forces | {"deflection": "z", "speed": "speed", "travel": "z"}).items():
        wrong = np.abs(getattr(run, name) - getattr(truth, name))
        # These jump where the share changes its mode.
        wrong = wrong * apart if name in ("soil_resistance", "speed") else wrong
        size = float(np.max(np.abs(getattr(truth, name))))
        note(name, np.max(wrong), max(size, peak_z) if name == "travel" else size, kind)
    note("peak_force", abs(run.peak_force - np.max(truth.mount_force)), np.max(np.abs(truth.mount_force)), "force")
    note("peak_deflection", abs(run.peak_deflection - np.max(truth.deflection)), peak_z, "z")
    size, size_z = max(abs(truth.mean_draft), truth.force_rms), max(abs(truth.mean_deflection), truth.displacement_rms)
    # The path of the strut is that of the share plus the deflection.
    towed = float((truth.travel + truth.deflection)[-1] - (truth.travel + truth.deflection)[0]) / run.duration
    power = max(abs(truth.tow_power), size * towed)
    rounding["power"] = rounding["force"] * scene.tow_speed
    averages = {
        "mean_draft": (size, "force"), "force_rms": (truth.force_rms, "force"), "mean_deflection": (size_z, "z"),
        "displacement_rms": (truth.displacement_rms, "z"), "tow_power": (power, "power"),
    }  # fmt: skip
    for name, (scale, kind) in averages.items():
        note(name, abs(getattr(run, name) - getattr(truth, name)), scale, kind)
    return found
