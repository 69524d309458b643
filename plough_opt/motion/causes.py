"""Why a motion could not be followed, named by what is known of the scene and of the motion until then."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.core.errors import IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion.integrators import Integration
from plough_opt.motion.methods import METHODS
from plough_opt.motion.plan import STIFF_PHASE, numbers_of, phase, steps_for, with_setting
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters, start_deflection

# Exponents of growth above this overflow, squared as they are in an RMS sooner than by themselves.
_MOST_GROWTH: Final = 700.0
# Steps beyond the last state that was reached, of a length in which the motion failed, at which own effects are asked.
_BEYOND: Final = np.linspace(0.0, 2.0, 9)


class Escape(IntegrationError):
    """A share that is driven away without bound before the duration is over: no other method follows it further."""


def refuse_runaway(scene: Scene, duration: float) -> None:
    """Refuse a repelling spring over a time in which no number holds the travel, and no method ends soon."""
    if scene.effects.printed.repelling_spring and _growth(scene) * duration > _MOST_GROWTH:
        raise Escape(f"the motion of a {scene.describe()} has no end in {duration:g} s: {_runaway(scene)}")


def waves_in_flight(scene: Scene, p: Mapping[str, float], duration: float) -> float:
    """Return the phase [rad] of the soil's strength that a share passes which a repelling spring drives away.

    Drag, which slows it down or ends the motion in finite time, is left out: with it no such phase is reported.
    """
    if not scene.effects.printed.repelling_spring or "wavelength" not in p or "drag" in p or "rate_term" in p:
        return 0.0
    growth, steady = _growth(scene), p["static"] / abs(p["stiffness"])
    amplitude = sum(value for name, value in p.items() if name.startswith("wave_amplitude"))
    shortest = min(value for name, value in p.items() if name.startswith("wavelength"))
    off = amplitude * steady if scene.effects.start == "equilibrium" else steady + p["tow_speed"] / growth
    # Half the offset from the equilibrium grows; a wave is passed twice as finely as its sine turns: see `forced_rate`.
    travel = 0.5 * off * math.exp(min(growth * duration, _MOST_GROWTH))
    return 4.0 * math.pi * travel / shortest


def failed_by(scene: Scene, duration: float, solver: Integration, last: Run | None, pause: float) -> IntegrationError:
    """Return the error that says when and why an integration failed, and what to do.

    Args:
        scene: numeric.
        duration: of the run [s].
        solver: what failed.
        last: the motion until shortly before, if any could be followed.
        pause: time in which it then failed [s].
    """
    until = 0.0 if last is None else float(last.duration)
    failure = (
        f"the motion of a {scene.describe()} could not be integrated by '{solver.accuracy.method}' beyond"
        f" t = {until:.4g} s of {duration:g} s: "
    )
    if (unsound := unsound_own(scene, last, pause)) is not None:
        return Escape(failure + unsound)
    if scene.effects.printed.repelling_spring:
        return Escape(failure + _runaway(scene))
    if last is not None and (driven := _driven_away(scene, last)) is not None:
        return Escape(failure + driven)
    return IntegrationError(failure + _too_much(scene, duration, solver))


def unsound_own(scene: Scene, last: Run | None, pause: float) -> str | None:
    """Return which of the user's own resistances is not a finite number along a motion or shortly beyond, if any.

    Args:
        scene: numeric.
        last: a motion; None: the start alone.
        pause: time beyond its end [s].
    """
    if not scene.effects.own:
        return None
    structure, p = Structure.of(scene), parameters(scene)
    if last is None:
        start = -float(as_number(start_deflection(structure, p)))
        places = [(start if math.isfinite(start) else 0.0, v) for v in (0.0, float(as_number(scene.tow_speed)))]
    else:
        places = [*zip(last.travel.tolist(), last.speed.tolist(), strict=True)]
        travel, speed = places[-1]
        places += [(travel + float(beyond) * pause * speed, speed) for beyond in _BEYOND]
    for term in structure.own:
        for travel, speed in places:
            with np.errstate(all="ignore"):
                force = float(as_number(term.force(p, travel, speed)))
            if not math.isfinite(force):
                return (
                    f"the own effect {term.kind.__name__} returns {force} N at a travel of {travel:.6g} m and a speed"
                    f" of {speed:.6g} m/s: it must return a finite resistance wherever the share may come"
                )
    return None


def _driven_away(scene: Scene, last: Run) -> str | None:
    """Return that the soil drives a retreating share away, if the motion ends in that, and not by too long steps."""
    speed, p = float(last.speed[-1]), numbers_of(scene)
    growing = float(p.get("drag", 0.0) + p["static"] * p.get("rate_term", 0.0))
    rest = p["static"] + abs(float(last.mount_force[-1]))
    fastest = abs(speed) >= 0.99 * float(np.max(np.abs(last.speed)))
    if not last.accuracy.adaptive:
        return None
    if scene.effects.contact != "resisting" or speed >= 0.0 or not fastest or growing * speed * speed < rest:
        return None
    return (
        f"the share retreats there at {-speed:.3g} m/s, and under contact 'resisting' the resistance drives the share"
        " away: it grows with the square of that speed and pushes it back ever faster, without bound in finite time, as"
        " real soil does not: take contact = StickSlip(), a stiffer mount, or a shorter duration"
    )


def _too_much(scene: Scene, duration: float, solver: Integration) -> str:
    total, outputs, accuracy = phase(numbers_of(scene), duration), solver.timeline.outputs, solver.accuracy
    turns = total / (2.0 * math.pi)
    if METHODS[accuracy.method].order is not None:
        enough = with_setting(replace(accuracy, steps=None), steps_for(total), outputs).steps or 0
        if enough > 2 * (accuracy.steps or 0):
            return f"{accuracy.steps} steps are too few for {turns:.3g} oscillations: take steps={enough}"
    if total > STIFF_PHASE:
        return (
            f"it oscillates {turns:.3g} times meanwhile: use the quasi-static scene (Effects(motion=False)),"
            " a softer or a damped mount, or a shorter duration"
        )
    return "the tolerance is tighter than rounding allows, or the resistance drives the share away"


def _growth(scene: Scene) -> float:
    """Return the rate [1/s] at which a repelling spring, against the mount's damper, drives the share away."""
    decay = float(as_number(scene.effects.damping or 0.0)) / (2.0 * float(as_number(scene.inertia)))
    frequency = float(as_number(scene.natural_frequency))
    return frequency**2 / (decay + math.hypot(decay, frequency))


def _runaway(scene: Scene) -> str:
    return (
        f"the print's repelling spring drives the share away like exp({_growth(scene):.3g} t), and drag still faster,"
        " beyond what the method can follow: take a shorter duration, or formulation = 'derived'"
    )
