"""`Measurements`: checked values of one measured result over conditions or time, from Python or from a CSV file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import array_of, check_kind, check_named, check_text, mapping_of, path_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import ByValue
from plough_opt.core.plain_data import Array, MaybeInfinite
from plough_opt.core.quantities import every_quantity, quantities
from plough_opt.core.tables import columns_of, heading_of, raise_listed, read_rows, table_of
from plough_opt.core.units import Unit, in_si
from plough_opt.motion.vocabulary import MEASURES

RECORD: Final = "mount_force"
"""The result that is measured over time; rows with equal conditions belong to one run."""
_EXAMPLE: Final = "'scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]'"


def measurable() -> tuple[str, ...]:
    """Return the names of the results that can be measured in the field."""
    return tuple(name for name, measure in MEASURES.items() if measure.measured)


def result_unit(name: str) -> Unit:
    """Return the SI unit of a result, or of a quantity that is measured directly."""
    return MEASURES[name].unit if name in measurable() else every_quantity()[name]


@dataclass(frozen=True, eq=False)
class Measurements(ByValue):
    """Measured values of one result, with a number per row in every column.

    For example ``Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=100.0)``.

    Args:
        result: the measured result: mean_draft [N], mount_force [N] over time, force_rms [N], mean_deflection [m],
            displacement_rms [m], tow_power [W], loosened_radius [m], added_mass [kg] or cone_index [Pa]; or an unknown
            that was measured directly, such as "soil.friction_angle" [rad] in a shear test.
        values: measured values, SI.
        conditions: key of a problem file, such as "scene.tow_speed" -> its value in every row, SI.
        sigma: standard deviation of the measuring error, one number or one per row, above 0; None: estimated from the
            scatter.
        weights: relative weight of each row's square, at least 0, instead of sigma; rows of weight 0 are left out.
        time: times since the start of the run [s], at least 0; only for mount_force.
        name: name of the set in messages, such as the file's name.
        lines: line of the file for each row.

    Raises:
        InputError: an unknown name, columns of unequal length, or an invalid number; the message names the row.

    Example:
        >>> import plough_opt as po
        >>> data = po.Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=100.0)
        >>> data.result
        'mean_draft'
    """

    result: str
    values: Array
    conditions: Mapping[str, Array]
    sigma: Array | None
    weights: Array | None
    time: Array | None
    name: str
    lines: tuple[int, ...]

    def __init__(
        self,
        result: str,
        values: Sequence[float] | Array,
        conditions: Mapping[str, Sequence[float] | Array | float] | None = None,
        *,
        sigma: Sequence[float] | Array | float | None = None,
        weights: Sequence[float] | Array | None = None,
        time: Sequence[float] | Array | None = None,
        name: str = "measurements",
        lines: Sequence[int] = (),
    ) -> None:
        check_text("the name of measurements", name)
        check_kind(f"{name}: lines", lines, Sequence, "a list of the rows' line numbers")
        conditions = mapping_of(f"{name}: conditions", conditions, "a quantity's key -> its values")
        _check_names(name, result, conditions)
        for key, value in (("result", result), ("name", name), ("lines", tuple(lines))):
            object.__setattr__(self, key, value)
        measured = self._column(result, values)
        count = len(measured)
        if not count:
            raise InputError(f"{name}: there are no measurements")
        columns = {key: self._column(key, column, count) for key, column in conditions.items()}
        optional = {key: None if given is None else self._column(key, given, count)
                    for key, given in (("sigma", sigma), ("weights", weights), ("time", time))}  # fmt: skip
        for key, column in {"values": measured, "conditions": columns, **optional}.items():
            object.__setattr__(self, key, column)
        self._check_columns()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values)

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Mask of the rows that are not left out by a weight of 0."""
        return np.full(self.rows, True) if self.weights is None else self.weights > 0.0

    def row(self, number: int) -> str:
        """Return the name of a row for messages.

        Raises:
            InputError: an invalid row number.

        Example:
            >>> import plough_opt as po
            >>> data = po.Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]}, name="field 3")
            >>> data.row(1)
            'field 3, row 2'
        """
        self._check_row(number)
        return self._place(number)

    def at(self, number: int) -> dict[str, float]:
        """Return the conditions of a row, SI.

        Raises:
            InputError: an invalid row number.

        Example:
            >>> import plough_opt as po
            >>> data = po.Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]})
            >>> data.at(1)
            {'scene.tow_speed': 2.0}
        """
        self._check_row(number)
        return {key: float(column[number]) for key, column in self.conditions.items()}

    def _place(self, number: int) -> str:
        return f"{self.name}, line {self.lines[number]}" if self.lines else f"{self.name}, row {number + 1}"

    def _check_row(self, number: int) -> None:
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < self.rows:
            raise InputError(f"{self.name}: row {shown(number)} must be a whole number from 0 to {self.rows - 1}")

    def _column(self, key: str, given: Any, rows: int | None = None) -> Array:
        """Return a column of finite numbers; a single number stands for all rows, if their number is known."""
        others = {"sigma": result_unit(self.result), "weights": Unit(""), "time": Unit("s")}
        given = in_si(f"{self.name}: '{key}'", given, (others.get(key) or result_unit(key)).symbol)
        column = array_of(given, f"{self.name}: '{key}' must be a column of numbers, SI units")
        if column.ndim == 0 and rows is not None:
            column = np.full(rows, float(column))
        if column.ndim != 1 or len(column) != (len(column) if rows is None else rows):
            expected = "one dimension" if rows is None else f"{rows} rows, as '{self.result}' has"
            raise InputError(f"{self.name}: '{key}' has the shape {column.shape}, and must have {expected}")
        self._check_rows(key, column, ~np.isfinite(column), "a finite number")
        column.flags.writeable = False
        return column

    def _check_columns(self) -> None:
        """Raise InputError if numbers are outside their domains, or if the columns do not go together."""
        if self.result in measurable() and self.result != RECORD:
            self._check_rows(self.result, self.values, self.values < 0.0, "at least 0: forces count against the travel")
        if self.sigma is not None:
            self._check_rows("sigma", self.sigma, self.sigma <= 0.0, "above 0: it is a standard deviation")
        if self.weights is not None:
            self._check_rows("weights", self.weights, self.weights < 0.0, "at least 0")
            if self.sigma is not None:
                raise InputError(f"{self.name}: sigma and weights exclude each other: keep sigma")
            if not np.any(self.weights > 0.0):
                raise InputError(f"{self.name}: every weight is 0, which leaves no row: omit this set")
        if self.time is not None:
            self._check_rows("time", self.time, self.time < 0.0, "at least 0: it counts from the start of the run")
            if self.result != RECORD:
                raise InputError(
                    f"{self.name}, column 'time': {self.result} is one value per run: a time goes with {RECORD} only"
                )
        elif self.result == RECORD:
            raise InputError(f"{self.name}: {RECORD} is measured over time: a column 'time [s]' is missing")

    def _check_rows(self, key: str, column: Array, bad: NDArray[np.bool_], expected: str) -> None:
        """Raise InputError for the first bad row of a column."""
        if np.any(bad):
            number = int(np.argmax(bad))
            raise InputError(f"{self._place(number)}: {key} = {column[number]:g} must be {expected}")


