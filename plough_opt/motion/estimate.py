"""Error estimates of a run: its difference from another run of the scene, and stops that neither run noticed.

An integrator locates an event where a sign differs from one step to the next. If the speed of a share falls below zero
for less than a step, neither a run nor its check notices. Between outputs the speed is therefore read from a polynomial
through speeds and accelerations.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.effects import StickSlip
from plough_opt.motion.equation import SLIP
from plough_opt.motion.run import Run
from plough_opt.motion.timeline import hermite

WORTH_A_WARNING: Final = 1e-6
"""Estimated relative error [-] above which a run carries a warning, unless a larger error was requested."""

# A quantity below this fraction of the run's scale of force, deflection or speed counts relative to that fraction.
# Rounding of the scale, 1e-16 of it, then contributes less than 1e-8.
_SMALLEST = 1e-7

# Errors midway between two outputs of the polynomials through speeds and accelerations at two and at four outputs, for
# an oscillation of 1 rad an interval, as fractions of the largest speed: 1/4^2/4! and (3/4)^4/8!, rounded up.
_ERROR_OF_TWO: Final = 3e-3
_ERROR_OF_FOUR: Final = 1e-5


def difference(run: Run, other: Run) -> float:
    """Return the largest relative difference of any quantity of two runs with the same output times.

    Each quantity has its own scale. An array (mount force, soil resistance, deflection, speed), and with it its peak,
    counts by its largest difference relative to its largest value; the travel relative to the largest deflection if
    that is larger, and the opening always relative to the largest deflection. An RMS counts relative to itself, a mean
    relative to the larger of itself and the RMS, and the tow power relative to the larger of itself and that force
    times the strut's mean speed. Speed and soil resistance jump at an event; they count only at outputs where both runs
    are in the same mode.
    """
    ours, apart = _arrays(run), _arrays(other)
    apart -= ours
    if run.scene.effects.events:
        apart[[1, 3]] *= run.mode == other.mode
    differences: list[float] = np.abs(apart).max(axis=1).tolist()
    largest: list[float] = np.abs(ours).max(axis=1).tolist()
    # The travel of a share that sticks is rounding.
    largest[4] = max(largest[4], largest[2])
    force, deflection, speed = _scales(run, largest)
    found, check = ({name: float(value) for name, value in vars(one.averages).items()} for one in (run, other))
    least, least_z = _SMALLEST * force, _SMALLEST * deflection
    leasts = (least, least, least_z, _SMALLEST * speed, least_z)
    pairs = [(change, max(scale, low)) for change, scale, low in zip(differences, largest, leasts, strict=True)]
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
    """Return mount force, soil resistance, deflection, speed and travel at the outputs, a row for each quantity."""
    rows = np.empty((5, len(run.time)))
    # A resistance of the user's own may be a single number for all times; assignment to a row spreads it.
    rows[0], rows[1], rows[2], rows[3] = run.mount_force, run.soil_resistance, run.deflection, run.speed
    rows[4] = run.travel
    return rows


def _scales(run: Run, largest: list[float]) -> tuple[float, float, float]:
    """Return the scales of force [N], deflection [m] and speed [m/s] at which the quantities of a motion round."""
    scene = run.scene
    stiffness = float(scene.stiffness)
    force = max(largest[0], largest[1], stiffness * largest[2])
    if not scene.effects.motion:
        return force, force / stiffness, largest[3]
    return force, force / stiffness, max(largest[3], force / math.sqrt(stiffness * float(scene.inertia)))


def unnoticed_stops(run: Run, rate: float, error: float) -> float:
    """Return a bound on the relative change of speed [-] by a stop that the integrator may not have noticed.

    A share may have stopped where its speed may have reached zero. It would have slipped on at once; if the mount had
    pulled it back by then, it would have left a gap in which no soil resists. With a breakaway ratio above 1 it would
    have been held until the mount pulled so much harder.

    Args:
        run: under any contact.
        rate: fastest angular frequency of the motion [rad/s].
        error: estimated relative error [-] of its speeds.

    Returns:
        The largest such change of speed relative to the largest speed; 0 if there is none.
    """
    scene = run.scene
    contact = scene.effects.contact
    if not isinstance(contact, StickSlip) or len(run.time) < 2:
        return 0.0
    interval = float(run.time[1] - run.time[0])
    fastest, acceleration = float(np.max(np.abs(run.speed))), (run.mount_force - run.soil_resistance) / scene.mass
    slips = (run.mode[:-1] == SLIP) & (run.mode[1:] == SLIP)
    minima = np.flatnonzero(slips & (acceleration[:-1] < 0.0) & (acceleration[1:] > 0.0))
    largest = 0.0
    for k in minima.tolist():
        part = _minimum(run.speed[k : k + 2], interval * acceleration[k : k + 2])
        first, count = (k - 1, 4) if 0 < k < len(slips) - 1 and slips[k - 1] and slips[k + 1] else (k, 2)
        around = slice(first, first + count)
        by_value, by_slope, *_ = hermite(np.arange(count, dtype=float)[None], np.array([k - first + part]))
        lowest = float(by_value[0] @ run.speed[around] + by_slope[0] @ acceleration[around] * interval)
        turned = rate * interval
        below = fastest * (error + (_ERROR_OF_TWO * turned**4 if count == 2 else _ERROR_OF_FOUR * turned**8)) - lowest
        if below > 0.0:
            largest = max(largest, _change_by_stop(run, k, below, float(contact.breakaway)))
    return largest / fastest if fastest > 0.0 else 0.0


def _minimum(speed: NDArray[np.float64], slope: NDArray[np.float64]) -> float:
    """Return the fraction of an interval at which a cubic is least, from its values and slopes at both ends.

    The first slope must be below zero and the second one above.
    """
    change = float(speed[1] - speed[0])
    bend, twist = 3.0 * change - 2.0 * slope[0] - slope[1], slope[0] + slope[1] - 2.0 * change
    return float(-slope[0] / (bend + math.sqrt(max(0.0, bend**2 - 3.0 * twist * slope[0]))))


def _change_by_stop(run: Run, k: int, below: float, breakaway: float) -> float:
    """Return the change of speed [m/s] by a stop within an output interval.

    Args:
        run: under `StickSlip`.
        k: number of the interval.
        below: how far below zero the speed may fall [m/s].
        breakaway: ratio of the contact.
    """
    scene, interval = run.scene, float(run.time[1] - run.time[0])
    soil = run.soil_resistance[k : k + 2]
    net = (run.mount_force[k : k + 2] - soil) / scene.mass
    jerk = float(net[1] - net[0]) / interval
    time = min(interval, math.sqrt(8.0 * below / jerk))
    resists = float(np.max(np.abs(soil)))
    if resists < scene.mass * jerk * time / 2.0:  # the mount pulls the share back
        return below + resists * time / float(scene.mass)
    return below + (breakaway - 1.0) * resists / math.sqrt(float(scene.stiffness) * float(scene.inertia))
