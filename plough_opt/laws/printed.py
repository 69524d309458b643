"""Equations (25)-(27) as the source prints them, errors included, to show the difference.

Three printed errors change the results: the factor pi occurs in F and again in A, B and C; C has 1/3 where the integral
(24) gives 2/3; and the spring of (27), + k0 (L - V0 t), pushes the share away from the strut. The left side of (27) is
L'' here, because the printed L' has the wrong unit. Only scenes with such a formulation use this file.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from plough_opt.core.checks import check_named, check_switch
from plough_opt.laws.law import SoilReaction

# Attribute of `Printed` -> the error in words.
_IN_WORDS = {
    "pi_twice": "the factor pi twice",
    "one_third": "1/3 for 2/3 in C",
    "repelling_spring": "a spring that repels",
}


@dataclass(frozen=True, kw_only=True)
class Printed:
    """Selection of the printed errors that a scene keeps; by default all, as with ``formulation="printed"``.

    ``Printed(pi_twice=False, one_third=False)`` keeps only the repelling spring.

    Args:
        pi_twice: pi in F (25) and again in A, B and C (26); F0, Fd and the added mass are pi times too large.
        one_third: 1/3 in C (26) in place of 2/3; the added mass is half its true value.
        repelling_spring: the term + k0 (L - V0 t) in (27); the spring's force on the share is -k0 z at the deflection
            z = V0 t - L, and the share moves away from the strut like exp(omega t), omega = sqrt(k0/M).

    Raises:
        InputError: an argument is not a bool.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(formulation=po.Printed(repelling_spring=False)).printed.pi_twice
        True
    """

    pi_twice: bool = True
    one_third: bool = True
    repelling_spring: bool = True

    def __post_init__(self) -> None:
        for name in _IN_WORDS:
            check_switch(name, getattr(self, name))

    @property
    def errors(self) -> tuple[str, ...]:
        """Descriptions of the selected errors; empty for the equations as derived."""
        return tuple(text for name, text in _IN_WORDS.items() if getattr(self, name))

    def reaction(self, derived: SoilReaction) -> SoilReaction:
        """Return F0 [N], Fd [N s^2/m^2] and added mass [kg] with the selected errors, given the derived values.

        Example:
            >>> import plough_opt as po
            >>> derived = po.SoilReaction(static=2e3, drag=50.0, added_mass=4.0)
            >>> round(po.Printed(pi_twice=True).reaction(derived).static / derived.static, 6)
            3.141593
        """
        if not (self.pi_twice or self.one_third):
            return derived
        twice = math.pi if self.pi_twice else 1.0
        return SoilReaction(
            static=twice * derived.static,
            drag=twice * derived.drag,
            added_mass=twice * (0.5 if self.one_third else 1.0) * derived.added_mass,
        )


Formulation: TypeAlias = Literal["derived", "printed"] | Printed
"""The equations as derived, as printed, or with some of the printed errors."""

FORMULATIONS: Final = {
    "derived": Printed(pi_twice=False, one_third=False, repelling_spring=False),
    "printed": Printed(),
}
"""Name of a formulation -> the printed errors that it keeps."""


def errors_of(formulation: Formulation) -> Printed:
    """Return the printed errors that a formulation keeps.

    Raises:
        InputError: the formulation is unknown; the message suggests the nearest.
    """
    if isinstance(formulation, Printed):
        return formulation
    check_named("formulation = {} is neither a Printed(...) nor the name of one", formulation, FORMULATIONS)
    return FORMULATIONS[formulation]
