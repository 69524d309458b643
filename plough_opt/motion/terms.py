"""Terms of the equation of motion (27) in the spring deflection, each there only if a scene contains it.

With z = s(t) - L the spring's deflection, z0 its value at the start and w = z - z0,

    M w'' = F(L, L') - k0 z0 - k0 w - c w' + M s''

is written in deviations from the start, so that at an equilibrium start the large steady forces cancel
on paper and not in floating point. As printed, with + k0 (L - V0 t), the spring repels: the parameter "stiffness"
is then -k0, the equilibrium lies at z = -F/k0, and a deviation from it grows like exp(sqrt(k0/M) t).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from plough_opt.core.expressions import Expression, as_number, is_symbolic, maximum, minimum, sin, template_of, where
from plough_opt.core.labels import unlabelled
from plough_opt.motion.effects import HarmonicBalance, Smooth, StickSlip
from plough_opt.motion.own import OwnTerm
from plough_opt.motion.scene import Scene
from plough_opt.soil.waves import StrengthWave

# Differences of travel [m] and speed [m/s] by which slopes that only choose steps are measured.
_DIFFERENCE = 1e-4
# Time [s] in which no mount moves: forces change by 1e-11 of themselves or so.
_SHORTEST_RAMP = 1e-9

PARAMETERS = (
    "inertia",
    "stiffness",
    "static",
    "drag",
    "tow_speed",
    "wave_amplitude",
    "wavelength",
    "ramp_time",
    "damping",
    "rate_term",
    "width",
    "breakaway",
    "height",
    "mass",
    "added_mass",
)
"""Names of everything that a term may need, in the order in which an equation takes what it uses."""


@dataclass(frozen=True)
class Structure:
    """What a scene's equation of motion contains, apart from numbers: scenes alike in this share one graph."""

    drag: bool
    rate: bool
    waves: int
    ramp: bool
    damper: bool
    start: Literal["equilibrium", "rest", "towed"]
    contact: Literal["resisting", "smooth", "stick_slip"]
    entry: bool
    carries: bool
    orbit: Literal["transient", "periodic", "linearised", "harmonic_balance"] = "transient"
    harmonics: int = 0
    own: tuple[OwnTerm, ...] = ()
    tells_ramp: bool = False
    locates_ramp: bool = False
    phased: bool = False
    turns: tuple[int, ...] = ()

    @classmethod
    def of(cls, scene: Scene) -> Structure:
        """Read the structure off a scene."""
        effects = scene.effects
        laws: dict[type, Literal["smooth", "stick_slip"]] = {Smooth: "smooth", StickSlip: "stick_slip"}
        return cls(
            drag=effects.inertial_drag,
            rate=effects.rate_term is not None,
            waves=len(effects.waves),
            phased=is_phased(effects.waves),
            turns=effects.turns if effects.orbit != "transient" and len(effects.waves) > 1 else (),
            ramp=effects.ramps,
            damper=effects.damping is not None,
            start=effects.start,
            contact=laws.get(type(effects.contact), "resisting"),
            entry=effects.entry,
            carries=effects.added_mass and effects.events,
            orbit="harmonic_balance" if isinstance(effects.orbit, HarmonicBalance) else effects.orbit,
            harmonics=effects.orbit.harmonics if isinstance(effects.orbit, HarmonicBalance) else 0,
            own=tuple(map(OwnTerm.of, effects.own)),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of everything that its terms may need, in order."""
        told = ("ramped",) if self.tells_ramp else ()
        waves = (name for k in range(self.waves) for name in wave_names(k) if name not in PARAMETERS)
        return (*PARAMETERS, *waves, *(name for k, term in enumerate(self.own) for name in term.names(k)), *told)

    @property
    def wave(self) -> bool:
        """Whether the soil's strength varies along the path."""
        return self.waves > 0

    @property
    def relaxed(self) -> bool:
        """Whether the spring is relaxed at the start."""
        return self.start != "equilibrium"

    @property
    def kinked(self) -> bool:
        """Whether the equation is not smooth where a share may come, so that steps of order 8 lose their order."""
        return self.entry or self.contact != "resisting"

    @property
    def stepped(self) -> bool:
        """Whether steps of order 8 from a start can follow the motion."""
        return self.orbit == "transient" and not self.events

    @property
    def events(self) -> bool:
        """Whether an integrator must find events."""
        return self.entry or self.contact == "stick_slip"

    @property
    def ends_ramp(self) -> bool:
        """Whether an integrator must find the end of the strut's ramp."""
        return self.ramp and (self.events or self.locates_ramp)


def parameters(scene: Scene) -> dict[str, Expression]:
    """Return the numbers that the equation of motion may need, by name, in SI units."""
    effects = scene.effects
    with unlabelled():  # a run is checked with its scene
        inertia, reaction = scene.inertia, scene.reaction
    values = {
        "inertia": inertia,
        "stiffness": scene.restoring_stiffness,
        "static": reaction.static,
        "tow_speed": scene.tow_speed,
    }
    if effects.inertial_drag:
        values["drag"] = reaction.drag
    for k, wave in enumerate(effects.waves):
        amplitude, length, phase = wave_names(k)
        values |= {amplitude: wave.amplitude, length: wave.wavelength}
        if is_phased(effects.waves):
            values[phase] = wave.phase
    if effects.ramps:
        values["ramp_time"] = effects.tow_ramp
    if effects.damping is not None:
        values["damping"] = effects.damping
    if effects.rate_term is not None:
        values["rate_term"] = effects.rate_term
    for k, effect in enumerate(effects.own):
        values |= {f"own_{k}_{j}": value for j, value in enumerate(template_of(effect)[1])}
    if isinstance(effects.contact, Smooth):
        values["width"] = effects.contact.width
    if isinstance(effects.contact, StickSlip):
        values["breakaway"] = effects.contact.breakaway
    if effects.entry:
        values["height"] = scene.cone.height
    if effects.events:
        values["mass"] = scene.mass
        if effects.added_mass:
            values["added_mass"] = reaction.added_mass
    return values


@dataclass(frozen=True)
class Strut:
    """Path s [m], speed gained since the start s' - s'(0) [m/s] and acceleration s'' [m/s^2] of the strut."""

    path: Expression
    gain: Expression
    acceleration: Expression


def strut(structure: Structure, p: dict[str, Expression], time: Expression) -> Strut:
    """Return the strut's motion: constant speed, or a ramp by 6u^5 - 15u^4 + 10u^3 with u = t/t_r.

    Where events interrupt the motion the state ``ramped`` ends the ramp: the step that finds its end goes beyond it,
    and its stages there must not see another motion yet.
    """
    speed = p["tow_speed"]
    if not structure.ramp:
        return Strut(path=speed * time, gain=0.0, acceleration=0.0)
    ramp = ramp_time(p)
    u = where(p["ramped"] > 0.5, 1.0, time / ramp) if "ramped" in p else minimum(time / ramp, 1.0)
    return Strut(
        path=speed * (ramp * u**4 * (2.5 + u * (u - 3.0)) + (time - ramp * u)),
        gain=speed * u**3 * (10.0 + u * (6.0 * u - 15.0)),
        acceleration=speed / ramp * 30.0 * u**2 * (1.0 - u) ** 2,
    )


def ramp_time(p: Mapping[str, Any]) -> Any:
    """Return the time of the strut's ramp [s]: of one that symbols make 0, one so short that it changes nothing."""
    time = p["ramp_time"]
    return where(time > 0.0, time, time + _SHORTEST_RAMP)


def start_speed(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the strut's speed at time 0 [m/s]: the speed to which the steady state at the start belongs."""
    return 0.0 if structure.ramp else p["tow_speed"]


def start_resistance(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the steady resistance at the strut's initial speed [N], without the wave."""
    u0, force = start_speed(structure, p), _steady(structure, p)
    soil = _step(p, u0) * force if structure.contact == "smooth" else force
    return soil + own_force(structure, p, 0.0, u0) if structure.own else soil


def own_force(structure: Structure, p: dict[str, Expression], travel: Expression, speed: Expression) -> Expression:
    """Return the sum of the user's own resistances [N]."""
    return sum(term.force(k, p, travel, speed) for k, term in enumerate(structure.own))


def own_slopes(scene: Scene) -> tuple[float, float]:
    """Return the steepest slopes of own resistances by travel [N/m] and by speed [N s/m], at rest and at tow speed."""
    structure, p = Structure.of(scene), parameters(scene)
    steepest = [0.0, 0.0]
    for speed in (0.0, float(as_number(p["tow_speed"]))):
        for k, (dx, dv) in enumerate(((_DIFFERENCE, 0.0), (0.0, _DIFFERENCE))):
            with np.errstate(all="ignore"):
                ahead, behind = (own_force(structure, p, s * dx, speed + s * dv) for s in (1.0, -1.0))
            slope = abs(float(as_number(ahead - behind))) / (2.0 * _DIFFERENCE)
            if math.isfinite(slope):
                steepest[k] = max(steepest[k], slope)
    return steepest[0], steepest[1]


def _steady(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the steady resistance of a wholly buried share that slips at the strut's initial speed [N]."""
    u0 = start_speed(structure, p)
    force = p["static"]
    if structure.rate:
        force = force * (1.0 + p["rate_term"] * u0**2)
    if structure.drag:
        force = force + p["drag"] * u0**2
    return force


def start_deflection(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return z0 [m]: steady deflection, or zero from rest."""
    return 0.0 if structure.relaxed else start_resistance(structure, p) / p["stiffness"]


def start_rate(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return z' at time 0 [m/s]: a share at rest under a moving strut has z' = V0."""
    return start_speed(structure, p) if structure.start == "rest" else 0.0


def resistance(structure: Structure, p: dict[str, Expression], travel: Expression, speed: Expression) -> Expression:
    """Return the resistance [N], the added mass's part excepted: to all its digits, however small it is.

    Args:
        structure: the terms that are on.
        p: parameters by name.
        travel: L of the share [m].
        speed: L' of the share [m/s].
    """
    force = _of_soil(structure, p, travel, speed)
    return force + own_force(structure, p, travel, speed) if structure.own else force


def hold(structure: Structure, p: dict[str, Expression], travel: Expression) -> Expression:
    """Return the mount force [N] at which a share that sticks at a travel L [m] moves: see `StickSlip`."""
    force = p["breakaway"] * _of_soil(structure, p, travel, 0.0)
    return force + sum(term.at_rest(k, p, travel) for k, term in enumerate(structure.own)) if structure.own else force


def _of_soil(structure: Structure, p: dict[str, Expression], travel: Expression, speed: Expression) -> Expression:
    """Return the part of the soil itself in the resistance."""
    force = p["static"]
    if structure.wave:
        force = force + _wave(structure, p, travel)
    if structure.rate:
        force = force * (1.0 + p["rate_term"] * speed**2)
    if structure.drag:
        force = force + p["drag"] * speed**2
    if structure.entry:
        force = buried(structure, p, travel) ** 2 * force
    if structure.contact == "smooth":
        force = _step(p, speed) * force
    return force


def resistance_change(
    structure: Structure, p: dict[str, Expression], travel: Expression, gain: Expression
) -> Expression:
    """Return how far the resistance is from the steady one of an equilibrium start [N]: see `resistance`.

    Args:
        structure: the terms that are on; a share that starts at equilibrium does not enter.
        p: parameters by name.
        travel: L of the share [m].
        gain: L' - s'(0), the share's speed above the strut's initial speed [m/s].
    """
    u0 = start_speed(structure, p)
    change: Expression = 0.0
    if structure.rate or structure.drag:
        factor = (p["static"] * p["rate_term"] if structure.rate else 0.0) + (p["drag"] if structure.drag else 0.0)
        change = factor * gain * (2.0 * u0 + gain)
    if structure.wave:
        wave = _wave(structure, p, travel)
        if structure.rate:
            wave = wave * (1.0 + p["rate_term"] * (u0 + gain) ** 2)
        change = change + wave
    if structure.contact == "smooth":
        step, first = _step(p, u0 + gain), _step(p, u0)
        change = step * change + (step - first) * _steady(structure, p)
    if structure.own:
        change = change + own_force(structure, p, travel, u0 + gain) - own_force(structure, p, 0.0, u0)
    return change


def _wave(structure: Structure, p: dict[str, Expression], travel: Expression) -> Expression:
    """Return the periodic part of the static resistance [N].

    On an orbit under several waves all lengths follow from the first one's, so that they stay commensurate.
    """
    total: Expression = 0.0
    for k in range(structure.waves):
        amplitude, length, phase = wave_names(k)
        turn = 2.0 * math.pi / p[length]
        if structure.turns:
            turn = 2.0 * math.pi * structure.turns[k] / repeat_length(structure, p)
        angle = turn * travel + p[phase] if structure.phased else turn * travel
        total = total + p["static"] * p[amplitude] * sin(angle)
    return total


def repeat_length(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the length [m] after which the soil of an orbit repeats itself."""
    return p["wavelength"] * structure.turns[0] if structure.turns else p["wavelength"]


def is_phased(waves: Sequence[StrengthWave]) -> bool:
    """Return whether any strength wave has a phase."""
    return any(is_symbolic(wave.phase) or bool(np.any(as_number(wave.phase) != 0.0)) for wave in waves)


def wave_names(k: int) -> tuple[str, str, str]:
    """Return the names of amplitude, wavelength and phase of a strength wave, counted from 0."""
    number = "" if k == 0 else f"_{k + 1}"
    return f"wave_amplitude{number}", f"wavelength{number}", f"wave_phase{number}"


def buried(structure: Structure, p: dict[str, Expression], travel: Expression) -> Expression:
    """Return the part H/h of the share's height that is in the soil [-], which its furthest travel decides.

    In the differential equation the state ``entered`` decides: rounding of the time at which the share is wholly in
    the soil would else leave the slope of the wrong side.
    """
    if not structure.entry:
        return 1.0
    entering = maximum((travel + p.get("behind", 0.0)) / p["height"], 0.0)
    return where(p["entered"] > 0.5, 1.0, entering) if "entered" in p else minimum(entering, 1.0)


def inertia_at(structure: Structure, p: dict[str, Expression], travel: Expression) -> Expression:
    """Return the mass of the share and of the soil that it carries at a travel L [kg]."""
    if not structure.events:
        return p["inertia"]
    return p["mass"] + carried_mass(structure, p, travel)


def lightest_mass(p: Mapping[str, Any]) -> Any:
    """Return the least mass that moves [kg], by an equation's parameters: in a gap and at first contact that alone."""
    return p["mass"] if "mass" in p else p["inertia"]


def carried_mass(structure: Structure, p: dict[str, Expression], travel: Expression) -> Expression:
    """Return the added mass of soil at a travel L [kg] in a structure with events."""
    return p["added_mass"] * buried(structure, p, travel) ** 3 if structure.carries else 0.0


def _step(p: dict[str, Expression], speed: Expression) -> Expression:
    """Return the smooth step of the share's speed: 0 for a share at rest or retreating, 1 above the width."""
    return Smooth(p["width"]).step(speed)[0]
