"""Contact `StickSlip`: soil that only resists, with the events that come of it."""

from dataclasses import dataclass
from typing import Any

from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import read_fields
from plough_opt.motion.effects.term import Parameters, Place, Term, Towed


@dataclass(frozen=True)
class StickSlip:
    """Soil that keeps its density on unloading, and so cannot push: the share slips, sticks, or leaves a gap.

    * Slip, L' > 0 at the furthest point: the resistance of (25). Where L' falls to 0 the share sticks if the mount
      force P lies between 0 and ``breakaway`` times the static resistance, leaves a gap if P < 0, and else slips on.
    * Stick, L' = 0: until P reaches ``breakaway`` F0(L), or 0.
    * Gap, behind the furthest point: no soil and no added mass; at the furthest point the share takes up the added
      mass, m v = (m + m_a) v', and slips on.

    CasADi says on the error stream, whenever an integrator with events or a derivative of one is built, that its
    support of them is experimental; a library leaves a program's streams alone. Every run is checked by a second one.

    Derivatives are those through the times at which it moves and stops; CasADi has the second ones of a gradient only:
    see `plough_opt.simulate`.

    Args:
        breakaway: resistance at which a sticking share moves, over the static resistance [-], at least 1.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(contact=po.StickSlip(breakaway=1.2)).contact.breakaway
        1.2
    """

    breakaway: Expression = 1.0

    def __post_init__(self) -> None:
        read_fields(self, breakaway="effects.breakaway")


class StickSlipContact(Term):
    """Factor ``breakaway`` on the soil's resistance to a share at rest; the equation of motion has its modes."""

    label, field = "stick and slip", "contact"
    names = ("breakaway",)
    kinked = events = True

    @classmethod
    def of(cls, scene: Towed) -> tuple[Term, ...]:
        return (cls(),) if isinstance(scene.effects.contact, StickSlip) else ()

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"breakaway": scene.effects.contact.breakaway}

    @classmethod
    def usual(cls, scene: Any, duration: float) -> StickSlip:
        return StickSlip()

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return p["breakaway"] * force
