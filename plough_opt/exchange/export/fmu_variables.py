"""Variables of an exported share: names, units, domains and orders of magnitude."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import casadi as ca

from plough_opt.core.expressions import Expression, is_quantity, map_expressions, template_of
from plough_opt.core.quantities import EVERY
from plough_opt.exchange.export.fmu_share import Share
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge


@dataclass(frozen=True)
class Variable:
    """A variable of an exported share.

    Attributes:
        name: as in a problem file.
        unit: SI unit, "1" of a pure number, or "" if it is unknown.
        description: in words.
        start: its value, if it has one before the start.
        low: its least value.
        high: its largest value.
        above: whether the least value itself is excluded.
        below: whether the largest value itself is excluded.
        nominal: its order of magnitude; 0 for that of its value.
        shown: unit in which a tool should show it, or "".
        derivative: name of the state whose rate it is, or "".
    """

    name: str
    unit: str
    description: str
    start: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False
    nominal: float = 0.0
    shown: str = ""
    derivative: str = ""

    @property
    def magnitude(self) -> float:
        """Order of magnitude, above 0."""
        return self.nominal or abs(self.start) or 1.0


def parameters_of(named: NamedScene) -> Iterator[Variable]:
    """Yield the parameters of a numeric scene with their values."""
    for name, value in named.values.items():
        one = EVERY[name]
        domain = one.low, one.high, one.above, one.below
        variable = Variable(name, one.unit or "1", one.meaning, float(value), *domain, shown=one.shown)
        if name != "effects.tow_ramp":
            yield variable
        elif named.scene.effects.ramps:  # which a ramp of no time does not
            yield replace(variable, above=True)
    numbers = template_of(_further(named.scene))[1]
    for (name, description), value in zip(_further_names(named.scene).items(), numbers, strict=True):
        yield Variable(name, "", description, float(value))


def _further(scene: Scene) -> tuple[Any, Any]:
    """Return what holds numbers that no registry names: of the soil's density profile, and of own resistances."""
    profile = scene.soil.density_profile
    return () if profile is None else profile.parameters, scene.effects.own


def _further_names(scene: Scene) -> dict[str, str]:
    """Return names of those numbers, of an own resistance its fields' where every number is a field, and meanings."""
    profile, effects = _further(scene)
    names = {f"soil.density_profile.parameters[{k}]": f"number {k} of the density profile" for k in _counted(profile)}
    for k, effect in zip(_counted(effects), effects, strict=True):
        numbers = template_of(effect)[1]
        fields = [f.name for f in dataclasses.fields(effect) if is_quantity(getattr(effect, f.name))]
        if len(fields) != len(numbers) or not all(map(str.isascii, fields)):
            fields = [f"parameters[{j}]" for j in _counted(numbers)]
        names |= {f"effects.own[{k}].{field}": f"{field} of the resistance {type(effect).__name__}" for field in fields}
    return names


def _counted(values: Sequence[object]) -> range:
    return range(1, len(values) + 1)


def scene_with(named: NamedScene, values: Mapping[str, Expression]) -> Scene:
    """Return the scene with a value for each of the parameters of `parameters_of`, by name."""
    names = iter(_further_names(named.scene))
    parameters, own = map_expressions(_further(named.scene), lambda _: values[next(names)], is_quantity)
    scene, _ = named.replaced({name: value for name, value in values.items() if name in EVERY})
    if (profile := scene.soil.density_profile) is not None:
        scene = replace(scene, soil=replace(scene.soil, density_profile=replace(profile, parameters=parameters)))
    return replace(scene, effects=replace(scene.effects, own=own))


