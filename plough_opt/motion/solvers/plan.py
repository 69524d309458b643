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

# Steps of order 8 in a symbolic run with smooth contact, which acts within a fraction of the mount's period.
_SMOOTH_STEPS = 1600

STIFF_PHASE = 1e5
"""Phase [rad] of the fastest oscillation over a run above which an implicit method is used."""

TIGHTEST = 1e-13
"""Tightest relative tolerance that double precision allows."""

STIFF_TOLERANCE = 1e-9
"""Tightest tolerance for an implicit method. Below it the steps resolve every oscillation of a stiff mount."""

# Steps of order 8. Their error is proportional to the eighth power of the phase per step, so one measured error gives
# the step length for any other. A phase of 0.5 rad of the fastest oscillation leaves an error of about 1e-10. By
# `Rates.summed`, which scatters half as much, 0.475 rad usually do. If not, the check notices and the run is refined.
PHASE_PER_STEP = 0.5
"""Phase [rad] of the fastest oscillation per step of order 8 that leaves a relative error of about 1e-10."""
_USUAL_PHASE = 0.475
# A smooth motion is tried with long steps first. Up to 1.6 rad by `Rates.summed` the error follows the order's law.
_LONG_PHASE = 1.6
# One of few steps is tried with this phase, which in three of four ordinary scenes is enough for an error of 1e-8.
_SHORT_PHASE = 0.65
_FEW_STEPS = 220
# Largest error from which the necessary number of steps can be extrapolated.
_LARGEST_KNOWN_ERROR = 1e-3
# Exponent of that extrapolation: below 1/8, for the error of long steps first falls faster than its order.
_ERROR_EXPONENT = 1.0 / 8.5
# Safety factor on the extrapolated number of steps.
_SAFETY = 1.12
# Order below which the error of long steps of order 8 shows a jump or a kink, across which more steps hardly help.
_LEAST_ORDER = 4.0
# The last run checks the next one if that takes as many steps as it can check, up to this factor on them.
_NEARLY = 1.05
# Least factor between two numbers of steps that are tried.
_LEAST_REFINEMENT = 1.15
# The same factor after an error too large to extrapolate from.
_BLIND_REFINEMENT = 1.4
# A check takes three quarters of the steps: its error is (4/3)^8 = 10 times as large, at less than the run's cost.
_CHECK_STEPS = 0.75
STEPS_PER_PIECE = 18
"""Least number of steps for each piece of a speed profile. Every piece then takes six at least, and its check five: as
many in both would hide their error."""
# Fewest steps of a run. Outputs are interpolated between eight ends of steps.
_FEWEST_STEPS = 20
# Most steps of a run, limited by memory.
_MOST_STEPS_IN_MEMORY = 4_000_000
# Phase [rad] over a run that steps of order 8 resolve within seconds.
_ORDER_8_PHASE = 4e5

# The slope of a smooth contact acts only while the share is slower than its width. Above the first phase [rad], by that
# slope, equal steps that resolve it everywhere take ten times as long as those of an adaptive method. Up to the second
# one that may be an explicit method, which reaches a smaller error than an implicit one.
_SMOOTH_PHASE = 5e3
_BRIEFLY_STIFF_PHASE = 2e6

RUN_TOLERANCE = 0.2
"""Tolerance of an adaptive run relative to that of its check, whose error is then about ten times as large."""
# At the tightest tolerance an adaptive method needs about 100 steps per rad. It may take three times as many.
_ADAPTIVE_PER_PHASE = 300.0
# Steps that an adaptive method may take in addition, to get started.
_FEWEST_ADAPTIVE = 1e4
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

# An oscillation that has decayed by exp(-30) has reached the rounding of its first swing.
_DECAYED = 30.0


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
    lasts = min(duration, _DECAYED / decay) if decay > 0.0 else duration
    return frequency * lasts


def steps_for(total_phase: float, phase_per_step: float = PHASE_PER_STEP) -> int:
    """Return the number of steps of order 8 that resolve a total phase [rad]."""
    return max(_FEWEST_STEPS, math.ceil(min(total_phase / phase_per_step, _MOST_STEPS_IN_MEMORY)))


