"""The [measures] table: results of a file's own, against the same arithmetic by hand."""

import math
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.commands import printed
from helpers.problem_files import COTTON, changed

import plough_opt as po
from plough_opt.problem_file.measures import measures_of

RIGHT = {
    "power_per_width": ("tow_power / (2 * loosened_radius)", "kW/m"),
    "slender": ("share.height * sqrt(loosened_radius**-2)", ""),
    "uneven": ("force_rms / mean_draft + exp(-force_rms / mean_draft)", ""),
    "draft_per_depth": ("maximum(mean_draft, 2 * force_rms) / share.height", "N/cm"),
    "excess": ("mean_draft / (mean_draft - force_rms)", ""),
    "spare": ("0.2e0 * mean_draft - -1 * force_rms**1", "kN"),
    "pushed": ("maximum(0, 0 + mean_draft - 0.0)", "kN"),
}


def written(measures, text=COTTON):
    """Return a problem file with a table of own results."""
    rows = [f'{name} = {{ value = "{value}", unit = "{unit}" }}' for name, (value, unit) in measures.items()]
    return "\n".join([text, "[measures]", *rows, ""])


def by_hand(run):
    """Return the values of `RIGHT` in their units, by Python's own arithmetic."""
    radius, height = run.scene.loosened_radius, run.scene.share.height
    uneven = run.force_rms / run.mean_draft
    return {
        "power_per_width": run.tow_power / (2.0 * radius) / 1e3,
        "slender": height / radius,
        "uneven": uneven + math.exp(-uneven),
        "draft_per_depth": max(run.mean_draft, 2.0 * run.force_rms) / height / 100.0,
        "excess": run.mean_draft / (run.mean_draft - run.force_rms),
        "spare": (0.2 * run.mean_draft + run.force_rms) / 1e3,
        "pushed": run.mean_draft / 1e3,
    }


def test_values_are_those_of_the_arithmetic(read):
    problem = read(written(RIGHT))
    run = problem.simulate()
    for name, value in by_hand(run).items():
        shown = float(measures_of(problem.table)[name].of(run)) / problem.displays[name].factor
        assert shown == pytest.approx(value, rel=1e-14), name  # a few roundings
        assert problem.displays[name].symbol == RIGHT[name][1]


def test_one_is_minimised_and_another_required(read):
    text = changed(
        ('mean_draft = { per = "1 kN" }', 'power_per_width = { per = "1 kW/m" }'),
        ("[require]", '[require]\ndraft_per_depth = { at_most = "150 N/cm" }'),
    )
    best, run = read(written(RIGHT, text), "scene.duration=0.5 s").optimise(search="near")
    expected = by_hand(run)
    # The design integrates its own run: both are right to 1e-8.
    assert best.objective == pytest.approx(expected["power_per_width"] + run.force_rms / 1e3, rel=1e-7)
    # Margins are SI: N/m.
    assert best.margins["draft_per_depth"] == pytest.approx(100.0 * (150.0 - expected["draft_per_depth"]), abs=1e-3)


def test_it_stands_in_the_response_and_in_a_sweep(read):
    problem = read(written(RIGHT))
    assert "power per width" in printed("simulate", problem.name)
    with ThreadPoolExecutor(1) as inline, po.sweep(problem, {"share.height": [0.2, 0.3]}, executor=inline) as swept:
        assert {*RIGHT} <= {*swept.results}


def test_brackets_alone_nest_nothing(read):
    assert read(written({"mine": ("(" * 90 + "force_rms" + ")" * 90, "N")}))


@pytest.mark.parametrize("value", ["1 / 0", "exp(2000)", "(0 - 8)**0.5", "sqrt(0 - 1)", "log(force_rms/force_rms - 1)"])
def test_what_has_no_finite_value_is_refused_when_it_is_computed(read, value):
    problem = read(written({"mine": (value, "")}), "scene.duration=0.1 s")
    with pytest.raises(po.InputError, match="has no finite value in this run"):
        measures_of(problem.table)["mine"].of(problem.simulate())


@pytest.mark.parametrize(
    ("name", "value", "unit", "words"),
    [
        ("mean_draft", "force_rms", "N", "another"),
        ("2nd", "force_rms", "N", "cannot be a name: use letters, digits and _"),
        ("mine", "force_rsm", "N", "force_rms"),
        ("mine", "deflection", "m", "mean_deflection"),
        ("mine", "force_rms + tow_power", "N", "unlike"),
        ("mine", "force_rms / mean_draft", "N", "has the unit 'N', but its expression has no unit"),
        ("mine", "force_rms", "florin", "florin"),
        ("mine", "force_rms +", "N", "expression"),
        ("mine", "force_rms ** tow_power", "N", "power"),
        ("mine", "force_rms ** 99", "N", "99"),
        ("mine", "exp(0) + force_rms", "N", "unlike"),
        ("mine", "0x1" + 256 * "0" + " * force_rms", "N", "too large"),
        ("mine", "__import__('os')", "", "cannot be computed"),
        ("mine", "sqrt(force_rms, 2)", "N", "arguments"),
        ("mine", "-" * 60 + "force_rms", "N", "deep"),
        ("mine", "force_rms" + " + force_rms" * 40, "N", "characters"),
    ],
)
def test_wrong_ones_are_refused_with_their_line(blames, name, value, unit, words):
    blames(written({name: (value, unit)}), f"{name} = {{ value", words)
