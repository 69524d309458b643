"""Inertial resistance of the soil, which grows with the squared speed."""

from plough_opt.core.expressions import Expression
from plough_opt.motion.effects.term import Parameters, Place, Rates, Term, Towed


class InertialDrag(Term):
    """Resistance Fd L'^2."""

    label, field = "inertial drag", "inertial_drag"
    names = ("drag",)
    usual = True

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"drag": scene.reaction.drag}

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force + p["drag"] * at.squared_speed

    @staticmethod
    def rates(p: Parameters) -> Rates:
        return Rates(damping=2.0 * p.get("drag", 0.0) * p.get("tow_speed", 0.0))
