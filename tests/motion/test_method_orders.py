"""Orders of the fixed-step methods against theory, separately for the state at the end, mean draft and RMS force.

A single error may change sign as the step size shrinks, and then shows no order. Measured is therefore the root sum of
squares over three durations, at four numbers of steps, each twice the one before.
"""

import math

import numpy as np
import pytest
from scipy.integrate import DOP853 as SCIPYS

import plough_opt as po
from plough_opt.motion.methods import DOP853

WAVE = po.StrengthWave(0.3, 0.6)
PARTS = (0.7, 0.85, 1.0)
# The ramp lasts a third of the duration. No number of steps is a multiple of 3, so it always ends a third of a step
# from the end of a step, and the inserted end divides a step in the same proportion.
RAMP = 1.0 / 3.0
SCENES = {
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
@pytest.mark.parametrize("name", SCENES)
def test_orders(r1_scene, method, name):
    longest, first = RANGES_OF_DOP853.get(name, RANGES[method]) if method == "dop853" else RANGES[method]
    effects, durations = SCENES[name], [part * longest for part in PARTS]
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
