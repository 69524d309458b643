"""Model of an exported share: the variables that its interface names, and their equations.

The input is the strut's speed s' or its path s. With the path the deflection is s - L, and not a state.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from operator import attrgetter
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, is_quantity, template_of
from plough_opt.core.quantities import EVERY
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.driven import DrivenShare
from plough_opt.motion.equation import Structure, parameters
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge

KINDS: Final = {
    "states": ("output", "continuous", "calculated"),
    "rates": ("local", "continuous", "calculated"),
    "outputs": ("output", "continuous", "calculated"),
    "indicators": ("local", "continuous", "calculated"),
    "calculated": ("calculatedParameter", "tunable", "calculated"),
    "inputs": ("input", "continuous", "exact"),
    "parameters": ("parameter", "tunable", "exact"),
    "discrete": ("output", "discrete", "calculated"),
}
"""Kind of variables -> causality, variability and initial, as FMI defines them; in the order of the C source."""


@dataclass(frozen=True)
class FmuVariable:
    """A variable of an exported share.

    Attributes:
        name: its name, as in a problem file.
        unit: SI unit, "1" for a pure number, or "" if it is unknown.
        description: its meaning.
        start: value of a parameter or input.
        low: least value.
        high: largest value.
        above: whether the least value itself is excluded.
        below: whether the largest value itself is excluded.
        nominal: order of magnitude; 0: that of the start value.
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


@dataclass(frozen=True)
class FmuModel:
    """An exported share.

    Attributes:
        of_kind: variables by kind. "parameters" holds those that an equation depends on, "calculated" what depends on
            the parameters alone, "discrete" what changes only at events.
        functions: Functions by name; arguments and results are columns: states x, inputs u, discrete variables d,
            parameters p, and the numbers q in the equation of motion. ``derive`` (p) -> (q, calculated);
            ``begin`` (u, q) -> (x, d); ``evaluate`` (t, x, u, d, q) -> (rates, outputs, indicators); ``happen``
            (t, x, u, d, q) -> (x, d) after all events up to now. The first three have directional derivatives.
            ``forward_...`` takes the same arguments and a seed for each of x, u, p and q among them, and returns the
            change of all continuous results in one column; ``reverse_...`` takes the same arguments and a seed for
            that column, and returns the sensitivities to each. A soil with a density profile has neither.
        depends: name of a rate, output or indicator -> names of the states, inputs and time that it depends on.
    """

    of_kind: Mapping[str, tuple[FmuVariable, ...]]
    functions: Mapping[str, ca.Function]
    depends: Mapping[str, tuple[str, ...]]

    @property
    def visible(self) -> tuple[FmuVariable, ...]:
        """Variables whose causality is "output": states, forces and discrete variables."""
        return tuple(one for kind, (causality, *_) in KINDS.items() if causality == "output"
                     for one in self.of_kind[kind])  # fmt: skip

    @cached_property
    def references(self) -> dict[str, str]:
        """Name -> value reference of each variable, in the order of the C source; time is number 0."""
        variables = chain.from_iterable(self.of_kind[kind] for kind in KINDS)
        return {name: str(k) for k, name in enumerate(["time", *(variable.name for variable in variables)])}


