"""Cost of each effect: additional nodes, states and events of the differential equation."""

from dataclasses import dataclass, replace
from typing import Any

from plough_opt.core.errors import InputError
from plough_opt.motion.effects import TERMS, Effects, Entry
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.scene import Scene


@dataclass(frozen=True)
class EffectCost:
    """Cost that one effect adds to a scene.

    Attributes:
        name: name of the effect.
        on: whether the scene has it.
        nodes: additional nodes of the differential equation and its events.
        states: additional states of the differential equation.
        events: additional events that an integrator must locate.
        refused: why the effect cannot be combined with the rest of the scene, or "".
    """

    name: str
    on: bool
    nodes: int = 0
    states: int = 0
    events: int = 0
    refused: str = ""


def effect_costs(scene: Scene, duration: float | None) -> list[EffectCost]:
    """Return the cost of every effect on a numeric scene. An effect that is off is tried with a realistic value.

    Args:
        scene: the scene.
        duration: simulated time [s], to which a realistic tow ramp is proportional; None for a periodic orbit.
    """
    costs = []
    for name, (on, off) in _pairs(scene, duration).items():
        present = all(getattr(scene.effects, field) == value for field, value in on.items())
        try:
            sizes = [_size(replace(scene, effects=replace(scene.effects, **changes))) for changes in (on, off)]
        except InputError as error:
            costs.append(EffectCost(name, present, refused=str(error)))
        else:
            nodes, states, events = (more - less for more, less in zip(*sizes, strict=True))
            costs.append(EffectCost(name, present, nodes, states, events))
    return costs


def _pairs(scene: Scene, duration: float | None) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return the name of every effect with the changes of `Effects` that switch it on and off."""
    effects, plain = scene.effects, Effects()
    start = effects.start if effects.start != "equilibrium" else "towed"
    pairs: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "equation of motion": ({"motion": True}, {"motion": False}),
        "added mass": ({"added_mass": True}, {"added_mass": False}),
        "ambient pressure": ({"ambient_pressure": True}, {"ambient_pressure": False}),
        "start at rest": ({"start": "rest"}, {"start": "equilibrium"}),
    }
    for kind in TERMS:
        if kind.label:
            usual = kind.usual(scene, duration or 1.0) if callable(kind.usual) else kind.usual
            on = getattr(effects, kind.field) if kind.of(scene) else usual
            begins = {"start": start} if kind is Entry else {}
            off = False if on is True else getattr(plain, kind.field)
            pairs[kind.label] = {kind.field: on, **begins}, {kind.field: off, **begins}
    pairs["periodic orbit"] = {"orbit": "periodic"}, {"orbit": "transient"}
    return pairs


def _size(scene: Scene) -> tuple[int, int, int]:
    """Return the numbers of nodes, states and events of a scene's differential equation; zero without motion."""
    if not scene.effects.motion:
        return 0, 0, 0
    equation = equation_of(Structure.of(scene))
    nodes = int(equation.rate.n_nodes())
    if equation.events is None:
        return nodes, equation.states, 0
    return nodes + int(equation.events.n_nodes()), equation.states, int(equation.events.numel_out(0))
