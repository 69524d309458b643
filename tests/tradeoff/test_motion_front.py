"""The front of a problem file: its parts on either side of a ridge, and its points by another method of integration."""

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS

import plough_opt as po
from plough_opt.problem_file.evaluations import SimulationOfMany


def test_parts_on_either_side_of_the_ridge_are_certified():
    """Mean deflection against the force's oscillation: soft mounts, and one as stiff as its bound."""
    problem = po.read_problem(PROBLEMS / "force_against_deflection.toml", ["trade_off.points=17"])
    front = problem.trade_off()
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
    many = SimulationOfMany(problem, tuple(axis.name for axis in front.variables))
    found = dict(zip(many.results, many.many(front.designs)[0].T, strict=True))
    # Another method of integration, to the error that it promises.
    assert np.column_stack([found["mean_deflection"], found["force_rms"]]) == pytest.approx(front.objectives, rel=1e-6)
