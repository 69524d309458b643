"""Laws of the draft other than the plastic gas, each against its formulas as printed, and their table in `check`."""

import dataclasses
import json
import math
import re
from functools import partial

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.commands import printed
from helpers.differences import differences
from helpers.problem_files import PROBLEMS
from helpers.refusals import refusals
from helpers.small_designs import design
from scipy.integrate import quad, solve_ivp

import plough_opt as po
from plough_opt.app.tables import drafts_by_law
from plough_opt.laws import LAWS, AsabeD497, McKyesAli, SphericalCavity, SwickPerumpral, UniversalEarthmoving
from plough_opt.laws.cones import spherical_cavity
from plough_opt.laws.tines import GRAVITY, POINTS, TEXTURES, draft_of_row, rupture_angle, wedge_angles

# --- the table of `plough-opt check` ---

PAGE = (PROBLEMS.parent / "docs" / "explanation" / "crosscheck.md").read_text(encoding="utf-8")
SOIL = po.named_soil("serozem")
SHARE = po.Wedge(angle=po.deg(39.1), chisel_angle=po.deg(15.0), height=0.254)
BASE = 2 * SHARE.height * math.tan(SHARE.equivalent_cone().half_angle)


def scene(soil=SOIL, share=SHARE, medium="plastic", **effects):
    return po.Scene(soil, share, 5e4, 25.0, 2.0, po.Effects(**effects), medium=medium)


def drafts(*arguments, **changes):
    return {label: row["draft"] for label, row in drafts_by_law(scene(*arguments, **changes)).items()}


def placed(soil=SOIL, speed=2.0, share=SHARE):
    return po.ShareInSoil(share, share if isinstance(share, po.Cone) else share.equivalent_cone(), soil, speed)


def draft_of(law, soil=SOIL, speed=2.0, share=SHARE):
    return law.reaction(placed(soil, speed, share)).at(speed)


def test_each_law_gives_its_draft_of_a_tine_with_the_shares_dimensions():
    own, tine = drafts(), {"width": BASE, "depth": 0.254, "rake_angle": po.deg(15.0)}
    assert own["the plastic gas"] == pytest.approx(float(scene().steady_resistance), rel=1e-14)
    assert own["ASABE D497"] == pytest.approx(draft_of(AsabeD497(depth=0.254)), rel=1e-15)
    assert own["the universal earthmoving equation"] == pytest.approx(draft_of(UniversalEarthmoving(**tine)), rel=1e-14)
    assert own["the spherical cavity (Forrestal-Luk)"] == pytest.approx(draft_of(SphericalCavity()), rel=1e-15)
    assert set(own) == {law.label for law in LAWS.values()}
    deep = McKyesAli(depth=0.3, width=0.08, rake_angle=po.deg(45.0))
    assert drafts(medium=deep)["McKyes-Ali"] == pytest.approx(draft_of(deep), rel=1e-15)


def test_a_law_outside_its_domain_gives_a_reason_and_no_draft():
    row = drafts_by_law(scene())["McKyes-Ali"]
    assert row["draft"] is None
    assert "end of the possible angles" in row["standing"]
    cone = drafts_by_law(scene(share=po.Cone(po.deg(12.0), 0.25)))
    assert "give rake_angle" in cone["Swick-Perumpral"]["standing"]


def test_the_command_prints_every_law_with_its_standing():
    page = printed("check", PROBLEMS / "cotton_subsoiler.toml")
    for law in LAWS.values():
        assert law.label.removeprefix("the ") in page
    for words in ("calculated, not measured", "crosscheck.md", "outside its domain"):
        assert words in page
    rows = json.loads(printed("check", PROBLEMS / "cotton_subsoiler.toml", "--json"))["laws"]
    # 0.7 (226 + 1.8 S^2) 25 N at S = 7.2.
    assert rows["ASABE D497"]["draft"] == pytest.approx(0.7 * (226.0 + 1.8 * 7.2**2) * 25.0, rel=1e-12)


# --- docs/explanation/crosscheck.md ---


