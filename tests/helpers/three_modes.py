"""Motion of a share by SciPy, in its travel L and speed L' in SI units, for every contact law and with entry.

Slip, stick and gap are integrated piece by piece; each event is found on the interpolant, and then sharpened by Newton
steps that integrate anew, for the interpolant is of lower order than the method.
"""

import functools
import itertools
import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import plough_opt as po
from helpers.forces import GAP, SLIP, STICK, Forces
from helpers.scenes import AVERAGES

TIGHT = 1e-12


class Change(NamedTuple):
    """An event: when and where, and between which modes."""

    time: float
    old: int
    new: int
    travel: float


class Motion(SimpleNamespace):
    """Results by their names in a `Run`, and the events."""

    def near_a_change(self, within):
        """Tell of each output time whether an event is that near [s]."""
        moments = np.array([change.time for change in self.changes] or [-np.inf])
        return np.min(np.abs(self.time[:, None] - moments), axis=1) < within

    def count(self, old, new):
        """Return how many events lead from one mode to another."""
        return sum((change.old, change.new) == (old, new) for change in self.changes)


class _Share(Forces):
    """The forces of a scene, the rates of its motion and the ends of its modes."""

    def rates(self, mode, about):
        """Return the rate of (L, L', sums of P, z, their squares about a mean, and P s')."""
        mean_force, mean_deflection = about

        def rate(t, x):
            travel, v = x[0], x[1]
            path, tow = self.strut(t)
            z = path - travel
            force = self.k * z + self.c * (tow - v)
            a = self.acceleration(mode, force, travel, v)
            return [v, a, force, z, (force - mean_force) ** 2, (z - mean_deflection) ** 2, force * tow]

        return rate

    def slows(self, t, x):
        """Return the force that speeds a slipping share up, less its rounding, which changes sign without end."""
        return self.pull(t, x[0], x[1]) - self.soil(x[0], x[1]) - 1e-11 * self.static

    def ends(self, mode, furthest, entered):
        """Return, by name, what crosses 0 upwards when a mode, or the entry, ends."""

        # An event counts only where the share moves towards it, so that none repeats at its own start.
        def halts(t, x):
            return -x[1] if self.slows(t, x) < 0.0 else -1.0

        found = []
        if self.breakaway is not None:
            if mode == SLIP:
                # A stop so short that both its crossings lie in one step shows where the slowing down ends.
                found += [("stop", halts), ("turn", self.slows)]
            elif mode == STICK:
                found.append(("move", lambda t, x: self.pull(t, x[0], 0.0) - self.hold(x[0])))
            else:
                found.append(("capture", lambda _, x: x[0] - furthest if x[1] > 0.0 else -1.0))
        if self.entry and not entered and mode != STICK:
            found.append(("buried", lambda _, x: x[0] - self.height))
            if self.breakaway is None and math.isinf(self.behind):
                found.append(("back", halts))
            elif self.breakaway is None:
                found.append(("forth", lambda _, x: x[0] - self.behind if x[1] > 0.0 else -1.0))
        return found


def follow(scene, duration, outputs=20, tolerance=TIGHT):
    """Return the `Motion` of a numeric scene."""
    share = _Share(scene)
    times = np.linspace(0.0, duration, outputs + 1)
    means, squares = np.array([share.static, share.static / share.k]), None
    for allowed in (1e3 * tolerance, 1e2 * tolerance, tolerance):
        # Squares about the mean that the pass before found, integrated relative to themselves.
        columns, changes = _path(share, (duration, times), (means, squares), allowed)
        sums, before = columns[:7, -1], means
        means = sums[2:4] / duration
        squares = np.maximum(sums[4:6] - duration * (means - before) ** 2, 0.0)
    spreads = np.sqrt(squares / duration)
    averages = means[0], spreads[0], means[1], spreads[1], sums[6] / duration
    names = ("travel", "speed", "mode", "opening", "mount_force", "soil_resistance")
    arrays = dict(zip(names, (*columns[:2], *columns[7:]), strict=True))
    arrays |= {"time": times, "deflection": np.array([share.strut(t)[0] for t in times]) - columns[0]}
    return Motion(**arrays, **dict(zip(AVERAGES, averages, strict=True)), changes=tuple(changes))


def agreed(scene, duration, outputs=10, allowed=2e-8, resistance=1.0):
    """Return a run and the `Motion` that it agrees with: force, resistance, averages, power, and modes if any.

    A run promises 1e-8 of both force and averages; the motion is exact to some 1e-11 of them.

    Args:
        scene: numeric, with motion.
        duration: of the run [s].
        outputs: at which they are compared.
        allowed: difference in parts of the largest mount force, and of the mean draft or RMS.
        resistance: by how much more the soil's resistance may differ; modes and resistance jump at an event, and are
            compared off it, and so are speeds.
    """
    run, expected = po.simulate(scene, duration, outputs=outputs), follow(scene, duration, outputs=outputs)
    far = ~expected.near_a_change(1e-7 * duration)
    # The travel is rounded to 1e-16 of itself, which the spring turns into force.
    rounding = 1e-15 * abs(scene.stiffness) * np.max(np.abs(expected.travel))
    force = allowed * np.max(np.abs(expected.mount_force)) + rounding
    size = allowed * max(abs(expected.mean_draft), expected.force_rms) + rounding
    assert np.max(np.abs(run.mount_force - expected.mount_force)) <= force
    assert np.max(np.abs(run.soil_resistance - expected.soil_resistance)[far], initial=0.0) <= resistance * force
    soft = 1.0 / scene.stiffness
    for name, unit in zip(AVERAGES, (1.0, 1.0, soft, soft, scene.tow_speed), strict=True):
        assert abs(getattr(run, name) - getattr(expected, name)) <= unit * size, name
    fastest = np.max(np.abs(expected.speed))
    apart = np.max(np.abs(run.speed - expected.speed)[far], initial=0.0)
    assert apart <= 5.0 * allowed * resistance * fastest + 1e-12 * scene.tow_speed
    if isinstance(scene.effects.contact, po.StickSlip):
        assert list(np.round(run.mode[far])) == list(expected.mode[far])
        # The definition of each mode holds exactly.
        gap, stick = run.mode == GAP, run.mode == STICK
        assert np.all(run.speed[stick] == 0.0)
        assert np.all(run.soil_resistance[stick] == run.mount_force[stick])
        assert np.all(run.soil_resistance[gap] == 0.0)
        assert np.all((run.opening > 0.0) == gap)
        assert np.max(np.abs(run.opening - expected.opening)) <= allowed * np.max(np.abs(expected.deflection))
    return run, expected


