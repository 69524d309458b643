"""A share that enters the soil from its surface."""

from plough_opt.core.expressions import Expression, maximum, minimum, where
from plough_opt.motion.effects.term import Parameters, Place, Term, Towed


class Entry(Term):
    """Factor (H/h)^2 on the resistance of a share of height h with the length H in the soil."""

    label = field = "entry"
    names = ("height",)
    usual = True
    state = "entered"
    kinked = events = True

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"height": scene.cone.height}

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force if at.travel is None else self.buried(p, at.travel) ** 2 * force

    def buried(self, p: Parameters, travel: Expression) -> Expression:
        """Return the fraction H/h of the share's height that is in the soil [-]; it follows from the furthest travel.

        The differential equation has the state ``entered``, which sets it to 1. Otherwise rounding of the time at which
        the share is fully in the soil could select the slope before that time.
        """
        entering = maximum((travel + p.get("behind", 0.0)) / p["height"], 0.0)
        return where(p["entered"] > 0.5, 1.0, entering) if "entered" in p else minimum(entering, 1.0)

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        return p["height"] - travel
