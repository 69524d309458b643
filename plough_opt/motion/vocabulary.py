"""Results of a run by the names that problem files use, such as "mean_draft", and labels for tables and pictures."""

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
    """A named result of a run.

    Attributes:
        unit: SI unit.
        of: run -> value; a column if ``everywhere``.
        needs: results that the scene's law of resistance must give: see `ResistanceLaw.lacking`.
        everywhere: whether it has a value at each output time; it can then be limited, but not minimised.
        random: whether it requires strength that varies along the path; tables show it if that strength is random.
        label: label of its extra row in a run's table on the command line; "" for none.
        measured: whether it can be measured in the field and used in a calibration.
    """

    unit: Unit
    of: Callable[[Run], Expression]
    needs: tuple[str, ...] = ()
    everywhere: bool = False
    random: bool = False
    label: str = ""
    measured: bool = False

    def check(self, name: str, law: ResistanceLaw) -> None:
        """Raise InputError if a law of resistance does not give the measure.

        Args:
            name: name of the measure, for the message.
            law: the law of resistance.
        """
        for what in self.needs:
            if law.lacks(what):
                raise InputError(law.refusal(what, name))

    def given_by(self, law: ResistanceLaw) -> bool:
        """Return whether a law of resistance gives the measure."""
        return not any(map(law.lacks, self.needs))


MEASURES: dict[str, Measure] = {
    "mean_draft": Measure(Unit("N"), lambda run: run.mean_draft, measured=True),
    "force_rms": Measure(Unit("N"), lambda run: run.force_rms, measured=True),
    "mean_deflection": Measure(Unit("m"), lambda run: run.mean_deflection, measured=True),
    "displacement_rms": Measure(Unit("m"), lambda run: run.displacement_rms, measured=True),
    "tow_power": Measure(Unit("W"), lambda run: run.tow_power, measured=True),
    "specific_draft": Measure(Unit("Pa"), lambda run: run.specific_draft, ("loosened_radius",)),
    "loosened_radius": Measure(Unit("m"), lambda run: run.scene.loosened_radius, ("loosened_radius",), measured=True),
    "half_angle": Measure(Unit("rad"), lambda run: run.scene.cone.half_angle),
    "moving_mass": Measure(Unit("kg"), lambda run: run.scene.mass),
    "added_mass": Measure(Unit("kg"), lambda run: run.scene.carried_soil, ("added_mass",), measured=True),
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
"""Results by name; angles in rad. A measure added here can be used in files, sweeps, fronts and components."""

_LABELS = {
    "force_rms": "RMS of the mount force",
    "displacement_rms": "RMS of the deflection",
    "specific_draft": "draft per loosened section",
    "stationary_force_rms": "stationary RMS of the mount force",
    "stationary_displacement_rms": "stationary RMS of the deflection",
}
_SIDES = {"at_least": "at least", "at_most": "at most", "lower": "lower bound", "upper": "upper bound"}


def called(name: str) -> str:
    """Return the label, in tables and pictures, of a quantity, a result, a limit of either, or a user's own name.

    Args:
        name: such as "share.height", "front.share.height", "force_rms", "loosened_radius at_least" or "my draft".
    """
    if name in _LABELS:
        return _LABELS[name]
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
