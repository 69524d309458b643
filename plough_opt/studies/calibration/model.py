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
from plough_opt.core.expressions import Expression, as_number, is_symbolic, stacked
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

Case: TypeAlias = tuple[Scene, Any, NDArray[np.intp]]
"""A scene, its duration [s] or None, and the indices of the rows that were measured in it."""


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

    @classmethod
    def of(cls, name: str, bounds: Any, current: float | None) -> "Unknown":
        """Return an unknown between bounds, whose guess is by default the scene's value between them, or the middle.

        Raises:
            InputError: no such quantity, or invalid bounds.
        """
        check_named("{} cannot be an unknown", name, EVERY)
        unit = EVERY[name].unit
        if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) not in (2, 3):
            raise InputError(f"'{name}' = {shown(bounds)} must be (lower, upper) or (lower, upper, guess)")
        words = (f"{side} bound of '{name}'" for side in ("lower", "upper", "guess"))
        numbers = [plain_number(what, in_si(what, x, unit), unit) for what, x in zip(words, bounds, strict=False)]
        check_bounds(f"'{name}'", *numbers)
        lower, upper, *guess = numbers
        log = lower > 0.0 and upper / lower >= 10.0
        middle = math.sqrt(lower * upper) if log else (lower + upper) / 2.0
        guess.append(current if current is not None and lower < current < upper else middle)
        return cls(name, unit, lower, upper, guess[0], log)


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

    @classmethod
    def of(cls, given: Any, duration: float | None, unknown: Mapping[str, Any] | None, columns: Set[str]) -> "Model":
        """Return the model of a problem, a numeric scene, or a function of values by key that returns a scene.

        Args:
            given: the problem, scene or function.
            duration: simulated time [s]; None: the problem's.
            unknown: key -> (lower, upper) or (lower, upper, guess); None: the problem's variables except the columns.
            columns: keys that are columns of the data.

        Raises:
            InputError: the model has the wrong type, a name is unknown, or bounds are invalid.
        """
        title, accuracy, current, build = "calibration", Accuracy(), {}, given
        if isinstance(given, Scene):
            title, build, current = given.soil.name, partial(with_quantities, given), _current(given)
        elif hasattr(given, "variables"):
            current = _current(given.scene()) | {key: float(value) for key, value in given.values().items()}
            duration = current.get(_DURATION) if duration is None else duration
            title, build, accuracy = given.title, partial(_scene_of_file, given), given.accuracy
            if unknown is None:
                unknown = {key: (v.lower, v.upper, v.guess) for key, v in given.variables.items() if key not in columns}
        elif not callable(given):
            raise InputError(f"{shown(given)} must be a Problem, a Scene, or a function of values that returns a Scene")
        bounds_of = mapping_of("unknown", unknown, "{'soil.cohesion': (1e3, 80e3)}")
        if not bounds_of:
            raise InputError("there are no unknowns: name each with its bounds, as {'soil.cohesion': (1e3, 80e3)}")
        unknowns = tuple(Unknown.of(name, bounds, current.get(name)) for name, bounds in bounds_of.items())
        return cls(title, build, duration, accuracy, unknowns)

    @property
    def guess(self) -> Array:
        """Scaled guesses of the unknowns."""
        return np.array([u.scaled(u.guess) for u in self.unknowns])

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

    def cases(self, measured: Measurements, y: Sequence[Expression] | Array) -> list[Case]:
        """Return the scene of every combination of conditions at scaled unknowns; none for direct measurements.

        Raises:
            InputError: the conditions of a row are outside the model's domain.
        """
        cases: list[Case] = []
        table, which = measured.distinct
        for number, conditions in enumerate([] if measured.direct else table.tolist()):
            rows = np.flatnonzero(which == number)
            values = self.values(y) | dict(zip(measured.conditions, conditions, strict=True))
            with about(f"{measured.row(int(rows[0]))}:", DomainError):
                scene = self.scene(values)
                scene.check_reaction()
            time = measured.time
            duration = self.duration_of(scene, values) if time is None else float(np.max(time[rows]))
            cases.append((scene, duration, rows))
        return cases

    def predictor(self, sets: Sequence[Measurements]) -> ca.Function:
        """Return a Function: scaled unknowns (p) -> (predictions of all sets (n), their Jacobian (n, p)).

        It is expanded to scalar operations if no prediction needs a run.

        Raises:
            InputError: the conditions of a row are outside the model's domain, or the duration is missing.
        """
        y = ca.MX.sym("y", len(self.unknowns))
        parts, closed = zip(*(self._predicted(m, y) for m in sets), strict=True)
        values = ca.densify(ca.vertcat(*parts))
        # Forward mode: through an integration the reverse mode takes far longer to build.
        slopes = ca.jtimes(values, y, ca.MX.eye(y.numel()))
        whole = ca.Function("predicted", [y], [values, ca.densify(slopes)])
        return whole.expand() if all(closed) and values.numel() <= _MOST_EXPANDED else whole

    def _predicted(self, measured: Measurements, y: ca.MX) -> tuple[ca.MX, bool]:
        """Return the predictions of a set (n) at scaled unknowns, and whether they are in closed form."""
        result, parts = measured.result, ca.vertsplit(y)
        if measured.direct:
            value: Any = self.values(parts)[result]
            return ca.MX.ones(len(measured.values)) * value, True
        numeric = self.cases(measured, self.guess)  # refuses rows outside the domain
        example = numeric[0][0]
        with about(f"{measured.name}: {result} of this scene needs a run:"):
            if result == RECORD:
                cases = zip(self.cases(measured, parts), numeric, strict=True)
                forces = [self._force_at(measured, *case, at_guess) for case, (at_guess, *_) in cases]
                order = np.argsort(np.concatenate([rows for *_, rows in numeric]))
                return ca.MX(stacked(*forces))[order.tolist(), 0], False
            closed = is_closed(example, result)
            # SX would unroll a law with matrix quadratures or loops; in MX it stays small.
            kind: Any = ca.SX if closed and example.law.scalar else ca.MX
            own, conditions = kind.sym("y", len(parts)), kind.sym("c", len(measured.conditions))
            values = self.values(ca.vertsplit(own)) | {key: conditions[k] for k, key in enumerate(measured.conditions)}
            scene = self.scene(values)
            if closed:
                value = _CLOSED[result](scene)
            else:
                run = simulate(scene, self.duration_of(scene, values), accuracy=self.accuracy)
                value = MEASURES[result].of(run)
            row = ca.Function("row", [own, conditions], [kind(value)])
        table, which = measured.distinct
        predicted: ca.MX = row.map(len(table))(ca.repmat(y, 1, len(table)), ca.DM(table.T)).T[which.tolist(), :]
        return predicted, closed

    def _force_at(
        self, measured: Measurements, scene: Scene, duration: float, rows: NDArray[np.intp], example: Scene
    ) -> Expression:
        """Return the mount force at the times of some rows; a numeric scene like it decides the number of outputs.

        Polynomials of degree 7 through the nearest of two outputs per step interpolate it to 1e-8.
        """
        steps = simulate(example, duration, accuracy=self.accuracy).accuracy.steps or 1000
        outputs = min(max(400, 2 * steps), 20_000)
        weights = np.zeros((len(rows), outputs + 1))
        for row, place in zip(weights, measured.time[rows] / duration * outputs, strict=True):
            first = int(np.clip(place - 3, 0, outputs - 7))
            row[first : first + 8] = barycentric_interpolate(np.arange(first, first + 8), np.eye(8), place)
        force: Expression = (
            ca.DM(weights) @ simulate(scene, duration, accuracy=self.accuracy, outputs=outputs).mount_force
        )
        return force

    def checked(self, measured: Measurements, case: Case) -> Array:
        """Return the results of the rows of a case from a numeric run, whose error is checked."""
        scene, duration, rows = case
        if measured.result == RECORD:
            return np.asarray(self._force_at(measured, *case, scene), dtype=float).ravel()
        run = simulate(scene, duration, accuracy=self.accuracy)
        return np.full(len(rows), float(as_number(MEASURES[measured.result].of(run))))


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


def is_closed(scene: Scene, result: str) -> bool:
    """Return whether a result has a closed form; the mean draft has one in a steady motion."""
    effects = scene.effects
    steady = not (effects.waves or effects.ramps or effects.entry or effects.own or effects.printed.repelling_spring)
    from_steady = not effects.motion or effects.start == "equilibrium"
    return result in _CLOSED and (result != "mean_draft" or (steady and from_steady))
