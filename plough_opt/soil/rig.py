"""The rig on which a force was recorded."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.quantities import settle

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    """The mount on which a force was recorded, whose own response is divided out of the record.

    Args:
        mass: moving mass [kg].
        stiffness: of its spring [N/m].
        damping: of its damper [N s/m], at least 0.
        tow_speed: speed at which it was pulled [m/s].

    Raises:
        DomainError: a number outside its domain.

    Example:
        >>> import plough_opt as po
        >>> po.Rig(mass=40.0, stiffness=2e5, damping=400.0, tow_speed=1.5).tow_speed
        1.5
    """

    mass: float
    stiffness: float
    damping: float
    tow_speed: float

    def __post_init__(self) -> None:
        settle(
            self, damping="effects.damping", **{name: f"scene.{name}" for name in ("mass", "stiffness", "tow_speed")}
        )

    def response(self, wave_number: Vector) -> NDArray[np.complex128]:
        """Return mount force over soil resistance [-] at wave numbers [rad/m]: (k + i w c)/(k - m w^2 + i w c)."""
        turn = wave_number * self.tow_speed
        damped = 1j * turn * self.damping
        ratio: NDArray[np.complex128] = (self.stiffness + damped) / (self.stiffness - self.mass * turn**2 + damped)
        return ratio

    @property
    def resonance(self) -> float:
        """Wave number [rad/m] at which it resonates."""
        return math.sqrt(self.stiffness / self.mass) / self.tow_speed
