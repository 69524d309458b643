"""Equations (25)-(27) as the source prints them, errors included, so that the difference can be shown.

Three errors of the print change what is computed: the factor pi stands in F and again in A, B and C; C has
1/3 where the integral (24) gives 2/3; and the spring of (27), + k0 (L - V0 t), repels the share from the strut.
The left side of (27) keeps L'': the printed L' has the wrong unit. Nothing in the toolkit needs this file
but a scene whose formulation asks for it.
"""

import math
from dataclasses import dataclass, fields
from typing import Final, Literal, TypeAlias

from plough_opt.core.checks import check_domain, shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, cos, sin
from plough_opt.laws.forces import ResistanceCoefficients
from plough_opt.laws.law import SoilReaction
from plough_opt.soil.geometry import Cone
from plough_opt.soil.soil import Soil

_IN_WORDS = {
    "pi_twice": "the factor pi twice",
    "one_third": "1/3 for 2/3 in C",
    "repelling_spring": "a spring that repels",
}


@dataclass(frozen=True, kw_only=True)
class Printed:
    """Which errors of the print a scene keeps; by default all, as ``formulation="printed"`` does.

    ``Printed(pi_twice=False, one_third=False)`` keeps the repelling spring alone.

    Args:
        pi_twice: pi in F (25) and again in A, B and C (26): F0, Fd and the added mass are pi times too large.
        one_third: 1/3 in C (26) for 2/3: the added mass is half of what it should be.
        repelling_spring: + k0 (L - V0 t) in (27): the spring's force on the share is -k0 z at the deflection
            z = V0 t - L, and the share runs away from the strut like exp(omega t), omega = sqrt(k0/M).

    Raises:
        InputError: a switch that is neither True nor False.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(formulation=po.Printed(repelling_spring=False)).printed.pi_twice
        True
    """

    pi_twice: bool = True
    one_third: bool = True
    repelling_spring: bool = True

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool):
                raise InputError(f"{field.name} = {shown(value)} must be True or False")

    @property
    def errors(self) -> tuple[str, ...]:
        """The errors that are kept, in words; empty for the equations as derived."""
        return tuple(text for name, text in _IN_WORDS.items() if getattr(self, name))

    def reaction(self, derived: SoilReaction) -> SoilReaction:
        """Return what the print makes of the derived F0 [N], Fd [N s^2/m^2] and added mass [kg]."""
        if not (self.pi_twice or self.one_third):
            return derived
        twice = math.pi if self.pi_twice else 1.0
        return SoilReaction(
            static=twice * derived.static,
            drag=twice * derived.drag,
            added_mass=twice * (0.5 if self.one_third else 1.0) * derived.added_mass,
        )


Formulation: TypeAlias = Literal["derived", "printed"] | Printed
"""The equations as derived, as printed, or with some of the print's errors."""

FORMULATIONS: Final = {
    "derived": Printed(pi_twice=False, one_third=False, repelling_spring=False),
    "printed": Printed(),
}
"""The formulations that have a name, and the errors of the print that each keeps."""


def errors_of(formulation: Formulation) -> Printed:
    """Return which errors of the print a formulation keeps.

    Raises:
        InputError: an unknown formulation; the message suggests the nearest.
    """
    if isinstance(formulation, Printed):
        return formulation
    if not isinstance(formulation, str) or formulation not in FORMULATIONS:
        hint = nearest(formulation if isinstance(formulation, str) else shown(formulation), FORMULATIONS)
        raise InputError(f"formulation = {shown(formulation)} is neither a Printed(...) nor the name of one: {hint}")
    return FORMULATIONS[formulation]


def printed_coefficients(cone: Cone, soil: Soil) -> ResistanceCoefficients:
    """Return A [Pa], B [-] and C [-] of equation (26) to the letter: with pi, with 1/3, dividing by nu and by b1.

    The straight formulas lose digits for little internal friction and for soil that locks at once; the ones
    to compute with are `plough_opt.laws.forces.resistance_coefficients`.

    Raises:
        DomainError: no internal friction, for (26) divides by nu = 2 mu/(1 + mu).
    """
    check_domain("friction angle", soil.friction_angle, "rad", above=0.0, why="(26) as printed divides by nu")
    tau0 = 2.0 * soil.cohesion * cos(soil.friction_angle)
    mu = sin(soil.friction_angle)
    nu = 2.0 * mu / (1.0 + mu)
    b1 = soil.density_ratio
    a = 1.0 / (1.0 - b1)
    slope = cone.slope
    growth, decay = a ** (nu / 2.0), a ** (nu / 2.0 - 1.0)
    bracket = (nu - 2.0) / nu * (growth - 1.0) + b1 * (nu - 2.0) * growth - (decay - 1.0)
    return ResistanceCoefficients(
        A=soil.strength_factor
        * math.pi
        * slope**2
        * (soil.ambient_pressure + tau0 / (nu * (1.0 + mu)))
        * (growth - 1.0),
        B=math.pi * slope**4 / (b1 * (nu - 2.0)) * bracket,
        C=math.pi * slope**4 / (3.0 * b1 * nu) * (growth - 1.0),
    )


def printed_resistance(cone: Cone, soil: Soil, speed: Expression, acceleration: Expression) -> Expression:
    """Return F [N] of equation (25) to the letter, with the coefficients (26) to the letter.

    Args:
        cone: the share's equivalent cone.
        soil: the soil, with internal friction.
        speed: L' of the share [m/s], at least 0.
        acceleration: L'' [m/s^2].

    Raises:
        DomainError: no internal friction, a speed below 0 or a number that is not finite.
    """
    check_domain("speed", speed, "m/s", at_least=0.0, why="the plastic gas does not follow a share that retreats")
    check_domain("acceleration", acceleration, "m/s^2")
    c = printed_coefficients(cone, soil)
    motion = c.B * soil.density * speed**2 + soil.density * c.C * cone.height * acceleration
    return math.pi * (1.0 + soil.tool_friction / cone.slope) * (c.A + motion) * cone.height**2
