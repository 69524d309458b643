"""The scripts of problems/: the paper's figures, the larger design, particles and measurements."""

import math
import re

import matplotlib.image
import numpy as np
import pytest
from helpers.linear_motion import oscillation
from helpers.scripts import imported

import plough_opt as po

# --- the source's figures, and each claim of its Discussion against a closed form or a measured trend ---


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


@pytest.mark.parametrize(("stiffness", "first", "last"), [(200.0, -0.038, -0.415), (500.0, -0.032, -0.427)])
def test_on_a_stiff_spring_the_amplitude_increases_only_beside_the_singularity(swings, stiffness, first, last):
    amplitudes, later = (values(swings(stiffness), name) for name in ("displacement", "last"))
    assert rises(-amplitudes)
    assert amplitudes[-1] / amplitudes[0] - 1 == pytest.approx(first, abs=5e-4)
    # Drag grows with b1 too, and separates the amplitudes after six oscillations.
    assert later[-1] / later[0] - 1 == pytest.approx(last, abs=2e-3)
    assert rises(values(swings(stiffness, (0.98, 0.995, 0.999)), "displacement"))


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


# --- the larger design: parts against closed forms, a certified optimum, and no better design by brute force ---


@pytest.fixture(scope="module")
def frame():
    with imported("subsoiler_frame") as module, imported("subsoiler_frame_check") as module.checks:
        yield module


@pytest.fixture(scope="module")
def checks(frame):
    return frame.checks


@pytest.fixture(scope="module")
def solved(frame):
    d, c, m = frame.design()
    return c, m, d.solve(search="local")


def free(checks, best):
    return np.array([[best.variables[name]] for name in checks.FREE])


# --- parts ---


def test_moments_are_those_of_textbook_beams(frame):
    # A load P in the middle of a span 2b: sagging P b / 2. At a distance a outside a bracket: -P a at the bracket.
    assert frame.moments([0.0], [10.0], 2.0) == pytest.approx([-10.0, 0.0, 0.0])
    assert frame.moments([-3.0, 3.0], [10.0, 10.0], 2.0) == pytest.approx([0.0, 0.0, 10.0, 10.0])


def test_traction_by_hand(frame):
    # Bn = 50, slip 10 %: gross 0.88 (1 - e^-5) (1 - e^-0.75) + 0.04, resistance 0.02 + 0.04 + 0.05 / 7.07.
    weight = frame.TRACTOR * frame.GRAVITY
    gross, net = frame.traction(0.1, weight)
    assert gross / weight == pytest.approx(0.88 * 0.99326205 * 0.52763345 + 0.04, rel=1e-7)
    assert (gross - net) / weight == pytest.approx(0.06 + 0.05 / 50**0.5, rel=1e-12)


def test_the_motion_in_numpy_converges_to_the_orbit_with_order_4(frame, checks):
    scene = po.Scene(frame.soil(0.5), po.Cone(0.26, 0.35), 3e5, 80.0, 1.4, frame.EFFECTS)
    orbit = po.simulate(scene)
    errors = [abs(checks.settled_averages(scene, 12, steps).force_rms / orbit.force_rms - 1.0) for steps in (32, 64)]
    assert errors[1] < 5e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)
    assert checks.settled_averages(scene, 12, 64).mean_draft == pytest.approx(orbit.mean_draft, rel=1e-6)


# --- the optimum, whose solve takes longer than all other tests of this file ---


@pytest.mark.thorough
def test_the_optimum_is_certified(checks, solved):
    c, m, best = solved
    assert best.status == "solved"
    # The tolerances of the optimiser are 1e-10 in scaled values.
    assert checks.least_margin(m, best) > -1e-9
    assert checks.kkt_residual(c, m, best) < 1e-8
    assert max(best.gap, best.error_estimate) < 1e-8
    assert set(best.active) == {"half angle", "loosened overlap", "oscillation", "stress", "grip", "power"}


def test_numpy_alone_gives_the_same_fuel(checks, solved):
    _, m, best = solved
    found = checks.evaluate(free(checks, best), len(m.scenes))
    # By Runge-Kutta steps the error of mean drafts is 1e-7, and that of the active oscillation limit 3e-5.
    assert found.fuel[0] == pytest.approx(best(m.fuel), rel=1e-6)
    assert found.worst[0] < 5e-5
    for name in ("height", "tube", "slip"):
        assert getattr(found.variables, name)[0] == pytest.approx(best.variables[name], rel=5e-5)


def test_no_design_near_the_optimum_is_better(checks, solved):
    _, m, best = solved
    random = np.random.default_rng(3).uniform(-1.0, 1.0, (len(checks.FREE), 1500))
    # Designs at different distances; blunter shares violate the half angle.
    rows = free(checks, best) * (1.0 + random * np.geomspace(1e-3, 0.2, random.shape[1]))
    found = checks.evaluate(rows, len(m.scenes))
    excess = found.fuel[found.worst <= 1e-9] / best(m.fuel) - 1.0
    assert excess.size > 20
    # The error of 3e-5 in the oscillation changes the fuel by less than 1e-6.
    assert -1e-6 < excess.min() < 0.01


@pytest.mark.slow
def test_brute_force_finds_the_same_design(checks, solved):
    _, m, best = solved
    found, tried = checks.brute_force(len(m.scenes))
    assert tried > 10_000
    assert -1e-6 < found.fuel / best(m.fuel) - 1.0 < 1e-3
    assert found.variables["spacing"] == pytest.approx(best.variables["spacing"], rel=0.05)


# --- the command ---


def test_costs_are_printed_in_units_of_an_import(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["what_it_costs.py", "--times", "1", "--only=-version"])
    with imported("what_it_costs") as module:
        module.main()
    row = re.search(r"\| `plough-opt --version` \| (\S+) \| (\d+) \|", capsys.readouterr().out)
    assert all(float(number) > 0.0 for number in row.groups())
