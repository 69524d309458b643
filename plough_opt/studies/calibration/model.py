"""The model to calibrate: a scene as a function of its named quantities, some of which are unknown.

Each unknown is searched between bounds, and scaled to the interval from 0 to 1.
"""

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, check_named, mapping_of, plain_number, shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number, exp, is_symbolic
from plough_opt.core.quantities import every_quantity, quantities
from plough_opt.core.units import in_si
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene, quantities_of, with_quantities

Vector = NDArray[np.float64]
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
class Model:
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
    def guess(self) -> Vector:
        """Scaled unknowns at their guesses."""
        return np.array([unknown.scaled(unknown.guess) for unknown in self.unknowns])

    def values(self, y: Sequence[Expression] | Vector) -> dict[str, Expression]:
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
) -> Model:
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
            variables = {key: own for key, own in given.variables.items() if key not in columns}
            unknown = {key: (own.lower, own.upper, own.guess) for key, own in variables.items()}
    elif isinstance(given, Scene):
        title, build, current = given.soil.name, partial(with_quantities, given), _current(given)
    elif callable(given):
        build = given
    else:
        raise InputError(
            f"{shown(given)} must be a Problem, a Scene, or a function of values by key that returns a Scene"
        )
    return Model(title, build, current, duration, accuracy, _unknowns(unknown, current))


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
