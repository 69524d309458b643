"""Equation (27) as printed: a spring that repels, from equilibrium, to overflow, and in a design."""

import math

import numpy as np
import pytest
from helpers.linear_motion import oscillation
from scipy.optimize import brentq

import plough_opt as po


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
    truth = brentq(lambda k: float(oscillation(scene(k), duration)[0]) - wanted, 1e3, 1e5, xtol=1e-9)
    design = po.Design()
    stiffness = design.variable("stiffness", guess=2e4, lower=1e3, upper=1e5, unit="N/m", log=True)
    run = po.simulate(scene(stiffness), duration, outputs=4)
    design.minimise((run.deflection[-1] / wanted - 1.0) ** 2 + 1.0)
    best = design.solve()
    # The objective is quadratic about its minimum of 1, so IPOPT's 1e-8 leaves about 1e-5 of the variable.
    assert best(stiffness) == pytest.approx(truth, rel=1e-4)
    assert any("not physics" in text for text in best.warnings)