def fewest_steps(p: Mapping[str, Any]) -> int:
    """Return the least number of steps of order 8 that fewer can check: 0 unless the tow speed has a profile."""
    return STEPS_PER_PIECE * int(p.get("speed_pieces", 0))


# Similar scenes share a timeline, whose times are computed once.
_timeline = lru_cache(maxsize=256)(Timeline)


def timeline_of(
    scene: Scene, duration: Expression, outputs: int, steps: int, method: str | None = None, *, symbolic: bool = False
) -> Timeline:
    """Return the times of a run, which include the end of a tow ramp, numeric or symbolic.

    Steps of order 8 need not end at the outputs, which are interpolated, unless steps end at kinks of unknown time.

    Args:
        scene: the scene.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        steps: number of steps.
        method: name of the method.
        symbolic: whether the run will be differentiated, so that steps must also end at the ends of smooth contact.
    """
    effects, ramp, profile = scene.effects, scene.effects.tow_ramp, scene.effects.tow_profile
    if profile is not None and is_symbolic(duration):
        raise InputError("the tow speed varies with time, so the duration cannot be a symbol: give a number [s]")
    untimed = effects.ramps and (is_symbolic(ramp) or is_symbolic(duration))
    moving = untimed or (symbolic and effects.motion and isinstance(effects.contact, Smooth))
    times = () if profile is None else profile.times
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
        accuracy = automatic("erk", wanted, p, duration)
    # These suffice for the default error. Second derivatives of order-8 steps are of order 8 too.
    finer: float = (DEFAULT_DERIVATIVES / accuracy.wanted_derivatives) ** 0.125
    enough = max(steps, math.ceil((_SMOOTH_STEPS if smooth else OUTPUTS) * finer), fewest_steps(p))
    steps = MOST_ADAPTIVE if accuracy.adaptive else accuracy.steps or enough
    return accuracy, timeline_of(scene, duration, outputs, steps, accuracy.method, symbolic=True)


def most_steps(total_phase: float) -> int:
    """Return the number of steps, a power of ten, after which an adaptive method gives up on a diverging motion."""
    return int(10.0 ** math.ceil(min(_LARGEST_COUNT, math.log10(_FEWEST_ADAPTIVE + _ADAPTIVE_PER_PHASE * total_phase))))


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


def suited(structure: Structure, total_phase: float) -> tuple[str, ...]:
    """Return the methods that suit an equation over a total phase [rad], cheapest first."""
    if structure.orbit != "transient":
        return ("dop853",)
    if structure.smooth and total_phase > _SMOOTH_PHASE:
        return ("erk", "rosenbrock") if total_phase <= _BRIEFLY_STIFF_PHASE else ("rosenbrock",)
    adaptive: str = "rosenbrock" if total_phase > STIFF_PHASE else "erk"
    return (adaptive,) if structure.events or total_phase > _ORDER_8_PHASE else ("dop853", adaptive)


def automatic(method: str, wanted: float, p: Mapping[str, Any], duration: Any) -> Accuracy:
    """Return the setting with which a method should reach a relative error.

    Args:
        method: one of `suited`.
        wanted: the relative error; three quarters of the returned steps of order 8 should reach it.
        p: the equation's parameters.
        duration: simulated time [s].
    """
    if method == "rosenbrock":
        return Accuracy(method, tolerance=max(0.1 * wanted, STIFF_TOLERANCE))
    if method == "erk":
        return Accuracy(method, tolerance=max(0.01 * wanted, TIGHTEST))
    enough = steps_for(rates(p).summed * duration, _USUAL_PHASE * (max(wanted, TIGHTEST) / DEFAULT_TOLERANCE) ** 0.125)
    return _order_8(rounded_up(max(math.ceil(enough / _CHECK_STEPS), fewest_steps(p))))


