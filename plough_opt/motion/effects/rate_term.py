"""Static resistance that grows with the squared speed, for calibration."""

from plough_opt.core.expressions import Expression
from plough_opt.motion.effects.term import Parameters, Place, Rates, Term, peak_strength


class RateTerm(Term):
    """Factor 1 + kappa L'^2 on the static resistance."""

    label, field = "rate term", "rate_term"
    names = ("rate_term",)
    usual = 0.01

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force * (1.0 + p["rate_term"] * at.squared_speed)

    @staticmethod
    def rates(p: Parameters) -> Rates:
        slope = 2.0 * p.get("rate_term", 0.0) * p.get("static", 0.0) * p.get("tow_speed", 0.0)
        return Rates(damping=slope, steepest=(peak_strength(p) - 1.0) * slope)
