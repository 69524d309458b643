"""Predictions of the model for every row of measurements: a Function of the scaled unknowns, and its derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number
from plough_opt.laws.penetration import cone_index
from plough_opt.motion import simulate
from plough_opt.motion.plan import numbers_of, phase
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]

# Results of a scene that do not depend on its motion.
_OF_SCENE: dict[str, Callable[[Scene], Expression]] = {
    "loosened_radius": lambda scene: scene.loosened_radius,
    "added_mass": lambda scene: scene.carried_soil,
    "cone_index": lambda scene: cone_index(scene.soil),
}
# Phase [rad] between output times, and nodes of the polynomial that interpolates the force: an error of 1e-8.
_PHASE, _NODES, _OUTPUTS = 0.25, 8, 400
_MOST_OUTPUTS = 20_000
_MOST_EXPANDED = 1000


@dataclass(frozen=True)
class Predictor:
    """Predictions for some rows.

    Attributes:
        value: scaled unknowns (p) -> predictions (n), SI.
        both: scaled unknowns -> (predictions, their Jacobian (n, p)), from one evaluation.
        closed: whether they are scalar expressions, without runs.
    """

    value: ca.Function
    both: ca.Function
    closed: bool


@dataclass(frozen=True)
class Rows:
    """The rows of one set of measurements as distinct conditions, each computed once.

    Attributes:
        measured: the set.
        model: to calibrate.
        unknowns: to be found.
    """

    measured: Measurements
    model: Model
    unknowns: tuple[Unknown, ...]

    @cached_property
    def _distinct(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return distinct conditions (m, c) and which of them each row has."""
        table = np.array(list(self.measured.conditions.values())).T.reshape(self.measured.rows, -1)
        if table.shape[1] == 0:
            return np.zeros((1, 0)), np.zeros(self.measured.rows, dtype=np.intp)
        distinct, which = np.unique(table, axis=0, return_inverse=True)
        return distinct, which.ravel()

    def predictor(self) -> Predictor:
        """Return the predictions for the rows.

        Raises:
            InputError: a row whose conditions are outside the model's domain, or a missing duration.
        """
        if self.measured.result in {unknown.name for unknown in self.unknowns}:
            return self._direct()
        self._check()
        return self._record() if self.measured.result == RECORD else self._mapped()

    def scenes(self, y: Vector) -> list[tuple[Scene, Expression | None, NDArray[np.intp]]]:
        """Return the distinct scenes of numbers, with their durations and their rows."""
        distinct, which = self._distinct
        scenes = []
        for number, conditions in enumerate(distinct):
            values = self._values(y, conditions)
            rows = np.flatnonzero(which == number)
            scenes.append((self.model.scene(values), self._duration(values, rows), rows))
        return scenes

    def _values(self, y: Sequence[Expression] | Vector, conditions: Sequence[Expression] | Vector
                ) -> dict[str, Expression]:  # fmt: skip
        own = {unknown.name: unknown.value(y[k]) for k, unknown in enumerate(self.unknowns)}
        return {**own, **dict(zip(self.measured.conditions, conditions, strict=True))}

    def _duration(self, values: Mapping[str, Expression], rows: NDArray[np.intp]) -> Expression | None:
        if self.measured.time is not None:
            return float(np.max(self.measured.time[rows]))
        return self.model.duration_of(values)

    def _check(self) -> None:
        """Raise InputError, which names the row, if a scene is outside the model's domain or needs a duration."""
        guess = np.array([unknown.scaled(unknown.guess) for unknown in self.unknowns])
        distinct, which = self._distinct
        for number, conditions in enumerate(distinct):
            try:
                scene = self.model.scene(self._values(guess, [float(value) for value in conditions]))
                scene.check_reaction()
            except DomainError as error:
                row = self.measured.row(int(np.argmax(which == number)))
                raise InputError(f"{row}: {error}") from None
            if not is_closed(scene, self.measured.result) and scene.effects.orbit == "transient":
                duration = self._duration(self._values(guess, conditions), np.flatnonzero(which == number))
                if duration is None or not duration > 0.0:
                    raise InputError(f"{self.measured.name}: {self.measured.result} of this scene is a run's: give the"
                                     " duration of the run, in seconds")  # fmt: skip

    def _direct(self) -> Predictor:
        """Return the predictions for an unknown that was measured itself."""
        y = ca.MX.sym("y", len(self.unknowns))
        k = [unknown.name for unknown in self.unknowns].index(self.measured.result)
        value = ca.MX.ones(self.measured.rows) * self.unknowns[k].value(y[k])
        return _predictor(y, value, ca.jacobian(value, y), value, closed=True)

    def _mapped(self) -> Predictor:
        """Return the predictions for results with one value for each distinct condition."""
        distinct, which = self._distinct
        alone, both = row_functions(self.model, self.unknowns, self.measured.at(0), self.measured.result)
        y = ca.MX.sym("y", len(self.unknowns))
        at, conditions, rows = ca.repmat(y, 1, len(distinct)), ca.DM(distinct.T), which.tolist()
        value = alone.map(len(distinct))(at, conditions)
        again, slope = both.map(len(distinct))(at, conditions)
        closed = alone.is_a("SXFunction")
        return _predictor(y, value.T[rows, :], slope.T[rows, :], again.T[rows, :], closed)

    def _record(self) -> Predictor:
        """Return the predictions for the mount force at the times of a run for each distinct condition."""
        distinct, which = self._distinct
        assert self.measured.time is not None
        y = ca.MX.sym("y", len(self.unknowns))
        parts, order = [], []
        for number, conditions in enumerate(distinct):
            rows = np.flatnonzero(which == number)
            values = self._values([y[k] for k in range(len(self.unknowns))], [float(c) for c in conditions])
            guess = self._values(np.array([u.scaled(u.guess) for u in self.unknowns]), conditions)
            times = self.measured.time[rows]
            duration = float(np.max(times))
            outputs = _outputs(self.model.scene(guess), duration, times)
            run = simulate(self.model.scene(values), duration, accuracy=self.model.accuracy, outputs=outputs)
            parts.append(ca.DM(reading(times / duration, outputs)) @ run.mount_force)
            order.extend(rows.tolist())
        stacked = ca.vertcat(*parts)[np.argsort(order).tolist()]
        return _predictor(y, stacked, ca.jacobian(stacked, y), stacked, closed=False)


