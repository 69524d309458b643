"""Inputs that are odd but legal, and odd ones that are refused in words: texts, NumPy's numbers, names, bounds."""

import contextlib
import random

import numpy as np
import pint
import pytest
from helpers.small_designs import design, sticking

import plough_opt as po
from plough_opt.design.search.effort import effort_of, searched

UNITS = pint.UnitRegistry()


def _declared(name="x", **more):
    d = po.Design()
    x = d.variable(name, **{"guess": 0.5, "lower": 0.0, "upper": 1.0, "unit": "m", **more})
    d.minimise((x - 0.25) ** 2 + 1.0)
    return d


def _texts(count, unit):
    """Return texts that look like numbers with a unit, most of them wrong."""
    rng = random.Random(4)
    pieces = ["1", "20", ".5", ".", "-", "+", "e", "e3", ",", " ", "%", "nan", "inf", "_", "\u00b2", "\u0663", "\n", ""]
    return ["".join(rng.choices(pieces, k=rng.randint(1, 4))) + rng.choice(["", " "]) + unit for _ in range(count)]


# What takes a text -> a function of it.
PLACES = {
    "search": lambda text: searched(text, _declared().declared.variables),
    "tolerance": lambda text: _declared(tolerance=text),
    "lower": lambda text: _declared(lower=text),
    "duration": lambda text: po.simulate(SCENE, text),
    "parameter": lambda text: _parameter(text),
    "catalogue": lambda text: NEAR.rounded(x=text),
    "catalogues": lambda text: NEAR.rounded(x=[text, 0.3]),
}
SCENE = po.Scene(po.named_soil("serozem"), po.Cone(0.2, 0.3), 5e4, 60.0, 1.5, po.Effects(motion=False))
NEAR = _declared().solve(search="near")


def _parameter(value, domain=(0.0, 1e4)):
    d, x = design(x=(0.5, 0.0, 1.0))
    pressure = d.parameter("pressure", 2e3, unit="Pa", domain=domain)
    d.minimise((x - pressure / 1e4) ** 2 + 1.0)
    return d.solve(search="near", parameters={"pressure": value}).variables["x"]


@pytest.mark.parametrize("place", PLACES)
def test_a_text_is_read_or_refused_in_words(place):
    for unit in ("s", "%", "mm", "kPa", ""):
        for text in _texts(8, unit):
            with contextlib.suppress(po.PloughError):  # any other error fails
                PLACES[place](text)


@pytest.mark.parametrize(
    ("search", "seconds"), [("20 s", 20.0), ("5 min", 300.0), ("1e3 ms", 1.0), ("0.5s", 0.5), (" .5 h", 1800.0)]
)
def test_a_search_takes_a_time_in_any_unit(search, seconds):
    assert searched(search, _declared().declared.variables) == (0,)
    assert effort_of(search, 1, 1, True).seconds == pytest.approx(seconds, rel=1e-15)


@pytest.mark.parametrize(
    "search", ["1.2.3 s", "-1 s", "inf s", "1 m", "8", "", "\n", 8.0, True, np.float64(8.0), 0, None]
)
def test_a_search_that_is_none_is_refused(search):
    with pytest.raises(po.InputError, match="search"):
        searched(search, _declared().declared.variables)


@pytest.mark.parametrize(
    "name", ["20 s", "5 min", "auto", "objective", "worst objective", "optimum", "position on the front", "Grösse µ"]
)
def test_a_variable_may_have_any_printable_name(name):
    best = _declared(name).solve(search=[name])
    assert best.variables == pytest.approx({name: 0.25}, abs=1e-6)
    assert best.search.variables == (name,)
    assert "optimum" in best.to_json()


@pytest.mark.parametrize("name", ["", " ", "a\nb", "worst objective\n", 3, None])
def test_other_names_are_refused(name):
    with pytest.raises(po.InputError, match="name"):
        _declared(name)


INTEGERS = [np.int64(3), np.uint8(3), np.int32(3)]


