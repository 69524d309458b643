"""Equation of motion (27) in the spring deflection; a scene has only the terms that it needs.

With z = s(t) - L the deflection of the spring, z0 its value at the start and w = z - z0, the equation is

    M w'' = F(L, L') - k0 z0 - k0 w - c w' + M s''

With a profile of the tow speed w is counted from a strut that keeps its initial speed, and the mount is compressed by
w and by how far the strut is ahead of that.

It is written in deviations from the start, so that the large steady forces of an equilibrium start cancel algebraically
and not in floating point. As printed, with + k0 (L - V0 t), the spring repels: the parameter "stiffness" is then -k0,
the equilibrium lies at z = -F/k0, and a deviation from it grows like exp(sqrt(k0/M) t).

The states begin with (w, w'). With `StickSlip` or entry two more follow: the distance behind the furthest point [m],
and the mode, whose rate is zero. With entry the next state is 0 until the share is fully in the soil, and 1 afterwards.
With a tow ramp whose end is an event, the last state is 0 until that end, and 1 afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final, Literal, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.checks import unlabelled
from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import (
    Column,
    Expression,
    as_number,
    is_casadi,
    is_symbolic,
    kept,
    minimum,
    rms,
    sqrt,
    stacked,
    where,
)
from plough_opt.motion.effects import (
    TERMS,
    Damping,
    Entry,
    Own,
    SmoothContact,
    StickSlipContact,
    TowProfile,
)
from plough_opt.motion.effects.terms import Changed, Parameters, Place, StrengthWaves, Strut, Term, Towed, TowRamp
from plough_opt.soil.strength import StrengthWave

_Kind = TypeVar("_Kind", bound=Term)

# Parameters that do not belong to a single effect. Events change the moving mass; otherwise it is the inertia.
_COMMON = ("inertia", "stiffness", "static", "tow_speed", "mass", "added_mass")


def _has(kind: type[Term]) -> cached_property[bool]:
    return cached_property(lambda structure: structure.find(kind) is not None)


def _term(kind: type[_Kind]) -> cached_property[_Kind | None]:
    return cached_property(lambda structure: structure.find(kind))


@dataclass(frozen=True)
class Structure:
    """Terms of a scene's equation of motion without their numbers. Scenes of equal structure share one graph.

    Attributes:
        terms: the effects that are on, in the order of `TERMS`.
        start: see `Effects`.
        carries: whether events change the mass of soil that moves with the share.
        orbit: see `Effects`.
        locates_ramp: whether an integrator locates the end of the ramp even if the scene has no other events.
    """

    terms: tuple[Term, ...] = ()
    start: Literal["equilibrium", "rest", "towed"] = "equilibrium"
    carries: bool = False
    orbit: Literal["transient", "periodic"] = "transient"
    locates_ramp: bool = False

    # Whether an effect is on.
    ramp, damper, entry = _has(TowRamp), _has(Damping), _has(Entry)
    smooth, sticks = _has(SmoothContact), _has(StickSlipContact)
    # Strength waves along the path, and the profile of the strut's speed; None if they are off.
    wave, profile = _term(StrengthWaves), _term(TowProfile)

    @staticmethod
    @kept
    def of(scene: Towed) -> Structure:
        """Return the structure of a scene."""
        effects = scene.effects
        terms = tuple(term for kind in TERMS for term in kind.of(scene))
        carries = effects.added_mass and effects.events
        return Structure(terms, effects.start, carries, effects.orbit)

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """Return the term of a class, or None if that effect is off."""
        return next((term for term in self.terms if isinstance(term, kind)), None)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that the terms may need, in order."""
        return (*_COMMON, *(name for term in self.terms for name in term.names))

    @property
    def accelerates(self) -> bool:
        """Whether the strut's speed changes, so that the tow power is averaged apart."""
        return self.ramp or self.profile is not None

    @cached_property
    def own(self) -> tuple[Own, ...]:
        """Resistances of the user's own."""
        return tuple(term for term in self.terms if isinstance(term, Own))

    @property
    def relaxed(self) -> bool:
        """Whether the spring is relaxed at the start."""
        return self.start != "equilibrium"

    @cached_property
    def kinked(self) -> bool:
        """Whether the equation has a kink that a share may reach, where steps of order 8 lose their order."""
        return any(term.kinked for term in self.terms)

    @cached_property
    def events(self) -> bool:
        """Whether an integrator must locate events."""
        return any(term.events for term in self.terms)

    @property
    def stepped(self) -> bool:
        """Whether the motion runs from a start without events, so that steps of order 8 can integrate it."""
        return self.orbit == "transient" and not self.events

    @cached_property
    def ends_ramp(self) -> bool:
        """Whether an integrator must locate the end of the strut's ramp."""
        return self.ramp and (self.events or self.locates_ramp)

    @cached_property
    def ending(self) -> tuple[Term, ...]:
        """Effects whose end an integrator locates. Each has a state that is 0 until then and 1 afterwards."""
        return tuple(term for term in self.terms if term.state and (self.ends_ramp or not isinstance(term, TowRamp)))

    def strut(self, p: Parameters, time: Expression) -> Strut:
        """Return the motion from which deviations are counted: the strut's, but under a profile at constant speed."""
        ramp = self.find(TowRamp)
        return Strut(self.start_speed(p) * time, gain=0.0, acceleration=0.0) if ramp is None else ramp.strut(p, time)

    def lead(self, p: Parameters, time: Expression) -> tuple[Expression, Expression]:
        """Return how far the strut is ahead of `strut` [m], and how much faster it is [m/s]: 0 without a profile."""
        return (0.0, 0.0) if self.profile is None else self.profile.lead(p, time)

    def towed(self, p: Parameters, time: Expression) -> tuple[Expression, Expression]:
        """Return path [m] and speed [m/s] of the strut."""
        mount, (ahead, faster) = self.strut(p, time), self.lead(p, time)
        return mount.path + ahead, self.start_speed(p) + mount.gain + faster

    def start_speed(self, p: Parameters) -> Expression:
        """Return the strut's speed at time 0 [m/s], which also defines the steady state of an equilibrium start."""
        if self.profile is not None:
            return self.profile.start_speed(p)
        return 0.0 if self.ramp else p["tow_speed"]

    def steady_resistance(self, p: Parameters, speed: Expression) -> Expression:
        """Return the resistance [N] to a buried share that slides at a speed [m/s], without strength waves."""
        return self._resist(p, p["static"], Place(None, speed))

    def start_resistance(self, p: Parameters) -> Expression:
        """Return the steady resistance at the strut's initial speed [N]."""
        return self.steady_resistance(p, self.start_speed(p))

    def start_force(self, p: Parameters) -> Expression:
        """Return the spring's force at the start [N]: the steady resistance, or 0 for a relaxed spring."""
        return 0.0 if self.relaxed else self.start_resistance(p)

    def start_deflection(self, p: Parameters) -> Expression:
        """Return the deflection z0 at the start [m]: steady, or 0 for a relaxed spring."""
        return self.start_force(p) / p["stiffness"]

    def start_rate(self, p: Parameters) -> Expression:
        """Return z' at time 0 [m/s]: V0 for a share at rest under a moving strut, otherwise 0."""
        return self.start_speed(p) if self.start == "rest" else 0.0

    def resistance(self, p: Parameters, travel: Expression, speed: Expression) -> Expression:
        """Return the resistance [N] without that of the added mass, accurate to all digits even if it is small.

        Args:
            p: parameters by name.
            travel: L of the share [m].
            speed: L' of the share [m/s].
        """
        return self._resist(p, p["static"], Place(travel, speed))

    def resistance_change(self, p: Parameters, travel: Expression, gain: Expression) -> Expression:
        """Return the resistance minus the steady resistance of an equilibrium start [N]: see `resistance`.

        Args:
            p: parameters by name.
            travel: L of the share [m].
            gain: L' - s'(0), the share's speed relative to the strut's initial speed [m/s].
        """
        at = Place(travel, Changed(self.start_speed(p), gain))
        static: Any = Changed(p["static"], 0.0)
        found: Any = self._resist(p, static, at)
        change: Expression = found.change
        return change

    def _resist(self, p: Parameters, force: Expression, at: Place) -> Expression:
        """Return the resistance that the terms, one after another, make of the static force [N]."""
        for term in self.terms:
            force = term.resist(force, at, p)
        return force

    def start_state(self, p: Parameters) -> Column:
        """Return the state at time 0 as a column."""
        first = stacked(0.0, self.start_rate(p))
        end_flags = (0.0,) * len(self.ending)
        if not self.sticks:
            return stacked(first, *((0.0, SLIP) if self.entry else ()), *end_flags)
        # A share without speed sticks, unless the mount force already exceeds what holds it.
        speed = 0.0 if self.start == "rest" else self.start_speed(p)
        pulled = self.start_force(p) + self.pull(p, 0.0, self.start_rate(p))
        held = pulled < self.hold(p, -self.start_deflection(p))
        return stacked(first, 0.0, where(speed > 0.0, SLIP, where(held, STICK, SLIP)), *end_flags)

    def hold(self, p: Parameters, travel: Expression) -> Expression:
        """Return the mount force [N] at which a sticking share at a travel L [m] breaks loose: see `StickSlip`."""
        force = p["static"]
        for term in self.terms:
            force = term.hold(force, Place(travel, 0.0), p)
        return force

    def pull(self, p: Parameters, deflection: Expression, rate: Expression) -> Expression:
        """Return the mount force [N] at a deflection [m] and its rate [m/s], or its change for changes of both."""
        return sum((term.pull(p, rate) for term in self.terms), p["stiffness"] * deflection)

    def inertia_at(self, p: Parameters, travel: Expression) -> Expression:
        """Return the moving mass [kg] at a travel L [m]: the share and the soil that it carries along."""
        return p["mass"] + self.carried_mass(p, travel) if self.events else p["inertia"]

    def carried_mass(self, p: Parameters, travel: Expression) -> Expression:
        """Return the added mass of soil [kg] at a travel L [m], in a structure with events."""
        mass = p["added_mass"]
        for term in self.terms:
            mass = term.carry(mass, p, travel)
        return mass if self.carries else 0.0

    def outputs(self, p: Parameters, time: Column, state: Sequence[Column]) -> tuple[Column, ...]:
        """Return what a run reports at its output times.

        Args:
            p: parameters by name, with "added_mass".
            time: output times [s].
            state: a column of these times for each state of `Equation`.

        Returns:
            Mount force [N], soil resistance with the inertia of the soil carried along [N], deflection [m], speed [m/s]
            and travel [m] of the share, opening [m], and mode.
        """
        if self.entry:
            p = {**p, "behind": state[2], "entered": state[4]}
        w, rate = state[:2]
        mount, initial_speed = self.strut(p, time), self.start_speed(p)
        gain = mount.gain - rate
        first = self.start_force(p)
        ahead, faster = self.lead(p, time)
        behind = first / p["stiffness"] + w
        deflection, travel = behind + ahead, mount.path - behind
        force = first + self.pull(p, w + ahead, rate + faster)
        soil = self.resistance(p, travel, initial_speed + gain)
        acceleration = (force - soil) / self.inertia_at(p, travel)
        soil = soil + (self.carried_mass(p, travel) if self.events else p["added_mass"]) * acceleration
        speed, opening = initial_speed + gain, 0.0 * w + 0.0
        mode = opening
        if self.sticks:
            opening, mode = state[2:4]
            if not is_casadi(mode):
                # An implicit method solves for the mode too, which leaves rounding errors in it.
                mode = np.round(mode)
            speed, soil = by_mode(mode, speed, 0.0, speed), by_mode(mode, soil, force, 0.0)
        return force, soil, deflection, speed, travel, opening, mode

    def averages(self, p: Parameters, means: Column, variances: Column) -> tuple[Column, ...]:
        """Return the averages of a run.

        Args:
            p: parameters by name.
            means: means of the signals of `Equation`.
            variances: mean squares about the mean of those signals that have an RMS.

        Returns:
            Mean and RMS of the mount force [N], mean and RMS of the deflection [m], tow power [W].
        """
        first, spring = self.start_force(p), p["stiffness"]
        stiffness = abs(spring)  # a repelling spring has a negative one
        # Only an expression is smoothed, on the scale of the steady resistance.
        scale = self.steady_resistance(p, p["tow_speed"]) if is_casadi(variances) else 0.0
        displacement_rms = rms(variances[0], scale / stiffness)
        if self.damper:
            mean_draft = first + self.pull(p, 0.0, self.start_rate(p)) + means[1]
            force_rms = rms(variances[1], scale)
        else:
            mean_draft = first + spring * means[0]
            force_rms = stiffness * displacement_rms
        tow_power = means[-1] if self.accelerates else mean_draft * p["tow_speed"]
        return mean_draft, force_rms, first / spring + means[0], displacement_rms, tow_power


