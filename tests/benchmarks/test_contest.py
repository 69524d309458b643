"""Contests with other programs, and how times grow with the size of a problem."""

import json
import math
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from contest_table import Growth, Row, race, solved_anew
from helpers.problem_files import SUBSOILER
from helpers.scenes import R1_RUNS
from peers import r1

import plough_opt as po
from plough_opt.app.page import asset
from plough_opt.app.page_model import page_model
from plough_opt.motion.equation import parameters

# --- simulations, optimisations and a front of R1, compared with other tools at the same error. No test asserts a time

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

WANTED = 1e-6
OUTPUTS, TIGHT = 400, 1e-8
OURS = "plough_opt simulate"
# Groups of designs that need similar numbers of steps, so that tools with fixed steps take few unnecessary ones.
GROUPS = 8


def _domain(count):
    uniform = np.random.default_rng(0).uniform(0.0, 1.0, (3, count))
    return np.column_stack(r1.unscaled(uniform))


def _near_start(count):
    return r1.START * np.random.default_rng(1).uniform(0.999, 1.001, (count, 3))


def _simulated(r1_scene, wave, x, error=1e-11):
    scene = r1_scene(math.degrees(x[0]), x[1], x[2], strength_wave=wave)
    return po.simulate(scene, r1.DURATION, accuracy=po.Accuracy(error=error), outputs=OUTPUTS)


def _error(found, truth):
    """Return the largest error of mean draft and RMS force, relative to the larger of the two."""
    found, truth = np.asarray(found), np.asarray(truth)
    return float(np.max(np.abs(found - truth) / np.max(truth, axis=0)))


def test_hand_written_r1_is_ours(r1_scene, r1_wave):
    for x in (r1.START, r1.LOWER, r1.UPPER):
        known = parameters(r1_scene(math.degrees(x[0]), x[1], x[2], strength_wave=r1_wave))
        ours = [known[name] for name in ("static", "drag", "inertia", "stiffness")]
        # Rounding of about twenty operations.
        np.testing.assert_allclose(r1.equation(*x)[:4], ours, rtol=2e-14)


