import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.methods import METHODS as EVERY
from plough_opt.motion.methods import adaptive, fixed_step

FIXED_STEP, ADAPTIVE, METHODS = fixed_step(), adaptive(), tuple(EVERY)


def test_default_is_automatic():
    assert po.Accuracy() == po.Accuracy("auto", error=None, steps=None, tolerance=None)


# Setting -> a valid value, and the methods that have it.
SETTINGS = {
    "error": (1e-6, ("auto",)),
    "derivatives": (1e-4, ("auto",)),
    "steps": (100, FIXED_STEP),
    "tolerance": (1e-9, ADAPTIVE),
}


@pytest.mark.parametrize("method", METHODS)
def test_each_method_has_its_own_settings_only(method):
    for name, (value, methods) in SETTINGS.items():
        if method in methods:
            assert getattr(po.Accuracy(method, **{name: value}), name) == value
        else:
            with pytest.raises(po.InputError, match=f"method '{method}' has no setting '{name}'"):
                po.Accuracy(method, **{name: value})


@pytest.mark.parametrize(
    ("name", "meant"), [("dop583", "dop853"), ("cvode", "cvodes"), ("rosenbrok", "rosenbrock"), ("Auto", "auto")]
)
def test_the_nearest_method_is_suggested(name, meant):
    with pytest.raises(po.InputError, match=f"no integration method is named '{name}': did you mean '{meant}'"):
        po.Accuracy(name)


def test_all_methods_are_listed_if_none_is_similar():
    with pytest.raises(po.InputError) as caught:
        po.Accuracy("euler-maruyama")
    assert all(method in str(caught.value) for method in METHODS)


@pytest.mark.parametrize(
    ("method", "name", "values"),
    [
        ("auto", "error", [0.0, 1e-13, 0.5, float("nan"), "1e-6", ca.DM(1e-6)]),
        ("auto", "derivatives", [0.0, 1e-11, 0.2, "fine", True]),
        ("dop853", "steps", [0]),
        ("rk", "steps", [-3, [3], 2.5, True]),
        ("collocation", "steps", [10**8]),
        ("cvodes", "tolerance", [0.0]),
        ("erk", "tolerance", [1e-15, [1e-8], np.array([1e-8, 1e-9])]),
        ("idas", "tolerance", [1.0]),
    ],
)
def test_a_setting_is_a_number_within_its_range_and_steps_are_whole(method, name, values):
    for value in values:
        with pytest.raises(po.InputError, match=f"accuracy {name} = .* must lie between"):
            po.Accuracy(method, **{name: value})
