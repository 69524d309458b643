"""The disconnected front of oscillation against deflection, compared with pymoo's NSGA-II. No test asserts a time."""

from functools import partial

import numpy as np
import pytest
from peers import r1

import plough_opt as po

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

PROBLEM = r1.PROBLEM.replace("reference", "force_against_deflection")
# A fifth of the positions lies in the gap of the front, so 64 positions give 50 designs.
POINTS, WANTED = 64, 50
STEPS = 500
# Deflection [m] and RMS force [N] of the far corner.
CORNER = (0.25, 160.0)
OURS, THEIRS = "plough_opt trade_off", "pymoo NSGA-II, 100 x 100, NumPy RK4"


def _simulated(designs):
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
    for name, compiled in ((OURS, False), (f"{OURS}, compiled before", True)):
        solve = partial(_front, problem, compiled=compiled)
        solve()
        front = solve()
        assert len(front.points) >= WANTED
        assert len(front.parts) == 2
        assert not front.failures
        # The optimiser's designs give what the front says by simulations of another setting.
        error = float(np.max(np.abs(_simulated(front.designs[::10]) / front.objectives[::10] - 1.0)))
        assert error < 1e-7
        own = front.hypervolume(CORNER)
        note = f"{len(front.points)} certified, hypervolume {own:.4f}, {front.building:.2f} s of it building"
        rows[name] = solve, error, note, *((setup, f"problem.trade_off({POINTS})") if name == OURS else ())
    if nsga2 is not None:
        from pymoo.indicators.hv import HV

        designs = nsga2.Mount(STEPS).designs(np.random.default_rng(0).uniform(*nsga2.Mount(STEPS).bounds(), (20, 3)))
        error = float(np.max(np.abs(np.column_stack(nsga2.averages(designs, STEPS)) / _simulated(designs) - 1.0)))
        found = nsga2.front(STEPS)
        theirs = float(HV(ref_point=np.array(CORNER))(found))
        note = f"{len(found)} designs, hypervolume {theirs:.4f}"
        rows[THEIRS] = partial(nsga2.front, STEPS), error, note, "from peers import nsga2", f"nsga2.front({STEPS})"
        assert own >= theirs
    contest.hold(task, rows, 3)
