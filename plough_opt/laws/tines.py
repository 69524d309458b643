"""Draft of tines by formulas of the field: ASABE D497, McKyes and Ali, the universal equation, Swick and Perumpral."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Final, NamedTuple

import casadi as ca
import numpy as np

from plough_opt.core.checks import LEAST, check_domain, check_named
from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import Column, Expression, arctan, arctan2, cos, is_casadi, minimum, sin, sqrt, tan
from plough_opt.core.units import in_si
from plough_opt.laws.law import STEADY, ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.soil.geometry import Wedge
from plough_opt.soil.soil import check_soil

GRAVITY: Final = 9.80665
"""Standard acceleration of gravity [m/s^2]."""

LARGEST_SPEED: Final = 5.0
"""Largest speed [m/s] for which a term with the squared speed is accepted."""

# Points of the grid on which the first minimum of a force is searched.
_GRID = 64
# Forces are compared at this fraction of the largest angle, because they may be infinite at the end.
_INSIDE = 1.0 - 1e-9


class Tine(NamedTuple):
    """A flat tine that cuts soil up to its surface, in SI units."""

    width: Expression
    depth: Expression
    rake_angle: Expression
    surcharge: Expression
    adhesion: Expression


@dataclass(frozen=True)
class TineLaw(ResistanceLaw):
    """A law for a tine that stands for the share; dimensions that are not given are estimated from the share.

    Args:
        depth: working depth d of the tine's lower edge below the surface [m], above 0; as the others a number, an
            array, a CasADi scalar, or text such as "8 cm"; default: the share's height.
        width: width w of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: angle alpha of its face to the horizontal, measured ahead [rad], above 0 and at most 90 degrees;
            default: the share's chisel angle.
        surcharge: pressure q on the soil's surface [Pa], at least 0.
        adhesion: adhesion c_a of soil on the face [Pa], at least 0.
    """

    depth: Expression | None = field(default=None, metadata={"unit": "m"})
    width: Expression | None = field(default=None, metadata={"unit": "m"})
    rake_angle: Expression | None = field(default=None, metadata={"unit": "rad"})
    surcharge: Expression = field(default=0.0, metadata={"unit": "Pa"})
    adhesion: Expression = field(default=0.0, metadata={"unit": "Pa"})
    scalar = False

    def tine(self, at: ShareInSoil) -> Tine:
        """Return the tine.

        Raises:
            DomainError: a number lies outside its domain, or the share is a cone and there is no rake angle.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> po.laws.McKyesAli(width="8 cm", depth=0.35).tine(at).width
            0.08
        """
        rake = self.rake_angle
        if rake is None:
            if not isinstance(at.share, Wedge):
                raise DomainError("a share given as a cone does not have a rake angle: give rake_angle")
            rake = at.share.chisel_angle
        width = 2.0 * at.cone.height * at.cone.slope if self.width is None else self.width
        depth = at.share.height if self.depth is None else self.depth
        most: dict[str, Any] = {"above": 0.0, "at_least": LEAST, "at_most": math.pi / 2}
        return Tine(
            width=_checked("tool width", width, "m", above=0.0),
            depth=_checked("working depth", depth, "m", above=0.0),
            rake_angle=_checked("rake angle", rake, "rad", **most),
            surcharge=_checked("surcharge", self.surcharge, "Pa", at_least=0.0),
            adhesion=_checked("adhesion", self.adhesion, "Pa", at_least=0.0),
        )


def _checked(what: str, value: Expression, unit: str, **domain: Any) -> Expression:
    checked: Expression = check_domain(what, in_si(what, value, unit), unit, **domain)
    return checked


@dataclass(frozen=True)
class WedgeAngles:
    """The angles of a wedge [rad] that do not depend on its rupture plane.

    Attributes:
        rake: alpha.
        tool_friction: delta = atan(mu0).
        friction: internal friction phi of the soil.
    """

    rake: Expression
    tool_friction: Expression
    friction: Expression

    @property
    def total(self) -> Expression:
        """Their sum omega."""
        return self.rake + self.tool_friction + self.friction


@dataclass(frozen=True)
class WedgeFactors:
    """Dimensionless factors of the force on a tine per width: gamma d^2 Ng + (c Nc + q Nq + c_a Nca + rho v^2 Na) d."""

    weight: Expression
    cohesion: Expression
    surcharge: Expression
    adhesion: Expression
    inertia: Expression


def wedge_angles(tine: Tine, at: ShareInSoil) -> WedgeAngles:
    """Return the angles of the wedge.

    Raises:
        InputError: the soil has the wrong type.
        DomainError: the soil has no friction, the angles sum to 180 degrees or more, or the speed is outside 0 to
            5 m/s.
    """
    check_soil(at.soil)
    why = "in soil without friction the weight does not determine a wedge"
    check_domain("friction angle", at.soil.friction_angle, "rad", above=0.0, why=why)
    why = "above 3 to 5 m/s draft grows more slowly than the square of the speed"
    check_domain("speed", at.speed, "m/s", at_least=0.0, at_most=LARGEST_SPEED, why=why)
    angles = WedgeAngles(tine.rake_angle, arctan(at.soil.tool_friction), at.soil.friction_angle)
    what, why = "rake angle, tool friction and internal friction together", "the wedge would not move up the face"
    check_domain(what, angles.total, "rad", below=math.pi, why=why)
    return angles


def wedge_factors(angles: WedgeAngles, beta: Expression) -> WedgeFactors:
    """Return McKyes' N-factors of a plane wedge whose rupture plane rises at beta [rad].

    Source: E. McKyes, Soil Cutting and Tillage, 1985, as given by A. Wilkinson and A. DeGennaro, J. Terramechanics 44
    (2007) 133-152. They hold for beta above 0 and below 180 degrees minus omega.
    """
    alpha, phi = angles.rake, angles.friction
    share = 1.0 / sin(angles.total + beta)
    weight = (1.0 / tan(alpha) + cos(beta) / sin(beta)) * sin(beta + phi) * share / 2.0
    return WedgeFactors(
        weight=weight,
        cohesion=cos(phi) / sin(beta) * share,
        surcharge=2.0 * weight,
        adhesion=-cos(alpha + beta + phi) / sin(alpha) * share,
        inertia=sin(alpha) * cos(phi) / sin(alpha + beta) * share,
    )


def plane_rupture_angle(angles: WedgeAngles) -> Expression:
    """Return the beta [rad] that minimises the factor of the weight of a plane wedge, Coulomb's passive wedge.

    With u = sin(omega + beta)/sin(beta) the factor is a + b u + c/u. It is least at
    u^2 = sin(delta + phi) sin(alpha + delta) / (sin(alpha) sin(phi)), and cot(beta) = (u - cos omega)/sin omega.
    """
    alpha, delta, phi = angles.rake, angles.tool_friction, angles.friction
    u = sqrt(sin(delta + phi) * sin(alpha + delta) / (sin(alpha) * sin(phi)))
    return arctan2(sin(angles.total), u - cos(angles.total))


def horizontal(force: Expression, tine: Tine, angles: WedgeAngles) -> Expression:
    """Return the draft [N] of a force at the angle delta to the face's normal, plus the adhesion along the face."""
    along = tine.adhesion * tine.width * tine.depth / tan(tine.rake_angle)
    return force * sin(angles.rake + angles.tool_friction) + along


