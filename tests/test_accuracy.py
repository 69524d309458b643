"""The accuracy study of a scene and of a design: true errors, advice, failures, pictures, and its script."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.linear_motion import averages, oscillation
from helpers.scenes import scene_of
from helpers.scripts import imported
from helpers.small_designs import design

import plough_opt as po
from plough_opt.studies.accuracy import AccuracyStudy, MethodResult

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.2)
METHODS = {"auto", "dop853", "collocation", "rk", "cvodes", "idas", "erk", "rosenbrock"}

# --- of a scene ---


@pytest.fixture(scope="module")
def linear():
    """Return a scene whose motion is a linear oscillation, and its study."""
    plain = scene_of(start="rest", inertial_drag=False)
    return plain, po.study_accuracy(plain, 0.15, wanted=1e-7, outputs=10)


def test_errors_are_those_from_the_exact_solution(linear):
    plain, study = linear
    mean, rms = averages(lambda t: plain.stiffness * oscillation(plain, t)[0], 0.15)
    force = plain.stiffness * oscillation(plain, np.linspace(0.0, 0.15, 11))[0]
    assert {entry.method for entry in study.entries} == METHODS
    assert 0.0 < study.floor < 1e-11
    for entry in study.entries:
        kind, value = sorted(entry.setting.split(), reverse=True)
        settings = {kind: float(value) if kind != "steps" else int(value)}
        run = po.simulate(plain, 0.15, accuracy=po.Accuracy(entry.method, **settings), outputs=10)
        off = max(abs(run.mean_draft - mean), abs(run.force_rms - rms)) / max(mean, rms)
        assert entry.errors["averages"] == pytest.approx(off, rel=1e-6, abs=study.floor)
        off = np.max(np.abs(run.mount_force - force)) / np.max(np.abs(force))
        assert entry.errors["forces"] == pytest.approx(off, rel=1e-6, abs=study.floor)
        assert 0.0 < entry.seconds < math.inf


def test_every_method_reaches_small_errors_and_finer_settings_have_smaller_ones(linear):
    study = linear[1]
    for method in METHODS:
        errors = [entry.error for entry in study.entries if entry.method == method]
        assert min(errors) < 1e-8, method
        assert errors[-1] <= max(errors[0], study.floor), method


def test_wanted_default_and_advice(linear):
    study = linear[1]
    labels = {entry.label for entry in study.entries}
    assert {"auto, error 1e-07", "auto, error 1e-08"} <= labels
    best = study.cheapest
    assert best.error <= 1e-7
    assert all(best.seconds <= e.seconds for e in study.entries if e.error <= 1e-7)
    assert study.advice.startswith(f"for 1e-07 take {best.label} (")
    assert "default" in study.advice
    assert study.advice in study.page().parts


def test_an_orbit_is_found_by_the_methods_that_can():
    study = po.study_accuracy(scene_of(strength_wave=WAVE, damping=400.0, orbit="periodic"), outputs=8)
    done = {entry.method for entry in study.entries if entry.failure is None}
    assert done == {"auto", "dop853"}
    assert study.duration == pytest.approx(0.1)
    assert "cannot find an orbit" in " ".join(study.refusals)


def test_methods_without_events_say_so_once():
    sticks = scene_of(tow_speed=0.5, start="rest", contact=po.StickSlip(1.2), damping=50.0, strength_wave=WAVE)
    study = po.study_accuracy(sticks, 0.05, outputs=2, allowance=0.1)
    refused = {entry.method: entry.failure for entry in study.entries if entry.failure and not entry.setting}
    assert set(refused) == METHODS - {"auto", "erk", "rosenbrock"}
    assert all("events" in reason for reason in refused.values())
    assert min(entry.error for entry in study.entries if entry.method == "auto") < 1e-9


def test_what_takes_too_long_is_left_out_with_a_reason():
    study = po.study_accuracy(scene_of(), 0.1, outputs=4, allowance=1e-9)
    left_out = [entry for entry in study.entries if entry.failure]
    assert {entry.method for entry in left_out} == METHODS
    assert all(" took " in entry.failure and math.isinf(entry.seconds) for entry in left_out)
    assert all(entry.setting.endswith("and finer") for entry in left_out)


WRONG = [
    ({"duration": None}, "duration is missing"),
    ({"wanted": 0.5}, "wanted error"),
    ({"scene": scene_of(strength_wave=WAVE, orbit="periodic")}, "omit the duration"),
    ({"scene": scene_of(stiffness=ca.MX.sym("k"))}, "holds symbols"),
    ({"scene": scene_of(motion=False)}, "no motion to integrate"),
    (
        {"scene": scene_of(stiffness=50.0, start="rest", formulation="printed"), "duration": 0.5},
        "drives the share away",
    ),
]


@pytest.mark.parametrize(("change", "said"), WRONG)
def test_wrong_inputs(change, said):
    given = {"scene": scene_of(), "duration": 0.1} | change
    with pytest.raises(po.PloughError, match=said):
        po.study_accuracy(given.pop("scene"), given.pop("duration"), **given)


# --- front, advice, table and picture of given figures ---


def made(*rows, wanted=1e-6):
    """Return a study of rows (method, setting, seconds, error)."""
    entries = tuple(MethodResult(m, s, t, {"averages": e, "forces": e}) for m, s, t, e in rows)
    return AccuracyStudy("made", 1.0, wanted, 1e-12, entries, ("a note",))


LOOSE, TIGHT, FINE = ("erk", "loose", 1e-3, 1e-3), ("erk", "tight", 2e-3, 1e-7), ("rk", "fine", 6e-3, 1e-8)
DEFAULT = ("auto", "error 1e-08", 0.1, 1e-10)
ADVICE = [
    ((LOOSE, TIGHT, FINE, DEFAULT), 1e-6,
     "for 1e-06 take erk, tight (2 ms, error 1e-07); the default, auto, error 1e-08 (100 ms, error 1e-10)."),
    ((LOOSE, DEFAULT), 1e-6, "for 1e-06 take auto, error 1e-08 (100 ms, error 1e-10); that is the default."),
    ((LOOSE, TIGHT), 1e-9, "nothing tried reaches 1e-09; the nearest is erk, tight (2 ms, error 1e-07)."),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "wanted", "said"), ADVICE)
def test_the_cheapest_good_setting_is_advised(rows, wanted, said):
    assert made(*rows, wanted=wanted).advice == said


def test_the_front_holds_what_nothing_beats_in_time_and_error():
    slower, below = ("erk", "slower", 3e-3, 1e-6), ("rk", "below the reference's error", 0.2, 1e-13)
    beyond = ("rk", "beyond it", 0.3, 1e-14)
    study = made(beyond, DEFAULT, slower, FINE, TIGHT, LOOSE, below)
    assert [entry.setting for entry in study.front] == ["loose", "tight", "fine", "error 1e-08", below[1]]


# --- of a design ---


def wells():
    """Return a design with two wells, whose guess lies in that of the worse one, and the objectives of both."""
    d, x = design(x=(-0.4, -1.0, 1.0))
    d.minimise((x**2 - 0.16) ** 2 - 0.02 * x)
    # Roots of f' = 4 x^3 - 0.64 x - 0.02.
    low, _, high = np.sort(np.roots([4.0, 0.0, -0.64, -0.02]).real)
    return d, *((x**2 - 0.16) ** 2 - 0.02 * x for x in (low, high))


def test_searches_are_right_as_often_as_they_find_the_best_well(tmp_path):
    d, value, least = wells()
    study = po.study_design(d, seeds=3, title="Two wells")
    near, *others = study.entries
    assert [entry.setting for entry in study.entries] == ["near", "250 designs", "1000 designs", "auto", "thorough"]
    assert (near.right, near.error) == (0.0, pytest.approx((value - least) / abs(least), rel=1e-6))
    assert all(entry.right == 1.0 and entry.error < 1e-8 and entry.designs > 0 for entry in others)
    assert study.cheapest in others
    assert "best design found by 100 %" in study.advice
    assert "designs tried" in str(study.page())
    assert study.plot(tmp_path / "chance.svg").axes[0].get_title() == "Two wells"
    # The design keeps its state.
    assert d.solve(search="near").objective == pytest.approx(value, rel=1e-8)


# --- the script that studies five scenes ---


@pytest.fixture
def cost():
    with imported("accuracy_cost") as module:
        yield module


def test_the_scenes_are_what_they_are_called(cost):
    smooth, stiff, resonant, sticks, entry = cost.scenes().values()
    assert float(stiff[0].natural_frequency) * stiff[1] / (2.0 * math.pi) == pytest.approx(1400, rel=0.05)
    assert float(resonant[0].natural_frequency) == pytest.approx(float(resonant[0].wave_frequency), rel=1e-12)
    assert set(po.simulate(*sticks, outputs=300).mode) == {0.0, 1.0}
    travel = po.simulate(*entry).travel
    assert travel[0] == 0.0 < entry[0].cone.height < travel[-1]
    assert float(smooth[0].natural_frequency) * smooth[1] < 100