def parameters(scene: Towed) -> dict[str, Expression]:
    """Return the parameters that the equation of motion may need, by name, in SI units."""
    structure = Structure.of(scene)
    with unlabelled():  # a design checks a run together with its scene
        inertia, reaction = scene.inertia, scene.reaction
        values = {
            "inertia": inertia,
            "stiffness": scene.restoring_stiffness,
            "static": reaction.static,
            "tow_speed": scene.tow_speed,
            "added_mass": reaction.added_mass,
        }
        if structure.events:
            values["mass"] = scene.mass
        for term in structure.terms:
            values |= term.values(scene)
    return values


# Points per shortest wavelength at which the strength is evaluated; a minimum between them is lower by at most 1e-3.
_POINTS = 64
_MOST_POINTS = 1_000_000


def check_strength(waves: Sequence[StrengthWave], path: tuple[float, float] | None = None) -> None:
    """Raise DomainError if waves together make the soil's strength negative; the message gives the place.

    Args:
        waves: the strength waves; symbolic amplitudes are not checked.
        path: start and end [m] of the share's path, if known; otherwise the sum of the amplitudes must not exceed 1.
    """
    if len(waves) < 2 or any(is_symbolic(wave.amplitude) for wave in waves):
        return
    total = float(np.max(sum(as_number(wave.amplitude) for wave in waves)))
    # Amplitudes of records and files have fewer digits than this.
    if total <= 1.0 + 1e-9:
        return
    if path is None:
        raise DomainError(
            f"the sum of the strength waves' amplitudes is {total:.6g} and must be at most 1 if the path is not known:"
            " soil cannot push the share forward"
        )
    numbers = [[float(as_number(x)) for x in (w.amplitude, w.wavelength, w.phase)] for w in waves]
    count = (path[1] - path[0]) / min(length for _, length, _ in numbers) * _POINTS
    travel = np.linspace(*path, int(min(count, _MOST_POINTS)) + 2)
    sines = [size * np.sin(2.0 * math.pi * travel / length + shift) for size, length, shift in numbers]
    strength = 1.0 + np.sum(sines, axis=0)
    least = int(np.argmin(strength))
    if strength[least] < 0.0:
        raise DomainError(
            f"the strength waves change the soil's strength by a factor of {strength[least]:.4g} at a travel of"
            f" {travel[least]:.4g} m, which must be at least 0: soil cannot push the share forward; reduce an amplitude"
        )


