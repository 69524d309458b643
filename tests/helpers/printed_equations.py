"""Equations (25) and (26) exactly as printed in the source: with pi twice, 1/3, and divisions by nu and b1."""

import math


def printed_coefficients(cone, soil):
    """Return A [Pa], B and C [-] of (26), for a soil with internal friction."""
    mu, slope, b1 = math.sin(soil.friction_angle), cone.slope, soil.density_ratio
    nu, tau0, a = 2.0 * mu / (1.0 + mu), 2.0 * soil.cohesion * math.cos(soil.friction_angle), 1.0 / (1.0 - b1)
    growth, decay = a ** (nu / 2.0), a ** (nu / 2.0 - 1.0)
    bracket = (nu - 2.0) / nu * (growth - 1.0) + b1 * (nu - 2.0) * growth - (decay - 1.0)
    static = soil.strength_factor * (soil.ambient_pressure + tau0 / (nu * (1.0 + mu))) * (growth - 1.0)
    return (
        math.pi * slope**2 * static,
        math.pi * slope**4 / (b1 * (nu - 2.0)) * bracket,
        math.pi * slope**4 / (3.0 * b1 * nu) * (growth - 1.0),
    )


def printed_resistance(cone, soil, speed, acceleration):
    """Return F [N] of (25) with these coefficients."""
    a, b, c = printed_coefficients(cone, soil)
    motion = b * soil.density * speed**2 + soil.density * c * cone.height * acceleration
    return math.pi * (1.0 + soil.tool_friction / cone.slope) * (a + motion) * cone.height**2
