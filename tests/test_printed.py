"""The source's equations to the letter, and what each error of the print changes in a scene."""

import dataclasses
import itertools
import math

import casadi as ca
import numpy as np
import pytest
from helpers.printed_equations import printed_coefficients, printed_resistance

import plough_opt as po
from plough_opt.laws.printed import errors_of

CONES = [po.Cone(po.deg(half_angle), height) for half_angle, height in ((3.0, 0.4), (11.0, 0.25), (19.0, 0.1))]
NONE = {"pi_twice": False, "one_third": False, "repelling_spring": False}
FACTORS = {
    # Error of the print -> factors of F0, Fd, the added mass and the stiffness.
    "pi_twice": (math.pi, math.pi, math.pi, 1.0),
    "one_third": (1.0, 1.0, 0.5, 1.0),
    "repelling_spring": (1.0, 1.0, 1.0, -1.0),
}


def only(*errors):
    return po.Printed(**(NONE | dict.fromkeys(errors, True)))


# --- (25) and (26) to the letter ---


@pytest.mark.parametrize("soil", [po.named_soil(name) for name in po.soil_names()], ids=lambda soil: soil.name)
@pytest.mark.parametrize("cone", CONES, ids=lambda cone: f"{math.degrees(cone.half_angle):.0f} deg")
def test_the_letter_is_the_derived_equation_with_wrong_factors(cone, soil):
    letter, derived = printed_coefficients(cone, soil), po.resistance_coefficients(cone, soil)
    factors = (math.pi, math.pi, math.pi / 2)
    expected = [factor * right for factor, right in zip(factors, dataclasses.astuple(derived), strict=True)]
    assert letter == pytest.approx(expected, rel=1e-13)
    wrong = po.Printed().reaction(po.soil_reaction(cone, soil))
    for speed, acceleration in ((0.0, 0.0), (2.3, 0.0), (0.0, -7.0), (1.4, 5.0)):
        expected = wrong.static + wrong.drag * speed**2 + wrong.added_mass * acceleration
        assert printed_resistance(cone, soil, speed, acceleration) == pytest.approx(expected, rel=1e-13)


def test_the_letter_by_hand():
    # tan beta = 1/2, theta = 30 deg: mu = 1/2, nu = 2/3; b1 = 7/8: a = 8, a^(nu/2) = 2, a^(nu/2 - 1) = 1/4.
    soil = po.Soil(1600.0, 7 / 8, 9e3, math.pi / 6, 0.4, ambient_pressure=5e3)
    cone, tau0 = po.Cone(math.atan(0.5), 0.2), 2 * 9e3 * math.sqrt(3) / 2
    a = math.pi / 4 * (5e3 + tau0)
    # The bracket: (nu - 2)/nu + b1 (nu - 2) 2 - (1/4 - 1) = -2 - 7/3 + 3/4, over b1 (nu - 2) = -7/6.
    b = math.pi / 16 * (43 / 12) / (7 / 6)
    c = math.pi / 16 / (3 * 7 / 8 * 2 / 3)
    assert printed_coefficients(cone, soil) == pytest.approx((a, b, c), rel=1e-14)
    force = printed_resistance(cone, soil, 2.0, 3.0)
    inner = a + b * 1600 * 4 + 1600 * c * 0.2 * 3
    assert force == pytest.approx(math.pi * (1 + 0.4 * 2) * inner * 0.04, rel=1e-14)


# --- which errors a scene keeps ---


@pytest.mark.parametrize("count", range(4))
def test_errors_multiply(r1_scene, count):
    derived = r1_scene()
    for errors in itertools.combinations(FACTORS, count):
        scene = r1_scene(formulation=only(*errors))
        static, drag, added, spring = np.prod([[1.0] * 4, *(FACTORS[name] for name in errors)], axis=0)
        assert scene.reaction.static == pytest.approx(static * derived.reaction.static, rel=1e-15)
        assert scene.reaction.drag == pytest.approx(drag * derived.reaction.drag, rel=1e-15)
        assert scene.reaction.added_mass == pytest.approx(added * derived.reaction.added_mass, rel=1e-15)
        assert scene.restoring_stiffness == spring * 5e4
        assert scene.inertia == scene.mass + scene.reaction.added_mass
        assert scene.stiffness == derived.stiffness


def test_without_errors_nothing_is_touched(r1_scene, r1_soil):
    reaction = po.soil_reaction(CONES[1], r1_soil)
    assert only().reaction(reaction) is reaction
    assert only("repelling_spring").reaction(reaction) is reaction
    symbol = ca.MX.sym("stiffness")
    assert r1_scene(stiffness=symbol).restoring_stiffness is symbol
    assert r1_scene(formulation=only()).warnings() == r1_scene().warnings()


@pytest.mark.parametrize("errors", [("pi_twice",), ("one_third",), ("repelling_spring",), tuple(FACTORS)])
def test_a_run_says_that_it_is_no_physics(r1_scene, errors):
    scene = r1_scene(formulation=only(*errors))
    (warning,) = [text for text in scene.warnings() if "as printed" in text]
    assert "not physics" in warning
    assert "formulation = 'derived'" in warning
    words = {"pi_twice": "pi twice", "one_third": "1/3 for 2/3", "repelling_spring": "spring that repels"}
    assert {name for name, text in words.items() if text in warning} == set(errors)
    assert warning in po.simulate(scene, 0.1, outputs=4).warnings


def test_the_derived_equation_needs_no_such_warning(r1_scene):
    assert not any("printed" in text for text in po.simulate(r1_scene(), 0.1, outputs=4).warnings)


# --- refused ---


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("prnted", "did you mean 'printed'?"),
        ("derive", "did you mean 'derived'?"),
        ("x", "valid names: derived, print"),
    ],
)
def test_an_unknown_formulation_is_refused_with_the_nearest(name, hint):
    with pytest.raises(po.InputError, match=r"formulation = .* is neither a Printed\(\.\.\.\) nor") as refusal:
        po.Effects(formulation=name)
    assert f"'{name}'" in str(refusal.value)
    assert hint in str(refusal.value)


@pytest.mark.parametrize("formulation", [None, True, 1, ("printed",), {"pi_twice": True}])
def test_what_names_no_formulation_is_refused(formulation):
    with pytest.raises(po.InputError, match=r"is neither a Printed\(\.\.\.\) nor the name of one"):
        errors_of(formulation)


@pytest.mark.parametrize("value", [1, "yes", None, math.pi])
def test_a_switch_is_on_or_off(value):
    with pytest.raises(po.InputError, match=r"one_third = .* must be True or False"):
        po.Printed(one_third=value)


@pytest.mark.parametrize("formulation", ["printed", only("repelling_spring")])
def test_a_spring_that_repels_has_no_quasi_static_limit(formulation):
    with pytest.raises(po.InputError, match=r"repelling spring needs motion: .*take formulation = 'derived'"):
        po.Effects(motion=False, formulation=formulation)


def test_the_other_errors_have_a_quasi_static_limit(r1_scene):
    wrong, right = (
        po.simulate(r1_scene(motion=False, formulation=choice), 1.0) for choice in (only("pi_twice"), "derived")
    )
    assert wrong.mean_draft == pytest.approx(math.pi * right.mean_draft, rel=1e-14)
