"""Soil strength that varies along the path as a sine or a sum of sines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic
from plough_opt.core.quantities import read_fields

# Longest common period of several waves, in multiples of the longest wavelength.
_MOST_TURNS = 100
# Relative error up to which wavelengths count as commensurate; records and files give fewer digits than that.
_COMMENSURATE = 1e-9
# Points per shortest wavelength at which the strength is evaluated; a minimum between them is lower by at most 1e-3.
_POINTS = 64
_MOST_POINTS = 1_000_000


@dataclass(frozen=True)
class StrengthWave:
    """Soil strength that varies along the path: F0 is multiplied by 1 + amplitude sin(2 pi L/wavelength + phase).

    Args:
        amplitude: epsilon [-], from 0 to 1.
        wavelength: ell [m], above 0.
        phase: phase at travel 0 [rad], from -2 pi to 2 pi. It does not change a start at equilibrium, which uses the
            mean strength.

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
    """Return how many wavelengths of each wave fit into their common period.

    Raises:
        InputError: a wavelength is a symbol, or there is no common period within a hundred of the longest wavelength.
    """
    if len(waves) == 1:
        return (1,)
    if any(is_symbolic(wave.wavelength) for wave in waves):
        raise InputError("a periodic orbit under several waves needs numeric wavelengths: they determine its period")
    lengths = np.array([float(as_number(wave.wavelength)) for wave in waves])
    for count in range(1, _MOST_TURNS + 1):
        turns = count * np.max(lengths) / lengths
        if np.all(np.abs(turns - np.round(turns)) <= _COMMENSURATE * turns):
            return tuple(int(turn) for turn in np.round(turns))
    raise InputError(
        f"the strength waves ({', '.join(f'{length:g}' for length in lengths)} m) have no common period within"
        f" {_MOST_TURNS} of the longest, so the motion is not periodic: simulate from a start"
    )


def check_strength(waves: Sequence[StrengthWave], path: tuple[float, float] | None = None) -> None:
    """Raise DomainError if waves together make the soil's strength negative; the message gives the place.

    Args:
        waves: the strength waves; symbolic amplitudes are not checked.
        path: start and end [m] of the share's path, if known; otherwise the sum of the amplitudes must not exceed 1.
    """
    if len(waves) < 2 or any(is_symbolic(wave.amplitude) for wave in waves):
        return
    total = float(np.max(sum(as_number(wave.amplitude) for wave in waves)))
    if total <= 1.0 + _COMMENSURATE:
        return
    if path is None:
        raise DomainError(
            f"the sum of the strength waves' amplitudes is {total:.6g} and must be at most 1 if the path is not known:"
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
            f"the strength waves change the soil's strength by a factor of {strength[least]:.4g} at a travel of"
            f" {travel[least]:.4g} m, which must be at least 0: soil cannot push the share forward; reduce an amplitude"
        )