def least_angle(force: Callable[..., Column], angles: WedgeAngles, *parameters: Expression) -> Expression:
    """Return the rupture angle [rad] that minimises ``force(angles, beta, *parameters)``.

    It lies between 0 and the smaller of 90 degrees and 180 degrees minus omega.

    Args:
        force: function written with `plough_opt.core.expressions`, smooth and finite inside that interval.
        angles: angles of the wedge.
        parameters: floats, arrays of one shape, or CasADi scalars.

    Raises:
        DomainError: a numeric force is least at the end of the interval.
    """
    search = _search(force, len(parameters))
    upper = minimum(math.pi / 2, math.pi - angles.total)
    arguments = (upper, angles.rake, angles.tool_friction, angles.friction, *parameters)
    found: Column
    if any(map(is_casadi, arguments)):
        found = search(*arguments)
    else:
        rows = np.broadcast_arrays(*(np.asarray(argument, dtype=float) for argument in arguments))
        each = search.map(rows[0].size)(*(row.reshape(1, -1) for row in rows)) if rows[0].size else ()
        beta = np.asarray(each).reshape(rows[0].shape)
        found = beta if beta.ndim else float(beta)
    quotient = force(angles, found, *parameters) / force(angles, upper * _INSIDE, *parameters)
    check_domain(
        "least force of a wedge over that at the end of the possible angles",
        # Beyond its domain the search may end nowhere.
        quotient if is_casadi(quotient) else np.where(np.isnan(quotient), 1.0, quotient),
        below=1.0,
        why="its derivation does not hold there: use a steeper rake angle or a wider tool",
    )
    angle: Expression = found
    return angle


