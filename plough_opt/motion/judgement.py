"""Errors before a motion is followed, reasons why one failed, and warnings about a finished run."""

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion.causes import waves_in_flight
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import SLIP, STICK
from plough_opt.motion.orbit import monodromy
from plough_opt.motion.plan import (
    MOST_RINGING,
    MOST_SHOT,
    PHASE_PER_STEP,
    forced_rate,
    numbers_of,
    phase,
    ringing,
    steps_for,
)
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure, hold, own_force, parameters, start_deflection
from plough_opt.motion.timeline import Timeline

# Exponents of growth above this overflow, squared as they are in an RMS sooner than by themselves.
_MOST_GROWTH = 700.0
# Speeds backwards below this fraction of the fastest speed are rounding, not retreat.
_RETREAT = 1e-9
# Part of the fastest speed below which a share all but stops.
_GRAZES = 5e-3
# A multiplier above 1 by less is that of an undamped mount, rounded.
_MARGINAL = 1e-8
# Speeds backwards of a slipping share above this fraction are not the rounding of the time at which it stopped.
_MISSED = 1e-5


# Places in a wavelength at which own resistances are compared with those one wavelength on, and the relative difference
# that is rounding of a travel.
_OWN_PLACES = 16
_SAME_OWN = 1e-9


class MissedEvent(IntegrationError):
    """An integrator went past the moment at which a share stopped or broke loose."""


def refuse_ringing(scene: Scene, duration: float) -> None:
    """Refuse a start from which a stiff mount rings so often that following it would take minutes."""
    if scene.effects.start == "equilibrium" or scene.effects.printed.repelling_spring:
        return
    turns = ringing(numbers_of(scene), duration)
    if turns <= MOST_RINGING:
        return
    steps = turns / PHASE_PER_STEP
    raise IntegrationError(
        f"the motion of a {scene.describe()}: from this start it rings {turns / (2.0 * math.pi):.3g} times, which"
        f" would take some {steps:.1g} steps: damp the mount, start at equilibrium, take a softer mount, a shorter"
        " duration or the quasi-static scene, or name a method, as Accuracy('erk'), to follow it all the same"
    )


def refuse_countless_waves(scene: Scene, p: Mapping[str, float], duration: float, most: float) -> None:
    """Refuse a wave, or a ramp, so short beside the run that following it would take minutes.

    Args:
        scene: numeric.
        p: its parameters.
        duration: of the run [s].
        most: phase [rad] that is followed.
    """
    total = forced_rate(p) * duration + waves_in_flight(scene, p, duration)
    if total <= most:
        return
    by_name = ", or name a method, as Accuracy('erk'), to follow them all the same" if scene.effects.motion else ""
    raise IntegrationError(
        f"the motion of a {scene.describe()}: in {duration:g} s the strut and the soil change it"
        f" {total / (4.0 * math.pi):.3g} times: take a shorter duration or a longer wave{by_name}"
    )


def refuse_stiff_orbit(scene: Scene) -> None:
    """Refuse a lasting orbit so stiff that finding it, or the error of its approximation, would take minutes.

    Args:
        scene: numeric, with an orbit.

    Raises:
        IntegrationError: it is stiffer than what is computed by default.
    """
    total = phase(numbers_of(scene), float(as_number(scene.wave_period))) if scene.effects.waves else 0.0
    if total <= MOST_SHOT:
        return
    stands = "" if scene.effects.orbit == "periodic" else ", from which this stand-in's error is told,"
    raise IntegrationError(
        f"the lasting orbit of a {scene.describe()}: its fastest part runs through {total / (2.0 * math.pi):.3g} turns"
        f" in one wavelength, so that the orbit{stands} would take minutes to find: take a softer or less damped mount,"
        " a shorter wave or a higher tow speed, the quasi-static scene (Effects(motion=False)), or name a method, as"
        f" Accuracy('dop853', steps={steps_for(total)}), to seek it all the same"
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
    structure, p = Structure.of(scene), numbers_of(scene)
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
    if np.any(late):
        raise MissedEvent(
            f"the motion of a {run.scene.describe()}: '{run.accuracy.method}' missed that the share broke loose before"
            f" t = {run.time[np.argmax(late)]:.4g} s: take a tighter tolerance"
        )
    slowest = float(np.min(np.where(run.mode == SLIP, run.speed, 0.0)))
    if slowest < -_MISSED * float(np.max(np.abs(run.speed))):
        first = float(run.time[np.argmax((run.mode == SLIP) & (run.speed == slowest))])
        raise MissedEvent(
            f"the motion of a {run.scene.describe()}: '{run.accuracy.method}' missed that the share stopped before"
            f" t = {first:.4g} s: take a tighter tolerance"
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


def stability(run: Run) -> tuple[tuple[complex, ...], tuple[str, ...]]:
    """Return the Floquet multipliers of an orbit, and a warning where it is unstable."""
    structure, numbers = Structure.of(run.scene), numbers_of(run.scene)
    p = ca.DM([*(numbers[name] for name in signals(structure).parameters), float(run.duration)])
    start = ca.DM([run.deflection[0] - start_deflection(structure, numbers), run.scene.tow_speed - run.speed[0]])
    # A numeric orbit has a number of steps; derivatives by the start are known less exactly by the same.
    once = Timeline(1, 2 * (run.accuracy.steps or 1))
    found = np.linalg.eigvals(monodromy(structure, once)(start, p).full())
    largest = float(np.max(np.abs(found)))
    multipliers = tuple(complex(value) for value in found)
    if largest <= 1.0 + _MARGINAL:
        return multipliers, ()
    return multipliers, (
        f"the orbit is unstable: a deviation grows {largest:.4g} times in every wavelength, so no share stays on it",
    )
