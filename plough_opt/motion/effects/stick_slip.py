"""Contact `StickSlip`: soil that only resists; the share slips, sticks or leaves a gap."""

from dataclasses import dataclass

from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import read_fields
from plough_opt.motion.effects.term import Parameters, Place, Term


@dataclass(frozen=True)
class StickSlip:
    """Contact with soil that keeps its density on unloading and so cannot push the share.

    The share is in one of three modes:

    * Slip, L' > 0 at the furthest point: the resistance of (25) acts. When L' falls to 0, the share sticks if the mount
      force P lies between 0 and ``breakaway`` times the static resistance, leaves a gap if P < 0, and otherwise slips
      on.
    * Stick, L' = 0: lasts until P reaches ``breakaway`` F0(L), or 0.
    * Gap, behind the furthest point: neither soil nor added mass act. Back at the furthest point the share picks up the
      added mass, m v = (m + m_a) v', and slips on.

    When an integrator with events, or a derivative of one, is built, CasADi prints on the error stream that its support
    of events is experimental. The toolkit does not redirect a program's streams. Every run is checked by a second one.

    Derivatives include those of the times at which the share stops and breaks loose. CasADi provides second derivatives
    of a gradient only: see `plough_opt.simulate`.

    Args:
        breakaway: ratio of the force at which a sticking share breaks loose to the static resistance [-], at least 1.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(contact=po.StickSlip(breakaway=1.2)).contact.breakaway
        1.2
    """

    breakaway: Expression = 1.0

    def __post_init__(self) -> None:
        read_fields(self, breakaway="effects.breakaway")


class StickSlipContact(Term):
    """Factor ``breakaway`` on the force that holds a resting share; the modes are part of the equation of motion."""

    label, field = "stick and slip", "contact"
    law, names = StickSlip, ("breakaway",)
    usual = StickSlip()
    kinked = events = True

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return p["breakaway"] * force