@lru_cache(maxsize=8)
def _search(force: Callable[..., Column], count: int) -> ca.Function:
    """Return a Function (upper, angles, parameters) -> angle: a grid search, bisection of the slope, Newton steps."""
    beta, upper = ca.SX.sym("beta"), ca.SX.sym("upper")
    p = [ca.SX.sym(f"p{k}") for k in range(3 + count)]
    value = force(WedgeAngles(*p[:3]), beta, *p[3:])
    slope = ca.jacobian(value, beta)
    f = ca.Function("force", [beta, *p], [value])
    g = ca.Function("slope", [beta, *p], [slope, ca.jacobian(slope, beta)])
    step = upper / (_GRID + 1)
    # Find the first minimum from the flattest plane on, because a force may fall again towards the end of the interval,
    # where it is meaningless.
    best, least, falls = step, ca.SX(math.inf), ca.SX(1.0)
    for k in range(1, _GRID + 1):
        here = f(k * step, *p)
        falls = ca.logic_and(falls, here < least)
        best, least = ca.if_else(falls, k * step, best), here
    low, high = best - step, best + step
    for _ in range(40):  # from two grid steps to rounding
        middle = (low + high) / 2.0
        before = g(middle, *p)[0] < 0.0
        low, high = ca.if_else(before, middle, low), ca.if_else(before, high, middle)
    found = (low + high) / 2.0
    for _ in range(3):  # Newton's steps make the derivatives exact: each doubles the order that is correct
        first, second = g(found, *p)
        found = found - first / second
    # Without a minimum inside the angle is undefined; NaN makes a solver shorten its step.
    outside = ca.logic_or(falls, ca.logic_or(found <= 0.0, found >= upper * _INSIDE))
    return ca.Function("least_angle", [upper, *p], [ca.if_else(outside, math.nan, found)])


POINTS: Final = {"narrow": (226.0, 0.0, 1.8), "winged": (294.0, 0.0, 2.4)}
"""Point -> A, B, C of D497's subsoiler rows, for N, km/h and cm; a winged point is 30 cm wide. Not verified."""

TEXTURES: Final = {"fine": 1.0, "medium": 0.70, "coarse": 0.45}
"""Soil texture (clay, loam, sand) -> factor F. Not verified."""

_KM_PER_H, _CM = 3.6, 100.0
CRITICAL_RATIO: Final = 6.0
"""Depth over width beyond which soil fails sideways at depth; reported as 5 to 6, not verified."""
# The inertia is that of soil in the tine's width plus this fraction of the depth.
_REACH = 0.6