def test_the_page_states_the_effect_of_speed():
    """Increase of draft from 3 to 9 km/h in per cent, for the share of the cotton problem and similar tines."""
    problem = po.read_problem(PROBLEMS / "cotton_subsoiler.toml")
    guess, steeper = problem.scene(), problem.scene({"share.wedge_angle": po.deg(39.0)})

    def rise(draft):
        slow, fast = draft(3.0 / 3.6), draft(9.0 / 3.6)
        return 100.0 * (fast / slow - 1.0)

    for share, most in ((guess, 0.6), (steeper, 1.45)):
        assert 0.45 < rise(lambda v, own=share: dataclasses.replace(own, tow_speed=v).steady_resistance) < most
    for rake in (30.0, 45.0):
        at = {"rake_angle": po.deg(rake)}
        assert 11.5 < rise(lambda v, at=at: draft_of(SwickPerumpral(**at), guess.soil, v, guess.share)) < 15.0
        assert 3.0 < rise(lambda v, at=at: draft_of(UniversalEarthmoving(**at), guess.soil, v, guess.share)) < 5.0
    # It refuses a rake of 30 degrees.
    assert 3.0 < rise(lambda v: draft_of(McKyesAli(**at), guess.soil, v, guess.share)) < 5.0
    assert 53.0 < rise(lambda v: draft_of(AsabeD497(), guess.soil, v, guess.share)) < 54.0
    assert f"({100.0 * float(guess.ambient_share):.0f} % in serozem" in PAGE


def test_the_table_of_laws_matches_the_laws():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (.*?) *\|(.*?)\|(.*?)\|(.*?)\|$", PAGE, flags=re.MULTILINE)
    assert [name for name, *_ in rows] == list(LAWS)
    for name, kind, *cells in rows:
        law = LAWS[name]()
        assert type(law).__name__ == kind
        for cell, what in zip(cells, ("motion", "added_mass", "loosened_radius", "entry"), strict=True):
            assert (cell.strip() == "yes") != law.lacks(what), (name, what)


def test_the_rows_of_the_standard_match_the_code():
    rows = re.findall(r"^\| (narrow|winged) point.* \| (\S+) \| (\S+) \| (\S+) \| (.+) \|$", PAGE, flags=re.MULTILINE)
    assert {name: tuple(map(float, found[:3])) for name, *found in rows} == POINTS
    for *_, factors in rows:
        assert tuple(map(float, factors.split(", "))) == tuple(TEXTURES.values())


# --- ASABE D497: the form against a published example, the subsoiler's rows by hand ---

KM_PER_H = 1 / 3.6


def test_the_form_is_that_of_a_published_example():
    """A chisel plough: 0.7 [91 + 5.4 x 10 + 0] 45 tools x 15 cm = 68 512.5 N at 10 km/h."""
    assert draft_of_row((91.0, 5.4, 0.0), 0.7, 0.15, 10 * KM_PER_H, 45) == pytest.approx(68512.5, rel=1e-14)


BY_HAND = [
    ("narrow", "fine", (9.69, 10.84, 12.57, 14.87)),
    ("narrow", "medium", (6.78, 7.59, 8.80, 10.41)),
    ("winged", "coarse", (5.68, 6.37, 7.41, 8.79)),
]


@pytest.mark.parametrize(("point", "texture", "kilonewtons"), BY_HAND)
def test_the_subsoilers_rows_by_hand(point, texture, kilonewtons):
    """At 40 cm and 3, 5, 7 and 9 km/h, worked by hand to two decimals."""
    speeds = np.array([3.0, 5.0, 7.0, 9.0]) * KM_PER_H
    found = draft_of(AsabeD497(texture, point, depth=0.4), speed=speeds) / 1e3
    assert found == pytest.approx(kilonewtons, abs=0.0051)
    three = draft_of(AsabeD497(texture, point, 3, depth=0.4), speed=speeds[0])
    assert three == pytest.approx(3e3 * found[0], rel=1e-15)


# --- the spherical cavity: its closed form against the differential equation, the published form and known limits ---

