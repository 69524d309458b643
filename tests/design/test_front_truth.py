"""Fronts and surfaces against brute force by the independent simulator."""

from itertools import pairwise

import numpy as np
import pytest
from independent import fast, study
from independent.build import as_design
from independent.fronts import objectives_of
from independent.problem import Limit, Problem, Variable, box_sample, measure
from independent.truth import sample

import plough_opt as po

FRONTS = study.problems("front")
# Those that take a second or two of processor time.
QUICK = (0, 5)
# Of a range: by so much no returned design may be beaten. The brute force lags behind the true front by as much.
BEATEN = 1e-3
# Straight lines between 40 points lie beside what is curved between them.
BESIDE = 2e-3
# Of a range: from no part of a surface of 60 positions is the nearest point farther.
COVERED = 0.15
_NEEDLE = 0.05


def drawn(front):
    """Return points of a front of two objectives, and of the straight lines between neighbours."""
    rows = [front.objectives]
    for part in front.parts:
        for a, b in pairwise(front.objectives[list(part)]):
            rows.append(a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a))
    return np.vstack(rows)


def designs_of(front, problem):
    return [[point.variables[v.name] for v in problem.variables] for point in front.points]


@pytest.mark.parametrize("number", [k if k in QUICK else pytest.param(k, marks=pytest.mark.slow) for k in FRONTS])
def test_fronts_are_those_of_brute_force(number):
    problem, truth = FRONTS[number]
    design, run = as_design(problem)
    front = po.trade_off(design, *(po.Goal(name, getattr(run, name)) for name in truth["names"]), points=40)
    verdict = study.judge_front(problem, truth, designs_of(front, problem))
    assert verdict.violation <= study.RELATIVE
    assert verdict.dominated <= BEATEN
    # No end, no branch and no basin of the brute force is missing: none of its designs is better than the front.
    wanted = np.array(truth["objectives"])
    behind = (drawn(front)[:, None, :] - wanted[None, :, :]) / np.ptp(wanted, axis=0)
    assert np.max(np.min(np.max(behind, axis=2), axis=0)) <= BESIDE
    assert not any("search more thoroughly" in note for note in front.notes)


# --- conflicts that were denied -----------------------------------------------------------------------------


def mount(*, soil, chisel, variables, limits, speed, wave, damping, duration, steel, mass):
    """Return a problem of a share under a wave, from equilibrium."""
    fixed = {"chisel angle": chisel, "tow speed": speed, "damping": damping, "ramp time": 0.0, "frame mass": mass}
    fixed = {k: v for k, v in fixed.items() if k not in [own.name for own in variables]}
    names = {"force_rms": 1.0, "mean_deflection": 1.0}
    return Problem("mount", soil, fixed, wave, "equilibrium", duration, steel, variables, limits, names)


ANGLE = Variable("wedge angle", np.radians(5.0), np.radians(60.0), np.radians(25.0), False)
HEIGHT = Variable("height", 0.1, 0.5, 0.25, False)
FLAT = Limit("half angle", "at_most", np.radians(15.0))


def test_no_conflict_is_said_only_where_needles_alone_conflict():
    problem = mount(
        soil=(1600.0, 0.914, 35e3, np.radians(32.0), 0.5, 101325.0),
        chisel=np.radians(12.0), speed=1.2, wave=(0.4, 0.25), damping=100.0, duration=1.0, steel=True, mass=60.0,
        variables=(ANGLE, HEIGHT, Variable("stiffness", 2e4, 5e6, 1e5, True)),
        limits=(Limit("loosened radius", "at_least", 0.14), FLAT),
    )  # fmt: skip
    design, run = as_design(problem)
    front = po.trade_off(design, po.Goal("deflection", run.mean_deflection), po.Goal("force", run.force_rms))
    best = np.array(front.points[0].objectives)
    assert len(front.points) == 1
    assert front.notes[0] == "'deflection' and 'force' do not conflict: one design is best in both"
    assert "designs beyond the front were seen that are needles" in front.notes[1]
    y = sample(problem, 15, np.random.default_rng(0))
    y = np.vstack([y, problem.positions([[0.6545926, 0.1692840, 20000.0]])])
    found = objectives_of(problem, ("mean_deflection", "force_rms"), y)
    assert np.all(found[:, 0] >= best[0] * (1.0 - BEATEN))
    less = np.flatnonzero(found[:, 1] < best[1] * (1.0 - BEATEN))
    assert len(less) > 0
    for k in less:
        box = measure(problem, box_sample(problem, y[k], 64), fast.simulate, 1.6)["force_rms"]
        assert np.median(box) > found[k, 1] * (1.0 + _NEEDLE)