@dataclass(frozen=True)
class Row:
    """A measured row with its prediction, SI.

    Attributes:
        place: file and line, or set and row.
        result: the measured result.
        unit: its unit.
        conditions: conditions of the row by key.
        time: time since the start of the run [s], or None.
        observed: measured value.
        predicted: fitted value.
        sigma: standard deviation of the measurement, stated or estimated; infinite for a row of weight 0.
        standard_error: standard error of the prediction, from the errors of the determined unknowns.
        residual: predicted minus observed value.
    """

    place: str
    result: str
    unit: str
    conditions: Mapping[str, float]
    time: float | None
    observed: float
    predicted: float
    sigma: MaybeInfinite
    standard_error: MaybeInfinite
    residual: float


def _check_names(name: str, result: object, conditions: Mapping[str, Any]) -> None:
    """Raise InputError if the result or a condition is unknown, or if the result is also a condition."""
    quantities_by_name = every_quantity()
    if not (isinstance(result, str) and result in quantities_by_name):
        check_named(f"{name}: {{}} is not a measured result", result, measurable())
    for key in conditions:
        check_named(f"{name}: {{}} is not a quantity of a scene", key, quantities_by_name)
        if key == result:
            raise InputError(f"{name}: '{key}' is both measured and a condition")


def read_measurements(path: str | Path) -> Measurements:
    """Read one measured result from a CSV file.

    The first line that is not empty and does not begin with ``#`` names the columns with their units, such as
    ``scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]``. Conditions have their keys in a
    problem file. There is one measured result, and optionally ``sigma`` (its standard deviation, in its unit or in
    ``%``) or ``weight``; ``mount_force`` needs a column ``time``. Cells are numbers with a decimal point, separated by
    commas, semicolons or tabs; between semicolons they may have decimal commas.

    Raises:
        InputError: the file does not exist, or has an invalid column or cell; the message lists each with line, column,
            the expected value and the nearest valid name.

    Example:
        >>> import plough_opt as po
        >>> po.read_measurements("problems/synthetic_draft.csv").result
        'mean_draft'
    """
    path = path_of("the file of measurements", path)
    rows = read_rows(path, "measurements")
    if not rows:
        raise InputError(f"{path}: the file is empty: name the columns in its first line, such as {_EXAMPLE}")
    line, headings = rows[0]
    relative = any(heading_of(text, ("sigma",)) == ("sigma", "%") for text in headings)
    columns = _columns(f"{path}, line {line}", headings, relative)
    if len(rows) == 1:
        raise InputError(f"{path}, line {line}: there is no row below the header: add the measured values")
    named = [(text.strip(), factor) for text, (_, factor) in zip(headings, columns, strict=True)]
    table = table_of(path, rows[1:], named, lambda k, value, cell: _check_cell(columns[k][0], value, cell))
    values = {name: table[:, k] for k, (name, _) in enumerate(columns)}
    result = next(name for name in values if name in measurable())
    sigma = values.pop("sigma", None)
    if sigma is not None and relative:
        with np.errstate(over="ignore"):  # `Measurements` reports an infinite number with its row
            sigma = sigma * np.abs(values[result])
    time, weights, measured = values.pop("time", None), values.pop("weight", None), values.pop(result)
    lines = [number for number, _ in rows[1:]]
    return Measurements(result, measured, values, sigma=sigma, weights=weights, time=time, name=str(path), lines=lines)


