"""An ordinary scene, of which a test gives only what it changes, and own effects."""

import math
from dataclasses import dataclass

import plough_opt as po
from plough_opt.expressions import Expression, cos, sin

SEROZEM = po.named_soil("serozem")
# Soil and share of problem R1.
R1_SOIL = po.Soil(
    density=1400.0,
    density_ratio=0.8,
    cohesion=15e3,
    friction_angle=po.deg(30.0),
    tool_friction=0.5,
    ambient_pressure=1e4,
)
SHARE = po.Wedge(po.deg(30.0), po.deg(15.0), 0.25)
SHARP, BLUNT = (po.Wedge(po.deg(angle), po.deg(15.0), height) for angle, height in ((25.0, 0.25), (70.0, 0.40)))


def scene_of(soil=SEROZEM, share=SHARE, stiffness=5e4, mass=20.0, tow_speed=2.0, medium="plastic", **effects):
    return po.Scene(soil, share, stiffness, mass, tow_speed, po.Effects(**effects), medium)


@dataclass(frozen=True)
class Shank:
    """A resistance that grows with speed and travel."""

    static: Expression = 0.0
    viscous: Expression = 0.0
    quadratic: Expression = 0.0
    per_metre: Expression = 0.0

    def force(self, travel, speed):
        return self.static + self.per_metre * travel + self.viscous * speed + self.quadratic * speed**2


@dataclass(frozen=True)
class Waves:
    """A resistance that varies along the travel, with a mean other than the value at the start."""

    sine: float
    cosine: float = 0.0
    wavelength: float = 0.2

    def force(self, travel, speed):
        angle = 2.0 * math.pi / self.wavelength * travel
        return self.sine * sin(angle) + self.cosine * cos(angle) + 0.0 * speed
