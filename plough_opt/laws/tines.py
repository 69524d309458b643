"""Draft of tines by formulas of the field: ASABE D497, McKyes and Ali, the universal equation, Swick and Perumpral."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import LEAST, check_domain, check_kind, check_named, limited_in_designs
from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import Column, Expression, arctan, arctan2, cos, is_casadi, minimum, sin, sqrt, tan
from plough_opt.core.units import in_si
from plough_opt.laws.law import STEADY, ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.soil.geometry import Wedge
from plough_opt.soil.soil import Soil, check_soil

GRAVITY: Final = 9.80665
"""Standard acceleration of gravity [m/s^2]."""

LARGEST_SPEED: Final = 5.0
"""Largest speed [m/s] for which a term with the squared speed is accepted."""

# Points of the grid on which the first minimum of a force is searched.
_GRID = 64
# Bisections of the slope's sign, from two grid steps to rounding.
_HALVINGS = 40
# Newton steps make the derivatives exact: each step doubles the order that is correct.
_NEWTON_STEPS = 3
# Forces are compared at this fraction of the largest angle, because they may be infinite at the end.
_INSIDE = 1.0 - 1e-9


@dataclass(frozen=True)
class Tine:
    """A flat tine that cuts soil up to its surface.

    Args:
        width: width w [m], above 0; as the others a number, an array, a CasADi scalar, or text such as "8 cm".
        depth: depth d of its lower edge below the surface [m], above 0.
        rake_angle: angle alpha of its face to the horizontal, measured ahead [rad], above 0 and at most 90 degrees.
        surcharge: pressure q on the soil's surface [Pa], at least 0.
        adhesion: adhesion c_a of soil on the face [Pa], at least 0.

    Raises:
        DomainError: a number lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> tine = po.laws.Tine(width=0.06, depth=0.3, rake_angle=po.deg(45))
        >>> tine.width
        0.06
    """

    width: Expression
    depth: Expression
    rake_angle: Expression
    surcharge: Expression = 0.0
    adhesion: Expression = 0.0

    def __post_init__(self) -> None:
        limits: dict[str, tuple[str, str, dict[str, Any]]] = {
            "width": ("tool width", "m", {"above": 0.0}),
            "depth": ("working depth", "m", {"above": 0.0}),
            "rake_angle": ("rake angle", "rad", {"above": 0.0, "at_least": LEAST, "at_most": math.pi / 2}),
            "surcharge": ("surcharge", "Pa", {"at_least": 0.0}),
            "adhesion": ("adhesion", "Pa", {"at_least": 0.0}),
        }
        for name, (what, unit, domain) in limits.items():
            value = in_si(what, getattr(self, name), unit)
            object.__setattr__(self, name, check_domain(what, value, unit, **domain))


@dataclass(frozen=True)
class TineLaw(ResistanceLaw):
    """A law for a tine that stands for the share; dimensions that are not given are estimated from the share.

    Args:
        depth: working depth [m]; default: the share's height.
        width: width of the tine [m]; default: base diameter of the equivalent cone.
        rake_angle: rake angle of the tine [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa].
        adhesion: adhesion of soil on the tine [Pa].
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
            >>> po.laws.McKyesAli(width=0.08, depth=0.35).tine(at).width
            0.08
        """
        rake = self.rake_angle
        if rake is None:
            if not isinstance(at.share, Wedge):
                raise DomainError("a share given as a cone does not have a rake angle: give rake_angle")
            rake = at.share.chisel_angle
        return Tine(
            width=2.0 * at.cone.height * at.cone.slope if self.width is None else self.width,
            depth=at.share.height if self.depth is None else self.depth,
            rake_angle=rake,
            surcharge=self.surcharge,
            adhesion=self.adhesion,
        )


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


def wedge_angles(soil: Soil, tine: Tine, speed: Expression) -> WedgeAngles:
    """Return the angles of the wedge.

    Raises:
        InputError: soil or tine has the wrong type.
        DomainError: the soil has no friction, the angles sum to 180 degrees or more, or the speed is outside 0 to
            5 m/s.
    """
    check_soil(soil)
    check_kind("the tine", tine, Tine, "a laws.Tine")
    why = "in soil without friction the weight does not determine a wedge"
    check_domain("friction angle", soil.friction_angle, "rad", above=0.0, why=why)
    why = "above 3 to 5 m/s draft grows more slowly than the square of the speed"
    check_domain("speed", speed, "m/s", at_least=0.0, at_most=LARGEST_SPEED, why=why)
    angles = WedgeAngles(tine.rake_angle, arctan(soil.tool_friction), soil.friction_angle)
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
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        before = g(middle, *p)[0] < 0.0
        low, high = ca.if_else(before, middle, low), ca.if_else(before, high, middle)
    found = (low + high) / 2.0
    for _ in range(_NEWTON_STEPS):
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
_LABEL = "ASABE D497"
CRITICAL_RATIO: Final = 6.0
"""Depth over width beyond which soil fails sideways at depth; reported as 5 to 6, not verified."""
# The inertia is that of soil in the tine's width plus this fraction of the depth.
_REACH = 0.6


@dataclass(frozen=True)
class AsabeD497(ResistanceLaw):
    """`asabe_draft` as a law: F0 and Fd depend on depth and texture, but not on soil properties or the share's angles.

    F = F (A + C S^2) N T for S in km/h and T in cm, the subsoiler's rows of ASABE D497.7, not verified against the
    standard's text, which is said to allow +-50 %. It moves with the share's own mass alone, and has no ambient
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

    label = _LABEL
    source = "ASABE D497.7, Agricultural machinery management data"
    standing = "coefficients not verified against the standard's text, which is said to allow +-50 %"

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2]; the subsoiler's rows do not have a term linear in the speed.

        Raises:
            InputError, DomainError: as `asabe_draft`.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "30 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.AsabeD497().reaction(at).at(2.0)))
            6706
        """
        depth = at.share.height if self.depth is None else in_si("working depth", self.depth, "m")
        static = asabe_draft(depth, 0.0, self.texture, point=self.point, shanks=self.shanks)
        check_domain("speed", at.speed, "m/s", at_least=0.0)
        _, _, squared = POINTS[self.point]
        drag = TEXTURES[self.texture] * squared * _KM_PER_H**2 * self.shanks * (_CM * depth)
        return SoilReaction(static=static, drag=drag)


@limited_in_designs(_LABEL)
def asabe_draft(
    depth: Expression, speed: Expression, texture: str, *, point: str = "narrow", shanks: Expression = 1.0
) -> Expression:
    """Return the draft [N] F (A + B S + C S^2) N T of a subsoiler, with S in km/h and T in cm.

    Source: ASABE D497.7. The form and its units agree with a published worked example for a chisel plough. The
    coefficients of the subsoiler's rows are not verified against the standard's text. The draft does not depend on tool
    width, rake angle, or the soil's density and strength.

    Args:
        depth: tillage depth T [m], above 0.
        speed: S [m/s], at least 0.
        texture: ``"fine"`` (clay), ``"medium"`` (loam) or ``"coarse"`` (sand).
        point: ``"narrow"`` or ``"winged"``.
        shanks: number N of shanks.

    Raises:
        InputError: the texture or the point is unknown.
        DomainError: depth, speed or number of shanks lies outside its domain.

    Example:
        >>> import plough_opt as po
        >>> draft = po.laws.asabe_draft(texture="medium", point="narrow", depth=0.3, speed=2.0)
        >>> round(float(draft) / 1e3, 2)
        6.71
    """
    check_named("no soil texture of D497 is named {}", texture, TEXTURES)
    check_named("no subsoiler point of D497 is named {}", point, POINTS)
    depth = check_domain("working depth", in_si("working depth", depth, "m"), "m", above=0.0)
    speed = check_domain("speed", in_si("speed", speed, "m/s"), "m/s", at_least=0.0)
    shanks = check_domain("number of shanks", shanks, above=0.0)
    return draft_of_row(POINTS[point], TEXTURES[texture], depth, speed, shanks)


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
    """`mckyes_ali_draft` as a law: F0 and Fd of a narrow tine, without added mass and loosened radius.

    A wedge of soil with a crescent at each side, cut along the plane of least weight: McKyes and Ali, J. Terramechanics
    14 (1977) 43-51. It holds from 0 to 5 m/s for a rake angle below a right angle, and ignores ambient pressure.
    Arguments, each a number or a CasADi scalar: see `TineLaw`.

    Args:
        depth: working depth [m], above 0; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.

    Raises:
        DomainError: by `reaction`: see `mckyes_ali_draft`.

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
        """Return F0 [N] and Fd [N s^2/m^2]; see `mckyes_ali_draft`.

        Raises:
            DomainError: as `mckyes_ali_draft`, or the share is a cone and there is no rake angle.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.McKyesAli(depth=0.35).reaction(at).static) / 1e3, 2)
            9.05
        """
        return _mckyes_ali(at.soil, self.tine(at), at.speed)


