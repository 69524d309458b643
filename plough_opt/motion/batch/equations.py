"""Batches as CasADi Functions: from the user's inputs, checked, to the parameters of the motion, and to results."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.expressions import (
    Column,
    Expression,
    absolute,
    is_quantity,
    map_expressions,
    minimum,
    stacked,
    template_of,
)
from plough_opt.core.labels import labels_in, without_labels
from plough_opt.core.quantities import BESIDE, QUANTITIES
from plough_opt.motion.batch.engine import Array
from plough_opt.motion.effects import StrengthWaves
from plough_opt.motion.equation import equation_of_motion, signals
from plough_opt.motion.plan import summed_rate
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of
from plough_opt.motion.terms import Structure, parameters, pull, start_deflection, start_force, start_rate

RESULTS = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
"""Names of the results of each design, before its error."""
# Moments at which the growth of a deviation is estimated in advance; multiples of the golden section fall evenly.
_MOMENTS = 8
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Steps in a run by its phase, the part of the wanted error that a step may make, and how much less that is where the
# slope of the soil's resistance adds to the spring's: see `_phase_and_part`.
_FEWEST, _PHASE_PER_STEP, _PART, _BENT = 4.0, 2.5, 0.8, 4.0
_TINY = 1e-300


@dataclass(frozen=True)
class Layout:
    """Positions in the columns that are the arguments of a step.

    Attributes:
        structure: the terms that are on.
        parameters: names of the equation's parameters; after them follow the end of the ramp [s], the duration [s], the
            longest first step [s] and the error of the deflection [m] that a step may make.
        means: number of signals that are averaged: see `plough_opt.motion.equation`.
        squares: how many of them have an RMS.
    """

    structure: Structure
    parameters: tuple[str, ...]
    means: int
    squares: int

    @classmethod
    def of(cls, structure: Structure) -> Layout:
        """Return the layout of a structure."""
        observed = signals(structure)
        return cls(structure, observed.parameters, observed.count, observed.squared)

    @property
    def ends(self) -> tuple[int, ...]:
        """Positions in the parameters of the time at which each part of the motion ends."""
        after = len(self.parameters)
        return (after, after + 1) if self.structure.ramp else (after + 1,)

    @property
    def longest_first_step(self) -> int:
        """Position in the parameters of the longest first step."""
        return len(self.parameters) + 2

    @property
    def allowed(self) -> int:
        """Position in the parameters of the error that a step may make, the last of them."""
        return len(self.parameters) + 3

    @property
    def state(self) -> int:
        """Size of the state: time, w, w', means, variances, and four numbers for the errors so far.

        Those are the three of `plough_opt.motion.batch.advance.grown`, and the mean of
        `plough_opt.motion.batch.advance.square_of_error` over the time until now.
        """
        return 7 + self.means + self.squares

    def value(self, p: ca.SX, name: str) -> ca.SX:
        """Return a parameter by its name, of a column of them."""
        return p[self.parameters.index(name)]

    def own_frequency(self, p: ca.SX) -> ca.SX:
        """Return sqrt(|k|/M) [rad/s]."""
        return ca.sqrt(ca.fabs(self.value(p, "stiffness")) / self.value(p, "inertia"))

    def fastest_frequency(self, p: ca.SX) -> ca.SX:
        """Return the sum of the mount's own frequency and the fastest wave's [rad/s]."""
        known = dict(zip(self.parameters, ca.vertsplit(p), strict=False))
        passing: ca.SX = reduce(ca.fmax, StrengthWaves.imposed(known), ca.SX(0)) / 2.0
        return self.own_frequency(p) + passing


@dataclass(frozen=True)
class Start:
    """Quantities of each design at the start, in the order in which `setup` returns them after a step's parameters.

    Attributes:
        rate: w' [m/s].
        phase: of the run [rad].
        force: mount force [N].
        deflection: of the spring [m].
        tow_speed: of the strut, after a ramp [m/s].
        stiffness: of the mount [N/m].
        restoring: the same, of a repelling spring negative [N/m].
    """

    rate: Column
    phase: Column
    force: Column
    deflection: Column
    tow_speed: Column
    stiffness: Column
    restoring: Column

    def averages(self, layout: Layout, state: Array) -> Array:
        """Return `RESULTS` and the relative error, a row each.

        Args:
            layout: of the state.
            state: at the end, from the means on, a row each.
        """
        means, variances = state[: layout.means], state[layout.means : layout.means + layout.squares]
        displacement_rms = np.sqrt(variances[0])
        # Without a damper the force is that of the spring.
        mean_draft = self.force + (means[1] if layout.squares > 1 else self.restoring * means[0])
        force_rms = np.sqrt(variances[1]) if layout.squares > 1 else self.stiffness * displacement_rms
        tow_power = means[-1] if layout.structure.ramp else mean_draft * self.tow_speed
        size = np.maximum(np.abs(mean_draft), force_rms)
        error = np.divide(np.sqrt(state[-1]) * self.stiffness, size, out=np.zeros_like(size), where=size != 0.0)
        # The distance of neighbouring motions that part for very long leaves the range of floating point.
        error[np.isnan(error)] = np.inf
        return np.stack([mean_draft, force_rms, self.deflection + means[0], displacement_rms, tow_power, error])


def setup(layout: Layout, scene: Scene, duration: Expression, inputs: Sequence[Column], error: float) -> ca.Function:
    """Return inputs -> the parameters of a step, and `Start`, in one column."""
    structure, known = layout.structure, parameters(scene)
    values = [known[name] for name in layout.parameters]
    end = minimum(known["ramp_time"], duration) if structure.ramp else duration
    size = absolute(scene.steady_resistance / scene.stiffness) + _TINY
    phase, part = _phase_and_part(layout)(stacked(*values, end, duration, 0.0, 0.0))
    rate = start_rate(structure, known)
    start = Start(
        rate=rate,
        phase=phase,
        force=start_force(structure, known) + pull(structure, known, 0.0, rate),
        deflection=start_deflection(structure, known),
        tow_speed=scene.tow_speed,
        stiffness=scene.stiffness,
        restoring=scene.restoring_stiffness,
    )
    column = stacked(*values, end, duration, duration / (1.0 + phase), error * size * part, *vars(start).values())
    return of_column("setup", inputs, column)


def of_column(name: str, inputs: Sequence[Column], result: Column) -> ca.Function:
    """Return a column of inputs -> result, of SX where the graph can be one.

    Raises:
        InputError: the result depends on other symbols than the inputs.
    """
    dense: Any = ca.densify(result)
    inner = ca.Function(name, list(inputs), [dense], {"allow_free": True})
    if inner.has_free():
        raise InputError(f"the scene depends on {', '.join(inner.get_free())}: name it among the inputs of the batch")
    if inner.is_a("MXFunction") and (labels := labels_in(inner)):
        inner = ca.Function(name, list(inputs), without_labels([dense], labels))
    kind: Any = ca.SX
    try:
        inner = inner.expand()
    except RuntimeError:
        kind = ca.MX
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


def _phase_and_part(layout: Layout) -> ca.Function:
    """Return parameters -> (phase of the run [rad], part of the wanted error that a step may make).

    The errors of all steps add up. A damper, and a soil whose resistance grows with the speed, make them decay at a
    rate estimated from the slopes along the path of a share that moves with the strut. If the slope of the soil's
    resistance along the path is not small beside the spring's stiffness, they may grow. This is an estimate in advance:
    each run estimates its own error, and is repeated if that is too large.
    """
    p = ca.SX.sym("p", layout.allowed + 1)
    known = dict(zip(layout.parameters, ca.vertsplit(p), strict=False))
    own = stacked(*(known[name] for name in equation_of_motion(layout.structure).names))
    duration, square = p[layout.ends[-1]], layout.own_frequency(p) ** 2
    bent, decay = ca.SX(0), ca.SX(0)
    for k in range(_MOMENTS):
        moment = duration * math.fmod(_GOLDEN * (k + 0.5), 1.0)
        spring, damper = ca.vertsplit(slopes(layout.structure)(moment, ca.SX.zeros(2), own))
        bent, decay = bent + ca.fabs(spring + square) / (_MOMENTS * square), decay - damper / (2.0 * _MOMENTS)
    # The slower decay of an overdamped mount, times the duration.
    decay = duration * ca.fmax(decay - ca.sqrt(ca.fmax(decay**2 - square, 0.0)), 0.0)
    phase = duration * summed_rate(known)
    # The root of the mean square of (1 - exp(-g u))/g over u from 0 to 1 is nearly this.
    remembered = 1.0 / ca.sqrt(3.0 + decay * (2.0 + decay))
    part = _PART / ((1.0 + _BENT * bent) * remembered * (_FEWEST + phase / _PHASE_PER_STEP))
    return ca.Function("phase_and_part", [p], [phase, part])


class DomainCheck:
    """Builds a scene again with arrays as its quantities, and finds the designs for which that raises an error.

    If the arrays are refused, designs with a quantity outside its own domain are checked one by one, the others by
    halves.
    """

    def __init__(self, template: Scene, fixed: list[float | None]) -> None:
        """Take a scene with placeholders, and for each of them its number, or None if it varies between designs."""
        self._template = template
        self._fixed = fixed
        names = {id(value): name for name, value in quantities_of(template).items() if value is not None}
        placed = zip(template_of(template)[1], fixed, strict=True)
        varying = [QUANTITIES.get(names.get(id(value), "")) for value, number in placed if number is None]
        self._domains = [*varying, BESIDE["scene.duration"]]

    def reasons(self, rows: Array) -> dict[int, str]:
        """Return the reasons why designs are refused, by their position.

        Args:
            rows: the quantities that vary, a row each, and the duration.
        """
        reasons: dict[int, str] = {}
        with np.errstate(all="ignore"):
            if rows.shape[1] > 0 and not self._accepts(lambda k: rows[k]):
                suspect = self._outside(rows)
                for k in np.flatnonzero(suspect):
                    self._search(rows, np.array([k]), reasons)
                self._search(rows, np.flatnonzero(~suspect), reasons)
        return reasons

    def _accepts(self, value: Callable[[int], Any]) -> bool:
        """Return whether a scene with these values is accepted; a user's own class may raise any error for arrays."""
        try:
            self.scene(value)
        except Exception:
            return False
        return True

    def _outside(self, rows: Array) -> NDArray[np.bool_]:
        """Return which designs have a quantity outside its own domain."""
        suspect = np.zeros(rows.shape[1], dtype=bool)
        for values, quantity in zip(rows, self._domains, strict=True):
            if quantity is not None:
                suspect |= ~((values >= quantity.low) & (values <= quantity.high))
        return suspect

    def _search(self, rows: Array, where: NDArray[np.int64], reasons: dict[int, str]) -> None:
        """Enter the reasons of those designs that are refused, by halving."""
        if len(where) == 0:
            return
        if len(where) == 1:
            try:
                self.scene(lambda k: float(rows[k, where[0]]))
            except PloughError as refusal:
                reasons[int(where[0])] = str(refusal)
        elif not self._accepts(lambda k: rows[k, where]):
            half = len(where) // 2
            self._search(rows, where[:half], reasons)
            self._search(rows, where[half:], reasons)

    def scene(self, value: Callable[[int], Any]) -> Scene:
        """Return the scene with values for the quantities that vary.

        Raises:
            DomainError: a value outside the model's domain.
        """
        varying = itertools.count()
        values = iter([value(next(varying)) if number is None else number for number in self._fixed])
        scene: Scene = map_expressions(self._template, lambda _: next(values), is_quantity)
        BESIDE["scene.duration"].check(value(next(varying)))
        return scene