NAMED = [po.named_soil(name) for name in po.soil_names()]
CONE = po.Cone(po.deg(15.0), 0.25)
RIGID = dataclasses.replace(NAMED[2], youngs_modulus=None)


def yield_line(soil):
    """Return lambda and tau0 of sigma_r - sigma_t = lambda p + tau0, Mohr and Coulomb's, in gauge pressures."""
    s, c = math.sin(soil.friction_angle), math.cos(soil.friction_angle)
    slope = 6 * s / (3 - s)
    return slope, 6 * soil.cohesion * c / (3 - s) + slope * soil.ambient_pressure


def integrated(soil, speed):
    """Return the gauge pressure on the wall [Pa] at a cavity radius of 1 m, by integrating the equation of motion."""
    slope, tau = yield_line(soil)
    rho0, rho1 = soil.density, soil.density / soil.density_ratio
    strain = tau / (2 * soil.youngs_modulus) if soil.youngs_modulus else 0.0
    # Volume: soil that filled the front's sphere r0 now lies, locked, between the cavity and r0 (1 + strain).
    r0 = float(mp.findroot(lambda r: rho0 * r**3 - rho1 * ((r * (1 + strain)) ** 3 - 1), 2.0))
    r1 = r0 * (1 + strain)
    front = speed * r0
    # Ahead: displacement strain r0^3/r^2, whose acceleration is 6 strain front^2 r0/r^2 and deviator tau (r0/r)^3.
    ahead = 0.0
    if strain:
        ahead = quad(lambda q: 2 * tau * q**2 + 6 * strain * rho0 * front**2, 0.0, 1.0, epsabs=0.0, epsrel=1e-13)[0]
    start = ahead + rho0 * front * (speed / r1**2 - 3 * strain * front)

    def slope_of(r, sigma):
        # p = sigma_r - (2/3) D, so that D = (lambda sigma_r + tau)/(1 + 2 lambda/3); v = V/r^2 at a cavity radius of 1.
        deviator = (slope * sigma + tau) / (1 + 2 * slope / 3)
        acceleration = 2 * speed**2 * (1 / r**2 - 1 / r**5)
        return -2 * deviator / r - rho1 * acceleration

    return solve_ivp(slope_of, (r1, 1.0), [start], method="DOP853", rtol=1e-12, atol=1e-6).y[0, -1]


@pytest.mark.parametrize("speed", [0.0, 2.0, 20.0])
@pytest.mark.parametrize("soil", [*NAMED, RIGID], ids=lambda s: s.name)
def test_the_closed_form_solves_the_equation_of_motion(soil, speed):
    cavity = spherical_cavity(soil)
    found = cavity.static + cavity.inertia * soil.density * speed**2
    # The integrator's tolerance is 1e-12 per step.
    assert found == pytest.approx(integrated(soil, speed), rel=1e-10)


def test_elastic_soil_ahead_is_the_published_form():
    """A equals the published one; B differs by terms of the order of the strain 1.6e-8 over eta = 0.05.

    The soil is that of a published port: lambda = 1.47, tau0 = 31 549 Pa, rho0/rho1 = 1834/1930.
    """
    eta, alpha, slope, tau = 96 / 1930, 3 * 1.47 / (3 + 2 * 1.47), 1.47, 31549.0
    s = 3 * slope / (6 + slope)
    cohesion = tau * (3 - s) / (6 * math.sqrt(1 - s * s))
    soil = po.Soil(1834.0, 1 - eta, cohesion, math.asin(s), 0.3, ambient_pressure=0.0, youngs_modulus=1e12)
    strain = tau / 2e12
    g = ((1 + strain) ** 3 - (1 - eta)) ** (1 / 3)
    x = ((1 + strain) / g) ** (2 * alpha)
    c1 = 6 * strain + eta * (1 - 3 * strain) ** 2
    k = (1 - eta) * (1 - 2 * alpha) * (2 - alpha)
    c2 = -(g**3) * (2 * (1 - eta) * (2 - alpha) + 3 * g**3) / (k * (1 + strain) ** 4)
    cavity = spherical_cavity(soil)
    assert cavity.static == pytest.approx(tau * (x / alpha - 1 / slope), rel=1e-12)
    assert cavity.inertia == pytest.approx(3 / k + x / g**2 * (c1 + c2), rel=3e-6)