def variables_of(share: Share, scene: Scene) -> dict[str, dict[Variable, Expression]]:
    """Return the variables that change in a run with their expressions, by kind.

    Args:
        share: at one moment.
        scene: numeric, from which the orders of magnitude are.
    """
    nominal, by_speed, events = _magnitudes(scene), share.by_speed, share.structure.events

    def variable(name: str, unit: str, description: str, shown: str = "", **more: Any) -> Variable:
        return Variable(name, unit, description, nominal=nominal.get(unit, 0.0), shown=shown, **more)

    travel = variable("travel", "m", "travel L of the share")
    speed = variable("speed", "m/s", "speed L' of the share", "km/h")
    deflection = variable("deflection", "m", "deflection z of the mount's spring, compression positive", "mm")
    place = variable("strut_position", "m", "path s of the strut")
    ramp = ", to which it rises in the time effects.tow_ramp" if share.structure.ramp else ""
    driven = variable("strut_speed", "m/s", f"speed s' of the strut{ramp}", "km/h", start=float(scene.tow_speed))
    travel_rate = variable("der(travel)", "m/s", "rate of the travel", derivative="travel")
    acceleration = variable("der(speed)", "m/s^2", "acceleration L'' of the share", derivative="speed")
    swing = variable("der(deflection)", "m/s", "rate z' of the deflection", derivative="deflection")
    pull = variable("mount_force", "N", "mount force P of spring and damper on the share", "kN")
    resistance = variable("soil_resistance", "N", "resistance F of the soil with its added mass", "kN")
    opening = variable("opening", "m", "how far the share is behind its furthest travel")
    mode = variable("mode", "1", "0: the share slips, 1: it sticks, 2: it is behind its furthest travel")
    furthest = variable("furthest_travel", "m", "furthest travel when the share last turned back")
    buried = variable("buried", "1", "1 once the whole share was in the soil, before that 0")
    event = "negative once an event has happened"
    indicators = {variable(f"event_indicator[{k}]", "", event): one for k, one in enumerate(share.indicators, start=1)}
    return {
        "states": {travel: share.travel, speed: share.speed} | ({deflection: share.deflection} if by_speed else {}),
        "rates": {travel_rate: share.speed, acceleration: share.acceleration}
        | ({swing: share.strut_speed - share.speed} if by_speed else {}),
        "outputs": {pull: share.pull, resistance: share.resistance}
        | ({place: share.travel + share.deflection} if by_speed else {deflection: share.deflection})
        | ({opening: share.opening} if events else {}),
        "indicators": indicators,
        "inputs": {driven if by_speed else place: share.input},
        "discrete": ({mode: share.mode, furthest: share.furthest} if events else {})
        | ({buried: share.entered} if share.structure.entry else {}),
    }


def _magnitudes(scene: Scene) -> dict[str, float]:
    """Return orders of magnitude by unit, all above 0."""
    speed, frequency = float(scene.tow_speed), float(scene.natural_frequency)
    force = abs(float(scene.steady_resistance)) or speed * math.sqrt(scene.stiffness * scene.inertia) or 1.0
    length = force / float(scene.stiffness)
    return {"N": force, "m": length, "m/s": speed or length * frequency, "m/s^2": force / float(scene.inertia)}


def calculated(scene: Scene, symbolic: Scene) -> dict[Variable, ca.SX]:
    """Return the variables that depend on the parameters alone, with expressions of a scene of the symbols of these."""
    gas, carries = not scene.law.lacks("loosened_radius"), not scene.law.lacks("added_mass")
    half_angle = Variable("share.half_angle", "rad", "half angle beta of the equivalent cone", shown="deg")
    radius = Variable("share.loosened_radius", "m", "radius r* of the compaction front at the share's base")
    static = Variable("share.static_resistance", "N", "static resistance F0", shown="kN")
    drag = Variable("share.drag_coefficient", "N*s^2/m^2", "resistance Fd per squared speed")
    carried = Variable("share.added_mass", "kg", "mass m_a of soil that the share carries along")
    found = {}
    for variable, path, present in (
        (half_angle, "cone.half_angle", isinstance(scene.share, Wedge)),
        (radius, "loosened_radius", gas),
        (static, "reaction.static", True),
        (drag, "reaction.drag", scene.effects.inertial_drag),
        (carried, "reaction.added_mass", scene.effects.added_mass and carries),
    ):
        if present:
            value = attrgetter(path)
            found[replace(variable, nominal=abs(float(value(scene))))] = value(symbolic)
    return found