@pytest.mark.parametrize("number", INTEGERS)
def test_integers_of_numpy_are_integers(number):
    d, x = design(x=(0.3, 0.0, 1.0))
    d.minimise((x - 0.25) ** 2 + 1.0)
    plain, given = d.solve(seed=3, search=64), d.solve(seed=number, search=type(number)(64))
    assert np.array_equal(plain.search.values, given.search.values)
    assert given.search.seed == 3
    assert po.trade_off(d, x, 1.0 - x, points=type(number)(5), seed=number, search="near").points


VALUES = [
    (3e3, 0.3),
    ("3 kPa", 0.3),
    ("0.03 bar", 0.3),
    (UNITS("3 kPa"), 0.3),
    (np.float32(3000), 0.3),
    (np.int64(3000), 0.3),
]


@pytest.mark.parametrize(("value", "wanted"), VALUES)
def test_a_parameter_of_a_solve_takes_a_unit(value, wanted):
    assert _parameter(value) == pytest.approx(wanted, abs=1e-7)


@pytest.mark.parametrize("value", [2e4, "20 kPa", -1.0, "3 m", "3", True, None, float("nan"), UNITS("1 m")])
def test_a_parameter_of_a_solve_keeps_its_unit_and_its_domain(value):
    with pytest.raises(po.InputError, match="'pressure'"):
        _parameter(value)


def test_a_catalogue_takes_units():
    assert NEAR.rounded(x="200 mm").variables == NEAR.rounded(x=0.2).variables
    assert NEAR.rounded(x=["10 cm", UNITS("300 mm")]).variables == {"x": 0.3}


def test_equal_bounds_say_what_does_it():
    with pytest.raises(po.InputError, match="the number itself"):
        _declared(lower=0.5, upper=0.5)


@pytest.mark.parametrize("number", [8, 16, 64])
def test_a_number_of_designs_is_that_of_the_sample(number):
    for objective in (lambda x: x**2, lambda x: x**2 + 1e-9 * sticking(x)):
        d, x = design(x=(0.3, 0.0, 1.0))
        d.minimise(objective(x) + 1.0)
        sampled = len(d.solve(search=number).search.values)
        # The sample has a power of two, and further designs around the guess.
        assert sampled <= number + 2


def test_a_flat_variable_at_its_bound_is_named():
    d, x, _ = design(x=(0.3, 0.0, 1.0), y=(1.0, 0.0, 1.0))
    d.minimise((x - 0.25) ** 2 + 1.0)
    best = d.solve(search="near")
    assert best.status == "not unique"
    assert [{name for name, change in way.items() if change} for way in best.flat_directions] == [{"y"}]
    assert "along y" in str(best)


def test_the_variable_that_bounds_the_worst_objective_is_hidden():
    d, x = design(x=(0.3, 0.0, 1.0, "", False, 0.05))
    worst = d.variable("worst objective", guess=0.3, lower=0.0, upper=1.0)
    d.minimise((x - 0.25) ** 2 + (worst - 0.5) ** 2 + 1.0, over="worst")
    best = d.solve()
    assert best.search.variables == ("x", "worst objective")
    assert best.variables == pytest.approx({"x": 0.25, "worst objective": 0.5}, abs=1e-2)
    with pytest.raises(po.InputError, match="valid names: auto, local, near, thorough, worst objective, x"):
        d.solve(search="z")


# Objectives with a needle or without one, and the half width of the tolerance of x.
NEEDLES = [
    (lambda x: (x - 0.25) ** 2, 0.003, False),
    (lambda x: (x - 0.25) ** 2 - 1e-9, 0.003, False),
    (lambda x: 1e-6 * (x - 0.25) ** 2, 0.003, False),
    (lambda x: 1.0 + (x - 0.25) ** 2, 0.003, False),
    (lambda x: 1e6 * (x - 0.25) ** 2 / ((x - 0.25) ** 2 * 1e6 + 1.0), 0.1, True),
    (lambda x: 1e6 * (x - 0.25) ** 2 / ((x - 0.25) ** 2 * 1e6 + 1.0) - 1.0, 0.1, True),
]


@pytest.mark.parametrize(("objective", "tolerance", "needle"), NEEDLES)
def test_an_optimum_of_zero_is_a_needle_only_on_the_scale_of_its_objective(objective, tolerance, needle):
    d, x = design(x=(0.25, 0.0, 1.0, "", False, tolerance))
    d.minimise(objective(x))
    assert d.solve(search="near").spread.needle == needle
