"""Measurements: one measured result over conditions or time, checked, SI units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import NOT_NUMBERS, check_kind, check_named, check_text, mapping_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import every_quantity
from plough_opt.core.units import Unit
from plough_opt.motion.vocabulary import MEASURES

Vector = NDArray[np.float64]

RECORD: Final = "mount_force"
"""The result that is measured over time, in one run for each set of conditions."""


def measurable() -> tuple[str, ...]:
    """Return the names of the results that can be measured in the field, and are compared with those of a run."""
    return tuple(name for name, one in MEASURES.items() if one.measured)


def result_unit(name: str) -> Unit:
    """Return the SI unit of a result, or of a quantity that is measured on its own."""
    return MEASURES[name].unit if name in measurable() else every_quantity()[name]


@dataclass(frozen=True)
class Measurements:
    """Measured values of one result; every column has one number per row.

    For example ``Measurements("mean_draft", [3.9e3, 4.1e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=100.0)``.

    Args:
        result: what was measured: mean_draft [N], mount_force [N] over time, force_rms [N], mean_deflection [m],
            displacement_rms [m], tow_power [W], loosened_radius [m], added_mass [kg],
            cone_index [Pa]; or one of the unknowns itself,
            such as "soil.friction_angle" [rad] from a shear test.
        values: measured values, SI.
        conditions: key of a problem file such as "scene.tow_speed" -> its value in every row, SI.
        sigma: standard deviation of the measuring error, one number or one per row, above 0; None: estimated from the
            scatter.
        weights: relative weight of each row's square, at least 0, instead of sigma; a row of weight 0 is left out.
        time: times since the start of the run [s], at least 0; only for mount_force.
        name: of the set in messages, such as the file's name.
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
    values: Vector
    conditions: Mapping[str, Vector] = field(default_factory=dict)
    sigma: Vector | None = None
    weights: Vector | None = None
    time: Vector | None = None
    name: str = "measurements"
    lines: tuple[int, ...] = ()

    def __init__(
        self,
        result: str,
        values: Sequence[float] | Vector,
        conditions: Mapping[str, Sequence[float] | Vector | float] | None = None,
        *,
        sigma: Sequence[float] | Vector | float | None = None,
        weights: Sequence[float] | Vector | None = None,
        time: Sequence[float] | Vector | None = None,
        name: str = "measurements",
        lines: Sequence[int] = (),
    ) -> None:
        keep = object.__setattr__
        check_text("the name of measurements", name)
        check_kind(f"{name}: lines", lines, Sequence, "a list of the rows' line numbers")
        conditions = mapping_of(f"{name}: conditions", conditions, "a quantity's key -> its values")
        for key, value in (("result", result), ("name", name), ("lines", tuple(lines))):
            keep(self, key, value)
        self._check_names(conditions)
        keep(self, "values", self._column(result, values))
        if not self.rows:
            raise InputError(f"{name}: there are no measurements")
        columns = {key: self._column(key, column) for key, column in conditions.items()}
        keep(self, "conditions", columns)
        for key, given in (("sigma", sigma), ("weights", weights), ("time", time)):
            keep(self, key, None if given is None else self._column(key, given))
        self._check_columns()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values)

    def row(self, number: int) -> str:
        """Return the name of a row in messages.

        Raises:
            InputError: an invalid row number.
        """
        self._check_row(number)
        return self._place(number)

    def at(self, number: int) -> dict[str, float]:
        """Return the conditions of a row, SI.

        Raises:
            InputError: an invalid row number.
        """
        self._check_row(number)
        return {key: float(column[number]) for key, column in self.conditions.items()}

    def _check_names(self, conditions: Mapping[str, Any]) -> None:
        known = every_quantity()
        if not (isinstance(self.result, str) and self.result in known):
            check_named(f"{self.name}: {{}} is not a measured result", self.result, measurable())
        for key in conditions:
            check_named(f"{self.name}: {{}} is not a quantity of a scene", key, known)
            if key == self.result:
                raise InputError(f"{self.name}: '{key}' is both measured and a condition")

    def _place(self, number: int) -> str:
        return f"{self.name}, line {self.lines[number]}" if self.lines else f"{self.name}, row {number + 1}"

    def _check_row(self, number: int) -> None:
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < self.rows:
            raise InputError(f"{self.name}: row {shown(number)} must be a whole number from 0 to {self.rows - 1}")

    def _column(self, key: str, given: Any) -> Vector:
        """Return a column of finite numbers; a single number applies to all rows."""
        try:
            column = np.array(given, dtype=float)
        except NOT_NUMBERS:
            raise InputError(f"{self.name}: '{key}' must be a column of numbers, SI units") from None
        if column.ndim == 0 and hasattr(self, "values"):
            column = np.full(self.rows, float(column))
        if column.ndim != 1 or (hasattr(self, "values") and len(column) != self.rows):
            expected = f"{self.rows} rows, as '{self.result}' has" if hasattr(self, "values") else "one dimension"
            raise InputError(f"{self.name}: '{key}' has the shape {column.shape}, and must have {expected}")
        self._refuse(key, column, ~np.isfinite(column), "a finite number")
        column.flags.writeable = False
        return column

    def _check_columns(self) -> None:
        if self.sigma is not None:
            self._refuse("sigma", self.sigma, self.sigma <= 0.0, "above 0: it is a standard deviation")
        if self.weights is not None:
            self._refuse("weights", self.weights, self.weights < 0.0, "at least 0")
            if self.sigma is not None:
                raise InputError(f"{self.name}: sigma and weights exclude each other: keep sigma")
            if not np.any(self.weights > 0.0):
                raise InputError(f"{self.name}: every weight is 0, which leaves no row")
        if self.time is not None:
            self._refuse("time", self.time, self.time < 0.0, "at least 0: it counts from the start of the run")
        if (self.time is not None) != (self.result == RECORD):
            if self.time is None:
                raise InputError(f"{self.name}: {RECORD} is measured over time: a column 'time' is missing")
            raise InputError(f"{self.name}: {self.result} is one value for a run: a column 'time' goes with {RECORD}")

    def _refuse(self, key: str, column: Vector, bad: NDArray[np.bool_], expected: str) -> None:
        if np.any(bad):
            number = int(np.argmax(bad))
            raise InputError(f"{self._place(number)}: {key} = {column[number]:g} must be {expected}")
