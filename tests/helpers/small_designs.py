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
