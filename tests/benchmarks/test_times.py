"""Times of reading, building, solving and simulating. No test asserts a time."""

import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.design.basin import first_optimum
from plough_opt.design.program import Program
from plough_opt.motion import integrators, runge_kutta

pytestmark = pytest.mark.bench

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
FILES = ("reference.toml", "cotton_subsoiler.toml")
NOTHING = np.empty(0)


def _forget():
    """Empty every cache, so that the next simulation builds its graphs like the first one."""
    for module in (integrators, runge_kutta):
        for member in vars(module).values():
            getattr(member, "cache_clear", lambda: None)()


@pytest.fixture(params=FILES)
def problem(request):
    return po.read_problem(PROBLEMS / request.param)


@pytest.fixture
def built(problem):
    program = Program(problem.design()[0].declared)
    program.build(NOTHING)
    return program


@pytest.mark.parametrize("name", FILES)
def test_optimise_from_the_command_line(benchmark, name):
    script = "import sys; from plough_opt.app import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", script, "optimise", str(PROBLEMS / name)]
    quiet = {"check": True, "stdout": subprocess.DEVNULL}
    benchmark.pedantic(subprocess.run, (command,), quiet, rounds=3, warmup_rounds=1)


def test_read_problem(benchmark):
    benchmark(po.read_problem, PROBLEMS / FILES[0])


def test_build(benchmark, problem):
    def fresh():
        return (Program(problem.design()[0].declared),), {}

    benchmark.pedantic(lambda program: program.build(NOTHING), setup=fresh, rounds=5, warmup_rounds=1)


def test_local_solve(benchmark, built):
    assert benchmark(first_optimum, built, NOTHING).solved


def test_full_solve(benchmark, problem):
    best = benchmark.pedantic(
        lambda design: design.solve(), setup=lambda: ((problem.design()[0],), {}), rounds=3, warmup_rounds=1
    )
    assert best.status == "solved"


def test_many_designs(benchmark, built):
    points = np.random.default_rng(0).random((4096, len(built.declared.variables)))
    benchmark(built.population, points, NOTHING)


def test_simulate_cold(benchmark, problem):
    given = problem.scene(), problem.values()["scene.duration"]
    benchmark.pedantic(po.simulate, given, setup=_forget, rounds=5, warmup_rounds=1)


def test_simulate_warm(benchmark, problem):
    given = problem.scene(), problem.values()["scene.duration"]
    po.simulate(*given)
    benchmark(po.simulate, *given)


@pytest.mark.parametrize("random", ["model", "record"])
def test_stationary_rms_and_its_second_derivatives(benchmark, random):
    damping = ca.MX.sym("damping")
    record = po.read_strength_record(PROBLEMS / "transect.csv")
    strength = po.RandomStrength(0.12, 0.35) if random == "model" else po.strength_spectrum(record)
    effects = po.Effects(random_strength=strength, damping=damping)
    scene = po.Scene(po.named_soil("firm sandy loam"), po.Cone(po.deg(15.0), 0.21), 5e5, 60.0, 1.4, effects)
    hessian, gradient = ca.hessian(scene.stationary_force_rms, damping)
    benchmark(ca.Function("rms", [damping], [scene.stationary_force_rms, gradient, hessian]), 4e3)


def test_from_readings_to_the_best_share(benchmark):
    """Run all of problems/field.toml, including its search over all variables."""
    benchmark.pedantic(lambda: po.read_problem(PROBLEMS / "field.toml").optimise(), rounds=2)
