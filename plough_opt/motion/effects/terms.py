"""Terms of the effects in the equation of motion: their base class, and the built-in ones with their settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias, cast

from plough_opt.core.checks import LEAST, check_domain
from plough_opt.core.expressions import Expression, as_number, maximum, minimum, sin, where
from plough_opt.core.quantities import read_fields
from plough_opt.soil.strength import StrengthWave

Parameters = Mapping[str, Expression]
"""Parameters of an equation of motion by name: numbers or symbols."""


Towed: TypeAlias = Any
"""A `Scene`, whose module imports this one."""


@dataclass(frozen=True)
class Changed:
    """A quantity as the sum of its value at the start and its change since then.

    It replaces an expression in the sums and products of resistances. Constant parts then cancel algebraically instead
    of in floating point.
    """

    first: Expression
    change: Expression

    def __add__(self, other: Expression) -> Changed:
        own = other if isinstance(other, Changed) else Changed(other, 0.0)
        return Changed(self.first + own.first, self.change + own.change)

    def __mul__(self, other: Expression) -> Changed:
        if not isinstance(other, Changed):
            return Changed(self.first * other, self.change * other)
        now = other.first + other.change
        return Changed(self.first * other.first, self.first * other.change + self.change * now)

    __radd__, __rmul__ = __add__, __mul__

    def squared(self) -> Changed:
        """Return the square."""
        return Changed(self.first**2, self.change * (2.0 * self.first + self.change))


class Place(NamedTuple):
    """Position and speed of a share.

    Attributes:
        travel: L [m]; None for a buried share that slides steadily through soil of the mean strength.
        speed: L' [m/s]; a `Changed` to compute the change of resistance since an equilibrium start.
    """

    travel: Expression | None
    speed: Any

    @property
    def squared_speed(self) -> Expression:
        """Square of the speed."""
        return cast(Expression, self.speed.squared() if isinstance(self.speed, Changed) else self.speed**2)

    def varying(self, value: Expression) -> Expression:
        """Return a quantity that averages to zero along the path, and so does not count at an equilibrium start."""
        return cast(Expression, Changed(0.0, value)) if isinstance(self.speed, Changed) else value

    def of(self, function: Callable[..., Expression]) -> Expression:
        """Return the value of a function of travel and speed."""
        if not isinstance(self.speed, Changed):
            return function(0.0 if self.travel is None else self.travel, self.speed)
        first = function(0.0, self.speed.first)
        change = function(self.travel, self.speed.first + self.speed.change) - first
        return cast(Expression, Changed(first, change))


class Rates(NamedTuple):
    """Slopes of an effect's force, from which the number of steps is chosen.

    Attributes:
        stiffness: steepest slope by travel [N/m].
        damping: slope by speed [N s/m] of a share that slides.
        steepest: slope by speed [N s/m] that occurs only at some speeds.
    """

    stiffness: Any = 0.0
    damping: Any = 0.0
    steepest: Any = 0.0


def peak_strength(p: Parameters) -> Any:
    """Return the ratio of the soil's greatest strength along the path to its mean."""
    return 1.0 + sum(value for name, value in p.items() if name.startswith("wave_amplitude"))


@dataclass(frozen=True)
class Term:
    """An effect in the equation of motion, without numbers. Methods that a class does not override have no influence.

    Attributes:
        label: its name in tables; "" for an effect that tables omit.
        field: the field of `Effects` that switches it on, or holds its only number.
        law: class of the field's value, with the parameters as its attributes, if the field may have values of others.
        names: names of its parameters.
        usual: realistic value of the field to try the effect with, or a function of a numeric scene and a duration [s].
        state: name of a state that is 0 until the effect is over and 1 afterwards; "" without one.
        kinked: whether the force has a kink that a share may reach, where steps of order 8 lose their order.
        events: whether it interrupts the motion by events that an integrator must locate.
    """

    label: ClassVar[str] = ""
    field: ClassVar[str] = ""
    law: ClassVar[type | None] = None
    usual: ClassVar[Any] = None
    state: ClassVar[str] = ""
    kinked: ClassVar[bool] = False
    events: ClassVar[bool] = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return ()

    @classmethod
    def of(cls, scene: Towed) -> Sequence[Term]:
        """Return the terms of a scene; none if the effect is off."""
        value = getattr(scene.effects, cls.field)
        on = value is not None and value is not False if cls.law is None else isinstance(value, cls.law)
        return (cls(),) if on else ()

    def values(self, scene: Towed) -> dict[str, Expression]:
        """Return the parameters of a scene by name."""
        value = getattr(scene.effects, self.field)
        return {name: value if self.law is None else getattr(value, name) for name in self.names}

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the resistance [N] with this effect, given that of all terms before it."""
        return force

    def hold(self, force: Expression, at: Place, p: Parameters) -> Expression:
        """Return the largest force [N] that holds a resting share, given that of all terms before it."""
        return self.resist(force, at, p)

    def carry(self, mass: Expression, p: Parameters, travel: Expression) -> Expression:
        """Return the mass of soil [kg] that the share carries along, given that of all terms before it."""
        return mass

    def pull(self, p: Parameters, rate: Expression) -> Expression:
        """Return the contribution to the mount force [N] at a rate z' of the deflection [m/s]."""
        return 0.0

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        """Return a value that becomes negative when the effect is over; for an effect with a `state`."""
        raise NotImplementedError

    @staticmethod
    def rates(p: Parameters) -> Rates:
        """Return the slopes of the force; all zero if the parameters of the effect are missing."""
        return Rates()

    @staticmethod
    def imposed(p: Parameters) -> Sequence[Any]:
        """Return the angular frequencies [rad/s] that the effect imposes on a share."""
        return ()


