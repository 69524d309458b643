"""Soil properties, and named soils with the sources of their values."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np

from plough_opt.core import expressions as ex
from plough_opt.core.checks import (
    LARGEST,
    array_of,
    check_callable,
    check_kind,
    check_named,
    check_text,
    shown,
    whole_number,
)
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import COUNT, Expression
from plough_opt.core.plain_data import FUNCTION, Array
from plough_opt.core.quantities import EVERY, QUANTITIES, read_fields
from plough_opt.core.units import in_si

STANDARD_ATMOSPHERE = 101325.0
"""Ambient pressure [Pa] of the named soils and of the source."""

CONE_HALF_ANGLE = math.radians(15.0)
"""Half angle [rad] of a penetrometer's cone."""

Adjust: TypeAlias = Literal["strength factor", "cohesion", "density ratio"]
"""Property of a soil that a cone index can determine."""

# No source in docs/howto/soils.md has a larger value. At this density ratio the front is at 4.5 cone radii.
_MOST_COHESION = 100e3
_MOST_DENSITY_RATIO = 0.95

_PROPERTIES = tuple(quantity for quantity in QUANTITIES.values() if quantity.owner == "soil")


@dataclass(frozen=True)
class DensityProfile:
    """Density of the soil behind the compaction front as a function of the Lagrangian radius.

    Args:
        density: function rho(r, *parameters) [kg/m^3] of the radius r [m]. Write it with arithmetic and the functions
            of `plough_opt.core.expressions`, so that it accepts floats, arrays and CasADi expressions.
        parameters: further arguments of the function. Design variables must be passed here, where a design finds them.
        order: number of Gauss-Legendre nodes in every quadrature over the profile.

    Raises:
        InputError: the density is not a function, or the order is below 1.
    """

    density: Annotated[Callable[..., Expression], FUNCTION]
    parameters: tuple[Expression, ...] = ()
    order: int = field(default=16, metadata=COUNT)

    def __post_init__(self) -> None:
        check_callable("the density profile", self.density, "of the radius, in kg/m^3")
        whole_number("order", self.order, 1)

    def at(self, r: Expression) -> Expression:
        """Return the density [kg/m^3] at a Lagrangian radius [m]."""
        return self.density(r, *self.parameters)


@dataclass(frozen=True)
class Yielding:
    """Coefficients of the yield condition (10), p_r - p_theta = tau0 + mu (p_r + p_theta).

    Attributes:
        mu: sine of the friction angle [-].
        nu: 2 mu/(1 + mu) [-].
        tau0: 2 k cos(theta) [Pa].
    """

    mu: Expression
    nu: Expression
    tau0: Expression

    def strength(self, ambient_pressure: Expression) -> Expression:
        """Return nu p_a + tau0/(1 + mu) [Pa]."""
        return self.nu * ambient_pressure + self.tau0 / (1.0 + self.mu)

    def growth(self, density_ratio: Expression) -> Expression:
        """Return phi = (a^(nu/2) - 1)/nu with a = 1/(1 - b1) [-], the factor of the strength in the wall pressure."""
        log_a = -ex.log1p(-density_ratio)
        return log_a / 2.0 * ex.expm1_ratio(self.nu * log_a / 2.0)

    def density_ratio(self, growth: Expression) -> Expression:
        """Return b1 = 1 - (1 + nu phi)^(-2/nu), the inverse of `growth`; regular without internal friction."""
        return -ex.expm1(-2.0 * growth * ex.log1p_ratio(self.nu * growth))


