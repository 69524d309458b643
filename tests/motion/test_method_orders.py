"""Orders of the fixed-step methods against theory: of the state at the end, the mean draft and the RMS force apart.

A single error may change sign as the step shrinks, and then shows no order. What is measured is therefore the root of
the summed squares over three durations, at each of four numbers of steps, each twice the last.
"""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from helpers import gauss_motion, three_modes
from scipy.optimize import brentq

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


# --- the reference ---


def exact_from_rest(scene, duration):
    """Return deflection, speed and mean draft of a linear oscillator from rest, in closed form."""
    k, c, inertia, v = scene.stiffness, scene.effects.damping, scene.inertia, scene.tow_speed
    z_s, d = scene.reaction.static / k, c / (2.0 * inertia)
    x = -d + 1j * math.sqrt(k / inertia - d**2)
    # z = z_s + Re(a exp(x t)) with z = 0 and z' = V0 at first.
    a = -z_s - 1j * (v - d * z_s) / x.imag
    wave = a * np.exp(x * duration)
    mean = scene.reaction.static + (a * (k + c * x) * np.expm1(x * duration) / (x * duration)).real
    return z_s + wave.real, v - (x * wave).real, mean


def test_the_reference_is_exact_to_rounding(r1_scene):
    scene = r1_scene(**SCENES["linear damper, from rest"])
    truth = gauss_motion.follow(scene, 0.16)
    deflection, speed, mean = exact_from_rest(scene, 0.16)
    assert truth.deflection == pytest.approx(deflection, rel=0, abs=2e-15 * truth.mean_deflection)
    assert truth.speed == pytest.approx(speed, rel=0, abs=4e-15 * scene.tow_speed)
    assert truth.mean_draft == pytest.approx(mean, rel=2e-15)


@pytest.mark.parametrize("name", SCENES)
def test_the_reference_agrees_with_another_and_with_itself(r1_scene, name):
    scene = scene_of(r1_scene, SCENES[name], 0.3)
    truth, finer = (gauss_motion.follow(scene, 0.3, steps=steps) for steps in (60, 90))
    other = three_modes.follow(scene, 0.3)
    for field in dataclasses.fields(truth):
        value = getattr(truth, field.name)
        scale = {"force_rms": "mean_draft", "displacement_rms": "mean_deflection", "deflection": "mean_deflection"}
        size = abs(getattr(truth, scale.get(field.name, field.name)))
        # Rounding of some hundreds of steps.
        assert value == pytest.approx(getattr(finer, field.name), rel=0, abs=2e-14 * size), field.name
        compared = getattr(other, field.name)
        compared = compared[-1] if field.name in ("deflection", "speed") else compared
        # The other integrates the travel, whose rounding is 1e-16 of 1 m in a deflection of 1e-2 m.
        assert value == pytest.approx(compared, rel=0, abs=1e-10 * size), field.name


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
    """Tell whether the mount force has a slope at the start."""
    return effects.get("start") == "rest" and "tow_ramp" not in effects


@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("name", SCENES)
def test_orders(truth_of, method, name):
    longest, first = RANGES_OF_DOP853.get(name, RANGES[method]) if method == "dop853" else RANGES[method]
    steps, bands = [first * 2**k for k in range(4)], RAMPED_BANDS if name in RAMPED else BANDS
    orders = [ORDERS[method]] * 3
    if method == "rk" and leaves_at_once(SCENES[name]):
        # The spread is taken about a running mean, which in the first step is the integral so far over the time so
        # far. Euler's first stage has that integral wrong by h^2, so the mean by h: its square counts for one step.
        orders[-1] = 3
    assert_orders(measured(*truth_of(name, longest), method, steps), steps, orders, bands[method])


