"""The effects of the toolkit itself, beside the contact laws, in the order in which they make up the resistance."""

import math
from dataclasses import dataclass
from typing import Any

from plough_opt.core.expressions import Expression, as_number, maximum, minimum, sin, where
from plough_opt.motion.effects.term import Parameters, Place, Rates, Term, Towed
from plough_opt.soil.waves import StrengthWave


@dataclass(frozen=True)
class StrengthWaves(Term):
    """Static resistance F0 (1 + sum of amplitude sin(2 pi L/wavelength + phase)).

    Attributes:
        count: number of waves.
        phased: whether any has a phase.
        turns: on an orbit under several waves, how often each turns before all repeat themselves together; else ().
    """

    count: int
    phased: bool = False
    turns: tuple[int, ...] = ()

    label, field = "strength wave", "strength_wave"

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for wave in map(wave_names, range(self.count)) for name in wave[: 2 + self.phased])

    @classmethod
    def of(cls, scene: Towed) -> tuple[Term, ...]:
        effects, waves = scene.effects, scene.effects.waves
        phased = any(not isinstance(wave.phase, int | float) or wave.phase != 0.0 for wave in waves)
        turns = effects.turns if effects.orbit != "transient" and len(waves) > 1 else ()
        return (cls(len(waves), phased, turns),) if waves else ()

    def values(self, scene: Towed) -> dict[str, Expression]:
        waves = ((wave.amplitude, wave.wavelength, wave.phase) for wave in scene.effects.waves)
        return dict(zip(self.names, (x for wave in waves for x in wave[: 2 + self.phased]), strict=True))

    @classmethod
    def usual(cls, scene: Any, duration: float) -> StrengthWave:
        return StrengthWave(0.3, 0.2)

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        if at.travel is None:
            return force
        total: Expression = 0.0
        for k in range(self.count):
            amplitude, length, phase = wave_names(k)
            # On an orbit all lengths follow from the first one's, so that they stay commensurate.
            turn = 2.0 * math.pi * self.turns[k] / self.repeats(p) if self.turns else 2.0 * math.pi / p[length]
            angle = turn * at.travel + p[phase] if self.phased else turn * at.travel
            total = total + p["static"] * p[amplitude] * sin(angle)
        return force + at.varying(total)

    def repeats(self, p: Parameters) -> Expression:
        """Return the length [m] after which the soil of an orbit repeats itself."""
        return p["wavelength"] * self.turns[0] if self.turns else p["wavelength"]

    @staticmethod
    def imposed(p: Parameters) -> list[Any]:
        # The wave is a sine of the travel, to which the share's own oscillation adds harmonics.
        return [4.0 * math.pi * p["tow_speed"] / length for name, length in p.items() if name.startswith("wavelength")]


def wave_names(k: int) -> tuple[str, str, str]:
    """Return the names of amplitude, wavelength and phase of a strength wave, counted from 0."""
    number = "" if k == 0 else f"_{k + 1}"
    return f"wave_amplitude{number}", f"wavelength{number}", f"wave_phase{number}"


class RateTerm(Term):
    """Factor 1 + kappa L'^2 on the static resistance."""

    label, field = "rate term", "rate_term"
    names = ("rate_term",)

    @classmethod
    def usual(cls, scene: Any, duration: float) -> float:
        return 0.01

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force * (1.0 + p["rate_term"] * at.squared_speed)


class InertialDrag(Term):
    """Resistance Fd L'^2."""

    label, field = "inertial drag", "inertial_drag"
    names = ("drag",)

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"drag": scene.reaction.drag}

    @classmethod
    def usual(cls, scene: Any, duration: float) -> bool:
        return True

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force + p["drag"] * at.squared_speed

    @staticmethod
    def rates(p: Parameters) -> Rates:
        return Rates(damping=2.0 * p.get("drag", 0.0) * p.get("tow_speed", 0.0))


class Entry(Term):
    """Resistance of the part of the share that is in the soil."""

    label = field = "entry"
    names = ("height",)
    state = "entered"
    kinked = events = True

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"height": scene.cone.height}

    @classmethod
    def usual(cls, scene: Any, duration: float) -> bool:
        return True

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force if at.travel is None else self.buried(p, at.travel) ** 2 * force

    def buried(self, p: Parameters, travel: Expression) -> Expression:
        """Return the part H/h of the share's height that is in the soil [-], which its furthest travel decides.

        In the differential equation the state ``entered`` decides: rounding of the time at which the share is wholly in
        the soil would else leave the slope of the wrong side.
        """
        entering = maximum((travel + p.get("behind", 0.0)) / p["height"], 0.0)
        return where(p["entered"] > 0.5, 1.0, entering) if "entered" in p else minimum(entering, 1.0)

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        return p["height"] - travel


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


class Damping(Term):
    """Force c z' of the mount on the share, beside the spring's."""

    label = field = "damping"
    names = ("damping",)

    @classmethod
    def usual(cls, scene: Any, duration: float) -> float:
        # A tenth of critical damping.
        return 0.2 * math.sqrt(float(as_number(scene.stiffness)) * float(as_number(scene.inertia)))

    def pull(self, p: Parameters, rate: Expression) -> Expression:
        return p["damping"] * rate

    @staticmethod
    def rates(p: Parameters) -> Rates:
        return Rates(damping=p.get("damping", 0.0))
