"""A result is a value: nothing that happens later, to its design or to other results, changes a bit of it."""

import copy
import dataclasses
import pickle

import pytest
from helpers.small_designs import design
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import plough_opt as po


def _spring():
    """Return a design of a share on a spring under a strength wave, and its run."""
    d, k0, height = design(stiffness=(7e4, 2e4, 2e5, "N/m", True), height=(0.25, 0.2, 0.35, "m"))
    speed, soil = d.parameter("tow speed", 1.5, unit="m/s"), po.named_soil("serozem")
    share = po.Cone(0.2, height)
    scene = po.Scene(soil, share, k0, 60.0, speed, po.Effects(strength_wave=po.StrengthWave(0.3, 0.4)))
    run = po.simulate(scene, 0.3, outputs=1)
    d.minimise(run.force_rms / 1e3 + run.mean_draft / 1e4 + k0 / 4e5)
    d.require("radius", po.loosened_radius(share, soil), at_least=0.1, unit="m")
    return d, run


def _asked(best, run):
    """Return all that an optimum says, also by computing again."""
    rounded = best.rounded(stiffness=[4e4, 6e4, 1e5])
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
    {"search": 16, "seed": 3},
    {"search": 16, "seed": 4, "judge": "bare"},
    {"search": "stiffness", "parameters": {"tow speed": 1.0}},
]
# What may happen between two questions, by a name: to the design, and to the results at hand.
EVENTS = {
    **{f"solve {k}": lambda d, results, k=k: results.append((k, d.solve(**QUESTIONS[k]))) for k in range(5)},
    "round": lambda _, results: results[0][1].rounded(stiffness=[5e4, 9e4], height=[0.23, 0.25]),
    "sensitivity": lambda _, results: results[-1][1].every_sensitivity(),
    "print": lambda _, results: print(results[0][1]),
    "declare": lambda d, _: d.parameter(f"p{len(d._parameters)}", 1.0),
    "front": lambda d, _: po.trade_off(
        d, d._variables[0].symbol, 1.0 / d._variables[0].symbol, points=5, search="near"
    ),
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


# The seed is fixed; each example takes about two seconds.
@settings(max_examples=2, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(st.integers(0, len(QUESTIONS) - 1), st.lists(st.sampled_from(sorted(EVENTS)), min_size=2, max_size=5))
def test_an_optimum_says_the_same_whatever_happens_later(alone, first, events):
    d, run = _spring()
    results = [(first, d.solve(**QUESTIONS[first]))]
    before = str(results[0][1]), results[0][1].to_json()
    for event in events:
        EVENTS[event](d, results)
    for number, best in results:
        assert _without_time(_asked(copy.deepcopy(best), run)) == alone[number]
    assert (str(results[0][1]), results[0][1].to_json()) == before


def test_a_copy_keeps_the_design_and_a_pickle_leaves_it_out():
    d, run = _spring()
    best = d.solve(search="near")
    for one in (copy.copy(best), copy.deepcopy(best)):
        assert one == best
        assert one(run.mean_draft) == best(run.mean_draft)
        assert str(one.rounded(height=[0.23])) == str(best.rounded(height=[0.23]))
    again = pickle.loads(pickle.dumps(best))
    assert again == best
    for refused in (
        lambda: again(run.mean_draft),
        lambda: again.rounded(height=[0.23]),
        lambda: again.sensitivity("x"),
    ):
        with pytest.raises(po.InputError, match="saved without its design"):
            refused()


def _results():
    """Return results of every kind that a design or a run gives."""
    d, run = _spring()
    best = d.solve(search=16)
    front = po.trade_off(d, run.mean_draft / 1e3, run.force_rms / 1e3, points=5, search="near")
    still = po.simulate(best(run.scene), 0.1, outputs=2)
    return [
        best,
        best.local_optima[0],
        best.rounded(height=[0.23]),
        best.search,
        front,
        still,
        po.Machine({"a": still}),
    ]


def test_results_are_equal_if_their_numbers_are(tmp_path):
    first = _results()
    for number, one in enumerate(first):
        assert one == copy.deepcopy(one) == pickle.loads(pickle.dumps(one))
        assert hash(one) == hash(copy.deepcopy(one))
        assert [one == other for other in first] == [k == number for k in range(len(first))]
        assert one != "a text"
        if hasattr(one, "save"):
            assert po.load(one.save(tmp_path / f"{number}.json")) == one
    best, other = first[0], first[2]
    assert dataclasses.replace(best, objective=best.objective * (1.0 + 1e-15)) != best
    assert best.search != dataclasses.replace(best.search, values=best.search.values + 1e-12)
    assert best.search == dataclasses.replace(best.search, values=best.search.values.copy())
    assert other.search is None
