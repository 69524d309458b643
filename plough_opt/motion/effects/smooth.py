"""Contact `Smooth`: one-sided resistance without memory."""

from dataclasses import dataclass
from typing import Any

from plough_opt.core.checks import LEAST, check_domain
from plough_opt.core.expressions import Expression, as_number, maximum, minimum
from plough_opt.core.quantities import read_fields
from plough_opt.motion.effects.term import Parameters, Place, Rates, Term, peak_strength


@dataclass(frozen=True)
class Smooth:
    """One-sided contact without memory: the resistance is multiplied by a smooth step of the share's speed.

    With u = L'/w for the width w, the step is 0 for u <= 0, u^5 (126 - 420 u + 540 u^2 - 315 u^3 + 70 u^4) up to u = 1,
    and 1 beyond. It is so smooth at both ends that second derivatives of a run keep their digits. As the width tends
    to 0 the motion tends to that of `StickSlip`, provided that no gap opens.

    Args:
        width: speed w [m/s] above which the soil resists fully, above 0.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(contact=po.Smooth("0.05 m/s")).contact.width
        0.05
    """

    width: Expression

    def __post_init__(self) -> None:
        read_fields(self, width="effects.contact_width")
        check_domain("width of the smooth contact", self.width, "m/s", at_least=LEAST)

    def step(self, speed: Expression) -> tuple[Expression, Expression]:
        """Return the step at a speed of the share [m/s], from 0 to 1, and its derivative [s/m]."""
        u = minimum(maximum(speed / self.width, 0.0), 1.0)
        # Four derivatives vanish at each end, so integration steps across an end keep the digits of second derivatives.
        step = u**5 * (126.0 + u * (u * (540.0 + u * (70.0 * u - 315.0)) - 420.0))
        return step, 630.0 * (u * (1.0 - u)) ** 4 / self.width


class SmoothContact(Term):
    """Factor `Smooth.step` on the whole resistance of the soil."""

    label, field = "smooth contact", "contact"
    law, names = Smooth, ("width",)
    kinked = True

    @staticmethod
    def usual(scene: Any, duration: float) -> Smooth:
        return Smooth(0.1 * (float(as_number(scene.tow_speed)) or 1.0))

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return at.of(lambda _, speed: Smooth(p["width"]).step(speed)[0]) * force

    @staticmethod
    def rates(p: Parameters) -> Rates:
        if "width" not in p:
            return Rates()
        slope = p["static"] * Smooth(p["width"]).step(p["tow_speed"])[1]
        # Steepest slope of the step, in the strongest soil along the path.
        steepest = 315.0 / 128.0 * p["static"] * peak_strength(p) / p["width"]
        return Rates(damping=slope, steepest=steepest - slope)
