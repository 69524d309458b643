"""The error estimate of a run: no error exceeds it, and a motion that cannot be predicted carries a warning.

A looser error never takes more steps.
"""

import collections
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
# Estimated error above which a reference is rejected, such as that of forces that are only the rounding of a travel.
DOUBTFUL = 1e-10


def by(seed):
    """Return a sampled run and its errors, or a text if there is none."""
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
    # If only rounding pulls, or a share nearly stops, the reference reports that it is inaccurate.
    assert kinds["no truth"] < 0.06 * count
    assert len(beyond) <= 0.01 * kinds["runs"]
    assert np.median(ratios) <= 30.0


@pytest.fixture(scope="module")
def gapped():
    """Return a run with slip, stick and gaps after a ramp."""
    effects = {"contact": po.StickSlip(), "strength_wave": po.StrengthWave(0.9, 0.1), "tow_ramp": 0.1, "start": "rest"}
    run = po.simulate(po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(**effects)), 0.6, outputs=60)
    assert set(run.mode) == {0.0, 1.0, 2.0}
    return run


@pytest.mark.parametrize("name", ["mount_force", "soil_resistance", "deflection", "speed", "travel", "opening"])
def test_every_array_counts_on_its_own_scale(gapped, name):
    values = getattr(gapped, name).copy()
    size = max(np.max(np.abs(values)), np.max(np.abs(gapped.deflection)) if name in ("travel", "opening") else 0.0)
    values[30] += 1e-3 * size
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == pytest.approx(1e-3, rel=1e-9)
    values[3] = np.nan
    assert difference(gapped, dataclasses.replace(gapped, **{name: values})) == np.inf


@pytest.mark.parametrize("name", ["mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power"])
def test_every_average_counts_on_its_own_scale(gapped, name):
    averages = dataclasses.replace(gapped.averages, **{name: getattr(gapped.averages, name) * 1.001})
    found = difference(gapped, dataclasses.replace(gapped, averages=averages))
    # A mean that is smaller than the RMS counts relative to the RMS.
    assert 1e-4 < found <= 1.0000001e-3
    assert found == pytest.approx(1e-3, rel=1e-9) or name in ("mean_draft", "mean_deflection", "tow_power")


# Scenes whose forces are far below the soil's strength.
HARD = po.Soil(
    density=1900, density_ratio=0.69, cohesion=1.5e6, friction_angle=0.066, tool_friction=0.93, ambient_pressure=700.0
)
FIRM = po.Soil(
    density=1900, density_ratio=0.8, cohesion=2e5, friction_angle=0.3, tool_friction=0.5, ambient_pressure=700.0
)
STUCK = {"start": "towed", "contact": po.StickSlip()}
WEAK = {
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
@pytest.mark.parametrize("name", WEAK)
def test_weak_forces_keep_their_digits(name, method):
    scene, duration = WEAK[name]
    run, truth = po.simulate(scene, duration, accuracy=po.Accuracy(method)), reference_run(scene, duration)
    errors = wild_scenes.errors(run, truth)
    assert max(errors.values()) <= run.error_estimate <= 3e-8, errors


# Seeds of `wild_scenes` -> quantity with the largest error. A ramp ends shortly before the end or soon after the start,
# or a share has entered by a millionth of its height.
FOUND = {421: "speed", 453: "soil_resistance", 1282: "force_rms", 1571: "force_rms"}


@pytest.mark.parametrize("seed", FOUND)
def test_the_estimate_holds_where_a_ramp_ends_late_or_an_entry_has_just_begun(seed):
    run, errors = by(seed)
    assert errors[FOUND[seed]] <= run.error_estimate < 2e-9


def test_the_estimate_includes_a_stop_that_the_integrator_did_not_notice():
    # The mount pulls the share back from weak soil for 2/10,000 of the run.
    run, errors = by(940)
    assert 1e-9 < max(errors.values()) <= run.error_estimate < 1e-6
    assert [text for text in run.warnings if "nearly stops" in text]


def test_the_resistance_of_a_share_that_just_entered_has_all_its_digits():
    # 1e-4 of the height is in the soil, so the resistance is 1e-8 of the full one: F0 (L/h)^2, times the wave.
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
    # The jerk jumps there, and the error control of a step of order 5 does not notice that.
    soil = dataclasses.replace(FIRM, friction_angle=0.0, tool_friction=0.0, ambient_pressure=0.0)
    effects = po.Effects(start="rest", entry=True, tow_ramp=0.0206, damping=635.0, rate_term=0.042)
    scene = po.Scene(soil, po.Wedge(1.4, 0.12, 0.15), 6.8e5, 337.0, 0.77, effects)
    run = po.simulate(scene, 0.1834, accuracy=po.Accuracy("erk", tolerance=1e-10))
    errors = wild_scenes.errors(run, reference_run(scene, 0.1834))
    # A step across the end would err by about a hundred tolerances.
    assert max(errors.values()) < 1e-9, errors


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
def test_a_motion_too_sensitive_to_be_predicted_carries_a_warning(contact, duration):
    # Each wave stops the undamped share, and deviations grow about tenfold from one to the next.
    effects = po.Effects(start="rest", strength_wave=po.StrengthWave(0.95, 0.1), inertial_drag=False, contact=contact)
    scene = po.Scene(SOIL, SHARE, 2e4, 20.0, 1.0, effects)
    run = po.simulate(scene, duration, outputs=50)
    (warning,) = [text for text in run.warnings if "too sensitive to be predicted" in text]
    assert f"better than {run.error_estimate:.1e}" in warning
    assert run.error_estimate > 1e-6
    beside = dataclasses.replace(scene, stiffness=scene.stiffness * (1.0 + 1e-12))
    assert difference(run, po.simulate(beside, duration, outputs=50)) > 1e-8


def test_an_unpredictable_motion_has_an_infinite_estimate():
    # The soil drives the share away at a speed that depends on digits beyond the last one of its quantities.
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
    """Return a scene for steps of order 8, with or without wave, damper and ramp, and a duration [s]."""
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
    """Return the number of steps for each wanted error, checks and repeated attempts included, and the estimates."""
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


# With fewer steps than this the arrays and averages of a run cost more than its steps.
FEW = 400


@pytest.mark.parametrize("number", [1, 4, 6, 10, 11])
def test_a_looser_error_takes_no_more_steps(monkeypatch, number):
    steps, estimates = steps_for_errors(monkeypatch, number)
    assert all(estimate <= error for error, estimate in zip(ERRORS, estimates, strict=True))
    assert all(tighter >= looser or looser < FEW for looser, tighter in itertools.pairwise(steps)), steps
