"""Optimisation of R1 beside other tools, to a relative gap of 1e-8. Nothing here asserts a time."""

import math
from functools import partial

import numpy as np
import pytest
from contest_table import fresh, race, solved_anew
from peers import r1

import plough_opt as po

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

GAP = 1e-8
# Each with the module of peers/ that it needs, how its question is built, and whether it is to reach the gap.
TOOLS = {
    "SLSQP, Numba RK4, 1600 steps": ("numba_rk4", "by_numba(1600)", False),
    "SLSQP, Numba RK4, 3200 steps": ("numba_rk4", "by_numba(3200)", True),
    "SLSQP, JAX RK4, 3200 steps, exact gradient": ("jax_rk4", "by_jax(3200)", True),
    "SLSQP, diffrax Tsit5 1e-9, exact gradient": ("jax_rk4", "by_diffrax(1e-9)", True),
    "SLSQP, SciPy DOP853 1e-9": ("scipy_ivp", "by_scipy('DOP853', 1e-9)", True),
}
OURS = "plough_opt Design"
COMPILED = "plough_opt Design, compiled before"
TASKS = {
    "local": "R1 from the first start to a local optimum",
    "best": "R1 to the global optimum: ours searches, others from five starts",
}


class _Judge:
    """What a design and its reported objective are worth, by simulations to 1e-11."""

    def __init__(self):
        self._problem = po.read_problem(r1.PROBLEM)

    def __call__(self, x, reported):
        """Return the error of the reported objective or its gap, whichever is larger, and a note."""
        scene = self._problem.scene(dict(zip(("share.wedge_angle", "share.height", "scene.stiffness"), x, strict=True)))
        run = po.simulate(scene, r1.DURATION, accuracy=po.Accuracy(error=1e-11))
        objective = (run.mean_draft + run.force_rms) / 1e3
        violation = max(0.0, *(-float(g) for g in r1.requirements(*x, run.mean_draft)))
        name, _, best = min(r1.OPTIMA, key=lambda optimum: abs(math.log(x[2] / optimum[1])))
        error, gap = abs(reported / objective - 1.0), objective / best - 1.0
        return (
            max(error, abs(gap)),
            f"{name}: J off by {error:.0e}, gap {gap:.0e}, violation {violation:.0e}",
            violation,
        )


@pytest.mark.parametrize("task", list(TASKS))
def test_r1(task, contest, peer):
    from peers import slsqp  # slow to import, and needed here only

    judge = _Judge()
    search = {"local": "local", "best": "auto"}[task]
    rows = {}
    for own, compiled in ((OURS, False), (COMPILED, True)):
        design, _ = po.read_problem(r1.PROBLEM).design()
        solve = partial(solved_anew, design, search=search, compiled=compiled)
        best = solve()
        reached, note, violation = judge(np.array(list(best.variables.values())), best.objective)
        assert reached < GAP
        assert violation < GAP
        if task == "best":
            _find_all_optima(best)
            note += f"; {len(best.local_optima)} optima"
        setup = f"import plough_opt as po; problem = po.read_problem({r1.PROBLEM!r})"
        call = f"problem.design()[0].solve(search={search!r}, compiled={compiled})"
        rows[own] = (solve, reached, note, setup, call)
    for name, (module, built, exact) in TOOLS.items():
        if peer(module) is None:
            continue
        solve, call = _solve(eval(f"slsqp.{built}", {"slsqp": slsqp}), task)
        reached, note, _ = judge(*solve())
        assert reached < GAP or not exact
        setup = f"from peers import r1, slsqp, {module}"
        rows[name] = (solve, reached, note, setup, f"slsqp.{built}.{call}")
    spent = race({name: row[0] for name, row in rows.items()}, 5)
    for name, (_, reached, note, setup, call) in rows.items():
        first = fresh(setup, call)
        contest.add(TASKS[task], name, spent[name], error=reached, first=first, note=note, ours=name == OURS)


def _solve(question, task):
    """Return how a question is solved, as a function and in words."""
    if task == "best":
        return question.best, "best()"
    return lambda: question.local(r1.START), "local(r1.START)"


def _find_all_optima(best):
    """Assert that the search found the three optima of the truth."""
    for _, stiffness, objective in r1.OPTIMA:
        nearest = min(best.local_optima, key=lambda o: abs(math.log(o.variables["scene.stiffness"] / stiffness)))
        assert abs(nearest.objective / objective - 1.0) < GAP
