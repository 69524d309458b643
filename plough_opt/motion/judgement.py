"""Errors before a motion is followed, reasons why one failed, and warnings about a finished run."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion import plan
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import SLIP, STICK
from plough_opt.motion.integrators import Integration
from plough_opt.motion.methods import METHODS
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, hold, own_force, parameters, start_deflection

# Exponents of growth above this overflow, squared as they are in an RMS sooner than by themselves.
_MOST_GROWTH: Final = 700.0
# Steps beyond the last state that was reached, of a length in which the motion failed, at which own effects are tried.
_BEYOND: Final = np.linspace(0.0, 2.0, 9)
# Speeds backwards below this fraction of the fastest speed are rounding, not retreat.
_RETREAT = 1e-9
# Part of the fastest speed below which a share all but stops.
_GRAZES = 5e-3
# Speeds backwards of a slipping share above this fraction are not the rounding of the time at which it stopped.
_MISSED = 1e-5
# Places in a wavelength at which own resistances are compared with those one wavelength on, and the relative difference
# that is rounding of a travel.
_OWN_PLACES = 16
_SAME_OWN = 1e-9


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
    speed, p = float(last.speed[-1]), plan.numbers_of(scene)
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
    total, outputs, accuracy = plan.phase(plan.numbers_of(scene), duration), solver.timeline.outputs, solver.accuracy
    turns = total / (2.0 * math.pi)
    if METHODS[accuracy.method].order is not None:
        enough = plan.with_setting(replace(accuracy, steps=None), plan.steps_for(total), outputs).steps or 0
        if enough > 2 * (accuracy.steps or 0):
            return f"{accuracy.steps} steps are too few for {turns:.3g} oscillations: take steps={enough}"
    if total > plan.STIFF_PHASE:
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


class MissedEvent(IntegrationError):
    """An integrator went past the moment at which a share stopped or broke loose."""


def refuse_endless(scene: Scene, p: Mapping[str, float], duration: float) -> None:
    """Refuse a scene that would take minutes to follow.

    Args:
        scene: numeric.
        p: its parameters.
        duration: of the run [s].

    Raises:
        IntegrationError: a lasting orbit too stiff, a start from which a stiff mount rings too often, or a wave, or a
            ramp, too short beside the run.
    """
    if scene.effects.orbit != "transient":
        return refuse_stiff_orbit(scene)
    relaxed = scene.effects.start != "equilibrium" and not scene.effects.printed.repelling_spring
    turns = plan.ringing(p, duration) if relaxed else 0.0
    if turns > plan.MOST_RINGING:
        raise IntegrationError(
            f"the motion of a {scene.describe()}: from this start it rings {turns / (2.0 * math.pi):.3g} times, which"
            f" would take some {turns / plan.PHASE_PER_STEP:.1g} steps: damp the mount, start at equilibrium, take a"
            " softer mount, a shorter duration or the quasi-static scene, or name a method, as Accuracy('erk'), to"
            " follow it all the same"
        )
    total = plan.forced_rate(p) * duration + waves_in_flight(scene, p, duration)
    motion = scene.effects.motion
    if total > (plan.MOST_FORCED if motion else plan.MOST_PANELLED):
        by_name = ", or name a method, as Accuracy('erk'), to follow them all the same" if motion else ""
        raise IntegrationError(
            f"the motion of a {scene.describe()}: in {duration:g} s the strut and the soil change it"
            f" {total / (4.0 * math.pi):.3g} times: take a shorter duration or a longer wave{by_name}"
        )
    return None


def refuse_stiff_orbit(scene: Scene) -> None:
    """Refuse a lasting orbit so stiff that finding it, or the error of its approximation, would take minutes.

    Args:
        scene: numeric, with an orbit.

    Raises:
        IntegrationError: it is stiffer than what is computed by default.
    """
    total = plan.phase(plan.numbers_of(scene), float(as_number(scene.wave_period))) if scene.effects.waves else 0.0
    if total <= plan.MOST_SHOT:
        return
    stands = "" if scene.effects.orbit == "periodic" else ", from which this stand-in's error follows,"
    raise IntegrationError(
        f"the lasting orbit of a {scene.describe()}: its fastest part runs through {total / (2.0 * math.pi):.3g} turns"
        f" in one wavelength, so that the orbit{stands} would take minutes to find: take a softer or less damped mount,"
        " a shorter wave or a higher tow speed, the quasi-static scene (Effects(motion=False)), or name a method, as"
        f" Accuracy('dop853', steps={plan.steps_for(total)}), to seek it all the same"
    )


def refuse_drifting_own(scene: Scene) -> None:
    """Refuse a lasting orbit under own resistances that are not the same one wavelength on.

    Args:
        scene: numeric, with an orbit.

    Raises:
        InputError: they differ.
    """
    if not scene.effects.own:
        return
    structure, p = Structure.of(scene), plan.numbers_of(scene)
    places = [k / _OWN_PLACES * p["wavelength"] for k in range(_OWN_PLACES)]
    both = [
        [float(as_number(own_force(structure, p, place + on, part * p["tow_speed"]))) for on in (0.0, p["wavelength"])]
        for place in places
        for part in (0.5, 1.0, 1.5)
    ]
    size = max(abs(force) for pair in both for force in pair)
    if any(abs(before - after) > _SAME_OWN * size for before, after in both):
        names = ", ".join(type(effect).__name__ for effect in scene.effects.own)
        raise InputError(
            f"own effects ({names}) resist otherwise one wavelength ({p['wavelength']:g} m) further on: no motion"
            " repeats itself with the wave then, so leave orbit out and simulate from a start"
        )


def refuse_weak_rest(scene: Scene, run: Run) -> None:
    """Refuse own effects that hold a share at rest with less than what they resist it with as it begins to slip.

    Such a share would stop and move again without end.

    Raises:
        InputError: one does, somewhere along a run under `StickSlip`.
    """
    structure, p = Structure.of(scene), parameters(scene)
    for term in structure.own:
        held, slips = (np.broadcast_to(as_number(force), run.travel.shape) for force in (
            term.at_rest(p, run.travel), term.force(p, run.travel, 0.0)))  # fmt: skip
        if np.any(weak := ~(held >= slips * (1.0 - _MISSED))):
            worst = int(np.argmax(weak))
            raise InputError(
                f"the own effect {term.kind.__name__} holds a share at rest with {held[worst]:.6g} N at a travel of"
                f" {run.travel[worst]:.6g} m, and resists one that begins to slip with {slips[worst]:.6g} N: at_rest"
                " must be no less than force at no speed"
            )


def refuse_missed_event(run: Run) -> None:
    """Refuse a run in which the share retreats without a gap, or is held too long.

    Raises:
        MissedEvent: an event was missed.
    """
    structure, p = Structure.of(run.scene), parameters(run.scene)
    held = hold(structure, p, run.travel)
    size = float(np.max(np.abs(run.mount_force)))
    late = (run.mode == STICK) & (run.mount_force > held + _MISSED * size)
    slowest = float(np.min(np.where(run.mode == SLIP, run.speed, 0.0)))
    backwards = slowest < -_MISSED * float(np.max(np.abs(run.speed)))
    for event, seen in (("broke loose", late), ("stopped", backwards & (run.mode == SLIP) & (run.speed == slowest))):
        if np.any(seen):
            raise MissedEvent(
                f"the motion of a {run.scene.describe()}: '{run.accuracy.method}' missed that the share {event} before"
                f" t = {run.time[np.argmax(seen)]:.4g} s: take a tighter tolerance"
            )


def remarks(run: Run) -> tuple[str, ...]:
    """Return what a reader must know of a motion, by its outputs."""
    return (*retreat(run), *grazing(run))


def retreat(run: Run) -> tuple[str, ...]:
    """Return a warning where, at an output time, the share retreats under a contact law that knows no gap."""
    contact = run.scene.effects.contact
    slowest = float(np.min(run.speed))
    if slowest >= 0.0 or isinstance(contact, StickSlip) or slowest >= -_RETREAT * float(np.max(np.abs(run.speed))):
        return ()
    law = (
        "under contact 'resisting' the soil then pushes it backwards, which real soil does not"
        if contact == "resisting"
        else "the smooth contact forgets the gap that it leaves; StickSlip() does not"
    )
    return (f"the share retreats (at up to {-slowest:.3g} m/s): {law}",)


def grazing(run: Run) -> tuple[str, ...]:
    """Return a warning where, at an output time, a share under stick and slip all but stops and slips on."""
    if not isinstance(run.scene.effects.contact, StickSlip):
        return ()
    before, here, after = run.speed[:-2], run.speed[1:-1], run.speed[2:]
    slips = (run.mode[:-2] == SLIP) & (run.mode[1:-1] == SLIP) & (run.mode[2:] == SLIP)
    slow = _GRAZES * float(np.max(run.speed))
    # A share that only begins to move does not stop.
    moved = np.maximum.accumulate(before) >= slow
    low = slips & moved & (here <= before) & (here <= after) & (here < slow)
    if not np.any(low):
        return ()
    first = int(np.argmax(low)) + 1
    return (
        f"the share all but stops at t = {run.time[first]:.4g} s ({run.speed[first]:.2g} m/s) and slips on: where its"
        " speed just touches zero the motion has no derivative, and derivatives given are those of slipping on",
    )
