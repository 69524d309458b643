"""The effects that a problem file describes."""

from collections.abc import Mapping
from typing import Literal

from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import MOST_WAVES, wave_table
from plough_opt.motion.effects import Effects, HarmonicBalance, Smooth, StickSlip
from plough_opt.problem_file.named import own_effects_of
from plough_opt.problem_file.schema import RANDOM, EffectsTable
from plough_opt.soil.random_strength import RandomStrength, Spectrum
from plough_opt.soil.waves import StrengthWave


def effects_of(table: EffectsTable, values: Mapping[str, Expression], spectrum: Spectrum | None) -> Effects:
    """Return the effects of a file.

    Args:
        table: the file's [effects].
        values: every quantity of the file by key, numbers or symbols, SI.
        spectrum: of the record that random strength is read from, if it is.
    """
    names = [name for name in map(wave_table, range(1, MOST_WAVES + 1)) if f"{name}.amplitude" in values]
    waves = [
        StrengthWave(values[f"{name}.amplitude"], values[f"{name}.wavelength"], values.get(f"{name}.phase", 0.0))
        for name in names
    ]
    random = [values.get(f"{RANDOM}.{key}") for key in ("rms", "correlation_length")]
    return Effects(
        motion=table.motion,
        inertial_drag=table.inertial_drag,
        added_mass=table.added_mass,
        ambient_pressure=table.ambient_pressure,
        contact=_contact(table.contact, values),
        start=table.start,
        entry=table.entry,
        strength_wave=waves[0] if len(waves) == 1 else tuple(waves) or None,
        random_strength=RandomStrength(*random) if None not in random else spectrum,
        tow_ramp=values.get("effects.tow_ramp"),
        damping=values.get("effects.damping"),
        rate_term=values.get("effects.rate_term"),
        orbit=HarmonicBalance(table.harmonics) if table.orbit == "harmonic_balance" else table.orbit,
        formulation=table.formulation,
        own=own_effects_of(table.own),
    )


def _contact(law: str, values: Mapping[str, Expression]) -> Literal["resisting"] | Smooth | StickSlip:
    """Return the contact law that a file names."""
    if law == "smooth":
        return Smooth(values["effects.contact_width"])
    if law == "stick_slip":
        return StickSlip(values.get("effects.breakaway", StickSlip.breakaway))
    return "resisting"
