"""Which method, how many steps, and what checks it: choices made from a scene's own time scales."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, reduce
from typing import Any

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_symbolic, maximum, sqrt
from plough_opt.motion.accuracy import DEFAULT_DERIVATIVES, DEFAULT_TOLERANCE, Accuracy
from plough_opt.motion.effects import TERMS, Own, Smooth, slopes
from plough_opt.motion.methods import METHODS, ORDER_8
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, lightest_mass, parameters
from plough_opt.motion.timeline import Timeline

OUTPUTS = 400
"""Default number of intervals between output times."""

# Of order 8 in a symbolic run with smooth contact, which changes in a fraction of the time of the mount's swing.
_SMOOTH_STEPS = 1600

STIFF_PHASE = 1e5
"""Phase [rad] of the fastest oscillation over a run above which an implicit method integrates it."""

TIGHTEST = 1e-13
"""Tightest relative tolerance that double precision leaves room for."""

STIFF_TOLERANCE = 1e-9
"""Tightest tolerance for an implicit method; below it the steps follow every oscillation of a stiff mount."""

# Steps of order 8. Their error falls with the eighth power of the phase in a step, so that one length that was tried
# gives those for all errors. By the fastest oscillation 0.5 rad a step leave some 1e-10; by `summed_rate`, which
# scatters half as far, 0.475 rad usually do: where they do not, the check finds out, and steps are repeated finer.
PHASE_PER_STEP = 0.5
"""Phase [rad] of the fastest oscillation in one step of order 8 that leaves a relative error of some 1e-10."""
_USUAL_PHASE = 0.475
# Where the motion is smooth, long steps come first: of 1.6 rad by `summed_rate`, from which on errors follow the law.
_LONG_PHASE = 1.6
# From an error up to 1e-3 follows how many steps reach the wanted one: by a power a little below 1/8, for from long
# steps the error falls a little faster at first; an eighth more, to be sure; and no less than 1.15 times as many.
_KNOWN = 1e-3
_FALLS = 1.0 / 8.5
_SURE = 1.12
_LEAST_FINER = 1.15
# From a larger one nothing follows but that they must be shorter.
_ANEW = 1.4
# Three quarters of the steps err by (4/3)^8 = 10 times as much: enough for a check, at less than another run's cost.
_COARSER = 0.75
# Fewest steps of a run, between which eight are read from at once, and most, for their memory.
_FEWEST_STEPS = 20
_MOST_STEPS = 4_000_000
# Phase [rad] over a run that steps of order 8 follow within seconds.
_ORDER_8_PHASE = 4e5

# Adaptive methods. Part of the tolerance of its check with which one runs: it then errs by a tenth of it or so.
_RUN_FINER = 0.2
# The tightest takes some 100 steps for a phase of 1 rad: it may take three times as many, and 10,000 for a start.
_ADAPTIVE_PER_PHASE = 300.0
_FEWEST_ADAPTIVE = 1e4
MOST_ADAPTIVE = 10_000_000
"""Steps after which an adaptive method of a symbolic scene gives up, whose phase is unknown."""

MOST_RINGING = 2e4
"""Phase [rad] of the share's own oscillation from a start that is not steady, up to which it is followed by default."""

MOST_FORCED = 1e6
"""Phase [rad] that strut and soil impose over a run, up to which it is followed by default."""

MOST_PANELLED = 4e5
"""The same of a quasi-static run, whose panels are in memory at once."""

MOST_SHOT = 1e4
"""Phase [rad] of the fastest part of a motion over one wavelength; up to it a lasting orbit is computed by default."""

MOST_OUTPUTS = 10_000_000
"""Output intervals of a run, whose arrays are in memory at once."""

# exp(-30) is the rounding of the first swing.
_DECAYED = 30.0


def numbers_of(scene: Scene, structure: Structure | None = None) -> dict[str, float]:
    """Return the parameters of a numeric scene, by name, and the steepest slopes of its own effects.

    Raises:
        InputError: one is an array.
    """
    p = {name: _number(name, value) for name, value in parameters(scene, structure).items()}
    return p | slopes(Own.of(scene), p) if scene.effects.own else p


def _number(name: str, value: Expression) -> float:
    if isinstance(value, float):
        return value
    if isinstance(value, np.ndarray) and value.ndim > 0:
        raise InputError(f"{name} is an array of {value.size} values: simulate takes one scene at a time")
    return float(as_number(value))


def forced_rate(p: Mapping[str, Any]) -> Any:
    """Return the fastest angular frequency [rad/s] that the strut and the soil impose."""
    return reduce(maximum, [rate for kind in TERMS for rate in kind.imposed(p)] or [0.0])


def is_imposed(name: str) -> bool:
    """Return whether `forced_rate` depends on a parameter."""
    return name in ("tow_speed", "ramp_time") or name.startswith("wavelength")


def fastest_rate(p: Mapping[str, float]) -> float:
    """Return the fastest angular frequency [rad/s] or rate of decay or growth [1/s] of an equation's parameters."""
    return float(max(_rates(p)))


