"""Model and measured rows of a calibration, with predictions as a CasADi Function of the unknowns.

Each unknown is searched between bounds, and scaled to the interval from 0 to 1.
"""

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_choice, check_domain, check_named, mapping_of, plain_number, shown
from plough_opt.core.errors import DomainError, InputError, nearest
from plough_opt.core.expressions import Column, Expression, as_number, exp, is_symbolic, stacked
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import every_quantity, quantities
from plough_opt.core.units import in_si
from plough_opt.laws.forces import cone_index
from plough_opt.motion import simulate
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.plan import numbers_of, phase
from plough_opt.motion.scene import Scene, quantities_of, with_quantities
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.studies.calibration.least_squares import Data, LeastSquares, loss_of
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable

SceneOf: TypeAlias = Callable[[Mapping[str, Expression]], Scene]
_DURATION = "scene.duration"
# An unknown whose bounds have at least this ratio is scaled logarithmically.
_LOG_RATIO = 10.0


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


@dataclass(frozen=True)
class Unknown:
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

    def value(self, y: Expression) -> Expression:
        """Return the quantity at a scaled value from 0 to 1, a number or a symbol."""
        if self.log:
            return self.lower * exp(y * math.log(self.upper / self.lower))
        return self.lower + y * (self.upper - self.lower)

    def read(self, what: str, value: Any) -> float:
        """Return a value in SI, given as a number, text with a unit or a pint quantity.

        Raises:
            InputError, DomainError: it is not a quantity of this kind, not finite, or outside the unknown's scale.
        """
        read = in_si(what, value, self.unit)
        why = "its bounds make its scale logarithmic" if self.log else ""
        check_domain(what, read, self.unit, above=0.0 if self.log else -np.inf, why=why)
        return plain_number(what, read)

    def slope(self, y: float) -> float:
        """Return the derivative of the quantity by its scaled value."""
        if self.log:
            return float(self.value(y)) * math.log(self.upper / self.lower)
        return self.upper - self.lower

    def scaled(self, value: float) -> float:
        """Return the scaled value of a quantity."""
        if self.log:
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)


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
        return {unknown.name: unknown.value(y[k]) for k, unknown in enumerate(self.unknowns)}

    def scene(self, values: Mapping[str, Expression]) -> Scene:
        """Return the scene with changed values; a duration among them is ignored, as it is not part of the scene."""
        scene = self.build({key: value for key, value in values.items() if key != _DURATION})
        if not isinstance(scene, Scene):
            raise InputError(f"the function of values returned {shown(scene)}: it must return a Scene")
        return scene

    def duration_of(self, values: Mapping[str, Expression]) -> Expression | None:
        """Return the simulated time [s]."""
        return values.get(_DURATION, self.duration)


