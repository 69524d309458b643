"""Stops between the outputs of a run under stick and slip, which its integrator may have passed over.

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
from plough_opt.motion.readings import hermite
from plough_opt.motion.run import Run

# Errors of polynomials through speeds and accelerations, of two outputs and of four around, halfway between them, in
# parts of the largest speed for an oscillation of 1 rad an interval: 1/4^2/4!, and (3/4)^4/8! rounded up.
_TWO: Final = 3e-3
_FOUR: Final = 1e-5


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
