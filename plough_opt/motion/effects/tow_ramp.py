"""A strut whose speed rises from 0 to the tow speed."""

import math
from dataclasses import dataclass
from typing import Any

from plough_opt.core.expressions import Expression, minimum, where
from plough_opt.motion.effects.term import Parameters, Term, Towed

# A ramp of this time [s] changes forces by about 1e-11 relative to a start at full speed.
_SHORTEST_RAMP = 1e-9


@dataclass(frozen=True)
class Strut:
    """Path s [m], gain in speed since the start s' - s'(0) [m/s] and acceleration s'' [m/s^2] of the strut."""

    path: Expression
    gain: Expression
    acceleration: Expression


class TowRamp(Term):
    """Strut that reaches the tow speed after the time t_r: its speed rises like 6u^5 - 15u^4 + 10u^3 with u = t/t_r."""

    label, field = "tow ramp", "tow_ramp"
    names = ("ramp_time",)
    state = "ramped"

    @classmethod
    def of(cls, scene: Towed) -> tuple[Term, ...]:
        return (cls(),) if scene.effects.ramps else ()

    @staticmethod
    def usual(scene: Any, duration: float) -> float:
        return 0.1 * duration

    def strut(self, p: Parameters, time: Expression) -> Strut:
        """Return the strut's motion.

        In an equation with events the state ``ramped`` ends the ramp. The step that locates the end overshoots it, and
        its stages beyond the end must still evaluate the ramp's formula.
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
    """Return the time of the strut's ramp [s]; if a symbol makes it 0, a time too short to matter."""
    time = p["ramp_time"]
    return where(time > 0.0, time, time + _SHORTEST_RAMP)