def first_steps(scene: Scene, duration: float, wanted: float) -> int:
    """Return the number of steps of order 8 to try first.

    It is that at which the error just begins to follow the law of the order. Up to `_FEW_STEPS`, where outputs cost as
    much as steps, it is the number that mostly reaches the wanted error: a second attempt would cost more.
    """
    phase = rates_of(scene).summed * duration
    usual = steps_for(phase, min(_SHORT_PHASE * (wanted / DEFAULT_ERROR) ** 0.125, _LONG_PHASE))
    enough = usual if usual <= _FEW_STEPS else steps_for(phase, _LONG_PHASE)
    return rounded_up(max(enough, fewest_steps(numbers_of(scene))))


def next_steps(steps: int, error: float, wanted: float) -> int:
    """Return the number of steps of order 8 to try next.

    Args:
        steps: number of steps tried last.
        error: error that they left; infinite if the integration failed.
        wanted: error to reach.
    """
    if error > _LARGEST_KNOWN_ERROR:
        return rounded_up(math.ceil(_BLIND_REFINEMENT * steps), 5)
    by_law = math.ceil(_SAFETY * steps * (error / wanted) ** _ERROR_EXPONENT)
    if by_law <= _NEARLY * (checked := int(steps / _CHECK_STEPS)):
        return checked
    return max(rounded_up(math.ceil(_LEAST_REFINEMENT * steps), 5), rounded_up(by_law, 5))


def has_lost_order(steps: int, error: float, fewer: int, error_before: float) -> bool:
    """Return whether an error hardly falls with the number of steps of order 8.

    Args:
        steps: number of steps tried last.
        error: error that they left.
        fewer: number tried before.
        error_before: error that those left; infinite if there are none or they failed.
    """
    return error_before <= _LARGEST_KNOWN_ERROR and error > error_before * (fewer / steps) ** _LEAST_ORDER


def pair_of(steps: int) -> tuple[Accuracy, Accuracy]:
    """Return the settings of a run of order 8 and of its check."""
    return _order_8(steps), _order_8(coarser(steps))


def coarser(steps: int) -> int:
    """Return the number of steps that checks a run of order 8."""
    return math.ceil(_CHECK_STEPS * steps)


def rounded_up(steps: int, digits: int = 3) -> int:
    """Return a number rounded up to some binary digits, so that similar scenes share one loop over steps."""
    unit = 1 << max(0, steps.bit_length() - digits)
    return -(-steps // unit) * unit


def checked(method: str, wanted: float, p: Mapping[str, float], duration: float) -> tuple[Accuracy, Accuracy]:
    """Return the settings of a run and of its check, which is coarser, to reach an error: see `automatic`.

    The check's error is several times the run's, so their difference is no less than the error of the run.
    """
    chosen = automatic(method, wanted, p, duration)
    return pair_of(chosen.steps) if chosen.steps else (finer(chosen, RUN_TOLERANCE), chosen)


@lru_cache(maxsize=256)
def _order_8(steps: int) -> Accuracy:
    """Return an `Accuracy` of order 8, cached because its validation takes longer than the look-up."""
    return Accuracy("dop853", steps=steps)


def named(
    accuracy: Accuracy, p: Mapping[str, float], duration: float, outputs: int, kinked: bool
) -> tuple[Accuracy, Accuracy]:
    """Return the settings of a named method and of its check: order 8 with enough steps, or the same method, finer.

    Args:
        accuracy: the method; its own setting, if given, is kept.
        p: the equation's parameters.
        duration: simulated time [s].
        outputs: number of intervals between output times.
        kinked: whether the motion has events or kinks, across which steps of order 8 lose their order.
    """
    total = phase(p, duration)
    chosen = with_setting(accuracy, max(steps_for(total), fewest_steps(p)), outputs)
    if not chosen.adaptive:
        return chosen, replace(chosen, steps=2 * (chosen.steps or 1))
    if total > STIFF_PHASE or kinked:
        return chosen, finer(chosen)
    return chosen, automatic("dop853", chosen.tolerance or DEFAULT_TOLERANCE, p, duration)


def finer(accuracy: Accuracy, by: float = 0.1) -> Accuracy:
    """Return an adaptive method at a fraction of its tolerance."""
    return replace(accuracy, tolerance=max(by * (accuracy.tolerance or DEFAULT_TOLERANCE), 0.1 * TIGHTEST))
