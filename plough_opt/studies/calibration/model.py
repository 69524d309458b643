"""Measurements, and the scene as a model of them: its predictions as a CasADi Function of the unknowns.

Each unknown is searched between bounds, and scaled to the interval from 0 to 1.
"""

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import (
    array_of,
    check_bounds,
    check_domain,
    check_kind,
    check_named,
    check_text,
    mapping_of,
    path_of,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError, about
from plough_opt.core.expressions import ByValue, Column, Expression, as_number, is_symbolic, stacked
from plough_opt.core.plain_data import Array, MaybeInfinite
from plough_opt.core.quantities import EVERY, quantities
from plough_opt.core.tables import columns_of, heading_of, raise_listed, read_rows, table_of
from plough_opt.core.units import Unit, in_si
from plough_opt.design.declarations import Scaled
from plough_opt.laws.forces import cone_index
from plough_opt.motion import simulate
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene, quantities_of, with_quantities
from plough_opt.motion.solvers.plan import numbers_of, phase
from plough_opt.motion.vocabulary import MEASURES

RECORD: Final = "mount_force"
"""The result that is measured over time; rows with equal conditions belong to one run."""
_EXAMPLE: Final = "'scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [kN]'"


def measurable() -> tuple[str, ...]:
    """Return the names of the results that can be measured in the field."""
    return tuple(name for name, measure in MEASURES.items() if measure.measured)


def result_unit(name: str) -> Unit:
    """Return the SI unit of a result, or of a quantity that is measured directly."""
    return MEASURES[name].unit if name in measurable() else Unit(EVERY[name].unit)


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
        if not (isinstance(result, str) and result in EVERY):
            check_named(f"{name}: {{}} is not a measured result", result, measurable())
        for key in conditions:
            check_named(f"{name}: {{}} is not a quantity of a scene", key, EVERY)
            if key == result:
                raise InputError(f"{name}: '{key}' is both measured and a condition")
        vars(self).update(result=result, name=name, lines=tuple(lines))
        measured = self._column(result, values)
        count = len(measured)
        if not count:
            raise InputError(f"{name}: there are no measurements")
        columns = {key: self._column(key, column, count) for key, column in conditions.items()}
        optional = {key: None if given is None else self._column(key, given, count)
                    for key, given in (("sigma", sigma), ("weights", weights), ("time", time))}  # fmt: skip
        vars(self).update(values=measured, conditions=columns, **optional)
        self._check_columns()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values)

    @property
    def direct(self) -> bool:
        """Whether a quantity of the scene was measured, and not a result."""
        return self.result not in measurable()

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
        whole_number(f"{self.name}: row", number, 0, self.rows - 1)

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
        if not self.direct and self.result != RECORD:
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
                raise InputError(f"{self.name}: {self.result} is one value per run: a time goes with {RECORD} only")
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


SceneOf: TypeAlias = Callable[[Mapping[str, Expression]], Scene]
_DURATION = "scene.duration"
# An unknown whose bounds have at least this ratio is scaled logarithmically.
_LOG_RATIO = 10.0
# Assumed standard deviation of a direct measurement of an unknown, as a part of the distance of its bounds.
_DIRECT_ERROR: Final = 0.05


@runtime_checkable
class Described(Protocol):
    """A scene with named quantities, such as the problem that `read_problem` returns."""

    @property
    def title(self) -> str:
        """Title for reports."""

    @property
    def accuracy(self) -> Accuracy:
        """Method and setting of runs."""

    @property
    def variables(self) -> Mapping[str, Any]:
        """Quantities that a design may change, each with attributes lower, upper and guess."""

    def values(self) -> dict[str, Expression]:
        """Return the given quantities by name, SI."""

    def scene(self, changes: Mapping[str, Expression] | None = None) -> Scene:
        """Return the scene with changed values of some quantities."""


Given: TypeAlias = Described | Scene | SceneOf
"""What a calibration takes as its model."""


@dataclass(frozen=True)
class Unknown(Scaled):
    """A quantity to find.

    Attributes:
        name: its key in a problem file, such as "soil.cohesion".
        unit: SI unit.
        lower: least value.
        upper: largest value.
        guess: start of the search.
        log: whether its logarithm is scaled, as for a positive quantity of unknown order of magnitude.
    """

    name: str
    unit: str
    lower: float
    upper: float
    guess: float
    log: bool

    def read(self, what: str, value: Any) -> float:
        """Return a value in SI, given as a number, text with a unit or a pint quantity.

        Raises:
            InputError, DomainError: it is not a quantity of this kind, not finite, or outside the unknown's scale.
        """
        read = in_si(what, value, self.unit)
        why = "its bounds make its scale logarithmic" if self.log else ""
        check_domain(what, read, self.unit, above=0.0 if self.log else -np.inf, why=why)
        return plain_number(what, read)

    @property
    def direct_error(self) -> float:
        """Standard deviation that is assumed for a direct measurement."""
        return _DIRECT_ERROR * (self.upper - self.lower)


