"""The source's figures, and each claim of its Discussion against a closed form or a measured trend."""

import math

import matplotlib.image
import numpy as np
import pytest
from helpers.linear_motion import oscillation
from helpers.scripts import imported
from scipy.optimize import minimize_scalar

import plough_opt as po

RATIOS = (0.2, 0.4, 0.6, 0.8, 0.95)
STIFFNESSES = (50.0, 200.0, 500.0)


@pytest.fixture(scope="module")
def paper():
    with imported("paper_figures") as module:
        yield module


@pytest.fixture(scope="module")
def swings(paper):
    """Return the first oscillations on a mount, by the density ratios."""
    return lambda stiffness, ratios=RATIOS: [paper.swing(paper.run(ratio, stiffness)) for ratio in ratios]


def values(swings, name):
    return np.array([getattr(one, name) for one in swings])


def rises(values):
    return bool(np.all(np.diff(values) > 0.0))


# --- without drag: z = z_s + A sin(omega t - phi) in closed form ---


@pytest.mark.parametrize("stiffness", STIFFNESSES)
@pytest.mark.parametrize("ratio", RATIOS)
def test_an_oscillation_without_drag_is_the_closed_form(paper, ratio, stiffness):
    scene = paper.scene(ratio, stiffness, inertial_drag=False)
    found = paper.swing(po.simulate(scene, paper.DURATION, outputs=paper.OUTPUTS))
    inertia, steady = scene.inertia, scene.reaction.static / stiffness
    amplitude = math.sqrt(steady**2 + scene.tow_speed**2 * inertia / stiffness)
    # Turning points are interpolated over steps of 2 ms, at most 1/240 of a period.
    assert found.period == pytest.approx(2 * math.pi * math.sqrt(inertia / stiffness), rel=1e-5)
    assert (found.displacement, found.last) == pytest.approx((amplitude, amplitude), rel=1e-5)
    assert found.force == pytest.approx(stiffness * amplitude, rel=1e-5)
    assert found.peak_force == pytest.approx(stiffness * (steady + amplitude), rel=1e-5)
    assert found.compressed == pytest.approx(0.5 + math.asin(steady / amplitude) / math.pi, abs=1e-4)
    retreat = math.hypot(scene.tow_speed, scene.natural_frequency * steady) - scene.tow_speed
    assert found.retreat == pytest.approx(retreat, abs=1e-4)


# --- the claims of the Discussion ---


def test_frequency_grows_as_the_root_of_the_stiffness(swings):
    soft, middle, stiff = (values(swings(k), "period") for k in STIFFNESSES)
    # Drag lengthens the period in the second order of a damping ratio below 0.07.
    assert soft / middle == pytest.approx(2.0, rel=4e-3)
    assert soft / stiff == pytest.approx(math.sqrt(10.0), rel=4e-3)


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_period_grows_with_the_density_ratio_by_less_than_a_percent(paper, swings, stiffness):
    periods = values(swings(stiffness), "period")
    assert rises(periods)
    by_mass = math.sqrt(paper.scene(RATIOS[-1], stiffness).inertia / paper.scene(RATIOS[0], stiffness).inertia) - 1
    assert by_mass == pytest.approx(0.0032, abs=5e-5)
    assert by_mass < periods[-1] / periods[0] - 1 < 0.007


def test_on_a_soft_spring_the_amplitude_falls_and_then_rises(swings):
    amplitudes = values(swings(50.0), "displacement")
    assert amplitudes == pytest.approx([0.466, 0.463, 0.458, 0.453, 0.460], abs=5e-4)
    turn = minimize_scalar(lambda b1: swings(50.0, [b1])[0].displacement, bounds=(0.6, 0.95), options={"xatol": 1e-3})
    assert turn.x == pytest.approx(0.867, abs=5e-3)


@pytest.mark.parametrize(("stiffness", "first", "last"), [(200.0, -0.038, -0.415), (500.0, -0.032, -0.427)])
def test_on_a_stiff_spring_the_amplitude_increases_only_beside_the_singularity(swings, stiffness, first, last):
    amplitudes, later = (values(swings(stiffness), name) for name in ("displacement", "last"))
    assert rises(-amplitudes)
    assert amplitudes[-1] / amplitudes[0] - 1 == pytest.approx(first, abs=5e-4)
    # Drag grows with b1 too, and separates the amplitudes after six oscillations.
    assert later[-1] / later[0] - 1 == pytest.approx(last, abs=2e-3)
    assert rises(values(swings(stiffness, (0.98, 0.995, 0.999)), "displacement"))


def test_force_amplitude_grows_and_displacement_amplitude_falls_with_the_stiffness(paper, swings):
    rows = [swings(k) for k in STIFFNESSES]
    force, displacement = (np.array([values(row, name) for row in rows]) for name in ("force", "displacement"))
    assert rises(force.T)
    assert rises(-displacement.T)
    # Without static load they are V0 sqrt(k0 M) and V0 sqrt(M/k0); F0 increases and drag reduces them by up to 10 %.
    scenes = [[paper.scene(ratio, k) for ratio in RATIOS] for k in STIFFNESSES]
    unloaded = [[scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia) for scene in row] for row in scenes]
    np.testing.assert_allclose(force, unloaded, rtol=0.10)
    assert force[2] / force[0] == pytest.approx(math.sqrt(10.0), rel=0.06)
    assert displacement[2] / displacement[0] == pytest.approx(math.sqrt(0.1), rel=0.06)


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_the_spring_is_compressed_longer_than_pulled_and_more_so_with_the_density_ratio(paper, swings, stiffness):
    own = swings(stiffness)
    assert own[0].compressed > 0.5
    assert rises(values(own, "compressed"))
    assert rises(values(own, "peak_force"))
    # F0 alone gives 1/2 + atan(F0/(V0 sqrt(k0 M)))/pi; drag has one sign and increases that.
    for one, ratio in zip(own, RATIOS, strict=True):
        scene = paper.scene(ratio, stiffness)
        ratio_of_forces = scene.reaction.static / (scene.tow_speed * math.sqrt(stiffness * scene.inertia))
        assert one.compressed > 0.5 + math.atan(ratio_of_forces) / math.pi


# --- printed and derived equation ---


def test_the_printed_share_runs_away_exponentially_and_with_drag_faster(paper):
    alone = paper.printed_run(formulation="printed", inertial_drag=False)
    scene, omega = alone.scene, alone.scene.natural_frequency
    exact, _ = oscillation(scene, paper.PRINTED_DURATION)
    assert alone.deflection[-1] == pytest.approx(exact, rel=1e-7)
    late = 30.0 / omega  # when the rest has decayed
    assert paper.runaway(scene) * math.exp(30.0) == pytest.approx(oscillation(scene, late)[0], rel=1e-12)
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