@dataclass(frozen=True)
class AsabeD497(ResistanceLaw):
    """Draft F (A + B S + C S^2) N T of a subsoiler for S in km/h and T in cm: ASABE D497.7.

    It depends on depth and texture, but not on soil properties or the share's angles. The form and its units agree with
    a published worked example for a chisel plough; the coefficients of the subsoiler's rows are not verified against
    the standard's text, which is said to allow +-50 %. It moves with the share's own mass alone, and has no ambient
    pressure, added mass, loosened radius or cone index.

    Args:
        texture: ``"fine"`` (clay), ``"medium"`` (loam) or ``"coarse"`` (sand).
        point: ``"narrow"`` or ``"winged"``.
        shanks: number of shanks [-], above 0: a number, an array or a CasADi scalar.
        depth: tillage depth [m], above 0, likewise; default: the share's height.

    Raises:
        InputError: an unknown texture or point; raised by `reaction`, as the next.
        DomainError: a depth, a number of shanks or a speed outside its domain.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", medium=po.laws.AsabeD497())
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        5.59
    """

    texture: str = "medium"
    point: str = "narrow"
    shanks: Expression = field(default=1.0, metadata={"unit": ""})
    depth: Expression | None = field(default=None, metadata={"unit": "m"})

    label = "ASABE D497"
    source = "ASABE D497.7, Agricultural machinery management data"
    standing = "coefficients not verified against the standard's text, which is said to allow +-50 %"

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2]; the subsoiler's rows do not have a term linear in the speed.

        Raises:
            InputError: the texture or the point is unknown.
            DomainError: depth, speed or number of shanks lies outside its domain.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "30 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.AsabeD497().reaction(at).at(2.0)))
            6706
        """
        check_named("no soil texture of D497 is named {}", self.texture, TEXTURES)
        check_named("no subsoiler point of D497 is named {}", self.point, POINTS)
        depth = _checked("working depth", at.share.height if self.depth is None else self.depth, "m", above=0.0)
        check_domain("speed", at.speed, "m/s", at_least=0.0)
        shanks = check_domain("number of shanks", self.shanks, above=0.0)
        factor, (first, _, squared) = TEXTURES[self.texture], POINTS[self.point]
        drag = factor * squared * _KM_PER_H**2 * shanks * (_CM * depth)
        return SoilReaction(draft_of_row((first, 0.0, 0.0), factor, depth, 0.0, shanks), drag)


def draft_of_row(
    row: tuple[float, float, float], texture: float, depth: Expression, speed: Expression, size: Expression
) -> Expression:
    """Return the draft [N] for any row of D497.

    Args:
        row: A, B and C.
        texture: factor F.
        depth: tillage depth [m].
        speed: [m/s].
        size: width or number of tools, as the row requires.
    """
    a, b, c = row
    s = _KM_PER_H * speed
    return texture * (a + b * s + c * s**2) * size * (_CM * depth)


@dataclass(frozen=True)
class McKyesAli(TineLaw):
    """A narrow tine that shears off a wedge with a crescent at each side: F0 and Fd.

    H = {gamma d^2 Ng (1 + 2s/3w) + (c Nc + q Nq)(1 + s/w) d + (c_a Nca + rho v^2 Na) d} w sin(alpha + delta), plus the
    adhesion along the face, with s = d sqrt(cot beta (cot beta + 2 cot alpha)); beta minimises the factor of the
    weight. The crescents do not affect the term with the squared speed. Source: McKyes and Ali, J. Terramechanics 14
    (1977) 43-51; the crescents' factors are not verified against the paper. It holds from 0 to 5 m/s for a rake angle
    below a right angle, and ignores ambient pressure, added mass and loosened radius.

    Args:
        depth: working depth [m], above 0; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.

    Raises:
        DomainError: by `reaction`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", medium=po.laws.McKyesAli(depth=0.35))
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        9.26
    """

    label = "McKyes-Ali"
    source = "E. McKyes and O. S. Ali, J. Terramechanics 14 (1977) 43-51; E. McKyes, Soil Cutting and Tillage, 1985"
    standing = "factors of the plane wedge as published; the crescents' factors not verified against the paper"

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2].

        Raises:
            DomainError: as `TineLaw.tine`, a number is outside the domain of a wedge, or the rake angle is so flat and
                the tine so narrow that the factor of the weight is least at the end of the possible angles. A `Design`
                keeps this limit of a scene's law.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.McKyesAli(depth=0.35).reaction(at).static) / 1e3, 2)
            9.05
        """
        tine = self.tine(at)
        angles, ratio, soil = wedge_angles(tine, at), tine.depth / tine.width, at.soil
        beta = rupture_angle(angles, ratio)
        n, side = wedge_factors(angles, beta), _side(angles.rake, beta, ratio)
        weight = soil.density * GRAVITY * tine.depth * n.weight * (1.0 + 2.0 / 3.0 * side)
        strength = (soil.cohesion * n.cohesion + tine.surcharge * n.surcharge) * (1.0 + side)
        face = tine.width * tine.depth
        return SoilReaction(
            static=horizontal((weight + strength + tine.adhesion * n.adhesion) * face, tine, angles),
            drag=soil.density * n.inertia * face * sin(angles.rake + angles.tool_friction),
        )


def rupture_angle(angles: WedgeAngles, ratio: Expression) -> Expression:
    """Return the beta [rad] that minimises the factor of the weight, crescents included; ratio = d/w.

    Raises:
        DomainError: the minimum is at the end of the possible angles.
    """
    return least_angle(_weight_factor, angles, ratio)


def _weight_factor(angles: WedgeAngles, beta: Expression, ratio: Expression) -> Expression:
    return wedge_factors(angles, beta).weight * (1.0 + 2.0 / 3.0 * _side(angles.rake, beta, ratio))


def _side(alpha: Expression, beta: Expression, ratio: Expression) -> Expression:
    """Return s/w, the width of a crescent over that of the tine; ratio = d/w."""
    cot = 1.0 / tan(beta)
    return ratio * sqrt(cot * (cot + 2.0 / tan(alpha)))


