"""Reference motion of a scene, to all digits of the widest floats.

Each smooth piece of the motion is a chain of Chebyshev polynomials (`plough_opt.studies.accuracy.wide`). An event ends
a piece at the root of its polynomial. Averages are quadratures of the polynomials by the rule of
Clenshaw and Curtis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.assembly import assemble
from plough_opt.motion.equation import GAP, SLIP, STICK, equation_of_motion, signals, start_state
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, lightest_mass, parameters, start_deflection, start_resistance
from plough_opt.studies.accuracy.wide import (
    EPS,
    PI,
    WIDE,
    Basis,
    Step,
    Wide,
    WideGraph,
    first_end,
    in_wide_floats,
    step,
)

# Most steps of a whole motion; they take minutes.
_MOST_STEPS = 400_000
# Number of steps between two checks whether that will be enough.
_CHECKED_EVERY = 2000
# Events at one time after which the motion counts as stuck there.
_MOST_AT_ONCE = 12
# Shortest step, in parts of the duration.
_SHORTEST = 1e-16
# Part of a step's coefficients that should be above rounding. The length of the next step is chosen for that.
_USED = 0.9
# A smaller mismatch of a periodic orbit, in units in the last place, is rounding once it no longer shrinks.
_STALLED = 1e4
# Most iterations of Newton's method for a periodic orbit.
_MOST_ITERATIONS = 20
# Names of the events that end each mode of contact: with stick-slip, and for an entering share without it.
_ENDS_OF_CONTACT: Final = {SLIP: "stop", STICK: "move", GAP: "recapture"}
_ENDS_OF_ENTRY: Final = {SLIP: "retreat", GAP: "advance"}


@lru_cache(maxsize=8)
def _graphs(structure: Structure) -> tuple[dict[str, WideGraph], tuple[str, ...]]:
    """Return a structure's rates, events, signals and start in wide floats, and the names of their parameters."""
    motion, observed = equation_of_motion(structure), signals(structure)
    p = ca.SX.sym("p", len(observed.parameters))
    known = dict(zip(observed.parameters, ca.vertsplit(p), strict=True))
    own = ca.vertcat(*(known[name] for name in motion.names))
    time, state = ca.SX.sym("time"), ca.SX.sym("state", motion.states)
    seen = ca.vertcat(state[:2], state[-1]) if structure.ends_ramp else state[:2]
    events: Any = [] if motion.events is None else motion.events(time, state, own)
    at = [time, state, p]
    graphs = {
        "rates": in_wide_floats(at, [motion.function(time, state, own)]),
        "events": in_wide_floats(at, list(events)),
        "signals": in_wide_floats(at, [observed.function(time, seen, p)]),
        "start": in_wide_floats([p], [start_state(structure, known)]),
    }
    return graphs, observed.parameters


