"""A soil with known parameters, scenes in it, and their drafts."""

import numpy as np

import plough_opt as po

# Name -> true value, and bounds of an estimate.
KNOWN = {
    "soil.cohesion": (20e3, 1e3, 80e3),
    "soil.friction_angle": (po.deg(28.0), po.deg(10.0), po.deg(45.0)),
    "soil.density_ratio": (0.794, 0.6, 0.95),
    "soil.tool_friction": (0.5, 0.05, 1.5),
    "soil.ambient_pressure": (60e3, 1e3, 200e3),
    "effects.rate_term": (0.02, 0.0, 0.2),
}
TRUTH = {name: true for name, (true, _, _) in KNOWN.items()}
BOUNDS = {name: (low, high) for name, (_, low, high) in KNOWN.items()}


def steady_scene(tow_speed=2.0, wedge_angle=0.7, **soil):
    """Return a quasi-static scene with the true values, or others."""
    own = {key.removeprefix("soil."): value for key, value in TRUTH.items() if key.startswith("soil.")} | soil
    effects = po.Effects(motion=False, rate_term=TRUTH["effects.rate_term"])
    share = po.Wedge(wedge_angle, po.deg(15.0), 0.25)
    return po.Scene(po.Soil(density=1350.0, **own), share, 5e4, 25.0, tow_speed, effects)


def drafts(speeds, angles):
    """Return conditions and true drafts over all combinations of speeds and wedge angles."""
    v, a = (column.ravel() for column in np.meshgrid(speeds, angles))
    exact = np.array([float(steady_scene(x, y).steady_resistance) for x, y in zip(v, a, strict=True)])
    return {"scene.tow_speed": v, "share.wedge_angle": a}, exact