@dataclass(frozen=True)
class CalibrationModel:
    """A scene as a function of its named quantities, and the unknowns among them.

    Attributes:
        title: title for reports.
        build: key -> changed value, a number or a symbol -> scene.
        current: key -> the scene's own value.
        duration: simulated time [s], or None if no result needs it.
        accuracy: method and setting of runs.
        unknowns: the quantities to find.
    """

    title: str
    build: SceneOf
    current: Mapping[str, float]
    duration: float | None
    accuracy: Accuracy
    unknowns: tuple[Unknown, ...]

    @property
    def guess(self) -> Array:
        """Scaled unknowns at their guesses."""
        return np.array([unknown.scaled(unknown.guess) for unknown in self.unknowns])

    def values(self, y: Sequence[Expression] | Array) -> dict[str, Expression]:
        """Return name -> value of the unknowns at scaled values."""
        return {unknown.name: unknown.unscaled(y[k]) for k, unknown in enumerate(self.unknowns)}

    def scene(self, values: Mapping[str, Expression]) -> Scene:
        """Return the scene with changed values; a duration among them is ignored, as it is not part of the scene."""
        scene = self.build({key: value for key, value in values.items() if key != _DURATION})
        check_kind("what the function of values returns", scene, Scene, "a Scene")
        return scene

    def duration_of(self, values: Mapping[str, Expression]) -> Expression | None:
        """Return the simulated time [s]."""
        return values.get(_DURATION, self.duration)


def model_of(
    given: Given, duration: float | None, unknown: Mapping[str, Any] | None, columns: Set[str]
) -> CalibrationModel:
    """Return the model of a problem, a scene or a function.

    Args:
        given: a problem, a numeric scene, or a function of values by key that returns a scene.
        duration: simulated time [s]; None: the problem's.
        unknown: key -> (lower, upper) or (lower, upper, guess); None: the problem's variables except the columns.
        columns: keys that are columns of the data.

    Raises:
        InputError: ``given`` has the wrong type, a name is unknown, or bounds are invalid.
    """
    title, accuracy = "calibration", Accuracy()
    current: dict[str, float] = {}
    build: SceneOf
    if isinstance(given, Described):
        current = _current(given.scene()) | {key: float(value) for key, value in given.values().items()}
        duration = current.get(_DURATION) if duration is None else duration
        title, build, accuracy = given.title, partial(_of_file, given), given.accuracy
        if unknown is None:
            variables = {key: variable for key, variable in given.variables.items() if key not in columns}
            unknown = {key: (variable.lower, variable.upper, variable.guess) for key, variable in variables.items()}
    elif isinstance(given, Scene):
        title, build, current = given.soil.name, partial(with_quantities, given), _current(given)
    elif callable(given):
        build = given
    else:
        raise InputError(f"{shown(given)} must be a Problem, a Scene, or a function of values that returns a Scene")
    bounds_of = mapping_of("unknown", unknown, "{'soil.cohesion': (1e3, 80e3)}")
    if not bounds_of:
        raise InputError("there are no unknowns: name each with its bounds, as {'soil.cohesion': (1e3, 80e3)}")
    unknowns = tuple(_unknown(name, bounds, current.get(name)) for name, bounds in bounds_of.items())
    return CalibrationModel(title, build, current, duration, accuracy, unknowns)


def _of_file(problem: Described, values: Mapping[str, Expression]) -> Scene:
    """Return a problem's scene with values changed by keys of files, which divide the mass into frame and steel."""
    for name in values:
        check_named("a problem file has no {}", name, quantities())
    return problem.scene(values)


def _current(scene: Scene) -> dict[str, float]:
    """Return name -> value of the quantities of a numeric scene."""
    values = {name: value for name, value in quantities_of(scene).items() if value is not None}
    if any(map(is_symbolic, values.values())):
        raise InputError("the scene holds symbols: calibrate a numeric scene, and name its unknowns")
    return {name: float(as_number(value)) for name, value in values.items()}


def _unknown(name: str, bounds: Any, current: float | None) -> Unknown:
    """Return an unknown; the default guess is the scene's value if it is between the bounds, otherwise their middle."""
    check_named("{} cannot be an unknown", name, EVERY)
    unit = EVERY[name].unit
    if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) not in (2, 3):
        raise InputError(f"'{name}' = {shown(bounds)} must be (lower, upper) or (lower, upper, guess)")
    whats = (f"{side} bound of '{name}'" for side in ("lower", "upper", "guess"))
    numbers = [plain_number(what, in_si(what, one, unit), unit) for what, one in zip(whats, bounds, strict=False)]
    check_bounds(f"'{name}'", *numbers)
    lower, upper, *given = numbers
    log = lower > 0.0 and upper / lower >= _LOG_RATIO
    middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
    default = current if current is not None and lower < current < upper else middle
    guess = given[0] if given else default
    return Unknown(name, unit, lower, upper, guess, log)