class Motion:
    """Equation of motion of a scene in the widest floats.

    Attributes:
        scene: the scene, with wide numbers.
        structure: terms of its equation of motion.
        p: parameters by name.
        swing: inverse of the largest angular frequency of the share on its mount [s].
        scales: sizes of the deviation w [m] and its rate w' [m/s], to which rounding is relative.
        ramp: end of the strut's ramp [s]; 0 if there is none, or its end is an event.
        start: state at time 0.
    """

    def __init__(self, scene: Scene) -> None:
        """Compute the parameters and the start of a scene with numbers.

        Raises:
            InputError: the scene is quasi-static, or approximates its periodic orbit.
        """
        if not scene.effects.motion:
            raise InputError("a quasi-static scene has no motion to integrate")
        if scene.effects.orbit not in ("transient", "periodic"):
            raise InputError(
                f"effects.orbit = '{scene.effects.orbit}' is an approximation of the periodic orbit: use 'periodic' for"
                " the reference"
            )
        speed = WIDE(scene.tow_speed)
        self.scene = replace(scene, stiffness=WIDE(scene.stiffness), mass=WIDE(scene.mass), tow_speed=speed)
        self.structure = Structure.of(scene)
        self._graph, names = _graphs(self.structure)
        self.p = {name: WIDE(value) for name, value in parameters(self.scene).items()}
        self._numbers = [self.p[name] for name in names]
        stiffness = abs(self.p["stiffness"])
        hardness = np.sqrt(stiffness * lightest_mass(self.p))
        self.swing = hardness / stiffness
        # Rounding comes from the forces and, unless the start is steady, from the speed that the mount must take up.
        # Soil without resistance leaves the rounding of the latter.
        steady = self.structure.start == "equilibrium" and not self.structure.ramp
        least = speed * hardness * (EPS if steady else 1)
        force = start_resistance(self.structure, self.p) + least
        self.scales = np.array([force / stiffness, force / hardness])
        self.ramp = WIDE(0) if self.structure.ends_ramp else self.p.get("ramp_time", WIDE(0))
        self.start: Wide = self._graph["start"](self._numbers)[0][:, 0]

    def rates(self, times: Wide, states: Wide) -> Wide:
        """Return the rates of the states, a row each, at times."""
        return self._graph["rates"]([times], states, self._numbers)[0]

    def signals(self, times: Wide, states: Wide) -> Wide:
        """Return the signals that are averaged, a row each, at times."""
        return self._graph["signals"]([times], states, self._numbers)[0]

    def names(self, state: Wide) -> list[str]:
        """Return the names of the events that can end the piece of motion beginning with a state."""
        if not self.structure.events:
            return []
        ends = _ENDS_OF_CONTACT if self.structure.sticks else _ENDS_OF_ENTRY
        counted = (term.state for term in self.structure.ending)
        return [ends[round(float(state[3]))], *("buried" if name == "entered" else str(name) for name in counted)]

    def next_event(self, state: Wide, done: Step, end: Wide) -> tuple[Wide, int | None]:
        """Return time and number of the event that ends a piece of motion in a step; without one, its end and None.

        Args:
            state: at the start of the piece, which decides the possible events.
            done: the step.
            end: of the step, or earlier [s].

        Raises:
            IntegrationError: a force that decides on the event is not finite.
        """

        def until(kind: int, times: Wide) -> Wide:
            values = self._graph["events"]([times], done.at(times), self._numbers)[0][kind]
            if not np.all(np.isfinite(values)):
                raise _stopped("stops", done.start, "a force is not finite there")
            return values

        first = None
        for kind in range(len(self.names(state))):
            found = first_end(partial(until, kind), done.start, end - done.start)
            if found is not None and (first is None or found < end):
                end, first = found, kind
        return end, first

    def after(self, kind: int, time: Wide, state: Wide) -> Wide:
        """Return the state after an event.

        Args:
            kind: number of the event.
            time: of the event [s].
            state: before the event.
        """
        columns = self._graph["events"]([np.array([time])], state[:, None], self._numbers)[1]
        return columns.reshape(-1, len(state))[kind]


@dataclass(frozen=True)
class IntegratedMotion:
    """Integrated motion.

    Attributes:
        motion: its equation.
        times: output times [s].
        states: states at the output times, a row each.
        events: time and name of each event.
        moments: means of the signals, and variances of those with an RMS.
    """

    motion: Motion
    times: Wide
    states: Wide
    events: tuple[tuple[Wide, str], ...]
    moments: tuple[Wide, Wide]

    def run(self) -> Run:
        """Return the run of the scene that has these states and averages."""
        motion, duration = self.motion, self.times[-1]
        known = motion.structure, dict(motion.p)
        fractions = self.times / duration
        return assemble(motion.scene, duration, fractions, self.states, *self.moments, Accuracy(), known)


