"""The first sign change of a polynomial within a step, as an expression without branches."""

import itertools
import math

import casadi as ca

# Equal intervals of a step between which the polynomial is sampled.
_INTERVALS = 8
# Halvings of the interval that contains the sign change, and steps of Newton's method after them.
_HALVINGS = 4
_NEWTON_STEPS = 3
# The next step begins this far beyond the root, as a fraction of the step, so that the sign has surely changed.
_BEYOND = 1e-7


def first_sign_change(polynomial: list[ca.SX], size: ca.SX) -> ca.SX:
    """Return a time [s] just after a polynomial first changes its sign within a step, or infinity if it does not.

    The polynomial is sampled at equal distances and, between each two of these, where its slopes there let it turn. The
    interval of the first change is halved, then Newton's method finds the root.

    Args:
        polynomial: Taylor coefficients by the time since the start of the step.
        size: of the step [s].
    """
    positive_at_first = polynomial[0] > 0.0

    def has_changed(value: ca.SX) -> ca.SX:
        return ca.logic_not((value > 0.0) == positive_at_first)

    low, high, found = ca.SX(0), ca.SX(1), ca.SX(0)
    samples = [(ca.SX(0), polynomial[0]), *_samples(polynomial, size)]
    # From the last interval to the first, so that the earliest change remains.
    for (start, _), (end, value) in reversed(list(itertools.pairwise(samples))):
        here = has_changed(value)
        low, high = ca.if_else(here, start, low), ca.if_else(here, end, high)
        found = ca.logic_or(found, here)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        past = has_changed(_value_and_slope(polynomial, size * middle)[0])
        low, high = ca.if_else(past, low, middle), ca.if_else(past, middle, high)
    root = 0.5 * (low + high)
    for _ in range(_NEWTON_STEPS):
        value, slope = _value_and_slope(polynomial, size * root)
        root = ca.fmin(ca.fmax(root - value / (size * _nonzero(slope)), low), high)
    after = ca.fmin(root + _BEYOND, high)
    high = ca.if_else(has_changed(_value_and_slope(polynomial, size * after)[0]), after, high)
    return ca.if_else(found, high * size, math.inf)


def _samples(polynomial: list[ca.SX], size: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return (fraction of the step, value) at the ends of all intervals, and in each where it may turn."""
    ends = [_value_and_slope(polynomial, size * (k / _INTERVALS)) for k in range(_INTERVALS + 1)]
    samples = []
    for k, ((_, slope_before), (value, slope_after)) in enumerate(itertools.pairwise(ends)):
        # Where a slope that changes linearly from one end to the other is zero.
        part = ca.fmin(ca.fmax(slope_before / _nonzero(slope_before - slope_after), 0.0), 1.0)
        turn = (k + part) / _INTERVALS
        samples += [(turn, _value_and_slope(polynomial, size * turn)[0]), (ca.SX((k + 1) / _INTERVALS), value)]
    return samples


def _nonzero(x: ca.SX) -> ca.SX:
    return ca.if_else(x == 0.0, 1.0, x)


def _value_and_slope(polynomial: list[ca.SX], x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a polynomial and its derivative at x, by Horner's scheme."""
    value, slope = ca.SX(polynomial[-1]), ca.SX(0)
    for c in reversed(polynomial[:-1]):
        slope = value + x * slope
        value = c + x * value
    return value, slope
