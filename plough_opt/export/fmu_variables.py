"""Variables of an exported share: what each is called, its unit, its domain, and the scene that it stands for."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from plough_opt.effects import Effects, Smooth, StickSlip, StrengthWave
from plough_opt.errors import InputError
from plough_opt.expressions import Expression, is_quantity, map_expressions, template_of
from plough_opt.geometry import Cone, Wedge
from plough_opt.scene import Scene
from plough_opt.soil import Soil


@dataclass(frozen=True)
class Unit:
    """A unit in SI.

    Attributes:
        base: exponents of its base units.
        shown: units that a tool may show instead, and their factors.
    """

    base: Mapping[str, int]
    shown: Mapping[str, float] = field(default_factory=dict)


UNITS: Final = {
    "s": Unit({"s": 1}),
    "m": Unit({"m": 1}, {"mm": 1e3}),
    "m/s": Unit({"m": 1, "s": -1}, {"km/h": 3.6}),
    "m/s2": Unit({"m": 1, "s": -2}),
    "kg": Unit({"kg": 1}),
    "kg/m3": Unit({"kg": 1, "m": -3}),
    "N": Unit({"kg": 1, "m": 1, "s": -2}, {"kN": 1e-3}),
    "N/m": Unit({"kg": 1, "s": -2}, {"kN/m": 1e-3}),
    "N.s/m": Unit({"kg": 1, "s": -1}),
    "N.s2/m2": Unit({"kg": 1, "m": -1}),
    "Pa": Unit({"kg": 1, "m": -1, "s": -2}, {"kPa": 1e-3}),
    "rad": Unit({"rad": 1}, {"deg": 180.0 / math.pi}),
    "s2/m2": Unit({"s": 2, "m": -2}),
    "1": Unit({}),
}
"""Units of an exported share by name; a display value is the value times the factor."""


@dataclass(frozen=True)
class Variable:
    """A variable of an exported share.

    Attributes:
        name: what it is called, as in a problem file.
        unit: of `UNITS`, or "" where nobody knows it.
        description: what it is.
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


_RIGHT: Final[dict[str, Any]] = {"high": math.pi / 2, "below": True, "shown": "deg"}
_POSITIVE: Final[dict[str, Any]] = {"low": 0.0, "above": True}
_SOIL = (
    Variable("soil.density", "kg/m3", "density rho0 of the undisturbed soil", **_POSITIVE),
    Variable("soil.density_ratio", "1", "undisturbed over locked density b1", **_POSITIVE, high=1.0, below=True),
    Variable("soil.cohesion", "Pa", "cohesion k", low=0.0, shown="kPa"),
    Variable("soil.friction_angle", "rad", "angle of internal friction theta", low=0.0, **_RIGHT),
    Variable("soil.tool_friction", "1", "friction mu0 of soil on metal", low=0.0),
    Variable("soil.ambient_pressure", "Pa", "pressure p_a ahead of the compaction front", low=0.0, shown="kPa"),
)
_WEDGE_ANGLE = Variable("share.wedge_angle", "rad", "wedge angle lambda at the top of the share", **_POSITIVE, **_RIGHT)
_CHISEL_ANGLE = Variable(
    "share.chisel_angle", "rad", "angle beta_pl of the chisel point to the base", low=0.0, **_RIGHT
)
_HALF_ANGLE = Variable("share.half_angle", "rad", "half angle beta of the cone", **_POSITIVE, **_RIGHT)
_HEIGHT = Variable("share.height", "m", "height h of the share", **_POSITIVE)
_STIFFNESS = Variable("scene.stiffness", "N/m", "stiffness k0 of the mount", **_POSITIVE, shown="kN/m")
_MASS = Variable("scene.mass", "kg", "mass m of all that moves but the soil", **_POSITIVE)
_FRAME_MASS = Variable("scene.frame_mass", "kg", "mass of all that moves but the share and the soil", low=0.0)
_STEEL = Variable("scene.steel_density", "kg/m3", "density of the share's material, whose mass moves too", low=0.0)
_TOW_SPEED = Variable("scene.tow_speed", "m/s", "speed V0 of the strut at the start", low=0.0, shown="km/h")
_WAVE = (
    Variable("effects.strength_wave.amplitude", "1", "amplitude epsilon of the soil's strength", low=0.0, high=1.0),
    Variable("effects.strength_wave.wavelength", "m", "wavelength of the soil's strength along the path", **_POSITIVE),
)
_RAMP = Variable("effects.tow_ramp", "s", "time in which the strut's speed rises from 0 to the input", **_POSITIVE)
_DAMPING = Variable("effects.damping", "N.s/m", "viscous damper c in the mount", low=0.0)
_RATE = Variable("effects.rate_term", "s2/m2", "kappa of the static resistance F0 (1 + kappa L'^2)", low=0.0)
_WIDTH = Variable("effects.contact_width", "m/s", "speed of the share above which the soil resists fully", **_POSITIVE)
_BREAKAWAY = Variable(
    "effects.breakaway", "1", "resistance at which a sticking share moves over the static one", low=1.0
)


def parameters_of(scene: Scene, steel_density: float | None) -> list[Variable]:
    """Return the parameters of a scene of numbers with their values.

    Args:
        scene: the scene.
        steel_density: of the share's material [kg/m^3], if its own mass is part of the scene's and follows its shape.

    Raises:
        InputError: a share of that material is heavier than all that moves.
    """
    return [replace(variable, start=float(value)) for variable, value in _offered(scene, steel_density)]


