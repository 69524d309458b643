"""A file's cone index is measured: whatever else varies or is uncertain, the soil keeps it."""

import numpy as np
import pytest
from helpers.problem_files import STATIC, changed

import plough_opt as po
from plough_opt.problem_file.uncertain import optimise_robust

NAME = 'name = "serozem"\n'
WIDE = '"0.15 m" }\ncone_index = { at_least = "1 MPa" }'
TEXT = changed((NAME, f'{NAME}cone_index = "1.5 MPa"\n'), ('"0.12 m" }', WIDE), text=STATIC)
UNCERTAIN = """\
[uncertain]
samples = 8
fresh = 100
"soil.cohesion" = { distribution = "lognormal", mean = "20 kPa", std = "6 kPa" }
"soil.density_ratio" = { distribution = "beta", mean = 0.794, std = 0.02, lower = 0.70, upper = 0.88 }
"""


def adjusting(name):
    return TEXT.replace('"1.5 MPa"', f'"1.5 MPa"\nadjust = "{name}"')


def test_samples_of_other_properties_keep_it(read):
    found = optimise_robust(read(TEXT + UNCERTAIN), lambda *_: None)
    values = found.robust.values(found.best.variables)
    # The strength factor follows in every sample: solved in closed form, to all digits but the last.
    assert values["cone_index"] == pytest.approx(np.full(8, 1.5e6), rel=1e-12)
    assert np.std(values["loosened_radius"]) > 1e-3


@pytest.mark.parametrize(("adjust", "name"), [("strength factor", "cohesion"), ("cohesion", "density_ratio")])
def test_changes_of_other_properties_keep_it(read, adjust, name):
    problem = read(adjusting(adjust))
    usual = getattr(po.named_soil("serozem"), name)
    for factor in (0.8, 1.1):
        soil = problem.scene({f"soil.{name}": factor * usual}).soil
        assert getattr(soil, name) == factor * usual
        assert po.cone_index(soil) == pytest.approx(1.5e6, rel=1e-12)
    # A change of the property that the reading decides takes the place of the reading.
    decided = adjust.replace(" ", "_")
    assert getattr(problem.scene({f"soil.{decided}": 2.0}).soil, decided) == 2.0


def test_of_a_least_value_the_smallest_samples_are_the_worst(read):
    text = TEXT.replace('at_least = "0.15 m"', 'at_least = "0.15 m", measure = "worst", width = "1 mm"')
    found = optimise_robust(read(text.replace("cone_index =", "# ") + UNCERTAIN), lambda *_: None)
    assert {check.result: check.text for check in found.fresh.checks}["loosened_radius"] == "smallest of the samples"


def test_draft_owes_nothing_to_a_cohesion_beneath_it(read):
    """Static draft follows from the cone index alone: its slope by cohesion is 0, by the reading draft over reading."""
    best, run = read(TEXT).optimise(parameters=True, search="near")
    reading = best.sensitivity("soil.cone_index")
    assert reading.objective == pytest.approx(run.scene.reaction.static / 1e3 / 1.5e6, rel=1e-6)
    assert abs(best.sensitivity("soil.cohesion").objective * 2e4) < 1e-6 * best.objective


COHESION = '"soil.cohesion" = { distribution = "uniform", lower = "1 kPa", upper = "9 kPa" }'
FACTOR = '"soil.strength_factor" = { distribution = "uniform", lower = 1.0, upper = 2.0 }'
READING = '"soil.cone_index" = { distribution = "uniform", lower = "1 MPa", upper = "2 MPa" }'


@pytest.mark.parametrize(
    ("adjust", "entries", "words"),
    [
        ("cohesion", COHESION, "'soil.cohesion' follows from the cone index in every sample: make soil.cone_index"),
        ("strength factor", FACTOR, "'soil.strength_factor' follows from the cone index"),
        ("cohesion", READING, 'only with adjust = "strength factor"'),
        ("strength factor", f"{COHESION}\n{READING}", "cannot both be uncertain"),
    ],
)
def test_what_the_reading_decides_is_not_uncertain_by_itself(refusal, adjust, entries, words):
    said = refusal(adjusting(adjust) + f"[uncertain]\n{entries}\n")
    assert words in said
    assert ", line " in said
