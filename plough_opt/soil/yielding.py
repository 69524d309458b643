"""Yield condition (10) of the soil, and the factor on its strength at the cavity wall: parts of equation (23)."""

from __future__ import annotations

from dataclasses import dataclass

from plough_opt.core.expressions import Expression, cos, expm1, expm1_ratio, log1p, log1p_ratio, sin


@dataclass(frozen=True)
class Yielding:
    """The yield condition (10): p_r - p_theta = tau0 + mu (p_r + p_theta), and nu = 2 mu/(1 + mu)."""

    mu: Expression
    nu: Expression
    tau0: Expression

    @classmethod
    def of(cls, friction_angle: Expression, cohesion: Expression) -> Yielding:
        """Return it for an angle of internal friction [rad] and a cohesion [Pa]."""
        mu = sin(friction_angle)
        return cls(mu, 2.0 * mu / (1.0 + mu), 2.0 * cohesion * cos(friction_angle))

    def strength(self, ambient_pressure: Expression) -> Expression:
        """Return nu p_a + tau0/(1 + mu) [Pa]."""
        return self.nu * ambient_pressure + self.tau0 / (1.0 + self.mu)


def growth(density_ratio: Expression, nu: Expression) -> Expression:
    """Return phi = (a^(nu/2) - 1)/nu with a = 1/(1 - b1) [-], the factor on the strength at the cavity wall."""
    log_a = -log1p(-density_ratio)
    return log_a / 2.0 * expm1_ratio(nu * log_a / 2.0)


def density_ratio_of(growth: Expression, nu: Expression) -> Expression:
    """Return the b1 whose `growth` is given, 1 - (1 + nu phi)^(-2/nu), regular without internal friction."""
    return -expm1(-2.0 * growth * log1p_ratio(nu * growth))
