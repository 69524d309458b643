"""Checks before integration, diagnosis of failed runs, and warnings about finished ones."""

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
from plough_opt.motion.terms import Structure, hold, parameters, start_deflection

# exp of a larger exponent overflows.
_MOST_GROWTH: Final = 700.0
# Own effects are evaluated beyond the last state too, at these multiples of the time until the motion failed.
_BEYOND: Final = np.linspace(0.0, 2.0, 9)
# A backward speed below this fraction of the fastest speed is rounding, not a retreat.
_RETREAT = 1e-9
# A share whose speed falls below this fraction of the fastest speed nearly stops.
_NEARLY_STOPS = 5e-3
# A slipping share with a backward speed above this fraction of the fastest speed shows that its stop was missed. A
# smaller one is due to rounding of the time of the stop.
_MISSED = 1e-5
# Places in a wavelength at which own resistances are compared with those one wavelength further on.
_OWN_PLACES = 16
# Relative difference of such resistances that is due to rounding of the travel.
_OWN_ROUNDING = 1e-9


class Escape(IntegrationError):
    """A share that is driven away without bound before the end of the run, which no other method can change."""


def refuse_runaway(scene: Scene, duration: float) -> None:
    """Raise Escape if a repelling spring drives the share beyond the range of floating point before the end."""
    if scene.effects.printed.repelling_spring and _growth(scene) * duration > _MOST_GROWTH:
        raise Escape(f"the motion of a {scene.describe()} overflows within {duration:g} s: {_runaway(scene)}")


def waves_in_flight(scene: Scene, p: Mapping[str, float], duration: float) -> float:
    """Return the phase [rad] of the strength wave that a share passes while a repelling spring drives it away.

    It is 0 in scenes with drag or a rate term, which slow the share down or end the motion in finite time.
    """
    if not scene.effects.printed.repelling_spring or "wavelength" not in p or "drag" in p or "rate_term" in p:
        return 0.0
    growth, steady = _growth(scene), p["static"] / abs(p["stiffness"])
    amplitude = sum(value for name, value in p.items() if name.startswith("wave_amplitude"))
    shortest = min(value for name, value in p.items() if name.startswith("wavelength"))
    offset = amplitude * steady if scene.effects.start == "equilibrium" else steady + p["tow_speed"] / growth
    # Half the offset from the equilibrium grows. Two rad for each rad of the wave: see `forced_rate`.
    travel = 0.5 * offset * math.exp(min(growth * duration, _MOST_GROWTH))
    return 4.0 * math.pi * travel / shortest


