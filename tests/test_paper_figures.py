"""The source's figures, and each claim of its Discussion against a closed form or a measured trend."""

import math

import matplotlib.image
import numpy as np
import pytest
from helpers.scripts import imported
from scipy.optimize import minimize_scalar

import plough_opt as po

RATIOS = (0.2, 0.4, 0.6, 0.8, 0.95)
STIFFNESSES = (50.0, 200.0, 500.0)


@pytest.fixture(scope="module")
def paper():
    with imported("paper_figures") as module:
        yield module


def swings(paper, stiffness, ratios=RATIOS):
    return [paper.swing(paper.run(ratio, stiffness)) for ratio in ratios]


def without_drag(paper, ratio, stiffness):
    scene = paper.scene(ratio, stiffness, inertial_drag=False)
    return scene, paper.swing(po.simulate(scene, paper.DURATION, outputs=paper.OUTPUTS))


def rises(values):
    return bool(np.all(np.diff(values) > 0.0))


# --- without drag: z = z_s + A sin(omega t - phi) in closed form ---


@pytest.mark.parametrize("stiffness", STIFFNESSES)
@pytest.mark.parametrize("ratio", RATIOS)
def test_an_oscillation_without_drag_is_the_closed_form(paper, ratio, stiffness):
    scene, found = without_drag(paper, ratio, stiffness)
    inertia, steady = scene.inertia, scene.reaction.static / stiffness
    amplitude = math.sqrt(steady**2 + scene.tow_speed**2 * inertia / stiffness)
    # Turning points are interpolated over steps of 2 ms, at most 1/240 of a period.
    assert found.period == pytest.approx(2 * math.pi * math.sqrt(inertia / stiffness), rel=1e-5)
    assert found.displacement == pytest.approx(amplitude, rel=1e-5)
    assert found.last == pytest.approx(amplitude, rel=1e-5)
    assert found.force == pytest.approx(stiffness * amplitude, rel=1e-5)
    assert found.peak_force == pytest.approx(stiffness * (steady + amplitude), rel=1e-5)
    assert found.compressed == pytest.approx(0.5 + math.asin(steady / amplitude) / math.pi, abs=1e-4)
    retreat = math.hypot(scene.tow_speed, scene.natural_frequency * steady) - scene.tow_speed
    assert found.retreat == pytest.approx(retreat, abs=1e-4)


# --- (a) frequency against stiffness ---


@pytest.mark.parametrize("ratio", RATIOS)
def test_frequency_grows_as_the_root_of_the_stiffness(paper, ratio):
    soft, middle, stiff = (swings(paper, k, [ratio])[0].period for k in STIFFNESSES)
    # Drag lengthens the period in the second order of a damping ratio below 0.07.
    assert soft / middle == pytest.approx(2.0, rel=4e-3)
    assert soft / stiff == pytest.approx(math.sqrt(10.0), rel=4e-3)


# --- (b) period against density ratio ---


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_period_grows_with_the_density_ratio_by_less_than_a_percent(paper, stiffness):
    periods = [s.period for s in swings(paper, stiffness)]
    assert rises(periods)
    scenes = [paper.scene(ratio, stiffness) for ratio in RATIOS]
    by_mass = math.sqrt(scenes[-1].inertia / scenes[0].inertia) - 1
    assert by_mass == pytest.approx(0.0032, abs=5e-5)
    assert by_mass < periods[-1] / periods[0] - 1 < 0.007


# --- (c) displacement amplitude against density ratio ---


def test_on_a_soft_spring_the_amplitude_falls_and_then_rises(paper):
    amplitudes = [s.displacement for s in swings(paper, 50.0)]
    assert rises([-a for a in amplitudes[:4]])
    assert amplitudes[4] > amplitudes[3]
    assert amplitudes == pytest.approx([0.466, 0.463, 0.458, 0.453, 0.460], abs=5e-4)
    turn = minimize_scalar(
        lambda ratio: swings(paper, 50.0, [ratio])[0].displacement, bounds=(0.6, 0.95), options={"xatol": 1e-3}
    )
    assert turn.x == pytest.approx(0.867, abs=5e-3)


@pytest.mark.parametrize(("stiffness", "first", "last"), [(200.0, -0.038, -0.415), (500.0, -0.032, -0.427)])
def test_on_a_stiff_spring_the_amplitude_hardly_changes_at_first(paper, stiffness, first, last):
    own = swings(paper, stiffness)
    assert own[-1].displacement / own[0].displacement - 1 == pytest.approx(first, abs=5e-4)
    # Drag grows with b1 too, and separates the amplitudes after six oscillations.
    assert own[-1].last / own[0].last - 1 == pytest.approx(last, abs=2e-3)