@pytest.mark.parametrize("soil", [NAMED[2], RIGID])
def test_the_draft_is_the_pressure_over_the_face(soil):
    speed, b = 2.0, CONE.half_angle
    cavity = spherical_cavity(soil)
    pressure = cavity.static + cavity.inertia * soil.density * (speed * math.sin(b)) ** 2
    expected = pressure * CONE.area * (math.sin(b) + soil.tool_friction * math.cos(b))
    assert draft_of(SphericalCavity(), soil, speed, CONE) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_and_arrays_give_the_numbers(kind):
    """At lambda = 0.75, 2 alpha = 1 and the quotient of powers has a removable singularity."""
    s = 3 * 0.75 / (6 + 0.75)
    theta = kind.sym("theta")

    def at(angle):
        return draft_of(SphericalCavity(), dataclasses.replace(NAMED[2], friction_angle=angle), share=CONE)

    value = at(theta)
    f = ca.Function("f", [theta], [value, ca.gradient(value, theta)])
    for angle in (math.asin(s), 0.0, 0.5):
        found, slope = map(float, f(angle))
        assert found == pytest.approx(at(angle), rel=1e-14)
        if angle:
            # Central differences with a step of 1e-5: truncation 1e-10, rounding 1e-11.
            assert slope == pytest.approx((at(angle + 1e-5) - at(angle - 1e-5)) / 2e-5, rel=1e-8)
    angles = np.array([0.3, 0.5])
    assert at(angles) == pytest.approx([at(a) for a in angles], rel=1e-14)


# --- McKyes-Ali, Swick-Perumpral and the universal earthmoving equation: factors, limits, worked figures, refusals ---
# Expected values come from the formulas as printed, with 30 digits of mpmath, or were worked beforehand.

# Unit weight 15 kN/m^3, cohesion 15 kPa, internal friction 32 deg, tool friction 22 deg.
TILLED = po.Soil(15e3 / GRAVITY, 0.8, 15e3, po.deg(32.0), math.tan(po.deg(22.0)))
TINE = {"width": 0.06, "depth": 0.20, "rake_angle": po.deg(45.0)}
LOADED = {"width": 0.10, "depth": 0.25, "rake_angle": po.deg(50.0), "surcharge": 2e3, "adhesion": 3e3}
OF_TINES = (McKyesAli, UniversalEarthmoving, SwickPerumpral)


def printed_factors(alpha, delta, phi, beta):
    """Return McKyes's factors of a plane wedge as they are printed."""
    q = mp.cos(alpha + delta) + mp.sin(alpha + delta) * mp.cot(beta + phi)
    return {
        "weight": (mp.cot(alpha) + mp.cot(beta)) / (2 * q),
        "cohesion": (1 + mp.cot(beta) * mp.cot(beta + phi)) / q,
        "surcharge": (mp.cot(alpha) + mp.cot(beta)) / q,
        "adhesion": (1 - mp.cot(alpha) * mp.cot(beta + phi)) / q,
        "inertia": (mp.tan(beta) + mp.cot(beta + phi)) / (q * (1 + mp.tan(beta) * mp.cot(alpha))),
    }


def precise(soil, tine):
    """Return alpha, delta, phi, w, d, unit weight, cohesion, adhesion and surcharge with 30 digits."""
    angles = tine["rake_angle"], math.atan(soil.tool_friction), soil.friction_angle
    loads = soil.density * GRAVITY, soil.cohesion, tine.get("adhesion", 0.0), tine.get("surcharge", 0.0)
    return [mp.mpf(x) for x in (*angles, tine["width"], tine["depth"], *loads)]


def least(function, start):
    """Return the angle at which an mpmath function is least, by its derivative's root."""
    return mp.findroot(lambda x: mp.diff(function, x), start)


