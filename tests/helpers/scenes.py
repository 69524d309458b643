"""An ordinary scene, of which a test gives only what it changes; results of a run, and own effects."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

import plough_opt as po
from plough_opt.expressions import Expression, cos, sin

SEROZEM = po.named_soil("serozem")
# Soil and share of problem R1.
R1_SOIL = po.Soil(1400.0, 0.8, 15e3, po.deg(30.0), 0.5, 1e4)
# Wedge angle [deg], height [m], stiffness [N/m]; mean and RMS [N] of a reference integration of R1 at 1e-11.
R1_RUNS = (
    (25.0, 0.25, 5e4, 531.047098354, 145.439117595),
    (25.0, 0.25, 6e3, 525.384371406, 209.467549465),
    (25.0, 0.25, 4e5, 530.442387539, 113.154184492),
    (10.0, 0.40, 1e4, 530.957907066, 921.978274273),
    (40.0, 0.15, 5e3, 405.636319546, 107.584572626),
)
SHARE = po.Wedge(po.deg(30.0), po.deg(15.0), 0.25)
SHARP, BLUNT = (po.Wedge(po.deg(angle), po.deg(15.0), height) for angle, height in ((25.0, 0.25), (70.0, 0.40)))


def scene_of(soil=SEROZEM, share=SHARE, stiffness=5e4, mass=20.0, tow_speed=2.0, medium="plastic", **effects):
    return po.Scene(soil, share, stiffness, mass, tow_speed, po.Effects(**effects), medium)


ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")
AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
RESULTS = (*ARRAYS, *AVERAGES)


def results_of(run):
    return [getattr(run, name) for name in RESULTS]


def assert_alike(found, run, allowed):
    """Assert that results, in the order of `RESULTS`, are those of a run up to a part of the largest of each."""
    for name, values, expected in zip(RESULTS, found, results_of(run), strict=True):
        size = np.max(np.abs(expected))
        assert np.ravel(values) == pytest.approx(np.ravel(expected), rel=0, abs=allowed * size), name


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


@dataclass(frozen=True)
class Own:
    """Resistance given by a function of travel and speed, if the field is one."""

    law: Callable

    def force(self, travel, speed):
        return self.law(travel, speed)
