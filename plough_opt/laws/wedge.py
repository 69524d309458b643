"""A tine, the wedge of soil that it shears off, and the rupture plane of least force.

Let omega = alpha + delta + phi (rake, tool friction, internal friction), and beta the angle of the rupture plane to the
surface. The balance of forces on the wedge then gives every factor with the denominator sin(omega + beta). The
published factors, written with cotangents, are equivalent.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import LEAST, check_domain, check_kind
from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import Column, Expression, arctan, arctan2, cos, is_casadi, minimum, sin, sqrt, tan
from plough_opt.core.units import in_si
from plough_opt.laws.law import ResistanceLaw, ShareInSoil
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
        >>> tine = po.crosscheck.Tine(width=0.06, depth=0.3, rake_angle=po.deg(45))
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
    check_kind("the tine", tine, Tine, "a crosscheck.Tine")
    check_domain(
        "friction angle", soil.friction_angle, "rad", above=0.0,
        why="in soil without friction the weight does not determine a wedge",
    )  # fmt: skip
    check_domain(
        "speed", speed, "m/s", at_least=0.0, at_most=LARGEST_SPEED,
        why="above 3 to 5 m/s draft grows more slowly than the square of the speed",
    )  # fmt: skip
    angles = WedgeAngles(tine.rake_angle, arctan(soil.tool_friction), soil.friction_angle)
    check_domain(
        "rake angle, tool friction and internal friction together", angles.total, "rad", below=math.pi,
        why="the wedge of soil would not move up the face",
    )  # fmt: skip
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
        each = search.map(rows[0].size)(*(row.reshape(1, -1) for row in rows))
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
