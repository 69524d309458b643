"""Derivatives of the periodic orbit and its approximations, against differences of order 8."""

import casadi as ca
import numpy as np
import pytest

import plough_opt as po

CHOICES = ["periodic", "linearised", po.HarmonicBalance(3)]
# Stiffness, mass, tow speed, wavelength, amplitude and damping.
PLACES = {
    "between": (3e4, 25.0, 2.0, 0.6, 0.5, 300.0),
    "soft": (4e3, 25.0, 2.0, 0.6, 0.3, 150.0),
    "stiff, strongest": (1.5e5, 25.0, 1.5, 0.4, 0.97, 1e3),
    "beside resonance": (1.3e4, 25.0, 2.0, 0.6, 0.3, 250.0),
}
# The others are slow, and of the same kind.
FEW = [pytest.param(name, marks=() if name == "stiff, strongest" else pytest.mark.slow) for name in PLACES]
OUTPUTS = 48


@pytest.fixture(scope="module")
def scene_of(r1_soil):
    def build(values, choice):
        stiffness, mass, speed, wavelength, amplitude, damping = values
        share = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
        wave = po.StrengthWave(amplitude, wavelength)
        return po.Scene(
            r1_soil,
            share,
            stiffness,
            mass,
            speed,
            po.Effects(strength_wave=wave, damping=damping, orbit=choice),
        )

    return build


def results(run):
    return [
        run.mean_draft,
        run.force_rms,
        run.mean_deflection,
        run.displacement_rms,
        run.tow_power,
        run.deflection[OUTPUTS // 3],
        run.mount_force[OUTPUTS // 2],
        run.soil_resistance[7],
        run.speed[OUTPUTS // 4],
        run.duration,
    ]


@pytest.fixture(scope="module")
def functions(scene_of):
    """Return the Functions of values and Jacobian, and of the Hessian of a weighted sum, for a kind of orbit."""
    known = {}

    def functions(choice):
        if choice not in known:
            x, weights = ca.MX.sym("x", 6), ca.MX.sym("weights", 10)
            run = po.simulate(scene_of(ca.vertsplit(x), choice), outputs=OUTPUTS)
            found = ca.vertcat(*results(run))
            known[choice] = (
                ca.Function("first", [x], [found, ca.jacobian(found, x)]),
                ca.Function("second", [x, weights], [ca.hessian(ca.dot(weights, found), x)[0]]),
            )
        return known[choice]

    return functions


def difference(function, at, step):
    """Return the change along a step, to first order, by central differences of order 8."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (function(at + k * step) - function(at - k * step)) for k, w in enumerate(weights, 1))


@pytest.mark.parametrize("place", FEW)
@pytest.mark.parametrize("choice", CHOICES)
def test_gradients_and_hessians_are_those_of_differences(functions, scene_of, choice, place):
    first, second = functions(choice)
    at = np.array(PLACES[place])
    value, slopes = (np.asarray(result) for result in first(at))
    value = value.ravel()
    run = po.simulate(scene_of(PLACES[place], choice), outputs=OUTPUTS)
    assert value == pytest.approx([float(one) for one in results(run)], rel=1e-9)
    weights = np.cos(np.arange(10)) / np.abs(value)  # so that no result hides behind a larger one
    bends = np.asarray(second(at, weights)) * np.outer(at, at)
    assert bends == pytest.approx(bends.T, rel=1e-9, abs=1e-9)

    def both(x):
        values, gradients = (np.asarray(result) for result in first(x))
        return np.concatenate([values.ravel(), weights @ gradients])

    # Along two directions in which all quantities change.
    for along in np.array([[1.0, -0.8, 0.6, 0.9, -0.7, 0.5], [-0.6, 0.7, 1.0, -0.5, 0.8, 0.9]]):
        slope, row = np.split(difference(both, at, 2e-3 * at * along) / 2e-3, [10])
        # Errors of 1e-14 over steps of 2e-3, and the truncation of order 8 near the resonance.
        assert slopes @ (at * along) == pytest.approx(slope, rel=0, abs=3e-9 * np.max(np.abs(value)))
        assert bends @ along == pytest.approx(row * at, rel=0, abs=1e-8 * np.max(np.abs(bends)))


@pytest.mark.parametrize("choice", CHOICES)
def test_derivatives_are_finite_and_right_without_amplitude(functions, choice):
    first, second = functions(choice)
    at, some = np.array([3e4, 25.0, 2.0, 0.6, 0.0, 300.0]), np.array([3e4, 25.0, 2.0, 0.6, 1e-4, 300.0])
    value, slopes = (np.asarray(result) for result in first(at))
    assert np.all(np.isfinite(value))
    assert np.all(np.isfinite(slopes))
    assert np.all(np.isfinite(np.asarray(second(at, np.ones(10)))))
    change = (np.asarray(first(some)[0]) - value) / 1e-4
    # The deflection changes in proportion to the amplitude, with a correction of first order in it ...
    assert slopes[5, 4] == pytest.approx(change[5, 0], rel=1e-3)
    # ... and the mean draft by its square.
    assert slopes[0, 4] == pytest.approx(0.0, abs=1e-9 * value[0, 0])
    # Derivatives by other quantities are those of steady sliding, on which c has no effect.
    deflection = value[2, 0]
    assert slopes[2, 0] == pytest.approx(-deflection / 3e4, rel=1e-9)
    assert slopes[2, [1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-12 * deflection)


@pytest.mark.parametrize("choice", CHOICES)
def test_sx_symbols_are_refused(r1_scene, choice):
    scene = r1_scene(stiffness=ca.SX.sym("stiffness"), strength_wave=po.StrengthWave(0.3, 0.6), orbit=choice)
    with pytest.raises(po.InputError, match=r"an orbit takes MX symbols only.*use casadi\.MX"):
        po.simulate(scene)
