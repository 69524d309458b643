"""A viscous damper in the mount."""

import math
from typing import Any

from plough_opt.core.expressions import Expression, as_number
from plough_opt.motion.effects.term import Parameters, Rates, Term


class Damping(Term):
    """Damping force c z' of the mount on the share, added to that of the spring."""

    label = field = "damping"
    names = ("damping",)

    @staticmethod
    def usual(scene: Any, duration: float) -> float:
        # A tenth of critical damping.
        return 0.2 * math.sqrt(float(as_number(scene.stiffness)) * float(as_number(scene.inertia)))

    def pull(self, p: Parameters, rate: Expression) -> Expression:
        return p["damping"] * rate

    @staticmethod
    def rates(p: Parameters) -> Rates:
        return Rates(damping=p.get("damping", 0.0))
