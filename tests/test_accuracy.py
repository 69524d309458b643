import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.methods import METHODS as EVERY
from plough_opt.motion.methods import adaptive, fixed_step

FIXED_STEP, ADAPTIVE, METHODS = fixed_step(), adaptive(), tuple(EVERY)


def test_default_is_automatic():
    assert po.Accuracy() == po.Accuracy("auto", error=None, steps=None, tolerance=None)


@pytest.mark.parametrize(
    ("method", "setting"),
    [
        ("auto", {"error": 1e-6}),
        *((method, {"steps": 100}) for method in FIXED_STEP),
        *((method, {"tolerance": 1e-9}) for method in ADAPTIVE),
    ],
)
def test_each_method_takes_its_own_setting(method, setting):
    accuracy = po.Accuracy(method, **setting)
    assert {name: getattr(accuracy, name) for name in setting} == setting


@pytest.mark.parametrize(
    ("method", "setting"),
    [
        *((method, {"error": 1e-6}) for method in METHODS if method != "auto"),
        *((method, {"steps": 100}) for method in METHODS if method not in FIXED_STEP),
        *((method, {"tolerance": 1e-9}) for method in METHODS if method not in ADAPTIVE),
    ],
)
def test_a_setting_of_another_method_is_refused(method, setting):
    (name,) = setting
    with pytest.raises(po.InputError, match=f"method '{method}' has no setting '{name}': it belongs to"):
        po.Accuracy(method, **setting)


@pytest.mark.parametrize(
    ("name", "meant"), [("dop583", "dop853"), ("cvode", "cvodes"), ("rosenbrok", "rosenbrock"), ("Auto", "auto")]
)
def test_the_nearest_method_is_suggested(name, meant):
    with pytest.raises(po.InputError, match=f"no integration method is named '{name}': did you mean '{meant}'"):
        po.Accuracy(name)


def test_all_methods_are_listed_where_none_is_near():
    with pytest.raises(po.InputError) as caught:
        po.Accuracy("euler-maruyama")
    assert all(method in str(caught.value) for method in METHODS)


@pytest.mark.parametrize(
    ("method", "setting"),
    [
        ("auto", {"error": 0.0}),
        ("auto", {"error": 1e-13}),
        ("auto", {"error": 0.5}),
        ("auto", {"error": float("nan")}),
        ("dop853", {"steps": 0}),
        ("rk", {"steps": -3}),
        ("collocation", {"steps": 10**8}),
        ("cvodes", {"tolerance": 0.0}),
        ("erk", {"tolerance": 1e-15}),
        ("idas", {"tolerance": 1.0}),
    ],
)
def test_a_setting_out_of_range_is_refused(method, setting):
    (name,) = setting
    with pytest.raises(po.InputError, match=f"accuracy {name} = .* must lie between"):
        po.Accuracy(method, **setting)


@pytest.mark.parametrize(
    ("method", "setting"),
    [
        ("auto", {"error": "1e-6"}),
        ("auto", {"error": ca.DM(1e-6)}),
        ("erk", {"tolerance": [1e-8]}),
        ("erk", {"tolerance": np.array([1e-8, 1e-9])}),
        ("rk", {"steps": [3]}),
        ("rk", {"steps": 2.5}),
        ("rk", {"steps": True}),
    ],
)
def test_a_setting_is_a_number_and_steps_are_whole(method, setting):
    (name,) = setting
    with pytest.raises(po.InputError, match=f"accuracy {name} = .* must lie between"):
        po.Accuracy(method, **setting)
