"""Means over broken and over whole strength waves: the warning, and average = "whole waves" in a file."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.problem_files import COTTON, SUBSOILER
from helpers.scenes import scene_of

import plough_opt as po
from plough_opt.problem_file.sweep import ProblemSweep

WHOLE = 'scene.average="whole waves"'
TWO = "effects.strength_wave_2={amplitude=0.1, wavelength='0.11 m'}"


def broken(run):
    """Return the change of the mean draft that a run warns of [%], and the duration of whole waves [s]; or None."""
    (found,) = [
        re.search(r"mean draft by (\S+) %.* waves of (\S+) s", text) for text in run.warnings if "wave" in text
    ] or [None]
    return None if found is None else (float(found[1]), float(found[2]))


@pytest.mark.parametrize("seed", range(12))
def test_a_broken_wave_is_pointed_out_if_it_matters(seed):
    rng = np.random.default_rng([32, 4, seed])
    wave = po.StrengthWave(float(rng.uniform(0.1, 0.9)), float(rng.uniform(0.1, 0.6)))
    effects = {"contact": po.StickSlip()} if seed % 4 == 3 else {"damping": float(rng.uniform(0.0, 500.0))}
    scene = scene_of(strength_wave=wave, **effects)
    period = wave.wavelength / scene.tow_speed
    duration = float(rng.uniform(1.1, 7.9)) * period
    run, whole = (po.simulate(scene, t, outputs=1000) for t in (duration, np.floor(duration / period) * period))
    percent = 100.0 * (run.mean_draft / whole.mean_draft - 1.0)
    if abs(percent) > 0.51:
        assert broken(run) == (pytest.approx(percent, rel=0.1), pytest.approx(float(whole.duration), rel=1e-3))
    elif abs(percent) < 0.49:
        assert broken(run) is None
    assert broken(whole) is None


def test_what_has_no_whole_wave_warns_of_none():
    for duration, effects in ((0.05, {"strength_wave": po.StrengthWave(0.5, 0.6)}), (0.77, {})):
        assert broken(po.simulate(scene_of(**effects), duration)) is None
    assert (
        broken(po.simulate(scene_of(strength_wave=po.StrengthWave(0.3, 0.2), orbit="periodic", damping=300.0))) is None
    )


AVERAGED = [
    (("scene.tow_speed=7.8 km/h",), 21 * 0.2 / (7.8 / 3.6)),
    (("scene.tow_speed=7.2 km/h",), 2.0),
    (("scene.duration=0.05 s",), 0.1),  # at least one wave
    (("scene.tow_speed=2.1 m/s", TWO), 21 * 0.2 / 2.1),  # the longest wave counts
]


@pytest.mark.parametrize(("changes", "expected"), AVERAGED)
def test_files_average_over_whole_waves(changes, expected):
    plain, whole = (po.read_problem(SUBSOILER, (*changes, *more)) for more in ((), (WHOLE,)))
    run = whole.simulate()
    assert run.duration == pytest.approx(expected, rel=1e-12)
    assert broken(run) is None
    by_hand = po.simulate(plain.scene(), expected)
    assert run.mean_draft == pytest.approx(by_hand.mean_draft, rel=1e-9)


def test_designs_sweeps_and_components_average_over_whole_waves():
    problem = po.read_problem(SUBSOILER, [WHOLE, "scene.duration=0.5 s"])
    speeds = [1.0, 1.3, 1.7, 2.3]
    each = [problem.simulate({"scene.tow_speed": speed}) for speed in speeds]
    assert [run.duration for run in each] == pytest.approx([np.floor(0.5 * v / 0.2 + 1e-9) * 0.2 / v for v in speeds])
    batch = ProblemSweep.of(problem, {"scene.tow_speed": speeds}, method="batch").evaluation
    found, _, _ = batch.many(np.array(speeds)[:, None])
    assert found[:, 0] == pytest.approx([run.mean_draft for run in each], rel=1e-5)
    component = problem.component(["scene.tow_speed"], ["mean_draft"])
    assert float(component(scene_tow_speed=1.7)["mean_draft"]) == pytest.approx(each[2].mean_draft, rel=1e-5)
    design, run = problem.design(parameters=True)
    assert "scene.duration" not in {p.name for p in design.declared.parameters if ca.depends_on(ca.jacobian(
        run.duration, p.symbol), p.symbol)}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "word"),
    [((WHOLE, "effects={}"), "strength wave"), ((WHOLE, "effects.orbit=periodic"), "transient"),
     (("scene.average=mean",), "whole waves")],
)  # fmt: skip
def test_whole_waves_of_nothing_are_refused(changes, word):
    with pytest.raises(po.InputError, match=word):
        po.read_problem(SUBSOILER, changes)


def test_the_frame_has_one_average(refusal_of_shares):
    assert "frame" in refusal_of_shares('scene.average = "whole waves"')


@pytest.fixture
def refusal_of_shares(tmp_path):
    """Return the message with which a line in the table of a share is refused."""

    def refusal(line):
        path = tmp_path / "shares.toml"
        path.write_text(f"{COTTON}\n[shares.front]\n{line}\n[shares.rear]\n", encoding="utf-8")
        with pytest.raises(po.InputError) as caught:
            po.read_problem(path)
        return str(caught.value)

    return refusal


def test_the_optimum_does_not_depend_on_the_duration_of_whole_waves():
    problem = po.read_problem(SUBSOILER, [WHOLE, "scene.duration=0.45 s", "scene.tow_speed=2.1 m/s"])
    best, _ = problem.optimise(search="near", parameters=True)
    assert best.sensitivity("scene.duration").elasticity == pytest.approx(0.0, abs=1e-9)
    plain, _ = replace(problem, table=po.read_problem(SUBSOILER).table).optimise(search="near", parameters=True)
    assert abs(plain.sensitivity("scene.duration").elasticity) > 1e-4