@limited_in_designs("McKyes and Ali")
def mckyes_ali_draft(soil: Soil, tine: Tine, speed: Expression) -> Expression:
    """Return the draft [N] of a narrow tine that shears off a wedge with a crescent at each side.

    H = {gamma d^2 Ng (1 + 2s/3w) + (c Nc + q Nq)(1 + s/w) d + (c_a Nca + rho v^2 Na) d} w sin(alpha + delta), plus the
    adhesion along the face, with s = d sqrt(cot beta (cot beta + 2 cot alpha)); beta minimises the factor of the
    weight. The crescents do not affect the term with the squared speed. Source: McKyes and Ali 1977; the crescents'
    factors are not verified against the paper.

    Args:
        soil: soil whose density, cohesion, friction and tool friction are used, but not its ambient pressure.
        tine: tine with floats or CasADi scalars.
        speed: v [m/s], from 0 to 5.

    Raises:
        DomainError: an argument is outside the domain of a wedge, or the rake angle is so flat and the tine so narrow
            that the factor of the weight is least at the end of the possible angles. For MX symbols a `Design` enforces
            this limit.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> tine = po.laws.Tine(width=0.06, depth=0.3, rake_angle=po.deg(45))
        >>> round(float(po.laws.mckyes_ali_draft(soil, tine, 2.0)) / 1e3, 2)
        7.59
    """
    return _mckyes_ali(soil, tine, speed).at(speed)


