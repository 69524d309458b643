"""Stiff mounts that swing on by themselves: a search's few steps keep their amplitude, so that none looks too quiet."""

import numpy as np
import pytest

import plough_opt as po
from plough_opt.design.tolerance import boxes
from plough_opt.motion.batch.many_runs import ManyRuns
from plough_opt.motion.terms import Structure, parameters

DURATION = 2.0


def _scene(stiffness, damping):
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), damping=damping, start="towed")
    share = po.Wedge(po.deg(25), po.deg(15), 0.25)
    return po.Scene(po.named_soil("firm sandy loam"), share, stiffness, 6.0, 1.5, effects)


@pytest.mark.parametrize("damping", [0.0, 1.0, 50.0])
def test_a_search_keeps_the_amplitude_of_a_towed_share(damping):
    # Swings of 400 to 4000 rad in a run; steps in proportion to the phase alone lost up to 20 % of the RMS.
    scenes = [_scene(float(stiffness), damping) for stiffness in np.geomspace(5e5, 5e7, 3)]
    many = ManyRuns(Structure.of(scenes[0]), 0)
    p = np.array([[*(float(parameters(scene)[name]) for name in many._observed.parameters), DURATION]
                  for scene in scenes])  # fmt: skip
    true = np.array([po.simulate(scene, DURATION).force_rms for scene in scenes])
    for finer, left in ((1.0, 6e-3), (2.0, 2e-5)):
        found = np.sqrt(many(p, finer=finer)[:, -1])  # the last result is the mean square of the force
        assert found == pytest.approx(true, rel=left)


def test_the_median_over_tolerances_is_that_of_exact_runs():
    d = po.Design()
    stiffness = d.variable("stiffness", guess=1e6, lower=8e5, upper=1.2e6, unit="N/m", log=True)
    d.minimise(po.simulate(_scene(stiffness, 0.0), DURATION).force_rms)
    best = d.solve()
    variables = d._program.declared.variables
    y = np.array([[v.scaled(best.variables[v.name]) for v in variables]])
    values = [float(variables[0].unscaled(one)) for one in boxes(variables, y)[:, 0]]
    exact = [po.simulate(_scene(value, 0.0), DURATION).force_rms for value in values]
    # Twice a search's steps leave some 1e-5.
    assert best.spread.median == pytest.approx(np.median(exact), rel=3e-5)
    assert best.spread.worst == pytest.approx(np.max(exact), rel=3e-5)
