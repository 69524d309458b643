"""Quantities and results by the names that problem files give them, such as "share.height" and "mean_draft"."""

from collections.abc import Callable
from dataclasses import dataclass

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY
from plough_opt.core.units import Unit
from plough_opt.laws.forces import cone_index
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion import Run


@dataclass(frozen=True)
class Measure:
    """A result of a run that can be named.

    Attributes:
        unit: SI unit.
        of: run -> value, a column where ``everywhere``.
        needs: what the scene's law of resistance must give for it: see `ResistanceLaw.lacking`.
        everywhere: a value at every output time; it can be limited, and not minimised.
        random: belongs to strength that varies along the path, and stands in tables where that is random.
        label: under which a run's table shows it on the command line; "" where the table holds it anyhow, or not.
        measured: whether it can be measured in the field, and so be calibrated with.
        adds: whether several shares in one frame have it together, as their sum.
    """

    unit: Unit
    of: Callable[[Run], Expression]
    needs: tuple[str, ...] = ()
    everywhere: bool = False
    random: bool = False
    label: str = ""
    measured: bool = False
    adds: bool = False

    def check(self, name: str, law: ResistanceLaw) -> None:
        """Refuse a measure that a law of resistance does not give.

        Raises:
            InputError: as said.
        """
        for what in self.needs:
            if law.lacks(what):
                raise InputError(law.refusal(what, name))

    def given_by(self, law: ResistanceLaw) -> bool:
        """Return whether a law of resistance gives it."""
        return not any(map(law.lacks, self.needs))


MEASURES: dict[str, Measure] = {
    "mean_draft": Measure(Unit("N"), lambda run: run.mean_draft, measured=True, adds=True),
    "force_rms": Measure(Unit("N"), lambda run: run.force_rms, measured=True),
    "mean_deflection": Measure(Unit("m"), lambda run: run.mean_deflection, measured=True),
    "displacement_rms": Measure(Unit("m"), lambda run: run.displacement_rms, measured=True),
    "tow_power": Measure(Unit("W"), lambda run: run.tow_power, measured=True, adds=True),
    "specific_draft": Measure(Unit("Pa"), lambda run: run.specific_draft, ("loosened_radius",)),
    "loosened_radius": Measure(Unit("m"), lambda run: run.scene.loosened_radius, ("loosened_radius",), measured=True),
    "half_angle": Measure(Unit("rad"), lambda run: run.scene.cone.half_angle),
    "moving_mass": Measure(Unit("kg"), lambda run: run.scene.mass, adds=True),
    "added_mass": Measure(Unit("kg"), lambda run: run.scene.carried_soil, ("added_mass",), measured=True, adds=True),
    "cone_index": Measure(Unit("Pa"), lambda run: cone_index(run.scene.soil), ("cone_index",), measured=True),
    "stationary_force_rms": Measure(Unit("N"), lambda run: run.scene.stationary_force_rms, ("motion",), random=True),
    "stationary_displacement_rms": Measure(
        Unit("m"), lambda run: run.scene.stationary_displacement_rms, ("motion",), random=True
    ),
    "deflection": Measure(Unit("m"), lambda run: run.deflection, everywhere=True),
    "mount_force": Measure(Unit("N"), lambda run: run.mount_force, everywhere=True, measured=True),
    "soil_resistance": Measure(Unit("N"), lambda run: run.soil_resistance, everywhere=True),
    "speed": Measure(Unit("m/s"), lambda run: run.speed, everywhere=True),
}
"""Results by name; an angle in rad. One that is added is a result in files, sweeps, fronts and components."""

_CALLED = {
    "force_rms": "RMS of the mount force",
    "displacement_rms": "RMS of the deflection",
    "specific_draft": "draft per loosened section",
    "stationary_force_rms": "stationary RMS of the mount force",
    "stationary_displacement_rms": "stationary RMS of the deflection",
}
_SIDES = {"at_least": "at least", "at_most": "at most"}


def called(name: str) -> str:
    """Return what tables and pictures call a quantity, a result, a limit of one, or a name of one's own.

    Args:
        name: such as "share.height", "front.share.height", "force_rms", "loosened_radius at_least" or "my draft".
    """
    if name in _CALLED:
        return _CALLED[name]
    if name in MEASURES and MEASURES[name].label:
        return MEASURES[name].label
    if name in EVERY:
        return EVERY[name].called
    first, _, side = name.rpartition(" ")
    if side in _SIDES:
        return f"{called(first)}, {_SIDES[side]}"
    share, _, key = name.partition(".")
    if share.isidentifier() and (key in MEASURES or key in EVERY or key.startswith("peak_")):
        return f"{called(key)}, {share}"
    return name if " " in name else name.rpartition(".")[2].replace("_", " ")
