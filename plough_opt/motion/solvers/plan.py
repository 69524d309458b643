"""Choice of the integration method, the number of steps and the checking run from a scene's own time scales."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np

from plough_opt.core.checks import check_domain
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic, kept, maximum, sqrt
from plough_opt.motion.effects import TERMS, Own, Smooth, slopes
from plough_opt.motion.effects.terms import Parameters
from plough_opt.motion.equation import Structure, lightest_mass, parameters
from plough_opt.motion.methods import DEFAULT_DERIVATIVES, DEFAULT_ERROR, DEFAULT_TOLERANCE, METHODS, ORDER_8, Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.steps import Timeline

OUTPUTS = 400
"""Default number of intervals between output times."""


STIFF_PHASE = 1e5
"""Phase [rad] of the fastest oscillation over a run above which an implicit method is used."""

TIGHTEST = 1e-13
"""Tightest relative tolerance that double precision allows."""

STIFF_TOLERANCE = 2e-10
"""Tightest tolerance for an implicit method. Below it the steps resolve every oscillation of a stiff mount."""

# Steps of order 8. Their error is proportional to the eighth power of the phase per step, so one measured error gives
# the step length for any other.
PHASE_PER_STEP = 0.5
"""Phase [rad] of the fastest oscillation per step of order 8 that leaves a relative error of about 1e-10."""
# Exponent with which the necessary number of steps follows from an error, and the safety factor on it. The error of
# long steps first falls faster than its order.
_ERROR_EXPONENT = 1.0 / 8.5
STEPS_PER_PIECE = 18
"""Least number of steps for each piece of a speed profile. Every piece then takes six at least, and its check five: as
many in both would hide their error."""


# Common logarithm of the most steps of a numeric run, which CasADi counts in an int. An implicit method takes fewer.
_LARGEST_COUNT = 9.0
MOST_ADAPTIVE = 10_000_000
"""Steps after which an adaptive method gives up on a symbolic scene, whose phase is unknown."""

MOST_RINGING = 2e4
"""Largest phase [rad] of the share's own oscillation after an unsteady start that is simulated by default."""

MOST_FORCED = 1e6
"""Largest phase [rad] imposed by strut and soil over a run that is simulated by default."""

MOST_PANELLED = 4e5
"""The same limit for a quasi-static run, whose quadrature panels are all in memory at once."""

MOST_SHOT = 1e4
"""Largest phase [rad] of the fastest rate over one wavelength for which a periodic orbit is computed by default."""

MOST_OUTPUTS = 10_000_000
"""Most output intervals of a run, whose arrays are all in memory at once."""


@kept
def numbers_of(scene: Scene) -> Mapping[str, float]:
    """Return the parameters of a numeric scene by name, with the steepest slopes of its own resistances.

    Raises:
        InputError: a parameter is an array.
        DomainError: the mass that moves, with the soil that it carries along, is not above 0.
    """
    p = {name: _number(name, value) for name, value in parameters(scene).items()}
    why = scene.law.without_value("such added mass")
    check_domain("moving mass with the soil that it carries along", p.get("inertia", 1.0), "kg", above=0.0, why=why)
    return p | slopes(Own.of(scene), p) if scene.effects.own else p


def _number(name: str, value: Expression) -> float:
    if isinstance(value, float):
        return value
    if isinstance(value, np.ndarray) and value.ndim > 0:
        raise InputError(f"{name} is an array of {value.size} values: simulate accepts one scene at a time")
    return float(as_number(value))


def forced_rate(p: Mapping[str, Any], terms: Iterable[Any] = TERMS) -> Any:
    """Return the fastest angular frequency [rad/s] that the strut and the soil impose."""
    return reduce(maximum, [rate for term in terms for rate in term.imposed(p)] or [0.0])


