"""Density profiles for the toolkit, and their precise counterparts in `precise_field`."""

from typing import NamedTuple

import plough_opt as po
from helpers.equations import mp
from helpers.precise_field import Field
from plough_opt.core.expressions import exp
from plough_opt.soil import plastic

DENSITY = 1400.0
"""Density of the undisturbed soil [kg/m^3]."""

STRENGTH = {"friction_angle": 0.5, "cohesion": 2e4, "ambient_pressure": 1e4}


DENSITIES = {
    "exponential, b rising": (lambda r, c, w: DENSITY / (c - exp(-r / w) / 4.0), (0.9, 0.1)),
    "exponential, b falling": (lambda r, c, w: DENSITY / (c + exp(-r / w) / 4.0), (0.55, 0.1)),
    "quadratic, b rising": (lambda r, c, w: DENSITY * c * (1.0 - (r / w) ** 2), (1.4, 0.4)),
    "quadratic, b falling": (lambda r, c, w: DENSITY * c * (1.0 + (r / w) ** 2), (1.1, 0.2)),
    "bell": (lambda r, c, w: DENSITY * c * (1.0 + exp(-((r / w) ** 2)) / 4.0), (1.1, 0.05)),
}
"""Name -> density [kg/m^3] as a function of radius and two parameters, and their values. The bell varies most."""


class Ground(NamedTuple):
    """A named profile in soil with a given strength."""

    name: str
    parameters: tuple
    friction_angle: object = STRENGTH["friction_angle"]
    cohesion: object = STRENGTH["cohesion"]

    def soil(self, order):
        """Return the toolkit's soil."""
        plain = po.Soil(DENSITY, 0.5, self.cohesion, self.friction_angle, 0.45, STRENGTH["ambient_pressure"])
        return plain.with_density_profile(DENSITIES[self.name][0], *self.parameters, order=order)

    def field(self, radius, rate, acceleration):
        """Return the precise field around a cavity."""
        values = (*self.parameters, radius, rate, acceleration, self.friction_angle, self.cohesion)
        return Field(self.name, *map(mp.mpf, (*values, STRENGTH["ambient_pressure"], DENSITY)))


def ground(name, **strength):
    """Return a profile with its default parameters."""
    return Ground(name, DENSITIES[name][1], **strength)


def field(quantity, r, cavity, soil):
    """Return a quantity of the toolkit's field by its name, at a Lagrangian radius if it depends on that."""
    if quantity in ("radial", "tangential"):
        return getattr(plastic.stress(r, cavity, soil), quantity)
    of_cavity = quantity in ("surface_pressure", "front_radius", "front_speed")
    return getattr(plastic, quantity)(*([] if of_cavity else [r]), cavity, soil)
