"""CasADi Functions around the steps of a batch: inputs to parameters of a step, and state at the end to results."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, absolute, minimum, stacked, where
from plough_opt.core.labels import labels_in, without_labels
from plough_opt.motion.batch.engine import Array
from plough_opt.motion.batch.layout import Layout
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.plan import summed_rate
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters, pull, start_deflection, start_force, start_rate

RESULTS = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
"""Names of the results of each design, before its error."""

# Keeps the allowed error of a step above zero if nothing moves the share.
_TINY = 1e-300

# The number of steps of a run is estimated as _FEWEST_STEPS + phase / _PHASE_PER_STEP, with the phase in rad.
_FEWEST_STEPS = 4.0
_PHASE_PER_STEP = 2.5
# Part of the wanted error that all steps together may make.
_MARGIN = 0.8
# That part is divided by 1 + _CAUTION * (slope of the soil's resistance over stiffness), because such a slope may let
# errors grow.
_CAUTION = 4.0
# Moments of a run at which these slopes are sampled. Multiples of the golden section cover the run evenly.
_MOMENTS = 8
_GOLDEN_SECTION = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class StartValues:
    """Values that the results need besides the averages, in the order in which `setup` returns them.

    Attributes:
        rate: w' at the start [m/s].
        phase: of the whole run [rad].
        force: mount force at the start [N].
        deflection: of the spring at the start [m].
        tow_speed: of the strut, after a ramp [m/s].
        stiffness: of the mount [N/m].
        restoring: the same, negative for a repelling spring [N/m].
    """

    rate: Column
    phase: Column
    force: Column
    deflection: Column
    tow_speed: Column
    stiffness: Column
    restoring: Column

    def results(self, layout: Layout, state: Array) -> Array:
        """Return `RESULTS` and the relative error, a row each.

        Args:
            layout: of the state.
            state: at the end, from the means on, a row each.
        """
        means, variances = state[: layout.averaged], state[layout.averaged : layout.averaged + layout.squared]
        displacement_rms = np.sqrt(variances[0])
        # Without a damper the mount force is that of the spring, and there is no signal for it.
        mean_draft = self.force + (means[1] if layout.squared > 1 else self.restoring * means[0])
        force_rms = np.sqrt(variances[1]) if layout.squared > 1 else self.stiffness * displacement_rms
        tow_power = means[-1] if layout.structure.ramp else mean_draft * self.tow_speed
        size = np.maximum(np.abs(mean_draft), force_rms)
        error = np.divide(np.sqrt(state[-1]) * self.stiffness, size, out=np.zeros_like(size), where=size != 0.0)
        # Motions that diverge for very long leave the range of floating point.
        error[np.isnan(error)] = np.inf
        return np.stack([mean_draft, force_rms, self.deflection + means[0], displacement_rms, tow_power, error])


def setup(layout: Layout, scene: Scene, duration: Expression, inputs: Sequence[Column], error: float) -> ca.Function:
    """Return a Function of the inputs whose result is a column: the parameters of a step, then `StartValues`."""
    structure, known = layout.structure, parameters(scene)
    values = [known[name] for name in layout.names]
    end = minimum(known["ramp_time"], duration) if structure.ramp else duration
    steady = absolute(scene.steady_resistance / scene.stiffness)
    # Where the soil never resists, the strut alone moves the share.
    size = where(steady > 0.0, steady, scene.tow_speed / scene.natural_frequency) + _TINY
    phase, part = _phase_and_error_part(layout)(stacked(*values, end, duration))
    rate = start_rate(structure, known)
    start = StartValues(
        rate=rate,
        phase=phase,
        force=start_force(structure, known) + pull(structure, known, 0.0, rate),
        deflection=start_deflection(structure, known),
        tow_speed=scene.tow_speed,
        stiffness=scene.stiffness,
        restoring=scene.restoring_stiffness,
    )
    longest_first_step, allowed_error = duration / (1.0 + phase), error * size * part
    column = stacked(*values, end, duration, longest_first_step, allowed_error, *vars(start).values())
    return function_of_column("setup", inputs, column)


def function_of_column(name: str, inputs: Sequence[Column], result: Column) -> ca.Function:
    """Return the Function of a column of all inputs with this result, of SX if its graph allows that.

    Raises:
        InputError: the result depends on other symbols than the inputs.
    """
    dense: Any = ca.densify(result)
    inner = ca.Function(name, list(inputs), [dense], {"allow_free": True})
    if inner.has_free():
        raise InputError(f"the scene depends on {', '.join(inner.get_free())}: name it among the inputs of the batch")
    if inner.is_a("MXFunction") and (labels := labels_in(inner)):
        inner = ca.Function(name, list(inputs), without_labels([dense], labels))
    kind: Any = ca.MX
    with contextlib.suppress(RuntimeError):  # the solution of linear equations has no graph of scalar operations
        expanded = inner.expand()
        # A table or the root of an equation remains a call, which only CasADi evaluates.
        if ca.OP_CALL not in map(expanded.instruction_id, range(expanded.n_instructions())):
            inner, kind = expanded, ca.SX
    column = kind.sym("column", sum(one.numel() for one in inputs))
    ends = itertools.accumulate((one.numel() for one in inputs), initial=0)
    parts = [ca.reshape(column[a:b], *one.shape) for one, (a, b) in zip(inputs, itertools.pairwise(ends), strict=True)]
    return ca.Function(name, [column], inner.call(parts))


@lru_cache(maxsize=16)
def slopes(structure: Structure) -> ca.Function:
    """Return (time, (w, w'), parameters of the equation of motion) -> (dw''/dw [1/s^2], dw''/dw' [1/s])."""
    motion = equation_of_motion(structure)
    time, state, p = ca.SX.sym("time"), ca.SX.sym("state", 2), ca.SX.sym("p", len(motion.names))
    found = ca.densify(ca.jacobian(motion.function(time, state, p)[1], state))
    return ca.Function("slopes", [time, state, p], [ca.cse(found.T)])


def _phase_and_error_part(layout: Layout) -> ca.Function:
    """Return parameters up to the duration -> (phase of the run [rad], part of the wanted error that a step may make).

    The errors of all steps add up. A damper, and a soil whose resistance grows with speed, let them decay; their rate
    is estimated from the slopes along the path of a share that moves with the strut. Errors may grow if the slope of
    the soil's resistance along the path is not small beside the stiffness. This is only a first guess: each run
    estimates its own error, and `Batch` repeats it if that is too large.
    """
    p = ca.SX.sym("p", layout.ends[-1] + 1)
    known = dict(zip(layout.names, ca.vertsplit(p), strict=False))
    motion_parameters = stacked(*(known[name] for name in equation_of_motion(layout.structure).names))
    duration, frequency_squared = p[layout.ends[-1]], layout.mount_frequency(p) ** 2
    soil_over_mount, decay = ca.SX(0), ca.SX(0)
    for k in range(_MOMENTS):
        moment = duration * math.fmod(_GOLDEN_SECTION * (k + 0.5), 1.0)
        spring, damper = ca.vertsplit(slopes(layout.structure)(moment, ca.SX.zeros(2), motion_parameters))
        soil_over_mount = soil_over_mount + ca.fabs(spring + frequency_squared) / (_MOMENTS * frequency_squared)
        decay = decay - damper / (2.0 * _MOMENTS)
    # An overdamped mount has two rates of decay; this is the slower one, times the duration.
    decay = duration * ca.fmax(decay - ca.sqrt(ca.fmax(decay**2 - frequency_squared, 0.0)), 0.0)
    phase = duration * summed_rate(known)
    # Nearly the root of the mean square of (1 - exp(-g u))/g over u from 0 to 1, with g for the decay.
    remembered = 1.0 / ca.sqrt(3.0 + decay * (2.0 + decay))
    steps = _FEWEST_STEPS + phase / _PHASE_PER_STEP
    part = _MARGIN / ((1.0 + _CAUTION * soil_over_mount) * remembered * steps)
    return ca.Function("phase_and_error_part", [p], [phase, part])
