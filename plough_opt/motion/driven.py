"""The equation of motion of a share whose strut or mount is driven from outside, for one's own integrators and solvers.

The states are travel L, speed L' and, unless the strut's position is given, the spring's deflection z with the rate
s' - L'. As a state z is not the small difference of two large travels; the strut's path is then L + z. The acceleration
of the strut does not occur, so its speed may have kinks and jumps. Three variables change only at events: the mode, the
furthest travel, and whether an entering share is wholly in the soil.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, absolute, as_number, holds_casadi, where
from plough_opt.core.quantities import QUANTITIES
from plough_opt.core.tables import Grid, Page, Readable
from plough_opt.motion.effects.terms import Parameters, Towed
from plough_opt.motion.equation import GAP, SLIP, STICK, Structure, by_mode, parameters

# Speeds below this part of the scene's speed, and distances below this part of the share's height, are rounding.
_ROUNDING_OF_EVENTS = 1e-12
# An integrator may stop before or after an event by a speed or distance of this part.
_EVENT_TOLERANCE = 1e-9


class DrivenShare:
    """The share at one moment: symbols, and expressions of them in SI units.

    Attributes:
        structure: which terms the equation of motion contains.
        by_speed: whether the strut's speed is given, as the parameter "tow_speed"; otherwise it is its position.
        p: parameters of the equation of motion by name, with "added_mass".
        time, travel, speed, mode, furthest, entered: symbols.
        deflection: deflection of the spring; a symbol if it is a state.
        opening: distance of the share behind its furthest travel.
        strut_speed: speed of the strut; meaningful only if it is given.
        pull: mount force P.
        acceleration: acceleration L'' of the share.
        resistance: force of the soil on the share, including the inertia of the added mass.
    """

    def __init__(self, scene: Towed, structure: Structure, p: Parameters, position: ca.SX | None = None) -> None:
        """Create the symbols and the expressions.

        Args:
            scene: numeric scene, for orders of magnitude.
            structure: its structure.
            p: parameters by name, with "added_mass".
            position: symbol of the strut's position if that is given instead of its speed.
        """
        self.structure, self.by_speed, self.p = structure, position is None, p
        self.sticks = structure.sticks
        self.time, self.travel, self.speed, self.mode, self.furthest, self.entered = map(
            ca.SX.sym, ("time", "travel", "speed", "mode", "furthest", "entered")
        )
        self._position: Column = 0.0 if position is None else position
        self.deflection = ca.SX.sym("deflection") if position is None else position - self.travel
        self.opening = where(self.mode > STICK, self.furthest - self.travel, 0.0)
        p = {**p, **({"entered": self.entered, "behind": self.opening} if structure.entry else {})}
        _, self.strut_speed = structure.towed(p, self.time)
        self.pull: Column = structure.pull(p, self.deflection, self.strut_speed - self.speed)
        steady = structure.resistance(p, self.travel, self.speed)
        self._carried = structure.carried_mass(p, self.travel) if structure.events else p["added_mass"]
        self._slipping: Column = (self.pull - steady) / structure.inertia_at(p, self.travel)
        self.acceleration, self.resistance = self._slipping, steady + self._carried * self._slipping
        if self.sticks:
            # The mount force at which a sticking share breaks away.
            self._hold = structure.hold(p, self.travel)
            self.acceleration = by_mode(self.mode, self._slipping, 0.0, self.pull / p["mass"])
            self.resistance = by_mode(self.mode, self.resistance, self.pull, 0.0)
        self._speed_scale, self._height = scene.tow_speed or 1.0, scene.cone.height

    @property
    def states(self) -> list[Column]:
        """Symbols of the states."""
        return [self.travel, self.speed, *([self.deflection] if self.by_speed else [])]

    @property
    def discrete(self) -> list[Column]:
        """Symbols of the variables that change only at events."""
        if not self.structure.events:
            return []
        return [self.mode, self.furthest, *([self.entered] if self.structure.entry else [])]

    @property
    def indicators(self) -> list[Expression]:
        """Expressions that become negative when an event happens."""
        if not self.structure.events:
            return []
        stopping = self.speed + _ROUNDING_OF_EVENTS * self._speed_scale
        closing = self.opening + _ROUNDING_OF_EVENTS * self._height
        if self.sticks:
            indicators = [
                by_mode(self.mode, stopping, self._hold - self.pull, closing),
                by_mode(self.mode, 1.0, self.pull + _ROUNDING_OF_EVENTS * absolute(self._hold), 1.0),
            ]
        else:
            turning = where(self.mode > STICK, closing, stopping)
            indicators = [where(self.entered < 0.5, turning, 1.0)]
        if self.structure.entry:
            indicators.append(where(self.entered < 0.5, self.p["height"] - self.travel, 1.0))
        return indicators

    def after_events(self) -> tuple[list[Expression], list[Expression]]:
        """Return the states and the discrete variables after all events up to now."""
        if not self.structure.events:
            return [*self.states], []
        speed: Column = self.speed
        slipping: Column = self._slipping
        opening: Column = self.opening
        stopped = ca.logic_and(speed <= _EVENT_TOLERANCE * self._speed_scale, slipping <= 0.0)
        closed = ca.logic_and(opening <= _EVENT_TOLERANCE * self._height, speed > 0.0)
        if self.sticks:
            held = self.pull < self._hold - _EVENT_TOLERANCE * absolute(self._hold)
            at_rest = where(self.pull < 0.0, GAP, where(held, STICK, SLIP))
            mode = by_mode(self.mode, where(stopped, at_rest, SLIP), at_rest, where(closed, SLIP, GAP))
            # A share that closes its gap takes up the carried soil, which is at rest: momentum is conserved.
            mass = self.p["mass"]
            caught = self.speed * mass / (mass + self._carried)
            speed = by_mode(self.mode, where(stopped, 0.0, self.speed), 0.0, where(closed, caught, self.speed))
        else:
            turned = where(stopped, GAP, SLIP)
            mode = where(self.mode > STICK, where(closed, SLIP, GAP), turned)
            mode = where(self.entered < 0.5, mode, SLIP)
        leaving = ca.logic_and(mode > STICK, self.mode < GAP)
        discrete = [mode, where(leaving, self.travel, self.furthest)]
        if self.structure.entry:
            inside = self.travel >= self.p["height"] * (1.0 - _EVENT_TOLERANCE)
            discrete.append(where(inside, 1.0, self.entered))
        return [self.travel, speed, *self.states[2:]], discrete

    def start(self) -> tuple[list[Expression], list[Expression]]:
        """Return the states and the discrete variables at the start."""
        structure, p = self.structure, self.p
        first, rate = structure.start_deflection(p), structure.start_rate(p)
        travel, speed = self._position - first, structure.start_speed(p) - rate
        x = [travel, speed, *([first] if self.by_speed else [])]
        if not structure.events:
            return x, []
        mode: Expression = SLIP
        if self.sticks:
            buried: Parameters = {"entered": 0.0, "behind": 0.0} if structure.entry else {}
            held = structure.pull(p, first, rate) < structure.hold({**p, **buried}, travel)
            mode = where(speed > 0.0, SLIP, where(held, STICK, SLIP))
        return x, [mode, travel, *([0.0] if structure.entry else [])]


CONTROLS: Final = {"tow_speed": "scene.tow_speed", "stiffness": "scene.stiffness", "damping": "effects.damping"}
"""Name of each quantity that may vary during a motion -> its name in problem files."""

_STATES: Final = {"travel": "m", "speed": "m/s", "deflection": "m", "mode": "", "furthest_travel": "m", "buried": ""}
_OUTPUTS: Final = {
    "mount_force": "N", "soil_resistance": "N", "acceleration": "m/s^2", "strut_speed": "m/s", "strut_position": "m",
    "tow_power": "W",
}  # fmt: skip


_OPTIONS: Final = {"cse": True}


@dataclass(frozen=True, eq=False)
class MotionEquation(Readable):
    """Equation of motion of a scene as CasADi Functions of numbers, MX or SX, for one's own integrator or optimiser.

    Every Function except `start` takes the time [s], the state, the controls and the parameters, each a column in SI
    units. A column may be empty: pass ``[]``.

    Attributes:
        rate: (time, state, controls, parameters) -> derivative of the state by time.
        outputs: the same arguments -> mount force P [N], soil resistance F with the inertia of the soil carried along
            [N], acceleration L'' [m/s^2], speed s' [m/s] and position s [m] of the strut, tow power P s' [W].
        events: the same arguments -> a column of values, one of which becomes negative at an event, and the state after
            all events up to now, which is the given state if there are none; None without stick and slip or entry.
        start: (controls at time 0, parameters) -> state at time 0.
        controls: values of the controls in the scene.
        parameters: values of the parameters in the scene.
        names: "state", "controls", "parameters" and "outputs" -> names in the order of the column. States are travel
            L, speed L' and deflection z of the spring. With stick and slip or entry the mode (0 slips, 1 sticks, 2 is
            behind its furthest travel) and the furthest travel follow, and with entry whether the whole share has been
            in the soil (0 or 1). They have the rate 0 and change at events.
        units: each of these names -> SI unit, "" for a pure number.

    It prints as a table of its columns.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> equation = scene.equation(controls=("tow_speed",), parameters=("soil.cohesion",))
        >>> equation.names["state"], equation.units["speed"]
        (('travel', 'speed', 'deflection'), 'm/s')
        >>> start = equation.start(equation.controls, equation.parameters)
        >>> equation.rate(0.0, start, 2.5, equation.parameters)  # the strut is 0.5 m/s faster than the share
        DM([2, 0, 0.5])
    """

    rate: ca.Function
    outputs: ca.Function
    events: ca.Function | None
    start: ca.Function
    controls: NDArray[np.float64]
    parameters: NDArray[np.float64]
    names: Mapping[str, tuple[str, ...]]
    units: Mapping[str, str]

    def page(self) -> Page:
        """Return a table of the columns: each entry's name, value if it has one, and unit.

        Example:
            >>> import plough_opt as po
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s").equation().page().heading
            'equation of motion: 3 states, 0 controls, 0 parameters, 6 outputs'
        """
        given = self.names["controls"] + self.names["parameters"]
        values = dict(zip(given, [*self.controls, *self.parameters], strict=True))
        table = Grid.of("", "column", "name", "value", "unit", left=("column", "name", "unit"))
        for column, names in self.names.items():
            for i, name in enumerate(names):
                value = f"{values[name]:.6g}" if name in given else ""
                table.rows.append((f"{column}[{i}]", name, value, self.units[name]))
        counts = (f"{len(names)} {column.rstrip('s')}{'s' * (len(names) != 1)}" for column, names in self.names.items())
        return Page(f"equation of motion: {', '.join(counts)}", (table,))


def symbols_of(scene: Towed, controls: Sequence[str], parameters: Sequence[str]) -> dict[str, ca.SX]:
    """Return a symbol for each control, by its name in problem files, and for each parameter.

    Raises:
        InputError: as `Scene.equation`.
    """
    effects = scene.effects
    if holds_casadi(scene):
        raise InputError(
            "the equation of a scene with symbols: give the scene numbers, and name the quantities that are to be"
            " symbols, such as parameters=('soil.cohesion',)"
        )
    if not effects.motion:
        raise InputError("a quasi-static scene has no equation of motion: give motion = True")
    if effects.orbit != "transient":
        raise InputError("an orbit is one solution of the equation of motion: leave orbit out")
    for what, given in (("controls", controls), ("parameters", parameters)):
        if not isinstance(given, tuple | list) or len({*map(str, given)}) < len(given):
            raise InputError(f"{what} = {given!r} must be a tuple of different names, such as ('tow_speed',)")
    for name in controls:
        check_named("{} cannot be a control, because only mount and strut may change during a motion", name, CONTROLS)
        if CONTROLS[name] in parameters:
            raise InputError(f"'{name}' is a control, so '{CONTROLS[name]}' cannot be a parameter: omit one of them")
    if "tow_speed" in controls and effects.accelerates:
        other = "tow_ramp" if effects.ramps else "tow_profile"
        raise InputError(f"{other} and the control 'tow_speed' both prescribe the strut's motion: leave one out")
    return {name: ca.SX.sym(name) for name in (*(CONTROLS[name] for name in controls), *parameters)}


def driven_equation(
    scene: Towed, symbolic: Towed, symbols: Mapping[str, ca.SX], values: Sequence[Expression], controls: Sequence[str]
) -> MotionEquation:
    """Return the equation of motion of a scene: see `Scene.equation`.

    Args:
        scene: numeric scene.
        symbolic: the scene with symbols in the place of some quantities.
        symbols: those quantities by name in problem files, and their symbols; those of the controls come first.
        values: their values in the numeric scene.
        controls: names of the controls.
    """
    # A quantity that is 0 in the numeric scene, such as a phase, still has its term.
    structure, count = Structure.of(symbolic), len(controls)
    p = parameters(symbolic)
    if "tow_speed" in controls:
        p["tow_speed"] = symbols["scene.tow_speed"]
    share = DrivenShare(scene, structure, p)
    given, states = [*symbols.values()], [*share.states, *share.discrete]
    u, q = _column(given[:count]), _column(given[count:])
    at, labels = [share.time, _column(states), u, q], ["time", "state", "controls", "parameters"]
    rates = [share.speed, share.acceleration, share.strut_speed - share.speed, *[0.0] * len(share.discrete)]
    place, power = share.travel + share.deflection, share.pull * share.strut_speed
    outputs = [share.pull, share.resistance, share.acceleration, share.strut_speed, place, power]
    zero, (x, d) = _column(share.indicators), share.after_events()
    numbers = np.array([float(as_number(value)) for value in values])
    names = {
        "state": tuple(_STATES)[: len(states)],
        "controls": tuple(controls),
        "parameters": tuple(symbols)[count:],
        "outputs": tuple(_OUTPUTS),
    }
    known = _STATES | _OUTPUTS
    return MotionEquation(
        rate=ca.Function("rate", at, [_column(rates)], labels, ["rate"], _OPTIONS),
        outputs=ca.Function("outputs", at, [*map(_column, outputs)], labels, [*_OUTPUTS], _OPTIONS),
        events=ca.Function("events", at, [zero, _column([*x, *d])], labels, ["zero", "after"], _OPTIONS)
        if structure.events
        else None,
        start=ca.Function("start", [u, q], [_column(chain(*share.start()))], labels[2:], ["state"], _OPTIONS),
        controls=numbers[:count],
        parameters=numbers[count:],
        names=names,
        units={
            name: known[name] if name in known else QUANTITIES[CONTROLS.get(name, name)].unit
            for name in chain(*names.values())
        },
    )


def _column(values: Any) -> ca.SX:
    """Return an expression, or several as one column, dense."""
    several = values if isinstance(values, Iterable) and not isinstance(values, ca.SX) else [values]
    return ca.densify(ca.vertcat(ca.SX(0, 1), *several))
