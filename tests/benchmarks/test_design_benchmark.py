"""How long designs take, from the command line down to one derivative. Nothing here asserts a time."""

import subprocess
import sys
from pathlib import Path

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


def _program(d):
    return Program(d.declared)


def _forget():
    """Empty every cache, so that the next simulation builds its graphs as the first one does."""
    for module in (integrators, runge_kutta):
        for member in vars(module).values():
            getattr(member, "cache_clear", lambda: None)()


@pytest.fixture(params=FILES)
def problem(request):
    return po.read_problem(PROBLEMS / request.param)


@pytest.fixture
def built(problem):
    program = _program(problem.design()[0])
    program.build(NOTHING)
    return program


@pytest.fixture
def point(built):
    return built.start()


# --- whole processes ----------------------------------------------------------------------------------------


def test_import(benchmark):
    command = [sys.executable, "-c", "import plough_opt"]
    benchmark.pedantic(subprocess.run, (command,), {"check": True}, rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("name", FILES)
def test_optimise_from_the_command_line(benchmark, name):
    script = "import sys; from plough_opt.app import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", script, "optimise", str(PROBLEMS / name)]
    benchmark.pedantic(
        subprocess.run, (command,), {"check": True, "stdout": subprocess.DEVNULL}, rounds=3, warmup_rounds=1
    )


# --- designs ------------------------------------------------------------------------------------------------


def test_read_problem(benchmark):
    benchmark(po.read_problem, PROBLEMS / FILES[0])


def test_build(benchmark, problem):
    def fresh():
        return (_program(problem.design()[0]),), {}

    benchmark.pedantic(lambda program: program.build(NOTHING), setup=fresh, rounds=5, warmup_rounds=1)


def test_local_solve(benchmark, built):
    point = benchmark(first_optimum, built, NOTHING)
    assert point.solved


def test_full_solve(benchmark, problem):
    def fresh():
        return (problem.design()[0],), {}

    best = benchmark.pedantic(lambda design: design.solve(), setup=fresh, rounds=3, warmup_rounds=1)
    assert best.status == "solved"


def test_second_full_solve(benchmark, problem):
    design, _ = problem.design()
    design.solve()
    benchmark.pedantic(design.solve, rounds=3)


def test_many_designs(benchmark, built):
    points = np.random.default_rng(0).random((4096, len(built.declared.variables)))
    benchmark(built.population, points, NOTHING)


# --- one evaluation -----------------------------------------------------------------------------------------


def test_values(benchmark, built, point):
    benchmark(built.nlp.values, point, NOTHING)


def test_slopes(benchmark, built, point):
    benchmark(built.nlp.slopes, point, NOTHING)


def test_hessian(benchmark, built, point):
    benchmark(built.nlp.hess_lag, point, NOTHING, 1.0, np.ones(len(built.owner)))


def test_simulate_cold(benchmark, problem):
    scene, duration = problem.scene(), problem.values()["scene.duration"]
    benchmark.pedantic(
        po.simulate, (scene, duration), setup=_forget, rounds=5, warmup_rounds=1
    )  # fmt: skip


def test_simulate_warm(benchmark, problem):
    scene, duration = problem.scene(), problem.values()["scene.duration"]
    po.simulate(scene, duration)
    benchmark(po.simulate, scene, duration)
