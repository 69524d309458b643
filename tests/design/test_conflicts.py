"""Conflicts that are there and conflicts that are not, against brute force by the independent simulator."""

import numpy as np
import pytest
from independent.build import as_design
from independent.fronts import objectives_of
from independent.problem import Limit, Problem, Variable, box_sample, measure
from independent.truth import sample

import plough_opt as po

# Of a range: by so much a design of the sample may be better.
BEATEN = 1e-3
_NEEDLE = 0.05


def mount(variables, limits, *, chisel, speed, damping, mass=0.0, **others):
    """Return a problem of a share under a wave, from equilibrium."""
    fixed = {"chisel angle": chisel, "tow speed": speed, "damping": damping, "ramp time": 0.0, "frame mass": mass}
    fixed = {k: v for k, v in fixed.items() if k not in [own.name for own in variables]}
    names = {"force_rms": 1.0, "mean_deflection": 1.0}
    return Problem("mount", fixed=fixed, variables=variables, limits=limits, objective=names, **others)


ANGLE = Variable("wedge angle", np.radians(5.0), np.radians(60.0), np.radians(25.0), False)
HEIGHT = Variable("height", 0.1, 0.5, 0.25, False)
FLAT = Limit("half angle", "at_most", np.radians(15.0))


def test_no_conflict_is_said_only_where_needles_alone_conflict():
    problem = mount(
        (ANGLE, HEIGHT, Variable("stiffness", 2e4, 5e6, 1e5, True)),
        (Limit("loosened radius", "at_least", 0.14), FLAT),
        soil=(1600.0, 0.914, 35e3, np.radians(32.0), 0.5, 101325.0),
        chisel=np.radians(12.0), speed=1.2, wave=(0.4, 0.25), damping=100.0, mass=60.0,
    )  # fmt: skip
    design, run = as_design(problem)
    front = po.trade_off(design, po.Goal("deflection", run.mean_deflection), po.Goal("force", run.force_rms))
    best = np.array(front.points[0].objectives)
    assert len(front.points) == 1
    assert front.notes[0] == "'deflection' and 'force' do not conflict: one design is best in both"
    y = sample(problem, 15, np.random.default_rng(0))
    y = np.vstack([y, problem.positions([[0.6545926, 0.1692840, 20000.0]])])
    found = objectives_of(problem, ("mean_deflection", "force_rms"), y)
    assert np.all(found[:, 0] >= best[0] * (1.0 - BEATEN))
    less = np.flatnonzero(found[:, 1] < best[1] * (1.0 - BEATEN))
    assert len(less) > 0
    for k in less:
        box = measure(problem, box_sample(problem, y[k], 64), 1.6)["force_rms"]
        assert np.median(box) > found[k, 1] * (1.0 + _NEEDLE)


@pytest.mark.slow
def test_more_mass_on_a_softer_mount_conflicts():
    problem = mount(
        (ANGLE, HEIGHT, Variable("stiffness", 1e4, 1e6, 1e5, True), Variable("frame mass", 10.0, 120.0, 50.0, False)),
        (FLAT, Limit("loosened radius", "at_least", 0.1), Limit("mean_deflection", "at_most", 0.06)),
        soil=(1300.0, 0.722, 5e3, np.radians(30.0), 0.4, 5e3),
        chisel=np.radians(10.0), speed=1.5, wave=(0.3, 0.4), damping=150.0, duration=1.5, steel=False,
    )  # fmt: skip
    design, run = as_design(problem)
    (mass,) = [v.symbol for v in design.declared.variables if v.name == "frame mass"]
    front = po.trade_off(design, po.Goal("force", run.force_rms), po.Goal("mass", mass))
    found = objectives_of(problem, ("force_rms", "mean_deflection"), sample(problem, 15, np.random.default_rng(0)))
    least = front.points[0]
    assert least.variables["frame mass"] == pytest.approx(120.0)
    assert least.objectives[0] <= np.min(found[:, 0])
    assert len(front.points) > 20