def model_of(
    given: Described | Scene | SceneOf, duration: float | None, unknown: Mapping[str, Any] | None, columns: Set[str]
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
        raise InputError(
            f"{shown(given)} must be a Problem, a Scene, or a function of values by key that returns a Scene"
        )
    return CalibrationModel(title, build, current, duration, accuracy, _unknowns(unknown, current))


def _of_file(problem: Described, values: Mapping[str, Expression]) -> Scene:
    """Return a problem's scene with values changed by keys of files, which divide the mass into frame and steel."""
    for name in values:
        if name not in quantities():
            raise InputError(f"a problem file has no '{name}': {nearest(name, quantities())}")
    return problem.scene(values)


def _current(scene: Scene) -> dict[str, float]:
    """Return name -> value of the quantities of a numeric scene."""
    values = {name: value for name, value in quantities_of(scene).items() if value is not None}
    if any(map(is_symbolic, values.values())):
        raise InputError("the scene holds symbols: calibrate a numeric scene, and name its unknowns")
    return {name: float(as_number(value)) for name, value in values.items()}


def _unknowns(given: Mapping[str, Any] | None, current: Mapping[str, float]) -> tuple[Unknown, ...]:
    """Return the checked unknowns.

    Raises:
        InputError: there are no unknowns, a name is unknown, or bounds are invalid.
    """
    bounds_of = mapping_of("unknown", given, "{'soil.cohesion': (1e3, 80e3)}")
    if not bounds_of:
        raise InputError("there are no unknowns: name each with its bounds, as {'soil.cohesion': (1e3, 80e3)}")
    return tuple(_unknown(name, bounds, current.get(name)) for name, bounds in bounds_of.items())


def _unknown(name: str, bounds: Any, current: float | None) -> Unknown:
    """Return an unknown; the default guess is the scene's value if it is between the bounds, otherwise their middle."""
    units = every_quantity()
    check_named("{} cannot be an unknown", name, units)
    if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) not in (2, 3):
        raise InputError(f"'{name}' = {shown(bounds)} must be (lower, upper) or (lower, upper, guess)")
    numbers = []
    for side, written in zip(("lower", "upper", "guess"), bounds, strict=False):
        number = in_si(f"{side} bound of '{name}'", written, units[name].symbol)
        check_domain(f"{side} bound of '{name}'", number, units[name].symbol)
        numbers.append(float(number))
    lower, upper = numbers[:2]
    if not lower < upper:
        raise InputError(f"'{name}': the lower bound {lower:g} must be below the upper bound {upper:g}")
    log = lower > 0.0 and upper / lower >= _LOG_RATIO
    middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
    guess = numbers[2] if len(numbers) == 3 else current
    if guess is None or (len(numbers) == 2 and not lower < guess < upper):
        guess = middle
    if not lower <= guess <= upper:
        raise InputError(f"'{name}': the guess {guess:g} must lie between {lower:g} and {upper:g}")
    return Unknown(name, units[name].symbol, lower, upper, guess, log)


Numbers: TypeAlias = Sequence[Expression] | Array
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
NOMINAL: Final = 0.01
"""Nominal standard deviation of an error, relative to the mean measured or each predicted value, without sigma."""

ERRORS: Final = ("constant", "relative")
"""Models of errors whose sigma is not stated: the same for each set of measurements, or proportional to the result."""

INSIDE: Final = 0.02
"""Starts keep at least this distance from the bounds, as a part of their distance: a search may stay at a bound."""


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

    @property
    def direct(self) -> bool:
        """Whether an unknown was measured directly."""
        return self.measured.result not in measurable()

    def scenes(self, y: Numbers) -> list[SceneOfRows]:
        """Return the distinct scenes at scaled unknowns, with their durations and rows.

        Raises:
            InputError: the conditions of a row are outside the model's domain.
        """
        scenes = []
        for number, conditions in enumerate([] if self.direct else self._distinct[0].tolist()):
            rows = np.flatnonzero(self._distinct[1] == number)
            values = self.model.values(y) | dict(zip(self.measured.conditions, conditions, strict=True))
            try:
                scene = self.model.scene(values)
                scene.check_reaction()
            except DomainError as error:
                raise InputError(f"{self.measured.row(int(rows[0]))}: {error}") from None
            time = self.measured.time
            duration = self.model.duration_of(values) if time is None else float(np.max(time[rows]))
            scenes.append((scene, duration, rows))
        return scenes

    def predicted(self, y: ca.MX) -> tuple[ca.MX, ca.MX, bool]:
        """Return the predictions (n) at scaled unknowns, their Jacobian (n, p), and whether they are in closed form.

        Raises:
            InputError: the conditions of a row are outside the model's domain, or the duration is missing.
        """
        if self.direct:
            values: dict[str, Column] = {**self.model.values(ca.vertsplit(y))}
            value = ca.MX.ones(self.measured.rows) * values[self.measured.result]
            return value, ca.jacobian(value, y), True
        for scene, duration, _ in self.scenes(self.model.guess):
            needs_run = not is_closed(scene, self.measured.result) and scene.effects.orbit == "transient"
            if needs_run and (duration is None or not duration > 0.0):
                raise InputError(
                    f"{self.measured.name}: {self.measured.result} of this scene needs a run: give its duration,"
                    " in seconds"
                )
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
        """Return the mount force of a run at the times of some rows.

        Args:
            scene: the scene, numeric or symbolic.
            duration: its duration [s].
            rows: indices of the rows.
            example: a numeric scene of the same kind, which determines the number of output times.
        """
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