def _predictor(y: ca.MX, value: ca.MX, slope: ca.MX, again: ca.MX, closed: bool) -> Predictor:
    """Return a predictor from expressions; `again` is the value in the same graph as the slope."""
    own = ca.Function("value", [y], [ca.densify(value)])
    both = ca.Function("both", [y], [ca.densify(again), ca.densify(slope)])
    # The scalar operations of many rows would fill the memory: these stay mapped.
    if closed and own.numel_out() <= _MOST_EXPANDED:
        return Predictor(own.expand(), both.expand(), True)
    return Predictor(own, both, False)


def joined(predictors: Sequence[Predictor], count: int) -> Predictor:
    """Return the predictions of several sets, one below the other, as a function of `count` unknowns."""
    y = ca.MX.sym("y", count)
    value = ca.vertcat(*(p.value(y) for p in predictors))
    pairs = [p.both(y) for p in predictors]
    again, slope = (ca.vertcat(*(pair[k] for pair in pairs)) for k in (0, 1))
    return _predictor(y, value, slope, again, closed=all(p.closed for p in predictors))


def row_functions(
    model: Model,
    unknowns: Sequence[Unknown],
    conditions: Mapping[str, float],
    result: str,
    fixed: Mapping[str, float] | None = None,
) -> tuple[ca.Function, ca.Function]:
    """Return two Functions of scaled unknowns and conditions: a result; the same and its derivatives as a column.

    Args:
        model: to calibrate.
        unknowns: to be found.
        conditions: names of the conditions, with valid values.
        result: the measured result.
        fixed: further conditions, which are constants of the Functions.
    """
    fixed = dict(fixed or {})
    example = model.scene({**{unknown.name: unknown.guess for unknown in unknowns}, **conditions, **fixed})
    closed = is_closed(example, result)
    # A law with quadratures of matrices, or loops, would be unrolled by scalar operations.
    kind: Any = ca.SX if closed and example.law.scalar else ca.MX
    y, c = kind.sym("y", len(unknowns)), kind.sym("c", len(conditions))
    values = {unknown.name: unknown.value(y[k]) for k, unknown in enumerate(unknowns)}
    values |= {key: c[k] for k, key in enumerate(conditions)} | fixed
    scene = model.scene(values)
    if result in _OF_SCENE:
        value = _OF_SCENE[result](scene)
    elif closed:
        value = scene.steady_resistance
    else:
        run = simulate(scene, model.duration_of(values), accuracy=model.accuracy)
        value = MEASURES[result].of(run)
    value = kind(value)
    if kind is ca.SX:
        slope = ca.densify(ca.jacobian(value, y))
    else:
        # Forward through the integration: the reverse mode takes far longer to build.
        slope = ca.horzcat(*(ca.jtimes(value, y, ca.DM.eye(len(unknowns))[:, k]) for k in range(len(unknowns))))
    return ca.Function("alone", [y, c], [value]), ca.Function("both", [y, c], [value, ca.densify(slope).T])


