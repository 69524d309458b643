"""One equation by seven methods: results, derivatives, and the causes of failures."""

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import assert_alike, results_of

import plough_opt as po

WAVE = po.StrengthWave(0.3, 0.6)
SCENES = {
    "wave": {"strength_wave": WAVE},
    "damped from rest": {"strength_wave": WAVE, "start": "rest", "damping": 250.0},
    "everything": {"strength_wave": WAVE, "start": "rest", "rate_term": 0.05, "damping": 250.0, "tow_ramp": 0.137},
    "bare": {"inertial_drag": False, "added_mass": False, "ambient_pressure": False},
}
# Settings for an error of 1e-9. The kink at a tow ramp's end costs collocation most of its order.
TIGHT = [
    *(po.Accuracy(method, tolerance=1e-12) for method in ("cvodes", "idas", "erk", "rosenbrock")),
    po.Accuracy("collocation", steps=4000),
    po.Accuracy("rk", steps=16000),
]


def method(accuracy):
    return accuracy.method if isinstance(accuracy, po.Accuracy) else None


@pytest.mark.parametrize("accuracy", TIGHT, ids=method)
@pytest.mark.parametrize("name", SCENES)
def test_all_methods_agree(r1_scene, name, accuracy):
    scene = r1_scene(**SCENES[name])
    found = po.simulate(scene, 1.0, accuracy=accuracy, outputs=20)
    order_8 = po.simulate(scene, 1.0, accuracy=po.Accuracy("dop853", steps=2000), outputs=20)
    # Errors of 1e-12 accumulate over about seven oscillations.
    assert_alike(results_of(found), order_8, 1e-9)


def test_a_damper_with_half_the_critical_damping(r1_scene):
    """Deflection and damper contribute equally to the expected size of the mount force, which a symbolic run keeps."""
    plain, x = r1_scene(), ca.MX.sym("x")
    scene = r1_scene(strength_wave=WAVE, damping=(plain.stiffness * plain.inertia) ** 0.5)
    run = po.simulate(replace(scene, tow_speed=x), 0.5, accuracy=po.Accuracy("cvodes", tolerance=1e-10), outputs=1)
    found = float(ca.Function("rms", [x], [run.force_rms])(scene.tow_speed))
    assert found == pytest.approx(po.simulate(scene, 0.5).force_rms, rel=1e-7)


# --- derivatives ---


@functools.cache
def derivatives(r1_scene, name, accuracy):
    """Return mean and RMS with first and second derivatives by relative changes of height and stiffness."""
    x = ca.MX.sym("x", 2)
    scene = r1_scene(25.0, 0.25 * x[0], 5e4 * x[1], **SCENES[name])
    run = po.simulate(scene, 0.5, accuracy=accuracy, outputs=5)
    value = ca.vertcat(run.mean_draft, run.force_rms)
    second = [ca.jacobian(ca.jacobian(value, x), x)] if accuracy.method in ("dop853", "cvodes", "erk") else []
    results = ca.Function("derivatives", [x], [value, ca.jacobian(value, x), *second]).call([ca.DM([1.0, 1.0])])
    return [result.full() for result in results]


@pytest.mark.parametrize("name", ["damped from rest", "everything"])
@pytest.mark.parametrize(
    ("accuracy", "allowed"),
    [
        *((po.Accuracy(method, tolerance=1e-11), 1e-8) for method in ("cvodes", "idas")),
        *((po.Accuracy(method, tolerance=1e-11), 1e-9) for method in ("erk", "rosenbrock")),
        # The kink at the ramp's end reduces collocation to order 3.
        (po.Accuracy("collocation", steps=800), 1e-7),
        (po.Accuracy("rk", steps=3200), 1e-7),
    ],
    ids=method,
)
def test_all_methods_have_the_same_derivatives(r1_scene, name, accuracy, allowed):
    expected = derivatives(r1_scene, name, po.Accuracy("dop853", steps=400))
    for found, truth in zip(derivatives(r1_scene, name, accuracy), expected, strict=False):
        # Second derivatives lose a digit.
        digits = allowed if found.shape[0] == 2 else max(allowed, 1e-8)
        assert found == pytest.approx(truth, rel=0, abs=digits * np.max(np.abs(truth)))


# --- failure ---


def test_failure_names_scene_time_and_cause_and_its_advice_works(r1_scene):
    scene = r1_scene(stiffness=5e5, start="rest")
    with pytest.raises(po.IntegrationError) as caught:
        po.simulate(scene, 50.0, accuracy=po.Accuracy("dop853", steps=4), outputs=2)
    message = str(caught.value)
    scene_in_words = ("half angle 8.93 deg and height 0.25 m", "500 kN/m", "at 2 m/s")
    for words in (*scene_in_words, "beyond t = ", "of 50 s", "4 steps are too few for"):
        assert words in message
    steps = int(message.rsplit("use steps=", 1)[1])
    run = po.simulate(scene, 50.0, accuracy=po.Accuracy("dop853", steps=steps), outputs=2)
    # Phase errors accumulate over the oscillations, so the error is above that of a single one.
    assert run.error_estimate < 1e-6
    with pytest.raises(po.IntegrationError, match="steps are too few"):
        po.simulate(scene, 50.0, accuracy=po.Accuracy("rk", steps=4), outputs=2)
