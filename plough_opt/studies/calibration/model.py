"""A scene as the model of measurements: predictions and their exact slopes as a CasADi Function of the unknowns."""

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import barycentric_interpolate

from plough_opt.core.checks import check_bounds, check_kind, check_named, mapping_of, plain_number, shown
from plough_opt.core.errors import DomainError, InputError, about
from plough_opt.core.expressions import Column, Expression, as_number, is_symbolic, stacked
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import EVERY, quantities
from plough_opt.core.units import in_si
from plough_opt.design.declarations import Scaled
from plough_opt.laws.forces import cone_index
from plough_opt.motion import simulate
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene, quantities_of, with_quantities
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.studies.calibration.measurements import RECORD, Measurements

# An unknown whose bounds have at least this ratio is scaled logarithmically: its order of magnitude is unknown.
_LOG_RATIO: Final = 10.0
# Outputs of a run for each of its steps. With eight nodes they interpolate the force to 1e-8.
_OUTPUTS_PER_STEP: Final = 2
_NODES: Final = 8
# The predictions of more rows are not expanded to scalar operations, which would fill the memory.
_MOST_EXPANDED: Final = 1000
# Results in closed form: the mean draft of a steady motion, and those that do not depend on the motion.
_CLOSED: Final[Mapping[str, Callable[[Scene], Expression]]] = {
    "mean_draft": lambda scene: scene.steady_resistance,
    "loosened_radius": lambda scene: scene.loosened_radius,
    "added_mass": lambda scene: scene.carried_soil,
    "cone_index": lambda scene: cone_index(scene.soil),
}
_DURATION: Final = "scene.duration"


