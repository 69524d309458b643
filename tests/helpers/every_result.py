"""A small result of every kind, each computed once."""

import dataclasses
import functools

import casadi as ca
import numpy as np

import plough_opt as po
from helpers.problem_files import PROBLEMS
from helpers.scenes import scene_of
from helpers.small_designs import design
from plough_opt.problem_file.uncertain import optimise_robust

SCENE = scene_of(share=po.Cone(po.deg(10), 0.25), damping=400.0, strength_wave=po.StrengthWave(0.3, 0.2))
STILL = dataclasses.replace(SCENE, effects=po.Effects(motion=False))


@functools.cache
def run():
    return po.simulate(SCENE, 0.2, outputs=20)


@functools.cache
def optimum():
    """Return an optimum with two variables and two requirements, one of which decides, and with its run."""
    d, height, stiffness = design(height=("250 mm", "100 mm", "500 mm"), stiffness=(1e5, 1e4, 1e6, "N/m", True))
    scene = dataclasses.replace(STILL, share=po.Cone(po.deg(10), height), stiffness=stiffness)
    moving = po.simulate(scene, 1.0)
    d.minimise(moving.mean_draft / 1e3 + 1e-9 * (stiffness - 5e4) ** 2)
    d.require("loosened radius", scene.loosened_radius, at_least=0.12, unit="m")
    d.require("half height", height / 2.0, at_least="40 mm")
    best = d.solve(search=200)
    return dataclasses.replace(best, run=best(moving), sensitivities=best.every_sensitivity())


@functools.cache
def batch():
    mass = ca.MX.sym("mass")
    return po.Batch(dataclasses.replace(SCENE, mass=mass), 0.2, [mass])(np.array([[20.0], [30.0], [-1.0]]))


@functools.cache
def fit():
    measured = po.Measurements("mean_draft", [7e3, 8e3, 9e3], {"scene.tow_speed": [1.0, 1.5, 2.0]}, sigma=100.0)
    return po.calibrate(STILL, measured, {"soil.cohesion": (1e3, 8e4)})


@functools.cache
def front():
    d, x = design(x=("500 mm", "0 mm", "1000 mm"))
    k = d.parameter("k", 2.0)
    d.require("sum", x * k, at_most=1.5)
    goals = po.Goal("draft", 5000.0 * (0.1 + x**2), "N"), po.Goal("radius", 0.1 + k * x, "m", maximise=True)
    return po.trade_off(d, *goals, points=5, search="local", title="a front", parameters={"k": 1.0})


@functools.cache
def robust():
    small = ("uncertain.samples=8", "uncertain.fresh=100", "effects={motion=false}", "scene.stiffness=200 kN/m",
             "share.wedge_angle=30 deg", "minimise={mean_draft={per='1 kN', measure='mean + 2 std'}}")  # fmt: skip
    return optimise_robust(po.read_problem(PROBLEMS / "uncertain_field.toml", small), lambda *_: None)


EVERY = {
    "Run": run,
    "Machine": lambda: po.Machine({"front": run(), "rear": run()}),
    "Optimum": optimum,
    "LocalOptimum": lambda: optimum().local_optima[0],
    "Rounded": lambda: optimum().rounded(stiffness=[4e4, 6.3e4]),
    "BatchResult": batch,
    "Fit": fit,
    "TradeOff": front,
    "AccuracyStudy": lambda: po.study_accuracy(SCENE, 0.1, allowance=0.01),
    "RobustOptimum": robust,
}
