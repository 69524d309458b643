import pytest

import plough_opt as po
from plough_opt.core.expressions import log

BOUNDS = {"share.wedge_angle": (po.deg(30), po.deg(50)), "share.height": (0.15, 0.3), "scene.stiffness": (3e4, 4.5e4)}
RESULTS = ["mean_draft", "force_rms", "loosened_radius", "mean_deflection", "half_angle"]
LIMITS = {"loosened_radius": {"lower": 0.12}, "mean_deflection": {"upper": 0.15}, "half_angle": {"upper": po.deg(15)}}


@pytest.fixture(scope="package")
def around_r1(r1_scene, r1_wave):
    """Problem R1 around its optimum with a mount of medium stiffness: names, limits, and the objective as an output."""
    inputs = [po.Input(name, *bounds) for name, bounds in BOUNDS.items()]
    objective = po.Output("objective", of=lambda run: run.mean_draft / 1e3 + run.force_rms / 1e3)
    outputs = [objective, *(po.Output(name, **LIMITS.get(name, {})) for name in RESULTS)]
    scene = r1_scene(37.0, 0.22, 4e4, strength_wave=r1_wave)
    return po.component(scene, 2.0, inputs=inputs, outputs=outputs, steel_density=7850.0, name="share")


@pytest.fixture(scope="package")
def with_columns(r1_scene):
    """A damped start from rest, with results at every output time; its name is a word of C."""
    scene, inputs = r1_scene(damping=300.0, start="rest"), ["soil.cohesion", "effects.damping"]
    outputs = ["mount_force", "displacement_rms"]
    return po.component(scene, 0.5, inputs=inputs, outputs=outputs, samples=10, name="double")


@pytest.fixture(scope="package")
def not_always_finite(r1_scene):
    """The logarithm of the height above 0.25 m, with a bound below that."""
    logarithm = po.Output("logarithm", of=lambda run: log(run.scene.share.height - 0.25), unit="")
    inputs = [po.Input("share.height", 0.2, 0.3, 0.26)]
    return po.component(r1_scene(motion=False), 1.0, inputs=inputs, outputs=[logarithm])
