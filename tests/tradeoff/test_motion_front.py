"""A front of a motion: against brute force over all designs of a grid, and against its own neighbours."""

import numpy as np
import pytest

import plough_opt as po
from plough_opt.studies.tradeoff.domination import undominated_in_order


@pytest.fixture(scope="module")
def grid(soft_or_stiff, r1_soil):
    """Return deflection and force oscillation of all feasible designs of a grid."""
    front = soft_or_stiff.front
    widest, shortest = front.designs[0, 0], front.designs[0, 1]
    angles = np.linspace(0.4, 1.0, 16) * widest
    heights = shortest * np.r_[1.0, 1.01, 1.03, 1.1, 1.2, 1.3, 1.5, 1.8, 2.1, 2.4]
    stiffness = np.geomspace(3e3, 5e5, 1000)
    designs = np.stack(np.meshgrid(angles, heights, stiffness, indexing="ij"), axis=-1).reshape(-1, 3)
    cone = po.Wedge(designs[:, 0], po.deg(15.0), designs[:, 1]).equivalent_cone()
    feasible = (po.loosened_radius(cone, r1_soil) >= 0.12 - 1e-9) & (cone.half_angle <= po.deg(15.0) + 1e-9)
    result = soft_or_stiff.batch(designs[feasible])
    assert not result.failed.any()
    return np.column_stack([result.mean_deflection, result.force_rms])


def test_no_design_of_the_grid_is_better(soft_or_stiff, grid):
    assert len(grid) > 50_000
    front = soft_or_stiff.front.objectives
    for point in front:
        # The batch is exact to 1e-8, and the optimiser keeps 1e-9 of the requirements.
        assert not np.any(np.all(grid < point * (1.0 - 1e-6), axis=1))


def test_efficient_designs_of_the_grid_lie_on_the_front(soft_or_stiff, grid):
    front = soft_or_stiff.front
    soft = front.objectives[list(front.parts[1])]
    scaled = (grid - grid.min(axis=0)) / np.ptp(grid, axis=0)
    best = grid[undominated_in_order(scaled)]
    inside = best[best[:, 0] > soft[0, 0]]
    assert len(inside) > 50
    # Lines between the front's points lie above the curve by an eighth of its curvature times their length squared.
    expected = np.interp(inside[:, 0], soft[:, 0], soft[:, 1])
    assert inside[:, 1] == pytest.approx(expected, rel=2e-3)
    # The others have the stiffest mount, so the grid has no efficient design in the hole either.
    (hole,) = front.holes
    assert np.all(best[best[:, 0] <= soft[0, 0], 0] <= hole.start[0] * (1.0 + 1e-6))


def test_parts_on_either_side_of_the_ridge(soft_or_stiff):
    front = soft_or_stiff.front
    assert front.parts[0] == (0,)
    assert front.points[0].branch == "stiff"
    assert {front.points[k].branch for k in front.parts[1]} == {"soft"}
    assert front.points[0].variables["stiffness"] == pytest.approx(5e5, rel=1e-6)
    assert front.holes[0].settled
    # On the soft side the part begins where the oscillation is that of the stiff mount.
    assert front.objectives[1, 1] == pytest.approx(front.objectives[0, 1], rel=1e-6)
    assert front.failures == ()


def test_points_are_certified_by_tight_integration(soft_or_stiff):
    for point in soft_or_stiff.front.points:
        assert point.gap < 1e-8
        assert point.violation < 1e-9
        assert point.residual < 1e-9
        assert {"loosened radius", "half angle"} <= set(point.active)
    best = soft_or_stiff.batch(soft_or_stiff.front.designs)
    # Another method of integration, to the error that it promises.
    assert best.force_rms == pytest.approx(soft_or_stiff.front.objectives[:, 1], rel=1e-6)
    assert best.mean_deflection == pytest.approx(soft_or_stiff.front.objectives[:, 0], rel=1e-6)