SceneOfRows: TypeAlias = tuple[Scene, Expression | None, NDArray[np.intp]]
"""A scene, its duration [s] or None, and the indices of the rows that were measured in it."""

# Results of a scene that do not depend on its motion.
_OF_SCENE: Final[dict[str, Callable[[Scene], Expression]]] = {
    "loosened_radius": lambda scene: scene.loosened_radius,
    "added_mass": lambda scene: scene.carried_soil,
    "cone_index": lambda scene: cone_index(scene.soil),
}
# Phase [rad] of the fastest oscillation between output times. With `_NODES` it interpolates the force to 1e-8.
_PHASE: Final = 0.25
# Number of nodes of the polynomial that interpolates the force between output times.
_NODES: Final = 8
_LEAST_OUTPUTS: Final = 400
_MOST_OUTPUTS: Final = 20_000
# The predictions of more rows are not expanded to scalar operations, which would fill the memory.
_MOST_EXPANDED: Final = 1000
# A time counts as an output time if it is closer to it than this part of the duration.
_ON_OUTPUT: Final = 1e-9


@dataclass(frozen=True)
class Rows:
    """The rows of one set of measurements, grouped by distinct conditions so that each is computed once.

    Attributes:
        measured: the set of measurements.
        model: the model to calibrate.
    """

    measured: Measurements
    model: CalibrationModel

    @cached_property
    def _distinct(self) -> tuple[Array, NDArray[np.intp]]:
        """Distinct conditions (m, c), and for each row the index of its conditions (n)."""
        # A column of zeros, dropped below, allows measurements without conditions.
        columns = [np.zeros(self.measured.rows), *self.measured.conditions.values()]
        distinct, which = np.unique(np.column_stack(columns), axis=0, return_inverse=True)
        return distinct[:, 1:], which.ravel()

    def scenes(self, y: Sequence[Expression] | Array) -> list[SceneOfRows]:
        """Return the distinct scenes at scaled unknowns, with their durations and rows.

        Raises:
            InputError: the conditions of a row are outside the model's domain.
        """
        scenes = []
        for number, conditions in enumerate([] if self.measured.direct else self._distinct[0].tolist()):
            rows = np.flatnonzero(self._distinct[1] == number)
            values = self.model.values(y) | dict(zip(self.measured.conditions, conditions, strict=True))
            with about(f"{self.measured.row(int(rows[0]))}:", DomainError):
                scene = self.model.scene(values)
                scene.check_reaction()
            time = self.measured.time
            duration = self.model.duration_of(values) if time is None else float(np.max(time[rows]))
            scenes.append((scene, duration, rows))
        return scenes

    def predicted(self, y: ca.MX) -> tuple[ca.MX, ca.MX, bool]:
        """Return the predictions (n) at scaled unknowns, their Jacobian (n, p), and whether they are in closed form.

        Raises:
            InputError: the conditions of a row are outside the model's domain, or the duration is missing.
        """
        if self.measured.direct:
            values: dict[str, Column] = {**self.model.values(ca.vertsplit(y))}
            value = ca.MX.ones(self.measured.rows) * values[self.measured.result]
            return value, ca.jacobian(value, y), True
        for scene, duration, _ in self.scenes(self.model.guess):
            needs_run = not is_closed(scene, self.measured.result) and scene.effects.orbit == "transient"
            if needs_run and (duration is None or not duration > 0.0):
                run = f"{self.measured.name}: {self.measured.result} of this scene needs a run"
                raise InputError(f"{run}: give its duration, in seconds")
        if self.measured.result == RECORD:
            value = self._record(y)
            return value, ca.jacobian(value, y), False
        distinct, which = self._distinct
        function = self._of_one_row()
        value, slope = function.map(len(distinct))(ca.repmat(y, 1, len(distinct)), ca.DM(distinct.T))
        return value.T[which.tolist(), :], slope.T[which.tolist(), :], function.is_a("SXFunction")

    def _of_one_row(self) -> ca.Function:
        """Return a Function: scaled unknowns and conditions -> (result, derivatives by the unknowns as a column)."""
        model, result, conditions = self.model, self.measured.result, self.measured.at(0)
        example = model.scene(model.values(model.guess) | conditions)
        closed = is_closed(example, result)
        # SX would unroll a law with matrix quadratures or loops; in MX it stays small.
        kind: Any = ca.SX if closed and example.law.scalar else ca.MX
        y, c = kind.sym("y", len(model.unknowns)), kind.sym("c", len(conditions))
        values = model.values(ca.vertsplit(y)) | {key: c[k] for k, key in enumerate(conditions)}
        scene = model.scene(values)
        if result in _OF_SCENE:
            value = _OF_SCENE[result](scene)
        elif closed:
            value = scene.steady_resistance
        else:
            value = MEASURES[result].of(simulate(scene, model.duration_of(values), accuracy=model.accuracy))
        value = kind(value)
        # Forward mode: through an integration the reverse mode takes far longer to build.
        slope = [ca.jtimes(value, y, column) for column in ca.horzsplit(ca.DM.eye(len(model.unknowns)))]
        return ca.Function("row", [y, c], [value, ca.densify(ca.vertcat(*slope))])

    def _record(self, y: ca.MX) -> ca.MX:
        """Return the mount force at the times of all rows, from one run for each distinct condition."""
        forces, order = [], []
        at_guess = self.scenes(self.model.guess)
        for (scene, duration, rows), (example, _, _) in zip(self.scenes(ca.vertsplit(y)), at_guess, strict=True):
            forces.append(self._force_at(scene, duration, rows, example))
            order.extend(rows.tolist())
        return ca.MX(stacked(*forces))[np.argsort(order).tolist(), 0]

    def _force_at(self, scene: Scene, duration: Any, rows: NDArray[np.intp], example: Scene) -> Expression:
        """Return the mount force at the times of some rows; a numeric scene like it decides the number of outputs."""
        assert self.measured.time is not None
        times = self.measured.time[rows]
        outputs = _outputs(example, duration, times)
        run = simulate(scene, duration, accuracy=self.model.accuracy, outputs=outputs)
        forces: Expression = ca.DM(interpolation(times / duration, outputs)) @ run.mount_force
        return forces

    def checked(self, scene: Scene, duration: Expression | None, rows: NDArray[np.intp]) -> Array:
        """Return the results of some rows from a numeric run, whose error is checked."""
        if self.measured.result == RECORD:
            return np.asarray(self._force_at(scene, duration, rows, scene), dtype=float).ravel()
        run = simulate(scene, duration, accuracy=self.model.accuracy)
        return np.full(len(rows), float(as_number(MEASURES[self.measured.result].of(run))))


