"""Runs of one structure in one program: mapped by one Function, with exact derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.differences import differences
from scipy import stats

import plough_opt as po
from plough_opt.design.program import Program

POINT = np.array([0.61, 0.43, 0.37])
FIELD = po.SoilDistribution(
    po.named_soil("serozem"), cohesion=stats.lognorm(0.3, scale=20e3), density_ratio=stats.beta(8, 4, 0.7, 0.14)
)


def _program(count, other=False, path=False):
    d = po.Design()
    angle = d.variable("wedge angle", guess=0.5, lower=0.2, upper=0.9)
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.40)
    k0 = d.variable("stiffness", guess=2e4, lower=5e3, upper=1e5, log=True)
    share = po.Wedge(angle, po.deg(15.0), height)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6))
    runs = []

    def response(soil):
        scene = po.Scene(soil, share, k0, 20.0 + share.equivalent_cone().solid_mass(7850.0), 2.0, effects)
        runs.append(po.simulate(scene, 0.8, accuracy=po.Accuracy("dop853", steps=60), outputs=5))
        return {"draft": runs[-1].mean_draft / 1e3, "rms": runs[-1].force_rms / 1e3, "radius": scene.loosened_radius}

    robust = po.Robust(FIELD, response, samples=count, seed=1)
    objective = robust.cvar("draft", 0.7, width=0.3) + robust.mean_plus("rms", 2.0)
    if other:
        scene = replace(runs[0].scene, effects=po.Effects(damping=300.0))
        objective = objective + po.simulate(scene, 0.5, accuracy=po.Accuracy("dop853", steps=40)).mean_draft / 1e3
    d.minimise(objective)
    robust.require_probability(d, "radius", "radius", 0.9, at_least=0.1, width=0.01)
    if path:
        d.require("deflection", runs[1].deflection, at_most=0.3)
    program = Program(d.declared)
    program.build(np.zeros(0))
    return program


@pytest.mark.parametrize(("other", "path"), [(False, False), (True, True)])
def test_derivatives_against_differences(other, path):
    program = _program(6, other, path)
    nlp, p = program.nlp, np.zeros(0)
    f, g, gradient, jacobian = (np.asarray(result) for result in nlp.slopes(POINT, p))
    again = [np.asarray(result) for result in nlp.values(POINT, p)]
    assert f == pytest.approx(again[0], rel=1e-12)
    assert g == pytest.approx(again[1], rel=1e-12)
    wanted = differences(lambda y: np.asarray(nlp.values(y, p)[0]), POINT)
    assert gradient.ravel() == pytest.approx(wanted.ravel(), rel=1e-8, abs=1e-8)
    assert jacobian == pytest.approx(differences(lambda y: np.asarray(nlp.values(y, p)[1]), POINT), rel=1e-7, abs=1e-8)
    weights = np.cos(1.0 + np.arange(len(program.owner)))
    upper = np.asarray(nlp.hess_lag(POINT, p, 0.7, weights))

    def slope(y):
        _, _, gradient, jacobian = (np.asarray(result) for result in nlp.slopes(y, p))
        return 0.7 * gradient.ravel() + jacobian.T @ weights

    hessian = differences(slope, POINT)
    # The measures' third derivatives jump where a sample enters a width: differences lose digits there.
    assert upper + np.triu(upper, 1).T == pytest.approx(hessian, rel=1e-6, abs=1e-6 * np.max(np.abs(hessian)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        {"contact": po.StickSlip(1.2), "strength_wave": po.StrengthWave(0.9, 0.2), "damping": 200.0},
        {"orbit": "periodic", "strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0},
    ],
    ids=["events", "orbit"],
)
def test_runs_with_events_and_orbits_are_mapped_too(effects):
    d = po.Design()
    k0 = d.variable("stiffness", guess=5e4, lower=2e4, upper=9e4, log=True)
    frame = d.parameter("frame mass", 20.0)
    share = po.Wedge(po.deg(35.0), po.deg(15.0), 0.2)

    def response(soil):
        scene = po.Scene(soil, share, k0, frame + 5.0, 0.8, po.Effects(**effects))
        run = po.simulate(scene, None if "orbit" in effects else 0.5, outputs=5)
        return {"rms": run.force_rms / 1e3}

    robust = po.Robust(FIELD, response, samples=3)
    d.minimise(robust.mean_plus("rms", 1.0))
    program, p, y = Program(d.declared), np.array([20.0]), np.array([0.5])
    program.build(p)
    gradient = np.asarray(program.nlp.slopes(y, p)[2])
    # Tolerances of integrators with events: 1e-10.
    wanted = differences(lambda at: np.asarray(program.nlp.values(at, p)[0]), y)
    assert gradient.item() == pytest.approx(wanted.item(), rel=1e-5)
    wanted = differences(lambda at: np.asarray(program.nlp.slopes(at, p)[2]), y)
    assert np.asarray(program.nlp.hess_lag(y, p, 1.0, [])).item() == pytest.approx(wanted.item(), rel=1e-5)
    best = d.solve(search="local")
    assert po.uncertainty.mean_plus(robust.values(best)["rms"], 1.0) == pytest.approx(best.objective, rel=1e-8)


def test_the_graph_of_the_derivatives_does_not_grow_with_the_samples():
    sizes = [_program(count).nlp.slopes.n_instructions() for count in (4, 12)]
    assert sizes[0] == sizes[1]
