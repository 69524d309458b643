"""`calibrate`: a scene and measurements in, the unknowns with their uncertainty out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.domain import check_text
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.kinds import check_kind, shown
from plough_opt.motion.scene import Scene
from plough_opt.studies.calibration.candidates import Candidate, NextMeasurement, evaluated, proposals, ranked
from plough_opt.studies.calibration.cross_validation import CrossValidation, cross_validate
from plough_opt.studies.calibration.estimate import NOMINAL, Data, Estimate, estimate
from plough_opt.studies.calibration.fit import Fit, reported
from plough_opt.studies.calibration.intervals import Interval, Kind, interval
from plough_opt.studies.calibration.least_squares import LeastSquares
from plough_opt.studies.calibration.loss import loss_of
from plough_opt.studies.calibration.measurements import Measurements, measurable
from plough_opt.studies.calibration.model import Described, Model, SceneOf, model_of
from plough_opt.studies.calibration.prediction import Rows, joined, row_functions
from plough_opt.studies.calibration.unknown import Unknown, unknowns_of

Vector = NDArray[np.float64]


def calibrate(
    given: Described | Scene | SceneOf,
    data: Measurements | Sequence[Measurements],
    unknown: Mapping[str, Any] | None = None,
    *,
    loss: str = "squares",
    duration: float | None = None,
    starts: int = 4,
    title: str = "",
) -> Fit:
    """Find soil and model parameters from measurements, by Gauss-Newton in IPOPT between bounds.

    For example::

        data = po.read_measurements("draft.csv")
        fit = po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "effects.rate_term": (0.0, 0.2)})
        print(fit.values, fit.intervals(0.95), fit.unidentifiable)

    Args:
        given: a problem file; a scene of numbers; or a function of values by key, such as "soil.cohesion", that accepts
            symbols and returns a scene.
        data: one set of measurements, or several.
        unknown: key of a problem file -> (lower, upper) or (lower, upper, guess), SI or text with units; default: the
            variables of the problem file that are not columns of the data.
        loss: "squares", or one that gives outliers less weight: "huber", "soft_l1", "cauchy".
        duration: simulated time [s] of runs whose averages were measured, if not the problem's.
        starts: number of starts: the guess, and the best of 64 points between the bounds (16 if they need runs).
        title: for reports.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.
        NotConverged: no start led to an optimum.
    """
    return Calibration(given, data, unknown, loss=loss, duration=duration, starts=starts, title=title).fit()


class Calibration:
    """A calibration whose model is built once, for fits to many sets of observed values."""

    def __init__(
        self,
        given: Described | Scene | SceneOf,
        data: Measurements | Sequence[Measurements],
        unknown: Mapping[str, Any] | None = None,
        *,
        loss: str = "squares",
        duration: float | None = None,
        starts: int = 4,
        title: str = "",
    ) -> None:
        """Take the arguments of `calibrate`, check them and build the model."""
        several = data if isinstance(data, Sequence) else ()
        check_text("title", title)
        self.measured = (data,) if isinstance(data, Measurements) else tuple(several)
        if not self.measured or not all(isinstance(m, Measurements) for m in self.measured):
            raise InputError("the data must be Measurements, one set or several: po.read_measurements reads a file")
        if not any(np.any(m.values) for m in self.measured):
            raise InputError(
                f"{self.measured[0].name}: every measured value is 0, which fits no soil: check the column"
            )
        if not is_count(starts) or starts > 16:
            raise InputError(f"starts = {shown(starts)} must be a whole number from 1 to 16")
        self.loss, self.starts = loss_of(loss), starts
        self.model: Model = model_of(given, duration)
        self.title = title or self.model.title
        self.unknowns = unknowns_of(_declared(given, unknown, self.measured), self.model.current)
        self._check_names()
        self._check_bounds()
        self.rows = tuple(Rows(m, self.model, self.unknowns) for m in self.measured)
        self.program = LeastSquares(joined([rows.predictor() for rows in self.rows], len(self.unknowns)), self.loss)
        self.data = self._data()
        self._check_count()
        self._check_finite()

    @property
    def guess(self) -> Vector:
        """Scaled unknowns at their guesses."""
        return np.array([unknown.scaled(unknown.guess) for unknown in self.unknowns])

    def predict(self, values: Mapping[str, float]) -> Vector:
        """Return the predictions of all rows with given unknowns, SI."""
        y = np.array([unknown.scaled(values[unknown.name]) for unknown in self.unknowns])
        return self.program.predict(y)

    def fit(self, observed: Vector | None = None) -> Fit:
        """Return the fit to the measured values, or to others instead.

        Raises:
            NotConverged: no start led to an optimum.
        """
        started = time.perf_counter()
        data = self.data_of(observed)
        fit = self.estimate(data)
        return reported(self, data, fit, time.perf_counter() - started)

    def data_of(self, observed: Vector | None = None) -> Data:
        """Return the measured values with their weights, or others instead.

        Raises:
            InputError: others that are not finite numbers, one for each row.
        """
        if observed is None:
            return self.data
        values = np.asarray(observed, dtype=float)
        if values.shape != self.data.observed.shape or not np.all(np.isfinite(values)):
            raise InputError(f"observed must be {len(self.data.observed)} finite numbers, one for each row")
        return replace(self.data, observed=values)

    def estimate(self, data: Data) -> Estimate:
        """Return the best fit in scaled unknowns.

        Raises:
            NotConverged: no start led to an optimum.
        """
        return estimate(self.program, data, self.guess, self.starts)

    def interval(self, data: Data, fit: Estimate, k: int, level: float, kind: Kind) -> Interval:
        """Return the confidence interval of an unknown."""
        return interval(self.program, self.unknowns, data, fit, k, level, kind)

    def cross_validation(self, data: Data, fit: Estimate, folds: int | None, seed: int) -> CrossValidation:
        """Return the errors of the predictions for rows left out of the fit."""
        results = [m.result for m in self.measured for _ in range(m.rows)]
        deviation = fit.variance**0.5 / np.where(fit.weights > 0.0, fit.weights, np.inf)
        deviation = np.where(deviation > 0.0, deviation, np.inf)
        return cross_validate(self.program, data, fit.y, deviation, results, folds, seed)

    def next_measurements(
        self, fit: Estimate, candidates: Sequence[Candidate] | None = None
    ) -> tuple[NextMeasurement, ...]:
        """Return candidates by their gain of information, the best first."""
        if candidates is None:
            chosen = proposals(self.model, self.measured, self.unknowns)
        else:
            check_kind("the candidates", candidates, Sequence, "a list of po.Candidate")
            chosen = list(candidates)
            for one in chosen:
                check_kind("a candidate", one, Candidate, "a po.Candidate")
        weighted = fit.slope * fit.weights[:, None]
        error = self._relative_error(fit)
        known = evaluated(chosen, self.unknowns, fit.y, error, lambda one: self._row(one, fit.y))
        if not known:
            raise InputError("none of the candidates is a measurement of this scene")
        return ranked(known, self.unknowns, fit.y, weighted.T @ weighted / fit.variance)

    def _relative_error(self, fit: Estimate) -> float:
        values = np.abs(self.data.observed)
        counts = (fit.weights > 0.0) & (values > 0.0)
        return float(np.median(fit.variance**0.5 / fit.weights[counts] / values[counts]))

    def _row(self, candidate: Candidate, y: Vector) -> tuple[float, Vector]:
        """Return the value of a candidate's result, and its derivatives."""
        if candidate.result not in measurable() or candidate.result == "mount_force":
            raise InputError(f"'{candidate.result}' is neither a single result of a run nor one of the unknowns")
        conditions: dict[str, float] = {}
        for m in self.measured:
            conditions |= {key: float(np.median(column)) for key, column in m.conditions.items()}
        conditions |= candidate.conditions
        _, both = row_functions(self.model, self.unknowns, {}, candidate.result, fixed=conditions)
        value, slope = both(y, np.zeros(0))
        return float(value), np.asarray(slope, dtype=float).ravel()

    def _check_names(self) -> None:
        """Raise InputError if a column is an unknown too, or if neither a result nor an unknown was measured."""
        names = {unknown.name for unknown in self.unknowns}
        for m in self.measured:
            both = names & set(m.conditions)
            if both:
                raise InputError(f"{m.name}: '{min(both)}' is a column of the data, and so cannot be an unknown")
            if m.result not in measurable() and m.result not in names:
                unknowns = ", ".join(sorted(names))
                raise InputError(f"{m.name}: '{m.result}' was measured, and is not among the unknowns: {unknowns}")

    def _check_bounds(self) -> None:
        """Raise InputError if bounds or the first row are outside the model's domain; `Rows` checks the other rows."""
        first = next((m for m in self.measured if m.result in measurable()), self.measured[0])
        guess = {unknown.name: unknown.guess for unknown in self.unknowns} | first.at(0)
        try:
            self.model.scene(guess)
        except DomainError as error:
            raise InputError(f"{first.row(0)}: {error}") from None
        for unknown in self.unknowns:
            for side, bound in (("lower", unknown.lower), ("upper", unknown.upper)):
                try:
                    self.model.scene(guess | {unknown.name: bound})
                except DomainError as error:
                    raise InputError(f"{side} bound of '{unknown.name}': {error}") from None

    def _check_finite(self) -> None:
        """Raise InputError if a prediction or its derivatives at the guesses are not finite."""
        y = np.clip(self.guess, 0.02, 0.98)  # where the search begins
        predicted = np.column_stack([self.program.predict(y), self.program.slope(y)])
        wrong = np.flatnonzero(~np.isfinite(predicted).all(axis=1))
        names = [m.row(k) for m in self.measured for k in range(m.rows)]
        if wrong.size:
            raise InputError(f"{names[wrong[0]]}: the model gives no finite number at these conditions")

    def _data(self) -> Data:
        stated = {m.sigma is not None for m in self.measured}
        if len(stated) > 1:
            without = next(m.name for m in self.measured if m.sigma is None)
            raise InputError(f"{without}: no sigma is stated, but other sets state theirs: give each set one")
        weights = []
        for m in self.measured:
            if m.sigma is not None:
                weights.append(1.0 / m.sigma)
                continue
            size = NOMINAL * float(np.mean(np.abs(m.values))) or 1.0
            weights.append(np.sqrt(np.ones(m.rows) if m.weights is None else m.weights) / size)
        return Data(np.concatenate([m.values for m in self.measured]), np.concatenate(weights), stated.pop())

    def _check_count(self) -> None:
        least = len(self.unknowns) + (0 if self.data.stated and not self.loss.robust else 1)
        if self.data.count < least:
            why = "" if self.data.stated else ", and the scatter is to be estimated too: state sigma, or measure more"
            raise InputError(
                f"{self.measured[0].name}: {self.data.count} rows are too few for {len(self.unknowns)} unknowns"
                f" ({', '.join(u.name for u in self.unknowns)}): at least {least} are needed{why}"
            )


def _declared(
    given: Described | Scene | SceneOf, unknown: Mapping[str, Any] | None, measured: Sequence[Measurements]
) -> Mapping[str, Any]:
    """Return the unknowns with their bounds, by default the variables of a problem."""
    if unknown is not None:
        return unknown
    if not isinstance(given, Described):
        return {}
    columns = {key for m in measured for key in m.conditions}
    return {key: (v.lower, v.upper, v.guess) for key, v in given.variables.items() if key not in columns}


__all__ = ["Calibration", "Unknown", "calibrate"]
