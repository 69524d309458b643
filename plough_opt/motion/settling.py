"""To which motion a share comes that starts from equilibrium: the lasting orbit that was found, or another one.

Under one wave several motions can last: the orbit that repeats itself with every wavelength, others that repeat
themselves after several, and some that never do. Multipliers of an orbit show whether a slight deviation dies; which
motion a start leads to shows only by following it. The share is followed from wavelength to wavelength, by the steps
of the orbit, and its states at their ends are compared with the orbit's and with earlier ones.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.assembly import averages_of
from plough_opt.motion.averages import Settled
from plough_opt.motion.equation import signals
from plough_opt.motion.orbit import monodromy
from plough_opt.motion.plan import numbers_of
from plough_opt.motion.run import Run
from plough_opt.motion.runge_kutta import run_from, step
from plough_opt.motion.terms import Structure, start_deflection
from plough_opt.motion.timeline import Timeline

Array = NDArray[np.float64]

MOST_STEPS: Final = 50_000
"""Steps of order 8 after which a share that has not settled is given up: some tenths of a second."""

# Most and fewest wavelengths that are followed at once.
_AT_ONCE: Final = 32
_FEWEST: Final = 4
# Wavelengths that are followed where nothing damps a deviation, and most that a motion is averaged over which does not
# repeat itself.
_UNDAMPED: Final = 64
_AVERAGED: Final = 256
# Distance from the orbit, in the orbit's own half ranges, at which multipliers below 1 decide: deviations that change
# the share's motion at all are of order one.
_NEAR: Final = 1e-2
# Distance from which on it counts that it shrinks nearly as the multipliers say, and how nearly.
_WITHIN: Final = 0.3
_AS_SLOWLY: Final = 1.5
# Longest period that is looked for [wavelengths], and the largest difference of states one period apart.
_LONGEST: Final = 32
_REPEATS: Final = 1e-6
# Rounding of states, which a chaotic motion would blow up: what differs by less repeats itself.
_ROUNDING: Final = 1e-13
# Steps of another motion's averages, over those of the orbit, beside which it may be fast.
_FINER: Final = 2
# A multiplier above 1 by less is that of an undamped mount, rounded.
_MARGINAL = 1e-8
# Least size of an orbit, as a part of the steady deflection: an orbit without a wave is a point.
_LEAST: Final = 1e-9


def which_motion(run: Run) -> tuple[tuple[complex, ...], Settled, tuple[str, ...]]:
    """Return a lasting orbit's Floquet multipliers [-], to which motion a share comes, and what a reader must know.

    Args:
        run: the orbit, of numbers.
    """
    path = _Path(run)
    # A numeric orbit has a number of steps; derivatives by the start are known less exactly by the same.
    once = Timeline(1, 2 * path.steps)
    found = np.linalg.eigvals(monodromy(path.structure, once)(path.orbit, path.p).full())
    multipliers, largest = tuple(complex(value) for value in found), float(np.max(np.abs(found)))
    notes: tuple[str, ...] = ()
    if largest > 1.0 + _MARGINAL:
        grows = f"a deviation grows {largest:.4g} times in every wavelength, so no share stays on it"
        notes = (f"the orbit is unstable: {grows}",)
    settles = _settled(path, largest)
    return multipliers, settles, (*notes, *_sentences(settles, largest))


def _settled(path: _Path, largest: float) -> Settled:
    """Return to which motion a share comes that starts from equilibrium.

    It is followed for as many wavelengths as `MOST_STEPS` steps reach, at least 4.

    Args:
        path: the share.
        largest: size of the orbit's largest multiplier [-].
    """
    lasts = MOST_STEPS // path.steps if abs(largest - 1.0) > _REPEATS else _UNDAMPED
    shrinks, distances = largest < 1.0 - _REPEATS, [math.inf]
    while True:
        path.follow()
        distance = path.distance
        if not math.isfinite(distance):
            return Settled(False, path.count, None, math.inf, path.count, math.inf, retreats=True)
        near = shrinks and distance < _NEAR and distance <= distances[-1]
        spent = path.count >= lasts
        distances.append(distance)
        if near or (spent and shrinks and _shrinks(distances, largest ** (len(distances) // 2 * path.at_once))):
            return Settled(True, path.count, 1, float(path.run.force_rms), 1, distance, retreats=False)
        if period := path.period(largest):
            return Settled(False, path.count, period, *path.last(period, distance))
        if spent:
            return Settled(None, path.count, None, *path.last(min(_AVERAGED, path.count // 2), distance))


def _shrinks(distances: list[float], factor: float) -> bool:
    """Return whether a distance within reach of linear theory shrank since half the time as that says, or nearly."""
    return distances[-1] < _WITHIN and distances[-1] < _AS_SLOWLY * factor * distances[len(distances) // 2]


def _sentences(found: Settled, largest: float) -> tuple[str, ...]:
    """Return what a reader of an orbit must know of the motion from equilibrium: nothing where it is the orbit."""
    if found.orbit:
        return ()
    if largest < 1.0 - _REPEATS:
        why = f", although the orbit is stable: a slight deviation shrinks to {largest:.4g} in every wavelength"
    else:
        why = "" if largest > 1.0 + _REPEATS else ": nothing damps a deviation from the orbit"
    return (f"a share that starts from equilibrium {found.text}{why}",)


class _Path:
    """A share that is followed from equilibrium, by its states at the ends of wavelengths, a row each."""

    def __init__(self, run: Run) -> None:
        """Begin at equilibrium, beside an orbit whose half ranges are the units of distances."""
        self.run, self.structure, self.numbers = run, Structure.of(run.scene), numbers_of(run.scene)
        self.steps = run.accuracy.steps or 1
        names = signals(self.structure).parameters
        self.p = ca.DM([*(self.numbers[name] for name in names), float(run.duration)])
        first = float(start_deflection(self.structure, self.numbers))
        w, rate = run.deflection - first, run.scene.tow_speed - run.speed
        frequency = max(float(run.scene.wave_frequency), float(run.scene.natural_frequency))
        range_of_w = max(float(np.ptp(w)) / 2.0, float(np.ptp(rate)) / 2.0 / frequency, _LEAST * abs(first))
        self.unit: Array = np.array([1.0, frequency]) * (range_of_w or 1.0)
        self.orbit: Array = np.array([w[0], rate[0]])
        self.states: Array = np.zeros((1, 2))

    @property
    def count(self) -> int:
        """Wavelengths that were followed."""
        return len(self.states) - 1

    @property
    def at_once(self) -> int:
        """Wavelengths that are followed at once: a quarter of those that `MOST_STEPS` reach, or a usual number."""
        return max(_FEWEST, min(_AT_ONCE, MOST_STEPS // (4 * self.steps)))

    @property
    def distance(self) -> float:
        """Largest distance from the orbit at the ends of the last half of the wavelengths followed at once."""
        return float(np.max(np.abs((self.states[-self.at_once // 2 :] - self.orbit) / self.unit)))

    def follow(self) -> None:
        """Follow the share for some more wavelengths."""
        ends = _wavelengths(self.structure, self.steps, self.at_once)(self.states[-1], self.p)
        self.states = np.vstack([self.states, ends.full().T])

    def period(self, largest: float) -> int | None:
        """Return after how many wavelengths the states have come to repeat themselves away from the orbit, if so."""
        distance = self.distance
        # Beside a slowly attracting orbit states differ little too, by about (1 - multiplier) of their distance.
        least = _REPEATS * min(1.0, max(distance, _NEAR)) * min(1.0, max(abs(1.0 - largest), _REPEATS))
        scaled = self.states / self.unit
        for period in range(1, min(_LONGEST, self.count // 2) + 1):
            apart = np.abs(scaled[-period:] - scaled[-2 * period : -period])
            if distance > _NEAR and float(np.max(apart)) < max(least, _ROUNDING * float(np.max(np.abs(scaled)))):
                return period
        return None

    def last(self, count: int, distance: float) -> tuple[float, int, float, bool]:
        """Return RMS of the mount force [N] over the last wavelengths, their number, the distance, and any retreat."""
        steps = count * _FINER * self.steps
        timeline = Timeline(steps, steps)
        p = ca.vertcat(self.p[:-1], count * float(self.run.duration))
        found = run_from(self.structure, timeline)(self.states[-1 - count], p)
        states, means, variances = (np.asarray(result) for result in found)
        scene = self.run.scene
        averages = averages_of(scene, self.structure, self.numbers, means.ravel(), variances.ravel())
        return float(averages.force_rms), count, distance, bool(np.max(states[1]) > scene.tow_speed)


@lru_cache(maxsize=32)
def _wavelengths(structure: Structure, steps: int, count: int) -> ca.Function:
    """Return (state, parameters with the wave's period last) -> states at the ends of the next wavelengths.

    Time begins anew with each, for the soil is the same one wavelength on.
    """
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(signals(structure).parameters) + 1)
    fractions = np.arange(steps) / steps
    spans = ca.DM(np.vstack([fractions, np.full(steps, 1.0 / steps)]))
    states, _ = step(structure).mapaccum(steps)(first, spans, ca.repmat(p, 1, steps))
    once = ca.Function("wavelength", [first, p], [states[:, -1]])
    return ca.Function("wavelengths", [first, p], [once.mapaccum(count)(first, ca.repmat(p, 1, count))])