def summed_rate(p: Mapping[str, Any]) -> Any:
    """Return the sum of mount's, wave's and decay's rates [1/s], for numbers or arrays: steps are in proportion to it.

    Of 23 sampled scenes under contact "resisting", steps of order 8 reached 1e-8 with 0.84 to 1.2 rad of it in the
    slower half, where `fastest_rate` scattered twice as far.
    """
    frequency, decay, forced = _rates(p)
    return frequency + decay + 0.5 * forced


def summed_and_lasting_phase(p: Mapping[str, Any], duration: Any) -> tuple[Any, Any]:
    """Return two phases of a run [rad], for numbers or arrays: by `summed_rate`, and of what swings on by itself.

    The latter is the phase of the share's own oscillation while it lasts, along which errors of its amplitude add up.

    Args:
        p: the equation's parameters.
        duration: of the run [s].
    """
    frequency, decay, forced = _rates(p)
    # A swing dies away by half of the rate with which its speed does.
    return (frequency + decay + 0.5 * forced) * duration, frequency * duration / (1.0 + 0.5 * decay * duration)


def _rates(p: Mapping[str, Any]) -> tuple[Any, Any, Any]:
    """Return the mount's angular frequency [rad/s], the rate of decay [1/s] and `forced_rate`."""
    inertia, rates = lightest_mass(p), [kind.rates(p) for kind in TERMS]
    decay = sum(each.damping + each.steepest for each in rates) / inertia
    stiffness = abs(p["stiffness"]) + sum(each.stiffness for each in rates)
    return sqrt(stiffness / inertia), decay, forced_rate(p)


def phase(p: Mapping[str, float], duration: float) -> float:
    """Return the phase of the fastest oscillation over the run [rad]."""
    return fastest_rate(p) * duration


def ringing(p: Mapping[str, float], duration: float) -> float:
    """Return the phase [rad] of the share's own oscillation from a start that is not steady, until it has died away."""
    inertia: float = lightest_mass(p)
    frequency = math.sqrt(abs(p["stiffness"]) / inertia)
    decay = sum(kind.rates(p).damping for kind in TERMS) / (2.0 * inertia)
    lasts = min(duration, _DECAYED / decay) if decay > 0.0 else duration
    return frequency * lasts


def steps_for(total_phase: float, phase_per_step: float = PHASE_PER_STEP) -> int:
    """Return how many steps of order 8 resolve an oscillation of that phase."""
    return max(_FEWEST_STEPS, math.ceil(min(total_phase / phase_per_step, _MOST_STEPS)))


# Scenes much alike share one, whose times are computed once.
_timeline = lru_cache(maxsize=256)(Timeline)


def timeline_of(
    scene: Scene,
    duration: Expression,
    outputs: int,
    steps: int,
    method: str | None = None,
    *,
    symbolic: bool = False,
) -> Timeline:
    """Return the times of a run; the end of a tow ramp is among them, a number or wherever its symbols put it.

    Steps of order 8 need not end at the outputs, which are read between them, unless steps end at moving kinks.

    Args:
        scene: the scene.
        duration: of the run [s].
        outputs: number of intervals between output times.
        steps: number of steps.
        method: the method that takes them.
        symbolic: whether the run is to be differentiated, so that steps end where smooth contact ends too.
    """
    effects, aligned = scene.effects, method not in ORDER_8
    ramp: Any = effects.tow_ramp if effects.ramps else 0.0
    timed = not effects.ramps or not (is_symbolic(ramp) or is_symbolic(duration))
    if not timed or (symbolic and effects.motion and isinstance(effects.contact, Smooth)):
        return _timeline(outputs, steps, moving=True)
    kink = kink_of(float(as_number(ramp)), float(as_number(duration))) if effects.ramps else None
    return _timeline(outputs, steps, kink, aligned)


def kink_of(ramp: float, duration: float) -> float | None:
    """Return at which part of the duration [s] a ramp of a time [s], or 0, ends; None if not within the run."""
    return ramp / duration if 0.0 < ramp < duration else None


def unknown_steps(scene: Scene, accuracy: Accuracy, outputs: int) -> int:
    """Return how many steps of order 8 a symbolic run takes, whose time scales are unknown."""
    steps = _SMOOTH_STEPS if isinstance(scene.effects.contact, Smooth) else OUTPUTS
    # For the default; second derivatives of order-8 steps are of that order too.
    finer: float = (DEFAULT_DERIVATIVES / accuracy.wanted_derivatives) ** 0.125
    return max(outputs, OUTPUTS, math.ceil(steps * finer))


def most_steps(total_phase: float) -> int:
    """Return after how many steps an adaptive method gives up, a power of ten: where a motion has no end, none do."""
    return int(10.0 ** math.ceil(math.log10(_FEWEST_ADAPTIVE + _ADAPTIVE_PER_PHASE * total_phase)))