@dataclass(frozen=True)
class Unknown(Scaled):
    """A quantity to find, SI.

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
        """Return a value in SI, given as a number, text with a unit or a pint quantity."""
        limits = {"above": 0.0, "why": "its bounds make its scale logarithmic"} if self.log else {}
        return plain_number(what, in_si(what, value, self.unit), self.unit, **limits)


@dataclass(frozen=True)
class Model:
    """A scene as a function of its named quantities, and the unknowns among them.

    Attributes:
        title: title for reports.
        build: key -> changed value, a number or a symbol -> scene.
        duration: simulated time [s], or None if no result needs it.
        accuracy: method and setting of runs.
        unknowns: the quantities to find.
    """

    title: str
    build: Callable[[Mapping[str, Expression]], Scene]
    duration: float | None
    accuracy: Accuracy
    unknowns: tuple[Unknown, ...]

    def values(self, y: Sequence[Expression] | Array) -> dict[str, Expression]:
        """Return name -> value of the unknowns at scaled values."""
        return {unknown.name: unknown.unscaled(y[k]) for k, unknown in enumerate(self.unknowns)}

    def scene(self, values: Mapping[str, Expression]) -> Scene:
        """Return the scene with changed values; a duration among them is ignored, as it is not part of the scene."""
        scene = self.build({key: value for key, value in values.items() if key != _DURATION})
        check_kind("what the function of values returns", scene, Scene, "a Scene")
        return scene

    def duration_of(self, scene: Scene, values: Mapping[str, Expression]) -> Any:
        """Return the simulated time [s]; None for an orbit, which has its own, and where none is stated."""
        return values.get(_DURATION, self.duration) if scene.effects.orbit == "transient" else None


def model_of(model: Any, duration: float | None, unknown: Mapping[str, Any] | None, columns: Set[str]) -> Model:
    """Return the model of a problem, a scene or a function.

    Args:
        model: a problem, a numeric scene, or a function of values by key that returns a scene.
        duration: simulated time [s]; None: the problem's.
        unknown: key -> (lower, upper) or (lower, upper, guess); None: the problem's variables except the columns.
        columns: keys that are columns of the data.

    Raises:
        InputError: the model has the wrong type, a name is unknown, or bounds are invalid.
    """
    title, accuracy, current, build = "calibration", Accuracy(), {}, model
    if isinstance(model, Scene):
        title, build, current = model.soil.name, partial(with_quantities, model), _current(model)
    elif hasattr(model, "variables"):
        current = _current(model.scene()) | {key: float(value) for key, value in model.values().items()}
        duration = current.get(_DURATION) if duration is None else duration
        title, build, accuracy = model.title, partial(_scene_of_file, model), model.accuracy
        if unknown is None:
            unknown = {key: (v.lower, v.upper, v.guess) for key, v in model.variables.items() if key not in columns}
    elif not callable(model):
        raise InputError(f"{shown(model)} must be a Problem, a Scene, or a function of values that returns a Scene")
    bounds_of = mapping_of("unknown", unknown, "{'soil.cohesion': (1e3, 80e3)}")
    if not bounds_of:
        raise InputError("there are no unknowns: name each with its bounds, as {'soil.cohesion': (1e3, 80e3)}")
    unknowns = tuple(_unknown(name, bounds, current.get(name)) for name, bounds in bounds_of.items())
    return Model(title, build, duration, accuracy, unknowns)


def _scene_of_file(problem: Any, values: Mapping[str, Expression]) -> Any:
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
    words = (f"{side} bound of '{name}'" for side in ("lower", "upper", "guess"))
    numbers = [plain_number(what, in_si(what, x, unit), unit) for what, x in zip(words, bounds, strict=False)]
    check_bounds(f"'{name}'", *numbers)
    lower, upper, *guess = numbers
    log = lower > 0.0 and upper / lower >= _LOG_RATIO
    middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
    guess.append(current if current is not None and lower < current < upper else middle)
    return Unknown(name, unit, lower, upper, guess[0], log)


SceneOfRows: TypeAlias = tuple[Scene, Any, NDArray[np.intp]]
"""A scene, its duration [s] or None, and the indices of the rows that were measured in it."""


class Rows:
    """The rows of one set of measurements, grouped by distinct conditions so that each is computed once.

    Attributes:
        measured: the set of measurements.
        model: the model to calibrate.
    """

    def __init__(self, measured: Measurements, model: Model) -> None:
        self.measured, self.model = measured, model
        # A column of zeros, dropped below, allows measurements without conditions.
        columns = np.column_stack([np.zeros(len(measured.values)), *measured.conditions.values()])
        distinct, which = np.unique(columns, axis=0, return_inverse=True)
        self._distinct, self._which = distinct[:, 1:], which.ravel()

    def scenes(self, y: Sequence[Expression] | Array) -> list[SceneOfRows]:
        """Return the distinct scenes at scaled unknowns, with their durations and rows.

        Raises:
            InputError: the conditions of a row are outside the model's domain.
        """
        scenes: list[SceneOfRows] = []
        for number, conditions in enumerate([] if self.measured.direct else self._distinct.tolist()):
            rows = np.flatnonzero(self._which == number)
            values = self.model.values(y) | dict(zip(self.measured.conditions, conditions, strict=True))
            with about(f"{self.measured.row(int(rows[0]))}:", DomainError):
                scene = self.model.scene(values)
                scene.check_reaction()
            time = self.measured.time
            duration = self.model.duration_of(scene, values) if time is None else float(np.max(time[rows]))
            scenes.append((scene, duration, rows))
        return scenes

    def predicted(self, y: ca.MX) -> tuple[ca.MX, ca.MX, bool]:
        """Return the predictions (n) at scaled unknowns, their Jacobian (n, p), and whether they are in closed form.

        Raises:
            InputError: the conditions of a row are outside the model's domain, or the duration is missing.
        """
        if self.measured.direct:
            values: Mapping[str, Column] = self.model.values(ca.vertsplit(y))
            value = ca.MX.ones(len(self.measured.values)) * values[self.measured.result]
            return value, ca.jacobian(value, y), True
        at_guess = self.scenes([u.scaled(u.guess) for u in self.model.unknowns])  # refuses rows outside the domain
        with about(f"{self.measured.name}: {self.measured.result} of this scene needs a run:"):
            if self.measured.result == RECORD:
                pairs = zip(self.scenes(ca.vertsplit(y)), at_guess, strict=True)
                forces = [self._force_at(*of_rows, example) for of_rows, (example, *_) in pairs]
                order = np.argsort(np.concatenate([rows for *_, rows in at_guess]))
                value = ca.MX(stacked(*forces))[order.tolist(), 0]
                return value, ca.jacobian(value, y), False
            function = self._of_one_row(at_guess[0][0])
        count, which = len(self._distinct), self._which.tolist()
        value, slope = function.map(count)(ca.repmat(y, 1, count), ca.DM(self._distinct.T))
        return value.T[which, :], slope.T[which, :], function.is_a("SXFunction")

    def _of_one_row(self, example: Scene) -> ca.Function:
        """Return a Function: scaled unknowns and conditions -> (result, derivatives by the unknowns as a column)."""
        model, result, closed = self.model, self.measured.result, is_closed(example, self.measured.result)
        # SX would unroll a law with matrix quadratures or loops; in MX it stays small.
        kind: Any = ca.SX if closed and example.law.scalar else ca.MX
        y, c = kind.sym("y", len(model.unknowns)), kind.sym("c", len(self.measured.conditions))
        values = model.values(ca.vertsplit(y)) | {key: c[k] for k, key in enumerate(self.measured.conditions)}
        scene = model.scene(values)
        if closed:
            value = kind(_CLOSED[result](scene))
        else:
            run = simulate(scene, model.duration_of(scene, values), accuracy=model.accuracy)
            value = kind(MEASURES[result].of(run))
        # Forward mode: through an integration the reverse mode takes far longer to build.
        slope = [ca.jtimes(value, y, column) for column in ca.horzsplit(ca.DM.eye(len(model.unknowns)))]
        return ca.Function("row", [y, c], [value, ca.densify(ca.vertcat(*slope))])

    def _force_at(self, scene: Scene, duration: float, rows: NDArray[np.intp], example: Scene) -> Expression:
        """Return the mount force at the times of some rows; a numeric scene like it decides the number of outputs."""
        steps = simulate(example, duration, accuracy=self.model.accuracy).accuracy.steps or 1000
        outputs = min(max(400, _OUTPUTS_PER_STEP * steps), 20_000)
        run = simulate(scene, duration, accuracy=self.model.accuracy, outputs=outputs)
        force: Expression = ca.DM(interpolation(self.measured.time[rows] / duration, outputs)) @ run.mount_force
        return force

    def checked(self, scene: Scene, duration: Any, rows: NDArray[np.intp]) -> Array:
        """Return the results of some rows from a numeric run, whose error is checked."""
        if self.measured.result == RECORD:
            return np.asarray(self._force_at(scene, duration, rows, scene), dtype=float).ravel()
        run = simulate(scene, duration, accuracy=self.model.accuracy)
        return np.full(len(rows), float(as_number(MEASURES[self.measured.result].of(run))))


def predictor(sets: Sequence[Rows], unknowns: int) -> ca.Function:
    """Return a Function: scaled unknowns (p) -> (predictions of all sets (n), their Jacobian (n, p)).

    It is expanded to scalar operations if no prediction needs a run.

    Raises:
        InputError: the conditions of a row are outside the model's domain, or the duration is missing.
    """
    y = ca.MX.sym("y", unknowns)
    values, slopes, closed = zip(*(rows.predicted(y) for rows in sets), strict=True)
    whole = ca.Function("predicted", [y], [ca.densify(ca.vertcat(*values)), ca.densify(ca.vertcat(*slopes))])
    return whole.expand() if all(closed) and whole.numel_out(0) <= _MOST_EXPANDED else whole


def is_closed(scene: Scene, result: str) -> bool:
    """Return whether a result has a closed form; the mean draft has one in a steady motion."""
    effects = scene.effects
    steady = not (effects.waves or effects.ramps or effects.entry or effects.own or effects.printed.repelling_spring)
    from_steady = not effects.motion or effects.start == "equilibrium"
    return result in _CLOSED and (result != "mean_draft" or (steady and from_steady))


def interpolation(fractions: Array, outputs: int) -> Array:
    """Return the matrix that maps a signal at the output times to its values at fractions of the duration.

    It interpolates by Lagrange polynomials of degree 7 through the nearest outputs; at an output it takes the value.
    """
    weights = np.zeros((len(fractions), outputs + 1))
    for row, place in zip(weights, fractions * outputs, strict=True):
        first = int(np.clip(place - _NODES // 2 + 1, 0, outputs + 1 - _NODES))
        row[first : first + _NODES] = barycentric_interpolate(np.arange(first, first + _NODES), np.eye(_NODES), place)
    return weights
