"""Optimisation of R1 and of five shares, compared with SLSQP to a relative gap of 1e-8. No test asserts a time."""

import math
from functools import partial

import numpy as np
import pytest
from contest_table import solved_anew
from peers import r1

import plough_opt as po

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

GAP = 1e-8
TIGHT = po.Accuracy(error=1e-11)
# Tool -> (module of peers/ that it needs, its simulation, whether it must reach the gap).
TOOLS = {
    "SLSQP, Numba RK4, 1600 steps": ("numba_rk4", "numba_averages(1600)", False),
    "SLSQP, Numba RK4, 3200 steps": ("numba_rk4", "numba_averages(3200)", True),
    "SLSQP, SciPy DOP853 1e-9": ("scipy_ivp", "scipy_averages('DOP853', 1e-9)", True),
}
OURS = {"plough_opt Design": False, "plough_opt Design, compiled before": True}
TASKS = {
    "local": "R1 from the first start to a local optimum",
    "best": "R1 to the global optimum: ours searches, others from five starts",
}
TEN = "five shares, ten variables, from the start to a local optimum"


def _judged(x, reported):
    """Return the larger of a design's gap and the error of its reported objective; a note; and the violation."""
    keys = ("share.wedge_angle", "share.height", "scene.stiffness")
    scene = po.read_problem(r1.PROBLEM).scene(dict(zip(keys, x, strict=True)))
    run = po.simulate(scene, r1.DURATION, accuracy=TIGHT)
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
    for own, compiled in OURS.items():
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


def test_ten_variables(r1_wave, contest, peer):
    """Each difference of SLSQP costs a simulation of every share."""
    from peers import slsqp

    tools = {name: _solver_of_five(r1_wave, compiled) for name, compiled in OURS.items()}
    if peer("numba_rk4") is not None:
        for steps in (1600, 3200):
            averages = slsqp.numba_averages(steps)
            tools[f"SLSQP, Numba RK4, {steps} steps"] = partial(slsqp.five_shares, averages)
    judged = {name: _judged_five(r1_wave, *solve()) for name, solve in tools.items()}
    least = min(objective for objective, _, violation in judged.values() if violation < GAP)
    rows = {}
    for name, (objective, error, violation) in judged.items():
        gap = objective / least - 1.0
        assert max(error, gap, violation) < GAP or name not in OURS
        note = f"J off by {error:.0e}, gap {gap:.0e}, violation {violation:.0e}"
        rows[name] = tools[name], max(error, abs(gap)), note
    contest.hold(TEN, rows)


def _five_scenes(wave, angles, heights):
    from peers import slsqp

    scenes = []
    for angle, height, cohesion in zip(angles, heights, slsqp.COHESIONS, strict=True):
        soil = po.Soil(r1.DENSITY, r1.RATIO, cohesion, r1.FRICTION, r1.TOOL, r1.AMBIENT)
        share = po.Wedge(angle, r1.CHISEL, height)
        mass = r1.FRAME + share.equivalent_cone().solid_mass(r1.STEEL)
        scenes.append(po.Scene(soil, share, slsqp.STIFFNESS, mass, r1.SPEED, po.Effects(strength_wave=wave)))
    return scenes


def _solver_of_five(wave, compiled):
    """Return a function that solves the design of five shares and returns (angles and heights, objective)."""
    from peers import slsqp

    d = po.Design()
    names = [(name, which, k) for which, name in enumerate(("angle", "height")) for k in range(1, 6)]
    x = [d.variable(f"{name} {k}", guess=r1.START[which], lower=r1.LOWER[which], upper=r1.UPPER[which])
         for name, which, k in names]  # fmt: skip
    scenes = _five_scenes(wave, x[:5], x[5:])
    runs = [po.simulate(scene, r1.DURATION) for scene in scenes]
    d.minimise(sum(run.mean_draft + run.force_rms for run in runs) / 1e3)
    d.require("mean radius", sum(scene.loosened_radius for scene in scenes) / 5.0, at_least=slsqp.MEAN_RADIUS)
    for k, (scene, run) in enumerate(zip(scenes, runs, strict=True), 1):
        d.require(f"deflection {k}", run.mean_deflection, at_most=0.15)
        d.require(f"half angle {k}", scene.cone.half_angle, at_most=po.deg(15.0))

    def solve():
        best = solved_anew(d, search="local", compiled=compiled)
        return np.array(list(best.variables.values())), best.objective

    return solve


def _judged_five(wave, x, reported):
    """Return a design's objective to 1e-11, the error of the reported one, and the violation."""
    from peers import slsqp

    angles, heights = np.split(x, 2)
    runs = [po.simulate(scene, r1.DURATION, accuracy=TIGHT) for scene in _five_scenes(wave, angles, heights)]
    objective = sum(run.mean_draft + run.force_rms for run in runs) / 1e3
    least = np.min(slsqp.five_requirements(angles, heights, [run.mean_draft for run in runs]))
    return objective, abs(reported / objective - 1.0), max(0.0, -float(least))
