"""The exported share at one moment: states, input and modes as symbols, and the expressions that an FMU evaluates.

The states are travel L, speed L' and, if the input is the strut's speed s', the spring's deflection z with the rate
s' - L'. As a state z is not the small difference of two large travels; the strut's path is then L + z. If the input is
the path s itself, the deflection is s - L. Three variables change only at events: the mode, the furthest travel, and
whether an entering share is wholly in the soil.
"""

import casadi as ca

from plough_opt.core.expressions import Column, Expression, absolute, where
from plough_opt.motion.effects.terms import Parameters
from plough_opt.motion.equation import GAP, SLIP, STICK, Structure
from plough_opt.motion.scene import Scene

# Speeds below this part of the scene's speed, and distances below this part of the share's height, are rounding.
_ROUNDING = 1e-12
# A tool may stop before or after an event by a speed or distance of this part.
_EVENT_TOLERANCE = 1e-9


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