def _path(share, when, about, tolerance):
    """Return columns at the output times and changes of mode.

    A column holds the state, the mode, the opening, the mount force and the soil's resistance.
    """
    (duration, times), (means, squares) = when, about
    share.behind = -math.inf
    travel, speed, mode = share.start()
    furthest, entered = travel, False
    hardness = math.sqrt(abs(share.k) * share.m)
    force = share.static + share.v0 * hardness + 1e-9
    z = force / abs(share.k)
    largest = duration * np.array([force, z]) ** 2
    known = largest if squares is None else np.clip(squares, 1e-12 * largest, largest)
    sums = [force * duration, z * duration, *known]
    sizes = np.array([z, force / hardness, *sums, force * max(share.v0 * duration, z)])
    # The travel's own size does not matter: it is its difference from the strut's path that pulls.
    relative = np.full(7, max(tolerance, 2.3e-14))
    relative[0] = 2.3e-14
    settings = {"method": "DOP853", "rtol": relative, "atol": tolerance * sizes}
    if share.breakaway is not None:
        # A stop of short duration lies between two crossings that a long step would take at once.
        turns = [math.sqrt(share.k / share.m), *(number * share.v0 for _, number, _ in share.waves)]
        settings["max_step"] = 0.1 / max(turns)
    # After a turn the next is not looked for at once, or rounding would find the same again.
    turned, rest = -math.inf, 1e-3 * settings.get("max_step", 0.0)
    stops = sorted({*times, *([share.ramp] if 0.0 < share.ramp < duration else [])})
    x, columns, changes = np.array([travel, speed] + [0.0] * 5), [], []

    def note(t):
        pull = share.pull(t, x[0], x[1])
        resistance = pull - share.m * share.acceleration(mode, pull, x[0], x[1])
        columns.append([*x, mode, furthest - x[0] if mode == GAP else 0.0, pull, resistance])

    note(0.0)
    for now, end in itertools.pairwise(stops):
        while now < end:
            ends = share.ends(mode, furthest, entered)
            until = end
            if now < turned + rest:
                ends, until = [one for one in ends if one[0] != "turn"], min(end, turned + rest)
            before = now, x
            now, x, which = _piece(share.rates(mode, means), (now, until), x, ends, settings)
            if which == "turn" and x[1] < 0.0:
                last = now - 1e-5 * (now - before[0])
                now, x, which = _piece(share.rates(mode, means), (before[0], last), before[1], ends[:1], settings)
            if which in (None, "turn", "back", "forth", "buried"):
                turned, entered = (now if which == "turn" else turned), entered or which == "buried"
                share.behind = {"back": x[0], "buried": x[0], "forth": -math.inf}.get(which, share.behind)
                continue
            pull, old = share.pull(now, x[0], 0.0 if mode == STICK else x[1]), mode
            x = x.copy()
            if mode == SLIP:
                x[1], mode = 0.0, (GAP if pull < 0.0 else STICK if pull <= share.hold(x[0]) else SLIP)
                furthest = x[0]
            elif mode == STICK:
                x[1], mode = 0.0, SLIP
            else:
                x[0], mode = furthest, SLIP
                x[1] *= share.m / (share.m + share.carried(x[0]))
                entered = entered or x[0] >= share.height
            changes.append(Change(now, old, mode, x[0]))
            assert len(changes) < 100_000, "events without end"
        if end in times:
            note(end)
    return np.array(columns).T, changes


def _piece(rate, span, x, ends, settings):
    """Integrate to the end of a span or to the first event; return time, state and which event."""
    events = [functools.partial(function) for _, function in ends]
    for event in events:
        event.terminal, event.direction = True, 1.0
    done = solve_ivp(rate, span, x, events=events or None, **settings)
    assert done.success, done.message
    if done.status == 0:
        return span[1], done.y[:, -1], None
    moment, which = min((t[0], k) for k, t in enumerate(done.t_events) if len(t))
    which, function = ends[which]
    # The last step starts at the last time but one; from there integrate anew to the event, twice corrected.
    before, base = done.t[-2], done.y[:, -2]
    at = moment
    for correct in (True, True, False):
        state = solve_ivp(rate, (before, at), base, **settings).y[:, -1] if at > before else base
        value = function(at, state)
        step = 1e-7 * (at - before) or 1e-12
        slope = (function(at + step, state + step * np.array(rate(at, state))) - value) / step
        correction = value / slope if abs(slope) > 0.0 else 0.0
        if not correct or not abs(correction) < 0.1 * (at - before) or abs(correction) <= 4e-16 * at:
            break
        at -= correction
    return at, state, which