def model_of(named: NamedScene, *, by_speed: bool) -> FmuModel:
    """Return the model of a numeric scene with motion from a start.

    Args:
        named: the scene.
        by_speed: whether the input is the strut's speed; otherwise it is the strut's position.

    Raises:
        InputError: the input is the strut's position, and the equations need its speed.
    """
    scene, structure = named.scene, Structure.of(named.scene)
    if not by_speed:
        _check_position_suffices(structure)
    symbols, symbolic = _with_parameters(named)
    from_scene = parameters(symbolic)
    numbers, given = {name: ca.SX.sym(name) for name in from_scene}, ca.SX.sym("input")
    if by_speed:
        share = DrivenShare(scene, structure, numbers | {"tow_speed": given})
    else:
        share = DrivenShare(scene, structure, numbers, given)
    expressions = _varying(share, scene, given) | {"calculated": _calculated(scene, symbolic)}
    x, u, d, *now, calculated = (
        _column(expressions[kind].values())
        for kind in ("states", "inputs", "discrete", "rates", "outputs", "indicators", "calculated")
    )
    moment, first, after = [share.time, x, u, d], [*map(_column, share.start())], [*map(_column, share.after_events())]
    # Keep only the numbers that occur in the equations, and only the parameters that these numbers depend on.
    in_equations = _symbols_in(*first, *now, *after)
    used = [name for name, symbol in numbers.items() if hash(symbol) in in_equations]
    q, from_p = (_column(source[name] for name in used) for source in (numbers, from_scene))
    needed = _symbols_in(from_p, calculated)
    used_parameters = {variable: symbol for variable, symbol in symbols.items() if hash(symbol) in needed}
    p = _column(used_parameters.values())
    graphs = {
        "derive": ([p], [from_p, calculated]),
        "begin": ([u, q], first),
        "evaluate": ([*moment, q], now),
        "happen": ([*moment, q], after),
    }
    # The quadratures of a density profile take hundreds of thousands of operations, their derivatives many more.
    if scene.soil.density_profile is None:
        graphs |= _derivatives("derive", *graphs["derive"], [p])
        graphs |= _derivatives("begin", [u, q], first[:1], [u, q])
        graphs |= _derivatives("evaluate", *graphs["evaluate"], [x, u, q])
    functions = {
        name: ca.Function(name, arguments, [*map(ca.densify, found)], {"cse": True})
        for name, (arguments, found) in graphs.items()
    }
    of_kind = {kind: tuple(found) for kind, found in expressions.items()} | {"parameters": tuple(used_parameters)}
    return FmuModel(
        of_kind, functions, _depends(of_kind, ca.jacobian_sparsity(_column(now), _column([x, u, share.time])))
    )


def _check_position_suffices(structure: Structure) -> None:
    """Raise InputError if the equations need the strut's speed."""
    if structure.damper:
        raise InputError(
            "a damper in the mount needs the strut's speed, which its position does not give: use strut = 'speed', or"
            " leave damping out"
        )
    if structure.ramp:
        raise InputError(
            "tow_ramp and a position as the input both prescribe the strut's motion: use strut = 'speed', or leave"
            " tow_ramp out"
        )


def _column(values: Any) -> ca.SX:
    """Return expressions as one column, which may be empty."""
    return ca.vertcat(ca.SX(0, 1), *values)


def _symbols_in(*expressions: ca.SX) -> set[int]:
    """Return the hashes of all symbols in some columns."""
    return {hash(symbol) for symbol in ca.symvar(ca.vertcat(*expressions))}


def _derivatives(
    name: str, arguments: list[ca.SX], results: list[ca.SX], by: list[ca.SX]
) -> dict[str, tuple[list[ca.SX], list[ca.SX]]]:
    """Return arguments and results of the products of a Jacobian with seeds, forward and reverse.

    Args:
        name: name of the differentiated Function.
        arguments: its arguments.
        results: those of its results that are differentiated.
        by: those of its arguments by which they are differentiated.
    """
    unknown, known = _column(results), _column(by)
    seeds, seed = [ca.SX.sym("seed", part.numel()) for part in by], ca.SX.sym("seed", unknown.numel())
    ends = np.cumsum([0, *(part.numel() for part in by)]).tolist()
    reverse = ca.vertsplit(ca.jtimes(unknown, known, seed, True), ends)
    return {
        f"forward_{name}": ([*arguments, *seeds], [ca.jtimes(unknown, known, _column(seeds))]),
        f"reverse_{name}": ([*arguments, seed], reverse),
    }


def _depends(of_kind: Mapping[str, tuple[FmuVariable, ...]], pattern: ca.Sparsity) -> dict[str, tuple[str, ...]]:
    """Return for each rate, output and indicator the names of states, inputs and time that it depends on."""
    rows = [variable.name for kind in ("rates", "outputs", "indicators") for variable in of_kind[kind]]
    known = [*(variable.name for kind in ("states", "inputs") for variable in of_kind[kind]), "time"]
    depends: dict[str, tuple[str, ...]] = dict.fromkeys(rows, ())
    for row, column in sorted(zip(*pattern.get_triplet(), strict=True)):
        depends[rows[row]] += (known[column],)
    return depends


def _quantities(named: NamedScene) -> Iterator[FmuVariable]:
    """Yield the named quantities of a scene as parameters."""
    for name, value in named.values.items():
        one, is_ramp = EVERY[name], name == "effects.tow_ramp"
        # A model has the equations of a ramp or not: without them its duration stays 0, with them it is above 0.
        if not is_ramp or named.scene.effects.ramps:
            yield FmuVariable(name, one.unit or "1", one.meaning, float(value), one.low, one.high, one.above or is_ramp,
                           one.below, shown=one.shown)  # fmt: skip


