"""The model to calibrate: a scene as a function of its quantities by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number, is_symbolic
from plough_opt.core.quantities import quantities
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of, with_quantities


class Bounded(Protocol):
    """A quantity between bounds."""

    @property
    def lower(self) -> float:
        """Least value."""

    @property
    def upper(self) -> float:
        """Largest value."""

    @property
    def guess(self) -> float:
        """Value where a search begins."""


@runtime_checkable
class Described(Protocol):
    """A scene with its quantities by name, as `read_problem` returns it."""

    @property
    def title(self) -> str:
        """Title for reports."""

    @property
    def accuracy(self) -> Accuracy:
        """Method and setting of runs."""

    @property
    def variables(self) -> Mapping[str, Bounded]:
        """Quantities that a design may change."""

    def values(self) -> dict[str, Expression]:
        """Return the given quantities, by name."""

    def scene(self, changes: Mapping[str, Expression] | None = None) -> Scene:
        """Return the scene, with other values of some quantities."""


SceneOf: TypeAlias = Callable[[Mapping[str, Expression]], Scene]
_DURATION = "scene.duration"


@dataclass(frozen=True)
class Model:
    """A scene by the names of its quantities.

    Attributes:
        title: for reports.
        build: values by key, numbers or symbols, that differ from the scene's own -> scene.
        current: key -> the scene's own value.
        duration: simulated time [s], or None if no result needs it.
        accuracy: method and setting of runs.
    """

    title: str
    build: SceneOf
    current: Mapping[str, float]
    duration: float | None
    accuracy: Accuracy

    def scene(self, values: Mapping[str, Expression]) -> Scene:
        """Return the scene with changed values; a duration among them does not belong to the scene."""
        scene = self.build({key: value for key, value in values.items() if key != _DURATION})
        if not isinstance(scene, Scene):
            raise InputError(f"the function of values returned {shown(scene)}, and must return a Scene")
        return scene

    def duration_of(self, values: Mapping[str, Expression]) -> Expression | None:
        """Return the simulated time [s]."""
        return values.get(_DURATION, self.duration)


def model_of(given: Described | Scene | SceneOf, duration: float | None = None) -> Model:
    """Return the model of a problem, a scene or a function.

    Args:
        given: a problem, a numeric scene, or a function of values by key that returns a scene.
        duration: simulated time [s], if not the problem's.

    Raises:
        InputError: something else.
    """
    if isinstance(given, Described):
        own = given.values()
        values = {**_current(given.scene()), **{key: float(value) for key, value in own.items()}}
        duration = values.get(_DURATION) if duration is None else duration
        return Model(given.title, lambda values: _of_file(given, values), values, duration, given.accuracy)
    if isinstance(given, Scene):
        scene = given
        return Model(
            given.soil.name, lambda values: with_quantities(scene, values), _current(given), duration, Accuracy()
        )
    if callable(given):
        return Model("calibration", given, {}, duration, Accuracy())
    raise InputError(f"{shown(given)} must be a Problem, a Scene, or a function of values by key that returns a Scene")


def _of_file(problem: Described, values: Mapping[str, Expression]) -> Scene:
    """Return a problem's scene; its quantities are those of files, with frame and steel instead of the whole mass."""
    for name in values:
        if name not in quantities():
            raise InputError(f"a problem file has no '{name}': {nearest(name, quantities())}")
    return problem.scene(values)


def _current(scene: Scene) -> dict[str, float]:
    """Return the quantities that a numeric scene has, by name."""
    values = {name: value for name, value in quantities_of(scene).items() if value is not None}
    if any(map(is_symbolic, values.values())):
        raise InputError("the scene holds symbols: calibrate a numeric scene, and name its unknowns")
    return {name: float(as_number(value)) for name, value in values.items()}
