"""Names, units and orders of magnitude of an exported share's variables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import casadi as ca

from plough_opt.core.expressions import Expression
from plough_opt.exchange.export.fmu_share import Share
from plough_opt.exchange.export.fmu_variables import Variable
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge


@dataclass(frozen=True)
class Names:
    """Variables of an exported share beside its parameters.

    Attributes:
        states: continuous states.
        rates: their rates.
        inputs: speed or position of the strut.
        outputs: the other results.
        indicators: those that change their sign at an event.
        discrete: those that change only at events; empty without events.
    """

    states: tuple[Variable, ...]
    rates: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    indicators: tuple[Variable, ...]
    discrete: tuple[Variable, ...]


def names_of(scene: Scene, share: Share) -> Names:
    """Return the variables of a share, with orders of magnitude from its scene of numbers."""
    by_speed, structure = share.kind == "speed", share.structure
    force, speed, length = _magnitudes(scene)
    place = Variable("strut_position", "m", "path s of the strut", nominal=length)
    deflection = Variable(
        "deflection", "m", "deflection z of the mount's spring, compression positive", nominal=length, shown="mm"
    )
    states = (
        Variable("travel", "m", "travel L of the share", nominal=length),
        Variable("speed", "m/s", "speed L' of the share", nominal=speed, shown="km/h"),
        *((deflection,) if by_speed else ()),
    )
    acceleration = force / float(scene.inertia)
    rates = (
        Variable("der(travel)", "m/s", "rate of the travel", nominal=speed, derivative="travel"),
        Variable("der(speed)", "m/s2", "acceleration L'' of the share", nominal=acceleration, derivative="speed"),
        Variable("der(deflection)", "m/s", "rate z' of the deflection", nominal=speed, derivative="deflection"),
    )
    ramp = ", to which it rises in the time effects.tow_ramp" if structure.ramp else ""
    driven = Variable("strut_speed", "m/s", f"speed s' of the strut{ramp}", float(scene.tow_speed), shown="km/h")
    opening = Variable("opening", "m", "how far the share is behind its furthest travel", nominal=length)
    outputs = (
        Variable("mount_force", "N", "mount force P of spring and damper on the share", nominal=force, shown="kN"),
        Variable("soil_resistance", "N", "resistance F of the soil with its added mass", nominal=force, shown="kN"),
        place if by_speed else deflection,
        *((opening,) if structure.events else ()),
    )
    indicator = "negative once an event has happened"
    discrete = (
        Variable("mode", "1", "0: the share slips, 1: it sticks, 2: it is behind its furthest travel"),
        Variable("furthest_travel", "m", "furthest travel when the share last turned back", nominal=length),
        Variable("buried", "1", "1 once the whole share was in the soil, before that 0"),
    )
    return Names(
        states=states,
        rates=rates[: len(states)],
        inputs=(driven if by_speed else place,),
        outputs=outputs,
        indicators=tuple(Variable(f"event_indicator[{k + 1}]", "", indicator) for k in range(share.indicators.numel())),
        discrete=discrete[: share.d.numel()],
    )


def _magnitudes(scene: Scene) -> tuple[float, float, float]:
    """Return a force [N], a speed [m/s] and a length [m], all above 0."""
    speed, frequency = float(scene.tow_speed), float(scene.natural_frequency)
    force = abs(float(scene.steady_resistance)) or speed * math.sqrt(scene.stiffness * scene.inertia) or 1.0
    length = force / float(scene.stiffness)
    return force, speed or length * frequency, length


def calculated(scene: Scene, symbolic: Scene) -> Iterator[tuple[Variable, ca.SX]]:
    """Yield the variables that depend on the parameters alone, and their values as expressions of the symbols."""
    half_angle = Variable("share.half_angle", "rad", "half angle beta of the equivalent cone", shown="deg")
    radius = Variable("share.loosened_radius", "m", "radius r* of the compaction front at the share's base")
    static = Variable("share.static_resistance", "N", "static resistance F0", shown="kN")
    drag = Variable("share.drag_coefficient", "N.s2/m2", "resistance Fd per squared speed")
    carried = Variable("share.added_mass", "kg", "mass m_a of soil that the share carries along")
    offered: tuple[tuple[bool, Variable, Callable[[Scene], Expression]], ...] = (
        (isinstance(scene.share, Wedge), half_angle, lambda s: s.cone.half_angle),
        (not scene.law.lacks("loosened_radius"), radius, lambda s: s.loosened_radius),
        (True, static, lambda s: s.reaction.static),
        (scene.effects.inertial_drag, drag, lambda s: s.reaction.drag),
        (scene.effects.added_mass and not scene.law.lacks("added_mass"), carried, lambda s: s.reaction.added_mass),
    )
    for present, variable, value in offered:
        if present:
            yield replace(variable, nominal=abs(float(value(scene)))), value(symbolic)