@dataclass(frozen=True)
class UniversalEarthmoving(TineLaw):
    """The universal earthmoving equation, with crescents at the sides of a narrow tine: F0 and Fd.

    H = {(gamma d^2 Ng + c d Nc + c_a d Nca + q d Nq)(w + d (m - (m - 1)/3)) + rho v^2 Na d (w + 0.6 d)}
    sin(alpha + delta), plus the adhesion along the face. Source: Godwin and O'Dogherty 2003. The charts of Hettiaratchi
    and Reece for the factors are replaced by the plane wedge with the least factor of the weight, which gives higher
    values for rough tools. It holds from 0 to 5 m/s down to six widths, where soil begins to fail sideways, and ignores
    ambient pressure, added mass and loosened radius.

    Args:
        depth: working depth [m], above 0: a number, an array or a CasADi expression; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.
        rupture_ratio: ratio m of the rupture distance on the surface to the depth [-], at least 1; default: that of the
            plane wedge.

    Raises:
        DomainError: by `reaction`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", medium=po.laws.UniversalEarthmoving(depth=0.35))
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        17.38
    """

    rupture_ratio: Expression | None = field(default=None, metadata={"unit": ""})

    label = "the universal earthmoving equation"
    source = (
        "R. J. Godwin and M. J. O'Dogherty, Integrated soil tillage force prediction models, ISTVS 2003;"
        " J. Terramechanics 44 (2007) 3-14"
    )
    standing = "factors of a plane wedge instead of Hettiaratchi's charts; the critical depth not verified"
    scalar = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2].

        Raises:
            DomainError: as `TineLaw.tine`, a number is outside the domain of a wedge, or the depth exceeds six widths.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.UniversalEarthmoving(depth=0.35).reaction(at).static) / 1e3, 2)
            13.75
        """
        tine = self.tine(at)
        angles, soil, d, w = wedge_angles(tine, at), at.soil, tine.depth, tine.width
        why = "below the critical depth the soil fails sideways, which this equation does not describe"
        check_domain("depth over width", d / w, at_most=CRITICAL_RATIO, why=why)
        beta = plane_rupture_angle(angles)
        n, plane = wedge_factors(angles, beta), 1.0 / tan(tine.rake_angle) + cos(beta) / sin(beta)
        m = plane if self.rupture_ratio is None else self.rupture_ratio
        m = check_domain("rupture distance ratio m", m, at_least=1.0)
        still = soil.density * GRAVITY * d * n.weight + soil.cohesion * n.cohesion
        still = still + tine.adhesion * n.adhesion + tine.surcharge * n.surcharge
        return SoilReaction(
            static=horizontal(still * d * (w + d * (m - (m - 1.0) / 3.0)), tine, angles),
            drag=soil.density * n.inertia * d * (w + _REACH * d) * sin(angles.rake + angles.tool_friction),
        )


@dataclass(frozen=True)
class SwickPerumpral(TineLaw):
    """A plane wedge of accelerated soil without forces at its sides, so low for narrow tines.

    H = P sin(alpha + delta) plus the adhesion along the face, where
    P/(w d) = gamma d Ng + c Nc + q Nq + c_a Nca + rho v^2 Na is minimised over the rupture angle. Source: Swick and
    Perumpral, J. Terramechanics 25 (1988) 43-56; that P is minimised is not verified against the paper. It holds from 0
    to 5 m/s and for steady sliding, because the rupture angle depends on the speed: a scene must have
    ``Effects(motion=False)``.

    Args:
        depth: working depth [m], above 0: a number or a CasADi scalar; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.

    Raises:
        DomainError: by `reaction`.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
        >>> still = po.Effects(motion=False)
        >>> law = po.laws.SwickPerumpral(depth=0.35)
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", still, medium=law)
        >>> round(float(scene.steady_resistance) / 1e3, 2)
        1.89
    """

    label = "Swick-Perumpral"
    source = "W. C. Swick and J. V. Perumpral, J. Terramechanics 25 (1988) 43-56"
    standing = "plane wedge without side forces; that its force is minimised is not verified against the paper"
    lacking: ClassVar[Mapping[str, str]] = {**ResistanceLaw.lacking, **STEADY}

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return the draft at the tow speed as F0 [N].

        Raises:
            DomainError: as `TineLaw.tine`, a number is outside the domain of a wedge, or the force is least at the end
                of the possible angles. A `Design` keeps this limit of a scene's law.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.SwickPerumpral(depth=0.35).reaction(at).static) / 1e3, 2)
            1.89
        """
        tine, soil = self.tine(at), at.soil
        angles, weight = wedge_angles(tine, at), soil.density * GRAVITY * tine.depth
        loads = (weight, soil.cohesion, tine.surcharge, tine.adhesion, soil.density * at.speed**2)
        force = _pressure(angles, least_angle(_pressure, angles, *loads), *loads) * tine.width * tine.depth
        return SoilReaction(static=horizontal(force, tine, angles))


def _pressure(angles: WedgeAngles, beta: Expression, weight: Expression, *loads: Expression) -> Expression:
    """Return the force over w d, the mean pressure on the projection of the face [Pa]."""
    n = wedge_factors(angles, beta)
    cohesion, surcharge, adhesion, inertia = loads
    still = weight * n.weight + cohesion * n.cohesion + surcharge * n.surcharge + adhesion * n.adhesion
    return still + inertia * n.inertia