def _mckyes_ali(soil: Soil, tine: Tine, speed: Expression) -> SoilReaction:
    """Return static draft and coefficient of the squared speed; the speed itself is only checked."""
    angles = wedge_angles(soil, tine, speed)
    beta = rupture_angle(angles, tine.depth / tine.width)
    n = wedge_factors(angles, beta)
    side = _side(angles.rake, beta, tine.depth / tine.width)
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
    """`godwin_draft` as a law: F0 and Fd of a narrow tine, without added mass and loosened radius.

    The universal earthmoving equation after Godwin and O'Dogherty 2003, with factors of a plane wedge. It holds from 0
    to 5 m/s down to six widths, where soil begins to fail sideways, and ignores ambient pressure.

    Args:
        depth: working depth [m], above 0: a number, an array or a CasADi expression; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.
        rupture_ratio: ratio m of the rupture distance on the surface to the depth [-], at least 1; default: that of the
            plane wedge.

    Raises:
        DomainError: by `reaction`: see `godwin_draft`.

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
        """Return F0 [N] and Fd [N s^2/m^2]; see `godwin_draft`.

        Raises:
            DomainError: as `godwin_draft`, or the share is a cone and there is no rake angle.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.UniversalEarthmoving(depth=0.35).reaction(at).static) / 1e3, 2)
            13.75
        """
        return _godwin(at.soil, self.tine(at), at.speed, self.rupture_ratio)


@limited_in_designs("universal earthmoving equation")
def godwin_draft(soil: Soil, tine: Tine, speed: Expression, *, rupture_ratio: Expression | None = None) -> Expression:
    """Return the draft [N] by the universal earthmoving equation, including crescents at the sides.

    H = {(gamma d^2 Ng + c d Nc + c_a d Nca + q d Nq)(w + d (m - (m - 1)/3)) + rho v^2 Na d (w + 0.6 d)}
    sin(alpha + delta), plus the adhesion along the face. Source: Godwin and O'Dogherty 2003. The charts of Hettiaratchi
    and Reece for the factors are replaced by the plane wedge with the least factor of the weight, which gives higher
    values for rough tools.

    Args:
        soil: soil whose density, cohesion, friction and tool friction are used, but not its ambient pressure.
        tine: tine with floats, arrays or CasADi expressions.
        speed: v [m/s], from 0 to 5.
        rupture_ratio: ratio m of the rupture distance on the surface to the depth, at least 1; default: that of the
            plane wedge, cot(alpha) + cot(beta).

    Raises:
        DomainError: an argument is outside the domain of a wedge, or the depth exceeds six widths.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> tine = po.laws.Tine(width=0.06, depth=0.3, rake_angle=po.deg(45))
        >>> round(float(po.laws.godwin_draft(soil, tine, 2.0)) / 1e3, 2)
        10.64
    """
    return _godwin(soil, tine, speed, rupture_ratio).at(speed)


def _godwin(soil: Soil, tine: Tine, speed: Expression, rupture_ratio: Expression | None) -> SoilReaction:
    """Return static draft and coefficient of the squared speed; the speed itself is only checked."""
    angles = wedge_angles(soil, tine, speed)
    check_domain(
        "depth over width", tine.depth / tine.width, at_most=CRITICAL_RATIO,
        why="below the critical depth the soil fails sideways, which this equation does not describe",
    )  # fmt: skip
    beta = plane_rupture_angle(angles)
    n = wedge_factors(angles, beta)
    m = 1.0 / tan(tine.rake_angle) + cos(beta) / sin(beta) if rupture_ratio is None else rupture_ratio
    m = check_domain("rupture distance ratio m", m, at_least=1.0)
    d, w = tine.depth, tine.width
    still = soil.density * GRAVITY * d * n.weight + soil.cohesion * n.cohesion
    still = still + tine.adhesion * n.adhesion + tine.surcharge * n.surcharge
    return SoilReaction(
        static=horizontal(still * d * (w + d * (m - (m - 1.0) / 3.0)), tine, angles),
        drag=soil.density * n.inertia * d * (w + _REACH * d) * sin(angles.rake + angles.tool_friction),
    )


@dataclass(frozen=True)
class SwickPerumpral(TineLaw):
    """`swick_perumpral_draft` as a law for steady sliding, because the rupture angle depends on the speed.

    A plane wedge of accelerated soil without forces at its sides, so low for narrow tines: Swick and Perumpral, J.
    Terramechanics 25 (1988) 43-56. It holds from 0 to 5 m/s; a scene must have ``Effects(motion=False)``.

    Args:
        depth: working depth [m], above 0: a number or a CasADi scalar; default: the share's height.
        width: width of the tine [m], above 0; default: base diameter of the equivalent cone.
        rake_angle: rake angle [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        surcharge: pressure on the soil's surface [Pa], at least 0.
        adhesion: adhesion of soil on the tine [Pa], at least 0.

    Raises:
        DomainError: by `reaction`: see `swick_perumpral_draft`.

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
            DomainError: as `swick_perumpral_draft`, or the share is a cone and there is no rake angle.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "35 deg", "25 cm")
            >>> at = po.ShareInSoil(share, share.equivalent_cone(), po.named_soil("serozem"), 2.0)
            >>> round(float(po.laws.SwickPerumpral(depth=0.35).reaction(at).static) / 1e3, 2)
            1.89
        """
        return SoilReaction(static=swick_perumpral_draft(at.soil, self.tine(at), at.speed))


@limited_in_designs("Swick and Perumpral")
def swick_perumpral_draft(soil: Soil, tine: Tine, speed: Expression) -> Expression:
    """Return the draft [N] of a plane wedge of accelerated soil, without forces at its sides.

    H = P sin(alpha + delta) plus the adhesion along the face, where
    P/(w d) = gamma d Ng + c Nc + q Nq + c_a Nca + rho v^2 Na is minimised over the rupture angle. Source: Swick and
    Perumpral 1988; that P is minimised is not verified against the paper. The side forces of narrow tines are left out,
    so the result is low for them.

    Args:
        soil: soil whose density, cohesion, friction and tool friction are used, but not its ambient pressure.
        tine: tine with floats or CasADi scalars.
        speed: v [m/s], from 0 to 5.

    Raises:
        DomainError: an argument is outside the domain of a wedge, or the force is least at the end of the possible
            angles. For MX symbols a `Design` enforces this limit.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> tine = po.laws.Tine(width=0.06, depth=0.3, rake_angle=po.deg(45))
        >>> round(float(po.laws.swick_perumpral_draft(soil, tine, 2.0)) / 1e3, 2)
        0.92
    """
    angles = wedge_angles(soil, tine, speed)
    loads = (soil.density * GRAVITY * tine.depth, soil.cohesion, tine.surcharge, tine.adhesion, soil.density * speed**2)
    beta = least_angle(_pressure, angles, *loads)
    return horizontal(_pressure(angles, beta, *loads) * tine.width * tine.depth, tine, angles)


def _pressure(angles: WedgeAngles, beta: Expression, weight: Expression, *loads: Expression) -> Expression:
    """Return the force over w d, the mean pressure on the projection of the face [Pa]."""
    n = wedge_factors(angles, beta)
    cohesion, surcharge, adhesion, inertia = loads
    still = weight * n.weight + cohesion * n.cohesion + surcharge * n.surcharge + adhesion * n.adhesion
    return still + inertia * n.inertia
