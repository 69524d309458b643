"""Parameters of an exported share: names, units and domains, and the scene with other values of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, is_quantity, map_expressions, template_of
from plough_opt.core.quantities import EVERY, QUANTITIES
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of, with_quantities


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
        name: as in a problem file.
        unit: of `UNITS`, or "" if it is unknown.
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


def _variable(name: str) -> Variable:
    """Return the variable of a quantity; units of an FMU are spelled without "^" and "*"."""
    quantity = EVERY[name]
    return Variable(
        name,
        quantity.unit.replace("^", "").replace("*", ".") or "1",
        quantity.meaning,
        low=quantity.low,
        high=quantity.high,
        above=quantity.above,
        below=quantity.below,
        shown=quantity.shown,
    )


# A motion in the plastic gas does not use these.
_UNUSED = ("soil.youngs_modulus", "soil.poisson_ratio", *(n for n in QUANTITIES if n.startswith("effects.random")))
_FRAME, _STEEL = "scene.frame_mass", "scene.steel_density"


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
    for name, value in quantities_of(scene).items():
        if name == "scene.mass" and steel_density is not None:
            yield _variable(_FRAME), _frame_mass(scene, steel_density)
            yield _variable(_STEEL), steel_density
        elif name == "effects.tow_ramp":
            if scene.effects.ramps:
                yield replace(_variable(name), above=True), value
        elif value is not None and name not in _UNUSED:
            yield _variable(name), value
    if scene.soil.density_profile is not None:
        for k, value in enumerate(scene.soil.density_profile.parameters):
            yield Variable(_profile_name(k), "", f"number {k + 1} that the density profile needs"), value
    for k, effect in enumerate(scene.effects.own):
        for name, value in zip(_own_names(k, effect), template_of(effect)[1], strict=True):
            yield Variable(name, "", f"{name.rpartition('.')[2]} of the resistance {type(effect).__name__}"), value


def _profile_name(k: int) -> str:
    return f"soil.density_profile.parameters[{k + 1}]"


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
    scene = with_quantities(scene, {name: value for name, value in values.items() if name in QUANTITIES})
    if _FRAME in values:
        scene = replace(scene, mass=values[_FRAME] + scene.cone.solid_mass(values[_STEEL]))
    if (profile := scene.soil.density_profile) is not None:
        numbers = tuple(values[_profile_name(k)] for k in range(len(profile.parameters)))
        scene = replace(scene, soil=replace(scene.soil, density_profile=replace(profile, parameters=numbers)))
    own = tuple(
        _own_with(effect, [values[name] for name in _own_names(k, effect)])
        for k, effect in enumerate(scene.effects.own)
    )
    return replace(scene, effects=replace(scene.effects, own=own))


def _own_with(effect: Any, values: Iterable[Expression]) -> Any:
    remaining = iter(values)
    return map_expressions(effect, lambda _: next(remaining), is_quantity)