def predictor(sets: Sequence[Rows], model: CalibrationModel) -> ca.Function:
    """Return a Function: scaled unknowns (p) -> (predictions of all sets (n), their Jacobian (n, p)).

    It is expanded to scalar operations if no prediction needs a run.

    Raises:
        InputError: the conditions of a row are outside the model's domain, or the duration is missing.
    """
    y = ca.MX.sym("y", len(model.unknowns))
    values, slopes, closed = zip(*(rows.predicted(y) for rows in sets), strict=True)
    whole = ca.Function("predicted", [y], [ca.densify(ca.vertcat(*values)), ca.densify(ca.vertcat(*slopes))])
    return whole.expand() if all(closed) and whole.numel_out(0) <= _MOST_EXPANDED else whole


def is_closed(scene: Scene, result: str) -> bool:
    """Return whether a result has a closed form: the mean draft of a steady motion is the steady resistance."""
    if result in _OF_SCENE:
        return True
    effects = scene.effects
    steady = not effects.waves and not effects.ramps and not effects.entry and not effects.own
    from_steady = not effects.motion or effects.start == "equilibrium"
    return result == "mean_draft" and steady and from_steady and not effects.printed.repelling_spring


def _outputs(scene: Scene, duration: float, times: Array) -> int:
    """Return a number of output intervals that places an output at every time, or suffices to interpolate there."""
    enough = _LEAST_OUTPUTS
    if scene.effects.motion:
        enough = max(enough, math.ceil(phase(numbers_of(scene), duration) / _PHASE))
    enough = min(enough, _MOST_OUTPUTS)
    for count in range(enough, 2 * enough):
        positions = times / duration * count
        if np.all(np.abs(positions - np.round(positions)) < _ON_OUTPUT * count):
            return count
    return enough


def interpolation(fractions: Array, outputs: int) -> Array:
    """Return the matrix that maps a signal at the output times to its values at fractions of the duration.

    It interpolates by Lagrange polynomials of degree 7 through the nearest outputs; at an output it takes the value.
    """
    weights = np.zeros((len(fractions), outputs + 1))
    for row, fraction in enumerate(fractions):
        position = fraction * outputs
        first = min(max(math.floor(position) - _NODES // 2 + 1, 0), outputs + 1 - _NODES)
        nodes = np.arange(first, first + _NODES)
        for k in nodes:
            others = nodes[nodes != k]
            weights[row, k] = np.prod((position - others) / (k - others))
    return weights