def lightest_mass(p: Parameters) -> Any:
    """Return the least moving mass [kg]: under events the share alone, as in a gap, otherwise the constant inertia."""
    return p["mass"] if "mass" in p else p["inertia"]


SLIP: Final = 0.0
STICK: Final = 1.0
GAP: Final = 2.0

# A negligible force [N], which keeps the sizes of a scene without forces above zero.
_LEAST_FORCE = 1e-9


def by_mode(mode: Column, slip: Expression, stick: Expression, gap: Expression) -> Any:
    """Return the value that belongs to a mode, which an integrator may have rounded."""
    return where(mode < (SLIP + STICK) / 2.0, slip, where(mode < (STICK + GAP) / 2.0, stick, gap))


Symbols = TypeVar("Symbols", ca.SX, ca.MX)


@dataclass(frozen=True, eq=False)
class Equation:
    """Equation of motion of a structure, with the signals whose time averages a run reports, as CasADi Functions.

    Their arguments are the time [s], the state, and a column of the parameters that the equation uses.

    Attributes:
        structure: the terms that are on.
        names: names of the parameters, in order.
        rate: (time, state, parameters) -> rate of the state.
        events: (time, state, parameters) -> (values, a row for each event, that become negative at the event; the state
            after each event, a column each); None without events.
        start: parameters -> state at time 0.
        signals: (time, state, parameters) -> the change of deflection; with a damper, the change of mount force; if the
            strut's speed varies, the tow power P s'. Without a damper the mount force is k0 z.
        count: number of signals.
        squared: number of signals, from the first, that have an RMS too.
    """

    structure: Structure
    names: tuple[str, ...]
    rate: ca.Function
    events: ca.Function | None
    start: ca.Function
    signals: ca.Function
    count: int
    squared: int

    @cached_property
    def outputs(self) -> tuple[tuple[str, ...], ca.Function]:
        """Names of parameters, and (column of time and state, the latter) -> the first five of `Structure.outputs`."""
        symbols = {name: ca.SX.sym(name) for name in self.structure.names}
        given = ca.SX.sym("given", 1 + self.states)
        time, *state = ca.vertsplit(given)
        found = ca.vertcat(*self.structure.outputs(symbols, time, state)[:5])
        used = {symbol.name() for symbol in ca.symvar(found)}
        names = tuple(name for name in self.structure.names if name in used)
        return names, ca.Function("outputs", [given, stacked(*(symbols[name] for name in names))], [ca.cse(found)])

    @cached_property
    def sizes(self) -> ca.Function:
        """Parameters with the duration last -> sizes to expect in a run, to which tolerances can be relative.

        The result is a column of the sizes of w [m] and w' [m/s], of each of the signals, and of the RMS of those that
        have one.
        """
        column, p = self.symbols(ca.MX)
        structure, complete = self.structure, dict.fromkeys(self.structure.names, 0.0) | p
        speed, stiffness = complete["tow_speed"], abs(p["stiffness"])  # a repelling spring has a negative one
        hardness = sqrt(stiffness * lightest_mass(p))
        force = structure.start_resistance(complete) + speed * hardness + _LEAST_FORCE
        if structure.relaxed and structure.sticks:
            # The resistance may be far greater than the force that the relaxed spring reaches.
            force = minimum(force, speed * (stiffness * column[-1] + hardness) + _LEAST_FORCE)
        deflection, rate = force / stiffness, force / hardness
        squared, others = [deflection], []
        if structure.damper:
            squared.append(force + structure.pull(p, 0.0, rate))
        if structure.accelerates:
            others.append(force * (speed + rate))
        return ca.Function("sizes", [column], [stacked(deflection, rate, *squared, *others, *squared)])

    @cached_property
    def sliding(self) -> ca.Function:
        """Resistance to a share that slides steadily at the strut's initial speed, as a Function.

        It is (travel, parameters with the duration last) -> (change since the start [N], slope by the speed [N s/m]).
        """
        travel, gain, (p, known) = ca.SX.sym("travel"), ca.SX.sym("gain"), self.symbols(ca.SX)
        change: Column = self.structure.resistance_change(known, travel, gain)
        force = ca.SX(change)
        both = (ca.densify(ca.substitute(one, gain, 0.0)) for one in (force, ca.jacobian(force, gain)))
        return ca.Function("sliding", [travel, p], list(both))

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.rate.numel_out(0))

    @property
    def averages(self) -> int:
        """Number of averages of a run: the means of all signals, and the mean squares of those that have an RMS."""
        return self.count + self.squared

    def column(self, p: Parameters, duration: Expression) -> list[Any]:
        """Return the parameters of an integration, the duration [s] last, from parameters by name."""
        return [*(p[name] for name in self.names), duration]

    def symbols(self, kind: type[Symbols]) -> tuple[Symbols, dict[str, Expression]]:
        """Return a column of symbols for the parameters and, last, the duration; and the parameters by name."""
        p = kind.sym("p", len(self.names) + 1)
        return p, self.named(p)

    def named(self, p: Column) -> dict[str, Expression]:
        """Return the parameters by name, from a column that has the duration as its last element."""
        values: list[Column] = ca.vertsplit(p[:-1])
        return dict(zip(self.names, values, strict=True))


