"""The exported share at one moment: its states, inputs and modes as symbols, and expressions of them.

The states are travel L, speed L' and, if the strut's speed is the input, the spring's deflection z, whose rate is
s' - L'; so z is not the difference of two large travels. The strut's path is then L + z. If that path s is the input,
the deflection is s - L. The mode, the furthest travel, and whether an entering share is wholly in the soil change only
at events.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca

from plough_opt.core.expressions import Expression, absolute
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

StrutInput = Literal["speed", "position"]

# Parts of the scene's speed and of the share's height below which a difference is rounding, and by which a tool may
# stop before or after an event.
_ROUNDING = 1e-12
_BESIDE = 1e-9


class Share:
    """The share at one moment: symbols, and expressions of them."""

    def __init__(self, scene: Scene, structure: Structure, kind: StrutInput, q: dict[str, ca.SX]) -> None:
        """Make the symbols."""
        self.structure, self.kind, self.q = structure, kind, q
        self.time, self.input = ca.SX.sym("time"), ca.SX.sym("input")
        self.travel, self.speed = ca.SX.sym("travel"), ca.SX.sym("speed")
        self.z = ca.SX.sym("deflection")
        self.mode, self.furthest, self.entered = ca.SX.sym("mode"), ca.SX.sym("furthest"), ca.SX.sym("entered")
        self.p = dict(q)
        if structure.entry:
            self.p |= {"entered": self.entered, "behind": self.opening}
        self.scales = (scene.tow_speed or 1.0, scene.cone.height)

    @property
    def x(self) -> ca.SX:
        """The states."""
        return ca.vertcat(self.travel, self.speed, *((self.z,) if self.kind == "speed" else ()))

    @property
    def d(self) -> ca.SX:
        """The variables that change only at events."""
        if not self.structure.events:
            return ca.SX(0, 1)
        return ca.vertcat(self.mode, self.furthest, *((self.entered,) if self.structure.entry else ()))

    @property
    def deflection(self) -> ca.SX:
        """Deflection z of the spring [m]."""
        return self.z if self.kind == "speed" else self.input - self.travel

    @property
    def opening(self) -> ca.SX:
        """How far the share is behind its furthest travel [m]."""
        return ca.if_else(self.mode > STICK, self.furthest - self.travel, 0.0)

    @property
    def strut_speed(self) -> Expression:
        """Speed of the strut [m/s], if that is the input."""
        p = self.p | {"tow_speed": self.input}
        return start_speed(self.structure, p) + strut(self.structure, p, self.time).gain

    @property
    def pull(self) -> Expression:
        """Mount force P [N]."""
        # Where the strut's place is the input there is no damper.
        rate = self.strut_speed - self.speed if self.structure.damper else 0.0
        return pull(self.structure, self.q, self.deflection, rate)

    @property
    def slipping(self) -> Expression:
        """Acceleration L'' of a share that slips [m/s^2]."""
        return (self.pull - self.steady) / inertia_at(self.structure, self.p, self.travel)

    @property
    def steady(self) -> Expression:
        """Resistance [N] without the added mass's part."""
        return resistance(self.structure, self.p, self.travel, self.speed)

    @property
    def carried(self) -> Expression:
        """Added mass [kg]."""
        if self.structure.events:
            return carried_mass(self.structure, self.p, self.travel)
        return self.q["added_mass"]

    @property
    def hold(self) -> Expression:
        """Mount force [N] at which a sticking share moves."""
        return hold(self.structure, self.p, self.travel)

    def by_mode(self, slip: Expression, stick: Expression, gap: Expression) -> Expression:
        """Choose by the mode."""
        rest = ca.if_else(self.mode < (STICK + GAP) / 2.0, stick, gap)
        return ca.if_else(self.mode < (SLIP + STICK) / 2.0, slip, rest)

    @property
    def sticks(self) -> bool:
        """Whether stick and gap are among the modes."""
        return self.structure.sticks

    @property
    def rates(self) -> ca.SX:
        """Rates of the states."""
        acceleration = self.slipping
        if self.sticks:
            acceleration = self.by_mode(acceleration, 0.0, self.pull / self.q["mass"])
        strut_rate = (self.strut_speed - self.speed,) if self.kind == "speed" else ()
        return ca.vertcat(self.speed, acceleration, *strut_rate)

    @property
    def resistance(self) -> Expression:
        """Resistance of the soil to the share [N], the added mass's part included."""
        force = self.steady + self.carried * self.slipping
        return self.by_mode(force, self.pull, 0.0) if self.sticks else force

    @property
    def outputs(self) -> ca.SX:
        """The results beside states and modes."""
        place = self.travel + self.z if self.kind == "speed" else self.deflection
        return ca.vertcat(self.pull, self.resistance, place, *((self.opening,) if self.structure.events else ()))

    @property
    def indicators(self) -> ca.SX:
        """Expressions that are negative once an event has happened."""
        if not self.structure.events:
            return ca.SX(0, 1)
        stopping = self.speed + _ROUNDING * self.scales[0]
        closing = self.opening + _ROUNDING * self.scales[1]
        if self.sticks:
            hold = self.hold
            indicators: list[Expression] = [
                self.by_mode(stopping, hold - self.pull, closing),
                self.by_mode(1.0, self.pull + _ROUNDING * absolute(hold), 1.0),
            ]
        else:
            turning = ca.if_else(self.mode > STICK, closing, stopping)
            indicators = [ca.if_else(self.entered < 0.5, turning, 1.0)]
        if self.structure.entry:
            indicators.append(ca.if_else(self.entered < 0.5, self.q["height"] - self.travel, 1.0))
        return ca.SX(ca.vertcat(*indicators))

    def after_events(self) -> tuple[ca.SX, ca.SX]:
        """Return the states and the discrete variables after the events until now."""
        if not self.structure.events:
            return self.x, self.d
        stopped = ca.logic_and(self.speed <= _BESIDE * self.scales[0], self.slipping <= 0.0)
        closed = ca.logic_and(self.opening <= _BESIDE * self.scales[1], self.speed > 0.0)
        if self.sticks:
            hold = self.hold
            held = self.pull < hold - _BESIDE * absolute(hold)
            freed = ca.if_else(self.pull < 0.0, GAP, ca.if_else(held, STICK, SLIP))
            mode = self.by_mode(ca.if_else(stopped, freed, SLIP), freed, ca.if_else(closed, SLIP, GAP))
            mass = self.q["mass"]
            taken_up = self.speed * mass / (mass + self.carried)
            slowed = self.by_mode(ca.if_else(stopped, 0.0, self.speed), 0.0, ca.if_else(closed, taken_up, self.speed))
        else:
            turned = ca.if_else(stopped, GAP, SLIP)
            mode = ca.if_else(self.mode > STICK, ca.if_else(closed, SLIP, GAP), turned)
            mode = ca.if_else(self.entered < 0.5, mode, SLIP)
            slowed = self.speed
        leaving = ca.logic_and(mode > STICK, self.mode < GAP)
        furthest = ca.if_else(leaving, self.travel, self.furthest)
        discrete = [mode, furthest]
        if self.structure.entry:
            inside = self.travel >= self.q["height"] * (1.0 - _BESIDE)
            discrete.append(ca.if_else(inside, 1.0, self.entered))
        rest = (self.z,) if self.kind == "speed" else ()
        return ca.vertcat(self.travel, slowed, *rest), ca.vertcat(*discrete)

    def start(self) -> tuple[ca.SX, ca.SX]:
        """Return the states and the discrete variables at the start."""
        structure, p = self.structure, dict(self.q)
        if self.kind == "speed":
            p["tow_speed"] = self.input
        first, speed = start_deflection(structure, p), start_speed(structure, p) - start_rate(structure, p)
        place = 0.0 if self.kind == "speed" else self.input
        x = ca.vertcat(place - first, speed, *((first,) if self.kind == "speed" else ()))
        mode: Expression = SLIP
        if self.sticks:
            buried = {"entered": 0.0, "behind": 0.0} if structure.entry else {}
            held = hold(self.structure, p | buried, place - first)
            force = pull(structure, p, first, start_rate(structure, p))
            mode = ca.if_else(speed > 0.0, SLIP, ca.if_else(force < held, STICK, SLIP))
        discrete = (mode, place - first, *((0.0,) if structure.entry else ())) if structure.events else ()
        return x, ca.vertcat(*discrete) if discrete else ca.SX(0, 1)
