"""The front of a problem file: against brute force over all designs of a grid, and by another method of integration."""

from pathlib import Path

import numpy as np
import pytest

import plough_opt as po
from plough_opt.problem_file.evaluations import SimulationOfMany
from plough_opt.studies.tradeoff.domination import undominated_in_order

FILE = Path(__file__).parents[2] / "problems" / "force_against_deflection.toml"


@pytest.fixture(scope="module")
def front():
    """Front of the mean deflection against the force's oscillation: soft mounts, and one as stiff as its bound."""
    return po.read_problem(FILE, ["trade_off.points=17"]).trade_off()


@pytest.fixture(scope="module")
def batch():
    """Return a function that returns the results of wedge angles, heights and stiffnesses by `po.Batch`."""
    many = SimulationOfMany(po.read_problem(FILE), ("share.wedge_angle", "share.height", "scene.stiffness"))

    def results(designs):
        found, failures, _ = many.many(designs)
        assert failures == {}
        return dict(zip(many.results, found.T, strict=True))

    return results


def test_a_grid_has_no_better_design_and_its_efficient_ones_lie_on_the_front(front, batch):
    widest, shortest = front.designs[0, :2]
    heights = shortest * np.array([1.0, 1.01, 1.03, 1.1, 1.3, 1.8, 2.4])
    axes = np.meshgrid(widest * np.linspace(0.4, 1.0, 7), heights, np.geomspace(3e3, 5e5, 500), indexing="ij")
    found = batch(np.stack(axes, axis=-1).reshape(-1, 3))
    feasible = (found["loosened_radius"] >= 0.12 - 1e-9) & (found["half_angle"] <= po.deg(15.0) + 1e-9)
    grid = np.column_stack([found["mean_deflection"], found["force_rms"]])[feasible]
    assert len(grid) > 5_000
    for point in front.objectives:
        # The batch is exact to 1e-8, and the optimiser keeps 1e-9 of the requirements.
        assert not np.any(np.all(grid < point * (1.0 - 1e-6), axis=1))
    soft = front.objectives[list(front.parts[1])]
    best = grid[undominated_in_order((grid - grid.min(axis=0)) / np.ptp(grid, axis=0))]
    inside = best[best[:, 0] > soft[0, 0]]
    assert len(inside) > 50
    # Lines between the front's points lie above the curve by an eighth of its curvature times their length squared.
    assert inside[:, 1] == pytest.approx(np.interp(inside[:, 0], *soft.T), rel=2e-3)
    # The others have the stiffest mount, so the grid has no efficient design in the hole either.
    (hole,) = front.holes
    assert np.all(best[best[:, 0] <= soft[0, 0], 0] <= hole.start[0] * (1.0 + 1e-6))


def test_parts_on_either_side_of_the_ridge_are_certified(front, batch):
    assert front.parts[0] == (0,)
    assert [front.points[0].branch, *{front.points[k].branch for k in front.parts[1]}] == ["stiff", "soft"]
    assert front.points[0].variables["scene.stiffness"] == pytest.approx(5e5, rel=1e-6)
    assert (front.holes[0].settled, front.failures) == (True, ())
    # On the soft side the part begins where the oscillation is that of the stiff mount.
    assert front.objectives[1, 1] == pytest.approx(front.objectives[0, 1], rel=1e-6)
    for point in front.points:
        assert point.gap < 1e-8
        assert max(point.violation, point.residual) < 1e-9
        assert {"loosened_radius", "half_angle"} <= set(point.active)
    found = batch(front.designs)
    # Another method of integration, to the error that it promises.
    assert np.column_stack([found["mean_deflection"], found["force_rms"]]) == pytest.approx(front.objectives, rel=1e-6)