@pytest.mark.parametrize("where", ["start", "domain"])
def test_very_many_designs(batch_of, r1_scene, r1_wave, where, contest, peer):
    task = f"mean and RMS force of very many designs {'near the start' if where == 'start' else 'all over the domain'}"
    designs = {"start": _near_start, "domain": _domain}[where]
    values, few = designs(16384), designs(16384)[:4096]
    batch = batch_of(r1.DURATION, WANTED, strength_wave=r1_wave)
    reference = batch_of(r1.DURATION, 1e-10, strength_wave=r1_wave)(values)
    truth = np.array([reference.mean_draft, reference.force_rms])
    for k in range(0, len(values), len(values) // 12):
        run = _simulated(r1_scene, r1_wave, values[k])
        # The error of the reference plus that of the simulation.
        assert _error(truth[:, [k]], [[run.mean_draft], [run.force_rms]]) < 2e-10
    found = batch(values)
    error = _error([found.mean_draft, found.force_rms], truth)
    assert error < WANTED
    tools = {"plough_opt Batch, compiled": (lambda: batch(values), len(values), error)}
    tools |= _fixed_step_peers(few, truth[:, : len(few)], GROUPS if where == "domain" else 1, peer)
    if (heyoka := peer("heyoka_taylor")) is not None:
        p = np.array(r1.equation(*few.T))

        def error(found):
            return _error((p[3] * (p[4] + found[0]), p[3] * found[1]), truth[:, : len(few)])

        tolerance, reached = _loosest(lambda tolerance: error(heyoka.batch(p, tolerance)), WANTED)
        tools["heyoka.py, a register at a time"] = partial(heyoka.batch, p, tolerance), len(few), reached
    spent = race({name: function for name, (function, _, _) in tools.items()}, 5)
    for name, (_, count, error) in tools.items():
        each = spent[name].per(count)
        contest.rows.append(Row(task, name, each, error, note=f"{1.0 / each.cpu:.3g} designs per second"))


def _loosest(error, wanted):
    """Return the loosest tolerance whose error is below the wanted one, and that error."""
    found = ((tolerance, error(tolerance)) for tolerance in (10.0 ** -np.arange(5.0, 13.01, 0.25)).tolist())
    return next((tolerance, reached) for tolerance, reached in found if reached < wanted)


def _fixed_step_peers(values, truth, groups, peer):
    """Return the tools that take classical Runge-Kutta steps, as few as each group of designs allows."""
    p = np.array(r1.equation(*values.T))
    fastest = (p[3] + r1.AMPLITUDE * p[0] * 2.0 * math.pi / r1.WAVELENGTH) / p[2]
    parts = [(np.ascontiguousarray(p[:, k]), truth[:, k]) for k in np.array_split(np.argsort(fastest), groups)]
    runs = {}
    if (c := peer("c_rk4")) is not None:
        runs[f"RK4 in C, {c.WIDTH} designs side by side"] = c.vector()
        runs["RK4 in C, a design at a time"] = c.scalar()
    if (numba := peer("numba_rk4")) is not None:
        runs["RK4 in Numba"] = numba.batch

    def error(run, part, wanted, steps):
        mean, spread = np.asarray(run(part, steps))
        return _error((part[3] * (part[4] + mean), part[3] * spread), wanted)

    found, steps = {}, None
    for name, run in runs.items():
        steps = steps or [
            next(n for n in (int(50 * 1.1**k) for k in range(80)) if error(run, *part, n) < WANTED) for part in parts
        ]
        reached = max(error(run, *part, n) for part, n in zip(parts, steps, strict=True))
        # All tools take the same steps and differ only by rounding.
        assert reached < WANTED * (1.0 + 1e-3)

        def every(run=run, steps=steps):
            for (part, _), n in zip(parts, steps, strict=True):
                np.asarray(run(part, n))

        found[name] = every, len(values), reached
    return found


def test_one_simulation(r1_scene, r1_wave, contest, peer):
    truth = _simulated(r1_scene, r1_wave, r1.START)
    task = f"one simulation of {OUTPUTS} outputs, mount force to {TIGHT:g}"
    assert _error([[truth.mean_draft], [truth.force_rms]], np.array(R1_RUNS[0])[3:, None]) < 1e-11

    def error(found):
        mean, rms, force = found
        errors = [np.max(np.abs(force - truth.mount_force)) / truth.peak_force]
        if mean is not None:
            errors.append(_error([[mean], [rms]], [[truth.mean_draft], [truth.force_rms]]))
        return float(max(errors))

    scene, read = r1_scene(strength_wave=r1_wave), f"problem = po.read_problem({r1.PROBLEM!r})"
    setup = f"import plough_opt as po; from peers import r1; {read}; s = problem.scene()"
    rows = {}
    for name, compiled in ((OURS, False), (f"{OURS}, compiled before", True)):
        simulate = partial(po.simulate, scene, r1.DURATION, compiled=compiled)
        run = simulate()
        ours = error((run.mean_draft, run.force_rms, run.mount_force))
        assert ours < TIGHT
        call = f"po.simulate(s, {r1.DURATION!r}, compiled={compiled})"
        rows[name] = (simulate, ours, "and once more for its error estimate", setup, call)
    p = [float(x) for x in r1.equation(*r1.START)]
    rows |= _scipy_rows(p, error, contest)
    if (numba := peer("numba_rk4")) is not None:
        steps = next(n for n in range(OUTPUTS, 40 * OUTPUTS, OUTPUTS) if error(numba.forces(*p, n, OUTPUTS)) < TIGHT)
        setup = "from peers import r1, numba_rk4; p = [float(x) for x in r1.equation(*r1.START)]"
        call = f"numba_rk4.forces(*p, {steps}, {OUTPUTS})"
        forces = partial(numba.forces, *p, steps, OUTPUTS)
        rows["RK4 in Numba"] = (forces, error(forces()), f"{steps} steps", setup, call)
    if (heyoka := peer("heyoka_taylor")) is not None:
        tolerance, reached = _loosest(lambda tolerance: error(heyoka.forces(p, tolerance, OUTPUTS)), TIGHT)
        call = f"heyoka_taylor.forces(p, {tolerance!r}, {OUTPUTS})"
        setup = "from peers import r1, heyoka_taylor; p = [float(x) for x in r1.equation(*r1.START)]"
        forces = partial(heyoka.forces, p, tolerance, OUTPUTS)
        rows["heyoka.py"] = (forces, reached, f"tolerance {tolerance:.1g}", setup, call)
    contest.hold(task, rows, 7)


def _scipy_rows(p, error, contest):
    """Return SciPy's integrators, each with the loosest tolerance that reaches the wanted error."""
    from peers import scipy_ivp

    rows = {}
    setup = "from peers import r1, scipy_ivp; p = r1.equation(*r1.START)"
    for method in ("DOP853", "LSODA", "RK45", "Radau", "odeint"):
        for averages in (True, False):
            name = f"SciPy {method}, {'with' if averages else 'without'} mean and RMS"
            for tolerance in 10.0 ** -np.arange(6.0, 13.01, 0.25):
                arguments = (method, float(f"{tolerance:.2g}"), OUTPUTS, averages)
                reached = error(scipy_ivp.solve(p, *arguments))
                if reached < TIGHT:
                    call, solve = f"scipy_ivp.solve(p, *{arguments!r})", partial(scipy_ivp.solve, p, *arguments)
                    rows[name] = (solve, reached, f"rtol {arguments[1]:g}", setup, call)
                    break
            else:
                contest.missing[name] = f"no tolerance reaches {TIGHT:g}"
    return rows


# --- R1, compared with SLSQP to a relative gap of 1e-8 ---


GAP = 1e-8
TRUE = po.Accuracy(error=1e-11)
# Tool -> (module of peers/ that it needs, its simulation, whether it must reach the gap).
TOOLS = {
    "SLSQP, Numba RK4, 1600 steps": ("numba_rk4", "numba_averages(1600)", False),
    "SLSQP, Numba RK4, 3200 steps": ("numba_rk4", "numba_averages(3200)", True),
    "SLSQP, SciPy DOP853 1e-9": ("scipy_ivp", "scipy_averages('DOP853', 1e-9)", True),
}
DESIGN = {"plough_opt Design": False, "plough_opt Design, compiled before": True}
TASKS = {
    "local": "R1 from the first start to a local optimum",
    "best": "R1 to the global optimum: ours searches, others from five starts",
}


def _judged(x, reported):
    """Return the larger of a design's gap and the error of its reported objective; a note; and the violation."""
    keys = ("share.wedge_angle", "share.height", "scene.stiffness")
    scene = po.read_problem(r1.PROBLEM).scene(dict(zip(keys, x, strict=True)))
    run = po.simulate(scene, r1.DURATION, accuracy=TRUE)
    objective = (run.mean_draft + run.force_rms) / 1e3
    violation = max(0.0, *(-float(g) for g in r1.requirements(*x, run.mean_draft)))
    name, _, best = min(r1.OPTIMA, key=lambda optimum: abs(math.log(x[2] / optimum[1])))
    error, gap = abs(reported / objective - 1.0), objective / best - 1.0
    note = f"{name}: J off by {error:.0e}, gap {gap:.0e}, violation {violation:.0e}"
    return max(error, abs(gap)), note, violation


@pytest.mark.parametrize("task", list(TASKS))
def test_r1(task, contest, peer):
    from peers import slsqp  # imported here because that is slow

    search = {"local": "local", "best": "auto"}[task]
    rows = {}
    for own, compiled in DESIGN.items():
        design, _ = po.read_problem(r1.PROBLEM).design()
        solve = partial(solved_anew, design, search=search, compiled=compiled)
        best = solve()
        reached, note, violation = _judged(np.array(list(best.variables.values())), best.objective)
        assert max(reached, violation) < GAP
        if task == "best":
            _find_all_optima(best)
            note += f"; {len(best.local_optima)} optima"
        setup = f"import plough_opt as po; problem = po.read_problem({r1.PROBLEM!r})"
        call = f"problem.design()[0].solve(search={search!r}, compiled={compiled})"
        rows[own] = (solve, reached, note, setup, call)
    for name, (module, averages, exact) in TOOLS.items():
        if peer(module) is None:
            continue
        solve = partial(getattr(slsqp, task), eval(f"slsqp.{averages}", {"slsqp": slsqp}))
        reached, note, _ = _judged(*solve())
        assert reached < GAP or not exact
        rows[name] = (solve, reached, note, f"from peers import slsqp, {module}", f"slsqp.{task}(slsqp.{averages})")
    contest.hold(TASKS[task], rows)


def _find_all_optima(best):
    """Assert that the search found the three optima of the truth."""
    for _, stiffness, objective in r1.OPTIMA:
        nearest = min(best.local_optima, key=lambda o: abs(math.log(o.variables["scene.stiffness"] / stiffness)))
        assert abs(nearest.objective / objective - 1.0) < GAP


# --- the disconnected front of oscillation against deflection, compared with pymoo's NSGA-II ---


PROBLEM = r1.PROBLEM.replace("reference", "force_against_deflection")
# A fifth of the positions lies in the gap of the front, so 64 positions give 50 designs.
POINTS, DESIGNS = 64, 50
STEPS = 500
# Deflection [m] and RMS force [N] of the far corner.
CORNER = (0.25, 160.0)
TRADE_OFF, NSGA2 = "plough_opt trade_off", "pymoo NSGA-II, 100 x 100, NumPy RK4"


def _simulated_of_front(designs):
    """Return deflection and RMS force of designs, each to 1e-11."""
    problem = po.read_problem(PROBLEM)
    keys = ("share.wedge_angle", "share.height", "scene.stiffness")
    runs = [po.simulate(problem.scene(dict(zip(keys, x, strict=True))), r1.DURATION, accuracy=po.Accuracy(error=1e-11))
            for x in designs]  # fmt: skip
    return np.array([(run.mean_deflection, run.force_rms) for run in runs])


def _front(problem, *, compiled):
    """Return the front of the problem file, with the program built anew."""
    d = po.Design()
    symbols = {key: d.variable(key, guess=v.guess, lower=v.lower, upper=v.upper, unit=v.unit, log=v.log)
               for key, v in problem.variables.items()}  # fmt: skip
    scene = problem.scene(symbols)
    run = po.simulate(scene, r1.DURATION)
    d.require("loosened radius", po.loosened_radius(scene.cone, scene.soil), at_least=0.12, unit="m")
    d.require("half angle", scene.cone.half_angle, at_most=po.deg(15.0), unit="rad")
    goals = po.Goal("deflection", run.mean_deflection, "m"), po.Goal("force oscillation", run.force_rms, "N")
    return po.trade_off(d, *goals, points=POINTS, compiled=compiled)


def test_disconnected_front(contest, peer):
    nsga2 = peer("nsga2")
    task = "front of force oscillation against deflection, in two parts"
    problem = po.read_problem(PROBLEM)
    setup = f"import plough_opt as po, scipy.optimize; problem = po.read_problem({PROBLEM!r})"
    rows = {}
    for name, compiled in ((TRADE_OFF, False), (f"{TRADE_OFF}, compiled before", True)):
        solve = partial(_front, problem, compiled=compiled)
        solve()
        front = solve()
        assert len(front.points) >= DESIGNS
        assert len(front.parts) == 2
        assert not front.failures
        # The optimiser's designs give what the front says by simulations of another setting.
        error = float(np.max(np.abs(_simulated_of_front(front.designs[::10]) / front.objectives[::10] - 1.0)))
        assert error < 1e-7
        own = front.hypervolume(CORNER)
        note = f"{len(front.points)} certified, hypervolume {own:.4f}, {front.building:.2f} s of it building"
        rows[name] = solve, error, note, *((setup, f"problem.trade_off({POINTS})") if name == TRADE_OFF else ())
    if nsga2 is not None:
        from pymoo.indicators.hv import HV

        designs = nsga2.Mount(STEPS).designs(np.random.default_rng(0).uniform(*nsga2.Mount(STEPS).bounds(), (20, 3)))
        error = float(
            np.max(np.abs(np.column_stack(nsga2.averages(designs, STEPS)) / _simulated_of_front(designs) - 1.0))
        )
        found = nsga2.front(STEPS)
        theirs = float(HV(ref_point=np.array(CORNER))(found))
        note = f"{len(found)} designs, hypervolume {theirs:.4f}"
        rows[NSGA2] = partial(nsga2.front, STEPS), error, note, "from peers import nsga2", f"nsga2.front({STEPS})"
        assert own >= theirs
    contest.hold(task, rows, 3)


# --- times of reading, building, solving and simulating, and how they and memory grow. No test asserts a time ---

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

GROWN_DESIGNS = """
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


def _solved(r1_scene, wave, shares):
    """Build and solve a design of two variables, which all shares have in common."""
    d = po.Design()
    angle = d.variable("angle", guess=25.0, lower=5.0, upper=60.0)
    height = d.variable("height", guess=0.25, lower=0.1, upper=0.5)
    scenes = [r1_scene(angle, height, 5e4 + 1e3 * k, strength_wave=wave) for k in range(shares)]
    runs = [po.simulate(scene, 2.0) for scene in scenes]
    d.minimise(sum(run.mean_draft + run.force_rms for run in runs) / 1e3)
    d.require("loosened radius", scenes[0].loosened_radius, at_least=0.12)
    return d.solve(search="local")


def test_times_grow(contest, r1_scene, batch_of, r1_wave):
    scene, batch = r1_scene(strength_wave=r1_wave), batch_of(2.0, 1e-6, strength_wave=r1_wave)
    designs = {count: _domain(count) for count in (4096, 16384, 65536, 262144)}
    horizons = [4.0 * 2.0**k for k in range(7)]
    _add(contest, "simulate, seconds simulated", horizons, lambda t: lambda: po.simulate(scene, t))
    outputs = (400, 1600, 6400, 25600, 102400)
    _add(contest, "simulate, output intervals", outputs, lambda n: lambda: po.simulate(scene, 2.0, outputs=n))
    _add(contest, "Design built and solved, shares", (4, 8, 16, 32), lambda n: lambda: _solved(r1_scene, r1_wave, n))
    _add(contest, "Batch, designs", tuple(designs), lambda n: lambda: batch(designs[n]))


GROWING = [
    ("Batch.stream, most memory, chunks of 16384 designs", MEMORY, (4, 16, 64)),
    # The caches are full after about 150 designs.
    ("Designs solved and dropped, memory at the end, designs", GROWN_DESIGNS, (250, 500, 1000, 2000)),
]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the memory of a process in /proc")
@pytest.mark.parametrize(("what", "code", "sizes"), GROWING, ids=["stream", "designs"])
def test_memory_does_not_grow(contest, what, code, sizes):
    commands = [[sys.executable, "-c", code.format(problem=r1.PROBLEM, count=size)] for size in sizes]
    done = [subprocess.run(command, check=True, capture_output=True, text=True) for command in commands]
    costs = tuple(int(one.stdout) / 1024.0 for one in done)
    contest.growths.append(Growth(what, sizes, costs, "MiB"))
    assert max(costs) < 1.1 * min(costs)


# --- times of the steps of a problem file ---


PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
FILES = ("reference.toml", "cotton_subsoiler.toml")


@pytest.fixture(params=FILES)
def problem(request):
    return po.read_problem(PROBLEMS / request.param)


@pytest.mark.parametrize("name", FILES)
def test_optimise_from_the_command_line(benchmark, name):
    script = "import sys; from plough_opt.app.main import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", script, "optimise", str(PROBLEMS / name)]
    quiet = {"check": True, "stdout": subprocess.DEVNULL}
    benchmark.pedantic(subprocess.run, (command,), quiet, rounds=3, warmup_rounds=1)


def test_from_readings_to_the_best_share(benchmark):
    """Run all of problems/field.toml, including its search over all variables."""
    benchmark.pedantic(lambda: po.read_problem(PROBLEMS / "field.toml").optimise(), rounds=2)


# --- times of the page that computes, in node: a move of a slider, and the cloud of its landscape; none is asserted ---

# A process that has computed once answers each line by computing again; the page's workers stay as warm.
CLIENT = Path(__file__).with_name("page_client.js").read_text(encoding="utf-8")


@pytest.mark.parametrize(("task", "rounds"), [("move", 200), ("cloud", 10)])
def test_time(task, rounds, benchmark, tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node: apt-get install nodejs")
    model = page_model(po.read_problem(SUBSOILER))
    script = f"const MODEL = {json.dumps(model.data)};\n{model.functions}\n{asset('engine.js')}\n{CLIENT}"
    (tmp_path / "page.js").write_text(script, encoding="utf-8")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([node, tmp_path / "page.js"], **pipes) as process:

        def ask():
            process.stdin.write(f"{task}\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        done = benchmark.pedantic(ask, rounds=rounds, warmup_rounds=3)
        assert done >= (800 if task == "move" else 2000)  # steps of 400 intervals, designs
        process.stdin.close()
