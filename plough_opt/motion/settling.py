"""Where a share that starts from equilibrium ends up: on the periodic orbit that was found, or in another motion.

Under one wave several motions can persist: the orbit that repeats itself every wavelength, others that repeat
themselves after several, and some that never do. The Floquet multipliers of an orbit show whether a small deviation
decays, but only an integration from the start shows where the start leads. This module follows the share from
wavelength to wavelength, by the steps of the orbit, and compares its state at the end of each with the orbit's and with
earlier ones.
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
from plough_opt.motion.terms import Structure, start_deflection, start_force
from plough_opt.motion.timeline import Timeline

Array = NDArray[np.float64]

MOST_STEPS: Final = 50_000
"""Steps of order 8 after which a share that has not settled is given up; they take some tenths of a second."""

# Most and fewest wavelengths that one call integrates.
_MOST_AT_ONCE: Final = 32
_FEWEST_AT_ONCE: Final = 4
# Limit on the wavelengths if no deviation decays or grows: more would show nothing new.
_UNDAMPED: Final = 64
# Most wavelengths over which a motion is averaged that does not repeat itself.
_AVERAGED: Final = 256
# Distance from the orbit, in half ranges of the orbit, within which linear theory certainly holds. Deviations that
# change the character of the motion are of order one.
_NEAR: Final = 1e-2
# Within this distance it is enough that the deviation shrinks nearly as linear theory says ...
_NEAR_ENOUGH: Final = 0.3
# ... that is, to no more than this factor times the predicted deviation.
_NEARLY: Final = 1.5
# Longest period that is looked for [wavelengths].
_LONGEST_PERIOD: Final = 32
# Largest difference of states one period apart in a motion that repeats itself, in half ranges of the orbit. A largest
# multiplier that differs from 1 by less counts as 1.
_REPEATS: Final = 1e-6
# Relative rounding of states, which a chaotic motion would amplify: states that differ by less are the same.
_ROUNDING: Final = 1e-13
# Factor on the orbit's steps for the averages of another motion, which may be faster.
_FINER: Final = 2
# A multiplier that exceeds 1 by less may be that of an undamped mount, rounded.
_MARGINAL = 1e-8
# Smallest unit of distances, as a part of the steady deflection: without a wave the orbit is a point.
_SMALLEST_UNIT: Final = 1e-9


def which_motion(run: Run) -> tuple[tuple[complex, ...], Settled, tuple[str, ...]]:
    """Return the Floquet multipliers [-] of a periodic orbit, where a share from equilibrium ends up, and warnings.

    Args:
        run: numeric run of the orbit.
    """
    path = _Path(run)
    # Derivatives by the start state are less exact than the states, so they take twice the orbit's steps.
    once = Timeline(1, 2 * path.steps)
    found = np.linalg.eigvals(monodromy(path.structure, once)(path.orbit, path.p).full())
    multipliers, largest = tuple(complex(value) for value in found), float(np.max(np.abs(found)))
    warnings: tuple[str, ...] = ()
    if largest > 1.0 + _MARGINAL:
        grows = f"a deviation grows {largest:.4g} times in every wavelength, so no share stays on it"
        warnings = (f"the orbit is unstable: {grows}",)
    settled = _settled(path, largest)
    return multipliers, settled, (*warnings, *_warnings(settled, largest))


def _settled(path: _Path, largest: float) -> Settled:
    """Follow a share from equilibrium and return the motion in which it ends up.

    It is followed until it settles, for as many wavelengths as `MOST_STEPS` allow, and for 4 at least.

    Args:
        path: the share.
        largest: absolute value of the orbit's largest multiplier [-].
    """
    limit = MOST_STEPS // path.steps if abs(largest - 1.0) > _REPEATS else _UNDAMPED
    stable, distances = largest < 1.0 - _REPEATS, [math.inf]
    while True:
        path.follow()
        distance = path.distance
        if not math.isfinite(distance):
            return Settled(False, path.count, None, math.inf, path.count, math.inf, retreats=True)
        near = stable and distance < _NEAR and distance <= distances[-1]
        spent = path.count >= limit
        distances.append(distance)
        if near or (spent and stable and _shrinks(distances, largest ** (len(distances) // 2 * path.at_once))):
            return Settled(True, path.count, 1, float(path.run.force_rms), 1, distance, retreats=False)
        if period := path.period(largest):
            return Settled(False, path.count, period, *path.last(period, distance))
        if spent:
            return Settled(None, path.count, None, *path.last(min(_AVERAGED, path.count // 2), distance))


def _shrinks(distances: list[float], factor: float) -> bool:
    """Return whether the distance is small and has nearly shrunk by a factor in the second half of the time."""
    return distances[-1] < _NEAR_ENOUGH and distances[-1] < _NEARLY * factor * distances[len(distances) // 2]


def _warnings(settled: Settled, largest: float) -> tuple[str, ...]:
    """Return a warning unless a share from equilibrium comes to the orbit."""
    if settled.orbit:
        return ()
    if largest < 1.0 - _REPEATS:
        why = f", although the orbit is stable: a small deviation shrinks to {largest:.4g} in every wavelength"
    else:
        why = "" if largest > 1.0 + _REPEATS else ": nothing damps a deviation from the orbit"
    return (f"a share that starts from equilibrium {settled.text}{why}",)


class _Path:
    """A share that is followed from equilibrium, as its states at the ends of wavelengths.

    Attributes:
        run: the orbit.
        structure: the terms that are on.
        numbers: the equation's parameters by name.
        p: the same as a column, the period last.
        steps: of the orbit.
        unit: of distances in w and w': half ranges of the orbit.
        orbit: the orbit's state at time 0.
        states: of the share, a row for each wavelength followed and one for the start.
    """

    def __init__(self, run: Run) -> None:
        """Begin at equilibrium."""
        self.run, self.structure, self.numbers = run, Structure.of(run.scene), numbers_of(run.scene)
        self.steps = run.accuracy.steps or 1
        names = signals(self.structure).parameters
        self.p = ca.DM([*(self.numbers[name] for name in names), float(run.duration)])
        first = float(start_deflection(self.structure, self.numbers))
        w, rate = run.deflection - first, run.scene.tow_speed - run.speed
        frequency = max(float(run.scene.wave_frequency), float(run.scene.natural_frequency))
        range_of_w = max(float(np.ptp(w)) / 2.0, float(np.ptp(rate)) / 2.0 / frequency, _SMALLEST_UNIT * abs(first))
        self.unit: Array = np.array([1.0, frequency]) * (range_of_w or 1.0)
        self.orbit: Array = np.array([w[0], rate[0]])
        self.states: Array = np.zeros((1, 2))

    @property
    def count(self) -> int:
        """Number of wavelengths followed."""
        return len(self.states) - 1

    @property
    def at_once(self) -> int:
        """Number of wavelengths that one call of `follow` integrates: at most a quarter of what `MOST_STEPS` allow."""
        return max(_FEWEST_AT_ONCE, min(_MOST_AT_ONCE, MOST_STEPS // (4 * self.steps)))

    @property
    def distance(self) -> float:
        """Largest distance from the orbit at the ends of the last wavelengths, half as many as one call integrates."""
        return float(np.max(np.abs((self.states[-self.at_once // 2 :] - self.orbit) / self.unit)))

    def follow(self) -> None:
        """Integrate some more wavelengths."""
        ends = _wavelengths(self.structure, self.steps, self.at_once)(self.states[-1], self.p)
        self.states = np.vstack([self.states, ends.full().T])

    def period(self, largest: float) -> int | None:
        """Return the period [wavelengths] with which the last states repeat themselves away from the orbit, if any."""
        distance = self.distance
        # States near a slowly attracting orbit differ little too: by about (1 - multiplier) times their distance.
        least = _REPEATS * min(1.0, max(distance, _NEAR)) * min(1.0, max(abs(1.0 - largest), _REPEATS))
        scaled = self.states / self.unit
        for period in range(1, min(_LONGEST_PERIOD, self.count // 2) + 1):
            apart = np.abs(scaled[-period:] - scaled[-2 * period : -period])
            if distance > _NEAR and float(np.max(apart)) < max(least, _ROUNDING * float(np.max(np.abs(scaled)))):
                return period
        return None

    def last(self, count: int, distance: float) -> tuple[float, int, float, bool]:
        """Return the last attributes of `Settled`, from another integration of the last wavelengths.

        Args:
            count: number of wavelengths.
            distance: from the orbit, returned as it is.

        Returns:
            RMS of the mount force [N], number of wavelengths, distance, and whether the share retreats.
        """
        steps = count * _FINER * self.steps
        timeline = Timeline(steps, steps)
        p = ca.vertcat(self.p[:-1], count * float(self.run.duration))
        found = run_from(self.structure, timeline)(self.states[-1 - count], p)
        states, means, variances = (np.asarray(result) for result in found)
        scene = self.run.scene
        first = start_force(self.structure, self.numbers)
        averages = averages_of(scene, self.structure, self.numbers, first, means.ravel(), variances.ravel())
        return float(averages.force_rms), count, distance, bool(np.max(states[1]) > scene.tow_speed)


@lru_cache(maxsize=32)
def _wavelengths(structure: Structure, steps: int, count: int) -> ca.Function:
    """Return (state, parameters with the wave's period last) -> states at the ends of the next wavelengths.

    Time restarts with each of them, because the soil repeats itself every wavelength.
    """
    first, p = ca.MX.sym("first", 2), ca.MX.sym("p", len(signals(structure).parameters) + 1)
    fractions = np.arange(steps) / steps
    spans = ca.DM(np.vstack([fractions, np.full(steps, 1.0 / steps)]))
    states, _ = step(structure).mapaccum(steps)(first, spans, ca.repmat(p, 1, steps))
    once = ca.Function("wavelength", [first, p], [states[:, -1]])
    return ca.Function("wavelengths", [first, p], [once.mapaccum(count)(first, ca.repmat(p, 1, count))])
