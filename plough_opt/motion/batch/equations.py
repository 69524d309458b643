"""From the user's inputs to the parameters of the motion, and from its averages to the results, as CasADi Functions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, minimum
from plough_opt.core.labels import labels_in, without_labels
from plough_opt.motion.batch.deviation import slopes
from plough_opt.motion.batch.layout import Layout
from plough_opt.motion.batch.program import Array
from plough_opt.motion.equation import equation_of_motion
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import parameters, start_deflection, start_rate, start_resistance, wave_names

RESULTS = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
"""Names of what a batch finds of each design, before its error."""

# Moments at which the growth of a deviation is looked at in advance; multiples of the golden section fall evenly.
_MOMENTS = 8
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Steps in a run of so much phase, the part of the wanted error that a step may make, and how much less where the soil
# bends the spring's law: see `_foresight`.
_FEWEST, _PHASE_PER_STEP, _PART, _BENT = 4.0, 2.5, 0.8, 4.0
_TINY = 1e-300


@dataclass(frozen=True)
class Start:
    """What every design has at the start, in the order in which `setup` gives it after the parameters of a step.

    Attributes:
        rate: w' [m/s].
        phase: of the run [rad].
        force: mount force [N].
        deflection: of the spring [m].
        tow_speed: of the strut, after a ramp [m/s].
        stiffness: of the mount [N/m].
        restoring: the same, of a repelling spring negative [N/m].
    """

    rate: Array
    phase: Array
    force: Array
    deflection: Array
    tow_speed: Array
    stiffness: Array
    restoring: Array

    def averages(self, layout: Layout, found: Array) -> Array:
        """Return `RESULTS` and the relative error, a row each.

        Args:
            layout: says what was found.
            found: all of a step's state from the means on, a row each.
        """
        means, variances = found[: layout.means], found[layout.means : layout.means + layout.squares]
        displacement_rms = np.sqrt(variances[0])
        # Without a damper the force is that of the spring.
        mean_draft = self.force + (means[1] if layout.squares > 1 else self.restoring * means[0])
        force_rms = np.sqrt(variances[1]) if layout.squares > 1 else self.stiffness * displacement_rms
        tow_power = means[-1] if layout.structure.ramp else mean_draft * self.tow_speed
        size = np.maximum(np.abs(mean_draft), force_rms)
        error = np.divide(np.sqrt(found[-1]) * self.stiffness, size, out=np.zeros_like(size), where=size != 0.0)
        # Of neighbouring motions that part for very long the distance leaves the range of floating point.
        error[np.isnan(error)] = np.inf
        return np.stack([mean_draft, force_rms, self.deflection + means[0], displacement_rms, tow_power, error])


def setup(
    layout: Layout, scene: Scene, duration: Expression, inputs: Sequence[Expression], error: float
) -> ca.Function:
    """Return inputs -> the parameters of a step, and `Start`, in one column."""
    structure, known = layout.structure, parameters(scene)
    values = [known[name] for name in layout.parameters]
    end = minimum(known["ramp_time"], duration) if structure.ramp else duration
    size = ca.fabs(scene.steady_resistance / scene.stiffness) + _TINY
    phase, part = _foresight(layout)(ca.vertcat(*values, end, duration, 0.0, 0.0))
    rate = start_rate(structure, known)
    start = Start(
        rate=rate,
        phase=phase,
        force=(0.0 if structure.relaxed else start_resistance(structure, known)) + known.get("damping", 0.0) * rate,
        deflection=start_deflection(structure, known),
        tow_speed=scene.tow_speed,
        stiffness=scene.stiffness,
        restoring=scene.restoring_stiffness,
    )
    column = ca.vertcat(*values, end, duration, duration / (1.0 + phase), error * size * part, *vars(start).values())
    return of_column("setup", inputs, column)


def of_column(name: str, inputs: Sequence[Expression], result: Expression) -> ca.Function:
    """Return a column of inputs -> result, of SX where the graph can be one.

    Raises:
        InputError: the result depends on other symbols than the inputs.
    """
    found: Any = ca.densify(result)
    inner = ca.Function(name, list(inputs), [found], {"allow_free": True})
    if inner.has_free():
        raise InputError(f"the scene depends on {', '.join(inner.get_free())}: name it among the inputs of the batch")
    if inner.is_a("MXFunction") and (labels := labels_in(inner)):
        inner = ca.Function(name, list(inputs), without_labels([found], labels))
    kind: type[Expression] = ca.SX
    try:
        inner = inner.expand()
    except RuntimeError:
        kind = ca.MX
    column = kind.sym("column", sum(one.numel() for one in inputs))
    ends = itertools.accumulate((one.numel() for one in inputs), initial=0)
    parts = [ca.reshape(column[a:b], *one.shape) for one, (a, b) in zip(inputs, itertools.pairwise(ends), strict=True)]
    return ca.Function(name, [column], inner.call(parts))


def _foresight(layout: Layout) -> ca.Function:
    """Return parameters -> (phase of the run [rad], part of the wanted error that a step may make).

    All steps make errors, which add up. A damper, and a soil whose resistance grows with the speed, forget them in a
    time that follows from the slopes along the path of a share that follows the strut; where the soil's slope along
    the path is not small beside the spring's stiffness, they may grow. The estimate that each run makes of its own
    error decides on repetition.
    """
    p = ca.SX.sym("p", layout.allowed + 1)
    known = dict(zip(layout.parameters, ca.vertsplit(p), strict=False))
    own = ca.vertcat(*(known[name] for name in equation_of_motion(layout.structure).names))
    duration, square = p[layout.ends[-1]], layout.own_frequency(p) ** 2
    bent, decay = ca.SX(0), ca.SX(0)
    for k in range(_MOMENTS):
        moment = duration * math.fmod(_GOLDEN * (k + 0.5), 1.0)
        spring, damper = ca.vertsplit(slopes(layout)(moment, ca.SX.zeros(2), own))
        bent, decay = bent + ca.fabs(spring + square) / (_MOMENTS * square), decay - damper / (2.0 * _MOMENTS)
    # Of an overdamped mount the slower decay; over the run, in its own time.
    decay = duration * ca.fmax(decay - ca.sqrt(ca.fmax(decay**2 - square, 0.0)), 0.0)
    phase = duration * _fastest(layout, known, p)
    # The root of the mean square of (1 - exp(-g u))/g over u from 0 to 1 is nearly this.
    remembered = 1.0 / ca.sqrt(3.0 + decay * (2.0 + decay))
    part = _PART / ((1.0 + _BENT * bent) * remembered * (_FEWEST + phase / _PHASE_PER_STEP))
    return ca.Function("foresight", [p], [phase, part])


def _fastest(layout: Layout, known: dict[str, ca.SX], p: ca.SX) -> ca.SX:
    """Return the sum of all frequencies and rates of decay [1/s]: `plough_opt.motion.plan.fastest_rate`, smooth."""
    zero = ca.SX(0)
    speed = known.get("tow_speed", zero)
    decay = known.get("damping", zero) + 2.0 * known.get("drag", zero) * speed
    if "width" in known:
        decay = decay + 2.0 * known["static"] / known["width"]
    rate = layout.own_frequency(p) + decay / known["inertia"]
    passing = zero
    for k in range(layout.structure.waves):
        passing = ca.fmax(passing, 2.0 * math.pi * speed / known[wave_names(k)[1]])
    return rate + passing + (2.0 * math.pi / known["ramp_time"] if "ramp_time" in known else 0.0)
