"""Model of an exported share: its states, modes and events, and the variables that its interface names.

The states are travel L, speed L' and, if the input is the strut's speed s', the spring's deflection z with the rate
s' - L'. As a state z is not the small difference of two large travels; the strut's path is then L + z. If the input is
the path s itself, the deflection is s - L. Three variables change only at events: the mode, the furthest travel, and
whether an entering share is wholly in the soil.
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
from plough_opt.core.expressions import Column, Expression, absolute, is_quantity, template_of, where
from plough_opt.core.quantities import EVERY
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.effects.terms import Parameters
from plough_opt.motion.equation import GAP, SLIP, STICK, Structure, parameters
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge

# Speeds below this part of the scene's speed, and distances below this part of the share's height, are rounding.
_ROUNDING = 1e-12
# A tool may stop before or after an event by a speed or distance of this part.
_EVENT_TOLERANCE = 1e-9
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


class Share:
    """The share at one moment: symbols, and expressions of them in SI units.

    Attributes:
        structure: which terms the equation of motion contains.
        by_speed: whether the input is the strut's speed; otherwise it is the strut's position.
        q: name -> symbol of each parameter of the equation of motion.
        time, input, travel, speed, mode, furthest, entered: symbols.
        deflection: deflection of the spring; a symbol if it is a state.
        opening: distance of the share behind its furthest travel.
        strut_speed: speed of the strut; meaningful only if the input is a speed.
        pull: mount force P.
        acceleration: acceleration L'' of the share.
        resistance: force of the soil on the share, including the inertia of the added mass.
    """

    def __init__(self, scene: Scene, structure: Structure, by_speed: bool, q: dict[str, ca.SX]) -> None:
        """Create the symbols and the expressions."""
        self.structure, self.by_speed, self.q = structure, by_speed, q
        self.sticks = structure.sticks
        self.time, self.input, self.travel, self.speed, self.mode, self.furthest, self.entered = map(
            ca.SX.sym, ("time", "input", "travel", "speed", "mode", "furthest", "entered")
        )
        self.deflection = ca.SX.sym("deflection") if by_speed else self.input - self.travel
        self.opening = where(self.mode > STICK, self.furthest - self.travel, 0.0)
        p = q | ({"entered": self.entered, "behind": self.opening} if structure.entry else {})
        driven = p | {"tow_speed": self.input}
        self.strut_speed = structure.start_speed(driven) + structure.strut(driven, self.time).gain
        self.pull: Column = structure.pull(q, self.deflection, self.strut_speed - self.speed)
        steady = structure.resistance(p, self.travel, self.speed)
        self._carried = structure.carried_mass(p, self.travel) if structure.events else q["added_mass"]
        self._slipping: Column = (self.pull - steady) / structure.inertia_at(p, self.travel)
        self.acceleration, self.resistance = self._slipping, steady + self._carried * self._slipping
        if self.sticks:
            # The mount force at which a sticking share breaks away.
            self._hold = structure.hold(p, self.travel)
            self.acceleration = self._by_mode(self._slipping, 0.0, self.pull / q["mass"])
            self.resistance = self._by_mode(self.resistance, self.pull, 0.0)
        self._speed_scale, self._height = scene.tow_speed or 1.0, scene.cone.height

    def _by_mode(self, slip: Column, stick: Column, gap: Column) -> Column:
        """Return the expression that belongs to the present mode."""
        rest = where(self.mode < (STICK + GAP) / 2.0, stick, gap)
        return where(self.mode < (SLIP + STICK) / 2.0, slip, rest)

    @property
    def indicators(self) -> list[Expression]:
        """Expressions that become negative when an event happens."""
        if not self.structure.events:
            return []
        stopping = self.speed + _ROUNDING * self._speed_scale
        closing = self.opening + _ROUNDING * self._height
        if self.sticks:
            indicators = [
                self._by_mode(stopping, self._hold - self.pull, closing),
                self._by_mode(1.0, self.pull + _ROUNDING * absolute(self._hold), 1.0),
            ]
        else:
            turning = where(self.mode > STICK, closing, stopping)
            indicators = [where(self.entered < 0.5, turning, 1.0)]
        if self.structure.entry:
            indicators.append(where(self.entered < 0.5, self.q["height"] - self.travel, 1.0))
        return indicators

    def after_events(self) -> tuple[list[Expression], list[Expression]]:
        """Return the states and the discrete variables after all events up to now."""
        rest = [self.deflection] if self.by_speed else []
        if not self.structure.events:
            return [self.travel, self.speed, *rest], []
        speed: Column = self.speed
        slipping: Column = self._slipping
        opening: Column = self.opening
        stopped = ca.logic_and(speed <= _EVENT_TOLERANCE * self._speed_scale, slipping <= 0.0)
        closed = ca.logic_and(opening <= _EVENT_TOLERANCE * self._height, speed > 0.0)
        if self.sticks:
            held = self.pull < self._hold - _EVENT_TOLERANCE * absolute(self._hold)
            at_rest = where(self.pull < 0.0, GAP, where(held, STICK, SLIP))
            mode = self._by_mode(where(stopped, at_rest, SLIP), at_rest, where(closed, SLIP, GAP))
            # A share that closes its gap takes up the carried soil, which is at rest: momentum is conserved.
            mass = self.q["mass"]
            caught = self.speed * mass / (mass + self._carried)
            speed = self._by_mode(where(stopped, 0.0, self.speed), 0.0, where(closed, caught, self.speed))
        else:
            turned = where(stopped, GAP, SLIP)
            mode = where(self.mode > STICK, where(closed, SLIP, GAP), turned)
            mode = where(self.entered < 0.5, mode, SLIP)
        leaving = ca.logic_and(mode > STICK, self.mode < GAP)
        discrete = [mode, where(leaving, self.travel, self.furthest)]
        if self.structure.entry:
            inside = self.travel >= self.q["height"] * (1.0 - _EVENT_TOLERANCE)
            discrete.append(where(inside, 1.0, self.entered))
        return [self.travel, speed, *rest], discrete

    def start(self) -> tuple[list[Expression], list[Expression]]:
        """Return the states and the discrete variables at the start."""
        structure = self.structure
        p = self.q | ({"tow_speed": self.input} if self.by_speed else {})
        first, rate = structure.start_deflection(p), structure.start_rate(p)
        travel, speed = (0.0 if self.by_speed else self.input) - first, structure.start_speed(p) - rate
        x = [travel, speed, *([first] if self.by_speed else [])]
        if not structure.events:
            return x, []
        mode: Expression = SLIP
        if self.sticks:
            buried: Parameters = {"entered": 0.0, "behind": 0.0} if structure.entry else {}
            held = structure.pull(p, first, rate) < structure.hold({**p, **buried}, travel)
            mode = where(speed > 0.0, SLIP, where(held, STICK, SLIP))
        return x, [mode, travel, *([0.0] if structure.entry else [])]


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
    from_scene = parameters(symbolic) | {"added_mass": symbolic.reaction.added_mass}
    share = Share(scene, structure, by_speed, {name: ca.SX.sym(name) for name in from_scene})
    expressions = _varying(share, scene) | {"calculated": _calculated(scene, symbolic)}
    x, u, d, *now, calculated = (
        _column(expressions[kind].values())
        for kind in ("states", "inputs", "discrete", "rates", "outputs", "indicators", "calculated")
    )
    moment, first, after = [share.time, x, u, d], [*map(_column, share.start())], [*map(_column, share.after_events())]
    # Keep only the numbers that occur in the equations, and only the parameters that these numbers depend on.
    in_equations = _symbols_in(*first, *now, *after)
    used = [name for name, symbol in share.q.items() if hash(symbol) in in_equations]
    q, from_p = (_column(source[name] for name in used) for source in (share.q, from_scene))
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


def _varying(share: Share, scene: Scene) -> dict[str, Mapping[FmuVariable, Column]]:
    """Return, by kind, the variables that change during a run with their expressions.

    Args:
        share: the share at one moment.
        scene: the numeric scene, which gives the orders of magnitude.
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
        "inputs": {driven if by_speed else place: share.input},
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