def _offered(scene: Scene, steel_density: float | None) -> Iterator[tuple[Variable, Any]]:
    """Yield every parameter and its value."""
    for variable in _SOIL:
        yield variable, getattr(scene.soil, variable.name.partition(".")[2])
    if scene.soil.density_profile is not None:
        for k, value in enumerate(scene.soil.density_profile.parameters):
            name = f"soil.density_profile.parameters[{k + 1}]"
            yield Variable(name, "", f"number {k + 1} that the density profile needs"), value
    if isinstance(scene.share, Wedge):
        yield _WEDGE_ANGLE, scene.share.angle
        yield _CHISEL_ANGLE, scene.share.chisel_angle
    else:
        yield _HALF_ANGLE, scene.share.half_angle
    yield _HEIGHT, scene.share.height
    yield _STIFFNESS, scene.stiffness
    if steel_density is None:
        yield _MASS, scene.mass
    else:
        yield _FRAME_MASS, _frame_mass(scene, steel_density)
        yield _STEEL, steel_density
    yield _TOW_SPEED, scene.tow_speed
    yield from _effects(scene.effects)


def _effects(effects: Effects) -> Iterator[tuple[Variable, Any]]:
    if effects.strength_wave is not None:
        yield _WAVE[0], effects.strength_wave.amplitude
        yield _WAVE[1], effects.strength_wave.wavelength
    for variable, value in (
        (_RAMP, effects.tow_ramp if effects.ramps else None),
        (_DAMPING, effects.damping),
        (_RATE, effects.rate_term),
        (_WIDTH, effects.contact.width if isinstance(effects.contact, Smooth) else None),
        (_BREAKAWAY, effects.contact.breakaway if isinstance(effects.contact, StickSlip) else None),
    ):
        if value is not None:
            yield variable, value
    for k, effect in enumerate(effects.own):
        for name, value in zip(_own_names(k, effect), template_of(effect)[1], strict=True):
            yield Variable(name, "", f"{name.rpartition('.')[2]} of the resistance {type(effect).__name__}"), value


def _own_names(k: int, effect: Any) -> list[str]:
    """Return a name for every quantity of an own resistance: its field's, where every quantity is a field."""
    fields = [f.name for f in dataclasses.fields(effect) if is_quantity(getattr(effect, f.name)) and f.name.isascii()]
    count = len(template_of(effect)[1])
    names = fields if len(fields) == count else [f"parameters[{j + 1}]" for j in range(count)]
    return [f"effects.own[{k + 1}].{name}" for name in names]


def _frame_mass(scene: Scene, steel_density: float) -> float:
    solid = scene.cone.solid_mass(steel_density)
    # A frame without mass may come out below zero by rounding.
    frame = float(scene.mass - solid)
    if frame < -1e-12 * solid:
        raise InputError(
            f"a share of {steel_density:.6g} kg/m^3 has {solid:.6g} kg, more than the {scene.mass:.6g} kg of all that"
            " moves: give the scene the mass of frame and share together, or leave steel_density out"
        )
    return max(frame, 0.0)


def scene_with(scene: Scene, values: Mapping[str, Expression]) -> Scene:
    """Return the scene with the values of its parameters, by the names of `parameters_of`."""
    share: Wedge | Cone
    if isinstance(scene.share, Wedge):
        share = Wedge(values["share.wedge_angle"], values["share.chisel_angle"], values["share.height"])
        cone = share.equivalent_cone()
    else:
        share = cone = Cone(values["share.half_angle"], values["share.height"])
    if "scene.mass" in values:
        mass = values["scene.mass"]
    else:
        mass = values["scene.frame_mass"] + cone.solid_mass(values["scene.steel_density"])
    return replace(
        scene,
        soil=_soil_with(scene.soil, values),
        share=share,
        stiffness=values["scene.stiffness"],
        mass=mass,
        tow_speed=values["scene.tow_speed"],
        effects=_effects_with(scene.effects, values),
    )


def _soil_with(soil: Soil, values: Mapping[str, Expression]) -> Soil:
    changed: dict[str, Any] = {(name := variable.name.partition(".")[2]): values[f"soil.{name}"] for variable in _SOIL}
    if (profile := soil.density_profile) is not None:
        names = (f"soil.density_profile.parameters[{k + 1}]" for k in range(len(profile.parameters)))
        changed["density_profile"] = replace(profile, parameters=tuple(values[name] for name in names))
    return replace(soil, **changed)


def _effects_with(effects: Effects, values: Mapping[str, Expression]) -> Effects:
    changed: dict[str, Any] = {
        "tow_ramp": values.get(_RAMP.name),
        "damping": values.get(_DAMPING.name),
        "rate_term": values.get(_RATE.name),
    }
    if effects.strength_wave is not None:
        changed["strength_wave"] = StrengthWave(*(values[variable.name] for variable in _WAVE))
    if isinstance(effects.contact, Smooth):
        changed["contact"] = Smooth(values[_WIDTH.name])
    if isinstance(effects.contact, StickSlip):
        changed["contact"] = StickSlip(values[_BREAKAWAY.name])
    own = tuple(
        _own_with(effect, [values[name] for name in _own_names(k, effect)]) for k, effect in enumerate(effects.own)
    )
    return replace(effects, **changed, own=own)


def _own_with(effect: Any, values: Iterable[Expression]) -> Any:
    remaining = iter(values)
    return map_expressions(effect, lambda _: next(remaining), is_quantity)
