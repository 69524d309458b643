"""Measured values with their conditions and errors, from Python or a CSV file."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import array_of, check_kind, check_named, check_text, mapping_of, path_of
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import ByValue
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import EVERY, quantities
from plough_opt.core.tables import columns_of, heading_of, raise_listed, read_rows, table_of
from plough_opt.core.units import Unit, in_si
from plough_opt.motion.vocabulary import MEASURES

RECORD: Final = "mount_force"
"""The result that is measured over time; rows with equal conditions belong to one run."""
_EXAMPLE: Final = "'scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]'"


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
    values: Any
    conditions: Any = None
    _: KW_ONLY
    sigma: Any = None
    weights: Any = None
    time: Any = None
    name: str = "measurements"
    lines: Sequence[int] = ()

    def __post_init__(self) -> None:
        check_text("the name of measurements", self.name)
        check_kind(f"{self.name}: lines", self.lines, Sequence, "a list of the rows' line numbers")
        conditions = mapping_of(f"{self.name}: conditions", self.conditions, "a quantity's key -> its values")
        if not (isinstance(self.result, str) and self.result in EVERY):
            check_named(f"{self.name}: {{}} is not a measured result", self.result, measurable())
        for key in conditions:
            check_named(f"{self.name}: {{}} is not a quantity of a scene", key, EVERY)
        if self.result in conditions:
            raise InputError(f"{self.name}: '{self.result}' is both measured and a condition")
        values = self._column(self.result, self.values, self.unit)
        if not len(values):
            raise InputError(f"{self.name}: there are no measurements")
        columns = {key: self._column(key, own, Unit(EVERY[key].unit), len(values)) for key, own in conditions.items()}
        vars(self).update(values=values, conditions=columns, lines=tuple(self.lines))
        for key, unit in (("sigma", self.unit), ("weights", Unit("")), ("time", Unit("s"))):
            if getattr(self, key) is not None:
                vars(self)[key] = self._column(key, getattr(self, key), unit, len(values))
        self._check_columns()

    @property
    def unit(self) -> Unit:
        """SI unit of the measured values."""
        return Unit(EVERY[self.result].unit) if self.direct else MEASURES[self.result].unit

    @property
    def direct(self) -> bool:
        """Whether a quantity of the scene was measured, and not a result."""
        return self.result in EVERY

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Mask of the rows that are not left out by a weight of 0."""
        return np.full(len(self.values), True) if self.weights is None else self.weights > 0.0

    @property
    def distinct(self) -> tuple[Array, NDArray[np.intp]]:
        """Distinct combinations of conditions (rows), and the number of each row's own."""
        # A column of zeros, dropped below, allows measurements without conditions.
        columns = np.column_stack([np.zeros(len(self.values)), *self.conditions.values()])
        table, which = np.unique(columns, axis=0, return_inverse=True)
        return table[:, 1:], which.ravel()

    def row(self, number: int) -> str:
        """Return the name of a row, counted from 0, for messages.

        Example:
            >>> import plough_opt as po
            >>> data = po.Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]}, name="field 3")
            >>> data.row(1)
            'field 3, row 2'
        """
        return f"{self.name}, line {self.lines[number]}" if self.lines else f"{self.name}, row {number + 1}"

    def at(self, number: int) -> dict[str, float]:
        """Return the conditions of a row, counted from 0, SI.

        Example:
            >>> import plough_opt as po
            >>> data = po.Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]})
            >>> data.at(1)
            {'scene.tow_speed': 2.0}
        """
        return {key: float(column[number]) for key, column in self.conditions.items()}

    def _column(self, key: str, values: Any, unit: Unit, rows: int | None = None) -> Array:
        """Return a column of finite numbers; a single number stands for all rows, if their number is known."""
        values = in_si(f"{self.name}: '{key}'", values, unit.symbol)
        column = array_of(values, f"{self.name}: '{key}' must be a column of numbers, SI units")
        if column.ndim == 0 and rows is not None:
            column = np.full(rows, float(column))
        if column.ndim != 1 or rows not in (None, len(column)):
            expected = "one dimension" if rows is None else f"{rows} rows, as '{self.result}' has"
            raise InputError(f"{self.name}: '{key}' has the shape {column.shape}, and must have {expected}")
        self._refuse(key, column, ~np.isfinite(column), "a finite number")
        column.flags.writeable = False
        return column

    def _check_columns(self) -> None:
        """Raise InputError if numbers are outside their domains, or if the columns do not go together."""
        columns = {"weights": self.weights, "time": self.time}
        if not (self.direct or self.result == RECORD):
            columns[self.result] = self.values
        for key, column in columns.items():
            if column is not None:
                self._refuse(key, column, column < 0.0, "at least 0")
        if self.sigma is not None:
            self._refuse("sigma", self.sigma, self.sigma <= 0.0, "above 0: it is a standard deviation")
        untimed, timed = self.time is None and self.result == RECORD, self.time is not None and self.result != RECORD
        for wrong, why in (
            (self.sigma is not None and self.weights is not None, "sigma and weights exclude each other: keep sigma"),
            (not np.any(self.counted), "every weight is 0, which leaves no row: omit this set"),
            (untimed, f"{RECORD} is measured over time: a column 'time [s]' is missing"),
            (timed, f"one value per run: a time goes with {RECORD} only"),
        ):
            if wrong:
                raise InputError(f"{self.name}: {why}")

    def _refuse(self, key: str, column: Array, bad: NDArray[np.bool_], expected: str) -> None:
        """Raise InputError for the first bad row of a column."""
        if np.any(bad):
            number = int(np.argmax(bad))
            raise InputError(f"{self.row(number)}: {key} = {column[number]:g} must be {expected}")


