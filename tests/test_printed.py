"""Effects of the source's printed errors on a scene."""

import itertools
import math

import numpy as np
import pytest
from helpers.refusals import refusals

import plough_opt as po

NONE = {"pi_twice": False, "one_third": False, "repelling_spring": False}
FACTORS = {
    # Printed error -> factors of F0, Fd, the added mass and the stiffness.
    "pi_twice": (math.pi, math.pi, math.pi, 1.0),
    "one_third": (1.0, 1.0, 0.5, 1.0),
    "repelling_spring": (1.0, 1.0, 1.0, -1.0),
}


def only(*errors):
    return po.Printed(**(NONE | dict.fromkeys(errors, True)))


ALL_SETS = [errors for count in range(4) for errors in itertools.combinations(FACTORS, count)]


@pytest.mark.parametrize("errors", ALL_SETS, ids="+".join)
def test_errors_multiply(r1_scene, errors):
    derived, scene = r1_scene(), r1_scene(formulation=only(*errors))
    static, drag, added, spring = np.prod([[1.0] * 4, *(FACTORS[name] for name in errors)], axis=0)
    assert scene.reaction.static == pytest.approx(static * derived.reaction.static, rel=1e-15)
    assert scene.reaction.drag == pytest.approx(drag * derived.reaction.drag, rel=1e-15)
    assert scene.reaction.added_mass == pytest.approx(added * derived.reaction.added_mass, rel=1e-15)
    assert scene.restoring_stiffness == spring * 5e4
    assert scene.inertia == scene.mass + scene.reaction.added_mass
    # The warning names the errors, and there is none without errors.
    words = {"pi_twice": "pi twice", "one_third": "1/3 for 2/3", "repelling_spring": "spring that repels"}
    text = " ".join(warning for warning in scene.warnings() if "as printed" in warning)
    assert {name for name, word in words.items() if word in text} == set(errors)
    assert not errors or "not physics" in text


REPELLING = "repelling spring needs motion: .*formulation = 'derived'"


test_invalid_formulations_are_refused = refusals(
    po.InputError,
    (lambda: po.Effects(formulation="prnted"), r"'prnted' is neither a Printed\(\.\.\.\) nor .*did you mean 'printed'"),
    (lambda: po.Effects(formulation=True), r"is neither a Printed\(\.\.\.\) nor the name of one"),
    (lambda: po.Printed(one_third=1), "one_third = .* must be True or False"),
    (lambda: po.Effects(motion=False, formulation="printed"), REPELLING),
    (lambda: po.Effects(motion=False, formulation=only("repelling_spring")), REPELLING),
)


def test_the_other_errors_have_a_quasi_static_limit(r1_scene):
    forms = only("pi_twice"), "derived"
    wrong, right = (po.simulate(r1_scene(motion=False, formulation=form), 1.0) for form in forms)
    assert wrong.mean_draft == pytest.approx(math.pi * right.mean_draft, rel=1e-14)