def _columns(place: str, headings: Sequence[str], relative: bool) -> list[tuple[str, float]]:
    """Return name and factor to SI of the columns that a header names.

    Raises:
        InputError: invalid columns, or columns that do not go together; the message lists all.
    """
    measured = [name for text in headings if (name := heading_of(text, measurable())[0]) in measurable()]
    units = {**quantities(), **{name: MEASURES[name].unit for name in measurable()}}
    of_sigma = MEASURES[measured[0]].unit if measured and not relative else Unit("")
    units |= {"sigma": of_sigma, "weight": Unit(""), "time": Unit("s")}
    # Without a measured result the unit of sigma is unknown: report the missing result only.
    known = (text for text in headings if measured or heading_of(text, ("sigma",))[0] != "sigma")
    columns = columns_of(place, [*known], units)
    names = [name for name, _ in columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    errors = [f"{place}, column '{key}': it is given twice: leave one of the two out" for key in twice]
    if not measured:
        errors.append(
            f"{place}: no column holds a measured result: add one of {', '.join(measurable())}, such as {_EXAMPLE}"
        )
    if len(set(measured)) > 1:
        errors.append(f"{place}: {' and '.join(measured)} are measured: write one file for each, and give all files")
    raise_listed(errors)
    return columns


def _check_cell(name: str, value: float, cell: str) -> None:
    """Raise InputError if a number is outside the domain of its column."""
    if name == "sigma" and value <= 0.0:
        raise InputError(f"{cell} must be above 0: it is a standard deviation")
    if name in ("weight", "time") and value < 0.0:
        raise InputError(f"{cell} must be at least 0")
