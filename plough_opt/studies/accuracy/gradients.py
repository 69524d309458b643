"""Reference gradients: central differences of the motion in the widest floats, where they lose few digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

from plough_opt.core.errors import IntegrationError
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.laws import Laws
from plough_opt.studies.accuracy.picard import EPS, WIDE, Wide
from plough_opt.studies.accuracy.reference import DEGREE, beside_orbit, follow, orbit

QUANTITIES: Final = ("stiffness", "mass", "tow_speed")
"""Quantities of a scene by which gradients are taken."""

AVERAGES: Final = ("mean_draft", "force_rms")
"""Averages whose gradients are taken."""

_Averages: TypeAlias = Callable[[Laws], tuple[Wide, tuple[str, ...]]]

# Weights of f(k) - f(-k), k = 1 to 4, in the derivative at 0, of order 8.
_WEIGHTS = (WIDE(4) / 5, -WIDE(1) / 5, WIDE(4) / 105, -WIDE(1) / 280)


@dataclass(frozen=True)
class ReferenceGradient:
    """Logarithmic derivatives x d/dx of `AVERAGES`, a row each [N], by `QUANTITIES`, a column each.

    Attributes:
        values: the derivatives.
        error: their estimated error relative to the largest of them [-].
    """

    values: Wide
    error: float


def reference_gradient(scene: Scene, duration: float | None, *, tries: int = 2) -> ReferenceGradient:
    """Return the gradient of mean draft and RMS by central differences of order 8 of the reference motion.

    Differences over shorter and shorter steps are compared, which gives their error.

    Args:
        scene: numeric.
        duration: simulated time [s]; None for a lasting orbit.
        tries: how many step lengths are tried at most, at least 2.

    Raises:
        InputError: as `reference_run`.
        IntegrationError: as `reference_run`, or no steps over which the events stay the same ones.
    """
    laws = Laws.of(scene)
    guess = beside_orbit(scene) if scene.effects.orbit == "periodic" else None

    def averages(varied: Laws) -> tuple[Wide, tuple[str, ...]]:
        if guess is not None:
            found = orbit(varied, guess, 1, DEGREE)
        else:
            found = follow(varied, WIDE(duration), 1, DEGREE)
        return np.array([getattr(found, name) for name in AVERAGES]), tuple(name for _, name in found.events)

    sequence = averages(laws)[1]
    h = WIDE(2.0 ** -(7 + math.ceil(math.log2(1.0 + _phase(laws, duration) / 8.0))))
    before, best = None, None
    for _ in range(tries):
        values = _differences(laws, averages, sequence, h)
        if values is not None and before is not None:
            size = np.max(np.abs(values))
            # Of order 8 the error of the longer steps is 4^8 times that of these.
            wrong = np.max(np.abs(values - before)) / (size if size > 0 else 1) / 4.0**4
            found = ReferenceGradient(values, float(max(wrong, 10 * EPS / h)))
            if best is None or found.error < best.error:
                best = found
            if wrong < 10 * EPS / h:
                break
        before, h = values, h / 4
    if best is None:
        raise IntegrationError("the events of the reference change with its quantities: it has no gradient")
    return best


def _phase(laws: Laws, duration: float | None) -> float:
    """Return the phase [rad] of oscillation and wave, which quantities shift; of an orbit it is one turn."""
    if duration is None:
        return 2.0 * math.pi
    own = np.sqrt(abs(laws.stiffness) / laws.mass)
    return float(max(own, laws.wavenumber * laws.tow_speed)) * duration


def _differences(laws: Laws, averages: _Averages, sequence: tuple[str, ...], h: Wide) -> Wide | None:
    """Return central differences over relative steps h to 4 h, or None where other events take place."""
    columns = []
    for name in QUANTITIES:
        column = np.zeros(len(AVERAGES), WIDE)
        for k, weight in enumerate(_WEIGHTS, start=1):
            (up, one), (down, other) = (
                averages(replace(laws, **{name: getattr(laws, name) * (1 + sign * k * h)})) for sign in (1, -1)
            )
            if not one == other == sequence:
                return None
            column = column + weight * (up - down)
        columns.append(column / h)
    return np.array(columns).T
