"""Designs of periodic orbits and their approximations, against brute force over the stiffness."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.differences import check_derivatives
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model.program import Program

CHOICES = {"linearised": "linearised", "periodic": "periodic", "harmonic balance": po.HarmonicBalance(3)}
LOWER, UPPER = 3e3, 4e5
LIMIT = 0.12


@pytest.fixture(scope="module")
def build(r1_scene):
    def scene(stiffness, choice, damping=400.0):
        wave = po.StrengthWave(0.3, 0.6)
        return r1_scene(stiffness=stiffness, strength_wave=wave, damping=damping, orbit=choice)

    def build(choice, *, limit=None, accuracy=None, damping=400.0, guess=5e4, lower=LOWER):
        d, stiffness = design(stiffness=(guess, lower, UPPER, "N/m", True))
        run = po.simulate(scene(stiffness, choice, damping), accuracy=accuracy, outputs=48)
        d.minimise(objective(run))
        if limit is not None:
            d.require("deflection", run.deflection, at_most=limit, unit="m")
        return SimpleNamespace(design=d, run=run)

    def numbers(stiffness, choice, damping=400.0):
        return po.simulate(scene(stiffness, choice, damping), outputs=48)

    build.numbers = numbers
    return build


def objective(run):
    return run.force_rms / 1e3 + run.mean_draft / 1e3


@pytest.fixture(scope="module")
def solved(build):
    """Return the function from a kind of orbit to the design with limited deflection and its optimum, solved once."""

    @functools.cache
    def solved(name):
        problem = build(CHOICES[name], limit=LIMIT)
        problem.best = problem.design.solve()
        return problem

    return solved


def branches(build, name):
    """Return the neighbourhoods of the local minima of a grid of stiffnesses that keep the limit, and their values."""
    stiffness = np.geomspace(LOWER, UPPER, 61)
    runs = [build.numbers(k, CHOICES[name]) for k in stiffness]
    wall = [np.inf, *(objective(run) if run.peak_deflection <= LIMIT else np.inf for run in runs), np.inf]
    lowest = [k for k in range(61) if wall[k] > wall[k + 1] < wall[k + 2]]
    return [(stiffness[max(k - 1, 0)], stiffness[min(k + 1, 60)], wall[k + 1]) for k in lowest]


@pytest.mark.parametrize("name", CHOICES)
def test_the_soft_and_the_stiff_branch_of_brute_force_are_found(solved, build, name):
    best = solved(name).best
    expected = branches(build, name)
    assert len(expected) == len(best.local_optima) == 2
    found = sorted(best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    for optimum, (low, high, coarse) in zip(found, expected, strict=True):
        assert low * (1 - 1e-6) <= optimum.variables["stiffness"] <= high * (1 + 1e-6)
        # No worse than the grid, and no better than a step of it can hide.
        assert coarse * 0.95 < optimum.objective <= coarse * (1 + 1e-7)
    assert best.objective == min(optimum.objective for optimum in found)


@pytest.mark.parametrize("name", CHOICES)
def test_optima_are_those_of_the_orbit_simulated_anew(solved, build, name):
    problem = solved(name)
    soft = min(problem.best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    assert soft.active == ("deflection",)
    assert build.numbers(soft.variables["stiffness"], CHOICES[name]).peak_deflection == pytest.approx(LIMIT, rel=1e-7)
    for optimum in problem.best.local_optima:
        run = build.numbers(optimum.variables["stiffness"], CHOICES[name])
        assert optimum.objective == pytest.approx(objective(run), rel=1e-10)
        assert optimum.gap < 1e-8
        assert optimum.error_estimate < 1e-9
    run = build.numbers(problem.best.variables["stiffness"], CHOICES[name])
    assert float(problem.best(problem.run.mean_draft)) == pytest.approx(run.mean_draft, rel=1e-10)
    assert float(problem.best(problem.run.force_rms)) == pytest.approx(run.force_rms, rel=1e-10)
    assert problem.best(problem.run.deflection).ravel() == pytest.approx(run.deflection, rel=1e-10)
    again = problem.best(problem.run)
    assert again.duration == pytest.approx(0.3, rel=1e-15)
    assert np.array_equal(again.mount_force, run.mount_force)
    assert again.error_estimate == run.error_estimate
    assert len(again.checks.floquet) == (2 if name == "periodic" else 0)


@pytest.mark.parametrize("name", CHOICES)
def test_designs_without_an_orbit_are_skipped(build, name):
    # Without damping, the search tries stiffnesses beside the resonance whose orbit is not found.
    best = build(CHOICES[name], damping=None, lower=2e3).design.solve()
    stiffness = sorted(optimum.variables["stiffness"] for optimum in best.local_optima)
    assert stiffness[0] == pytest.approx(2e3, rel=1e-6)
    assert stiffness[-1] == pytest.approx(UPPER, rel=1e-6)
    for optimum in best.local_optima:
        run = build.numbers(optimum.variables["stiffness"], CHOICES[name], damping=None)
        assert optimum.objective == pytest.approx(objective(run), rel=1e-8)


@pytest.mark.parametrize("name", ["linearised", "periodic"])
def test_thousands_of_orbits_under_two_waves_are_tried(r1_scene, name):
    waves = po.StrengthWave(0.2, 0.6), po.StrengthWave(0.2, 0.2, 1.0)

    def run_at(stiffness):
        scene = r1_scene(stiffness=stiffness, strength_wave=waves, damping=400.0, orbit=CHOICES[name])
        return po.simulate(scene, outputs=48)

    d, stiffness = design(stiffness=(5e4, LOWER, UPPER, "N/m", True))
    d.minimise(objective(run_at(stiffness)))
    best = d.solve()
    assert best.search.designs > 500
    assert not best.search.one_by_one
    grid = [objective(run_at(float(k))) for k in np.geomspace(LOWER, UPPER, 40)]
    assert best.objective <= min(grid) * (1.0 + 1e-8)
    assert best.objective == pytest.approx(objective(run_at(best.variables["stiffness"])), rel=1e-8)


# A periodic orbit is found by harmonic balance or, with the user's own steps, by shooting.
OWN = po.Accuracy("dop853", steps=96)
STEPS = [("linearised", None, 56), ("periodic", None, 12), ("periodic", OWN, None), ("harmonic balance", None, 56)]


@pytest.mark.parametrize(("name", "accuracy", "steps"), STEPS)
def test_derivatives_of_the_program_are_those_of_differences(build, name, accuracy, steps):
    declared = build(CHOICES[name], limit=LIMIT, accuracy=accuracy).design.declared
    program = Program.of(declared).with_steps(np.array([]))
    assert program.built.steps == [steps]
    for y in (0.2, 0.8):
        check_derivatives(program.nlp, np.array([y]), [], 1e-8, 1e-7, step=1e-3)


def test_tow_speed_and_wave_may_be_chosen_too(r1_scene):
    def run_at(speed, wavelength):
        wave = po.StrengthWave(0.3, wavelength)
        scene = r1_scene(tow_speed=speed, damping=400.0, strength_wave=wave, orbit="periodic", stiffness=4e4)
        return po.simulate(scene, outputs=24)

    d, speed = design(speed=(1.5, 1.0, 2.5, "m/s"))
    run = run_at(speed, d.parameter("wavelength", 0.6, unit="m"))
    d.minimise((run.tow_power / 1e3 - 0.9) ** 2)
    best = d.solve(parameters={"wavelength": 0.8}, search="local")
    # The objective is flat to 1e-10 within the square root of that.
    assert run_at(best.variables["speed"], 0.8).tow_power == pytest.approx(900.0, rel=1e-4)
