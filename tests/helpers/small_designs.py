"""Designs with a few variables."""

import plough_opt as po
from helpers.scenes import scene_of


def design(**variables):
    """Return a design and the symbols of its variables.

    Args:
        variables: name -> guess, lower bound, upper bound and optionally unit, whether to scale by the logarithm, and
            tolerance.
    """
    d = po.Design()
    symbols = [
        d.variable(name, guess=at, lower=low, upper=high, **dict(zip(("unit", "log", "tolerance"), more, strict=False)))
        for name, (at, low, high, *more) in variables.items()
    ]
    return d, *symbols


def sticking(x):
    """Return the draft of a run that is integrated by itself, because of its events."""
    return po.simulate(scene_of(stiffness=2e4 * (1.0 + x), contact=po.StickSlip()), 0.02, outputs=1).mean_draft


def softest(soil, wave, stiffness=(7e4, 6e4, 1.2e5), duration=0.4, accuracy=None, **effects):
    """Return a simplified problem R1, whose only variable, the stiffness, has an optimum between its bounds."""
    d, k0 = design(stiffness=(*stiffness, "N/m"))
    share = po.Wedge(po.deg(30.0), po.deg(15.0), 0.2)
    scene = po.Scene(soil, share, k0, 25.0, 2.0, po.Effects(strength_wave=wave, **effects))
    d.minimise(po.simulate(scene, duration, outputs=4, accuracy=accuracy).force_rms / 1e2)
    return d
