"""Strength factor and density ratio from a penetrometer and the width of a trench, with intervals."""

import dataclasses
import math

import numpy as np
import pytest
from helpers.problem_files import STATIC, changed

import plough_opt as po

BASE = dataclasses.replace(po.named_soil("firm sandy loam"), ambient_pressure=5e3)
CONE = po.Cone(po.deg(13.0), 0.24)
SCENE = po.Scene(BASE, CONE, 5e5, 60.0, 1.4, po.Effects(motion=False))
UNKNOWN = {"soil.strength_factor": (0.1, 200.0), "soil.density_ratio": (0.4, 0.97)}
INDEX, RADIUS = 1.6e6, 0.15


def index_of(density_ratio):
    """Return the law's cone index [Pa] at a density ratio, which tests/test_cone_index.py compares with mpmath."""
    return po.cone_index(dataclasses.replace(BASE, density_ratio=density_ratio))


def ratio_of(radius, cone=CONE):
    """Return the density ratio at which a cone loosens a radius [m]: r* = h tan(beta)/sqrt(1 - b1)."""
    return 1.0 - (cone.height * math.tan(cone.half_angle) / radius) ** 2


def fitted(indices, radii, errors):
    columns = zip(("cone_index", "loosened_radius"), (indices, radii), errors, strict=True)
    return po.calibrate(SCENE, [po.Measurements(name, own, sigma=error) for name, own, error in columns], UNKNOWN)


def test_one_reading_of_each_determines_both():
    fit = fitted([INDEX], [RADIUS], (1e-3 * INDEX, 1e-3 * RADIUS))
    ratio = ratio_of(RADIUS)
    truth = {"soil.strength_factor": INDEX / index_of(ratio), "soil.density_ratio": ratio}
    assert fit.values == pytest.approx(truth, rel=1e-7)  # of the least squares' steps
    assert [po.cone_index(fit.soil), po.loosened_radius(CONE, fit.soil)] == pytest.approx([INDEX, RADIUS], rel=1e-7)
    # Each prediction has the variance of its own reading, which a second one halves.
    gains = {item.candidate.describe(): item.information for item in fit.next_measurements()}
    assert gains["loosened_radius again"] == pytest.approx(0.5 * math.log(2.0), rel=1e-3)
    assert fit.plot().axes[2].get_xlabel() == "number of the row"
    with pytest.raises(po.InputError, match="2 folds leave fewer rows than unknowns"):
        fit.cross_validation()


def test_intervals_agree_with_error_propagation():
    """By hand: 1 - b1 goes with r^-2; the strength factor with the reading, and against the law's index at that b1."""
    fit = fitted([INDEX], [RADIUS], (1e5, 2e-3))
    ratio = ratio_of(RADIUS)
    of_ratio = 2.0 * (1.0 - ratio) * 2e-3 / RADIUS
    slope = math.log(index_of(ratio + 1e-5) / index_of(ratio - 1e-5)) / 2e-5
    found = fit.intervals(kind="linearised")
    width = found["soil.density_ratio"].upper - found["soil.density_ratio"].lower
    assert width / 2.0 == pytest.approx(1.959964 * of_ratio, rel=1e-5)
    # What has bounds that are far apart is fitted by its logarithm.
    width = math.log(found["soil.strength_factor"].upper / found["soil.strength_factor"].lower)
    assert width / 2.0 == pytest.approx(1.959964 * math.hypot(1e5 / INDEX, slope * of_ratio), rel=1e-5)


@pytest.mark.slow  # by default test_linear.py stands for it
def test_the_intervals_hold_the_truth():
    """Eight insertions and three widths of a known soil: 95 +- 3 % of the 95 % intervals hold the truth."""
    true = dataclasses.replace(BASE, density_ratio=0.85, strength_factor=20.0)
    index, radius = po.cone_index(true), po.loosened_radius(CONE, true)
    trials, rng, inside = 500, np.random.default_rng(4), np.zeros(2)
    for _ in range(trials):
        indices, radii = (x * (1.0 + s * rng.standard_normal(n)) for x, s, n in ((index, 0.12, 8), (radius, 0.03, 3)))
        found = fitted(indices, radii, (0.12 * index, 0.03 * radius)).intervals()
        inside += [20.0 in found["soil.strength_factor"], 0.85 in found["soil.density_ratio"]]
    assert np.all(np.abs(inside / trials - 0.95) <= 0.03), inside / trials


def test_with_the_cone_index_in_the_file_the_trench_gives_the_density_ratio(tmp_path):
    """With the reading in the file the width decides b1, and the strength factor follows from both."""
    path = tmp_path / "share.toml"
    soil = 'name = "firm sandy loam"\nambient_pressure = "5 kPa"\ncone_index = "1.6 MPa"'
    path.write_text(changed(('name = "serozem"', soil), text=STATIC), encoding="utf-8")
    problem = po.read_problem(path)
    data = po.Measurements("loosened_radius", [RADIUS], sigma=3e-3)
    fit = po.calibrate(problem, data, {"soil.density_ratio": (0.4, 0.97)})
    ratio = fit.values["soil.density_ratio"]
    soil = problem.scene({"share.height": 0.24, "soil.density_ratio": ratio}).soil
    assert po.cone_index(soil) == pytest.approx(INDEX, rel=1e-12)
    assert soil.strength_factor == pytest.approx(INDEX / index_of(ratio), rel=1e-9)