@pytest.fixture(autouse=True)
def _digits():
    with mp.workdps(30):
        yield


# The factor of the weight has its minimum at 66 degrees for this tine, and falls again towards 90 degrees.
FALLS_AGAIN = {"width": 0.08, "depth": 0.30, "rake_angle": po.deg(32.0)}


@pytest.mark.parametrize("tine", [TINE, FALLS_AGAIN, LOADED])
def test_mckyes_ali_is_the_printed_formula_at_its_least_angle(tine):
    alpha, delta, phi, w, d, gamma, c, c_a, q = precise(TILLED, tine)

    def side(beta):
        r = d * (mp.cot(alpha) + mp.cot(beta))
        return mp.sqrt(r**2 - (d * mp.cot(alpha)) ** 2)

    beta = least(lambda b: printed_factors(alpha, delta, phi, b)["weight"] * (1 + 2 * side(b) / (3 * w)), 0.9)
    law, at = McKyesAli(**tine), placed(TILLED, 0.0)
    found = rupture_angle(wedge_angles(law.tine(at), at), tine["depth"] / tine["width"])
    assert found == pytest.approx(float(beta), rel=1e-12)
    n, v = printed_factors(alpha, delta, phi, beta), 1.5
    s = side(beta)
    force = gamma * d**2 * n["weight"] * (1 + 2 * s / (3 * w))
    force += d * (c * n["cohesion"] + q * n["surcharge"]) * (1 + s / w)
    force += d * (c_a * n["adhesion"] + TILLED.density * v**2 * n["inertia"])
    expected = w * force * mp.sin(alpha + delta) + c_a * w * d * mp.cot(alpha)
    assert draft_of(law, TILLED, v) == pytest.approx(float(expected), rel=1e-12)


def test_swick_perumpral_is_the_printed_formula_at_its_least_angle():
    b, delta, f, w, d, gamma, c, c_a, q = precise(TILLED, LOADED)

    def force(r):
        weight = (gamma * d / 2 + q) * (mp.cot(b) + mp.cot(r)) * mp.sin(f + r)
        strength = c * mp.cos(f) / mp.sin(r) - c_a * mp.cos(b + f + r) / mp.sin(b)
        inertia = gamma / GRAVITY * 2**2 * mp.sin(b) * mp.cos(f) / mp.sin(b + r)
        return w * d / mp.sin(b + f + r + delta) * (weight + strength + inertia)

    expected = force(least(force, 0.5)) * mp.sin(b + delta) + c_a * w * d * mp.cot(b)
    assert draft_of(SwickPerumpral(**LOADED), TILLED) == pytest.approx(float(expected), rel=1e-13)


def test_godwin_is_the_printed_formula():
    alpha, delta, phi, w, d, gamma, c, c_a, q = precise(TILLED, LOADED)
    beta = least(lambda b: printed_factors(alpha, delta, phi, b)["weight"], 0.5)
    n = printed_factors(alpha, delta, phi, beta)
    v, m = 2, mp.mpf("2.25")
    still = gamma * d**2 * n["weight"] + d * (c * n["cohesion"] + c_a * n["adhesion"] + q * n["surcharge"])
    total = still * (w + d * (m - (m - 1) / 3)) + gamma * v**2 / GRAVITY * n["inertia"] * d * (w + d * mp.mpf("0.6"))
    expected = total * mp.sin(alpha + delta) + c_a * w * d * mp.cot(alpha)
    law = UniversalEarthmoving(**LOADED, rupture_ratio=2.25)
    assert draft_of(law, TILLED) == pytest.approx(float(expected), rel=1e-12)
    plane = dataclasses.replace(law, rupture_ratio=float(mp.cot(alpha) + mp.cot(beta)))
    assert draft_of(UniversalEarthmoving(**LOADED), TILLED) == pytest.approx(draft_of(plane, TILLED), rel=1e-12)


