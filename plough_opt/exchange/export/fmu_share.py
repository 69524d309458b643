"""The exported share at one moment: its states, inputs and modes as symbols, and expressions of them.

The states are travel L, speed L' and, if the strut's speed is the input, the spring's deflection z, whose rate is
s' - L'; so z is not the difference of two large travels. The strut's path is then L + z. If that path s is the input,
the deflection is s - L. The mode, the furthest travel, and whether an entering share is wholly in the soil change only
at events.
"""

import casadi as ca

from plough_opt.core.expressions import Column, Expression, absolute, where
from plough_opt.motion.effects.term import Parameters
from plough_opt.motion.equation import GAP, SLIP, STICK
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import (
    Structure,
    carried_mass,
    hold,
    inertia_at,
    pull,
    resistance,
    start_deflection,
    start_rate,
    start_speed,
    strut,
)

# Parts of the scene's speed and of the share's height below which a difference is rounding, and by which a tool may
# stop before or after an event.
_ROUNDING = 1e-12
_BESIDE = 1e-9


class Share:
    """The share at one moment: symbols, and expressions of them in SI units.

    Attributes:
        structure: what the equation of motion contains.
        by_speed: whether the input is the strut's speed; else it is its position.
        q: symbol of each number in the equation of motion, by name.
        time, input, travel, speed, mode, furthest, entered: symbols.
        deflection: of the spring, a symbol if it is a state.
        opening: how far the share is behind its furthest travel.
        strut_speed: if the input gives it.
        pull: mount force P.
        acceleration: of the share L''.
        resistance: of the soil to the share, the added mass's part included.
    """

    def __init__(self, scene: Scene, structure: Structure, by_speed: bool, q: dict[str, ca.SX]) -> None:
        """Make symbols and expressions."""
        self.structure, self.by_speed, self.q = structure, by_speed, q
        self.sticks = structure.sticks
        self.time, self.input, self.travel, self.speed, self.mode, self.furthest, self.entered = map(
            ca.SX.sym, ("time", "input", "travel", "speed", "mode", "furthest", "entered")
        )
        self.deflection = ca.SX.sym("deflection") if by_speed else self.input - self.travel
        self.opening = where(self.mode > STICK, self.furthest - self.travel, 0.0)
        p = q | ({"entered": self.entered, "behind": self.opening} if structure.entry else {})
        driven = p | {"tow_speed": self.input}
        self.strut_speed = start_speed(structure, driven) + strut(structure, driven, self.time).gain
        self.pull: Column = pull(structure, q, self.deflection, self.strut_speed - self.speed)
        steady = resistance(structure, p, self.travel, self.speed)
        self._carried = carried_mass(structure, p, self.travel) if structure.events else q["added_mass"]
        self._slipping: Column = (self.pull - steady) / inertia_at(structure, p, self.travel)
        self.acceleration, self.resistance = self._slipping, steady + self._carried * self._slipping
        if self.sticks:
            # Mount force at which a sticking share moves.
            self._hold = hold(structure, p, self.travel)
            self.acceleration = self._by_mode(self._slipping, 0.0, self.pull / q["mass"])
            self.resistance = self._by_mode(self.resistance, self.pull, 0.0)
        self._swift, self._high = scene.tow_speed or 1.0, scene.cone.height

    def _by_mode(self, slip: Column, stick: Column, gap: Column) -> Column:
        rest = where(self.mode < (STICK + GAP) / 2.0, stick, gap)
        return where(self.mode < (SLIP + STICK) / 2.0, slip, rest)

    @property
    def indicators(self) -> list[Expression]:
        """Expressions that are negative once an event has happened."""
        if not self.structure.events:
            return []
        stopping = self.speed + _ROUNDING * self._swift
        closing = self.opening + _ROUNDING * self._high
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
        """Return the states and the discrete variables after the events until now."""
        rest = [self.deflection] if self.by_speed else []
        if not self.structure.events:
            return [self.travel, self.speed, *rest], []
        slowed: Column = self.speed
        slipping: Column = self._slipping
        behind: Column = self.opening
        stopped = ca.logic_and(slowed <= _BESIDE * self._swift, slipping <= 0.0)
        closed = ca.logic_and(behind <= _BESIDE * self._high, slowed > 0.0)
        if self.sticks:
            held = self.pull < self._hold - _BESIDE * absolute(self._hold)
            freed = where(self.pull < 0.0, GAP, where(held, STICK, SLIP))
            mode = self._by_mode(where(stopped, freed, SLIP), freed, where(closed, SLIP, GAP))
            mass = self.q["mass"]
            taken_up = self.speed * mass / (mass + self._carried)
            slowed = self._by_mode(where(stopped, 0.0, self.speed), 0.0, where(closed, taken_up, self.speed))
        else:
            turned = where(stopped, GAP, SLIP)
            mode = where(self.mode > STICK, where(closed, SLIP, GAP), turned)
            mode = where(self.entered < 0.5, mode, SLIP)
        leaving = ca.logic_and(mode > STICK, self.mode < GAP)
        discrete = [mode, where(leaving, self.travel, self.furthest)]
        if self.structure.entry:
            inside = self.travel >= self.q["height"] * (1.0 - _BESIDE)
            discrete.append(where(inside, 1.0, self.entered))
        return [self.travel, slowed, *rest], discrete

    def start(self) -> tuple[list[Expression], list[Expression]]:
        """Return the states and the discrete variables at the start."""
        structure = self.structure
        p = self.q | ({"tow_speed": self.input} if self.by_speed else {})
        first, rate = start_deflection(structure, p), start_rate(structure, p)
        travel, speed = (0.0 if self.by_speed else self.input) - first, start_speed(structure, p) - rate
        x = [travel, speed, *([first] if self.by_speed else [])]
        if not structure.events:
            return x, []
        mode: Expression = SLIP
        if self.sticks:
            buried: Parameters = {"entered": 0.0, "behind": 0.0} if structure.entry else {}
            held = pull(structure, p, first, rate) < hold(structure, {**p, **buried}, travel)
            mode = where(speed > 0.0, SLIP, where(held, STICK, SLIP))
        return x, [mode, travel, *([0.0] if structure.entry else [])]
