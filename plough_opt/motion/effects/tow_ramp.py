"""A strut whose speed rises from 0 to the tow speed."""

import math
from dataclasses import dataclass
from typing import Any

from plough_opt.core.expressions import Expression, minimum, where
from plough_opt.motion.effects.term import Parameters, Term, Towed

# Time [s] in which no mount moves: forces change by 1e-11 of themselves or so.
_SHORTEST_RAMP = 1e-9


@dataclass(frozen=True)
class Strut:
    """Path s [m], speed gained since the start s' - s'(0) [m/s] and acceleration s'' [m/s^2] of the strut."""

    path: Expression
    gain: Expression
    acceleration: Expression


class TowRamp(Term):
    """Speed of the strut by 6u^5 - 15u^4 + 10u^3 with u = t/t_r."""

    label, field = "tow ramp", "tow_ramp"
    names = ("ramp_time",)
    state = "ramped"

    @classmethod
    def of(cls, scene: Towed) -> tuple[Term, ...]:
        return (cls(),) if scene.effects.ramps else ()

    @classmethod
    def usual(cls, scene: Any, duration: float) -> float:
        return 0.1 * duration

    def strut(self, p: Parameters, time: Expression) -> Strut:
        """Return the strut's motion.

        Where events interrupt the motion the state ``ramped`` ends the ramp: the step that finds its end goes beyond
        it, and its stages there must not see another motion yet.
        """
        speed, ramp = p["tow_speed"], ramp_time(p)
        u = where(p["ramped"] > 0.5, 1.0, time / ramp) if "ramped" in p else minimum(time / ramp, 1.0)
        return Strut(
            path=speed * (ramp * u**4 * (2.5 + u * (u - 3.0)) + (time - ramp * u)),
            gain=speed * u**3 * (10.0 + u * (6.0 * u - 15.0)),
            acceleration=speed / ramp * 30.0 * u**2 * (1.0 - u) ** 2,
        )

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        return ramp_time(p) - time

    @staticmethod
    def imposed(p: Parameters) -> tuple[Any, ...]:
        return (2.0 * math.pi / p["ramp_time"],) if "ramp_time" in p else ()


def ramp_time(p: Parameters) -> Expression:
    """Return the time of the strut's ramp [s]: of one that symbols make 0, one so short that it changes nothing."""
    time = p["ramp_time"]
    return where(time > 0.0, time, time + _SHORTEST_RAMP)
