"""Derivatives by differences, for comparison with exact ones."""

import numpy as np

# Weights of the central difference of order 8. For phases up to 30 rad the error at a step of 2e-4 is about 1e-12.
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
STEP = 2e-4


def differences(function, y, step=STEP):
    """Return the derivative of a function of y by central differences of order 8, a column for each entry of y."""
    columns = []
    for k in range(len(y)):
        unit = np.zeros(len(y))
        unit[k] = step
        pairs = [np.ravel(function(y + m * unit) - function(y - m * unit)) for m in range(1, 5)]
        columns.append(sum(w * pair for w, pair in zip(WEIGHTS, pairs, strict=True)) / step)
    return np.column_stack(columns)


def order_4(function, x, step):
    """Return the derivative of a function at x by a central difference of order 4, of four values."""
    one, two = (function(x + h) - function(x - h) for h in (step, 2.0 * step))
    return (8.0 * one - two) / (12.0 * step)