class Rates(NamedTuple):
    """Rates of a motion, numbers or arrays.

    Attributes:
        frequency: the mount's angular frequency [rad/s].
        decay: rate of decay [1/s].
        forced: see `forced_rate` [rad/s].
    """

    frequency: Any
    decay: Any
    forced: Any

    @property
    def fastest(self) -> float:
        """Largest angular frequency [rad/s], or rate of decay or growth [1/s], of the motion."""
        return float(max(self))

    @property
    def summed(self) -> Any:
        """Sum of the rates of mount, waves and decay [1/s]; steps are proportional to it.

        In 23 sampled scenes under contact "resisting", steps of order 8 reached an error of 1e-8 with 0.84 to 1.2 rad
        per step by this rate. By `fastest` the phase scattered twice as much.
        """
        return self.frequency + self.decay + 0.5 * self.forced

    def lasting_phase(self, duration: Any) -> Any:
        """Return the phase [rad] of the share's own oscillation while it lasts, along which errors accumulate."""
        # The amplitude of an oscillation decays at half the rate d/M of the speed.
        return self.frequency * duration / (1.0 + 0.5 * self.decay * duration)


def rates(p: Mapping[str, Any], terms: Iterable[Any] = TERMS) -> Rates:
    """Return the rates of a motion from the equation's parameters, numbers or arrays, and its terms if known."""
    inertia, every = lightest_mass(p), [term.rates(p) for term in terms]
    decay = sum(each.damping + each.steepest for each in every) / inertia
    stiffness = abs(p["stiffness"]) + sum(each.stiffness for each in every)
    return Rates(sqrt(stiffness / inertia), decay, forced_rate(p, terms))


@kept
def rates_of(scene: Scene) -> Rates:
    """Return the rates of a numeric scene's motion."""
    return rates(numbers_of(scene))


def phase(p: Mapping[str, float], duration: float) -> float:
    """Return the phase of the fastest oscillation over a duration in s [rad]."""
    return rates(p).fastest * duration


def ringing(p: Mapping[str, float], duration: float) -> float:
    """Return the phase [rad] of the share's own oscillation after an unsteady start, until it has decayed."""
    inertia: float = lightest_mass(p)
    frequency = math.sqrt(abs(p["stiffness"]) / inertia)
    decay = sum(kind.rates(p).damping for kind in TERMS) / (2.0 * inertia)
    # An oscillation that has decayed by exp(-30) has reached the rounding of its first swing.
    lasts = min(duration, 30.0 / decay) if decay > 0.0 else duration
    return frequency * lasts


def steps_for(total_phase: float, phase_per_step: float = PHASE_PER_STEP) -> int:
    """Return the number of steps of order 8 that resolve a total phase [rad]."""
    # Fewest steps of a run. Outputs are interpolated between eight ends of steps.
    # Most steps of a run, limited by memory.
    return max(20, math.ceil(min(total_phase / phase_per_step, 4_000_000)))


def fewest_steps(p: Mapping[str, Any]) -> int:
    """Return the least number of steps of order 8 that fewer can check: 0 unless the tow speed has a profile."""
    return STEPS_PER_PIECE * int(p.get("speed_pieces", 0))


# Similar scenes share a timeline, whose times are computed once.
_timeline = lru_cache(maxsize=256)(Timeline)


def timeline_of(scene: Scene, duration: Expression, outputs: int, steps: int, method: str | None = None) -> Timeline:
    """Return the times of a run, which include the end of a tow ramp.

    Steps of order 8 need not end at the outputs, which are interpolated, unless a ramp or the duration is a symbol.

    Args:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        steps: number of steps.
        method: name of the method.
    """
    effects, ramp, profile = scene.effects, scene.effects.tow_ramp, scene.effects.tow_profile
    if profile is not None and is_symbolic(duration):
        raise InputError("the tow speed varies with time, so the duration cannot be a symbol: give a number [s]")
    times = () if profile is None else profile.times
    moving = effects.ramps and (is_symbolic(ramp) or is_symbolic(duration))
    if effects.ramps and not moving:
        times = (float(as_number(ramp)),)
    kinks = kinks_of(times, float(as_number(duration))) if times else ()
    return _timeline(outputs, steps, kinks, moving or method not in ORDER_8, moving)


