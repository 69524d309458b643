"""Refusals of a simulation with the cause that each names, and stiff own resistances, which it accepts.

A motion that cannot be integrated is refused soon, and the message says when it ends and why.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import plough_opt as po

SOIL = po.named_soil("serozem")
SHARE = po.Wedge(po.deg(30), po.deg(15), 0.25)
STRONG = dataclasses.replace(SOIL, cohesion=1e6)
WAVE = po.StrengthWave(0.3, 0.2)


@dataclass(frozen=True)
class Own:
    """Resistance given by a function of travel and speed."""

    law: Callable

    def force(self, travel, speed):
        return self.law(travel, speed)


ROOTED = Own(lambda travel, speed: 100.0 * po.expressions.sqrt(0.3 - travel) + 0.0 * speed)  # no value beyond 0.3 m
NEVER = Own(lambda travel, speed: float("nan") * speed + 0.0 * travel)


def viscous(damping):
    return Own(lambda travel, speed: damping * speed + 0.0 * travel)


def refusal(scene, duration, **keywords):
    with pytest.raises(po.IntegrationError) as caught:
        po.simulate(scene, duration, **keywords)
    return str(caught.value)


def end_of_time(message):
    """Return the time beyond which the motion could not be integrated, according to a message."""
    return float(message.split("beyond t = ")[1].split(" s of")[0])


def escape(scene, duration):
    """Return, by SciPy, the time at which a share retreats a million times faster than it is towed."""
    k, m, v0, reaction = scene.stiffness, scene.inertia, scene.tow_speed, scene.reaction
    rate = scene.effects.rate_term or 0.0

    def rates(t, x):
        force = reaction.static * (1.0 + rate * x[1] ** 2) + reaction.drag * x[1] ** 2
        return [x[1], (k * (v0 * t - x[0]) - force) / m]

    def fast(_, x):
        return x[1] + 1e6 * v0

    fast.terminal = True
    start = [0.0, 0.0 if scene.effects.start == "rest" else v0]
    return solve_ivp(rates, (0.0, duration), start, events=fast, rtol=1e-9, atol=1e-9).t[-1]


@pytest.mark.parametrize("rate_term", [None, 0.1])
@pytest.mark.parametrize("start", ["rest", "towed"])
@pytest.mark.parametrize("mass", [0.07, 45.0])
def test_a_share_driven_away_by_the_soil(mass, start, rate_term):
    scene = po.Scene(STRONG, SHARE, 1e3, mass, 1.0, po.Effects(start=start, rate_term=rate_term))
    message = refusal(scene, 0.5)
    assert "the share retreats there at" in message
    assert "without bound in finite time" in message
    assert "oscillat" not in message
    # Bisected to 1 part in 5,000 with a tolerance of 1e-4, and printed with four digits.
    assert end_of_time(message) == pytest.approx(escape(scene, 0.5), rel=2e-3)


def test_a_share_driven_away_while_it_enters():
    share = po.Wedge(1.2, 0.2, 0.3)
    message = refusal(po.Scene(STRONG, share, 1e3, 5.0, 1.0, po.Effects(start="towed", entry=True)), 0.6)
    assert "the share retreats there at" in message


@pytest.mark.parametrize("start", ["equilibrium", "rest", "towed"])
def test_countless_waves_passed_under_a_repelling_spring(start):
    effects = po.Effects(formulation="printed", strength_wave=WAVE, inertial_drag=False, start=start)
    scene = po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, effects)
    assert "the strut and the soil change it" in refusal(scene, 1.5)
    # A shorter run is accepted: the travel grows like exp(33 t) from a few centimetres.
    assert po.simulate(scene, 0.2).error_estimate < 1e-6


@pytest.mark.parametrize(
    "effects",
    [{}, {"start": "towed", "entry": True}, {"contact": po.Smooth(0.2), "start": "rest"}, {"motion": False}],
    ids=["resisting", "entry", "smooth", "quasi-static"],
)
def test_an_own_effect_that_becomes_nan_is_named(effects):
    scene = po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(own=(ROOTED,), **effects))
    message = refusal(scene, 1.0)
    assert "the own effect Own returns nan N at a travel of 0.3" in message
    assert "must return a finite resistance" in message


def test_an_own_effect_that_is_always_nan_is_named():
    scene = po.Scene(SOIL, SHARE, 5e4, 45.0, 1.5, po.Effects(own=(NEVER,)))
    assert "the own effect Own returns nan N at a travel of 0 m" in refusal(scene, 1.0)


@pytest.mark.parametrize("outputs", ["4", None, 2.5, math.nan, True, 0, -4])
def test_outputs_are_a_whole_number(r1_scene, outputs):
    with pytest.raises(po.InputError, match=r"outputs = .* must be a whole number"):
        po.simulate(r1_scene(), 1.0, outputs=outputs)


@pytest.mark.parametrize("duration", [[1.0], "1", np.array([1.0, 2.0]), ca.DM([1.0, 2.0]), ca.MX.sym("duration", 2)])
def test_a_duration_is_one_number(r1_scene, duration):
    with pytest.raises((po.InputError, po.DomainError), match=r"duration|one number per quantity"):
        po.simulate(r1_scene(), duration)


def test_arguments_of_the_wrong_type(r1_scene, r1_soil):
    with pytest.raises(po.InputError, match="must be a Scene"):
        po.simulate(r1_soil, 1.0)
    with pytest.raises(po.InputError, match="must be an Accuracy"):
        po.simulate(r1_scene(), 1.0, accuracy="rk")
    with pytest.raises(po.InputError, match="one number per quantity"):
        po.simulate(r1_scene(stiffness=ca.MX.sym("stiffness", 2)), 1.0)


@pytest.mark.parametrize("force", [None, ca.DM([1.0, 2.0]), "12 N"], ids=str)
def test_an_own_force_of_the_wrong_type(r1_scene, force):
    with pytest.raises(po.InputError, match=r"Own\.force returned"):
        po.simulate(r1_scene(own=(Own(lambda *_: force),)), 1.0)


@pytest.mark.parametrize("motion", [True, False])
@pytest.mark.parametrize(("wavelength", "duration"), [(1e-6, 2.0), (0.6, 1e9)])
def test_countless_waves_are_refused_at_once(r1_scene, motion, wavelength, duration):
    scene = r1_scene(motion=motion, strength_wave=po.StrengthWave(0.3, wavelength))
    with pytest.raises(po.IntegrationError, match="times: use a shorter duration or a longer wave"):
        po.simulate(scene, duration)


@pytest.mark.parametrize("method", [None, "erk", "rosenbrock", "cvodes"])
def test_a_strong_own_damper(r1_scene, method):
    damping, duration = 5e4, 1.0
    accuracy = None if method is None else po.Accuracy(method)
    scene = r1_scene(inertial_drag=False, start="rest", own=(viscous(damping),))
    run = po.simulate(scene, duration, accuracy=accuracy)
    # M z'' = F0 + c (V0 - z') - k0 z from z = 0, z' = V0, overdamped.
    root = math.sqrt(damping**2 - 4.0 * scene.inertia * scene.stiffness)
    fast = -(damping + root) / (2.0 * scene.inertia)
    slow = scene.stiffness / (scene.inertia * fast)
    last = (scene.reaction.static + damping * scene.tow_speed) / scene.stiffness
    of_fast = (scene.tow_speed + slow * last) / (fast - slow)
    exact = last + of_fast * np.exp(fast * run.time) - (last + of_fast) * np.exp(slow * run.time)
    # The default error, which a named method's tolerance of 1e-10 reaches too.
    np.testing.assert_allclose(run.deflection, exact, rtol=0.0, atol=1e-8 * np.max(exact))
    assert run.error_estimate < 1e-8


def test_a_stiff_own_spring(r1_scene):
    ground = 1e7
    scene = r1_scene(inertial_drag=False, start="rest", own=(Own(lambda travel, speed: ground * travel + 0.0 * speed),))
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


def test_runs_are_compared_by_identity(r1_scene):
    run = po.simulate(r1_scene(), 0.1)
    assert run in [run]
    assert run != po.simulate(r1_scene(), 0.1)
