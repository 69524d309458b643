"""What is calibrated: a scene as a function of its quantities by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from plough_opt.accuracy import Accuracy
from plough_opt.effects import Effects, Smooth, StickSlip
from plough_opt.errors import InputError, nearest
from plough_opt.expressions import Expression, as_number, is_symbolic
from plough_opt.geometry import Wedge
from plough_opt.problem_file import Problem
from plough_opt.problem_file.schema import quantities
from plough_opt.scene import Scene

SceneOf: TypeAlias = Callable[[Mapping[str, Expression]], Scene]
_DURATION = "scene.duration"


@dataclass(frozen=True)
class Model:
    """A scene by the names of its quantities.

    Attributes:
        title: for reports.
        build: values by key, numbers or symbols, of those that differ from the scene's own -> scene.
        current: key -> value of the scene's own.
        duration: simulated time [s] where a result needs one, or None.
        accuracy: method and setting of runs.
    """

    title: str
    build: SceneOf
    current: Mapping[str, float]
    duration: float | None
    accuracy: Accuracy

    def scene(self, values: Mapping[str, Expression]) -> Scene:
        """Return the scene with changed values; a duration among them is none of the scene's."""
        return self.build({key: value for key, value in values.items() if key != _DURATION})

    def duration_of(self, values: Mapping[str, Expression]) -> Expression | None:
        """Return the simulated time [s]."""
        return values.get(_DURATION, self.duration)


def model_of(given: Problem | Scene | SceneOf, duration: float | None = None) -> Model:
    """Return what is calibrated.

    Args:
        given: a problem, a scene of numbers, or a function of values by key that returns a scene.
        duration: simulated time [s], if not the problem's.

    Raises:
        InputError: none of these.
    """
    if isinstance(given, Problem):
        own = given.values()
        values = {**_current(given.scene()), **{key: float(value) for key, value in own.items()}}
        duration = values.get(_DURATION) if duration is None else duration
        return Model(given.title, given.scene, values, duration, given.accuracy)
    if isinstance(given, Scene):
        scene = given
        return Model(given.soil.name, lambda values: changed(scene, values), _current(given), duration, Accuracy())
    if callable(given):
        return Model("calibration", given, {}, duration, Accuracy())
    raise InputError(f"{given!r} must be a Problem, a Scene, or a function of values by key that returns a Scene")


def _current(scene: Scene) -> dict[str, float]:
    """Return the quantities of a scene of numbers by key, as far as they have keys."""
    found: dict[str, Any] = {f"soil.{key}": getattr(scene.soil, key) for key in _names("soil")}
    if isinstance(scene.share, Wedge):
        found |= {"share.wedge_angle": scene.share.angle, "share.chisel_angle": scene.share.chisel_angle}
    found |= {"share.height": scene.share.height, "scene.tow_speed": scene.tow_speed}
    found |= {"scene.stiffness": scene.stiffness}
    found |= {f"effects.{key}": getattr(scene.effects, key) for key in ("tow_ramp", "damping", "rate_term")}
    if any(map(is_symbolic, found.values())):
        raise InputError("the scene holds symbols: calibrate a scene of numbers, and name what is unknown in it")
    return {key: float(as_number(value)) for key, value in found.items() if value is not None}


def changed(scene: Scene, values: Mapping[str, Expression]) -> Scene:
    """Return a scene with some of its quantities, by their keys in a problem file, changed.

    Raises:
        InputError: a quantity that this scene does not have.
    """
    tables: dict[str, dict[str, Expression]] = {"soil": {}, "share": {}, "scene": {}, "effects": {}}
    for key, value in values.items():
        table, _, name = key.partition(".")
        tables[table][name] = value
    for key in tables["scene"]:
        if key not in ("tow_speed", "stiffness"):
            raise InputError(f"a Scene has no 'scene.{key}': {nearest(key, ('tow_speed', 'stiffness'))}; calibrate a"
                             " problem file, or a function that returns the scene")  # fmt: skip
    share = scene.share
    if tables["share"]:
        names = {"wedge_angle": "angle"}
        own = {names.get(key, key): value for key, value in tables["share"].items()}
        missing = [key for key in own if not hasattr(share, key)]
        if missing:
            raise InputError(f"a cone has no '{missing[0]}': give the scene a Wedge, or vary share.height")
        share = replace(share, **own)
    return replace(
        scene,
        soil=replace(scene.soil, **tables["soil"]),
        share=share,
        effects=_effects(scene.effects, tables["effects"]),
        **tables["scene"],
    )


def _effects(effects: Effects, values: Mapping[str, Expression]) -> Effects:
    """Return effects with changed quantities."""
    own = {key: value for key, value in values.items() if key in ("tow_ramp", "damping", "rate_term")}
    wave = {key.partition(".")[2]: value for key, value in values.items() if key.startswith("strength_wave.")}
    if wave:
        if effects.strength_wave is None:
            raise InputError("the scene has no strength wave whose amplitude or wavelength could vary: give it one")
        own["strength_wave"] = replace(effects.strength_wave, **wave)
    for key, law, name in (("contact_width", Smooth, "width"), ("breakaway", StickSlip, "breakaway")):
        if key in values:
            if not isinstance(effects.contact, law):
                raise InputError(f"the scene's contact is not {law.__name__}, and has no effects.{key} to vary")
            own["contact"] = replace(effects.contact, **{name: values[key]})
    return replace(effects, **own)


def _names(table: str) -> list[str]:
    return [key.removeprefix(f"{table}.") for key in quantities() if key.startswith(f"{table}.")]
