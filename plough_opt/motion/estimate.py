"""How far a run may be off: by another run of its scene, and by stops that both may have passed over.

An integrator sees an event where a sign changes from one step to the next; a share whose speed falls below zero for
less than a step shows none, in a run and in its check alike. Between outputs the speed is read as a polynomial from
speeds and accelerations.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import SLIP
from plough_opt.motion.run import Run
from plough_opt.motion.timeline import hermite

TELLING: Final = 1e-6
"""Estimated relative error [-] beyond which a run says so in words, unless a larger one was wanted."""

# Part of a run's own scales of force, deflection and speed below which a quantity is their rounding, times a hundred
# million: a quantity so small counts relative to that part, and its rounding by less than 1e-8.
_LEAST = 1e-7

# Errors of polynomials through speeds and accelerations, of two outputs and of four around, halfway between them, in
# parts of the largest speed for an oscillation of 1 rad an interval: 1/4^2/4!, and (3/4)^4/8! rounded up.
_TWO: Final = 3e-3
_FOUR: Final = 1e-5


def difference(run: Run, other: Run) -> float:
    """Return the largest relative difference of any quantity of two runs with the same output times.

    Each counts on its own scale: an array (mount force, soil resistance, deflection, speed), and with it its peak, by
    its largest difference relative to its largest value; travel and opening relative to the largest deflection too; an
    RMS relative to itself; a mean relative to the larger of itself and the RMS; the tow power relative to the larger of
    itself and that force at the strut's mean speed. Speed and soil resistance jump at an event, and count at outputs at
    which both runs are in the same mode.
    """
    ours, apart = _arrays(run), _arrays(other)
    apart -= ours
    if run.scene.effects.events:
        apart[[1, 3]] *= run.mode == other.mode
    wrong: list[float] = np.abs(apart).max(axis=1).tolist()
    largest: list[float] = np.abs(ours).max(axis=1).tolist()
    # A share that sticks has a travel of rounding.
    largest[4] = max(largest[4], largest[2])
    force, deflection, speed = _scales(run, largest)
    found, check = ({name: float(value) for name, value in vars(one.averages).items()} for one in (run, other))
    least, least_z = _LEAST * force, _LEAST * deflection
    leasts = (least, least, least_z, _LEAST * speed, least_z)
    pairs = [(change, max(scale, low)) for change, scale, low in zip(wrong, largest, leasts, strict=True)]
    size = max(abs(found["mean_draft"]), found["force_rms"], least)
    size_z = max(abs(found["mean_deflection"]), found["displacement_rms"], least_z)
    sizes = {
        "mean_draft": size,
        "force_rms": max(found["force_rms"], least),
        "mean_deflection": size_z,
        "displacement_rms": max(found["displacement_rms"], least_z),
    }
    if run.scene.effects.ramps:
        towed = (run.travel[-1] + run.deflection[-1] - run.travel[0] - run.deflection[0]) / run.duration
        sizes["tow_power"] = max(abs(found["tow_power"]), size * float(towed))
    pairs += [(abs(found[name] - check[name]), scale) for name, scale in sizes.items()]
    if run.scene.effects.events:
        pairs.append((float(np.abs(run.opening - other.opening).max()), max(largest[2], least_z)))
    if not all(math.isfinite(change) for change, _ in pairs):
        return math.inf
    return max((float(change / scale) for change, scale in pairs if change > 0.0), default=0.0)


def _arrays(run: Run) -> NDArray[np.float64]:
    """Return mount force, soil resistance, deflection, speed and travel at the outputs, a row each."""
    rows = np.empty((5, len(run.time)))
    # A user's own resistance may be one number for all times.
    rows[0], rows[1], rows[2], rows[3] = run.mount_force, run.soil_resistance, run.deflection, run.speed
    rows[4] = run.travel
    return rows


def _scales(run: Run, largest: list[float]) -> tuple[float, float, float]:
    """Return the scales of force [N], deflection [m] and speed [m/s] of a motion, at which its numbers round."""
    scene = run.scene
    stiffness = float(scene.stiffness)
    force = max(largest[0], largest[1], stiffness * largest[2])
    if not scene.effects.motion:
        return force, force / stiffness, largest[3]
    return force, force / stiffness, max(largest[3], force / math.sqrt(stiffness * float(scene.inertia)))


def unseen(run: Run, rate: float, error: float) -> float:
    """Return by how much of its largest speed a motion may change at most by a stop that was passed over [-].

    Where the speed may be zero, the share may have stopped. It would have gone on at once, behind a gap
    if the mount had pulled it back by then, for a time in which no soil resists; with a breakaway ratio above 1 it
    would have been held until the mount pulled so much more.

    Args:
        run: under any contact.
        rate: fastest angular frequency of the motion [rad/s].
        error: estimated relative error [-] of its speeds.
    """
    scene = run.scene
    contact = scene.effects.contact
    if not isinstance(contact, StickSlip) or len(run.time) < 2:
        return 0.0
    interval = float(run.time[1] - run.time[0])
    fastest, acceleration = float(np.max(np.abs(run.speed))), (run.mount_force - run.soil_resistance) / scene.mass
    slips = (run.mode[:-1] == SLIP) & (run.mode[1:] == SLIP)
    turns = np.flatnonzero(slips & (acceleration[:-1] < 0.0) & (acceleration[1:] > 0.0))
    doubt = 0.0
    for k in turns.tolist():
        part = _turning(run.speed[k : k + 2], interval * acceleration[k : k + 2])
        first, count = (k - 1, 4) if 0 < k < len(slips) - 1 and slips[k - 1] and slips[k + 1] else (k, 2)
        around = slice(first, first + count)
        by_value, by_slope, *_ = hermite(np.arange(count, dtype=float)[None], np.array([k - first + part]))
        lowest = float(by_value[0] @ run.speed[around] + by_slope[0] @ acceleration[around] * interval)
        turned = rate * interval
        below = fastest * (error + (_TWO * turned**4 if count == 2 else _FOUR * turned**8)) - lowest
        if below > 0.0:
            doubt = max(doubt, _effect(run, k, below, float(contact.breakaway)))
    return doubt / fastest if fastest > 0.0 else 0.0


def _turning(speed: NDArray[np.float64], slope: NDArray[np.float64]) -> float:
    """Return at which part of an interval a cubic through its ends, with slopes below and above zero, is least."""
    change = float(speed[1] - speed[0])
    bend, twist = 3.0 * change - 2.0 * slope[0] - slope[1], slope[0] + slope[1] - 2.0 * change
    return float(-slope[0] / (bend + math.sqrt(max(0.0, bend**2 - 3.0 * twist * slope[0]))))


def _effect(run: Run, k: int, below: float, breakaway: float) -> float:
    """Return the change of speed [m/s] by a stop in an interval in which the speed may be so far below zero [m/s]."""
    scene, interval = run.scene, float(run.time[1] - run.time[0])
    soil = run.soil_resistance[k : k + 2]
    net = (run.mount_force[k : k + 2] - soil) / scene.mass
    jerk = float(net[1] - net[0]) / interval
    lasts = min(interval, math.sqrt(8.0 * below / jerk))
    resists = float(np.max(np.abs(soil)))
    if resists < scene.mass * jerk * lasts / 2.0:  # then the mount pulls it back
        return below + resists * lasts / float(scene.mass)
    return below + (breakaway - 1.0) * resists / math.sqrt(float(scene.stiffness) * float(scene.inertia))
