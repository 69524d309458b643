"""How far two runs of a scene are apart: the measure behind the error estimate of a run."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.run import Run

TELLING: Final = 1e-6
"""Estimated relative error [-] beyond which a run says so in words, unless a larger one was asked for."""

# Part of a run's own scales of force, deflection and speed below which a quantity is their rounding, times a hundred
# million: a quantity so small counts relative to that part, and its rounding by less than 1e-8.
_LEAST = 1e-7


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
    found, check = run.averages, other.averages
    least, least_z = _LEAST * force, _LEAST * deflection
    leasts = (least, least, least_z, _LEAST * speed, least_z)
    pairs = [(change, max(scale, low)) for change, scale, low in zip(wrong, largest, leasts, strict=True)]
    size = max(abs(found.mean_draft), found.force_rms, least)
    size_z = max(abs(found.mean_deflection), found.displacement_rms, least_z)
    pairs += [
        (abs(found.mean_draft - check.mean_draft), size),
        (abs(found.force_rms - check.force_rms), max(found.force_rms, least)),
        (abs(found.mean_deflection - check.mean_deflection), size_z),
        (abs(found.displacement_rms - check.displacement_rms), max(found.displacement_rms, least_z)),
    ]
    if run.scene.effects.ramps:
        towed = (run.travel[-1] + run.deflection[-1] - run.travel[0] - run.deflection[0]) / run.duration
        pairs.append((abs(found.tow_power - check.tow_power), max(abs(found.tow_power), size * towed)))
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
