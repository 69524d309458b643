"""A calibration before it is solved: model and measurements, checked, with the least-squares problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from plough_opt.core.errors import DomainError, InputError
from plough_opt.motion.scene import Scene
from plough_opt.studies.calibration.least_squares import Data, LeastSquares, loss_of
from plough_opt.studies.calibration.measurements import Measurements, measurable
from plough_opt.studies.calibration.model import Described, Model, SceneOf, model_of
from plough_opt.studies.calibration.prediction import Rows, predictor

NOMINAL: Final = 0.01
"""Standard deviation, as a part of the mean measured value, from which weights follow if no sigma is stated."""

# The search begins at least so far from the bounds.
_INSIDE: Final = 0.02


@dataclass(frozen=True)
class Setup:
    """A checked calibration.

    Attributes:
        model: the scene as a function of its quantities, with the unknowns.
        rows: the sets of measurements.
        problem: the sum of losses.
        data: measured values and their weights.
    """

    model: Model
    rows: tuple[Rows, ...]
    problem: LeastSquares
    data: Data

    @property
    def measured(self) -> tuple[Measurements, ...]:
        """The sets of measurements."""
        return tuple(rows.measured for rows in self.rows)

    @property
    def places(self) -> list[str]:
        """Name of every row in messages."""
        return [m.row(k) for m in self.measured for k in range(m.rows)]


def setup_of(
    given: Described | Scene | SceneOf,
    data: Measurements | Sequence[Measurements],
    unknown: Mapping[str, Any] | None,
    loss: str,
    duration: float | None,
) -> Setup:
    """Return a calibration, checked; the arguments are those of `Calibration`.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.
    """
    measured = (data,) if isinstance(data, Measurements) else tuple(data) if isinstance(data, Sequence) else ()
    if not measured or not all(isinstance(m, Measurements) for m in measured):
        raise InputError("the data must be Measurements, one set or several: po.read_measurements reads a file")
    if not any(np.any(m.values) for m in measured):
        raise InputError(f"{measured[0].name}: every measured value is 0, which fits no soil: check the column")
    own, model = loss_of(loss), model_of(given, duration, unknown, {key for m in measured for key in m.conditions})
    _check_names(model, measured)
    _check_bounds(model, measured)
    rows = tuple(Rows(m, model) for m in measured)
    setup = Setup(model, rows, LeastSquares(predictor(rows, model), own), _data(measured))
    _check_numbers(setup)
    return setup


def _check_names(model: Model, measured: Sequence[Measurements]) -> None:
    """Raise InputError if a column is an unknown too, or if neither a result nor an unknown was measured."""
    names = {unknown.name for unknown in model.unknowns}
    for m in measured:
        if both := names & set(m.conditions):
            raise InputError(f"{m.name}: '{min(both)}' is a column of the data, and so cannot be an unknown")
        if m.result not in measurable() and m.result not in names:
            known = ", ".join(sorted(names))
            raise InputError(f"{m.name}: '{m.result}' was measured, and is not among the unknowns: {known}")


def _check_bounds(model: Model, measured: Sequence[Measurements]) -> None:
    """Raise InputError if bounds or the first row are outside the model's domain; `Rows` checks the other rows."""
    first = next((m for m in measured if m.result in measurable()), measured[0])
    guess = {unknown.name: unknown.guess for unknown in model.unknowns} | first.at(0)
    tried = {first.row(0): guess}
    for own in model.unknowns:
        tried[f"lower bound of '{own.name}'"] = guess | {own.name: own.lower}
        tried[f"upper bound of '{own.name}'"] = guess | {own.name: own.upper}
    for place, values in tried.items():
        try:
            model.scene(values)
        except DomainError as error:
            raise InputError(f"{place}: {error}") from None


def _data(measured: Sequence[Measurements]) -> Data:
    """Return values and weights of all rows.

    Raises:
        InputError: some sets state sigma, and others do not.
    """
    stated = {m.sigma is not None for m in measured}
    if len(stated) > 1:
        without = next(m.name for m in measured if m.sigma is None)
        raise InputError(f"{without}: no sigma is stated, but other sets state theirs: give each set one")
    weights = []
    for m in measured:
        nominal = NOMINAL * float(np.mean(np.abs(m.values))) or 1.0
        relative = np.ones(m.rows) if m.weights is None else m.weights
        weights.append(np.sqrt(relative) / nominal if m.sigma is None else 1.0 / m.sigma)
    return Data(np.concatenate([m.values for m in measured]), np.concatenate(weights), stated.pop())


def _check_numbers(setup: Setup) -> None:
    """Raise InputError if there are too few rows, or if a prediction or a derivative at the guesses is not finite."""
    data, unknowns = setup.data, setup.model.unknowns
    least = len(unknowns) + (0 if data.stated and not setup.problem.loss.robust else 1)
    if data.count < least:
        why = "" if data.stated else ", and the scatter is to be estimated too: state sigma, or measure more"
        raise InputError(
            f"{setup.measured[0].name}: {data.count} rows are too few for {len(unknowns)} unknowns"
            f" ({', '.join(u.name for u in unknowns)}): at least {least} are needed{why}"
        )
    values, slopes = setup.problem.at(np.clip(setup.model.guess, _INSIDE, 1.0 - _INSIDE))
    finite = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
    if not np.all(finite):
        raise InputError(
            f"{setup.places[int(np.argmin(finite))]}: the model gives no finite number at these conditions"
        )
