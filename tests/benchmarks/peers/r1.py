"""Problem R1 written out for other tools, and its reference from a grid of simulations refined in long double."""

import math
from pathlib import Path

import numpy as np

PROBLEM = str(Path(__file__).resolve().parents[3] / "problems" / "reference.toml")
DURATION, SPEED, AMPLITUDE, WAVELENGTH = 2.0, 2.0, 0.3, 0.6
CHISEL, STEEL, FRAME = math.radians(15.0), 7850.0, 20.0
DENSITY, RATIO, FRICTION, COHESION, TOOL, AMBIENT = 1400.0, 0.8, math.radians(30.0), 15e3, 0.5, 1e4

LOWER = np.array([math.radians(5.0), 0.10, 5e3])
UPPER = np.array([math.radians(60.0), 0.50, 5e5])
START = np.array([math.radians(25.0), 0.25, 5e4])
STARTS = tuple(np.array([START[0], START[1], k]) for k in (5e4, 6e3, 2e4, 1e5, 4e5))

# Name, stiffness [N/m] and objective of the local optima; the first is the global one.
OPTIMA = (("L1", 5e3, 0.8250057092), ("L2", 5e5, 0.8383450230), ("L3", 37505.6423, 0.9164459115))

_LOOSE = 1.0 / (1.0 - RATIO)
_MU = math.sin(FRICTION)
_NU = 2.0 * _MU / (1.0 + _MU)
_PHI = (_LOOSE ** (_NU / 2.0) - 1.0) / _NU
_RATE = _PHI / RATIO + _LOOSE ** (_NU / 2.0) + (1.0 - _LOOSE ** (_NU / 2.0 - 1.0)) / (RATIO * (_NU - 2.0))


def equation(angle, height, stiffness, m=np):
    """Return F0, Fd, M, k and z0 of the equation of motion, by NumPy or a module with the same functions."""
    strength = _PHI * (_NU * AMBIENT + 2.0 * COHESION * math.cos(FRICTION) / (1.0 + _MU))
    slope = _slope(angle, m)
    face = math.pi * height**2 * slope * (slope + TOOL)
    static, drag = face * strength, face * slope**2 * _RATE * DENSITY
    added = face * slope**2 * (2.0 / 3.0) * (_PHI / RATIO) * DENSITY * height
    inertia = FRAME + STEEL * math.pi / 3.0 * height**3 * slope**2 + added
    return static, drag, inertia, stiffness, (static + drag * SPEED**2) / stiffness


def requirements(angle, height, stiffness, mean, m=np):
    """Return the margins of loosened radius, mean deflection and half angle, relative to their limits."""
    slope = _slope(angle, m)
    radius = height * slope * math.sqrt(_LOOSE)
    return radius / 0.12 - 1.0, 1.0 - mean / stiffness / 0.15, 1.0 - m.arctan(slope) / math.radians(15.0)


def _slope(angle, m):
    q = 2.0 * m.tan(angle) / (math.pi * math.cos(CHISEL) ** 2)
    return q / m.sqrt(2.0 * (1.0 + m.sqrt(1.0 + q**2)))


def scaled(x):
    """Return a design scaled to 0 to 1, with the logarithm of the stiffness."""
    low, high = LOWER.copy(), UPPER.copy()
    low[2], high[2] = np.log(low[2]), np.log(high[2])
    return (np.array([x[0], x[1], math.log(x[2])]) - low) / (high - low)


def unscaled(y, m=np):
    """Return angle, height and stiffness of a scaled design."""
    angle, height = (LOWER[k] + y[k] * (UPPER[k] - LOWER[k]) for k in range(2))
    return angle, height, LOWER[2] * m.exp(y[2] * math.log(UPPER[2] / LOWER[2]))
