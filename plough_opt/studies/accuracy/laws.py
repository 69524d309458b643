"""The motion of a share in smooth pieces, in the widest floats: each piece with its forces and with what ends it.

Written from equation (27), M L'' = P - F(L, L') with P = k0 z + c z', in the spring's deflection z = s - L, and from
the contact laws of `plough_opt.motion.effects`; it shares nothing with the graphs of `plough_opt.motion`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.motion.effects import OwnResistance, RestingResistance, Smooth, StickSlip
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.picard import EPS, PI, WIDE, Acceleration, Step, Wide

SLIP: Final = 0
STICK: Final = 1
GAP: Final = 2

# Part of the smooth contact's width by which its step's polynomial is left late.
_LATE = WIDE(1e-4)
# Part of the tow speed below which a speed backwards is rounding: of a share that hardly begins to move.
_STANDSTILL = 2 * EPS


@dataclass(frozen=True)
class Piece:
    """The law that holds until the next event.

    Attributes:
        ramping: whether the strut's speed still rises.
        mode: slip, stick or gap.
        zone: of a smooth contact, -1 where it does not resist, 0 where its step rises, 1 where it resists fully.
        following: whether the buried length is the travel itself; else it is ``depth``.
        depth: buried length H of a share that is wholly buried, or retreats while it enters [m].
        furthest: furthest travel of a share that sticks, or is behind a gap, or retreats while it enters [m].
    """

    ramping: bool
    mode: int
    zone: int
    following: bool
    depth: Wide
    furthest: Wide


@dataclass(frozen=True)
class Laws:
    """Numbers of a scene, in SI units, and the laws of each `Piece`; ``width`` and ``breakaway`` may be None.

    ``waves`` has amplitude, wave number [rad/m] and phase [rad] of each strength wave.
    """

    stiffness: Wide
    damping: Wide
    mass: Wide
    added_mass: Wide
    static: Wide
    drag: Wide
    rate: Wide
    tow_speed: Wide
    ramp: Wide
    waves: tuple[tuple[Wide, Wide, Wide], ...]
    height: Wide
    width: Wide | None
    breakaway: Wide | None
    entry: bool
    start: str
    own: tuple[OwnResistance, ...]

    @classmethod
    def of(cls, scene: Scene) -> Laws:
        """Read them off a numeric scene with a motion.

        Raises:
            InputError: no motion, or an own resistance that loses digits.
        """
        effects, reaction = scene.effects, scene.reaction
        if not effects.motion:
            raise InputError("a quasi-static scene has no motion to follow")
        contact = effects.contact
        laws = cls(
            stiffness=_wide(scene.restoring_stiffness),
            damping=_wide(effects.damping),
            mass=_wide(scene.mass),
            added_mass=_wide(reaction.added_mass),
            static=_wide(reaction.static),
            drag=_wide(reaction.drag),
            rate=_wide(effects.rate_term),
            tow_speed=_wide(scene.tow_speed),
            ramp=_wide(effects.tow_ramp),
            waves=tuple(
                (_wide(wave.amplitude), 2 * PI / _wide(wave.wavelength), _wide(wave.phase)) for wave in effects.waves
            ),
            height=_wide(scene.cone.height),
            width=_wide(contact.width) if isinstance(contact, Smooth) else None,
            breakaway=_wide(contact.breakaway) if isinstance(contact, StickSlip) else None,
            entry=effects.entry,
            start=effects.start,
            own=effects.own,
        )
        laws._check_own()
        return laws

    def _check_own(self) -> None:
        """Refuse own resistances that do not compute in the widest floats."""
        for effect in self.own:
            try:
                found = np.asarray(effect.force(np.full(2, WIDE(0.1)), np.full(2, self.tow_speed)))
            except (TypeError, NotImplementedError, AttributeError) as error:
                raise InputError(f"own resistance {effect!r} takes no wide floats: {error}") from None
            if found.ndim and found.dtype != WIDE:
                raise InputError(f"own resistance {effect!r} computes in {found.dtype}, not in the widest floats")

    @property
    def wavenumber(self) -> Wide:
        """Of the shortest strength wave [rad/m], 0 without one."""
        return max((turn for _, turn, _ in self.waves), default=WIDE(0))

    @property
    def steady(self) -> bool:
        """Whether the share starts in steady sliding."""
        return self.start == "equilibrium" and not self.ramp > 0

    # --- strut and soil ---

    def strut(self, t: Wide, piece: Piece) -> tuple[Wide, Wide, Wide]:
        """Return path, speed and acceleration of the strut."""
        v = self.tow_speed
        if not piece.ramping:
            return v * (t - self.ramp / 2), v + 0 * t, 0 * t
        u = t / self.ramp
        path = v * self.ramp * u**4 * (WIDE(2.5) + u * (u - 3))
        return path, v * u**3 * (10 + u * (6 * u - 15)), v / self.ramp * 30 * u**2 * (1 - u) ** 2

    def step(self, speed: Wide, zone: int) -> Wide:
        """Return the smooth step of the share's speed, as the zone has it."""
        if self.width is None or zone == 1:
            return WIDE(1)
        if zone == -1:
            return WIDE(0)
        u = speed / self.width
        return u**5 * (126 + u * (u * (540 + u * (70 * u - 315)) - 420))

    def buried(self, travel: Wide, piece: Piece) -> Wide:
        """Return the part of the height that is buried."""
        if not self.entry:
            return WIDE(1)
        return (travel if piece.following else piece.depth) / self.height

    def resistance(self, travel: Wide, speed: Wide, piece: Piece) -> Wide:
        """Return the soil's force on a share that slips, without the added mass."""
        force = self.static * (1 + self.rate * speed**2)
        if self.waves:
            force = force * (1 + sum(size * np.sin(turn * travel + shift) for size, turn, shift in self.waves))
        force = self.step(speed, piece.zone) * self.buried(travel, piece) ** 2 * (force + self.drag * speed**2)
        for effect in self.own:
            force = force + effect.force(travel, speed)
        return force

    def inertia(self, travel: Wide, piece: Piece) -> Wide:
        """Return the mass of the share and of the soil that it carries."""
        return self.mass + self.added_mass * self.buried(travel, piece) ** 3

    def pull(self, z: Wide, rate: Wide) -> Wide:
        """Return the mount force P."""
        return self.stiffness * z + self.damping * rate

    def felt(self, z: Wide, rate: Wide, share: tuple[Wide, Wide], piece: Piece) -> Wide:
        """Return the soil's force with the added mass's part, at z, z', and the share's travel and speed."""
        pull = self.pull(z, rate)
        if piece.mode == STICK:
            return pull
        if piece.mode == GAP:
            return 0 * pull
        net = pull - self.resistance(*share, piece)
        return pull - self.mass * net / self.inertia(share[0], piece)

    def hold(self, travel: Wide, piece: Piece) -> Wide:
        """Return the mount force at which a share that sticks breaks loose."""
        assert self.breakaway is not None  # else no share sticks
        soil = self.breakaway * replace(self, own=()).resistance(travel, WIDE(0), piece)
        own = (effect.at_rest(travel) for effect in self.own if isinstance(effect, RestingResistance))
        return soil + sum(own, WIDE(0))

    def law(self, piece: Piece) -> Callable[[Wide], Acceleration]:
        """Return what gives z'' at times of a step."""

        def at(times: Wide) -> Acceleration:
            path, speed, tow = self.strut(times, piece)

            def slip(z: Wide, rate: Wide) -> Wide:
                travel, own = path - z, speed - rate
                net: Wide = self.pull(z, rate) - self.resistance(travel, own, piece)
                return tow - net / self.inertia(travel, piece)

            def gap(z: Wide, rate: Wide) -> Wide:
                return tow - self.pull(z, rate) / self.mass

            return {SLIP: slip, STICK: lambda _z, _rate: tow, GAP: gap}[piece.mode]

        return at

    # --- pieces ---

    def first(self) -> tuple[Piece, Wide, Wide]:
        """Return the first piece, and z and z' at the start."""
        ramping = self.ramp > 0
        nothing = WIDE(0)
        piece = Piece(bool(ramping), SLIP, 1, self.entry, self.height, nothing)
        tow = nothing if ramping else self.tow_speed
        speed = nothing if self.start == "rest" else tow
        z = nothing
        if self.start == "equilibrium":
            # The strength wave has no part in the state that a start takes for steady.
            steady = replace(self, waves=())
            z = steady.resistance(nothing, tow, replace(piece, zone=self._zone(tow))) / self.stiffness
        piece = replace(piece, zone=self._zone(speed), depth=nothing if self.entry else self.height, furthest=-z)
        rate = tow - speed
        if self.breakaway is not None and not speed > 0 and self.pull(z, rate) < self.hold(-z, piece):
            piece = replace(piece, mode=STICK)
        return piece, z, rate

    def _zone(self, speed: Wide) -> int:
        if self.width is None or speed >= self.width:
            return 1
        return 0 if speed > 0 else -1

    def ends(self, piece: Piece, step: Step) -> dict[str, Callable[[Wide], Wide]]:
        """Return, by name, functions of time that are positive, and become negative where the piece ends."""

        def speed(t: Wide) -> Wide:
            return self.strut(t, piece)[1] - step.at(t)[1]

        def travel(t: Wide) -> Wide:
            return self.strut(t, piece)[0] - step.at(t)[0]

        def behind(t: Wide) -> Wide:
            return piece.furthest - travel(t)

        if piece.mode == STICK:
            return {"move": lambda t: self.hold(piece.furthest, piece) - self.pull(*step.at(t))}
        if piece.mode == GAP:
            return {"recapture": behind}
        found: dict[str, Callable[[Wide], Wide]] = {}
        if self.breakaway is not None:
            found["stop"] = lambda t: speed(t) + _STANDSTILL * self.tow_speed
        if self.width is not None:
            found |= self._zone_ends(piece.zone, self.width, speed)
        if piece.following:
            found["buried"] = lambda t: self.height - travel(t)
            if self.breakaway is None:
                found["retreat"] = speed
        elif self.entry and piece.depth < self.height:
            found["advance"] = behind
        return found

    @staticmethod
    def _zone_ends(zone: int, width: Wide, speed: Callable[[Wide], Wide]) -> dict[str, Callable[[Wide], Wide]]:
        if zone == -1:
            return {"resists": lambda t: -speed(t)}
        if zone == 1:
            return {"yields": lambda t: speed(t) - width}
        # The step's polynomial is left a little late, where it is still 0 or 1 to 1e-18: no event repeats at once.
        late = _LATE * width
        return {"resists fully": lambda t: width + late - speed(t), "lets go": lambda t: speed(t) + late}

    def after(self, name: str, piece: Piece, t: Wide, z: Wide, rate: Wide) -> tuple[Piece, Wide, Wide]:
        """Return piece, z and z' after an event."""
        path, tow, _ = self.strut(t, piece)
        travel = path - z
        zones = {"resists": 0, "yields": 0, "resists fully": 1, "lets go": -1}
        if name in zones:
            return replace(piece, zone=zones[name]), z, rate
        if name == "buried":
            return replace(piece, following=False, depth=self.height), z, rate
        if name in ("retreat", "advance"):
            return replace(piece, following=name == "advance", depth=travel, furthest=travel), z, rate
        if name == "move":
            return replace(piece, mode=SLIP), z, tow
        if name == "recapture":
            taken_up = (tow - rate) * self.mass / self.inertia(piece.furthest, piece)
            return replace(piece, mode=SLIP), path - piece.furthest, tow - taken_up
        pull = self.pull(z, rate)
        mode = GAP if pull < 0 else STICK if pull <= self.hold(travel, piece) else SLIP
        return replace(piece, mode=mode, furthest=travel), z, tow


def _wide(value: object) -> Wide:
    """Return a scene's number, or zero for what it lacks."""
    return WIDE(0.0 if value is None else float(as_number(value)))
