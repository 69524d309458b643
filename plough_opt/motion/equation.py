"""Equation of motion (27) in the spring deflection, assembled from the terms that a scene contains.

With z = s(t) - L the spring's deflection, z0 its value at the start and w = z - z0,

    M w'' = F(L, L') - k0 z0 - k0 w - c w' + M s''

is written in deviations from the start, so that at an equilibrium start the large steady forces cancel
on paper and not in floating point. As printed, with + k0 (L - V0 t), the spring repels: the parameter "stiffness"
is then -k0, the equilibrium lies at z = -F/k0, and a deviation from it grows like exp(sqrt(k0/M) t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from plough_opt.expressions import Expression, minimum, sin
from plough_opt.scene import Scene


@dataclass(frozen=True)
class Structure:
    """What a scene's equation of motion contains, apart from numbers: scenes alike in this share one graph."""

    drag: bool
    rate: bool
    wave: bool
    ramp: bool
    damper: bool
    rest: bool

    @classmethod
    def of(cls, scene: Scene) -> Structure:
        """Read the structure off a scene."""
        effects = scene.effects
        return cls(
            drag=effects.inertial_drag,
            rate=effects.rate_term is not None,
            wave=effects.strength_wave is not None,
            ramp=effects.ramps,
            damper=effects.damping is not None,
            rest=effects.start == "rest",
        )


def parameters(scene: Scene) -> dict[str, Expression]:
    """Return the numbers that the equation of motion may need, by name, in SI units."""
    effects = scene.effects
    values = {
        "inertia": scene.inertia,
        "stiffness": scene.restoring_stiffness,
        "static": scene.reaction.static,
        "tow_speed": scene.tow_speed,
    }
    if effects.inertial_drag:
        values["drag"] = scene.reaction.drag
    if effects.strength_wave is not None:
        values["wave_amplitude"] = effects.strength_wave.amplitude
        values["wavelength"] = effects.strength_wave.wavelength
    if effects.ramps:
        values["ramp_time"] = effects.tow_ramp
    if effects.damping is not None:
        values["damping"] = effects.damping
    if effects.rate_term is not None:
        values["rate_term"] = effects.rate_term
    return values


@dataclass(frozen=True)
class Strut:
    """Path s [m], speed gained since the start s' - s'(0) [m/s] and acceleration s'' [m/s^2] of the strut."""

    path: Expression
    gain: Expression
    acceleration: Expression


def strut(structure: Structure, p: dict[str, Expression], time: Expression) -> Strut:
    """Return the strut's motion: constant speed, or a ramp by 6u^5 - 15u^4 + 10u^3 with u = t/t_r."""
    speed = p["tow_speed"]
    if not structure.ramp:
        return Strut(path=speed * time, gain=0.0, acceleration=0.0)
    ramp = p["ramp_time"]
    u = minimum(time / ramp, 1.0)
    return Strut(
        path=speed * (ramp * u**4 * (2.5 + u * (u - 3.0)) + (time - ramp * u)),
        gain=speed * u**3 * (10.0 + u * (6.0 * u - 15.0)),
        acceleration=speed / ramp * 30.0 * u**2 * (1.0 - u) ** 2,
    )


def start_speed(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the strut's speed at time 0 [m/s]: the speed to which the steady state at the start belongs."""
    return 0.0 if structure.ramp else p["tow_speed"]


def start_resistance(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return the steady resistance at the strut's initial speed [N], without the wave."""
    u0 = start_speed(structure, p)
    force = p["static"]
    if structure.rate:
        force = force * (1.0 + p["rate_term"] * u0**2)
    if structure.drag:
        force = force + p["drag"] * u0**2
    return force


def start_deflection(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return z0 [m]: steady deflection, or zero from rest."""
    return 0.0 if structure.rest else start_resistance(structure, p) / p["stiffness"]


def start_rate(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return z' at time 0 [m/s]: a share at rest under a moving strut has z' = V0."""
    return start_speed(structure, p) if structure.rest else 0.0


def start_state(structure: Structure, p: dict[str, Expression]) -> Expression:
    """Return (w, w') at time 0 as a column."""
    return ca.vertcat(0.0, start_rate(structure, p))


def resistance_change(
    structure: Structure, p: dict[str, Expression], travel: Expression, gain: Expression
) -> Expression:
    """Return how far the resistance is from the steady one at the start [N], the added mass's part excepted.

    Args:
        structure: the terms that are on.
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
        wave = p["static"] * p["wave_amplitude"] * sin(2.0 * math.pi / p["wavelength"] * travel)
        if structure.rate:
            wave = wave * (1.0 + p["rate_term"] * (u0 + gain) ** 2)
        change = change + wave
    return change


@dataclass(frozen=True)
class EquationOfMotion:
    """Right-hand side w', w'' as a CasADi Function, with exactly the parameters that it uses.

    Attributes:
        function: (time [s], state (w [m], w' [m/s]), parameters) -> (w', w'').
        names: names of the parameters, in order.
    """

    function: ca.Function
    names: tuple[str, ...]


@lru_cache(maxsize=64)
def equation_of_motion(structure: Structure) -> EquationOfMotion:
    """Build the differential equation of a structure; terms that are off leave no trace in it."""
    symbols = {name: ca.SX.sym(name) for name in PARAMETERS}
    time, w, rate = ca.SX.sym("time"), ca.SX.sym("w"), ca.SX.sym("rate")
    mount = strut(structure, symbols, time)
    travel = mount.path - start_deflection(structure, symbols) - w
    force = resistance_change(structure, symbols, travel, mount.gain - rate) - symbols["stiffness"] * w
    if structure.rest:
        force = force + start_resistance(structure, symbols)
    if structure.damper:
        force = force - symbols["damping"] * rate
    acceleration = force / symbols["inertia"]
    if structure.ramp:
        acceleration = acceleration + mount.acceleration
    used = {symbol.name() for symbol in ca.symvar(acceleration)} - {"time", "w", "rate"}
    names = tuple(name for name in PARAMETERS if name in used)
    function = ca.Function(
        "equation_of_motion",
        [time, ca.vertcat(w, rate), ca.vertcat(*(symbols[name] for name in names))],
        [ca.vertcat(rate, acceleration)],
        ["time", "state", "parameters"],
        ["rate"],
    )
    return EquationOfMotion(function, names)


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
)