def _with_parameters(named: NamedScene) -> tuple[dict[FmuVariable, ca.SX], Scene]:
    """Return a symbol for each parameter of a scene, and the scene with these symbols.

    Beside the named quantities, the numbers of a density profile and of a user's own effects are parameters. The
    latter have the names of their fields if every number is a field; otherwise they are numbered.
    """
    symbols = {variable: ca.SX.sym(variable.name) for variable in _quantities(named)}
    scene, _ = named.replaced({variable.name: symbol for variable, symbol in symbols.items()})
    if (profile := scene.soil.density_profile) is not None:
        parameters, pairs = _with_symbols(profile.parameters)
        scene = replace(scene, soil=replace(scene.soil, density_profile=replace(profile, parameters=parameters)))
        for k, (value, symbol) in enumerate(pairs, start=1):
            what = f"number {k} of the density profile"
            symbols[FmuVariable(f"soil.density_profile.parameters[{k}]", "", what, value)] = symbol
    effects: tuple[Any, ...] = scene.effects.own
    own = []
    for k, effect in enumerate(effects, start=1):
        fields = [one.name for one in dataclasses.fields(effect) if is_quantity(getattr(effect, one.name))]
        symbolic_effect, pairs = _with_symbols(effect)
        own.append(symbolic_effect)
        if len(fields) != len(pairs) or not all(map(str.isascii, fields)):
            fields = [f"parameters[{j}]" for j, _ in enumerate(pairs, start=1)]
        for field, (value, symbol) in zip(fields, pairs, strict=True):
            what = f"{field} of the resistance {type(effect).__name__}"
            symbols[FmuVariable(f"effects.own[{k}].{field}", "", what, value)] = symbol
    return symbols, replace(scene, effects=replace(scene.effects, own=tuple(own)))


def _with_symbols(part: Any) -> tuple[Any, list[tuple[float, ca.SX]]]:
    """Return a part of a scene with a symbol in place of each number, and the pairs of number and symbol."""
    template, values = template_of(part)
    return template, [*zip(map(float, values), template_of(template)[1], strict=True)]


def _varying(share: DrivenShare, scene: Scene, given: ca.SX) -> dict[str, Mapping[FmuVariable, Column]]:
    """Return, by kind, the variables that change during a run with their expressions.

    Args:
        share: the share at one moment.
        scene: the numeric scene, which gives the orders of magnitude.
        given: the input.
    """
    nominal, by_speed, events = _magnitudes(scene), share.by_speed, share.structure.events

    def variable(name: str, unit: str, description: str, shown: str = "", **more: Any) -> FmuVariable:
        return FmuVariable(name, unit, description, nominal=nominal.get(unit, 0.0), shown=shown, **more)

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
        "inputs": {driven if by_speed else place: given},
        "discrete": ({mode: share.mode, furthest: share.furthest} if events else {})
        | ({buried: share.entered} if share.structure.entry else {}),
    }


def _magnitudes(scene: Scene) -> dict[str, float]:
    """Return unit -> order of magnitude, above 0, of variables with this unit."""
    speed, frequency = float(scene.tow_speed), float(scene.natural_frequency)
    force = abs(float(scene.steady_resistance)) or speed * math.sqrt(scene.stiffness * scene.inertia) or 1.0
    length = force / float(scene.stiffness)
    return {"N": force, "m": length, "m/s": speed or length * frequency, "m/s^2": force / float(scene.inertia)}


def _calculated(scene: Scene, symbolic: Scene) -> dict[FmuVariable, ca.SX]:
    """Return the variables that depend on the parameters alone, with their expressions from the symbolic scene."""
    gas, carries = not scene.law.lacks("loosened_radius"), not scene.law.lacks("added_mass")
    half_angle = FmuVariable("share.half_angle", "rad", "half angle beta of the equivalent cone", shown="deg")
    radius = FmuVariable("share.loosened_radius", "m", "radius r* of the compaction front at the share's base")
    static = FmuVariable("share.static_resistance", "N", "static resistance F0", shown="kN")
    drag = FmuVariable("share.drag_coefficient", "N*s^2/m^2", "resistance Fd per squared speed")
    carried = FmuVariable("share.added_mass", "kg", "mass m_a of soil that the share carries along")
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