def kinks_of(times: tuple[float, ...], duration: float) -> tuple[float, ...]:
    """Return the fractions of a duration [s] at which the strut's motion is not smooth, from the times of that [s]."""
    return tuple(time / duration for time in times if 0.0 < time < duration)


def of_symbols(
    scene: Scene, p: Parameters, duration: Expression, accuracy: Accuracy, outputs: int
) -> tuple[Accuracy, Timeline]:
    """Return the final setting and the times of a symbolic run, whose time scales are unknown.

    Args:
        scene: the scene.
        p: the equation's parameters.
        duration: simulated time [s].
        accuracy: the setting that was asked for.
        outputs: number of intervals between output times.
    """
    smooth, steps = isinstance(scene.effects.contact, Smooth), max(outputs, OUTPUTS)
    if not scene.effects.motion:
        phase = forced_rate(p) * duration
        panels = steps if is_symbolic(phase) else max(steps, steps_for(float(as_number(phase))))
        return accuracy, timeline_of(scene, duration, outputs, panels)
    if accuracy.method != "auto":
        accuracy = with_setting(accuracy, steps, outputs)
    elif scene.effects.events:
        # Events are located, but not the ends of the step of smooth contact, which need a tighter tolerance.
        wanted = min(accuracy.error or DEFAULT_ERROR, (1e-4 if smooth else 1e-2) * accuracy.wanted_derivatives)
        accuracy = first_setting("erk", wanted)
    # These suffice for the default error. Second derivatives of order-8 steps are of order 8 too.
    finer: float = (DEFAULT_DERIVATIVES / accuracy.wanted_derivatives) ** 0.125
    # Steps of order 8 in a symbolic run with smooth contact, which acts within a fraction of the mount's period.
    enough = max(steps, math.ceil((1600 if smooth else OUTPUTS) * finer), fewest_steps(p))
    steps = MOST_ADAPTIVE if accuracy.adaptive else accuracy.steps or enough
    return accuracy, timeline_of(scene, duration, outputs, steps, accuracy.method)


def most_steps(total_phase: float) -> int:
    """Return the number of steps, a power of ten, after which an adaptive method gives up on a diverging motion."""
    # At the tightest tolerance an adaptive method needs about 100 steps per rad. It may take three times as many.
    # Steps that an adaptive method may take in addition, to get started.
    return int(10.0 ** math.ceil(min(_LARGEST_COUNT, math.log10(1e4 + 300.0 * total_phase))))