class OfEquation:
    """What has an equation of motion, and passes on its structure and the names of its parameters."""

    equation: Equation

    @property
    def structure(self) -> Structure:
        """Terms that are on."""
        return self.equation.structure

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the equation's parameters, without the duration."""
        return self.equation.names


class _SymbolicShare:
    """State of the share as symbols, and expressions that follow from it.

    Attributes:
        speed: L' [m/s].
        stopping: speed [m/s] that becomes negative when the share stops, but not by rounding at the start.
        mount_force: P [N].
        slipping: w'' of a slipping share [m/s^2].
    """

    def __init__(self, structure: Structure, p: dict[str, ca.SX]) -> None:
        """Create the symbols of a structure's state."""
        self.time = ca.SX.sym("time")
        self.w, self.rate = ca.SX.sym("w"), ca.SX.sym("rate")
        self.opening, self.mode = ca.SX.sym("opening"), ca.SX.sym("mode")
        modes = (self.opening, self.mode) if structure.events else ()
        ended = {term.state: ca.SX.sym(term.state) for term in structure.ending}
        self.state = stacked(self.w, self.rate, *modes, *ended.values())
        self.structure = structure
        self.p = p | ended | ({"behind": self.opening} if structure.entry else {})
        self.strut = structure.strut(self.p, self.time)
        self.travel = self.strut.path - structure.start_deflection(p) - self.w
        self.strut_speed = structure.start_speed(self.p) + self.strut.gain
        self.speed = self.strut_speed - self.rate
        # A speed below this fraction of the tow speed is rounding of the difference between strut's and spring's speed.
        self.stopping = self.speed + 1e-12 * self.p["tow_speed"]
        self.ahead, self.faster = structure.lead(self.p, self.time)
        change = structure.pull(self.p, self.w + self.ahead, self.rate + self.faster)
        self.mount_force = structure.start_force(self.p) + change
        if structure.relaxed:
            soil = structure.resistance(self.p, self.travel, self.speed)
        else:
            soil = structure.resistance_change(self.p, self.travel, self.strut.gain - self.rate)
        acceleration = (soil - change) / structure.inertia_at(self.p, self.travel)
        self.slipping = acceleration + self.strut.acceleration if structure.ramp else acceleration

    def signals(self) -> list[Expression]:
        """Return the signals of an `Equation`."""
        structure = self.structure
        w, rate = self.w + self.ahead, self.rate + self.faster
        force = structure.pull(self.p, w, rate - structure.start_rate(self.p))
        values: list[Expression] = [w, force] if structure.damper else [w]
        if structure.accelerates:
            values.append(self.mount_force * (self.strut_speed + self.faster))
        return values

    def by_mode(self, slip: Column, stick: Column, gap: Column) -> Column:
        """Return the column that belongs to the mode, chosen element by element."""
        columns = (ca.vertsplit(ca.densify(ca.SX(x))) for x in (slip, stick, gap))
        return stacked(*(by_mode(self.mode, *row) for row in zip(*columns, strict=True)))


