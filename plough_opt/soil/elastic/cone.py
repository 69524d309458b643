"""Slender cone on its axis: equations (3) and (4) and the stresses by Hooke's law, for piecewise-linear profiles.

The body acts as a line of sources S' on its axis: on a small cylinder around it r u_r = S(x), with
S = section_factor R^2. With the potentials N and M of `plough_opt.soil.elastic.sources` the axial displacement is
2 (N_alpha - N_eta)/m - N_alpha + 2 N_eta and the radial one 2 (M_alpha - M_eta)/m - M_alpha.
"""

from dataclasses import dataclass

from plough_opt.core.checks import LEAST, check_domain
from plough_opt.core.expressions import Expression
from plough_opt.soil.elastic.medium import Medium, medium
from plough_opt.soil.elastic.profile import Body, Profile, body, points
from plough_opt.soil.elastic.sources import Potentials, displaced, potentials
from plough_opt.soil.soil import Soil

SECTION_FACTOR = 0.5
"""S/R^2 that conserves the displaced volume; 1 balances the energy. The slender-body model leaves the choice open."""


@dataclass(frozen=True)
class ConeDisplacement:
    """Displacement of the soil around a cone [m]: along its axis, with the stream, and away from it."""

    axial: Expression
    radial: Expression


@dataclass(frozen=True)
class ConeStress:
    """Stresses around a cone [Pa], tension positive: along x, radial, circumferential, and shear."""

    xx: Expression
    rr: Expression
    tt: Expression
    rx: Expression


def displacement_of(found: Potentials, section: Expression, r: Expression, soil: Medium) -> ConeDisplacement:
    """Return the displacement that belongs to potentials and to the displaced section S(x)."""
    return ConeDisplacement(
        axial=found.n + 2.0 * soil.eta**2 * found.n_change,
        radial=section / r + found.outward,
    )


def stress_of(found: Potentials, section: Expression, r: Expression, soil: Medium) -> ConeStress:
    """Return the stresses that belong to potentials and to the displaced section S(x)."""
    mu, hoop = soil.shear_modulus, (section / r + found.outward) / r
    dilatation = soil.stiffening * soil.lateral * found.n_x
    along = found.n_x + 2.0 * soil.eta**2 * found.n_x_change
    # u_x + u_r,r + u_r/r = kappa (1 + eta^2) N_x gives the radial strain.
    radial = soil.kappa * soil.lateral * found.n_x - along - hoop
    return ConeStress(
        xx=mu * (dilatation + 2.0 * along),
        rr=mu * (dilatation + 2.0 * radial),
        tt=mu * (dilatation + 2.0 * hoop),
        rx=2.0 * mu * soil.lateral * found.n_r_change,
    )


def cone_displacement(
    x: Expression,
    r: Expression,
    profile: Profile,
    soil: Soil,
    speed: Expression,
    section_factor: Expression = SECTION_FACTOR,
) -> ConeDisplacement:
    """Return the displacement around a slender cone that moves steadily, equations (3) and (4).

    The print's (4) lacks + S(infinity)/(2r), without which an open body would disturb the soil far ahead. The result is
    valid away from the body: at its surface the strains are of order one, too large for linear elasticity.

    Args:
        x: behind the tip [m]; a float, an array, or a CasADi column.
        r: from the axis [m], above 0, of the same shape.
        profile: nodes (x, radius) [m] from the tip, where the radius is 0; behind the last the body keeps its radius.
            A `Wedge` or `Cone` is replaced by its (equivalent) cone.
        soil: with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s], from 0 to below `shear_wave_speed`. For an MX expression a `Design` adds this limit as a
            requirement.
        section_factor: S/R^2 [-]: 1/2 conserves the displaced volume, 1 balances the energy; the theory leaves it open.

    Raises:
        DomainError: a speed at or beyond the shear wave's, a point on the axis, or a number outside its domain.
        InputError: an invalid profile, or a soil without elastic constants.
    """
    state, cone, x, r = _place(x, r, profile, soil, speed, section_factor)
    offsets = cone.offsets(x)
    found = potentials(offsets, r, cone, state, section_factor)
    section = displaced(offsets, cone, section_factor)
    displacement: ConeDisplacement = state.limited(displacement_of(found, section, r, state))
    return displacement


def cone_stress(
    x: Expression,
    r: Expression,
    profile: Profile,
    soil: Soil,
    speed: Expression,
    section_factor: Expression = SECTION_FACTOR,
) -> ConeStress:
    """Return the stresses around a slender cone: arguments, errors and limits as of `cone_displacement`."""
    state, cone, x, r = _place(x, r, profile, soil, speed, section_factor)
    offsets = cone.offsets(x)
    found = potentials(offsets, r, cone, state, section_factor)
    stress: ConeStress = state.limited(stress_of(found, displaced(offsets, cone, section_factor), r, state))
    return stress


def cone_pressure(
    x: Expression, profile: Profile, soil: Soil, speed: Expression, section_factor: Expression = SECTION_FACTOR
) -> Expression:
    """Return the pressure -sigma_rr [Pa] that the soil adds to its ambient pressure on the face of a slender cone.

    It is an order of magnitude only: it is near mu for any slender cone, strains on the face are of order one, and its
    dependence on the speed is of the order that linear elasticity neglects.

    Args:
        x: behind the tip [m], between the first and the last node, where the radius is above 0.
        profile: nodes (x, radius) [m], or a share.
        soil: with density, Young's modulus and Poisson's ratio.
        speed: V0 [m/s].
        section_factor: as in `cone_displacement`.

    Raises:
        DomainError: as `cone_displacement`, or x beside the body.
        InputError: as `cone_displacement`.
    """
    check_domain("section factor", section_factor, above=0.0)
    state, cone = state_of(soil, speed), body(profile)
    x, _ = points(x, 0.0, cone, state, section_factor)
    check_domain("x from the first node", x - cone.places[0], "m", above=0.0, why="the face begins there")
    check_domain("x beyond the last node", x - cone.places[-1], "m", at_most=0.0, why="the face ends there")
    radius = cone.height(x)
    check_domain("radius of the cone at x", radius, "m", above=0.0)
    return state.limited(face_pressure(cone.offsets(x), radius, cone, state, section_factor))


def face_pressure(
    offsets: list[Expression], radius: Expression, cone: Body, soil: Medium, section_factor: Expression
) -> Expression:
    """Return the pressure on the face at distances from the nodes [Pa]."""
    found = potentials(offsets, radius, cone, soil, section_factor)
    return -stress_of(found, displaced(offsets, cone, section_factor), radius, soil).rr


def state_of(soil: Soil, speed: Expression) -> Medium:
    """Return the medium at a speed below the shear wave's, where the cone's logarithms are finite."""
    state = medium(soil, speed)
    check_domain("speed over shear wave speed", state.mach, below=1.0, why="the cone's potentials end there")
    return state


def _place(
    x: Expression, r: Expression, profile: Profile, soil: Soil, speed: Expression, section_factor: Expression
) -> tuple[Medium, Body, Expression, Expression]:
    """Return the medium, the body, and the coordinates of a point off the axis."""
    check_domain("r", r, "m", above=0.0, at_least=LEAST, why="the axis itself is singular inside the body")
    check_domain("section factor", section_factor, above=0.0)
    state, cone = state_of(soil, speed), body(profile)
    x, r = points(x, r, cone, state, section_factor)
    return state, cone, x, r
