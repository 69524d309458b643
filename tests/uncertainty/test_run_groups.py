"""Runs of one structure in one program: mapped by one Function, with exact derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.differences import check_derivatives
from scipy import stats

import plough_opt as po
from plough_opt.design.model.program import Program

FIELD = po.SoilDistribution(
    po.named_soil("serozem"), cohesion=stats.lognorm(0.3, scale=20e3), density_ratio=stats.beta(8, 4, 0.7, 0.14)
)
FIXED = po.Accuracy("dop853", steps=60)


def _program(d):
    return Program.of(d.declared).with_steps(np.zeros(0))


def _path(count):
    """Return the program of averages over soils, of the path in one of them, and of a run of another structure."""
    d = po.Design()
    angle = d.variable("wedge angle", guess=0.5, lower=0.2, upper=0.9)
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.40)
    k0 = d.variable("stiffness", guess=2e4, lower=5e3, upper=1e5, log=True)
    share = po.Wedge(angle, po.deg(15.0), height)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6))
    runs = []

    def response(soil):
        scene = po.Scene(soil, share, k0, 20.0 + share.equivalent_cone().solid_mass(7850.0), 2.0, effects)
        runs.append(po.simulate(scene, 0.8, accuracy=FIXED, outputs=5))
        return {"draft": runs[-1].mean_draft / 1e3, "rms": runs[-1].force_rms / 1e3, "radius": scene.loosened_radius}

    robust = po.Robust(FIELD, response, samples=count, seed=1)
    other = po.simulate(replace(runs[0].scene, effects=po.Effects(damping=300.0)), 0.5, accuracy=FIXED)
    d.minimise(robust.cvar("draft", 0.7, width=0.3) + robust.mean_plus("rms", 2.0) + other.mean_draft / 1e3)
    robust.require_probability(d, "radius", "radius", 0.9, at_least=0.1, width=0.01)
    d.require("deflection", runs[1].deflection, at_most=0.3)
    return _program(d)


def _events():
    """Return the program of averages over soils of runs that stick and slip."""
    d = po.Design()
    k0 = d.variable("stiffness", guess=5e4, lower=2e4, upper=9e4, log=True)
    share = po.Wedge(po.deg(35.0), po.deg(15.0), 0.2)
    wave = po.StrengthWave(0.9, 0.2)
    effects = po.Effects(contact=po.StickSlip(1.2), strength_wave=wave, damping=200.0)

    def response(soil):
        return {"rms": po.simulate(po.Scene(soil, share, k0, 25.0, 0.8, effects), 0.5, outputs=5).force_rms / 1e3}

    d.minimise(po.Robust(FIELD, response, samples=3).mean_plus("rms", 1.0))
    return _program(d)


@pytest.mark.parametrize(
    ("make", "point", "first", "second"),
    [
        # The measures' third derivatives jump where a sample enters a width: differences lose digits there.
        pytest.param(lambda: _path(6), [0.61, 0.43, 0.37], 1e-7, 1e-6, id="averages, a path and another run"),
        # Tolerances of integrators with events: 1e-10.
        pytest.param(_events, [0.5], 1e-5, 1e-5, id="events", marks=pytest.mark.slow),
    ],
)
def test_derivatives_against_differences(make, point, first, second):
    check_derivatives(make().nlp, np.array(point), np.zeros(0), first, second)


def test_the_graph_of_the_derivatives_does_not_grow_with_the_samples():
    sizes = [_path(count).nlp.slopes.n_instructions() for count in (4, 12)]
    assert sizes[0] == sizes[1]
