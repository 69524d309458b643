"""The larger design: parts against closed forms, a certified optimum, and no better design by brute force."""

import matplotlib.image
import numpy as np
import pytest
from helpers.scripts import imported

import plough_opt as po


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


# --- the optimum ---


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


@pytest.mark.slow
def test_the_script_prints_certifies_and_draws(frame, tmp_path, capsys):
    with imported("subsoiler_frame_picture"):
        frame.main(["--check", "--plot", str(tmp_path / "frame.png")])
    said = capsys.readouterr().out
    assert "MJ/ha" in said
    assert "no limit balances" in said
    assert matplotlib.image.imread(tmp_path / "frame.png").std() > 0.1