def test_more_mass_on_a_softer_mount_conflicts():
    problem = mount(
        soil=(1300.0, 0.722, 5e3, np.radians(30.0), 0.4, 5e3),
        chisel=np.radians(10.0), speed=1.5, wave=(0.3, 0.4), damping=150.0, duration=1.5, steel=False, mass=0.0,
        variables=(ANGLE, HEIGHT, Variable("stiffness", 1e4, 1e6, 1e5, True),
                   Variable("frame mass", 10.0, 120.0, 50.0, False)),
        limits=(FLAT, Limit("loosened radius", "at_least", 0.1), Limit("mean_deflection", "at_most", 0.06)),
    )  # fmt: skip
    design, run = as_design(problem)
    (mass,) = [v.symbol for v in design.declared.variables if v.name == "frame mass"]
    front = po.trade_off(design, po.Goal("force", run.force_rms), po.Goal("mass", mass))
    found = objectives_of(problem, ("force_rms", "mean_deflection"), sample(problem, 15, np.random.default_rng(0)))
    least = front.points[0]
    assert least.variables["frame mass"] == pytest.approx(120.0)
    assert least.objectives[0] <= np.min(found[:, 0])
    assert len(front.points) > 20


# --- three objectives ---------------------------------------------------------------------------------------


def kept_by_all(objectives, tolerance):
    """Return the numbers of designs that no other beats, thinned to a tolerance."""
    left = np.argsort(objectives.sum(axis=1), kind="stable")
    kept = []
    while len(left):
        kept.append(left[0])
        left = left[np.any(objectives[left] < objectives[left[0]] - tolerance, axis=1)]
    return np.array(kept)


def surface_by_brute_force(problem, names):
    """Return objectives of designs on the surface between three, needles apart, and their ranges."""
    random = np.random.default_rng(5)
    y = sample(problem, 16, random)
    f = objectives_of(problem, names, y)
    for spread in (0.1, 0.03, 0.01, 0.003):
        sound = np.flatnonzero(np.all(np.isfinite(f), axis=1))
        size = np.ptp(f[sound[kept_by_all(f[sound] / np.ptp(f[sound], axis=0), 1e-3)]], axis=0)
        best = y[sound[kept_by_all(f[sound] / size, 1e-3)]]
        more = best[random.integers(len(best), size=2**14)]
        more = np.clip(more + spread * random.standard_normal(more.shape), 0.0, 1.0)
        y, f = np.vstack([y, more]), np.vstack([f, objectives_of(problem, names, more)])
    left = np.flatnonzero(np.all(np.isfinite(f), axis=1))
    while True:
        best = left[kept_by_all(f[left] / size, 5e-3)]
        boxes = np.vstack([box_sample(problem, y[k], 64) for k in best])
        measures = measure(problem, boxes, fast.simulate, 1.6)
        medians = np.array([np.median(measures[name].reshape(len(best), 64), axis=1) for name in names]).T
        needles = np.any(medians - f[best] > _NEEDLE * np.maximum(f[best], size), axis=1)
        if not np.any(needles):
            return f[best], np.ptp(f[best], axis=0)
        left = np.setdiff1d(left, best[needles])


SURFACES = {1: "displacement_rms"}


@pytest.mark.slow
@pytest.mark.parametrize("number", SURFACES)
def test_surfaces_are_covered_and_beaten_by_none(number):
    problem, truth = FRONTS[number]
    names = [*truth["names"], SURFACES[number]]
    wanted, size = surface_by_brute_force(problem, names)
    design, run = as_design(problem)
    front = po.trade_off(design, *(po.Goal(name, getattr(run, name)) for name in names), points=60)
    away = (front.objectives[:, None, :] - wanted[None, :, :]) / size
    assert np.max(np.min(away, axis=2)) <= BEATEN
    assert np.max(np.min(np.max(np.abs(away), axis=2), axis=0)) <= COVERED
