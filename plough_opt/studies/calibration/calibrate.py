"""`calibrate`: the unknowns of a scene, with their uncertainty, from measurements."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from plough_opt.core.checks import array_of, check_choice, check_named, check_text, mapping_of, whole_number
from plough_opt.core.errors import DomainError, InputError, about
from plough_opt.core.plain_data import Array
from plough_opt.studies.calibration.estimate import ERRORS, INSIDE, LOSSES, NOMINAL, Data, LeastSquares, Setup, estimate
from plough_opt.studies.calibration.fit import Fit, reported
from plough_opt.studies.calibration.model import CalibrationModel, Given, Measurements, Rows, model_of, predictor


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
        loss: "squares", or a robust loss that gives outliers less weight: "huber", "soft_l1", "cauchy".
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
        given: Given,
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
        self.starts = whole_number("starts", starts, 1, 16)
        measured = (data,) if isinstance(data, Measurements) else tuple(data) if isinstance(data, Sequence) else ()
        if not measured or not all(isinstance(m, Measurements) for m in measured):
            raise InputError("the data must be Measurements, one set or several: read a file with po.read_measurements")
        if twice := [m for k, m in enumerate(measured) if any(m is other for other in measured[:k])]:
            raise InputError(f"{twice[0].name} is given twice, so its rows would count twice: remove one of the two")
        if not any(np.any(m.values[m.counted]) for m in measured):
            raise InputError(f"{measured[0].name}: every measured value is 0, which no soil gives: check the column")
        check_named("no loss is named {}", loss, LOSSES)
        check_choice("errors", errors, ERRORS)
        model = model_of(given, duration, unknown, {key for m in measured for key in m.conditions})
        _check_names(model, measured)
        _check_bounds(model, measured)
        rows = tuple(Rows(m, model) for m in measured)
        problem = LeastSquares(predictor(rows, model), LOSSES[loss])
        self.setup = Setup(model, rows, problem, _data(measured, errors))
        _check_numbers(self.setup)
        self.title = title or model.title

    def predict(self, values: Mapping[str, Any]) -> Array:
        """Return the predictions of all rows, SI.

        Args:
            values: unknown -> its value, SI or text with a unit.

        Raises:
            InputError: the values are not those of all unknowns.
            DomainError: a value is not finite.

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
        unknowns = self.setup.model.unknowns
        names = [unknown.name for unknown in unknowns]
        given = mapping_of("the values", values, f"{{'{names[0]}': value}} for every unknown")
        for name in given:
            check_named("{} is not an unknown of this calibration", name, names)
        if missing := [name for name in names if name not in given]:
            raise InputError(f"the values lack {', '.join(missing)}: give every unknown a value")
        y = np.array([u.scaled(u.read(f"'{u.name}'", given[u.name])) for u in unknowns])
        return self.setup.problem.at(y)[0]

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
        started = time.perf_counter()
        data = self.setup.data
        if observed is not None:
            rows = data.observed.shape
            expected = f"observed must be {rows[0]} finite numbers, one for each row"
            values = array_of(observed, expected, lambda array: array.shape == rows and np.all(np.isfinite(array)))
            data = replace(data, observed=values)
        return reported(self.title, estimate(self.setup, data, self.setup.model.guess, self.starts), started)


def calibrate(
    given: Given, data: Measurements | Sequence[Measurements], unknown: Mapping[str, Any] | None = None, **options: Any
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


def _check_names(model: CalibrationModel, measured: Sequence[Measurements]) -> None:
    """Raise InputError if a column is also an unknown, or if neither a result nor an unknown was measured."""
    names = {unknown.name for unknown in model.unknowns}
    for m in measured:
        if both := names & set(m.conditions):
            raise InputError(f"{m.name}: '{min(both)}' is a column of the data, so it cannot be an unknown")
        if m.direct and m.result not in names:
            listed = ", ".join(sorted(names))
            raise InputError(f"{m.name}: '{m.result}' was measured, but is not among the unknowns: {listed}")


def _check_bounds(model: CalibrationModel, measured: Sequence[Measurements]) -> None:
    """Raise InputError if the bounds or the first row are outside the model's domain; `Rows` checks other rows."""
    first = next((m for m in measured if not m.direct), measured[0])
    guess = {unknown.name: unknown.guess for unknown in model.unknowns} | first.at(0)
    tried = {first.row(0): guess}
    for u in model.unknowns:
        tried |= {f"{side} bound of '{u.name}'": guess | {u.name: getattr(u, side)} for side in ("lower", "upper")}
    for place, values in tried.items():
        with about(f"{place}:", DomainError):
            model.scene(values)


def _data(measured: Sequence[Measurements], errors: str) -> Data:
    """Return values and weights of all rows.

    Raises:
        InputError: some sets state sigma and others do not, or all do and errors are relative too.
    """
    relative = errors == "relative"
    stated = {m.sigma is not None for m in measured}
    if len(stated) > 1:
        without = next(m.name for m in measured if m.sigma is None)
        raise InputError(f"{without}: no sigma is stated, but other sets state theirs: give every set its sigma")
    if relative and stated == {True}:
        raise InputError(f"{measured[0].name}: sigma states the errors, so they cannot be 'relative' too: omit either")
    squares = [np.ones(m.rows) if m.weights is None else m.weights for m in measured]
    # Only ratios of weights count: their mean is 1, as without them.
    mean = float(np.mean(np.concatenate([weight[m.counted] for weight, m in zip(squares, measured, strict=True)])))
    weights = []
    for weight, m in zip(squares, measured, strict=True):
        nominal = NOMINAL if relative else NOMINAL * float(np.mean(np.abs(m.values[m.counted]))) or 1.0
        weights.append(np.sqrt(weight / mean) / nominal if m.sigma is None else 1.0 / m.sigma)
    return Data(np.concatenate([m.values for m in measured]), np.concatenate(weights), stated.pop(), relative)


def _check_numbers(setup: Setup) -> None:
    """Raise InputError if there are too few rows, or if a prediction or derivative at the guess is not finite."""
    data, unknowns = setup.data, setup.model.unknowns
    least = len(unknowns) + (0 if data.stated and not setup.problem.loss.robust else 1)
    if data.count < least:
        why = "" if data.stated else ", because the scatter is estimated too: state sigma, or measure more"
        names, few = ", ".join(u.name for u in unknowns), f"{setup.measured[0].name}: {data.count} rows are too few"
        raise InputError(f"{few} for {len(unknowns)} unknowns ({names}): at least {least} are needed{why}")
    values, slopes = setup.problem.at(np.clip(setup.model.guess, INSIDE, 1.0 - INSIDE))
    finite = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
    if not np.all(finite):
        raise InputError(f"{setup.places[int(np.argmin(finite))]}: the model has no finite prediction there")
