"""What each effect costs: nodes, states and events of the differential equation, and time, with it and without it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plough_opt.effects import Effects, Smooth, StickSlip, StrengthWave
from plough_opt.errors import InputError, IntegrationError
from plough_opt.expressions import as_number
from plough_opt.motion import simulate
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.terms import Structure
from plough_opt.scene import Scene

_REPEATS = 3


@dataclass(frozen=True)
class EffectCost:
    """What one effect adds to a scene.

    Attributes:
        name: the effect.
        on: whether the scene has it.
        nodes: of the differential equation and its events.
        states: of the differential equation.
        events: that an integrator must find.
        time: of a run with the effect over that of one without it [-].
        refused: why it does not go with the rest of the scene, or "".
    """

    name: str
    on: bool
    nodes: int = 0
    states: int = 0
    events: int = 0
    time: float = 1.0
    refused: str = ""


def effect_costs(scene: Scene, duration: float | None) -> list[EffectCost]:
    """Measure every effect on a scene of numbers; one that the scene lacks is tried with a strength of its own order.

    Args:
        scene: the scene.
        duration: simulated time [s]; None for a lasting orbit, which is measured beside a transient of ten wavelengths.
    """
    found: dict[Effects, float] = {}

    def measured(effects: Effects) -> float:
        if effects not in found:
            found[effects] = _seconds(replace(scene, effects=effects), duration)
        return found[effects]

    return [_cost(name, scene, pair, measured) for name, pair in _pairs(scene, duration).items()]


def _cost(
    name: str, scene: Scene, pair: tuple[dict[str, Any], dict[str, Any]], measured: Callable[[Effects], float]
) -> EffectCost:
    """Return what an effect costs, from the changes that switch it on and off."""
    present = all(getattr(scene.effects, field) == value for field, value in pair[0].items())
    try:
        both = [replace(scene.effects, **changes) for changes in pair]
        sizes = [_size(replace(scene, effects=effects)) for effects in both]
        times = [measured(effects) for effects in both]
    except (InputError, IntegrationError) as error:
        return EffectCost(name, present, refused=str(error))
    nodes, states, events = (on - off for on, off in zip(*sizes, strict=True))
    return EffectCost(name, present, nodes, states, events, times[0] / times[1])


def _pairs(scene: Scene, duration: float | None) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return, for every effect, the changes that switch it on and off."""
    own = scene.effects
    speed = float(as_number(scene.tow_speed)) or 1.0
    critical = 2.0 * math.sqrt(float(as_number(scene.stiffness)) * float(as_number(scene.inertia)))
    start = own.start if own.start != "equilibrium" else "towed"
    smooth = own.contact if isinstance(own.contact, Smooth) else Smooth(0.1 * speed)
    slip = own.contact if isinstance(own.contact, StickSlip) else StickSlip()
    wave = own.strength_wave or StrengthWave(0.3, 0.2)
    return {
        "equation of motion": ({"motion": True}, {"motion": False}),
        "inertial drag": ({"inertial_drag": True}, {"inertial_drag": False}),
        "added mass": ({"added_mass": True}, {"added_mass": False}),
        "ambient pressure": ({"ambient_pressure": True}, {"ambient_pressure": False}),
        "start at rest": ({"start": "rest"}, {"start": "equilibrium"}),
        "strength wave": ({"strength_wave": wave}, {"strength_wave": None}),
        "tow ramp": ({"tow_ramp": own.tow_ramp or 0.1 * (duration or 1.0)}, {"tow_ramp": None}),
        "damping": ({"damping": own.damping or 0.1 * critical}, {"damping": None}),
        "rate term": ({"rate_term": own.rate_term or 0.01}, {"rate_term": None}),
        "smooth contact": ({"contact": smooth}, {"contact": "resisting"}),
        "stick and slip": ({"contact": slip}, {"contact": "resisting"}),
        "entry": ({"entry": True, "start": start}, {"entry": False, "start": start}),
        "periodic orbit": ({"orbit": "periodic"}, {"orbit": "transient"}),
    }


def _size(scene: Scene) -> tuple[int, int, int]:
    """Return nodes, states and events of a scene's differential equation; none without motion."""
    if not scene.effects.motion:
        return 0, 0, 0
    equation = equation_of_motion(Structure.of(scene))
    nodes = int(equation.function.n_nodes())
    if equation.events is None:
        return nodes, equation.states, 0
    return nodes + int(equation.events.n_nodes()), equation.states, int(equation.events.numel_out(0))


def _seconds(scene: Scene, duration: float | None) -> float:
    """Return the median time of a run [s], its check included, after a warm-up."""
    wave = scene.effects.strength_wave
    if scene.effects.orbit != "transient":
        duration = None
    elif duration is None:
        assert wave is not None  # the scene's own orbit has one
        duration = 10.0 * float(as_number(wave.wavelength)) / float(as_number(scene.tow_speed))
    taken = []
    for _ in range(1 + _REPEATS):
        started = time.perf_counter()
        simulate(scene, duration)
        taken.append(time.perf_counter() - started)
    return float(np.median(taken[1:]))
