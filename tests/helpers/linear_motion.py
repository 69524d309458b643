"""Exact solutions of linear equations of motion, as sums of exponentials."""

import cmath

import numpy as np


def released(inertia, damping, stiffness, first, times):
    """Return the z and z' of M z'' + c z' + k z = 0 that start with the given two values."""
    middle, root = -damping / (2.0 * inertia), cmath.sqrt((damping / (2.0 * inertia)) ** 2 - stiffness / inertia)
    one, two = middle + root, middle - root
    a = (first[1] - two * first[0]) / (2.0 * root)
    parts = a * np.exp(one * times), (first[0] - a) * np.exp(two * times)
    return (parts[0] + parts[1]).real, (one * parts[0] + two * parts[1]).real


def oscillation(scene, times, damping=0.0, stiffness=0.0):
    """Return z and z' of a share that starts at rest, its spring relaxed, against a constant soil resistance F0.

    M z'' = F0 + d L' + K L - k0 z - c z' with the travel L = V0 t - z. An own resistance adds the damping d [N s/m] and
    the stiffness K [N/m].
    """
    speed, slow = scene.tow_speed, damping + (scene.effects.damping or 0.0)
    pull = stiffness + scene.restoring_stiffness
    drift = stiffness * speed / pull
    steady = (scene.reaction.static + damping * speed - slow * drift) / pull
    z, rate = released(scene.inertia, slow, pull, (-steady, speed - drift), times)
    return steady + drift * times + z, drift + rate


def averages(function, duration):
    """Return mean and RMS of a smooth function of an array of times, by Gauss's quadrature of degree 239."""
    nodes, weights = np.polynomial.legendre.leggauss(120)
    values = function(duration * (nodes + 1.0) / 2.0)
    mean = weights @ values / 2.0
    return mean, np.sqrt(weights @ (values - mean) ** 2 / 2.0)