def with_setting(accuracy: Accuracy, steps: int, outputs: int) -> Accuracy:
    """Return a named method with the setting that it will really have.

    Args:
        accuracy: the method; a setting that it gives is kept.
        steps: what order 8 would take.
        outputs: output intervals; methods of fixed steps but order 8 take as many whole steps in each of them.
    """
    if accuracy.adaptive:
        return replace(accuracy, tolerance=accuracy.tolerance or DEFAULT_TOLERANCE)
    if accuracy.method == "dop853":
        return replace(accuracy, steps=accuracy.steps or steps)
    # Other methods of fixed steps are of lower order and take more steps for the same error.
    wanted = accuracy.steps or math.ceil(METHODS[accuracy.method].finer * steps)
    return replace(accuracy, steps=-(-wanted // outputs) * outputs)


def suited(structure: Structure, total_phase: float) -> tuple[str, ...]:
    """Return the methods that suit an equation over that phase [rad], cheapest first."""
    if structure.orbit != "transient":
        return ("dop853",)
    adaptive: str = "rosenbrock" if total_phase > STIFF_PHASE else "erk"
    return (adaptive,) if structure.events or total_phase > _ORDER_8_PHASE else ("dop853", adaptive)


def automatic(method: str, wanted: float, p: Mapping[str, float], duration: float) -> Accuracy:
    """Return the setting with which a method should reach a relative error.

    Args:
        method: one of `suited`.
        wanted: the relative error; of order 8 three quarters of the steps should reach it.
        p: the equation's parameters.
        duration: of the run [s].
    """
    if method == "rosenbrock":
        return Accuracy(method, tolerance=max(0.1 * wanted, STIFF_TOLERANCE))
    if method == "erk":
        return Accuracy(method, tolerance=max(0.01 * wanted, TIGHTEST))
    # The error of order 8 falls by (4/3)^8 = 10 from the steps that should reach it to those taken.
    enough = steps_for(summed_rate(p) * duration, _USUAL_PHASE * (max(wanted, TIGHTEST) / DEFAULT_TOLERANCE) ** 0.125)
    return _order_8(_rounded(math.ceil(enough / _COARSER)))


def first_steps(p: Mapping[str, float], duration: float) -> int:
    """Return how many steps of order 8 are so long that their error just begins to follow the order's law."""
    return _rounded(steps_for(summed_rate(p) * duration, _LONG_PHASE))


def next_steps(steps: int, error: float, wanted: float) -> int:
    """Return how many steps of order 8 to take for an error, after so many that left another one; infinite: failed."""
    if error > _KNOWN:
        return _rounded(math.ceil(_ANEW * steps), 5)
    by_law = math.ceil(_SURE * steps * (error / wanted) ** _FALLS)
    return max(_rounded(math.ceil(_LEAST_FINER * steps), 5), _rounded(by_law, 5))


def pair_of(steps: int) -> tuple[Accuracy, Accuracy]:
    """Return so many steps of order 8, and what checks them."""
    return _order_8(steps), _order_8(coarser(steps))


def coarser(steps: int) -> int:
    """Return the steps of order 8 that check so many."""
    return math.ceil(_COARSER * steps)


def _rounded(steps: int, digits: int = 3) -> int:
    """Return at least so many steps, to some binary digits: scenes much alike then share one loop over steps."""
    unit = 1 << max(0, steps.bit_length() - digits)
    return -(-steps // unit) * unit


def checked(method: str, wanted: float, p: Mapping[str, float], duration: float) -> tuple[Accuracy, Accuracy]:
    """Return how a method runs, and what checks it: `automatic`, of an adaptive method after a finer run.

    The coarser of the two errs by several times as much as the run, so that their difference is no less than its error.
    """
    chosen = automatic(method, wanted, p, duration)
    return pair_of(chosen.steps) if chosen.steps else (finer(chosen, _RUN_FINER), chosen)


@lru_cache(maxsize=256)
def _order_8(steps: int) -> Accuracy:
    """Return steps of order 8 as an accuracy, which takes longer to check than to look up."""
    return Accuracy("dop853", steps=steps)


def check_of(accuracy: Accuracy, p: Mapping[str, float], duration: float, kinked: bool) -> Accuracy:
    """Return what checks a method with its setting: order 8 with enough steps, or the same method, finer.

    Args:
        accuracy: the method.
        p: the equation's parameters.
        duration: of the run [s].
        kinked: whether the motion has events or kinks, across which order 8 is none.
    """
    if not accuracy.adaptive:
        return replace(accuracy, steps=2 * (accuracy.steps or 1))
    if phase(p, duration) > STIFF_PHASE or kinked:
        return finer(accuracy)
    return automatic("dop853", accuracy.tolerance or DEFAULT_TOLERANCE, p, duration)


def finer(accuracy: Accuracy, by: float = 0.1) -> Accuracy:
    """Return an adaptive method at a part of its tolerance."""
    return replace(accuracy, tolerance=max(by * (accuracy.tolerance or DEFAULT_TOLERANCE), 0.1 * TIGHTEST))
