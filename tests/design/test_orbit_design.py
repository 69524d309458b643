"""Designs of periodic orbits and their approximations, against brute force over the stiffness."""

from types import SimpleNamespace

import numpy as np
import pytest

import plough_opt as po

CHOICES = {"linearised": "linearised", "periodic": "periodic", "harmonic balance": po.HarmonicBalance(3)}
LOWER, UPPER = 3e3, 4e5
LIMIT = 0.12


@pytest.fixture(scope="module")
def build(r1_scene):
    def scene(stiffness, choice, damping=400.0):
        wave = po.StrengthWave(0.3, 0.6)
        return r1_scene(stiffness=stiffness, strength_wave=wave, damping=damping, orbit=choice)

    def build(choice, *, limit=None, accuracy=None, damping=400.0, guess=5e4, lower=LOWER):
        d = po.Design()
        stiffness = d.variable("stiffness", guess=guess, lower=lower, upper=UPPER, unit="N/m", log=True)
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
    """Return, for each kind of orbit, the design with limited deflection and its optimum, solved once."""
    known = {}

    def solved(name):
        if name not in known:
            problem = build(CHOICES[name], limit=LIMIT)
            problem.best = problem.design.solve()
            known[name] = problem
        return known[name]

    return solved


@pytest.fixture(scope="module")
def grid(build):
    """Return, for each kind of orbit, stiffnesses and their objectives, infinite if they break the limit."""
    known = {}

    def grid(name):
        if name not in known:
            stiffness = np.geomspace(LOWER, UPPER, 61)
            runs = [build.numbers(k, CHOICES[name]) for k in stiffness]
            good = np.array([objective(run) if run.peak_deflection <= LIMIT else np.inf for run in runs])
            known[name] = stiffness, good
        return known[name]

    return grid


def branches(stiffness, good):
    """Return the neighbourhoods of a grid's local minima."""
    wall = np.r_[np.inf, good, np.inf]
    lowest = [k for k in range(len(good)) if np.isfinite(good[k]) and wall[k] > good[k] < wall[k + 2]]
    return [(stiffness[max(k - 1, 0)], stiffness[min(k + 1, len(good) - 1)], good[k]) for k in lowest]


@pytest.mark.parametrize("name", CHOICES)
def test_the_soft_and_the_stiff_branch_of_brute_force_are_found(solved, grid, name):
    best = solved(name).best
    expected = branches(*grid(name))
    assert len(expected) == len(best.local_optima) == 2
    found = sorted(best.local_optima, key=lambda optimum: optimum.variables["stiffness"])
    for optimum, (low, high, coarse) in zip(found, expected, strict=True):
        assert low * (1 - 1e-6) <= optimum.variables["stiffness"] <= high * (1 + 1e-6)
        # No worse than the grid, and no better than a step of it can hide.
        assert coarse * 0.95 < optimum.objective <= coarse * (1 + 1e-7)
    assert best.objective == min(optimum.objective for optimum in found)
    assert best.objective <= np.min(grid(name)[1]) * (1 + 1e-7)


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


@pytest.mark.parametrize("guess", [3.5e3, 3.5e5])
def test_a_local_search_stays_on_the_branch_of_its_guess(build, guess):
    best = build("periodic", guess=guess).design.solve(search="local")
    bound = LOWER if guess < 5e4 else UPPER
    assert best.variables["stiffness"] == pytest.approx(bound, rel=1e-6)
    assert best.active == ("stiffness",)


def test_a_periodic_orbit_is_found_by_harmonic_balance_and_with_own_steps_by_shooting(build, program_of):
    automatic, stepped = (
        program_of(build("periodic", accuracy=accuracy).design) for accuracy in (None, po.Accuracy("dop853", steps=96))
    )
    y = np.array([0.6])
    for program in (automatic, stepped):
        program.build(np.array([]))
    assert automatic.built.steps == [12]
    assert stepped.built.steps == [None]
    by_harmonics, by_steps = (np.asarray(p.nlp.slopes(y, [])[2]).item() for p in (automatic, stepped))
    assert by_harmonics == pytest.approx(by_steps, rel=1e-9)
    curvatures = [np.asarray(p.nlp.hess_lag(y, [], 1.0, [])).item() for p in (automatic, stepped)]
    assert curvatures[0] == pytest.approx(curvatures[1], rel=1e-8)


@pytest.mark.parametrize("name", CHOICES)
def test_derivatives_of_the_program_are_those_of_differences(build, program_of, name):
    program = program_of(build(CHOICES[name], limit=LIMIT).design)
    program.build(np.array([]))
    weights = np.linspace(-1.0, 1.0, program.nlp.values(0.5, [])[1].numel())

    def lagrangian(y):
        f, g = program.nlp.values(y, [])
        return float(f) + float(weights @ np.asarray(g).ravel())

    def slope(y):
        _, _, gradient, jacobian = program.nlp.slopes(y, [])
        return float(gradient) + float(weights @ np.asarray(jacobian).ravel())

    def difference(function, y, h=1e-3):
        pairs = [(function(y + k * h) - function(y - k * h)) / h for k in (1, 2, 3, 4)]
        return np.dot((4 / 5, -1 / 5, 4 / 105, -1 / 280), pairs)

    for y in (0.2, 0.8):
        assert slope(y) == pytest.approx(difference(lagrangian, y), rel=1e-8)
        second = float(program.nlp.hess_lag(y, [], 1.0, weights))
        assert second == pytest.approx(difference(slope, y), rel=1e-7)


def test_tow_speed_and_wave_may_be_chosen_too(r1_scene):
    d = po.Design()
    speed = d.variable("tow speed", guess=1.5, lower=1.0, upper=2.5, unit="m/s")
    wavelength = d.parameter("wavelength", 0.6, unit="m")
    scene = r1_scene(
        tow_speed=speed, damping=400.0, strength_wave=po.StrengthWave(0.3, wavelength), orbit="periodic", stiffness=4e4
    )
    run = po.simulate(scene, outputs=24)
    d.minimise((run.tow_power / 1e3 - 0.9) ** 2)
    best = d.solve(parameters={"wavelength": 0.8}, search="local")
    found = r1_scene(
        tow_speed=best.variables["tow speed"],
        damping=400.0,
        strength_wave=po.StrengthWave(0.3, 0.8),
        orbit="periodic",
        stiffness=4e4,
    )
    # The objective is flat to 1e-10 within the square root of that.
    assert po.simulate(found).tow_power == pytest.approx(900.0, rel=1e-4)