def follow(motion: Motion, duration: Wide, outputs: int, degree: int, first: Wide | None = None) -> IntegratedMotion:
    """Integrate a motion once.

    Args:
        motion: equation of motion.
        duration: simulated time [s].
        outputs: number of equal intervals between output times.
        degree: degree of the polynomials.
        first: state at the start; default that of the scene.

    Raises:
        IntegrationError: steps or pauses between events become too short, or too many steps are needed.
    """
    state = motion.start if first is None else first
    times = duration * np.arange(outputs + 1) / WIDE(outputs)
    # Rounding may put the last output behind the end, which no step reaches.
    times[-1] = duration
    states: list[Wide] = []
    integrals: list[tuple[Wide, Wide]] = []
    events: list[tuple[Wide, str]] = []
    now, size, at_once, steps = WIDE(0), motion.swing, 0, 0
    while now < duration:
        stop = motion.ramp if now < motion.ramp < duration else duration
        # The last step is a little longer rather than leaving almost nothing for another one.
        whole = stop - now <= size * WIDE(1.001)
        done = step(degree, now, stop - now if whole else size, state, motion.rates, motion.scales)
        if done is None:
            size = min(size, stop - now) / 2
            if size < _SHORTEST * duration:
                raise _stopped("stops", now, "the forces are not smooth there")
            continue
        steps += 1
        if steps % _CHECKED_EVERY == 0 and now * _MOST_STEPS < steps * duration:
            raise _stopped(f"would take more than {_MOST_STEPS} steps", now, "the forces change too fast there")
        end, kind = motion.next_event(state, done, stop if whole else now + size)
        states += list(done.at(times[len(states) : int(np.searchsorted(times, end, "right"))]).T)
        integrals.append(_integrands(motion, done, end))
        at_once = at_once + 1 if kind is not None and end - now <= 4 * EPS * end else 0
        if at_once > _MOST_AT_ONCE:
            raise _stopped("hangs", now, "events repeat endlessly")
        names = motion.names(state)
        now, state = end, done.at(np.array([end]))[:, 0]
        if kind is not None:
            events.append((now, names[kind]))
            state = motion.after(kind, now, state)
        if not whole or done.used > _USED:
            size = done.size * WIDE(min(2.0, max(0.5, _USED / max(done.used, 0.1))))
    return IntegratedMotion(motion, times, np.array(states), tuple(events), _moments(motion, integrals))


def _stopped(what: str, now: Wide, why: str) -> IntegrationError:
    return IntegrationError(f"the reference {what} at t = {float(now):.6g} s: {why}")


def _integrands(motion: Motion, done: Step, end: Wide) -> tuple[Wide, Wide]:
    """Return weights of an integral over a step up to its end or an event [s], and the signals at its nodes.

    The rule of Clenshaw and Curtis has twice the degree of the polynomials, because variances are squares.
    """
    basis = Basis.of(2 * done.coefficients.shape[1] - 2)
    half = (end - done.start) / 2
    inner = done.start + half * (basis.nodes + 1)
    return half * basis.integral[-1], motion.signals(inner, done.at(inner))


def _moments(motion: Motion, integrals: list[tuple[Wide, Wide]]) -> tuple[Wide, Wide]:
    """Return means and variances of the signals; two passes avoid cancellation."""
    weights, values = (np.concatenate(parts, axis=-1) for parts in zip(*integrals, strict=True))
    shares = weights / np.sum(weights)
    means = values @ shares
    return means, (values - means[:, None])[: signals(motion.structure).squared] ** 2 @ shares


def orbit(motion: Motion, guess: Wide, outputs: int, degree: int) -> IntegratedMotion:
    """Return the periodic orbit near a state, by Newton's method on the motion over one period.

    Args:
        motion: equation of motion.
        guess: state near the orbit's start.
        outputs: number of equal intervals between output times.
        degree: degree of the polynomials.

    Raises:
        IntegrationError: no orbit was found.
    """
    period, speed, state = motion.scene.wave_period, motion.scene.tow_speed, guess
    unit = np.array([abs(state[0]) + speed * period / (2 * PI), speed])

    def after(first: Wide) -> Wide:
        return follow(motion, period, 1, degree, first).states[-1]

    nudges = np.diag(WIDE(math.sqrt(EPS)) * unit)
    columns = [(after(guess + nudge) - after(guess - nudge)) / (2 * np.max(nudge)) for nudge in nudges]
    slope, least = np.array(columns, float).T - np.eye(2), np.inf
    for _ in range(_MOST_ITERATIONS):
        miss = after(state) - state
        size = float(np.max(np.abs(miss) / unit))
        if size <= 2 * EPS or (size < _STALLED * EPS and size >= least):
            return follow(motion, period, outputs, degree, state)
        least = size
        # The guess and a step have the digits of a double: each step adds as many again.
        state = state - np.linalg.solve(slope, miss.astype(float))
    raise IntegrationError("no periodic orbit was found near that of the simulation")


def state_near_orbit(scene: Scene) -> Wide:
    """Return a state near the periodic orbit by simulation; it decides which orbit is found, not its digits."""
    run = simulate(scene, outputs=1)
    first = start_deflection(Structure.of(scene), parameters(scene))
    return np.array([run.deflection[0] - first, float(scene.tow_speed) - run.speed[0]], WIDE)