@dataclass(frozen=True)
class Soil:
    """A dense soil ahead of the share.

    Args:
        density: density rho0 of the undisturbed soil [kg/m^3], above 0.
        density_ratio: ratio b1 = rho0/rho1 of undisturbed to locked density [-], between 0 and 1.
        cohesion: cohesion k [Pa], at least 0.
        friction_angle: angle theta of internal friction [rad], from 0 to below 90 degrees.
        tool_friction: friction coefficient mu0 of soil on metal [-], at least 0.
        ambient_pressure: pressure p_a ahead of the compaction front [Pa], at least 0. The source uses atmospheric
            pressure; for soil with open pores one may use the overburden, a few kPa, instead.
        youngs_modulus: Young's modulus E [Pa], above 0, or None if unknown. The plastic gas does not use it.
        poisson_ratio: Poisson's ratio, from 0 to below 0.5, or None if unknown. The plastic gas does not use it.
        name: name of the soil in reports.
        source: source of the values.
        density_profile: density behind the compaction front, in place of the constant one that follows from b1; see
            `with_density_profile`.
        strength_factor: ratio of measured to computed static resistance [-], above 0. It multiplies A of equation (26)
            and so F0 and everything that depends on it, but not the stresses, the inertia, the front or other models.
            `from_cone_index` computes it from a penetrometer reading.

    Properties may be floats, NumPy arrays or CasADi expressions.

    Raises:
        DomainError: a property lies outside its domain.
        InputError: the name is not a string of printable characters.

    Example:
        >>> import plough_opt as po
        >>> soil = po.Soil("1.35 g/cm^3", 0.8, "20 kPa", "28 deg", 0.5)
        >>> soil.cohesion
        20000.0
    """

    density: Expression
    density_ratio: Expression
    cohesion: Expression
    friction_angle: Expression
    tool_friction: Expression
    ambient_pressure: Expression = STANDARD_ATMOSPHERE
    youngs_modulus: Expression | None = None
    poisson_ratio: Expression | None = None
    name: str = "unnamed soil"
    source: str = "values given by the user"
    density_profile: DensityProfile | None = None
    strength_factor: Expression = 1.0

    def __post_init__(self) -> None:
        check_text("name", self.name)
        read_fields(self, **{quantity.key: quantity.name for quantity in _PROPERTIES})

    @property
    def yielding(self) -> Yielding:
        """The yield condition of the soil."""
        mu = ex.sin(self.friction_angle)
        return Yielding(mu, 2.0 * mu / (1.0 + mu), 2.0 * self.cohesion * ex.cos(self.friction_angle))

    def with_density_profile(
        self, density: Callable[..., Expression], *parameters: Expression, order: int = 16
    ) -> Soil:
        """Return the soil with a density that varies behind the compaction front, equations (9)-(22).

        The density ratio b1 is then not used. Results that depend on the profile are Gauss-Legendre quadratures of the
        given order. `plough_opt.soil.plastic.quadrature_error` estimates their error, and `plough_opt.refine` compares
        error and cost of several orders.

        Args:
            density: function rho(r, *parameters) [kg/m^3] of the Lagrangian radius r [m], above the undisturbed density
                up to the front; for instance ``lambda r, width: 1350.0 + 250.0 * exp(-(r / width) ** 2)`` with the
                ``exp`` of `plough_opt.core.expressions`, which accepts numbers and symbols.
            parameters: further arguments of the function, such as design variables.
            order: number of nodes, at least 1.

        Raises:
            InputError: the density is not a function, or the order is below 1.

        Example:
            >>> import plough_opt as po
            >>> from plough_opt.expressions import exp
            >>> profile = lambda r, width: 1350.0 + 350.0 * exp(-((r / width) ** 2))
            >>> soil = po.named_soil("serozem").with_density_profile(profile, 0.2)
            >>> round(float(po.plastic.front_radius(po.plastic.Cavity(0.04, 0.5, 0.0), soil)), 4)
            0.0919
        """
        return replace(self, density_profile=DensityProfile(density, parameters, order))

    @classmethod
    def from_cone_index(cls, cone_index: Expression, soil: Soil, adjust: Adjust = "strength factor") -> Soil:
        """Return the soil adjusted to a measured cone index.

        The equation s (1 + mu0/tan 15 deg) phi (nu p_a + tau0/(1 + mu)) = cone index is solved for one property in
        closed form; the others are unchanged. `plough_opt.cone_index` of the result equals the reading.

        Args:
            cone_index: pressure on the base of the 30 degree cone [Pa], above 0; a float, an array or an expression.
            soil: the soil to adjust.
            adjust: the property to set: ``"strength factor"``, which only scales the static resistance;
                ``"cohesion"``; or ``"density ratio"``, which moves the compaction front too.

        Raises:
            InputError: ``adjust`` is unknown, the soil has a density profile or zero strength to scale, or the reading
                is lower than even zero cohesion gives; the message says by how much.
            DomainError: the reading is not above 0.

        Example:
            >>> import plough_opt as po
            >>> soil = po.Soil.from_cone_index(1.5e6, soil=po.named_soil("serozem"))
            >>> round(float(soil.strength_factor), 4)
            5.7373
        """
        cone_index = EVERY["soil.cone_index"].read(cone_index, stacklevel=2)
        check_kind("soil", soil, Soil, "the Soil to adjust")
        if soil.density_profile is not None:
            raise InputError("a density profile cannot be adjusted: set strength_factor to reading/po.cone_index(soil)")
        check_named("adjust = {}", adjust, get_args(Adjust))
        key = adjust.replace(" ", "_")
        changed: dict[str, Any] = {key: _adjusted(cone_index, soil, adjust)}
        source = f"{soil.source}; {adjust} from a cone index"
        return replace(soil, **changed, name=f"{soil.name}, by cone index", source=source)

    @classmethod
    def from_compaction(
        cls, pressure: Sequence[float | str] | Array, compaction: Sequence[float] | Array, soil: Soil
    ) -> Soil:
        """Return the soil with the density ratio that a compression test shows at its ambient pressure.

        A soil that compacts by the part e of its volume under a pressure has b1 = 1 - e there. Between the pressures of
        the test, log e is linear in log p. As b1 falls with the pressure, the draft grows less than in proportion to
        it; with one b1 for all pressures it grows as nu p_a + tau0/(1 + mu).

        Args:
            pressure: mean pressures of a triaxial test, or axial ones of an oedometer, two or more that rise [Pa].
            compaction: parts of the initial volume that the soil has lost at these pressures, above 0 and below 1 and
                rising [-]; in a triaxial test the largest part before the soil dilates.
            soil: the other properties; its ambient pressure must lie in the range of the test. A symbolic ambient
                pressure gives a symbolic density ratio, which beyond that range follows the nearest two pressures.

        Raises:
            InputError: fewer than two pressures, numbers that do not rise or lie outside their domains, an ambient
                pressure outside the range, or a soil with a density profile.

        Example:
            >>> import plough_opt as po
            >>> soil = po.Soil("1.35 g/cm^3", 0.8, "20 kPa", "28 deg", 0.5, "50 kPa")
            >>> float(po.Soil.from_compaction([25e3, 100e3], [0.01, 0.04], soil).density_ratio)
            0.98
        """
        check_kind("soil", soil, Soil, "the Soil whose density ratio is to follow")
        if soil.density_profile is not None:
            raise InputError("a soil with a density profile has no density ratio: give its profile another density")
        p, e = compression_test(pressure, compaction)
        at = soil.ambient_pressure
        if not ex.is_symbolic(at) and not np.all((p[0] <= ex.as_number(at)) & (ex.as_number(at) <= p[-1])):
            test = f"the compression test, {p[0] / 1e3:g} to {p[-1] / 1e3:g} kPa"
            raise InputError(f"ambient pressure = {shown(at)} Pa is outside {test}: set the soil's ambient_pressure")
        x, y = np.log(p), np.log(e)
        slopes = np.diff(y) / np.diff(x)
        log_e = y[0] + slopes[0] * (ex.log(at) - x[0])
        for knot, change in zip(x[1:-1].tolist(), np.diff(slopes).tolist(), strict=True):
            log_e = log_e + change * ex.maximum(ex.log(at) - knot, 0.0)
        source = f"{soil.source}; density ratio from a compression test"
        return replace(soil, density_ratio=1.0 - ex.exp(log_e), name=f"{soil.name}, by compaction", source=source)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about unusual properties of a numeric soil.

        Example:
            >>> import plough_opt as po
            >>> measured = po.Soil.from_cone_index("1.5 MPa", po.named_soil("serozem"))
            >>> [warning.rpartition(" by ")[2] for warning in measured.warnings()]
            ['5.737']
        """
        warned, given = [], (self.cohesion, self.density_ratio, self.strength_factor)
        cohesion, ratio, factor = (np.max(ex.as_number(value)) for value in given)
        if cohesion > _MOST_COHESION:
            most = f"{_MOST_COHESION / 1e3:g} kPa at most"
            warned.append(f"a cohesion of {cohesion / 1e3:.4g} kPa is more than soils have ({most})")
        if ratio > _MOST_DENSITY_RATIO and self.density_profile is None:
            warned.append(
                f"a density ratio of {ratio:.6g} is closer to 1 than in real soils ({_MOST_DENSITY_RATIO:g} at most):"
                f" the radius of the compaction front is {(1.0 - ratio) ** -0.5:.3g} times that of the share"
            )
        if np.any(ex.as_number(self.strength_factor) != 1.0):
            warned.append(f"the measured strength factor multiplies the law's static resistance by {factor:.4g}")
        return tuple(warned)


def _adjusted(reading: Expression, soil: Soil, adjust: Adjust) -> Expression:
    """Return the value of the adjusted property for a cone index [Pa]."""
    yielding = soil.yielding
    friction = 1.0 + soil.tool_friction / math.tan(CONE_HALF_ANGLE)
    phi = yielding.growth(soil.density_ratio)
    if adjust == "cohesion":
        level = soil.strength_factor * friction * phi
        without = yielding.nu * soil.ambient_pressure
        if not (ex.is_symbolic(reading) or ex.is_symbolic(level * without)):
            short = float(np.max(ex.as_number(level * without) - ex.as_number(reading)))
            if short > 0.0:
                above = f"a cone index {short / 1e3:.4g} kPa above the reading, so it cannot be matched by cohesion"
                raise InputError(f"friction and ambient pressure alone give {above}: adjust the strength factor")
        return (reading / level - without) * (1.0 + yielding.mu) / (2.0 * ex.cos(soil.friction_angle))
    strength = yielding.strength(soil.ambient_pressure)
    if not ex.is_symbolic(strength) and np.any(ex.as_number(strength) == 0.0):
        raise InputError("soil without cohesion, and without friction or pressure, has zero strength: adjust cohesion")
    if adjust == "strength factor":
        return reading / (friction * phi * strength)
    return yielding.density_ratio(reading / (soil.strength_factor * friction * strength))


_CHOICE = "engineering choice inside published brackets, not measured on one soil"
_FRICTION = "tool friction: soil on steel 0.13-0.85 by moisture (Manuwa 2012, Mod. Appl. Sci. 6(4):117)"


# Name, density [kg/m^3], density ratio, cohesion [kPa], friction angle [deg], tool friction, Young's modulus [MPa],
# Poisson's ratio, and published brackets.
_TABLE = (
    ("loose sandy loam", 1300, 0.722, 5, 30, 0.40, 3, 0.30,
     "density: light loam after subsoiling 1300 kg/m^3 (zzs.ujs.edu.cn, abstract 948)"),
    ("firm sandy loam", 1500, 0.815, 15, 32, 0.45, 8, 0.30,
     "locked density: Proctor maximum 1840 kg/m^3 of a savanna sandy loam (Hossne Garcia et al. 2012)"),
    ("serozem", 1350, 0.794, 20, 28, 0.50, 10, 0.33,
     "density: Syrdarya grey-meadow soils 1280-1370 kg/m^3 (tjabs 3738); modulus: compacted loess"
     " 18-34 MPa at small strain (Adv. Civ. Eng. 2021, 9574548)"),
    ("hardpan", 1600, 0.914, 35, 32, 0.50, 20, 0.35,
     "density: critical for roots in clay loam 1450-1550 kg/m^3 (Harris 1990; Morris and Lowery 1988);"
     " strength: Kenyan sandy clay loam 22-39 kPa (Mwonga et al. 2019, doi 10.4236/ojop.2019.83008)"),
    ("heavy clay", 1300, 0.812, 45, 15, 0.40, 8, 0.40,
     "density: growth-restricting above 1470 kg/m^3 in clay; cohesion of a clay at 1550 kg/m^3 30 kPa"
     " (Horn and Fleige 2003)"),
)  # fmt: skip
_NAMED = {
    name: Soil(
        density, ratio, 1e3 * cohesion, math.radians(angle), tool_friction, STANDARD_ATMOSPHERE, 1e6 * modulus, poisson,
        name, f"{_CHOICE}; {brackets}; {_FRICTION}",
    )
    for name, density, ratio, cohesion, angle, tool_friction, modulus, poisson, brackets in _TABLE
}  # fmt: skip


def soil_names() -> tuple[str, ...]:
    """Return the valid names for `named_soil`.

    Example:
        >>> import plough_opt as po
        >>> "serozem" in po.soil_names()
        True
    """
    return tuple(_NAMED)


def named_soil(name: str) -> Soil:
    """Return one of the named soils: loose sandy loam, firm sandy loam, serozem, hardpan, heavy clay.

    Their values are engineering choices inside published brackets, as ``source`` says; they were not measured on a
    single soil. The ambient pressure is the standard atmosphere.

    Raises:
        InputError: the name is unknown; the message suggests the nearest.

    Example:
        >>> import plough_opt as po
        >>> po.named_soil("serozem").cohesion
        20000.0
    """
    check_named("no soil is named {}", name, _NAMED)
    return _NAMED[name]


def compression_test(pressure: object, compaction: object) -> tuple[Array, Array]:
    """Return pressures [Pa] and lost parts of the volume as arrays; raise InputError as `Soil.from_compaction` does."""
    if isinstance(pressure, Sequence) and not isinstance(pressure, str):
        pressure = [in_si("pressure", one, "Pa") for one in pressure]
    p = array_of(pressure, "pressure must be a list of pressures, not {}")
    e = array_of(compaction, "the compaction must be a list of numbers, not {}")
    if p.ndim != 1 or p.shape != e.shape or len(p) < 2:
        raise InputError(f"give as many pressures as compactions, two or more of each, not {p.size} and {e.size}")
    for name, values, most in (("pressure", p, LARGEST), ("compaction", e, 1.0)):
        if not (values[0] > 0.0 and values[-1] < most and np.all(np.diff(values) > 0.0)):
            raise InputError(f"{name} = {shown(values.tolist())} must rise from above 0 to below {most:g}")
    return p, e


def check_soil(soil: object) -> None:
    """Raise InputError if the soil has the wrong type, such as its name."""
    check_kind("the soil", soil, Soil, "a Soil, for instance named_soil('serozem')")