def test_a_step_ends_at_a_ramp_whose_end_is_a_symbol(r1_scene):
    # Across the end, where the strut's acceleration leaves 0 like (t - ramp)^2, a step would be off by h^3: 1e-7 here.
    duration, ramp = 0.24, 0.08
    truth = gauss_motion.follow(r1_scene(strength_wave=WAVE, tow_ramp=ramp), duration)
    steps, errors = [96 * 2**k - 1 for k in range(4)], []
    for count in steps:
        x = ca.MX.sym("x")
        run = po.simulate(
            r1_scene(strength_wave=WAVE, tow_ramp=x), duration, accuracy=po.Accuracy("dop853", steps=count), outputs=1
        )
        results = [run.deflection, run.speed, run.mean_draft, run.force_rms]
        deflection, speed, mean, rms = ca.Function("results", [x], results).call([ca.DM(ramp)])
        end = (float(deflection[-1]) - truth.deflection) / truth.mean_deflection, float(speed[-1]) / truth.speed - 1.0
        errors.append((math.hypot(*end), float(mean) / truth.mean_draft - 1.0, float(rms) / truth.force_rms - 1.0))
    # What is left is the rounding of both runs, and of the RMS the reference's own error.
    assert np.all(np.abs(errors) < 1e-12)


# --- the smooth contact, whose step has a kink of its own ---

# Width of the step [m/s] and effects. The share comes up to speed, crosses the width once, and stays above it.
CONTACTS = {
    "damper": (1.0, {"damping": 300.0}),
    "narrower": (0.5, {"damping": 300.0}),
    "wave, rate and damper": (1.0, {"damping": 300.0, "strength_wave": WAVE, "rate_term": 0.1}),
}


@pytest.fixture(scope="module", params=CONTACTS)
def crossing(request, r1_scene):
    """Return a scene and the time at which its share's speed crosses the width."""
    width, effects = CONTACTS[request.param]
    scene = r1_scene(start="rest", contact=po.Smooth(width), **effects)
    rough = three_modes.follow(scene, 0.1, outputs=50)
    after = np.argmax(rough.speed > width)
    between = rough.time[after - 1], rough.time[after]
    return scene, brentq(lambda t: gauss_motion.follow(scene, t, steps=20).speed - width, *between, xtol=1e-15)


@pytest.mark.parametrize(("method", "orders", "band"), [("dop853", (6, 6, 6), 0.2), ("rk", (4, 4, 3), 0.03)])
def test_orders_across_the_step_of_the_smooth_contact(crossing, method, orders, band):
    # The step's fifth derivative jumps at the width, 126 (1 - u)^5 on one side and 0 on the other, and with it that of
    # the acceleration: the step across is off by h^6, whatever the method's order. The crossing lies at a third of the
    # run and every number of steps is one below a multiple of 3, so it is always the same third of a step.
    scene, moment = crossing
    duration = 3.0 * moment
    truth = gauss_motion.follow(scene, duration, kinks=[moment])
    other = three_modes.follow(scene, duration, outputs=40)
    assert other.force_rms == pytest.approx(truth.force_rms, rel=1e-10)
    assert np.min(other.speed[other.time > 1.05 * moment]) > scene.effects.contact.width
    steps = [{"dop853": 15, "rk": 48}[method] * 2**k - 1 for k in range(4)]
    assert_orders(measured([scene], [truth], [duration], method, steps), steps, orders, band)


def test_order_5_of_collocation_under_the_smooth_contact(r1_scene):
    # The speed swings through the width, twice in every period: what order 5 adds up to over four periods is more than
    # what happens at the crossings, of order 6 and in ever other parts of a step, which leaves the wider band.
    scene = r1_scene(tow_speed=1.5, contact=po.Smooth(1.4), start="towed")
    durations = [part * 0.6 for part in PARTS]
    # So many steps leave 1e-13 of the crossings, by their own order of 6.
    truths = [gauss_motion.follow(scene, duration, steps=200) for duration in durations]
    steps = [48 * 2**k for k in range(4)]
    errors = measured([scene] * len(PARTS), truths, durations, "collocation", steps)
    assert_orders(errors, steps, (5, 5, 5), 0.1)
