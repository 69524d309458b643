"""Orders of the fixed-step methods against theory: of the state at the end, the mean draft and the RMS force apart.

A single error may change sign as the step shrinks, and then shows no order. What is measured is therefore the root of
the summed squares over three durations, at each of four numbers of steps, each twice the last.
"""

import math

import numpy as np
import pytest
from helpers import gauss_motion

import plough_opt as po

WAVE = po.StrengthWave(0.3, 0.6)
PARTS = (0.7, 0.85, 1.0)
# The ramp lasts a third of the duration: no number of steps below is a multiple of 3, so it never ends with an equal
# step. It ends a third of a step from one end or the other, so an inserted step has the same two parts every time.
RAMP = 1.0 / 3.0
SMOOTH = {
    "wave": {"strength_wave": WAVE},
    "wave, from rest": {"strength_wave": WAVE, "start": "rest"},
    "wave, towed": {"strength_wave": WAVE, "start": "towed"},
    "drag, from rest": {"start": "rest"},
    "linear damper, from rest": {"inertial_drag": False, "start": "rest", "damping": 250.0},
    "rate and damper, from rest": {"start": "rest", "rate_term": 0.05, "damping": 100.0},
    "all, from rest": {"strength_wave": WAVE, "start": "rest", "rate_term": 0.05, "damping": 100.0},
}
RAMPED = {
    "ramp": {"strength_wave": WAVE, "tow_ramp": RAMP},
    "ramp, from rest": {"start": "rest", "tow_ramp": RAMP},
    "ramp and damper": {"strength_wave": WAVE, "tow_ramp": RAMP, "damping": 100.0},
    "ramp and all": {"strength_wave": WAVE, "tow_ramp": RAMP, "damping": 100.0, "rate_term": 0.05},
}
SCENES = SMOOTH | RAMPED
# Longest duration and first number of steps. The fewest are in the asymptotic range, the most leave an error above
# rounding. Collocation solves its equations to some 1e-12 only, so it runs for longer.
RANGES = {"dop853": (0.24, 8), "collocation": (0.40, 32), "rk": (0.12, 128)}
RANGES_OF_DOP853 = {
    "wave": (0.12, 4),
    "wave, from rest": (0.20, 8),
    "wave, towed": (0.20, 7),
    "drag, from rest": (0.12, 5),
    "linear damper, from rest": (0.32, 7),
    "rate and damper, from rest": (0.16, 7),
    "all, from rest": (0.20, 8),
}
# The order of a Radau IIA method of three stages is 2 s - 1 = 5.
ORDERS = {"dop853": 8, "collocation": 5, "rk": 4}
# What the fit leaves: terms of the error two orders up, which at the coarsest steps of 0.3 to 2 rad are some per cent
# of the leading one where the method is of order 8, and below that of lower order with its smaller steps; and rounding,
# a tenth of the finest error of order 8, down to 4e-15. Of a ramp, that few steps do not double in each part.
BANDS = {"dop853": 0.3, "collocation": 0.05, "rk": 0.03}
RAMPED_BANDS = BANDS | {"dop853": 0.7}
QUANTITIES = ("end", "mean draft", "RMS force")


def scene_of(r1_scene, effects, duration):
    ramp = {"tow_ramp": effects["tow_ramp"] * duration} if "tow_ramp" in effects else {}
    return r1_scene(**(effects | ramp))


def errors_of(run, truth):
    """Return the relative errors of the end state, a vector, of the mean draft and of the RMS force."""
    end = (run.deflection[-1] - truth.deflection) / truth.mean_deflection, (run.speed[-1] - truth.speed) / truth.speed
    mean, rms = run.mean_draft - truth.mean_draft, run.force_rms - truth.force_rms
    return math.hypot(*end), mean / truth.mean_draft, rms / truth.mean_draft


def measured(scenes, truths, durations, method, steps):
    """Return the errors at every number of steps, a row each."""
    rows = []
    for count in steps:
        accuracy = po.Accuracy(method, steps=count)
        runs = [po.simulate(scene, d, accuracy=accuracy, outputs=1) for scene, d in zip(scenes, durations, strict=True)]
        rows.append(np.linalg.norm([errors_of(run, truth) for run, truth in zip(runs, truths, strict=True)], axis=0))
    return np.array(rows)


def fitted(errors, steps):
    """Return the orders p of errors a h^p (1 + b h): four errors, three unknowns."""
    h = steps[0] / np.array(steps)
    unknowns = np.column_stack([np.ones(4), np.log(h), h])
    return np.linalg.lstsq(unknowns, np.log(errors), rcond=None)[0][1]


def assert_orders(errors, steps, orders, band):
    # Three halvings, from where the leading term rules down to above rounding.
    assert np.all(errors[0] < 0.05)
    assert np.all(errors[-1] > 2e-15)
    found = fitted(errors, steps)
    assert dict(zip(QUANTITIES, found, strict=True)) == pytest.approx(
        dict(zip(QUANTITIES, orders, strict=True)), rel=0, abs=band
    )


# --- smooth scenes, and scenes with the kink at the end of a tow ramp ---


@pytest.fixture(scope="module")
def truth_of(r1_scene):
    """Return scenes, references and durations of a name up to a longest duration, each found once."""
    known = {}

    def find(name, longest):
        if (name, longest) not in known:
            durations = [part * longest for part in PARTS]
            scenes = [scene_of(r1_scene, SCENES[name], duration) for duration in durations]
            truths = [gauss_motion.follow(scene, duration) for scene, duration in zip(scenes, durations, strict=True)]
            known[name, longest] = scenes, truths, durations
        return known[name, longest]

    return find


def leaves_at_once(effects):
    """Return whether the mount force has a slope at the start."""
    return effects.get("start") == "rest" and "tow_ramp" not in effects


@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("name", SCENES)
def test_orders(truth_of, method, name):
    longest, first = RANGES_OF_DOP853.get(name, RANGES[method]) if method == "dop853" else RANGES[method]
    steps, bands = [first * 2**k for k in range(4)], RAMPED_BANDS if name in RAMPED else BANDS
    orders = [ORDERS[method]] * 3
    if method == "rk" and leaves_at_once(SCENES[name]):
        # The deviation is taken from a running mean, an integral divided by the elapsed time. In the first step Euler's
        # stage leaves h^2 in that integral and so h in the mean, whose square counts for one step.
        orders[-1] = 3
    assert_orders(measured(*truth_of(name, longest), method, steps), steps, orders, bands[method])


# --- the smooth contact, whose step has a kink of its own ---
