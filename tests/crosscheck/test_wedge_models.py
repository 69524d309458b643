"""McKyes-Ali, Swick-Perumpral and the universal earthmoving equation: factors, limits, worked figures, refusals.

Expected values come from the formulas as printed, with 30 digits of mpmath, or were worked beforehand.
"""

import dataclasses
import math

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from helpers import high_precision as hp
from helpers.differences import differences

import plough_opt as po
from plough_opt.laws.tines import rupture_angle
from plough_opt.laws.wedge import GRAVITY, wedge_angles
from plough_opt.studies.crosscheck import Tine, godwin_draft, mckyes_ali_draft, swick_perumpral_draft

# Unit weight 15 kN/m^3, cohesion 15 kPa, internal friction 32 deg, tool friction 22 deg.
SOIL = po.Soil(15e3 / GRAVITY, 0.8, 15e3, po.deg(32.0), math.tan(po.deg(22.0)))
TINE = Tine(width=0.06, depth=0.20, rake_angle=po.deg(45.0))
LOADED = Tine(width=0.10, depth=0.25, rake_angle=po.deg(50.0), surcharge=2e3, adhesion=3e3)
DRAFTS = (mckyes_ali_draft, godwin_draft, swick_perumpral_draft)


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
    angles = tine.rake_angle, math.atan(soil.tool_friction), soil.friction_angle
    loads = soil.density * GRAVITY, soil.cohesion, tine.adhesion, tine.surcharge
    return [mp.mpf(x) for x in (*angles, tine.width, tine.depth, *loads)]


def least(function, start):
    """Return the angle at which an mpmath function is least, by its derivative's root."""
    return mp.findroot(lambda x: mp.diff(function, x), start)


@pytest.fixture(autouse=True)
def _digits():
    with mp.workdps(30):
        yield


# The factor of the weight has its minimum at 66 degrees for this tine, and falls again towards 90 degrees.
FALLS_AGAIN = Tine(width=0.08, depth=0.30, rake_angle=po.deg(32.0))


@pytest.mark.parametrize("tine", [TINE, FALLS_AGAIN, LOADED])
def test_mckyes_ali_is_the_printed_formula_at_its_least_angle(tine):
    alpha, delta, phi, w, d, gamma, c, c_a, q = precise(SOIL, tine)

    def side(beta):
        r = d * (mp.cot(alpha) + mp.cot(beta))
        return mp.sqrt(r**2 - (d * mp.cot(alpha)) ** 2)

    beta = least(lambda b: printed_factors(alpha, delta, phi, b)["weight"] * (1 + 2 * side(b) / (3 * w)), 0.9)
    angles = wedge_angles(SOIL, tine, 0.0)
    assert rupture_angle(angles, tine.depth / tine.width) == pytest.approx(float(beta), rel=1e-12)
    n, v = printed_factors(alpha, delta, phi, beta), 1.5
    s = side(beta)
    force = gamma * d**2 * n["weight"] * (1 + 2 * s / (3 * w))
    force += d * (c * n["cohesion"] + q * n["surcharge"]) * (1 + s / w)
    force += d * (c_a * n["adhesion"] + SOIL.density * v**2 * n["inertia"])
    expected = w * force * mp.sin(alpha + delta) + c_a * w * d * mp.cot(alpha)
    assert mckyes_ali_draft(SOIL, tine, v) == pytest.approx(float(expected), rel=1e-12)


def test_swick_perumpral_is_the_printed_formula_at_its_least_angle():
    b, delta, f, w, d, gamma, c, c_a, q = precise(SOIL, LOADED)

    def force(r):
        weight = (gamma * d / 2 + q) * (mp.cot(b) + mp.cot(r)) * mp.sin(f + r)
        strength = c * mp.cos(f) / mp.sin(r) - c_a * mp.cos(b + f + r) / mp.sin(b)
        inertia = gamma / GRAVITY * 2**2 * mp.sin(b) * mp.cos(f) / mp.sin(b + r)
        return w * d / mp.sin(b + f + r + delta) * (weight + strength + inertia)

    expected = force(least(force, 0.5)) * mp.sin(b + delta) + c_a * w * d * mp.cot(b)
    assert swick_perumpral_draft(SOIL, LOADED, 2.0) == pytest.approx(float(expected), rel=1e-13)


