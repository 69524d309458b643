"""Derivatives of the lasting orbit and of its stand-ins, against differences of order eight."""

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
# The others are of one kind with these, and slow.
FEW = [pytest.param(name, marks=() if name == "stiff, strongest" else pytest.mark.slow) for name in PLACES]
OUTPUTS = 48


@pytest.fixture(scope="module")
def scene_of(r1_soil):
    def build(values, choice, **effects):
        stiffness, mass, speed, wavelength, amplitude, damping = values
        share = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
        wave = po.StrengthWave(amplitude, wavelength)
        return po.Scene(
            r1_soil,
            share,
            stiffness,
            mass,
            speed,
            po.Effects(strength_wave=wave, damping=damping, orbit=choice, **effects),
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
    """Return, once for each form of the orbit, values and Jacobian, and the Hessian of a weighted sum."""
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
    """Return the derivative along a step, over it, by central differences of order eight."""
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
    weights = np.cos(np.arange(10)) / np.abs(value)  # all results at once, none hidden behind a larger one
    bends = np.asarray(second(at, weights)) * np.outer(at, at)
    assert bends == pytest.approx(bends.T, rel=1e-9, abs=1e-9)

    def both(x):
        values, gradients = (np.asarray(result) for result in first(x))
        return np.concatenate([values.ravel(), weights @ gradients])

    # Along two directions, in which every number counts.
    for along in np.array([[1.0, -0.8, 0.6, 0.9, -0.7, 0.5], [-0.6, 0.7, 1.0, -0.5, 0.8, 0.9]]):
        slope, row = np.split(difference(both, at, 2e-3 * at * along) / 2e-3, [10])
        # Values that are 1e-14 wrong over steps of 2e-3, and what order eight leaves beside the resonance.
        assert slopes @ (at * along) == pytest.approx(slope, rel=0, abs=3e-9 * np.max(np.abs(value)))
        assert bends @ along == pytest.approx(row * at, rel=0, abs=1e-8 * np.max(np.abs(bends)))


@pytest.mark.parametrize("effects", [{"rate_term": 0.05, "added_mass": False}, {"inertial_drag": False}])
@pytest.mark.parametrize("choice", CHOICES)
def test_gradients_with_other_effects(scene_of, choice, effects):
    at = np.array(PLACES["between"])
    x = ca.MX.sym("x", 6)
    run = po.simulate(scene_of(ca.vertsplit(x), choice, **effects), outputs=OUTPUTS)
    found = ca.vertcat(run.mean_draft, run.force_rms, run.deflection[30])
    along = ca.Function("along", [x], [found, ca.mtimes(ca.jacobian(found, x), ca.DM(at))])

    def by_numbers(x):
        numbers = po.simulate(scene_of(x, choice, **effects), outputs=OUTPUTS)
        return np.array([numbers.mean_draft, numbers.force_rms, numbers.deflection[30]])

    value, slope = (np.asarray(result).ravel() for result in along(at))
    assert value == pytest.approx(by_numbers(at), rel=1e-9)
    # All six grow together.
    expected = difference(by_numbers, at, 1e-3 * at) / 1e-3
    assert slope == pytest.approx(expected, rel=0, abs=1e-8 * np.max(np.abs(expected)))


@pytest.mark.parametrize("choice", CHOICES)
def test_derivatives_are_finite_and_right_without_amplitude(functions, choice):
    first, second = functions(choice)
    at, some = np.array([3e4, 25.0, 2.0, 0.6, 0.0, 300.0]), np.array([3e4, 25.0, 2.0, 0.6, 1e-4, 300.0])
    value, slopes = (np.asarray(result) for result in first(at))
    assert np.all(np.isfinite(value))
    assert np.all(np.isfinite(slopes))
    assert np.all(np.isfinite(np.asarray(second(at, np.ones(10)))))
    change = (np.asarray(first(some)[0]) - value) / 1e-4
    # An amplitude moves the deflection in proportion, with a correction of first order in it ...
    assert slopes[5, 4] == pytest.approx(change[5, 0], rel=1e-3)
    # ... and the mean draft by its square.
    assert slopes[0, 4] == pytest.approx(0.0, abs=1e-9 * value[0, 0])
    # By what does not belong to the wave they are those of steady sliding, c without effect.
    deflection = value[2, 0]
    assert slopes[2, 0] == pytest.approx(-deflection / 3e4, rel=1e-9)
    assert slopes[2, [1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-12 * deflection)


@pytest.mark.parametrize("method", ["auto", "dop853"])
@pytest.mark.parametrize("choice", CHOICES)
def test_sx_symbols_are_refused(r1_scene, choice, method):
    scene = r1_scene(stiffness=ca.SX.sym("stiffness"), strength_wave=po.StrengthWave(0.3, 0.6), orbit=choice)
    with pytest.raises(po.InputError, match=r"an orbit takes MX symbols only.*use casadi\.MX"):
        po.simulate(scene, accuracy=po.Accuracy(method))


@pytest.mark.parametrize("choice", CHOICES)
def test_a_symbolic_orbit_says_what_it_cannot_have(r1_scene, choice):
    run = po.simulate(r1_scene(stiffness=ca.MX.sym("k"), strength_wave=po.StrengthWave(0.3, 0.6), orbit=choice))
    with pytest.raises(po.InputError, match="no Floquet multipliers: simulate the scene with numbers"):
        _ = run.floquet
    with pytest.raises(po.InputError, match="no error estimate"):
        _ = run.error_estimate


@pytest.mark.parametrize("choice", CHOICES)
def test_numbers_in_casadis_clothes_are_numbers(r1_scene, choice):
    effects = {"strength_wave": po.StrengthWave(0.3, 0.6), "orbit": choice, "damping": 200.0}
    plain, wrapped = (po.simulate(r1_scene(stiffness=k, **effects)) for k in (5e4, ca.MX(5e4)))
    assert wrapped.mean_draft == plain.mean_draft
    assert wrapped.error_estimate == plain.error_estimate
    assert isinstance(wrapped.mount_force, np.ndarray)
