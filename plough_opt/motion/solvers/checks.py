"""Checks of runs: refusals before an integration, why one failed, warnings, and the difference of two runs."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import SLIP, STICK, Structure, parameters
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.run import Averages, Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers import plan

# A slipping share with a backward speed above this fraction of the fastest speed shows that its stop was missed. A
# smaller one is due to rounding of the time of the stop.
_MISSED = 1e-5
# Places in a wavelength at which own resistances are compared with those one wavelength further on.
_OWN_PLACES = 16


class Escape(IntegrationError):
    """A share that is driven away without bound before the end of the run, which no other method can change."""


# --- refusals before an integration ---


def refuse_endless(scene: Scene, duration: float) -> None:
    """Raise an error for a run that would take minutes.

    Args:
        scene: numeric scene.
        duration: of the run [s].

    Raises:
        IntegrationError: the mount is too stiff for a periodic orbit, it rings too often from this start, or a wave or
            the tow ramp is too short compared with the run.
    """
    if scene.effects.orbit != "transient":
        return refuse_stiff_orbit(scene)
    motion, by_name = scene.effects.motion, ", or name a method, such as Accuracy('erk'), to integrate it anyway"
    relaxed = scene.effects.start != "equilibrium" and not scene.effects.printed.repelling_spring
    turns = plan.ringing(plan.numbers_of(scene), duration) if relaxed else 0.0
    if turns > plan.MOST_RINGING:
        raise IntegrationError(
            f"the motion of a {scene.describe()}: from this start it rings {turns / (2.0 * math.pi):.3g} times, which"
            f" would take about {turns / plan.PHASE_PER_STEP:.1g} steps: damp the mount, start at equilibrium, use a"
            f" softer mount, a shorter duration or the quasi-static scene{by_name}"
        )
    total = plan.rates_of(scene).forced * duration
    if total > (plan.MOST_FORCED if motion else plan.MOST_PANELLED):
        raise IntegrationError(
            f"the motion of a {scene.describe()}: in {duration:g} s the strut and the soil change it"
            f" {total / (4.0 * math.pi):.3g} times: use a shorter duration or a longer wave{by_name if motion else ''}"
        )
    return None


def refuse_stiff_orbit(scene: Scene) -> None:
    """Raise an error if finding a periodic orbit would take minutes.

    Args:
        scene: numeric scene with an orbit.

    Raises:
        IntegrationError: the motion is stiffer than `plough_opt.motion.solvers.plan.MOST_SHOT` allows by default.
    """
    total = plan.rates_of(scene).fastest * float(as_number(scene.wave_period)) if scene.effects.waves else 0.0
    if total > plan.MOST_SHOT:
        raise IntegrationError(
            f"the periodic orbit of a {scene.describe()} would take minutes to find: its fastest part makes"
            f" {total / (2.0 * math.pi):.3g} turns in one wavelength; use a softer or less damped mount, a shorter"
            " wave, a higher tow speed or the quasi-static scene (Effects(motion=False)), or name a method, such as"
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
    # Relative difference of such resistances that is due to rounding of the travel.
    if np.any(np.abs(both[:, 0] - both[:, 1]) > 1e-9 * np.max(np.abs(both), initial=0.0)):
        names = ", ".join(type(effect).__name__ for effect in scene.effects.own)
        raise InputError(
            f"own effects ({names}) have another resistance one wavelength ({p['wavelength']:g} m) further on, so no"
            " motion repeats itself with the wave: leave orbit out and simulate from a start"
        )


def refuse_runaway(scene: Scene, duration: float) -> None:
    """Raise Escape if a repelling spring drives the share beyond the range of floating point before the end."""
    # exp of a larger exponent overflows.
    if scene.effects.printed.repelling_spring and _growth(scene) * duration > 700.0:
        raise Escape(f"the motion of a {scene.describe()} overflows within {duration:g} s: {_runaway(scene)}")


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


# --- the cause of a failure ---


def failed_by(scene: Scene, duration: float, accuracy: Accuracy) -> IntegrationError:
    """Return the error that says why an integration failed, as far as the scene tells, and what to do.

    Args:
        scene: numeric scene.
        duration: of the run [s].
        accuracy: method and setting of the integration that failed.
    """
    total = plan.rates_of(scene).fastest * duration
    turns = total / (2.0 * math.pi)
    enough = plan.with_setting(replace(accuracy, steps=None), plan.steps_for(total), 1).steps or 0
    kind: type[IntegrationError] = IntegrationError
    if unsound := unsound_own(scene, duration):
        kind, why = Escape, unsound
    elif scene.effects.printed.repelling_spring:
        kind, why = Escape, _runaway(scene)
    elif enough > 2 * (accuracy.steps or enough):
        why = f"{accuracy.steps} steps are too few for {turns:.3g} oscillations: use steps={enough}"
    elif total > plan.STIFF_PHASE:
        why = (
            f"it oscillates {turns:.3g} times: use the quasi-static scene (Effects(motion=False)), a softer or a damped"
            " mount, or a shorter duration"
        )
    else:
        why = (
            "steps are too long, the tolerance is tighter than rounding allows, or a resistance drives the share away"
            " without bound, as under contact 'resisting' the soil does once a share retreats: use contact ="
            " StickSlip(), a stiffer mount or a shorter duration, and let own effects oppose the motion"
        )
    return kind(f"the motion of a {scene.describe()} could not be integrated by '{accuracy.method}': {why}")


def unsound_own(scene: Scene, duration: float) -> str:
    """Return a sentence on an own effect with a force that is not finite along the strut's path; "" if there is none.

    Args:
        scene: numeric scene.
        duration: of the run [s].
    """
    structure, p, speed = Structure.of(scene), parameters(scene), float(as_number(scene.tow_speed))
    for term in structure.own:
        for travel in np.linspace(0.0, speed * duration, _OWN_PLACES**2):
            at = {f"a speed of {v:.6g} m/s": term.force(p, float(travel), v) for v in (0.0, speed)}
            at |= {"rest": term.at_rest(p, float(travel))} if structure.sticks else {}
            for where, force in at.items():
                if not math.isfinite(value := float(as_number(force))):
                    return (
                        f"the own effect {term.kind.__name__} returns {value} N at a travel of {travel:.6g} m and at"
                        f" {where}: it must return a finite resistance wherever the share may go"
                    )
    return ""


# --- refusals and warnings of finished runs ---


class MissedEvent(IntegrationError):
    """An integrator passed the moment at which a share stopped or broke loose without noticing it."""


def refuse_weak_rest(run: Run) -> None:
    """Raise an error if an own effect holds a resting share with less force than it resists a slipping one.

    Such a share would stop and break loose endlessly.

    Args:
        run: numeric run under `StickSlip`.

    Raises:
        InputError: an own effect does so somewhere along the run.
    """
    p = parameters(run.scene)
    for term in Structure.of(run.scene).own:
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
    held = structure.hold(p, run.travel)
    size = float(np.max(np.abs(run.mount_force)))
    late = (run.mode == STICK) & (run.mount_force > held + _MISSED * size)
    back = (run.mode == SLIP) & (run.speed < -_MISSED * float(np.max(np.abs(run.speed))))
    for event, seen in (("broke loose", late), ("stopped", back)):
        if np.any(seen):
            raise MissedEvent(
                f"the motion of a {run.scene.describe()}: '{run.accuracy.method}' missed that the share {event} before"
                f" t = {run.time[np.argmax(seen)]:.4g} s: use a tighter tolerance"
            )


def remarks(run: Run) -> tuple[str, ...]:
    """Return the warnings that follow from the outputs of a motion."""
    return (*_retreat(run), *_broken_wave(run))


def _broken_wave(run: Run) -> tuple[str, ...]:
    """Return a warning if the mean draft of a transient differs from that over its whole waves."""
    effects, waves = run.scene.effects, run.scene.effects.waves
    if not waves or effects.orbit != "transient" or effects.tow_profile is not None:
        return ()
    duration = float(run.duration)
    period = max(float(wave.wavelength) for wave in waves) / float(run.scene.tow_speed)
    # Part of a wave that may be missing by rounding.
    count = math.floor(duration / period + 1e-9)
    if count < 1:
        return ()
    until, force, intervals = min(count * period, duration), run.mount_force, len(run.time) - 1
    # By the trapezoidal rule, whose intervals are equal but for the one in which the waves end.
    last, part = divmod(until / duration * intervals, 1.0)
    last, part = (int(last), part) if last < intervals else (intervals - 1, 1.0)
    first, before, after = (float(force[k]) for k in (0, last, last + 1))
    summed = float(force[: last + 1].sum()) - 0.5 * (first + before)
    whole = (summed + part * (before + 0.5 * part * (after - before))) / until
    if whole == 0.0:  # nothing resists
        return ()
    every = float(force.sum()) - 0.5 * (first + float(force[-1]))
    percent = 100.0 * (every / duration / whole - 1.0)
    words = (
        f"the run ends within a strength wave, which changes its mean draft by {percent:+.2g} %: take the"
        f' {count} whole waves of {count * period:.4g} s, in a file by average = "whole waves" in [scene]'
    )
    # A change that deserves a warning [%].
    return (words,) if abs(percent) > 0.5 else ()


def _retreat(run: Run) -> tuple[str, ...]:
    """Return a warning if the share retreats at an output time under a contact law without gaps."""
    contact = run.scene.effects.contact
    slowest = float(np.min(run.speed))
    # A backward speed below this fraction of the fastest speed is rounding, not a retreat.
    if slowest >= 0.0 or isinstance(contact, StickSlip) or slowest >= -1e-9 * float(np.max(np.abs(run.speed))):
        return ()
    law = (
        "under contact 'resisting' the soil then pushes it backwards, which real soil does not do"
        if contact == "resisting"
        else "the smooth contact ignores the gap that the share leaves; StickSlip() does not"
    )
    return (f"the share retreats (at up to {-slowest:.3g} m/s): {law}",)


WORTH_A_WARNING: Final = 1e-6
"""Estimated relative error [-] above which a run carries a warning, unless a larger error was requested."""

# A quantity below this fraction of the run's scale of force, deflection or speed counts relative to that fraction.
# Rounding of the scale, 1e-16 of it, then contributes less than 1e-8.
_SMALLEST = 1e-7


def difference(run: Run, other: Run) -> float:
    """Return the largest relative difference of any quantity of two runs with the same output times.

    Each quantity has its own scale. An array (mount force, soil resistance, deflection, speed), and with it its peak,
    counts by its largest difference relative to its largest value; the travel relative to the largest deflection if
    that is larger, and the opening always relative to the largest deflection. An RMS counts relative to itself, a mean
    relative to the larger of itself and the RMS, and the tow power relative to the larger of itself and that force
    times the strut's mean speed. Speed and soil resistance jump at an event; they count only at outputs where both runs
    are in the same mode.
    """
    ours, apart = _arrays(run), _arrays(other)
    apart -= ours
    if run.scene.effects.events:
        apart[[1, 3]] *= run.mode == other.mode
    largest, differences = (np.abs(rows).max(axis=1).tolist() for rows in (ours, apart))
    opening = float(np.abs(run.opening - other.opening).max()) if run.scene.effects.events else 0.0
    return relative_difference(run, largest, differences, other.averages, opening)


def relative_difference(
    run: Run, largest: list[float], differences: list[float], averages: Averages, opening: float = 0.0
) -> float:
    """Return the `difference` of a run from another one.

    Args:
        run: the run.
        largest: its largest values of mount force, soil resistance, deflection, speed and travel.
        differences: largest differences of the same quantities.
        averages: of the other run.
        opening: largest difference of the opening [m].
    """
    stiffness, speed = float(run.scene.stiffness), largest[3]
    # The scales at which the quantities of a motion round.
    force = max(largest[0], largest[1], stiffness * largest[2])
    deflection = force / stiffness
    if run.scene.effects.motion:
        speed = max(speed, force / math.sqrt(stiffness * float(run.scene.inertia)))
    ours, theirs = ([float(value) for value in vars(one).values()] for one in (run.averages, averages))
    draft, force_rms, mean_deflection, displacement_rms, power = ours
    least, least_z = _SMALLEST * force, _SMALLEST * deflection
    size, size_z = max(abs(draft), force_rms, least), max(abs(mean_deflection), displacement_rms, least_z)
    apart = [*differences, opening, *(a - b for a, b in zip(ours, theirs, strict=True))]
    scales = [
        *(max(largest[0], least), max(largest[1], least), max(largest[2], least_z), max(largest[3], _SMALLEST * speed)),
        # The travel of a share that sticks is rounding.
        *(max(largest[4], largest[2], least_z), max(largest[2], least_z)),
        *(size, max(force_rms, least), size_z, max(displacement_rms, least_z)),
    ]
    if run.scene.effects.accelerates:
        towed = (run.travel[-1] + run.deflection[-1] - run.travel[0] - run.deflection[0]) / run.duration
        scales.append(max(abs(power), size * float(towed)))
    # Without an acceleration the tow power is the mean draft times the speed.
    ratios = [abs(change) / scale for change, scale in zip(apart, scales, strict=False) if change]
    return float(max(ratios, default=0.0)) if math.isfinite(sum(ratios)) else math.inf


def _arrays(run: Run) -> NDArray[np.float64]:
    """Return mount force, soil resistance, deflection, speed and travel at the outputs, a row for each quantity."""
    rows = np.empty((5, len(run.time)))
    # A resistance of the user's own may be a single number for all times; assignment to a row spreads it.
    rows[0], rows[1], rows[2], rows[3] = run.mount_force, run.soil_resistance, run.deflection, run.speed
    rows[4] = run.travel
    return rows
