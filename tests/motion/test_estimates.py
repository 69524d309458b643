"""The error estimate of a run: no result is further from the truth, and a motion that cannot be predicted says so.

And the price of a wanted error: a looser one takes no more steps, counted and not clocked.
"""

import collections
import contextlib
import dataclasses
import itertools
import math

import numpy as np
import pytest
from helpers import wild_scenes

import plough_opt as po
from plough_opt.motion import verified
from plough_opt.motion.estimate import difference
from plough_opt.studies.accuracy.reference import reference_run

SOIL = po.named_soil("serozem")
SHARE = po.Wedge(po.deg(30), po.deg(15), 0.25)
# The truth's own error, estimated, above which it is none: of forces that are but the rounding of a travel.
DOUBTFUL = 1e-10


def by(seed):
    """Return a sampled run and its errors, or why there is none."""
    drawn = wild_scenes.sampled(seed)
    if drawn is None:
        return "not drawn"
    scene, duration, outputs = drawn
    try:
        run = po.simulate(scene, duration, outputs=outputs)
    except po.IntegrationError:
        return "refused"
    if not run.mount_force.any() and not run.soil_resistance.any():
        return "nothing pulls"
    try:
        truth = reference_run(scene, duration, outputs=outputs)
    except po.IntegrationError:
        return "no truth"
    return (run, wild_scenes.errors(run, truth)) if truth.error < DOUBTFUL else "no truth"


@pytest.mark.parametrize("count", [30, pytest.param(1600, marks=pytest.mark.slow)])
def test_no_result_is_further_from_the_truth_than_estimated(count, capsys):
    kinds, ratios, beyond = collections.Counter(), [], []
    for seed in range(count):
        found = by(seed)
        if isinstance(found, str):
            kinds[found] += 1
            continue
        run, errors = found
        kinds["runs"] += 1
        worst = max(errors, key=errors.get)
        error = errors[worst]
        if error > 0.0:
            ratios.append(run.error_estimate / error)
        if error > run.error_estimate:
            beyond.append((seed, worst, error, run.error_estimate))
        assert error <= 3.0 * run.error_estimate, (seed, worst, error, run.error_estimate)
        assert error <= 1e-6 or run.checks.notes, (seed, worst, error)
    with capsys.disabled():
        print(f"\n{dict(kinds)}, estimate over error {np.median(ratios):.1f} in the median; beyond: {beyond}")
    assert kinds["runs"] > 0.6 * count
    # Where nothing but rounding pulls, or a share grazes, the reference itself reports that it is none.
    assert kinds["no truth"] < 0.06 * count
    assert len(beyond) <= 0.01 * kinds["runs"]
    assert np.median(ratios) <= 30.0


@pytest.fixture(scope="module")
def gapped():
    """Return a run with slip, stick and gaps behind a ramp."""
    effects = {"contact": po.StickSlip(), "strength_wave": po.StrengthWave(0.9, 0.1), "tow_ramp": 0.1, "start": "rest"}
    run = po.simulate(po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(**effects)), 0.6, outputs=60)
    assert set(run.mode) == {0.0, 1.0, 2.0}
    return run


@pytest.mark.parametrize("name", ["mount_force", "soil_resistance", "deflection", "speed", "travel", "opening"])
def test_every_array_counts(gapped, name):
    values = getattr(gapped, name).copy()
    size = max(np.max(np.abs(values)), np.max(np.abs(gapped.deflection)) if name in ("travel", "opening") else 0.0)
    values[30] += 1e-3 * size
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == pytest.approx(1e-3, rel=1e-9)
    values[3] = np.nan
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == np.inf


@pytest.mark.parametrize("name", ["mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power"])
def test_every_average_counts(gapped, name):
    averages = dataclasses.replace(gapped.averages, **{name: getattr(gapped.averages, name) * 1.001})
    found = difference(gapped, dataclasses.replace(gapped, averages=averages))
    # A mean that is less than the RMS counts relative to that.
    assert 1e-4 < found <= 1.0000001e-3
    assert found == pytest.approx(1e-3, rel=1e-9) or name in ("mean_draft", "mean_deflection", "tow_power")


# --- forces far below the soil's strength, to which tolerances were once related ---

HARD = po.Soil(
    density=1900, density_ratio=0.69, cohesion=1.5e6, friction_angle=0.066, tool_friction=0.93, ambient_pressure=700.0
)
FIRM = po.Soil(
    density=1900, density_ratio=0.8, cohesion=2e5, friction_angle=0.3, tool_friction=0.5, ambient_pressure=700.0
)
STUCK = {"start": "towed", "contact": po.StickSlip()}
FEEBLE = {
    "sticks at once": (
        po.Scene(HARD, po.Wedge(1.24, 0.52, 0.35), 1565.0, 0.27, 1.3, po.Effects(**STUCK, damping=120.0)),
        0.033,
    ),
    "sticks, no added mass": (
        po.Scene(FIRM, po.Wedge(1.0, 0.26, 0.35), 2e3, 5.0, 0.1, po.Effects(**STUCK, damping=500.0, added_mass=False)),
        0.5,
    ),
    "touches the soil": (po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(start="towed", entry=True)), 1e-4),
    "begins to enter": (po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(start="towed", entry=True)), 1e-3),
}


