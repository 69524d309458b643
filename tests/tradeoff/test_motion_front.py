"""The front of a problem file: its parts on either side of a ridge, and its points by another method of integration."""

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS

import plough_opt as po
from plough_opt.problem_file.sweep import SimulationOfMany

FILE = PROBLEMS / "force_against_deflection.toml"


def test_parts_on_either_side_of_the_ridge_are_certified():
    """Mean deflection against the force's oscillation: soft mounts, and one as stiff as its bound."""
    # The first number of steps leaves an error of 2e-12, so the front is refined once.
    changes, told = ["trade_off.points=17", "accuracy.error=1e-12"], []
    front = po.read_problem(FILE, changes).trade_off(progress=lambda step, done: told.append((step, done)))
    assert (told[0], told.count(("refining", 0.0))) == (("building the model", 0.0), 1)
    assert all(0.0 <= done < 1.0 for _, done in told)
    assert front.parts[0] == (0,)
    assert [front.points[0].branch, *{front.points[k].branch for k in front.parts[1]}] == ["stiff", "soft"]
    assert front.points[0].variables["scene.stiffness"] == pytest.approx(5e5, rel=1e-6)
    assert (front.holes[0].settled, front.failures) == (True, ())
    # On the soft side the part begins where the oscillation is that of the stiff mount.
    assert front.objectives[1, 1] == pytest.approx(front.objectives[0, 1], rel=1e-6)
    # The stiffness is the only limit that decides some designs and not all: those at its bounds.
    rows = str(front).splitlines()[3 : 3 + len(front.points)]
    assert [row.split()[-1] for row in rows] == ["1", *["soft"] * (len(rows) - 2), "1"]
    assert "limits: 1 stiffness" in str(front)
    for point in front.points:
        assert point.gap < 1e-12
        assert max(point.violation, point.residual) < 1e-9
        assert {"loosened_radius", "half_angle"} <= set(point.active)
    many = SimulationOfMany(po.read_problem(FILE), tuple(axis.name for axis in front.variables))
    found = dict(zip(many.results, many.many(front.designs)[0].T, strict=True))
    # Another method of integration, to the error that it promises.
    assert np.column_stack([found["mean_deflection"], found["force_rms"]]) == pytest.approx(front.objectives, rel=1e-6)
