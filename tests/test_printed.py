"""Effects of the source's printed errors on a scene."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.laws.printed import errors_of

CONES = [po.Cone(po.deg(half_angle), height) for half_angle, height in ((3.0, 0.4), (11.0, 0.25), (19.0, 0.1))]
NONE = {"pi_twice": False, "one_third": False, "repelling_spring": False}
FACTORS = {
    # Printed error -> factors of F0, Fd, the added mass and the stiffness.
    "pi_twice": (math.pi, math.pi, math.pi, 1.0),
    "one_third": (1.0, 1.0, 0.5, 1.0),
    "repelling_spring": (1.0, 1.0, 1.0, -1.0),
}


def only(*errors):
    return po.Printed(**(NONE | dict.fromkeys(errors, True)))


# --- selected errors ---


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


def test_without_printed_errors_nothing_changes(r1_scene, r1_soil):
    reaction = po.soil_reaction(CONES[1], r1_soil)
    assert only().reaction(reaction) is reaction
    assert only("repelling_spring").reaction(reaction) is reaction
    symbol = ca.MX.sym("stiffness")
    assert r1_scene(stiffness=symbol).restoring_stiffness is symbol
    assert r1_scene(formulation=only()).warnings() == r1_scene().warnings()


@pytest.mark.parametrize("errors", [("pi_twice",), ("one_third",), ("repelling_spring",), tuple(FACTORS)])
def test_runs_warn_that_printed_equations_are_not_physics(r1_scene, errors):
    scene = r1_scene(formulation=only(*errors))
    (warning,) = [text for text in scene.warnings() if "as printed" in text]
    assert "not physics" in warning
    assert "formulation = 'derived'" in warning
    words = {"pi_twice": "pi twice", "one_third": "1/3 for 2/3", "repelling_spring": "spring that repels"}
    assert {name for name, text in words.items() if text in warning} == set(errors)
    assert warning in po.simulate(scene, 0.1, outputs=4).warnings


# --- invalid formulations ---


@pytest.mark.parametrize(
    ("build", "words"),
    [
        *[(lambda name=name: po.Effects(formulation=name), rf"'{name}' is neither a Printed\(\.\.\.\) nor.*{hint}")
          for name, hint in (("prnted", "did you mean 'printed'"), ("x", "valid names: derived, print"))],
        *[(lambda kind=kind: errors_of(kind), r"is neither a Printed\(\.\.\.\) nor the name of one")
          for kind in (None, True, ("printed",), {"pi_twice": True})],
        *[(lambda value=value: po.Printed(one_third=value), r"one_third = .* must be True or False")
          for value in (1, "yes", None)],
        *[(lambda kind=kind: po.Effects(motion=False, formulation=kind),
           "repelling spring needs motion: .*formulation = 'derived'")
          for kind in ("printed", only("repelling_spring"))],
    ],
)  # fmt: skip
def test_invalid_formulations_are_refused(build, words):
    with pytest.raises(po.InputError, match=words):
        build()


def test_the_other_errors_have_a_quasi_static_limit(r1_scene):
    wrong, right = (
        po.simulate(r1_scene(motion=False, formulation=choice), 1.0) for choice in (only("pi_twice"), "derived")
    )
    assert wrong.mean_draft == pytest.approx(math.pi * right.mean_draft, rel=1e-14)