def failed_by(scene: Scene, duration: float, solver: Integration, last: Run | None, pause: float) -> IntegrationError:
    """Return the error that says when and why an integration failed, and what to do.

    Args:
        scene: numeric scene.
        duration: of the run [s].
        solver: the integration that failed.
        last: the motion until shortly before it failed, or None if it failed at once.
        pause: time from the end of ``last`` to the failure [s].
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
    if last is not None and (driven := _driven_by_own(scene, last) or _driven_away(scene, last)) is not None:
        return Escape(failure + driven)
    return IntegrationError(failure + _too_difficult(scene, duration, solver))


def unsound_own(scene: Scene, last: Run | None, pause: float) -> str | None:
    """Return a sentence on an own effect with a force that is not finite along a motion or shortly after; else None.

    Args:
        scene: numeric scene.
        last: the motion, or None to check the start only.
        pause: time from its end to the failure [s]; twice this time is checked too.
    """
    if not scene.effects.own:
        return None
    structure, p = Structure.of(scene), parameters(scene)
    if last is None:
        start = 0.0 - float(as_number(start_deflection(structure, p)))
        places = [(start if math.isfinite(start) else 0.0, v) for v in (0.0, float(as_number(scene.tow_speed)))]
    else:
        places = [*zip(last.travel.tolist(), last.speed.tolist(), strict=True)]
        travel, speed = places[-1]
        places += [(travel + float(beyond) * pause * speed, speed) for beyond in _BEYOND]
    for term in structure.own:
        for travel, speed in places:
            force = float(as_number(term.force(p, travel, speed)))
            held = float(as_number(term.at_rest(p, travel))) if structure.sticks else 0.0
            if not math.isfinite(force + held):
                found, at = (held, "rest") if math.isfinite(force) else (force, f"a speed of {speed:.6g} m/s")
                return (
                    f"the own effect {term.kind.__name__} returns {found} N at a travel of {travel:.6g} m and at {at}:"
                    " it must return a finite resistance wherever the share may go"
                )
    return None


def _driven_by_own(scene: Scene, last: Run) -> str | None:
    """Return a sentence if the motion ends because an own effect drives the share ever faster; else None."""
    travel, speed = float(last.travel[-1]), float(last.speed[-1])
    structure, p = Structure.of(scene), parameters(scene)
    forces = {term: float(as_number(term.force(p, travel, speed))) for term in structure.own}
    strongest = max(forces, key=lambda term: abs(forces[term]), default=None)
    if strongest is None or not last.accuracy.adaptive or abs(speed) < 0.99 * float(np.max(np.abs(last.speed))):
        return None
    # A resistance against the motion has its sign; one that drives the share must exceed the spring's force too.
    force, others = forces[strongest], abs(float(last.mount_force[-1])) + float(as_number(p["static"]))
    if force * speed >= 0.0 or abs(force) < others:
        return None
    return (
        f"the own effect {strongest.kind.__name__} drives the share ever faster: it returns {force:.3g} N there, at a"
        f" travel of {travel:.3g} m and a speed of {speed:.3g} m/s: let it oppose the motion, or limit it at high speed"
    )


def _driven_away(scene: Scene, last: Run) -> str | None:
    """Return a sentence if the motion ends because the soil drives a retreating share away; else None."""
    retreat, p = -float(last.speed[-1]), plan.numbers_of(scene)
    growing = float(p.get("drag", 0.0) + p["static"] * p.get("rate_term", 0.0))
    rest = p["static"] + abs(float(last.mount_force[-1]))
    fastest = retreat >= 0.99 * float(np.max(np.abs(last.speed)))
    if not last.accuracy.adaptive:  # fixed steps may just have been too long, and the last speed any number
        return None
    if scene.effects.contact != "resisting" or not fastest or growing * retreat**2 <= rest:
        return None
    return (
        f"the share retreats there at {retreat:.3g} m/s, and under contact 'resisting' the resistance drives the share"
        " away: it grows with the square of that speed and pushes the share back ever faster, without bound in finite"
        " time, which real soil does not do: use contact = StickSlip(), a stiffer mount, or a shorter duration"
    )


def _too_difficult(scene: Scene, duration: float, solver: Integration) -> str:
    """Return why an integration failed that neither an own effect nor an escape explains."""
    total, outputs, accuracy = plan.phase(plan.numbers_of(scene), duration), solver.timeline.outputs, solver.accuracy
    turns = total / (2.0 * math.pi)
    if METHODS[accuracy.method].order is not None:
        enough = plan.with_setting(replace(accuracy, steps=None), plan.steps_for(total), outputs).steps or 0
        if enough > 2 * (accuracy.steps or 0):
            return f"{accuracy.steps} steps are too few for {turns:.3g} oscillations: use steps={enough}"
    if total > plan.STIFF_PHASE:
        return (
            f"it oscillates {turns:.3g} times until then: use the quasi-static scene (Effects(motion=False)),"
            " a softer or a damped mount, or a shorter duration"
        )
    return "steps are too long, the tolerance is tighter than rounding allows, or the resistance drives the share away"


def _growth(scene: Scene) -> float:
    """Return the rate [1/s] of the exponential growth by which a repelling spring drives the share away."""
    decay = float(as_number(scene.effects.damping or 0.0)) / (2.0 * float(as_number(scene.inertia)))
    frequency = float(as_number(scene.natural_frequency))
    return frequency**2 / (decay + math.hypot(decay, frequency))


def _runaway(scene: Scene) -> str:
    return (
        f"the print's repelling spring drives the share away like exp({_growth(scene):.3g} t), and drag still faster,"
        " so that the method fails: use a shorter duration, or formulation = 'derived'"
    )


class MissedEvent(IntegrationError):
    """An integrator passed the moment at which a share stopped or broke loose without noticing it."""


def refuse_endless(scene: Scene, p: Mapping[str, float], duration: float) -> None:
    """Raise an error for a run that would take minutes.

    Args:
        scene: numeric scene.
        p: the equation's parameters by name.
        duration: of the run [s].

    Raises:
        IntegrationError: the mount is too stiff for a periodic orbit, it rings too often from this start, or a wave or
            the tow ramp is too short compared with the run.
    """
    if scene.effects.orbit != "transient":
        return refuse_stiff_orbit(scene)
    relaxed = scene.effects.start != "equilibrium" and not scene.effects.printed.repelling_spring
    turns = plan.ringing(p, duration) if relaxed else 0.0
    if turns > plan.MOST_RINGING:
        raise IntegrationError(
            f"the motion of a {scene.describe()}: from this start it rings {turns / (2.0 * math.pi):.3g} times, which"
            f" would take about {turns / plan.PHASE_PER_STEP:.1g} steps: damp the mount, start at equilibrium, use a"
            " softer mount, a shorter duration or the quasi-static scene, or name a method, such as Accuracy('erk'), to"
            " integrate it anyway"
        )
    total = plan.forced_rate(p) * duration + waves_in_flight(scene, p, duration)
    motion = scene.effects.motion
    if total > (plan.MOST_FORCED if motion else plan.MOST_PANELLED):
        by_name = ", or name a method, such as Accuracy('erk'), to integrate it anyway" if motion else ""
        raise IntegrationError(
            f"the motion of a {scene.describe()}: in {duration:g} s the strut and the soil change it"
            f" {total / (4.0 * math.pi):.3g} times: use a shorter duration or a longer wave{by_name}"
        )
    return None


def refuse_stiff_orbit(scene: Scene) -> None:
    """Raise an error if finding a periodic orbit, or the error of its approximation, would take minutes.

    Args:
        scene: numeric scene with an orbit.

    Raises:
        IntegrationError: the motion is stiffer than `plough_opt.motion.plan.MOST_SHOT` allows by default.
    """
    total = plan.phase(plan.numbers_of(scene), float(as_number(scene.wave_period))) if scene.effects.waves else 0.0
    if total <= plan.MOST_SHOT:
        return
    purpose = "" if scene.effects.orbit == "periodic" else ", which the error of this approximation needs,"
    raise IntegrationError(
        f"the periodic orbit of a {scene.describe()}{purpose} would take minutes to find: its fastest part makes"
        f" {total / (2.0 * math.pi):.3g} turns in one wavelength; use a softer or less damped mount, a shorter wave, a"
        " higher tow speed or the quasi-static scene (Effects(motion=False)), or name a method, such as"
        f" Accuracy('dop853', steps={plan.steps_for(total)}), to compute it anyway"
    )


def refuse_drifting_own(scene: Scene) -> None:
    """Raise an error if own resistances do not repeat with the wave, so that there is no periodic orbit.

    Args:
        scene: numeric scene with an orbit.

    Raises:
        InputError: a resistance differs one wavelength further on.
    """
    if not scene.effects.own:
        return
    structure, p = Structure.of(scene), plan.numbers_of(scene)

    def force(place: float, speed: float) -> float:
        return float(as_number(sum(term.force(p, place, speed) for term in structure.own)))

    places = [k / _OWN_PLACES * p["wavelength"] for k in range(_OWN_PLACES)]
    at = [(place, part * p["tow_speed"]) for place in places for part in (0.5, 1.0, 1.5)]
    both = np.array([(force(place, speed), force(place + p["wavelength"], speed)) for place, speed in at])
    both = both[np.isfinite(both).all(axis=1)]  # the integration reports the others, if the share comes there
    if np.any(np.abs(both[:, 0] - both[:, 1]) > _OWN_ROUNDING * np.max(np.abs(both), initial=0.0)):
        names = ", ".join(type(effect).__name__ for effect in scene.effects.own)
        raise InputError(
            f"own effects ({names}) have another resistance one wavelength ({p['wavelength']:g} m) further on, so no"
            " motion repeats itself with the wave: leave orbit out and simulate from a start"
        )


def refuse_weak_rest(scene: Scene, run: Run) -> None:
    """Raise an error if an own effect holds a resting share with less force than it resists a slipping one.

    Such a share would stop and break loose endlessly.

    Args:
        scene: numeric scene.
        run: its run under `StickSlip`.

    Raises:
        InputError: an own effect does so somewhere along the run.
    """
    structure, p = Structure.of(scene), parameters(scene)
    for term in structure.own:
        held, slips = (np.broadcast_to(as_number(force), run.travel.shape) for force in (
            term.at_rest(p, run.travel), term.force(p, run.travel, 0.0)))  # fmt: skip
        if np.any(weak := ~(held >= slips * (1.0 - _MISSED))):
            worst = int(np.argmax(weak))
            raise InputError(
                f"the own effect {term.kind.__name__} holds a share at rest with {held[worst]:.6g} N at a travel of"
                f" {run.travel[worst]:.6g} m, but resists one that begins to slip with {slips[worst]:.6g} N: at_rest"
                " must be at least the force at speed 0"
            )


def refuse_missed_event(run: Run) -> None:
    """Raise an error if an integrator missed an event of a share under `StickSlip`.

    Raises:
        MissedEvent: a slipping share retreats, or one is held although the mount pulls harder than the soil holds.
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
                f" t = {run.time[np.argmax(seen)]:.4g} s: use a tighter tolerance"
            )


