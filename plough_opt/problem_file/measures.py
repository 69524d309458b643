"""What a problem file can minimise or require, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from plough_opt.expressions import Expression
from plough_opt.forces import added_mass
from plough_opt.motion import Run
from plough_opt.problem_file.units import Unit


@dataclass(frozen=True)
class Measure:
    """A result of a run that a file can name.

    Attributes:
        unit: SI unit.
        of: run -> value, a column where ``everywhere``.
        everywhere: a value at every output time; it can be limited, and not minimised.
        plastic: belongs to the plastic gas alone.
    """

    unit: Unit
    of: Callable[[Run], Expression]
    everywhere: bool = False
    plastic: bool = False


MEASURES: dict[str, Measure] = {
    "mean_draft": Measure(Unit("N"), lambda run: run.mean_draft),
    "force_rms": Measure(Unit("N"), lambda run: run.force_rms),
    "mean_deflection": Measure(Unit("m"), lambda run: run.mean_deflection),
    "displacement_rms": Measure(Unit("m"), lambda run: run.displacement_rms),
    "tow_power": Measure(Unit("W"), lambda run: run.tow_power),
    "specific_draft": Measure(Unit("Pa"), lambda run: run.specific_draft, plastic=True),
    "loosened_radius": Measure(Unit("m"), lambda run: run.scene.loosened_radius, plastic=True),
    "half_angle": Measure(Unit("rad"), lambda run: run.scene.cone.half_angle),
    "moving_mass": Measure(Unit("kg"), lambda run: run.scene.mass),
    "added_mass": Measure(Unit("kg"), lambda run: added_mass(run.scene.cone, run.scene.soil), plastic=True),
    "deflection": Measure(Unit("m"), lambda run: run.deflection, everywhere=True),
    "mount_force": Measure(Unit("N"), lambda run: run.mount_force, everywhere=True),
    "soil_resistance": Measure(Unit("N"), lambda run: run.soil_resistance, everywhere=True),
    "speed": Measure(Unit("m/s"), lambda run: run.speed, everywhere=True),
}