def test_godwin_is_the_printed_formula():
    alpha, delta, phi, w, d, gamma, c, c_a, q = precise(SOIL, LOADED)
    beta = least(lambda b: printed_factors(alpha, delta, phi, b)["weight"], 0.5)
    n = printed_factors(alpha, delta, phi, beta)
    v, m = 2, mp.mpf("2.25")
    still = gamma * d**2 * n["weight"] + d * (c * n["cohesion"] + c_a * n["adhesion"] + q * n["surcharge"])
    total = still * (w + d * (m - (m - 1) / 3)) + gamma * v**2 / GRAVITY * n["inertia"] * d * (w + d * mp.mpf("0.6"))
    expected = total * mp.sin(alpha + delta) + c_a * w * d * mp.cot(alpha)
    assert godwin_draft(SOIL, LOADED, 2.0, rupture_ratio=2.25) == pytest.approx(float(expected), rel=1e-12)
    plane = godwin_draft(SOIL, LOADED, 2.0, rupture_ratio=float(mp.cot(alpha) + mp.cot(beta)))
    assert godwin_draft(SOIL, LOADED, 2.0) == pytest.approx(plane, rel=1e-12)


@pytest.mark.parametrize("draft", DRAFTS)
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbols_and_arrays_give_numbers_and_exact_derivatives(draft, kind):
    """Gradient and Hessian against central differences of order 8, whose error is 1e-16 over a step of 2e-4."""
    point = np.array([0.10, 0.25, po.deg(50.0), 15e3, po.deg(32.0), 0.4, 1.5])

    def at(width, depth, rake, cohesion, friction, tool, speed):
        soil = dataclasses.replace(SOIL, cohesion=cohesion, friction_angle=friction, tool_friction=tool)
        return draft(soil, Tine(width, depth, rake, 2e3, 3e3), speed)

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
    design = po.Design()
    rake = design.variable("rake", guess=po.deg(50.0), lower=po.deg(10.0), upper=po.deg(80.0), unit="rad")
    draft = mckyes_ali_draft(SOIL, Tine(0.08, 0.3, rake), 1.5)
    design.minimise(draft / 1e3)
    best = design.solve()
    (name,) = best.active
    assert name.startswith("McKyes and Ali: least force of a wedge")
    tine = Tine(0.08, 0.3, best.variables["rake"])
    assert mckyes_ali_draft(SOIL, tine, 1.5) == pytest.approx(best(draft), rel=1e-10)
    with pytest.raises(po.DomainError, match="end of the possible angles"):
        mckyes_ali_draft(SOIL, dataclasses.replace(tine, rake_angle=tine.rake_angle - po.deg(0.1)), 1.5)


ROUGH = {"friction_angle": po.deg(80.0), "tool_friction": 2.0}
FLUID = {"friction_angle": 0.0}
OUTSIDE = [(FLUID, 1.0, "friction angle"), ({}, -1.0, "speed"), ({}, 5.1, "speed"), (ROUGH, 1.0, "together")]


@pytest.mark.parametrize("draft", DRAFTS)
@pytest.mark.parametrize(("soil", "speed", "word"), OUTSIDE)
def test_soils_and_speeds_outside_their_domain_are_refused(draft, soil, speed, word):
    with pytest.raises(po.DomainError, match=word):
        draft(dataclasses.replace(SOIL, **soil), TINE, speed)


def test_godwin_refuses_depths_below_the_critical_one_and_short_ruptures():
    with pytest.raises(po.DomainError, match="critical depth"):
        godwin_draft(SOIL, dataclasses.replace(TINE, depth=0.37), 1.0)
    with pytest.raises(po.DomainError, match="rupture distance ratio"):
        godwin_draft(SOIL, TINE, 1.0, rupture_ratio=0.9)
