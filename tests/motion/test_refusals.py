"""What a simulation refuses, and says of it; and stiff resistances of a user's own, which it does not."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.expressions import Expression


@dataclass(frozen=True)
class Viscous:
    damping: Expression

    def force(self, travel, speed):
        del travel
        return self.damping * speed


@dataclass(frozen=True)
class Elastic:
    stiffness: Expression

    def force(self, travel, speed):
        del speed
        return self.stiffness * travel


@dataclass(frozen=True)
class Mistaken:
    kind: str

    def force(self, travel, speed):
        del travel, speed
        return {"nothing": None, "column": ca.DM([1.0, 2.0]), "text": "12 N"}[self.kind]


@pytest.mark.parametrize("outputs", ["4", None, 2.5, math.nan, True, 0, -4])
def test_outputs_are_a_whole_number(r1_scene, outputs):
    with pytest.raises(po.InputError, match=r"outputs = .* must be a whole number"):
        po.simulate(r1_scene(), 1.0, outputs=outputs)


@pytest.mark.parametrize("duration", [[1.0], "1", np.array([1.0, 2.0]), ca.DM([1.0, 2.0]), ca.MX.sym("duration", 2)])
def test_a_duration_is_one_number(r1_scene, duration):
    with pytest.raises((po.InputError, po.DomainError), match=r"duration|one number for each quantity"):
        po.simulate(r1_scene(), duration)


def test_what_is_no_scene_or_accuracy(r1_scene, r1_soil):
    with pytest.raises(po.InputError, match="must be a Scene"):
        po.simulate(r1_soil, 1.0)
    with pytest.raises(po.InputError, match="must be an Accuracy"):
        po.simulate(r1_scene(), 1.0, accuracy="rk")
    with pytest.raises(po.InputError, match="one number for each quantity"):
        po.simulate(r1_scene(stiffness=ca.MX.sym("stiffness", 2)), 1.0)


@pytest.mark.parametrize("kind", ["nothing", "column", "text"])
def test_an_own_force_that_is_none(r1_scene, kind):
    with pytest.raises(po.InputError, match=r"Mistaken\.force returned"):
        po.simulate(r1_scene(own=(Mistaken(kind),)), 1.0)


def test_no_nan_leaves_a_quasi_static_scene(r1_scene):
    with pytest.raises(po.IntegrationError, match="not finite"):
        po.simulate(r1_scene(motion=False, own=(Viscous(math.nan),)), 1.0)


@pytest.mark.parametrize("motion", [True, False])
@pytest.mark.parametrize(("wavelength", "duration"), [(1e-6, 2.0), (0.6, 1e9)])
def test_countless_waves_are_refused_at_once(r1_scene, motion, wavelength, duration):
    scene = r1_scene(motion=motion, strength_wave=po.StrengthWave(0.3, wavelength))
    with pytest.raises(po.IntegrationError, match="times: take a shorter duration or a longer wave"):
        po.simulate(scene, duration)


@pytest.mark.parametrize("method", [None, "erk", "rosenbrock", "cvodes"])
def test_a_strong_own_damper(r1_scene, method):
    damping, duration = 5e4, 1.0
    accuracy = None if method is None else po.Accuracy(method)
    scene = r1_scene(inertial_drag=False, start="rest", own=(Viscous(damping),))
    run = po.simulate(scene, duration, accuracy=accuracy)
    # M z'' = F0 + c (V0 - z') - k0 z from z = 0, z' = V0, overdamped.
    root = math.sqrt(damping**2 - 4.0 * scene.inertia * scene.stiffness)
    fast = -(damping + root) / (2.0 * scene.inertia)
    slow = scene.stiffness / (scene.inertia * fast)
    last = (scene.reaction.static + damping * scene.tow_speed) / scene.stiffness
    of_fast = (scene.tow_speed + slow * last) / (fast - slow)
    exact = last + of_fast * np.exp(fast * run.time) - (last + of_fast) * np.exp(slow * run.time)
    # The error that a run is to keep by default, and what the tolerance 1e-10 of a named method leaves.
    np.testing.assert_allclose(run.deflection, exact, rtol=0.0, atol=1e-8 * np.max(exact))
    assert run.error_estimate < 1e-8


def test_a_stiff_own_spring(r1_scene):
    ground = 1e7
    scene = r1_scene(inertial_drag=False, start="rest", own=(Elastic(ground),))
    run = po.simulate(scene, 0.2)
    # M z'' = F0 + K (V0 t - z) - k0 z from z = 0, z' = V0.
    both = ground + scene.stiffness
    mean, drift = scene.reaction.static / both, ground * scene.tow_speed / both
    frequency = math.sqrt(both / scene.inertia)
    swing = (scene.tow_speed - drift) / frequency
    angle = frequency * run.time
    exact = mean + drift * run.time - mean * np.cos(angle) + swing * np.sin(angle)
    np.testing.assert_allclose(run.deflection, exact, rtol=0.0, atol=1e-8 * np.max(exact))
    assert run.error_estimate < 1e-8


def test_runs_are_compared_as_objects(r1_scene):
    run = po.simulate(r1_scene(), 0.1)
    assert run in [run]
    assert run != po.simulate(r1_scene(), 0.1)
