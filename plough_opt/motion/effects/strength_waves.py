"""Soil strength that varies along the path as a sum of sines: see `plough_opt.soil.waves`."""

import math
from dataclasses import dataclass
from typing import Any

from plough_opt.core.expressions import Expression, sin
from plough_opt.motion.effects.term import Parameters, Place, Term, Towed
from plough_opt.soil.waves import StrengthWave


@dataclass(frozen=True)
class StrengthWaves(Term):
    """Static resistance F0 (1 + sum of amplitude sin(2 pi L/wavelength + phase)).

    Attributes:
        count: number of waves.
        phased: whether any wave has a phase.
        turns: periods of each wave in the common period, for an orbit under several waves; otherwise ().
    """

    count: int
    phased: bool = False
    turns: tuple[int, ...] = ()

    label, field = "strength wave", "strength_wave"
    usual = StrengthWave(0.3, 0.2)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for wave in map(wave_names, range(self.count)) for name in wave[: 2 + self.phased])

    @classmethod
    def of(cls, scene: Towed) -> tuple[Term, ...]:
        effects, waves = scene.effects, scene.effects.waves
        phased = any(not isinstance(wave.phase, int | float) or wave.phase != 0.0 for wave in waves)
        turns = effects.turns if effects.orbit != "transient" and len(waves) > 1 else ()
        return (cls(len(waves), phased, turns),) if waves else ()

    def values(self, scene: Towed) -> dict[str, Expression]:
        waves = ((wave.amplitude, wave.wavelength, wave.phase) for wave in scene.effects.waves)
        return dict(zip(self.names, (x for wave in waves for x in wave[: 2 + self.phased]), strict=True))

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        if at.travel is None:
            return force
        total: Expression = 0.0
        for k in range(self.count):
            amplitude, length, phase = wave_names(k)
            # On an orbit all wavelengths follow from the first one, so that they stay commensurate.
            turn = 2.0 * math.pi * self.turns[k] / self.repeats(p) if self.turns else 2.0 * math.pi / p[length]
            angle = turn * at.travel + p[phase] if self.phased else turn * at.travel
            total = total + p["static"] * p[amplitude] * sin(angle)
        return force + at.varying(total)

    def repeats(self, p: Parameters) -> Expression:
        """Return the length [m] of path after which the soil of an orbit repeats itself."""
        return p["wavelength"] * self.turns[0] if self.turns else p["wavelength"]

    @staticmethod
    def imposed(p: Parameters) -> list[Any]:
        # Twice the wave's frequency: the force is a sine of the travel, whose oscillation adds harmonics.
        return [4.0 * math.pi * p["tow_speed"] / length for name, length in p.items() if name.startswith("wavelength")]


def wave_names(k: int) -> tuple[str, str, str]:
    """Return the names of amplitude, wavelength and phase of strength wave k, counted from 0."""
    number = "" if k == 0 else f"_{k + 1}"
    return f"wave_amplitude{number}", f"wavelength{number}", f"wave_phase{number}"