def measurable() -> tuple[str, ...]:
    """Return the names of the results that can be measured in the field."""
    return tuple(name for name, measure in MEASURES.items() if measure.measured)


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
    shown = [(text.strip(), factor) for text, (_, factor) in zip(headings, columns, strict=True)]
    table = table_of(path, rows[1:], shown, lambda *_: None)
    values = {name: table[:, k] for k, (name, _) in enumerate(columns)}
    result = next(name for name in values if name in measurable())
    measured, sigma = values.pop(result), values.pop("sigma", None)
    if sigma is not None and relative:
        with np.errstate(over="ignore"):  # `Measurements` reports an infinite number with its row
            sigma = sigma * np.abs(measured)
    about = {"sigma": sigma, "weights": values.pop("weight", None), "time": values.pop("time", None)}
    return Measurements(result, measured, values, **about, name=str(path), lines=[number for number, _ in rows[1:]])


def _columns(place: str, headings: Sequence[str], relative: bool) -> list[tuple[str, float]]:
    """Return name and factor to SI of the columns that a header names.

    Raises:
        InputError: invalid columns, or columns that do not go together; the message lists all.
    """
    measured = {name: MEASURES[name].unit for name in measurable()}
    results = [name for text in headings if (name := heading_of(text, measured)[0]) in measured]
    # Without a measured result the unit of sigma is unknown: report the missing result only.
    sigma = [text for text in headings if heading_of(text, ("sigma",))[0] == "sigma"]
    units = quantities() | measured | {"weight": Unit(""), "time": Unit("s")}
    units["sigma"] = measured[results[0]] if results and not relative else Unit("")
    columns = columns_of(place, [text for text in headings if results or text not in sigma], units)
    names = [name for name, _ in columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    errors = [f"{place}, column '{key}': it is given twice: leave one of the two out" for key in twice]
    if not results:
        valid = f"add one of {', '.join(measurable())}, such as {_EXAMPLE}"
        errors.append(f"{place}: no column holds a measured result: {valid}")
    if len(set(results)) > 1:
        errors.append(f"{place}: {' and '.join(results)} are measured: write one file for each, and give all files")
    raise_listed(errors)
    return columns