@pytest.mark.parametrize("method", ["auto", "erk", "rosenbrock"])
@pytest.mark.parametrize("name", FEEBLE)
def test_feeble_forces_keep_their_digits(name, method):
    scene, duration = FEEBLE[name]
    run, truth = po.simulate(scene, duration, accuracy=po.Accuracy(method)), reference_run(scene, duration)
    errors = wild_scenes.errors(run, truth)
    assert max(errors.values()) <= run.error_estimate <= 3e-8, errors


# Seeds of `wild_scenes` in which a ramp ends shortly before the run does, or soon, a share has entered by a millionth.
FOUND = {421: "speed", 453: "soil_resistance", 1282: "force_rms", 1571: "force_rms"}


@pytest.mark.parametrize("seed", FOUND)
def test_scenes_once_further_from_the_truth_than_three_estimates(seed):
    run, errors = by(seed)
    assert errors[FOUND[seed]] <= run.error_estimate < 2e-9


def test_a_stop_that_the_integrator_passes_over_is_in_the_estimate():
    # The mount pulls the share back from feeble soil for two parts in ten thousand of the run.
    run, errors = by(940)
    assert 1e-9 < max(errors.values()) <= run.error_estimate < 1e-6
    assert [text for text in run.warnings if "nearly stops" in text]


def test_the_resistance_of_a_share_that_just_entered_has_all_its_digits():
    # A ten-thousandth of the height is in the soil: 1e-8 of the resistance, F0 (L/h)^2 with the wave on it.
    wave = po.StrengthWave(0.5, 0.1)
    scene = po.Scene(
        SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(start="towed", entry=True, strength_wave=wave, added_mass=False)
    )
    run = po.simulate(scene, 2e-5, outputs=10)
    depth = run.travel / scene.cone.height
    strength = scene.reaction.static * (1.0 + 0.5 * np.sin(2.0 * np.pi * run.travel / 0.1))
    expected = depth**2 * (strength + scene.reaction.drag * run.speed**2)
    assert 0.9e-4 < depth[-1] < 1.3e-4
    assert run.soil_resistance == pytest.approx(expected, rel=8 * np.finfo(float).eps, abs=0.0)


def test_no_step_crosses_the_end_of_a_ramp():
    # The jerk jumps there, and a step of order 5 across it errs by what its tolerance does not see.
    soil = dataclasses.replace(FIRM, friction_angle=0.0, tool_friction=0.0, ambient_pressure=0.0)
    effects = po.Effects(start="rest", entry=True, tow_ramp=0.0206, damping=635.0, rate_term=0.042)
    scene = po.Scene(soil, po.Wedge(1.4, 0.12, 0.15), 6.8e5, 337.0, 0.77, effects)
    run = po.simulate(scene, 0.1834, accuracy=po.Accuracy("erk", tolerance=1e-10))
    errors = wild_scenes.errors(run, reference_run(scene, 0.1834))
    # Some hundred times the tolerance where a step does.
    assert max(errors.values()) < 1e-9, errors


def test_modes_are_whole_by_an_implicit_method(gapped):
    run = po.simulate(gapped.scene, gapped.duration, accuracy=po.Accuracy("rosenbrock"), outputs=60)
    assert set(run.mode) == {0.0, 1.0, 2.0}


def test_few_outputs_let_no_event_pass(gapped):
    few = po.simulate(gapped.scene, gapped.duration, outputs=3)
    assert few.mount_force == pytest.approx(gapped.mount_force[::20], rel=0, abs=1e-8 * gapped.peak_force)
    assert len(few.time) == len(few.mode) == len(few.opening) == 4


@pytest.mark.parametrize(
    ("contact", "duration"),
    [
        pytest.param("resisting", 4.0, id="resisting"),
        pytest.param(po.StickSlip(2.0), 12.0, id="stick_slip", marks=pytest.mark.slow),
    ],
)
def test_a_motion_too_sensitive_to_be_predicted_says_so(contact, duration):
    # An undamped share between waves that stop it: deviations grow some ten times from each to the next.
    effects = po.Effects(start="rest", strength_wave=po.StrengthWave(0.95, 0.1), inertial_drag=False, contact=contact)
    scene = po.Scene(SOIL, SHARE, 2e4, 20.0, 1.0, effects)
    run = po.simulate(scene, duration, outputs=50)
    (warning,) = [text for text in run.warnings if "too sensitive to be predicted" in text]
    assert f"better than {run.error_estimate:.1e}" in warning
    assert run.error_estimate > 1e-6
    beside = dataclasses.replace(scene, stiffness=scene.stiffness * (1.0 + 1e-12))
    assert difference(run, po.simulate(beside, duration, outputs=50)) > 1e-8


