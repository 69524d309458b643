"""Times of reading, building, solving and simulating. No test asserts a time."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import plough_opt as po
from plough_opt.design.model.program import Program
from plough_opt.motion import integrators, steps

pytestmark = pytest.mark.bench

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
FILES = ("reference.toml", "cotton_subsoiler.toml")
NOTHING = np.empty(0)


def _forget():
    """Empty every cache, so that the next simulation builds its graphs like the first one."""
    for module in (integrators, steps):
        for member in vars(module).values():
            getattr(member, "cache_clear", lambda: None)()


@pytest.fixture(params=FILES)
def problem(request):
    return po.read_problem(PROBLEMS / request.param)


@pytest.mark.parametrize("name", FILES)
def test_optimise_from_the_command_line(benchmark, name):
    script = "import sys; from plough_opt.app.main import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", script, "optimise", str(PROBLEMS / name)]
    quiet = {"check": True, "stdout": subprocess.DEVNULL}
    benchmark.pedantic(subprocess.run, (command,), quiet, rounds=3, warmup_rounds=1)


def test_build(benchmark, problem):
    def fresh():
        return (Program.of(problem.design()[0].declared),), {}

    benchmark.pedantic(lambda program: program.with_steps(NOTHING), setup=fresh, rounds=5, warmup_rounds=1)


def test_full_solve(benchmark, problem):
    best = benchmark.pedantic(
        lambda design: design.solve(), setup=lambda: ((problem.design()[0],), {}), rounds=3, warmup_rounds=1
    )
    assert best.status == "solved"


@pytest.mark.parametrize("setup", [_forget, None], ids=["cold", "warm"])
def test_simulate(benchmark, problem, setup):
    given = problem.scene(), problem.values()["scene.duration"]
    benchmark.pedantic(po.simulate, given, setup=setup, rounds=5, warmup_rounds=1)


def test_from_readings_to_the_best_share(benchmark):
    """Run all of problems/field.toml, including its search over all variables."""
    benchmark.pedantic(lambda: po.read_problem(PROBLEMS / "field.toml").optimise(), rounds=2)
