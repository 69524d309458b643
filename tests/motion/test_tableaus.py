"""A Butcher tableau added by name: its order, derivatives, default steps, and refusals."""

import math
from dataclasses import replace

import casadi as ca
import pytest
from helpers.differences import order_4
from helpers.scenes import scene_of

import plough_opt as po
from plough_opt.motion.methods import METHODS, Tableau

THREE_EIGHTHS = Tableau(
    4, nodes=(0.0, 1 / 3, 2 / 3, 1.0), weights=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
    stages=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)),
)  # fmt: skip
HEUN = Tableau(3, nodes=(0.0, 1 / 3, 2 / 3), weights=(0.25, 0.0, 0.75), stages=((), (1 / 3,), (0.0, 2 / 3)))
OWN = {"three_eighths": THREE_EIGHTHS, "heun_3": HEUN}


@pytest.fixture(autouse=True)
def _added(monkeypatch):
    for name, tableau in OWN.items():
        monkeypatch.setitem(METHODS, name, tableau)


def simulated(accuracy, **changes):
    effects = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0}
    return po.simulate(scene_of(mass=25.0, **effects | changes), 0.5, accuracy=accuracy, outputs=4)


@pytest.mark.parametrize("name", OWN)
def test_error_falls_by_the_order(name):
    exact = simulated(po.Accuracy(error=1e-11)).mean_draft
    errors = [abs(simulated(po.Accuracy(name, steps=n)).mean_draft - exact) for n in (160, 320)]
    # The next term of the error changes the order by about an eighth at these steps.
    assert math.log2(errors[0] / errors[1]) == pytest.approx(OWN[name].order, abs=0.25)


@pytest.mark.parametrize("name", ["three_eighths", "rk", "collocation"])
def test_default_steps_suit_the_order_and_the_estimate_is_honest(name):
    exact, run = simulated(po.Accuracy(error=1e-11)).mean_draft, simulated(po.Accuracy(name))
    assert abs(run.mean_draft - exact) <= run.error_estimate * exact < 1e-7 * exact


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbolic_run_has_the_derivatives_of_its_steps(kind):
    x = kind.sym("k")
    accuracy = po.Accuracy("three_eighths", steps=400)
    run = simulated(accuracy, stiffness=x)
    both = ca.Function("f", [x], [run.force_rms, ca.jacobian(run.force_rms, x)])
    value, slope = map(float, both(5e4))
    # Up to rounding of a mean square of deviations.
    assert value == pytest.approx(simulated(accuracy).force_rms, rel=1e-10)
    assert slope == pytest.approx(order_4(lambda k: float(both(k)[0]), 5e4, 5.0), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": (0.25, 0.75)}, "must be explicit"),
        ({"stages": ((), (1 / 3,), (0.0, 2 / 3, 0.0))}, "must be explicit"),
        ({"order": 0}, "must be explicit"),
        ({"weights": (0.5, 0.0, 0.5)}, r"integrate t\^1 with an error of -1.7e-01"),
        ({"stages": ((), (1 / 3,), (0.1, 2 / 3))}, "row .* adds up to .* node 0.66"),
    ],
)
def test_invalid_tableaus_are_refused(change, message):
    with pytest.raises(po.InputError, match=message):
        replace(HEUN, **change)