@dataclass(frozen=True)
class StrengthWaves(Term):
    """Static resistance F0 (1 + sum of amplitude sin(2 pi L/wavelength + phase)).

    Attributes:
        count: number of waves.
        phased: whether any wave has a phase.
        turns: periods of each wave in the common period, for an orbit under several waves; otherwise ().
    """

    count: int
    phased: bool = False
    turns: tuple[int, ...] = ()

    label, field = "strength wave", "strength_wave"
    usual = StrengthWave(0.3, 0.2)

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

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        if at.travel is None:
            return force
        total: Expression = 0.0
        for k in range(self.count):
            amplitude, length, phase = wave_names(k)
            # On an orbit all wavelengths follow from the first one, so that they stay commensurate.
            turn = 2.0 * math.pi * self.turns[k] / self.repeats(p) if self.turns else 2.0 * math.pi / p[length]
            angle = turn * at.travel + p[phase] if self.phased else turn * at.travel
            total = total + p["static"] * p[amplitude] * sin(angle)
        return force + at.varying(total)

    def repeats(self, p: Parameters) -> Expression:
        """Return the length [m] of path after which the soil of an orbit repeats itself."""
        return p["wavelength"] * self.turns[0] if self.turns else p["wavelength"]

    @staticmethod
    def imposed(p: Parameters) -> list[Any]:
        # Twice the wave's frequency: the force is a sine of the travel, whose oscillation adds harmonics.
        return [4.0 * math.pi * p["tow_speed"] / length for name, length in p.items() if name.startswith("wavelength")]


def wave_names(k: int) -> tuple[str, str, str]:
    """Return the names of amplitude, wavelength and phase of strength wave k, counted from 0."""
    number = "" if k == 0 else f"_{k + 1}"
    return f"wave_amplitude{number}", f"wavelength{number}", f"wave_phase{number}"


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


class SpeedTerm(Term):
    """Factor 1 + lambda L' on the static resistance. A retreating share has less of it."""

    label, field = "speed term", "speed_term"
    names = ("speed_term",)
    usual = 0.1

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return cast(Expression, force * (1.0 + p["speed_term"] * at.speed))

    @staticmethod
    def rates(p: Parameters) -> Rates:
        slope = p.get("speed_term", 0.0) * p.get("static", 0.0)
        return Rates(damping=slope, steepest=(peak_strength(p) - 1.0) * slope)


class Entry(Term):
    """Factors on a share of height h with the length H in the soil: (H/h)^2 on resistance, (H/h)^3 on added mass."""

    label = field = "entry"
    names = ("height",)
    usual = True
    state = "entered"
    kinked = events = True

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"height": scene.cone.height}

    def resist(self, force: Expression, at: Place, p: Parameters) -> Expression:
        return force if at.travel is None else self.buried(p, at.travel) ** 2 * force

    def carry(self, mass: Expression, p: Parameters, travel: Expression) -> Expression:
        return mass * self.buried(p, travel) ** 3

    def buried(self, p: Parameters, travel: Expression) -> Expression:
        """Return the fraction H/h of the share's height that is in the soil [-]; it follows from the furthest travel.

        The differential equation has the state ``entered``, which sets it to 1. Otherwise rounding of the time at which
        the share is fully in the soil could select the slope before that time.
        """
        entering = maximum((travel + p.get("behind", 0.0)) / p["height"], 0.0)
        return where(p["entered"] > 0.5, 1.0, entering) if "entered" in p else minimum(entering, 1.0)

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        return p["height"] - travel


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
        """Return the step at a speed of the share [m/s], from 0 to 1, and its derivative [s/m].

        Example:
            >>> import plough_opt as po
            >>> step, slope = po.Smooth("0.05 m/s").step(0.025)
            >>> round(float(step), 6), round(float(slope), 6)
            (0.5, 49.21875)
        """
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
    of events is experimental. Simulations, designs and studies suppress this line, because every run is checked by a
    second one; a derivative that you build from a run yourself still prints it.

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


SHORTEST_RAMP = 1e-9
"""Time of a ramp [s] that changes forces by about 1e-11 relative to a start at full speed."""


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

    def values(self, scene: Towed) -> dict[str, Expression]:
        time = scene.effects.tow_ramp
        # If a symbol makes it 0, the formulas of the ramp still hold for a time too short to matter.
        return {"ramp_time": where(time > 0.0, time, time + SHORTEST_RAMP)}

    def strut(self, p: Parameters, time: Expression) -> Strut:
        """Return the strut's motion.

        In an equation with events the state ``ramped`` ends the ramp. The step that locates the end overshoots it, and
        its stages beyond the end must still evaluate the ramp's formula.
        """
        speed, ramp = p["tow_speed"], p["ramp_time"]
        u = where(p["ramped"] > 0.5, 1.0, time / ramp) if "ramped" in p else minimum(time / ramp, 1.0)
        return Strut(
            path=speed * (ramp * u**4 * (2.5 + u * (u - 3.0)) + (time - ramp * u)),
            gain=speed * u**3 * (10.0 + u * (6.0 * u - 15.0)),
            acceleration=speed / ramp * 30.0 * u**2 * (1.0 - u) ** 2,
        )

    def until(self, p: Parameters, time: Expression, travel: Expression) -> Expression:
        return p["ramp_time"] - time

    @staticmethod
    def imposed(p: Parameters) -> tuple[Any, ...]:
        return (2.0 * math.pi / p["ramp_time"],) if "ramp_time" in p else ()


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
