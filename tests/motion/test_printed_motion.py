"""Equation (27) as printed: a spring that repels, against exact solutions and another solver."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

import plough_opt as po

REPELS = po.Printed(pi_twice=False, one_third=False)
FINE = po.Accuracy("dop853", steps=2000)
ADAPTIVE = [po.Accuracy(method) for method in ("erk", "cvodes", "idas", "rosenbrock")]


def exact(scene, sinh=np.sinh, cosh=np.cosh, exp=np.exp, sqrt=np.sqrt):
    """Return z and z' as functions of time: M z'' = F0 + k0 z - c z', z(0) = 0, z'(0) = V0."""
    k, inertia, force = scene.stiffness, scene.inertia, scene.reaction.static
    decay = (scene.effects.damping or 0.0) / (2 * inertia)
    rate = sqrt(k / inertia + decay**2)
    steady = -force / k
    # z = steady + exp(-decay t) (-steady cosh + b sinh).
    b = (scene.tow_speed - decay * steady) / rate

    def deflection(t):
        return steady + exp(-decay * t) * (-steady * cosh(rate * t) + b * sinh(rate * t))

    def slope(t):
        by_cosh, by_sinh = b * rate + decay * steady, -steady * rate - decay * b
        return exp(-decay * t) * (by_cosh * cosh(rate * t) + by_sinh * sinh(rate * t))

    return deflection, slope


def averages(function, duration):
    """Return mean and RMS by a quadrature that is exact to rounding over about ten e-foldings."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    values = function(duration * (nodes + 1) / 2)
    mean = weights @ values / 2
    return mean, math.sqrt(weights @ (values - mean) ** 2 / 2)


def largest(expected, allowed):
    return pytest.approx(expected, rel=0, abs=allowed * np.max(np.abs(expected)))


CASES = [
    # stiffness N/m, tow speed m/s, damping N s/m, formulation, duration s
    (5e4, 2.0, None, REPELS, 0.15),
    (5e4, 2.0, None, "printed", 0.15),
    (5e4, 2.0, 250.0, REPELS, 0.2),
    (3e2, 0.5, None, "printed", 1.5),
    (3e2, 0.0, 90.0, "printed", 2.0),
]


def rest_scene(r1_scene, stiffness, speed, damping, formulation):
    effects = {"start": "rest", "inertial_drag": False, "damping": damping, "formulation": formulation}
    return r1_scene(stiffness=stiffness, tow_speed=speed, **effects)


@pytest.mark.parametrize("accuracy", [None, FINE, *ADAPTIVE], ids=lambda a: a.method if a else "auto")
@pytest.mark.parametrize(("stiffness", "speed", "damping", "formulation", "duration"), CASES)
def test_the_runaway_is_that_of_the_exact_solution(
    r1_scene, stiffness, speed, damping, formulation, duration, accuracy
):
    scene = rest_scene(r1_scene, stiffness, speed, damping, formulation)
    run = po.simulate(scene, duration, accuracy=accuracy, outputs=20)
    deflection, slope = exact(scene)
    z, rate = deflection(run.time), slope(run.time)

    def mount(t):
        return -stiffness * deflection(t) + (damping or 0.0) * slope(t)

    allowed = 1e-12 if accuracy is FINE else 3e-8
    assert run.deflection == largest(z, allowed)
    assert run.speed == pytest.approx(speed - rate, rel=0, abs=allowed * np.max(np.abs(rate)))
    assert run.travel == pytest.approx(speed * run.time - z, rel=0, abs=allowed * np.max(np.abs(z)))
    assert run.mount_force == largest(mount(run.time), allowed)
    # The source's P(t) = k0 (V0 t - L) is the negative of the spring's force on the share.
    assert stiffness * (speed * run.time - run.travel) == largest(
        (damping or 0.0) * rate - mount(run.time), 2 * allowed
    )
    for found, function in (
        ((run.mean_deflection, run.displacement_rms), deflection),
        ((run.mean_draft, run.force_rms), mount),
    ):
        mean, rms = averages(function, duration)
        assert found == pytest.approx((mean, rms), rel=0, abs=allowed * max(abs(mean), rms))
    if accuracy is None:
        assert run.error_estimate < 1e-8
    assert run.tow_power == pytest.approx(run.mean_draft * speed, rel=1e-12)


def test_its_unstable_equilibrium_is_exact_and_grows_at_the_natural_frequency(r1_scene):
    scene = r1_scene(formulation="printed")
    run = po.simulate(scene, 1.0, outputs=10)
    assert run.mean_deflection == pytest.approx(-scene.steady_resistance / scene.stiffness, rel=1e-15)
    assert run.mean_draft == pytest.approx(scene.steady_resistance, rel=1e-15)
    assert run.force_rms == np.ptp(run.deflection) == 0.0
    # A disturbance of 1e-12 of the soil's strength grows like exp(omega t), here by 1e9 in 0.45 s.
    wave = po.StrengthWave(1e-12, 0.6)
    disturbed = po.simulate(r1_scene(formulation="printed", strength_wave=wave, inertial_drag=False), 0.45, outputs=9)
    deviation = np.abs(disturbed.deflection + scene.reaction.static / scene.stiffness)
    growth = math.log(deviation[-1] / deviation[-2]) / (0.45 / 9)
    assert growth == pytest.approx(float(disturbed.scene.natural_frequency), rel=1e-3)


# --- overflow ---


@pytest.mark.parametrize("accuracy", [None, po.Accuracy("dop853"), po.Accuracy("erk")], ids=str)
@pytest.mark.parametrize(
    ("drag", "duration"),
    # Growth by exp(3e4); by exp(600), whose square overflows; and by drag of constant sign, which drives a retreating
    # share away in finite time.
    [(False, 2e3), (False, 39.0), (True, 1.0)],
)
def test_overflow_names_the_repelling_spring(r1_scene, drag, duration, accuracy):
    scene = r1_scene(stiffness=5e3, start="rest", inertial_drag=drag, formulation="printed")
    with pytest.raises(po.IntegrationError) as refusal:
        po.simulate(scene, duration, accuracy=accuracy, outputs=10)
    message = str(refusal.value)
    assert "the print's repelling spring drives the share away like exp(" in message
    assert f"exp({scene.natural_frequency:.3g} t)" in message
    assert "use a shorter duration, or formulation = 'derived'" in message
    assert "on 5 kN/m of a repelling spring, as printed, with" in message


def test_a_design_finds_the_stiffness_of_a_wanted_deflection(r1_scene):
    def scene(stiffness):
        return r1_scene(stiffness=stiffness, start="rest", inertial_drag=False, formulation="printed")

    wanted, duration = 1.5, 0.1
    truth = brentq(lambda k: float(exact(scene(k))[0](duration)) - wanted, 1e3, 1e5, xtol=1e-9)
    design = po.Design()
    stiffness = design.variable("stiffness", guess=2e4, lower=1e3, upper=1e5, unit="N/m", log=True)
    run = po.simulate(scene(stiffness), duration, outputs=4)
    design.minimise((run.deflection[-1] / wanted - 1.0) ** 2 + 1.0)
    best = design.solve()
    # The objective is quadratic about its minimum of 1, so IPOPT's 1e-8 leaves about 1e-5 of the variable.
    assert best(stiffness) == pytest.approx(truth, rel=1e-4)
    assert any("not physics" in text for text in best.warnings)
