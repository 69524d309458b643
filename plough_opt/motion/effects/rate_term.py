"""Static resistance that grows with the squared speed, for calibration."""

from plough_opt.core.expressions import Expression
from plough_opt.motion.effects.term import Parameters, Place, Term


class RateTerm(Term):
    """Factor 1 + kappa L'^2 on the static resistance."""

    label, field = "rate term", "rate_term"
    names = ("rate_term",)
    usual = 0.01

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force * (1.0 + p["rate_term"] * at.squared_speed)
