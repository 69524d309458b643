"""Soil strength that varies along the path as one sine or a sum of several."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic
from plough_opt.core.quantities import read_fields

# Longest wavelengths within which several waves must repeat themselves for a lasting orbit, and the relative difference
# of lengths that are commensurate: what a record or a file says has fewer digits.
_MOST_TURNS = 100
_COMMENSURATE = 1e-9
# Points in the shortest wavelength at which strength is looked at, and most points: what is missed between is 1e-3.
_POINTS = 64
_MOST_POINTS = 1_000_000


@dataclass(frozen=True)
class StrengthWave:
    """Soil strength that varies along the path: F0 is multiplied by 1 + amplitude sin(2 pi L/wavelength + phase).

    Args:
        amplitude: epsilon [-], from 0 to 1.
        wavelength: ell [m], above 0.
        phase: at travel 0 [rad], at most one turn either way. A start at equilibrium is at the deflection of the mean
            strength all the same.

    Example:
        >>> import plough_opt as po
        >>> po.StrengthWave(amplitude=0.3, wavelength="20 cm").wavelength
        0.2
    """

    amplitude: Expression
    wavelength: Expression
    phase: Expression = 0.0

    def __post_init__(self) -> None:
        read_fields(self, **{name: f"effects.strength_wave.{name}" for name in ("amplitude", "wavelength", "phase")})


def turns_of(waves: Sequence[StrengthWave]) -> tuple[int, ...]:
    """Return how often each wave turns before all repeat themselves together.

    Raises:
        InputError: wavelengths that are symbols, or that have no common length within a hundred of the longest.
    """
    if len(waves) == 1:
        return (1,)
    if any(is_symbolic(wave.wavelength) for wave in waves):
        raise InputError("a lasting orbit under several waves needs numeric wavelengths: they decide its period")
    lengths = np.array([float(as_number(wave.wavelength)) for wave in waves])
    for count in range(1, _MOST_TURNS + 1):
        turns = count * np.max(lengths) / lengths
        if np.all(np.abs(turns - np.round(turns)) <= _COMMENSURATE * turns):
            return tuple(int(turn) for turn in np.round(turns))
    raise InputError(
        f"the strength waves ({', '.join(f'{length:g}' for length in lengths)} m) have no common length within"
        f" {_MOST_TURNS} of the longest, so no motion repeats itself: simulate from a start"
    )


def check_strength(waves: Sequence[StrengthWave], path: tuple[float, float] | None = None) -> None:
    """Refuse waves that together leave the soil less than no strength.

    Args:
        waves: the strength waves; those whose amplitudes are symbols pass.
        path: from and to [m] where the share comes, if known; without it the amplitudes must not exceed 1 in sum.

    Raises:
        DomainError: as said; the message gives the place.
    """
    if len(waves) < 2 or any(is_symbolic(wave.amplitude) for wave in waves):
        return
    total = sum(float(as_number(wave.amplitude)) for wave in waves)
    if total <= 1.0 + _COMMENSURATE:
        return
    if path is None:
        raise DomainError(
            f"the strength waves' amplitudes are {total:.6g} in sum and must be at most 1 where the path is not known:"
            " soil cannot push the share forward"
        )
    numbers = [[float(as_number(x)) for x in (w.amplitude, w.wavelength, w.phase)] for w in waves]
    count = (path[1] - path[0]) / min(length for _, length, _ in numbers) * _POINTS
    travel = np.linspace(*path, int(min(count, _MOST_POINTS)) + 2)
    sines = [size * np.sin(2.0 * math.pi * travel / length + shift) for size, length, shift in numbers]
    strength = 1.0 + np.sum(sines, axis=0)
    least = int(np.argmin(strength))
    if strength[least] < 0.0:
        raise DomainError(
            f"the strength waves leave the soil {strength[least]:.4g} of its strength at a travel of"
            f" {travel[least]:.4g} m, which must be at least 0: soil cannot push the share forward; lower an amplitude"
        )