@pytest.mark.parametrize("stiffness", [200.0, 500.0])
def test_on_a_stiff_spring_it_increases_only_beside_the_singularity(paper, stiffness):
    assert rises([-s.displacement for s in swings(paper, stiffness)])
    below, beside, nearer = (s.displacement for s in swings(paper, stiffness, (0.98, 0.995, 0.999)))
    assert below < beside < nearer
    with pytest.raises(po.DomainError, match="density ratio b1 = 1 must be below 1"):
        paper.scene(1.0, stiffness)


# --- (d) amplitudes against stiffness ---


@pytest.mark.parametrize("ratio", RATIOS)
def test_force_amplitude_grows_and_displacement_amplitude_falls_with_the_stiffness(paper, ratio):
    own = [swings(paper, k, [ratio])[0] for k in STIFFNESSES]
    assert rises([s.force for s in own])
    assert rises([-s.displacement for s in own])
    # Without static load they are V0 sqrt(k0 M) and V0 sqrt(M/k0); F0 increases and drag reduces them by up to 10 %.
    for s, k in zip(own, STIFFNESSES, strict=True):
        scene = paper.scene(ratio, k)
        assert s.force == pytest.approx(scene.tow_speed * math.sqrt(k * scene.inertia), rel=0.10)
    assert own[2].force / own[0].force == pytest.approx(math.sqrt(10.0), rel=0.06)
    assert own[2].displacement / own[0].displacement == pytest.approx(math.sqrt(0.1), rel=0.06)


# --- (e) compression against tension ---


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_the_spring_is_compressed_longer_than_pulled_and_more_so_with_the_density_ratio(paper, stiffness):
    own = swings(paper, stiffness)
    assert own[0].compressed > 0.5
    assert rises([s.compressed for s in own])
    assert rises([s.peak_force for s in own])
    # F0 alone gives 1/2 + atan(F0/(V0 sqrt(k0 M)))/pi; drag has one sign and increases that.
    for s, ratio in zip(own, RATIOS, strict=True):
        scene = paper.scene(ratio, stiffness)
        ratio_of_forces = scene.reaction.static / (scene.tow_speed * math.sqrt(stiffness * scene.inertia))
        assert s.compressed > 0.5 + math.atan(ratio_of_forces) / math.pi


# --- the values chosen ---


def test_comments_on_the_chosen_values_are_right(paper):
    scene, c = paper.scene(0.95, 50.0), paper.CHOICE
    assert math.degrees(scene.cone.half_angle) == pytest.approx(7.0, abs=0.05)
    assert scene.cone.solid_mass(7850.0) == pytest.approx(0.43, abs=0.01)
    # k0 V0 t reaches F0 within a tenth of a period.
    assert scene.reaction.static / (50.0 * c.tow_speed) == pytest.approx(0.135, abs=5e-4)
    assert 5 * scene.reaction.static == pytest.approx(68.0, abs=0.5)
    assert c.tow_speed * math.sqrt(50.0 * scene.inertia) == pytest.approx(24.6, abs=0.05)
    mu = math.sin(c.friction_angle)
    strength = 2 * c.cohesion * math.cos(c.friction_angle) / (1 + mu)
    assert 1 + 2 * mu / (1 + mu) * 101325.0 / strength == pytest.approx(60.0, abs=1.0)
    assert c.density / 2650.0 == pytest.approx(0.49, abs=1e-3)


# --- figure 3 ---


# --- printed and derived equation ---


def test_the_printed_share_runs_away_exponentially_and_with_drag_faster(paper):
    alone = paper.printed_run(formulation="printed", inertial_drag=False)
    scene, omega = alone.scene, alone.scene.natural_frequency
    steady, end = scene.reaction.static / scene.stiffness, paper.PRINTED_DURATION
    exact = steady * (math.cosh(omega * end) - 1) + scene.tow_speed / omega * math.sinh(omega * end)
    assert alone.deflection[-1] == pytest.approx(exact, rel=1e-7)
    decaying = (steady - scene.tow_speed / omega) / 2 * math.exp(-omega * end)
    assert paper.runaway(scene) * math.exp(omega * end) - steady + decaying == pytest.approx(exact, rel=1e-13)
    whole, derived = paper.printed_run(formulation="printed"), paper.printed_run()
    assert whole.deflection[-1] > 1.5 * exact
    assert whole.travel[-1] < -13.0 < 1.4 < derived.travel[-1]


# --- the script ---


def test_the_script_writes_every_picture_and_the_table(paper, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    paper.main(["--folder", str(tmp_path / "figures")])
    names = [f"figure_{n}.png" for n in range(1, 8)] + ["printed.png"]
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == sorted(names)
    for name in names:
        image = matplotlib.image.imread(tmp_path / "figures" / name)
        assert min(image.shape[:2]) > 400
        assert image[..., :3].std() > 0.05
    out = capsys.readouterr().out
    assert all(f"wrote {tmp_path / 'figures' / name}" in out for name in names)
    assert "does it follow?" in out
    assert "drives the share back: at up to 0.001, 0.004, 0.013, 0.051, 0.284 m/s" in out
