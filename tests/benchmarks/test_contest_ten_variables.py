"""A design of ten variables beside SLSQP, whose differences cost a simulation of every share for each variable."""

import numpy as np
import pytest
from contest_table import race, solved_anew
from peers import five_shares, r1

import plough_opt as po

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

GAP = 1e-8
OURS = "plough_opt Design"
COMPILED = "plough_opt Design, compiled before"
TASK = "five shares, ten variables, from the start to a local optimum"


def test_ten_variables(r1_wave, contest, peer):
    tools = {OURS: _ours(r1_wave, compiled=False), COMPILED: _ours(r1_wave, compiled=True)}
    if peer("numba_rk4") is not None:
        tools |= {f"SLSQP, Numba RK4, {steps} steps": five_shares.by_numba(steps) for steps in (1600, 3200)}
    judged = {name: _judged(r1_wave, *solve()) for name, solve in tools.items()}
    least = min(objective for objective, _, violation in judged.values() if violation < GAP)
    spent = race(tools, 5)
    for name, (objective, error, violation) in judged.items():
        gap = objective / least - 1.0
        assert max(error, gap, violation) < GAP or name not in (OURS, COMPILED)
        note = f"J off by {error:.0e}, gap {gap:.0e}, violation {violation:.0e}"
        contest.add(TASK, name, spent[name], error=max(error, abs(gap)), note=note, ours=name == OURS)


def _ours(wave, *, compiled):
    design = _design(wave)

    def solve():
        best = solved_anew(design, search="local", compiled=compiled)
        return np.array(list(best.variables.values())), best.objective

    return solve


def _scenes(wave, angles, heights):
    scenes = []
    for angle, height, cohesion in zip(angles, heights, five_shares.COHESIONS, strict=True):
        soil = po.Soil(
            density=r1.DENSITY,
            density_ratio=r1.RATIO,
            cohesion=cohesion,
            friction_angle=r1.FRICTION,
            tool_friction=r1.TOOL,
            ambient_pressure=r1.AMBIENT,
        )
        share = po.Wedge(angle, r1.CHISEL, height)
        mass = r1.FRAME + share.equivalent_cone().solid_mass(r1.STEEL)
        scenes.append(po.Scene(soil, share, five_shares.STIFFNESS, mass, r1.SPEED, po.Effects(strength_wave=wave)))
    return scenes


def _design(wave):
    d = po.Design()
    angles, heights = (
        [
            d.variable(f"{name} {k}", guess=r1.START[which], lower=r1.LOWER[which], upper=r1.UPPER[which])
            for k in range(1, 6)
        ]
        for which, name in enumerate(("angle", "height"))
    )
    scenes = _scenes(wave, angles, heights)
    runs = [po.simulate(scene, r1.DURATION) for scene in scenes]
    d.minimise(sum(run.mean_draft + run.force_rms for run in runs) / 1e3)
    d.require("mean radius", sum(scene.loosened_radius for scene in scenes) / 5.0, at_least=five_shares.MEAN_RADIUS)
    for k, (scene, run) in enumerate(zip(scenes, runs, strict=True), 1):
        d.require(f"deflection {k}", run.mean_deflection, at_most=0.15)
        d.require(f"half angle {k}", scene.cone.half_angle, at_most=po.deg(15.0))
    return d


def _judged(wave, x, reported):
    """Return a design's objective by simulations to 1e-11, the error of the reported one, and the violation."""
    angles, heights = np.split(x, 2)
    accuracy = po.Accuracy(error=1e-11)
    runs = [po.simulate(scene, r1.DURATION, accuracy=accuracy) for scene in _scenes(wave, angles, heights)]
    objective = sum(run.mean_draft + run.force_rms for run in runs) / 1e3
    least = np.min(five_shares.requirements(angles, heights, [run.mean_draft for run in runs]))
    return objective, abs(reported / objective - 1.0), max(0.0, -float(least))
