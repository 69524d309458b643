"""A result is a value: nothing that happens later, to its design or to other results, changes a bit of it."""

import copy
import pickle

import pytest
from helpers.small_designs import design
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import plough_opt as po


def _spring():
    """Return a design of a moving share with a parameter, a requirement and several basins."""
    d, k0, mass = design(stiffness=(6e4, 2e4, 2e5, "N/m", True), mass=(60.0, 20.0, 120.0, "kg"))
    speed = d.parameter("tow speed", 1.5, unit="m/s")
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.4), damping=300.0)
    scene = po.Scene(po.named_soil("serozem"), po.Cone(0.2, 0.3), k0, mass, speed, effects)
    run = po.simulate(scene, 0.5, outputs=5)
    d.minimise(run.force_rms / 1e3 + mass / 400.0)
    d.require("deflection", run.mean_deflection, at_most=0.05, unit="m")
    return d, run


def _asked(best, run):
    """Return all that an optimum says, also by computing again."""
    rounded = best.rounded(mass=[40.0, 60.0, 80.0])
    return {
        "text": str(best),
        "deflection": best(run.mean_deflection),
        "sensitivity": best.sensitivity("tow speed", check=True),
        "every": best.every_sensitivity(),
        "rounded": (str(rounded), rounded.variables, rounded.tried, rounded.spread),
        "margins": best.margins,
        "spread": best.spread,
        "json": best.to_json(),
    }


QUESTIONS = [
    {"search": "near"},
    {"search": "near", "parameters": {"tow speed": 2.0}},
    {"search": 64, "seed": 3},
    {"search": 64, "seed": 4, "judge": "bare"},
    {"search": "stiffness", "parameters": {"tow speed": 1.0}},
]
# What may happen between two questions, by a name: to the design, and to the results at hand.
EVENTS = {
    **{f"solve {k}": lambda d, results, k=k: results.append((k, d.solve(**QUESTIONS[k]))) for k in range(5)},
    "round": lambda _, results: results[0][1].rounded(stiffness=[5e4, 6e4], mass=[50.0, 70.0]),
    "sensitivity": lambda _, results: results[-1][1].every_sensitivity(),
    "print": lambda _, results: print(results[0][1]),
    "declare": lambda d, results: d.parameter(f"p{len(d._parameters)}", 1.0),
    "compiled": lambda d, _: d.solve(search="near", compiled=True),
    "front": lambda d, _: po.trade_off(d, d._variables[0].symbol, 1.0 / d._variables[0].symbol, points=5),
}


@pytest.fixture(scope="module")
def alone():
    """For each question what its optimum says if nothing else was ever asked of the design."""
    answers = {}
    for number, question in enumerate(QUESTIONS):
        d, run = _spring()
        answers[number] = _without_time(_asked(d.solve(**question), run))
    return answers


def _without_time(asked):
    """Return answers without the texts that hold the seconds or the date of a solve."""
    return {key: own for key, own in asked.items() if key not in ("text", "json")}


# A fixed seed, as everywhere in these tests; each example takes about a second.
@settings(max_examples=6, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.integers(0, len(QUESTIONS) - 1), st.lists(st.sampled_from(sorted(EVENTS)), min_size=2, max_size=5))
def test_an_optimum_says_the_same_whatever_happens_later(alone, first, events):
    d, run = _spring()
    results = [(first, d.solve(**QUESTIONS[first]))]
    before = str(results[0][1]), results[0][1].to_json()
    for event in events:
        EVENTS[event](d, results)
    for number, best in results:
        for one in (best, copy.deepcopy(best), copy.copy(best)):
            assert _without_time(_asked(one, run)) == alone[number]
    assert (str(results[0][1]), results[0][1].to_json()) == before
