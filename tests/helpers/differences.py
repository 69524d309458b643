"""Derivatives by differences, for comparison with exact ones."""

import numpy as np
import pytest

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


def check_derivatives(nlp, y, parameters, first, second, step=STEP):
    """Compare the slopes and curvatures of a program's Lagrangian with differences.

    Args:
        nlp: program of a design.
        y: scaled variables.
        parameters: values of the parameters.
        first: relative tolerance for the slopes.
        second: tolerance for the curvatures, relative to the largest.
        step: step of the differences.
    """
    weights = np.cos(1.0 + np.arange(nlp.values(y, parameters)[1].numel()))

    def lagrangian(y):
        f, g = (np.asarray(result) for result in nlp.values(y, parameters))
        return 0.7 * f.ravel() + g.T @ weights

    def slope(y):
        _, _, gradient, jacobian = (np.asarray(result) for result in nlp.slopes(y, parameters))
        return 0.7 * gradient.ravel() + jacobian.T @ weights

    assert slope(y) == pytest.approx(differences(lagrangian, y, step).ravel(), rel=first, abs=1e-8)
    upper = np.asarray(nlp.hess_lag(y, parameters, 0.7, weights))
    curvature = differences(slope, y, step)
    assert upper + np.triu(upper, 1).T == pytest.approx(curvature, abs=second * np.max(np.abs(curvature)))


def order_4(function, x, step):
    """Return the derivative of a function at x by a central difference of order 4, of four values."""
    one, two = (function(x + h) - function(x - h) for h in (step, 2.0 * step))
    return (8.0 * one - two) / (12.0 * step)