def is_closed(scene: Scene, result: str) -> bool:
    """Return whether a result needs no run: the mean draft of a steady motion is the resistance."""
    if result in _OF_SCENE or result not in measurable():
        return True
    effects = scene.effects
    steady = not effects.waves and not effects.ramps and not effects.entry and not effects.own
    from_steady = not effects.motion or effects.start == "equilibrium"
    return result == "mean_draft" and steady and from_steady and not effects.printed.repelling_spring


def _outputs(scene: Scene, duration: float, times: Vector) -> int:
    """Return a number of output intervals with an output at every time, or enough of them to interpolate."""
    fine = max(_OUTPUTS, math.ceil(phase(numbers_of(scene), duration) / _PHASE)) if scene.effects.motion else _OUTPUTS
    fine = min(fine, _MOST_OUTPUTS)
    for count in range(fine, 2 * fine):
        places = times / duration * count
        if np.all(np.abs(places - np.round(places)) < 1e-9 * count):
            return count
    return fine


def reading(fractions: Vector, outputs: int) -> Vector:
    """Return the matrix that interpolates a signal on equal output intervals at fractions of its duration.

    It uses polynomials of degree 7 through the nearest outputs, and at an output the value there.
    """
    weights = np.zeros((len(fractions), outputs + 1))
    for row, fraction in enumerate(fractions):
        place = fraction * outputs
        nearest = round(place)
        if abs(place - nearest) < 1e-9 * outputs:
            weights[row, nearest] = 1.0
            continue
        first = min(max(math.floor(place) - _NODES // 2 + 1, 0), outputs + 1 - _NODES)
        nodes = np.arange(first, first + _NODES)
        for k in nodes:
            others = nodes[nodes != k]
            weights[row, k] = np.prod((place - others) / (k - others))
    return weights


def checked(scene: Scene, duration: Expression | None, measured: Measurements, rows: NDArray[np.intp],
            model: Model) -> Vector:  # fmt: skip
    """Return the results of some rows from a run of numbers, which checks its own error."""
    if measured.result == RECORD:
        assert measured.time is not None
        assert duration is not None
        times = measured.time[rows]
        outputs = _outputs(scene, float(duration), times)
        run = simulate(scene, duration, accuracy=model.accuracy, outputs=outputs)
        return np.asarray(reading(times / float(duration), outputs) @ run.mount_force, dtype=float)
    run = simulate(scene, duration, accuracy=model.accuracy)
    return np.full(len(rows), float(as_number(MEASURES[measured.result].of(run))))