def with_setting(accuracy: Accuracy, steps: int, outputs: int) -> Accuracy:
    """Return a named method with its final setting.

    Args:
        accuracy: the method; its own setting, if given, is kept.
        steps: number of steps that order 8 would take.
        outputs: output intervals. Fixed-step methods except order 8 take a whole number of steps in each.
    """
    if accuracy.adaptive:
        return replace(accuracy, tolerance=accuracy.tolerance or DEFAULT_TOLERANCE)
    if accuracy.method == "dop853":
        return replace(accuracy, steps=accuracy.steps or steps)
    # Other fixed-step methods have a lower order and need more steps for the same error.
    wanted = accuracy.steps or math.ceil(METHODS[accuracy.method].finer * steps)
    return replace(accuracy, steps=-(-wanted // outputs) * outputs)


@lru_cache(maxsize=256)
def _order_8(steps: int) -> Accuracy:
    """Return an `Accuracy` of order 8, cached because its validation takes longer than the look-up."""
    return Accuracy("dop853", steps=steps)


def rounded_up(steps: int, digits: int = 3) -> int:
    """Return a number rounded up to some binary digits, so that similar scenes share one loop over steps."""
    unit = 1 << max(0, steps.bit_length() - digits)
    return -(-steps // unit) * unit


def suited(structure: Structure, total_phase: float) -> tuple[str, ...]:
    """Return the methods that suit an equation over a total phase [rad], cheapest first."""
    if structure.orbit != "transient":
        return ("dop853",)
    # The slope of a smooth contact acts only while the share is slower than its width: equal steps that resolve it
    # everywhere take ten times as long as adaptive ones, which may be explicit up to a larger phase.
    # Phase [rad] over a run that steps of order 8 resolve within seconds.
    # The slope of a smooth contact acts only while the share is slower than its width. Above the first phase [rad], by
    # that slope, equal steps that resolve it everywhere take ten times as long as those of an adaptive method. Up to
    # the second one that may be an explicit method, which reaches a smaller error than an implicit one.
    most_steps, stiff = (5e3, 2e6) if structure.smooth else (4e5, STIFF_PHASE)
    adaptive = ("rosenbrock",) if total_phase > stiff else ("erk", "rosenbrock") if structure.smooth else ("erk",)
    return adaptive if structure.events or total_phase > most_steps else ("dop853", *adaptive)


def first_setting(method: str, wanted: float, summed_phase: float = 0.0, fewest: int = 0) -> Accuracy:
    """Return the setting with which a method usually reaches a relative error, by its difference from `coarser`.

    Args:
        method: one of `suited`.
        wanted: the relative error.
        summed_phase: phase by `Rates.summed` over the run [rad], for steps of order 8.
        fewest: `fewest_steps`, for the same.
    """
    if method == "dop853":
        # By `Rates.summed`, which scatters half as much, this phase leaves an error of 1e-8 in three of four ordinary
        # scenes.
        steps = steps_for(summed_phase, 0.65 * (max(wanted, TIGHTEST) / DEFAULT_ERROR) ** 0.125)
        return _order_8(rounded_up(max(steps, fewest)))
    least = STIFF_TOLERANCE if method == "rosenbrock" else TIGHTEST
    return Accuracy(method, tolerance=max(0.003 * wanted, least))


def coarser(setting: Accuracy) -> Accuracy:
    """Return the setting of the check, whose error is about ten times as large: (4/3)^8 or ten times the tolerance."""
    if setting.steps:
        return _order_8(math.ceil(0.75 * setting.steps))
    return replace(setting, tolerance=10.0 * (setting.tolerance or DEFAULT_TOLERANCE))


def refined(setting: Accuracy, error: float, wanted: float) -> Accuracy:
    """Return the next setting, from the error that the last one left: infinite if its integration failed."""
    if setting.steps:
        factor = 1.12 * min(error / wanted, 1e9) ** _ERROR_EXPONENT
        return _order_8(rounded_up(math.ceil(setting.steps * min(max(factor, 1.15), 3.0)), 5))
    tolerance = (setting.tolerance or DEFAULT_TOLERANCE) * min(0.1, max(0.01, 0.5 * wanted / error))
    least = STIFF_TOLERANCE if setting.method == "rosenbrock" else TIGHTEST
    return replace(setting, tolerance=max(tolerance, least))


def named(accuracy: Accuracy, p: Mapping[str, float], duration: float, outputs: int) -> tuple[Accuracy, Accuracy]:
    """Return the settings of a named method and of its check, the same method with finer ones.

    Args:
        accuracy: the method; its own setting, if given, is kept.
        p: the equation's parameters.
        duration: simulated time [s].
        outputs: number of intervals between output times.
    """
    chosen = with_setting(accuracy, max(steps_for(phase(p, duration)), fewest_steps(p)), outputs)
    return chosen, finer(chosen)


def finer(accuracy: Accuracy) -> Accuracy:
    """Return a method with twice its steps or a tenth of its tolerance."""
    if not accuracy.adaptive:
        return replace(accuracy, steps=2 * (accuracy.steps or 1))
    return replace(accuracy, tolerance=max(0.1 * (accuracy.tolerance or DEFAULT_TOLERANCE), 0.1 * TIGHTEST))