@pytest.mark.parametrize("law", OF_TINES)
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_and_arrays_give_numbers_and_exact_derivatives(law, kind):
    """Gradient and Hessian against central differences of order 8, whose error is 1e-16 over a step of 2e-4."""
    point = np.array([0.10, 0.25, po.deg(50.0), 15e3, po.deg(32.0), 0.4, 1.5])

    def at(width, depth, rake, cohesion, friction, tool, speed):
        soil = dataclasses.replace(TILLED, cohesion=cohesion, friction_angle=friction, tool_friction=tool)
        return draft_of(law(depth, width, rake, 2e3, 3e3), soil, speed)

    function = hp.differentiated(at, kind, len(point))
    value, gradient, hessian = function(point)
    assert value == pytest.approx(at(*point), rel=1e-13)
    depths = np.array([0.1, 0.2, 0.3])
    arrays = at(point[0], depths, *point[2:])
    assert arrays == pytest.approx([at(point[0], depth, *point[2:]) for depth in depths.tolist()], rel=1e-14)
    at_rest = np.zeros(len(point))
    slopes = differences(lambda y: at(*(point * (1.0 + y))), at_rest)[0]
    assert gradient * point == pytest.approx(slopes, rel=1e-10, abs=1e-10 * value)
    bends = differences(lambda y: function(point * (1.0 + y))[1] * point, at_rest)
    np.testing.assert_allclose(hessian * np.outer(point, point), bends, atol=1e-9 * value)


def test_a_design_keeps_the_rupture_angle_inside_its_range():
    """A flatter rake reduces the draft until the factor at the end of the angles equals its minimum inside."""
    d, rake = design(rake=("50 deg", "10 deg", "80 deg"))
    law = McKyesAli(depth=0.3, width=0.08, rake_angle=rake)
    draft = po.Scene(TILLED, SHARE, 5e4, 25.0, 1.5, po.Effects(), medium=law).steady_resistance
    d.minimise(draft / 1e3)
    best = d.solve()
    (name,) = best.active
    assert name.startswith("McKyes-Ali: least force of a wedge")
    law = dataclasses.replace(law, rake_angle=best.variables["rake"])
    assert draft_of(law, TILLED, 1.5) == pytest.approx(best(draft), rel=1e-10)
    with pytest.raises(po.DomainError, match="end of the possible angles"):
        draft_of(dataclasses.replace(law, rake_angle=law.rake_angle - po.deg(0.1)), TILLED, 1.5)
    # Far outside, where the factor has no least value at all.
    with pytest.raises(po.DomainError, match="end of the possible angles = 1 must be below 1"):
        draft_of(dataclasses.replace(law, rake_angle=1e-4), TILLED, 1.5)


SOFT, FLUID = dataclasses.replace(NAMED[2], youngs_modulus=1e6), dataclasses.replace(TILLED, friction_angle=0.0)
ROUGH = dataclasses.replace(TILLED, friction_angle=po.deg(80.0), tool_friction=2.0)
OUTSIDE = [(FLUID, 1.0, "friction angle"), (TILLED, -1.0, "speed"), (TILLED, 5.1, "speed"), (ROUGH, 1.0, "together")]
test_invalid_arguments_and_what_lies_outside_a_models_domain_are_refused = refusals(
    (po.InputError, po.DomainError),
    (lambda: draft_of(AsabeD497("fin")), "did you mean 'fine'"),
    (lambda: draft_of(AsabeD497(depth=0.0)), "working depth"),
    (lambda: draft_of(SphericalCavity(), speed=-1.0), "speed"),
    (lambda: draft_of(SphericalCavity(), SOFT), "strain"),
    (lambda: draft_of(SphericalCavity(), NAMED[2], 300.0, CONE), "compaction front"),
    *((partial(draft_of, law(**TINE), soil, speed), words) for law in OF_TINES for soil, speed, words in OUTSIDE),
    (lambda: draft_of(UniversalEarthmoving(**TINE | {"depth": 0.37}), TILLED), "critical depth"),
    (lambda: draft_of(McKyesAli(**TINE | {"rake_angle": po.deg(95.0)}), TILLED), "rake angle"),
)
