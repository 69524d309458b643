"""One equation by all methods: results, derivatives, orders, and the causes of failures."""

import functools
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import assert_alike, results_of
from scipy.integrate import DOP853 as SCIPYS

import plough_opt as po
from plough_opt.motion.methods import DOP853

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


DERIVATIVES = [
    *((po.Accuracy(method, tolerance=1e-11), 1e-8) for method in ("cvodes", "idas")),
    *((po.Accuracy(method, tolerance=1e-11), 1e-9) for method in ("erk", "rosenbrock")),
    # The kink at the ramp's end reduces collocation to order 3.
    (po.Accuracy("collocation", steps=800), 1e-7),
    (po.Accuracy("rk", steps=3200), 1e-7),
]


@pytest.mark.parametrize("name", ["damped from rest", "everything"])
@pytest.mark.parametrize(("accuracy", "allowed"), DERIVATIVES, ids=method)
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


# Orders are measured separately for the state at the end, mean draft and RMS force. A single error may change sign as
# the step size shrinks, and then shows no order. Measured is therefore the root sum of squares over three durations, at
# four numbers of steps, each twice the one before.
PARTS = (0.7, 0.85, 1.0)
# The ramp lasts a third of the duration. No number of steps is a multiple of 3, so it always ends a third of a step
# from the end of a step, and the inserted end divides a step in the same proportion.
RAMP = 1.0 / 3.0
MEASURED = {
    "wave": {"strength_wave": WAVE},
    "wave, from rest": {"strength_wave": WAVE, "start": "rest"},
    "linear damper, from rest": {"inertial_drag": False, "start": "rest", "damping": 250.0},
    "all, from rest": {"strength_wave": WAVE, "start": "rest", "rate_term": 0.05, "damping": 100.0},
    "ramp": {"strength_wave": WAVE, "tow_ramp": RAMP},
    "ramp and all": {"strength_wave": WAVE, "tow_ramp": RAMP, "damping": 100.0, "rate_term": 0.05},
}
# Longest duration and first number of steps. The fewest are in the asymptotic range, and the most leave an error above
# rounding. Collocation solves its equations to about 1e-12 only, so its run is longer.
RANGES = {"dop853": (0.24, 8), "collocation": (0.40, 32), "rk": (0.12, 128)}
RANGES_OF_DOP853 = {
    "wave": (0.12, 4),
    "wave, from rest": (0.20, 8),
    "linear damper, from rest": (0.32, 7),
    "all, from rest": (0.20, 8),
}
# The order of a Radau IIA method of three stages is 2 s - 1 = 5.
ORDERS = {"dop853": 8, "collocation": 5, "rk": 4}
# The fit omits the next terms of the error, a few per cent of the leading one at the coarsest steps of order 8 (0.3 to
# 2 rad), and rounding, which is a tenth of the finest error of order 8. A ramp's parts do not take exactly twice as
# many steps each.
BANDS = {"dop853": 0.4, "collocation": 0.05, "rk": 0.03}


def fitted(errors, steps):
    """Return the orders p of errors a h^p (1 + b h): four errors, three unknowns."""
    h = steps[0] / np.array(steps)
    unknowns = np.column_stack([np.ones(4), np.log(h), h])
    return np.linalg.lstsq(unknowns, np.log(errors), rcond=None)[0][1]


@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("name", MEASURED)
def test_orders(r1_scene, method, name):
    longest, first = RANGES_OF_DOP853.get(name, RANGES[method]) if method == "dop853" else RANGES[method]
    effects, durations = MEASURED[name], [part * longest for part in PARTS]
    ramped = "tow_ramp" in effects
    scenes = [r1_scene(**effects | ({"tow_ramp": RAMP * duration} if ramped else {})) for duration in durations]

    def runs(accuracy):
        return [po.simulate(scene, d, accuracy=accuracy, outputs=1) for scene, d in zip(scenes, durations, strict=True)]

    def errors(run, truth):
        """Return the relative errors of the end state, a vector, of the mean draft and of the RMS force."""
        deflection = (run.deflection[-1] - truth.deflection[-1]) / truth.mean_deflection
        end = math.hypot(deflection, run.speed[-1] / truth.speed[-1] - 1.0)
        mean, rms = run.mean_draft - truth.mean_draft, run.force_rms - truth.force_rms
        return end, mean / truth.mean_draft, rms / truth.mean_draft

    # 1000 steps of order 8 leave only rounding. `test_simulate` shows that their results are right.
    truths, steps = runs(po.Accuracy("dop853", steps=1000)), [first * 2**k for k in range(4)]
    found = np.array([
        np.linalg.norm([*map(errors, runs(po.Accuracy(method, steps=count)), truths)], axis=0) for count in steps
    ])  # fmt: skip
    # Three halvings, from where the leading term rules down to above rounding.
    assert np.all(found[0] < 0.05)
    assert np.all(found[-1] > 2e-15)
    orders = [ORDERS[method]] * 3
    if method == "rk" and effects.get("start") == "rest":
        # The mount force has a slope at the start.
        # The deviation is taken from a running mean, an integral divided by the elapsed time. In the first step Euler's
        # stage leaves h^2 in that integral and so h in the mean, whose square counts for one step.
        orders[-1] = 3
    band = 0.9 if ramped and method == "dop853" else BANDS[method]
    assert fitted(found, steps) == pytest.approx(orders, rel=0, abs=band)


def test_coefficients_of_order_8_are_scipys():
    assert (DOP853.nodes, DOP853.weights) == (tuple(SCIPYS.C), tuple(SCIPYS.B))
    assert DOP853.stages == tuple(tuple(row[:k]) for k, row in enumerate(SCIPYS.A))
