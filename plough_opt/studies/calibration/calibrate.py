"""`calibrate`: the unknowns of a scene, with their uncertainty, from measurements."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from plough_opt.core.checks import (
    array_of,
    check_choice,
    check_named,
    check_text,
    mapping_of,
    plain_number,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError, about
from plough_opt.core.expressions import as_number
from plough_opt.core.plain_data import Array
from plough_opt.core.units import in_si
from plough_opt.studies.calibration.fit import ERRORS, LOSSES, Fit, Source
from plough_opt.studies.calibration.least_squares import NOMINAL, LeastSquares, Predictions
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.model import Model


def calibrate(
    given: Any, data: Measurements | Sequence[Measurements], unknown: Mapping[str, Any] | None = None, **options: Any
) -> Fit:
    """Estimate soil and model parameters from measurements, by least squares between bounds.

    For example::

        data = po.read_measurements("draft.csv")
        fit = po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "effects.rate_term": (0.0, 0.2)})
        print(fit.values, fit.intervals(0.95), fit.unidentifiable)

    Args:
        given: a problem file, a numeric scene, or a function of values by key that returns a scene.
        data: one set of measurements, or several.
        unknown: key of a problem file -> (lower, upper) or (lower, upper, guess), SI or text with units.
        **options: loss, errors, duration, starts and title; see `Calibration` for all arguments.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.
        NotConverged: no start led to an optimum.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
        >>> fit = po.calibrate(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
        >>> fit.freedom
        1
    """
    fit = Calibration(given, data, unknown, **options).fit()
    return replace(fit, origin=getattr(given, "origin", fit.origin))


class Calibration:
    """A calibration whose model is built once, for fits to many sets of observed values.

    Args:
        given: a problem file; a numeric scene; or a function of values by key, such as "soil.cohesion", that accepts
            symbols and returns a scene.
        data: one set of measurements, or several.
        unknown: key of a problem file -> (lower, upper) or (lower, upper, guess), SI or text with units; default: the
            variables of the problem file that are not columns of the data.
        errors: of values whose sigma is not stated: "constant" standard deviation in each set, or "relative", that is
            proportional to the result.
        loss: "squares", or "soft_l1", which gives outliers less weight.
        duration: simulated time [s] of runs whose averages were measured; default: the problem's.
        starts: number of starts: the guess, and the best of 64 points between the bounds (of 16 if they need runs).
        title: title for reports.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
        >>> po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")}).fit().loss
        'squares'
    """

    def __init__(
        self,
        given: Any,
        data: Measurements | Sequence[Measurements],
        unknown: Mapping[str, Any] | None = None,
        *,
        loss: str = "squares",
        errors: str = "constant",
        duration: float | None = None,
        starts: int = 4,
        title: str = "",
    ) -> None:
        check_text("title", title)
        check_named("no loss is named {}", loss, LOSSES)
        check_choice("errors", errors, ERRORS)
        self._starts = whole_number("starts", starts, 1, 16)
        self._sets = _sets(data)
        self._model = Model.of(given, duration, unknown, {key for m in self._sets for key in m.conditions})
        self._title = title or self._model.title
        _check_unknowns(self._model, self._sets)
        weights, stated = _weights(self._sets, relative=errors == "relative")
        self._problem = LeastSquares(
            predictions=Predictions(self._model.predictor(self._sets)),
            guess=self._model.guess,
            observed=np.concatenate([m.values for m in self._sets]),
            weights=weights,
            counted=np.concatenate([m.counted for m in self._sets]),
            stated=stated,
            relative=errors == "relative",
            robust=loss == "soft_l1",
        )
        self._check_rows()

    def predict(self, values: Mapping[str, Any]) -> Array:
        """Return the predictions of all rows, SI.

        Args:
            values: unknown -> its value, SI or text with a unit.

        Raises:
            InputError: the values are not those of all unknowns, or not finite.

        Example:
            >>> import plough_opt as po
            >>> still = po.Effects(motion=False)
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
            >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
            >>> question = po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
            >>> question.predict({"soil.cohesion": "20 kPa"}).round().tolist()
            [2405.0, 2430.0]
        """
        unknowns = {u.name: u for u in self._model.unknowns}
        values = mapping_of("the values", values, f"{{'{next(iter(unknowns))}': value}} for every unknown")
        for name in values:
            check_named("{} is not an unknown of this calibration", name, unknowns)
        if missing := [name for name in unknowns if name not in values]:
            raise InputError(f"the values lack {', '.join(missing)}: give every unknown a value")
        y = []
        for name, u in unknowns.items():
            limits = {"above": 0.0, "why": "its bounds make its scale logarithmic"} if u.log else {}
            value = plain_number(f"'{name}'", in_si(f"'{name}'", values[name], u.unit), u.unit, **limits)
            y.append(float(as_number(u.scaled(value))))
        return self._problem.predictions(np.array(y))[0]

    def fit(self, observed: Array | None = None) -> Fit:
        """Return the fit to the measured values, or to other observed values.

        Args:
            observed: other values in place of the measured ones, SI, one for each row.

        Raises:
            InputError: the observed values are not finite numbers, one for each row.
            NotConverged: no start led to an optimum.

        Example:
            >>> import plough_opt as po
            >>> still = po.Effects(motion=False)
            >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
            >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
            >>> data = po.Measurements("mean_draft", [2000.0, 2300.0], {"scene.tow_speed": [1.0, 3.0]})
            >>> question = po.Calibration(scene, data, {"soil.cohesion": ("1 kPa", "80 kPa")})
            >>> round(question.fit(question.predict({"soil.cohesion": 25e3})).values["soil.cohesion"])
            25000
        """
        started, problem = time.perf_counter(), self._problem
        if observed is not None:
            rows = problem.observed.shape
            expected = f"observed must be {rows[0]} finite numbers, one for each row"
            values = array_of(observed, expected, lambda array: array.shape == rows and np.all(np.isfinite(array)))
            problem = replace(problem, observed=values)
        solution = problem.fitted(self._starts)
        return Source(self._title, self._model, self._sets, solution).fit(started)

    def _check_rows(self) -> None:
        """Raise InputError for too few rows, or for a prediction or slope at the guess that is not finite."""
        problem, names = self._problem, [u.name for u in self._model.unknowns]
        count = int(np.sum(problem.counted))
        if count < problem.least_rows:
            why = "" if problem.stated else ", because the scatter is estimated too: state sigma, or measure more"
            few = f"{self._sets[0].name}: {count} rows are too few for {len(names)} unknowns ({', '.join(names)})"
            raise InputError(f"{few}: at least {problem.least_rows} are needed{why}")
        values, slopes = problem.predictions(np.clip(problem.guess, 0.02, 0.98))
        finite = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
        if not np.all(finite):
            places = [m.row(k) for m in self._sets for k in range(len(m.values))]
            raise InputError(f"{places[int(np.argmin(finite))]}: the model has no finite prediction there")


def _sets(data: Measurements | Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets of measurements; raise InputError if they are none, given twice, or all 0."""
    sets = (data,) if isinstance(data, Measurements) else tuple(data) if isinstance(data, Sequence) else ()
    if not sets or not all(isinstance(m, Measurements) for m in sets):
        raise InputError("the data must be Measurements, one set or several: read a file with po.read_measurements")
    if twice := [m for k, m in enumerate(sets) if any(m is other for other in sets[:k])]:
        raise InputError(f"{twice[0].name} is given twice, so its rows would count twice: remove one of the two")
    if not any(np.any(m.values[m.counted]) for m in sets):
        raise InputError(f"{sets[0].name}: every measured value is 0, which no soil gives: check the column")
    return sets


def _check_unknowns(model: Model, measured: Sequence[Measurements]) -> None:
    """Raise InputError if unknowns are columns, or if bounds or the first row are outside the model's domain."""
    guess = {u.name: u.guess for u in model.unknowns}
    for m in measured:
        if both := guess.keys() & set(m.conditions):
            raise InputError(f"{m.name}: '{min(both)}' is a column of the data, so it cannot be an unknown")
        if m.direct and m.result not in guess:
            listed = ", ".join(sorted(guess))
            raise InputError(f"{m.name}: '{m.result}' was measured, but is not among the unknowns: {listed}")
    first = next((m for m in measured if not m.direct), measured[0])
    for u in model.unknowns:
        for side, bound in (("lower", u.lower), ("upper", u.upper)):
            with about(f"{side} bound of '{u.name}':", DomainError):
                model.scene(guess | first.at(0) | {u.name: bound})


def _weights(measured: Sequence[Measurements], *, relative: bool) -> tuple[Array, bool]:
    """Return the weights of the residuals of all rows, and whether they follow from stated sigmas.

    Raises:
        InputError: some sets state sigma and others do not, or all do and errors are relative too.
    """
    stated = {m.sigma is not None for m in measured}
    if len(stated) > 1:
        without = next(m.name for m in measured if m.sigma is None)
        raise InputError(f"{without}: no sigma is stated, but other sets state theirs: give every set its sigma")
    if stated == {True}:
        if relative:
            raise InputError(f"{measured[0].name}: sigma states the errors, so they are not 'relative': omit either")
        return np.concatenate([1.0 / m.sigma for m in measured]), True
    squares = [np.ones(len(m.values)) if m.weights is None else m.weights for m in measured]
    # Only ratios of weights count: their mean is 1, as without them.
    mean = np.mean(np.concatenate([own[m.counted] for own, m in zip(squares, measured, strict=True)]))
    nominal = [NOMINAL * (1.0 if relative else float(np.mean(np.abs(m.values[m.counted])))) or 1.0 for m in measured]
    return np.concatenate([np.sqrt(own / mean) / size for own, size in zip(squares, nominal, strict=True)]), False