@dataclass(frozen=True)
class Setup:
    """A checked calibration.

    Attributes:
        model: the scene as a function of its quantities, with the unknowns.
        rows: the sets of measurements.
        problem: the least-squares problem.
        data: measured values and their weights.
    """

    model: CalibrationModel
    rows: tuple[Rows, ...]
    problem: LeastSquares
    data: Data

    @property
    def measured(self) -> tuple[Measurements, ...]:
        """The sets of measurements."""
        return tuple(rows.measured for rows in self.rows)

    @property
    def places(self) -> list[str]:
        """Name of every row for messages."""
        return [m.row(k) for m in self.measured for k in range(m.rows)]


def setup_of(
    given: Described | Scene | SceneOf,
    data: Measurements | Sequence[Measurements],
    unknown: Mapping[str, Any] | None,
    loss: str,
    errors: str,
    duration: float | None,
) -> Setup:
    """Return a checked calibration; `Calibration` describes the arguments.

    Raises:
        InputError: an unknown name, invalid bounds, too few rows, or data that do not belong to the scene.
    """
    measured = (data,) if isinstance(data, Measurements) else tuple(data) if isinstance(data, Sequence) else ()
    if not measured or not all(isinstance(m, Measurements) for m in measured):
        raise InputError("the data must be Measurements, one set or several: read a file with po.read_measurements")
    for k, m in enumerate(measured):
        if any(m is other for other in measured[:k]):
            raise InputError(f"{m.name} is given twice, so its rows would count twice: remove one of the two")
    if not any(np.any(m.values[m.counted]) for m in measured):
        raise InputError(f"{measured[0].name}: every measured value is 0, which no soil gives: check the column")
    chosen_loss = loss_of(loss)
    check_choice("errors", errors, ERRORS)
    model = model_of(given, duration, unknown, {key for m in measured for key in m.conditions})
    _check_names(model, measured)
    _check_bounds(model, measured)
    rows = tuple(Rows(m, model) for m in measured)
    setup = Setup(model, rows, LeastSquares(predictor(rows, model), chosen_loss), _data(measured, errors))
    _check_numbers(setup)
    return setup


def _check_names(model: CalibrationModel, measured: Sequence[Measurements]) -> None:
    """Raise InputError if a column is also an unknown, or if neither a result nor an unknown was measured."""
    names = {unknown.name for unknown in model.unknowns}
    for m in measured:
        if both := names & set(m.conditions):
            raise InputError(f"{m.name}: '{min(both)}' is a column of the data, so it cannot be an unknown")
        if m.result not in measurable() and m.result not in names:
            listed = ", ".join(sorted(names))
            raise InputError(f"{m.name}: '{m.result}' was measured, but is not among the unknowns: {listed}")


def _check_bounds(model: CalibrationModel, measured: Sequence[Measurements]) -> None:
    """Raise InputError if the bounds or the first row are outside the model's domain; `Rows` checks other rows."""
    first = next((m for m in measured if m.result in measurable()), measured[0])
    guess = {unknown.name: unknown.guess for unknown in model.unknowns} | first.at(0)
    tried = {first.row(0): guess}
    for unknown in model.unknowns:
        tried[f"lower bound of '{unknown.name}'"] = guess | {unknown.name: unknown.lower}
        tried[f"upper bound of '{unknown.name}'"] = guess | {unknown.name: unknown.upper}
    for place, values in tried.items():
        try:
            model.scene(values)
        except DomainError as error:
            raise InputError(f"{place}: {error}") from None


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
        raise InputError(
            f"{setup.measured[0].name}: {data.count} rows are too few for {len(unknowns)} unknowns"
            f" ({', '.join(u.name for u in unknowns)}): at least {least} are needed{why}"
        )
    values, slopes = setup.problem.at(np.clip(setup.model.guess, INSIDE, 1.0 - INSIDE))
    finite = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
    if not np.all(finite):
        raise InputError(
            f"{setup.places[int(np.argmin(finite))]}: the model has no finite prediction at these conditions"
        )