def test_a_motion_of_which_nothing_is_known_says_so():
    # The soil drives the share away at a speed that its numbers decide beyond the last digit.
    scene, duration, outputs = wild_scenes.sampled(548)
    run = po.simulate(scene, duration, outputs=outputs)
    assert run.error_estimate == np.inf
    assert [text for text in run.warnings if "too sensitive to be predicted at all" in text]


@pytest.mark.parametrize("accuracy", [po.Accuracy("erk", tolerance=1e-4), po.Accuracy("dop853", steps=24)])
def test_a_named_method_warns_of_an_error_that_matters(accuracy):
    scene = po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(strength_wave=po.StrengthWave(0.3, 0.3)))
    coarse, fine = (po.simulate(scene, 1.0, accuracy=a) for a in (accuracy, po.Accuracy()))
    assert coarse.error_estimate > 1e-6
    assert [text for text in coarse.warnings if "estimated relative error is" in text]
    assert not [text for text in fine.warnings if "error" in text]


ERRORS = [10.0**-k for k in range(2, 11)]


def sampled(number):
    """Return a scene that steps of order 8 follow, with a wave, a damper and a ramp or without, and a time."""
    random = np.random.default_rng(number)
    effects = {"start": str(random.choice(["equilibrium", "rest", "towed"]))}
    if random.random() < 0.7:
        effects["strength_wave"] = po.StrengthWave(random.uniform(0.05, 0.5), 10.0 ** random.uniform(-1.0, 0.3))
    if random.random() < 0.6:
        effects["damping"] = 10.0 ** random.uniform(1.0, 3.0)
    if random.random() < 0.3:
        effects["tow_ramp"] = random.uniform(0.05, 0.5)
    share = po.Wedge(random.uniform(0.2, 0.8), 0.26, random.uniform(0.15, 0.4))
    stiffness, mass, speed = 10.0 ** random.uniform(4.0, 6.0), random.uniform(10.0, 60.0), random.uniform(0.5, 3.0)
    scene = po.Scene(po.named_soil("serozem"), share, stiffness, mass, speed, po.Effects(**effects))
    return scene, 10.0 ** random.uniform(-0.5, 1.0)


def steps_for_errors(monkeypatch, number):
    """Return the steps, checks and attempts included, that each of the wanted errors takes, and the estimates."""
    scene, duration = sampled(number)
    taken, integrate = [], verified.integrate

    def counted(case, accuracy, *given, **named):
        taken.append(accuracy.steps or math.inf)
        return integrate(case, accuracy, *given, **named)

    monkeypatch.setattr(verified, "integrate", counted)
    found = []
    for error in ERRORS:
        taken.clear()
        run = po.simulate(scene, duration, accuracy=po.Accuracy(error=error), outputs=100)
        found.append((sum(taken), run.error_estimate))
    return [list(column) for column in zip(*found, strict=True)]


# Steps below which a run's time is that of what goes with it: its arrays and averages.
FEW = 400


@pytest.mark.parametrize("number", [1, 4, 6, 10, 11])
def test_a_looser_error_takes_no_more_steps(monkeypatch, number):
    steps, estimates = steps_for_errors(monkeypatch, number)
    assert all(estimate <= error for error, estimate in zip(ERRORS, estimates, strict=True))
    assert all(tighter >= looser or looser < FEW for looser, tighter in itertools.pairwise(steps)), steps


def overshoots(monkeypatch, number):
    """Return by how many times each wanted error is more than the true one, where more steps are taken than a few."""
    steps, _ = steps_for_errors(monkeypatch, number)
    scene, duration = sampled(number)
    truth = po.simulate(scene, duration, accuracy=po.Accuracy(error=1e-12), outputs=100)
    found = []
    for taken, error in zip(steps, ERRORS[:-1], strict=False):
        # What the first, long steps leave is had for nothing.
        if taken > max(FEW, 1.5 * steps[0]):
            run = po.simulate(scene, duration, accuracy=po.Accuracy(error=error), outputs=100)
            found.append(error / difference(truth, run))
    return found


@pytest.mark.parametrize("numbers", [(1, 4, 6), pytest.param(range(60), marks=pytest.mark.slow)], ids=len)
def test_where_steps_cost_time_the_error_is_not_far_less_than_wanted(monkeypatch, numbers):
    found = []
    for number in numbers:
        with contextlib.suppress(po.IntegrationError):  # a start from which the share is driven away
            found += overshoots(monkeypatch, number)
    assert len(found) > 1.5 * len(numbers)
    # The check with three quarters of the steps errs by ten times as much, and steps are a tenth more than enough.
    assert 5.0 < np.median(found) < 30.0, found