def remarks(run: Run) -> tuple[str, ...]:
    """Return the warnings that follow from the outputs of a motion."""
    return (*retreat(run), *grazing(run))


def retreat(run: Run) -> tuple[str, ...]:
    """Return a warning if the share retreats at an output time under a contact law without gaps."""
    contact = run.scene.effects.contact
    slowest = float(np.min(run.speed))
    if slowest >= 0.0 or isinstance(contact, StickSlip) or slowest >= -_RETREAT * float(np.max(np.abs(run.speed))):
        return ()
    law = (
        "under contact 'resisting' the soil then pushes it backwards, which real soil does not do"
        if contact == "resisting"
        else "the smooth contact ignores the gap that the share leaves; StickSlip() does not"
    )
    return (f"the share retreats (at up to {-slowest:.3g} m/s): {law}",)


def grazing(run: Run) -> tuple[str, ...]:
    """Return a warning if a share under `StickSlip` nearly stops at an output time and slips on."""
    if not isinstance(run.scene.effects.contact, StickSlip):
        return ()
    before, here, after = run.speed[:-2], run.speed[1:-1], run.speed[2:]
    slips = (run.mode[:-2] == SLIP) & (run.mode[1:-1] == SLIP) & (run.mode[2:] == SLIP)
    slow = _NEARLY_STOPS * float(np.max(run.speed))
    # A share that has just begun to move is slow too.
    moved = np.maximum.accumulate(before) >= slow
    low = slips & moved & (here <= before) & (here <= after) & (here < slow)
    if not np.any(low):
        return ()
    first = int(np.argmax(low)) + 1
    return (
        f"the share nearly stops at t = {run.time[first]:.4g} s ({run.speed[first]:.2g} m/s) and slips on: where its"
        " speed just touches zero the motion has no derivative, and derivatives are those of slipping on",
    )
