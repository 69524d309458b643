"""One step of x' = f(t, x) by Chebyshev polynomials and Picard's iteration, in the machine's widest floats.

Clenshaw, Norton: The solution of nonlinear ordinary differential equations in Chebyshev series, Computer Journal 6
(1963), 88-92. The solution of a step is a polynomial, whose last coefficients show how accurate it is, and on which
events are found to all its digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from plough_opt.studies.accuracy.wide import EPS, PI, WIDE, Wide

Rates: TypeAlias = Callable[[Wide, Wide], Wide]
"""Rates of the states, a row each, from times and states."""

_MOST_SWEEPS = 60
# Rounding of a sweep, in units of the last place, beyond which it no longer converges.
_CONVERGED = 4.0
_STALLED = 1e4
_LOST = 1e40
# A coefficient below this many units is rounding.
_TAIL = 4.0
_SAMPLES = 96
# A value below this part of the largest is taken for rounding of zero, and has no sign.
_ROUNDING = 1e3


@dataclass(frozen=True)
class Basis:
    """Chebyshev nodes of a degree on [-1, 1], both ends included, and what belongs to them.

    Attributes:
        nodes: from -1 to 1.
        coefficients: matrix from values at the nodes to Chebyshev coefficients.
        integral: matrix from values at the nodes to integrals from -1 to each node.
    """

    nodes: Wide
    coefficients: Wide
    integral: Wide

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, degree: int) -> Basis:
        """Return the basis of a degree."""
        k = np.arange(degree + 1)
        nodes = -np.cos(PI * k / degree)
        ends = np.where((k == 0) | (k == degree), WIDE(0.5), WIDE(1.0))
        to_coefficients = 2 * np.cos(PI * np.outer(k, degree - k) / degree) * ends[:, None] * ends[None, :] / degree
        integrate = np.zeros((degree + 2, degree + 1), WIDE)
        for j in range(degree + 1):
            # The integral of T_j is T_(j+1)/(2 (j+1)) - T_(j-1)/(2 (j-1)); T_0 and T_1 have forms of their own.
            integrate[j + 1, j] += WIDE(1) / (1 if j == 0 else 2 * (j + 1))
            if j > 1:
                integrate[j - 1, j] -= WIDE(1) / (2 * (j - 1))
        integrate[0, :] -= ((-1.0) ** np.arange(degree + 2)) @ integrate
        return cls(nodes, to_coefficients, chebyshev(nodes, degree + 1) @ integrate @ to_coefficients)


def chebyshev(x: Wide, degree: int) -> Wide:
    """Return T_0 to T_degree at places in [-1, 1], a row each."""
    rows = [np.ones_like(x), x]
    for _ in range(degree - 1):
        rows.append(2 * x * rows[-1] - rows[-2])
    return np.stack(rows[: degree + 1], axis=-1)


@lru_cache(maxsize=8)
def gauss(count: int) -> tuple[Wide, Wide]:
    """Return Gauss-Legendre nodes on [-1, 1] and weights, NumPy's sharpened by Newton's method."""
    x: Wide = np.polynomial.legendre.leggauss(count)[0].astype(WIDE)
    for _ in range(3):
        before, now = np.ones_like(x), x
        for k in range(2, count + 1):
            before, now = now, ((2 * k - 1) * x * now - (k - 1) * before) / k
        slope = count * (before - x * now) / (1 - x**2)
        x = x - now / slope
    return x, 2 / ((1 - x**2) * slope**2)


@dataclass(frozen=True)
class Step:
    """Solution of a step: polynomials over the time from its start.

    Attributes:
        start: time [s].
        size: length [s].
        coefficients: of Chebyshev's polynomials, a row for each state.
        used: part of the second state's coefficients that are above rounding; 1 where all but the last are.
    """

    start: Wide
    size: Wide
    coefficients: Wide
    used: float

    def at(self, times: Wide) -> Wide:
        """Return the states, a row each, at times within the step."""
        places = 2 * (times - self.start) / self.size - 1
        return self.coefficients @ chebyshev(places, self.coefficients.shape[1] - 1).T


def step(degree: int, start: Wide, size: Wide, first: Wide, rates: Rates, scales: Wide) -> Step | None:
    """Return the solution of one step, or None where the step is too long for the degree.

    Args:
        degree: of the polynomials.
        start: of the step [s].
        size: of the step [s].
        first: states at the start; the second is the rate of the first.
        rates: of the states.
        scales: sizes of the first two states, to which rounding is relative.
    """
    basis = Basis.of(degree)
    times = start + size * (basis.nodes + 1) / 2
    # A step that is too long diverges, which is one way to find that out.
    with np.errstate(over="ignore", invalid="ignore"):
        states = _solved(size / 2 * basis.integral, times, first, rates, scales)
    if states is None:
        return None
    coefficients = states @ basis.coefficients.T
    largest = max(scales[1], np.max(np.abs(states[1])))
    above = np.flatnonzero(np.abs(coefficients[1]) > _TAIL * EPS * largest)
    used = (1.0 + above[-1]) / degree if above.size else 0.0
    return None if used > 1.0 else Step(start, size, coefficients, used)


def _solved(integral: Wide, times: Wide, first: Wide, rates: Rates, scales: Wide) -> Wide | None:
    """Return the states at the nodes; None where the iteration does not converge."""
    states = first[:, None] + np.zeros(len(times), WIDE)
    states[0] += first[1] * (times - times[0])
    last = np.inf
    for _ in range(_MOST_SWEEPS):
        new = first[:, None] + rates(times, states) @ integral.T
        new[0] = first[0] + integral @ new[1]
        sizes = np.maximum(scales, np.max(np.abs(new[:2]), axis=1))
        moved = float(np.max(np.max(np.abs(new - states)[:2], axis=1) / sizes) / EPS)
        states = new
        if not moved < _LOST:
            return None
        if moved <= _CONVERGED or (moved < _STALLED and moved >= last):
            return states
        last = moved
    return None


@lru_cache(maxsize=2)
def _fractions() -> Wide:
    """Return fractions of a step at which signs are looked at, dense towards both ends, 0 left out."""
    return (1 - np.cos(PI * np.arange(1, _SAMPLES + 1) / _SAMPLES)) / 2


def first_end(function: Callable[[Wide], Wide], start: Wide, size: Wide) -> Wide | None:
    """Return the first time in a step after which a smooth function is negative, or None.

    Args:
        function: of an array of times; positive, or zero, at the start.
        start: of the step [s].
        size: of the step [s].
    """
    times = start + size * _fractions()
    values = function(times)
    largest = np.max(np.abs(values))
    decided = np.abs(values) > _ROUNDING * EPS * largest
    negative = np.flatnonzero(decided & (values < 0.0))
    if not negative.size:
        k = int(np.argmin(values))
        if not 0 < k < _SAMPLES - 1 or values[k] > 0.05 * largest:
            return None
        lowest = _lowest(function, times[k - 1], times[k + 1])
        if function(np.array([lowest]))[0] >= -_ROUNDING * EPS * largest:
            return None
        return _sign_change(function, times[k - 1], lowest)
    k = int(negative[0])
    before = np.flatnonzero(decided[:k] & (values[:k] > 0.0))
    if not before.size:
        low = start
        if function(np.array([start]))[0] <= _ROUNDING * EPS * largest:
            return start
    else:
        low = times[before[-1]]
    return _sign_change(function, low, times[k])


def _sign_change(function: Callable[[Wide], Wide], low: Wide, high: Wide) -> Wide:
    """Return where a function that is positive at low and negative at high is zero: many points at a time."""
    parts = np.linspace(WIDE(0), WIDE(1), 33)
    for _ in range(14):
        times = low + (high - low) * parts
        values = function(times)
        k = max(1, int(np.argmax(values < 0.0))) if np.any(values < 0.0) else len(parts) - 1
        low, high = times[k - 1], times[k]
        if high - low <= 2 * EPS * abs(high):
            break
    # A last chord takes the place of the halving that rounding of the time no longer allows.
    one, other = function(np.array([low, high]))
    return low + (high - low) * one / (one - other) if one > other else high


def _lowest(function: Callable[[Wide], Wide], low: Wide, high: Wide) -> Wide:
    """Return where a function with one valley between two times is least."""
    parts = np.linspace(WIDE(0), WIDE(1), 33)
    for _ in range(8):
        times = low + (high - low) * parts
        k = min(max(int(np.argmin(function(times))), 1), len(parts) - 2)
        low, high = times[k - 1], times[k + 1]
    return (low + high) / 2
