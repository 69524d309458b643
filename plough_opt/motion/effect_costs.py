"""Cost of each effect: nodes, states and events of the differential equation, and operations of a run.

Operations are counted and not timed, so that they are the same on every machine.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import Column, as_number, stacked
from plough_opt.motion import simulate
from plough_opt.motion.effects import TERMS, Effects, Entry
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers import plan
from plough_opt.motion.solvers.integrators import integration, units
from plough_opt.motion.solvers.steps import GAUSS_POINTS, MORE_POINTS, step


@dataclass(frozen=True)
class EffectCost:
    """Cost that one effect adds to a scene.

    Attributes:
        name: name of the effect.
        on: whether the scene has it.
        nodes: additional nodes of the differential equation and its events.
        states: additional states of the differential equation.
        events: additional events that an integrator must locate.
        operations: operations of a run and its check with the effect, relative to those without it [-]; None for an
            orbit, which repeats one wavelength until it is found and so cannot be compared with a run from a start.
        refused: why the effect cannot be combined with the rest of the scene, or "".
    """

    name: str
    on: bool
    nodes: int = 0
    states: int = 0
    events: int = 0
    operations: float | None = 1.0
    refused: str = ""


def effect_costs(scene: Scene, duration: float | None) -> list[EffectCost]:
    """Return the cost of every effect on a numeric scene. An effect that is off is tried with a realistic value.

    Args:
        scene: the scene.
        duration: simulated time [s]; None for a periodic orbit, which is compared with a run over ten wavelengths.
    """
    counted = cache(lambda effects: _operations(replace(scene, effects=effects), duration))
    return [_cost(name, scene, pair, counted) for name, pair in _pairs(scene, duration).items()]


def _cost(
    name: str, scene: Scene, pair: tuple[dict[str, Any], dict[str, Any]], counted: Callable[[Effects], int]
) -> EffectCost:
    """Return the cost of an effect, given the changes of `Effects` that switch it on and off."""
    present = all(getattr(scene.effects, field) == value for field, value in pair[0].items())
    try:
        both = [replace(scene.effects, **changes) for changes in pair]
        sizes = [_size(replace(scene, effects=effects)) for effects in both]
        totals = [counted(effects) for effects in both]
    except (InputError, IntegrationError) as error:
        return EffectCost(name, present, refused=str(error))
    nodes, states, events = (on - off for on, off in zip(*sizes, strict=True))
    alike = both[0].orbit == both[1].orbit
    return EffectCost(name, present, nodes, states, events, totals[0] / totals[1] if alike else None)


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


def _operations(scene: Scene, duration: float | None) -> int:
    """Return the number of operations of a run and its check; for an orbit, of one pass through a wavelength."""
    structure = Structure.of(scene)
    if scene.effects.orbit != "transient":
        duration = None
    elif duration is None:
        duration = 10.0 * float(as_number(scene.wave_period))
    if not scene.effects.motion:
        assert duration is not None  # only orbits have none, and they have motion
        panels = plan.steps_for(plan.rates_of(scene).forced * duration)
        return panels * (2 * GAUSS_POINTS + MORE_POINTS) * _of_resistance(structure)
    accuracy = simulate(scene, duration).accuracy
    if accuracy.order_8:
        steps = sum(each.steps or 1 for each in (accuracy, plan.coarser(accuracy)))
        return steps * int(step(equation_of(structure)).n_instructions())
    assert duration is not None
    return sum(_of_adaptive(scene, duration, each) for each in (accuracy, plan.coarser(accuracy)))


def _of_resistance(structure: Structure) -> int:
    """Return the number of operations of the resistance at one point of the path."""
    symbols = {name: ca.SX.sym(name) for name in structure.names}
    travel, speed = ca.SX.sym("travel"), ca.SX.sym("speed")
    force: Column = structure.resistance(symbols, travel, speed)
    return int(ca.Function("resistance", [*symbols.values(), travel, speed], [force]).n_instructions())


def _of_adaptive(scene: Scene, duration: float, accuracy: Accuracy) -> int:
    """Return the number of operations of an adaptive method in evaluating the equation and its event functions."""
    p = plan.numbers_of(scene)
    timeline = plan.timeline_of(scene, duration, plan.OUTPUTS, plan.MOST_ADAPTIVE, accuracy.method)
    solver = integration(Structure.of(scene), accuracy, timeline)
    equation, column = solver.equation, ca.DM(solver.equation.column(p, duration))
    assert solver.sized is not None  # adaptive methods are CasADi's
    (used,) = (part for part in solver.sized.find_functions() if part.class_name().lower() == accuracy.method)
    sizes = equation.sizes(column)
    first = stacked(equation.start(column[:-1]) / units(equation, sizes)[0], ca.DM.zeros(equation.squared))
    used(x0=first, p=stacked(column, sizes))
    stats = used.stats()
    count = int(stats["n_call_rhsF"]) * int(equation.rate.n_instructions())
    if equation.events is not None:
        count += int(stats["n_call_zeroF"]) * int(equation.events.n_instructions())
    return count
