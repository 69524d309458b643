"""Times of reading, building, solving and simulating, and how they and memory grow. No test asserts a time."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contest_table import Growth, race
from peers import r1

import plough_opt as po
from plough_opt.design.model.program import Program
from plough_opt.motion import integrators, steps

pytestmark = pytest.mark.bench

EFFECTS = {
    "strength_wave": po.StrengthWave(0.3, 0.6),
    "inertial_drag": True,
    "damping": 250.0,
    "rate_term": 0.05,
    "tow_ramp": 0.137,
}
COUNTS = (1, 2, 3, 4, 5)
MEMORY = """
import casadi as ca, numpy as np, plough_opt as po
from pathlib import Path
angle, height, k0 = (ca.MX.sym(name) for name in ("angle", "height", "k0"))
scene = po.read_problem({problem!r}).scene(
    {{"share.wedge_angle": angle, "share.height": height, "scene.stiffness": k0}})
batch = po.Batch(scene, 2.0, [angle, height, k0])
random = np.random.default_rng(0)
chunks = (random.uniform((0.2, 0.2, 4e4), (0.8, 0.4, 6e4), (16384, 3)) for _ in range({count}))
assert sum(len(found.mean_draft) for found in batch.stream(chunks)) == 16384 * {count}
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))
"""

DESIGNS = """
import plough_opt as po
from pathlib import Path
soil, share = po.named_soil("serozem"), po.Wedge(po.deg(30), po.deg(15), 0.25)
for k in range({count}):
    design = po.Design()
    stiffness = design.variable("stiffness", guess=5e4, lower=1e4, upper=1e5)
    effects = po.Effects(start="rest", tow_ramp=0.1 + 1e-4 * k, damping=400.0)
    run = po.simulate(po.Scene(soil, share, stiffness, 25.0, 2.0, effects), 0.5)
    design.minimise(run.force_rms)
    design.solve(search="local")
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmRSS" in line))
"""


def _add(contest, what, sizes, call, rounds=3):
    """Measure call(size)() for each size and add the growth of its time to the table."""
    spent = race({size: call(size) for size in sizes}, rounds)
    contest.growths.append(Growth(what, tuple(sizes), tuple(spent[size].cpu for size in sizes)))


def _effects(count):
    return {"inertial_drag": False, **{name: EFFECTS[name] for name in list(EFFECTS)[:count]}}


def test_simulation(contest, r1_scene, r1_wave):
    scene, horizons = r1_scene(strength_wave=r1_wave), [4.0 * 2.0**k for k in range(7)]
    _add(contest, "simulate, seconds simulated", horizons, lambda t: lambda: po.simulate(scene, t))
    outputs = (400, 1600, 6400, 25600, 102400)
    _add(contest, "simulate, output intervals", outputs, lambda n: lambda: po.simulate(scene, 2.0, outputs=n))
    scenes = {count: r1_scene(**_effects(count)) for count in COUNTS}
    _add(contest, "simulate, effects that are on", COUNTS, lambda n: lambda: po.simulate(scenes[n], 2.0), 7)


def _solved(r1_scene, duration, requirements=0, **effects):
    """Build and solve a design of two variables."""
    d = po.Design()
    angle = d.variable("angle", guess=25.0, lower=5.0, upper=60.0)
    height = d.variable("height", guess=0.25, lower=0.1, upper=0.5)
    scene = r1_scene(angle, height, **effects)
    run = po.simulate(scene, duration)
    d.minimise((run.mean_draft + run.force_rms) / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.12)
    for k in range(requirements):
        d.require(f"spare {k}", run.mean_draft * (1.0 + 0.01 * k), at_most=1e5)
    return d.solve(search="local")


def test_design(contest, r1_scene, r1_wave):
    what, wave = "Design built and solved", {"strength_wave": r1_wave}
    _add(contest, f"{what}, effects that are on", COUNTS, lambda n: lambda: _solved(r1_scene, 2.0, **_effects(n)))
    counts, horizons = (4, 8, 16, 32, 64), (2.0, 4.0, 8.0, 16.0)
    _add(contest, f"{what}, requirements", counts, lambda n: lambda: _solved(r1_scene, 2.0, n, **wave))
    _add(contest, f"{what}, seconds simulated", horizons, lambda t: lambda: _solved(r1_scene, t, **wave))


def _designs(count):
    return np.column_stack(r1.unscaled(np.random.default_rng(0).uniform(0.0, 1.0, (3, count))))


def test_batch(contest, batch_of, r1_wave):
    batch = batch_of(2.0, 1e-6, strength_wave=r1_wave)
    sizes = {count: _designs(count) for count in (4096, 16384, 65536, 262144)}
    _add(contest, "Batch, designs", tuple(sizes), lambda n: lambda: batch(sizes[n]))
    batches = {count: batch_of(2.0, 1e-6, **_effects(count)) for count in COUNTS}
    _add(contest, "Batch of 4096, effects that are on", COUNTS, lambda n: lambda: batches[n](sizes[4096]))


@pytest.mark.parametrize("damping", [None, 250.0, 2000.0])
@pytest.mark.parametrize("where", ["near the start", "all over the domain"])
def test_batch_over_its_horizon(contest, batch_of, r1_wave, where, damping):
    # Three in a thousand undamped motions all over the domain become chaotic within a minute and miss the wanted error.
    values = _designs(2048) if where != "near the start" else r1.START * np.linspace(0.999, 1.001, 2048)[:, None]
    horizons = (0.5, 2.0, 8.0, 32.0, 64.0)
    batches = {t: batch_of(t, 1e-6, strength_wave=r1_wave, damping=damping) for t in horizons}
    damper = "undamped" if damping is None else f"damped by {damping:g} N s/m"
    what = f"Batch of 2048 {where}, {damper}, seconds simulated"
    _add(contest, what, horizons, lambda t: lambda: batches[t](values))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the memory of a process in /proc")
@pytest.mark.parametrize(
    ("what", "code", "sizes"),
    [
        ("Batch.stream, most memory, chunks of 16384 designs", MEMORY, (4, 16, 64)),
        # The caches are full after about 150 designs.
        ("Designs solved and dropped, memory at the end, designs", DESIGNS, (250, 500, 1000, 2000)),
    ],
    ids=["stream", "designs"],
)
def test_memory_does_not_grow(contest, what, code, sizes):
    commands = [[sys.executable, "-c", code.format(problem=r1.PROBLEM, count=size)] for size in sizes]
    done = [subprocess.run(command, check=True, capture_output=True, text=True) for command in commands]
    costs = tuple(int(one.stdout) / 1024.0 for one in done)
    contest.growths.append(Growth(what, sizes, costs, "MiB"))
    assert max(costs) < 1.1 * min(costs)


# --- times of the steps of a problem file ---


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
