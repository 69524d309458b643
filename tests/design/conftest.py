"""Designs that the tests of the design layer share; each expensive one is solved once."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest

import plough_opt as po

# What judges these designs integrates in C.
JUDGED = ("*_study", "independent_problems")
collect_ignore_glob = [] if shutil.which("cc") else [f"test_{name}.py" for name in JUDGED]


@pytest.fixture(scope="session")
def build_r1(r1_soil):
    """Build problem R1, or a relative of it, in the vocabulary of the package."""

    def build(
        soil=r1_soil,
        guess=(25.0, 0.25, 5e4),
        radius=0.12,
        accuracy=None,
        duration=2.0,
        outputs=400,
        damping=None,
        parameters=(),
    ):
        d = po.Design()
        angle = d.variable("wedge angle", guess=po.deg(guess[0]), lower=po.deg(5.0), upper=po.deg(60.0), unit="rad")
        height = d.variable("height", guess=guess[1], lower=0.10, upper=0.50, unit="m")
        k0 = d.variable("stiffness", guess=guess[2], lower=5e3, upper=5e5, unit="N/m", log=True)
        given = {"cohesion": soil.cohesion, "tow speed": 2.0}
        given |= {name: d.parameter(name, value) for name, value in given.items() if name in parameters}
        soil = replace(soil, cohesion=given["cohesion"])
        share = po.Wedge(angle, po.deg(15.0), height)
        cone = share.equivalent_cone()
        effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.6), damping=damping)
        scene = po.Scene(soil, share, k0, 20.0 + cone.solid_mass(7850.0), given["tow speed"], effects)
        run = po.simulate(scene, duration, accuracy=accuracy, outputs=outputs)
        d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
        d.require("loosened radius", po.loosened_radius(cone, soil), at_least=radius, unit="m")
        d.require("mean deflection", run.mean_draft / k0, at_most=0.15, unit="m")
        d.require("half angle", cone.half_angle, at_most=po.deg(15.0), unit="rad")
        return SimpleNamespace(design=d, height=height, k0=k0, share=share, cone=cone, scene=scene, run=run, soil=soil)

    return build


@pytest.fixture(scope="session")
def r1(build_r1):
    """Problem R1, solved with the search for all its optima."""
    problem = build_r1()
    problem.best = problem.design.solve()
    return problem
