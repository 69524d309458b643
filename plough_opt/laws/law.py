"""The interface of resistance laws, on which scenes rely, and equations (25)-(27) as the source prints them."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, Protocol, TypeAlias, runtime_checkable

from plough_opt.core.checks import check_named, check_switch
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT, Cone, Wedge
from plough_opt.soil.soil import Soil


def too_blunt(half_angle: float) -> str:
    """Return the end of a warning about a half angle [rad] for which the hypothesis of plane sections does not hold."""
    limit = f"{math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg"
    return f"{math.degrees(half_angle):.1f} deg: above {limit} the hypothesis of plane sections does not hold"


@dataclass(frozen=True)
class SoilReaction:
    """Coefficients of the resistance F = static + drag L'^2 + added_mass L''.

    Attributes:
        static: F0 [N].
        drag: Fd [N s^2/m^2].
        added_mass: m_a [kg].

    Example:
        >>> import plough_opt as po
        >>> po.SoilReaction(static=2e3).drag
        0.0
    """

    static: Expression
    drag: Expression = 0.0
    added_mass: Expression = 0.0

    def at(self, speed: Expression, acceleration: Expression = 0.0) -> Expression:
        """Return the resistance [N] at a speed [m/s] and an acceleration [m/s^2].

        Example:
            >>> import plough_opt as po
            >>> po.SoilReaction(static=2e3, drag=50.0, added_mass=4.0).at(speed=2.0, acceleration=1.0)
            2204.0
        """
        return self.static + self.drag * speed**2 + self.added_mass * acceleration


@dataclass(frozen=True)
class ShareInSoil:
    """Share, soil and speed from which a law computes a resistance.

    Attributes:
        share: the share, a `Wedge` or a `Cone`.
        cone: the cone of equal height and surface.
        soil: the soil; its ambient pressure is 0 if the scene ignores it.
        speed: speed V0 of the strut [m/s].

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> po.ShareInSoil(cone, cone, soil, 2.0).speed
        2.0
    """

    share: Wedge | Cone
    cone: Cone
    soil: Soil
    speed: Expression


STEADY: Final = dict.fromkeys(
    ("motion", "strength_wave", "random_strength", "tow_ramp", "speed_term", "rate_term", "own"),
    "gives the force of steady sliding only",
)
"""Entries of `ResistanceLaw.lacking` for a law that is not a polynomial in the speed."""


@runtime_checkable
class ResistanceLaw(Protocol):
    """A law of the soil's resistance to a share: a frozen dataclass that inherits from this class.

    Its fields hold what it needs besides share, soil and speed: numbers, expressions or strings. A law must define only
    ``label`` and ``reaction``; the other attributes describe what else it provides. A law with a name in
    `plough_opt.laws.LAWS` can be used in problem files too.

    Its domain is what ``reaction`` declares by `plough_opt.core.checks.check_domain`: a name, an expression, its limits
    and the reason. For numbers outside, ``reaction`` then raises DomainError, as do simulations, batches, sweeps and
    components; a design keeps the limits, and names them if they decide the optimum. A design skips designs for which
    ``reaction`` raises another InputError or DomainError, or gives NaN.

    Attributes:
        label: name in messages and tables.
        source: source of its equations.
        standing: clause that says which parts are not verified, or where it does not hold.
        lacking: things that it does not provide -> clause that follows "which". They are effects that a scene then
            refuses ("motion", "strength_wave", "random_strength", "tow_ramp", "speed_term", "rate_term", "own",
            "entry"), results that are then missing ("added_mass", "loosened_radius", "cone_index"),
            "ambient_pressure" (has no effect), and "uncertain" (soil).
        scalar: whether it can be part of a graph of scalar operations (SX); False if it contains loops or matrices.
        slender: whether it relies on the hypothesis of plane sections.

    Example:
        >>> from dataclasses import dataclass
        >>> import plough_opt as po
        >>> @dataclass(frozen=True)
        ... class PerDepth(po.ResistanceLaw):
        ...     per_metre: float
        ...     label = "a constant force per depth"
        ...     def reaction(self, at):
        ...         return po.SoilReaction(static=self.per_metre * at.share.height)
        >>> share = po.Wedge(angle=po.deg(30), chisel_angle=po.deg(15), height=0.25)
        >>> scene = po.Scene(po.named_soil("serozem"), share, 5e4, 20.0, 2.0, medium=PerDepth(40e3))
        >>> round(po.simulate(scene, duration=1.0).mean_draft)
        10000
    """

    label: ClassVar[str]
    source: ClassVar[str] = ""
    standing: ClassVar[str] = ""
    lacking: ClassVar[Mapping[str, str]] = {
        "added_mass": "does not include soil that moves with the share",
        "loosened_radius": "does not give the radius to which soil is loosened",
        "cone_index": "does not apply to a penetrometer",
        "entry": "does not describe how the resistance grows while the share enters",
        "ambient_pressure": "does not depend on it",
    }
    scalar: ClassVar[bool] = True
    slender: ClassVar[bool] = False

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N], Fd [N s^2/m^2] and the added mass [kg]; a law that lacks "motion" returns F0 at the tow speed.

        Args:
            at: share, soil and speed: numbers or CasADi scalars, and arrays where the law's functions take them.

        Raises:
            DomainError: a number lies outside the law's domain.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.PlasticGas().reaction(at).static))
            2402
        """

    def loosened_radius(self, at: ShareInSoil) -> Expression:  # noqa: ARG002 - overriding methods use the argument
        """Return the radius to which the soil is loosened at the share's base [m].

        Args:
            at: share, soil and speed.

        Raises:
            InputError: the law does not give it.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> try:
            ...     po.laws.AsabeD497().loosened_radius(at)
            ... except po.InputError as error:
            ...     print(str(error).partition(",")[0])
            loosened_radius has no meaning in ASABE D497
        """
        raise InputError(self.refusal("loosened_radius"))

    def warnings(self, at: ShareInSoil) -> tuple[str, ...]:
        """Return sentences on the law's limitations for readers of numeric results.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> len(po.laws.AsabeD497().warnings(at))
            2
        """
        found = [f"{self.label}: {self.standing}"] if self.standing else []
        if self.lacks("added_mass") and not self.lacks("motion"):
            found.append(f"{self.label} {self.lacking['added_mass']}: the share moves with its own mass alone")
        half_angle = float(as_number(at.cone.half_angle))
        if self.slender and half_angle > PLANE_SECTIONS_LIMIT:
            found.append(f"the equivalent cone's half angle is {too_blunt(half_angle)}")
        return tuple(found)

    def without_value(self, what: str) -> str:
        """Return a clause that says what the law does not give for some share, soil and speed, and where it holds.

        Example:
            >>> import plough_opt as po
            >>> po.laws.AsabeD497().without_value("draft").partition(" (")[0]
            'ASABE D497 gives no draft for this share, soil and speed'
        """
        return f"{self.label} gives no {what} for this share, soil and speed" + (
            f" ({self.standing})" * bool(self.standing)
        )

    def lacks(self, what: str) -> bool:
        """Return whether the law lacks something; see ``lacking``.

        Example:
            >>> import plough_opt as po
            >>> po.laws.AsabeD497().lacks("loosened_radius"), po.laws.PlasticGas().lacks("loosened_radius")
            (True, False)
        """
        return what in self.lacking

    def refusal(self, what: str, name: str = "") -> str:
        """Return the message that refuses something that the law lacks.

        Args:
            what: key of ``lacking``.
            name: name of a result that depends on it; default: the key itself.

        Example:
            >>> import plough_opt as po
            >>> po.laws.AsabeD497().refusal("loosened_radius").partition(",")[0]
            'loosened_radius has no meaning in ASABE D497'
        """
        remedy = "use effects = Effects(motion=False), or" if what == "motion" else "leave it out, or use"
        name = f"'{name}'" if name else what
        return f"{name} has no meaning in {self.label}, which {self.lacking[what]}: {remedy} medium = 'plastic'"


def without_pressure(at: ShareInSoil) -> ShareInSoil:
    """Return the same share in soil without ambient pressure."""
    return dataclasses.replace(at, soil=dataclasses.replace(at.soil, ambient_pressure=0.0))


# Attribute of `Printed` -> the error in words.
_IN_WORDS = {
    "pi_twice": "the factor pi twice",
    "one_third": "1/3 for 2/3 in C",
    "repelling_spring": "a spring that repels",
}


@dataclass(frozen=True, kw_only=True)
class Printed:
    """Selection of the printed errors that a scene keeps; by default all, as with ``formulation="printed"``.

    The left side of (27) is L'' here, because the printed L' has the wrong unit.

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