def _stick_slip(share: _SymbolicShare) -> tuple[Column, list[Column], list[Column]]:
    """Return the rate of the four states, the value that becomes negative when the mode ends, and the state after."""
    p, mass = share.p, share.p["mass"]
    breakaway = share.structure.hold(p, share.travel)
    slip = stacked(share.rate, share.slipping, 0.0, 0.0)
    stick = stacked(share.strut_speed, share.strut.acceleration, 0.0, 0.0)
    gap = stacked(share.rate, share.strut.acceleration - share.mount_force / mass, -share.speed, 0.0)
    # While the share sticks the strut only compresses the mount, so P cannot fall to 0.
    until = share.by_mode(share.stopping, breakaway - share.mount_force, share.opening)
    stopped = where(share.mount_force < 0.0, GAP, where(share.mount_force <= breakaway, STICK, SLIP))
    speed_with_soil = share.speed * mass / (mass + share.structure.carried_mass(p, share.travel))
    rate = share.by_mode(share.strut_speed, share.strut_speed, share.strut_speed - speed_with_soil)
    after = stacked(share.w, rate, 0.0, share.by_mode(stopped, SLIP, SLIP))
    return share.by_mode(slip, stick, gap), [until], [after]


def _entering(share: _SymbolicShare) -> tuple[Column, list[Column], list[Column]]:
    """Return the same as `_stick_slip` for a share that enters and stays in contact.

    It may turn back. The mode GAP then marks that it is behind its furthest point.
    """
    behind = share.mode > STICK
    rates = stacked(share.rate, share.slipping, where(behind, -share.speed, 0.0), 0.0)
    turning = where(share.p["entered"] < 0.5, where(behind, share.opening, share.stopping), 1.0)
    after = stacked(share.w, share.rate, 0.0, where(behind, SLIP, GAP))
    return rates, [turning], [after]


