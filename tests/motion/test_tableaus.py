"""A Butcher tableau added by name: its order, derivatives, default steps and refusals."""

import math

import casadi as ca
import pytest

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


def scene(**changes):
    share = po.Wedge(po.deg(30), po.deg(15), 0.25)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.2), damping=400.0)
    given = {"stiffness": 5e4, "mass": 25.0, "tow_speed": 2.0, "effects": effects}
    return po.Scene(po.named_soil("serozem"), share, **given | changes)


@pytest.mark.parametrize("name", OWN)
def test_error_falls_by_the_order(name):
    exact = po.simulate(scene(), 0.5, accuracy=po.Accuracy(error=1e-11)).mean_draft
    errors = [
        abs(po.simulate(scene(), 0.5, accuracy=po.Accuracy(name, steps=n), outputs=4).mean_draft - exact)
        for n in (160, 320)
    ]
    # The next term of the error changes the order by about an eighth at these steps.
    assert math.log2(errors[0] / errors[1]) == pytest.approx(OWN[name].order, abs=0.25)


@pytest.mark.parametrize("name", ["three_eighths", "rk", "collocation"])
def test_default_steps_suit_the_order_and_the_estimate_is_honest(name):
    exact = po.simulate(scene(), 0.5, accuracy=po.Accuracy(error=1e-11)).mean_draft
    run = po.simulate(scene(), 0.5, accuracy=po.Accuracy(name))
    assert abs(run.mean_draft - exact) <= run.error_estimate * exact < 1e-7 * exact


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_symbolic_run_has_the_derivatives_of_its_steps(kind):
    x = kind.sym("k")
    accuracy = po.Accuracy("three_eighths", steps=400)
    run = po.simulate(scene(stiffness=x), 0.5, accuracy=accuracy, outputs=4)
    both = ca.Function("f", [x], [run.force_rms, ca.jacobian(run.force_rms, x)])
    value, slope = map(float, both(5e4))
    # Up to rounding of a mean square of deviations.
    assert value == pytest.approx(po.simulate(scene(), 0.5, accuracy=accuracy, outputs=4).force_rms, rel=1e-10)
    difference = (float(both(5e4 * 1.0001)[0]) - float(both(5e4 * 0.9999)[0])) / 10.0
    # Central differences with relative steps of 1e-4.
    assert slope == pytest.approx(difference, rel=1e-6)


def test_events_tolerances_and_unknown_names_are_refused():
    with pytest.raises(po.InputError, match=r"'heun_3' cannot locate.* events"):
        po.simulate(scene(effects=po.Effects(contact=po.StickSlip())), 0.5, accuracy=po.Accuracy("heun_3"))
    with pytest.raises(po.InputError, match="'heun_3' has no setting 'tolerance'"):
        po.Accuracy("heun_3", tolerance=1e-9)
    with pytest.raises(po.InputError, match=r"is named 'heun_4'.*heun_3"):
        po.Accuracy("heun_4")


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
    given = {"order": 3, "nodes": HEUN.nodes, "weights": HEUN.weights, "stages": HEUN.stages}
    with pytest.raises(po.InputError, match=message):
        Tableau(**given | change)