@lru_cache(maxsize=64)
def equation_of(structure: Structure) -> Equation:
    """Build the equation of motion of a structure from the terms that are on."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    share = _SymbolicShare(structure, symbols)
    if structure.sticks:
        rates, zeros, after = _stick_slip(share)
    elif structure.entry:
        rates, zeros, after = _entering(share)
    else:
        rates, zeros, after = stacked(share.rate, share.slipping), [], []
    end_flags = share.state[4 if structure.events else 2 :]
    rates, after = stacked(rates, ca.SX.zeros(end_flags.numel())), [stacked(state, end_flags) for state in after]
    for term, ended in zip(structure.ending, ca.vertsplit(end_flags), strict=True):
        zeros.append(where(ended < 0.5, term.until(share.p, share.time, share.travel), 1.0))
        after.append(ca.substitute(share.state, ended, 1.0))
    values, first = share.signals(), structure.start_state(symbols)
    observed = stacked(*values)
    used = {symbol.name() for symbol in ca.symvar(stacked(rates, *zeros, *after, observed, first))}
    names = tuple(name for name in structure.names if name in used)
    p = stacked(*(symbols[name] for name in names))
    inputs, labels = [share.time, share.state, p], ["time", "state", "parameters"]
    return Equation(
        structure=structure,
        names=names,
        rate=ca.Function("rate", inputs, [rates], labels, ["rate"]),
        events=ca.Function("events", inputs, [stacked(*zeros), ca.horzcat(*after)], labels, ["zero", "after"])
        if zeros
        else None,
        start=ca.Function("start", [p], [ca.densify(ca.SX(first))], ["parameters"], ["state"]),
        signals=ca.Function("signals", inputs, [observed], labels, ["signals"]),
        count=len(values),
        squared=2 if structure.damper else 1,
    )
