"""Accuracy: a method and its setting, or an error to reach."""

from dataclasses import dataclass

import numpy as np

from plough_opt.core.checks import check_named, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.motion.methods import METHODS, ORDER_8, adaptive, fixed_step

DEFAULT_ERROR = 1e-8
DEFAULT_DERIVATIVES = 1e-6
DEFAULT_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Accuracy:
    """How exactly the equation of motion is integrated.

    Args:
        method: ``"auto"`` reaches ``error``; the others are named for whoever wants one:
            ``"dop853"``, fixed steps of order 8, cheapest inside a design and twice differentiable at
            every setting; CasADi's adaptive ``"cvodes"``, ``"idas"``, ``"erk"``, ``"rosenbrock"``; and
            CasADi's fixed-step ``"collocation"`` and ``"rk"``, of order 5 and 4 (RMS by
            ``"rk"`` from a start at which the force has a slope: 3); or a tableau of one's own, by its name in
            `plough_opt.motion.methods.METHODS`.
        error: for ``"auto"``, the wanted relative error: of a numeric run that of every result, each on its own
            scale, as in its ``error_estimate``; default 1e-8.
        steps: for a fixed-step method, steps over the whole duration; default: as many as the scene's
            fastest oscillation needs for 1e-8, or of a symbolic scene, whose time scales are unknown, at
            least 400 of order 8. Under ``"auto"`` a design chooses and refines them by itself. In a numeric run
            order 8 takes a few more: the outermost in two, for what is read between them, and some on either side of
            the end of a ramp.
        derivatives: for ``"auto"``, the wanted error of the first and second derivatives of a symbolic scene's averages
            by relative changes of its numbers, relative to the largest of average, first and second derivatives;
            default 1e-6. Where smooth contact calls for it there are more than 400 steps, and events are located
            more tightly. A symbolic scene cannot be checked, for it has no numbers: that is done where a design is
            solved, at its optimum, and where a component is made, at points between its bounds, by finer
            steps; where the error is missed, a warning says so.
        tolerance: for an adaptive method, relative tolerance; default 1e-10. Absolute tolerances
            follow from it and from the scene's own scales of deflection and speed.

    Raises:
        InputError: an unknown method, or a setting that the method does not have.

    Example:
        >>> import plough_opt as po
        >>> po.Accuracy(error=1e-6).error
        1e-06
    """

    method: str = "auto"
    error: float | None = None
    steps: int | None = None
    tolerance: float | None = None
    derivatives: float | None = None

    def __post_init__(self) -> None:
        check_named("no integration method is named {}", self.method, METHODS)
        self._check_setting("error", self.error, ("auto",), 1e-12, 1e-1)
        self._check_setting("steps", self.steps, fixed_step(), 1, 10**7)
        self._check_setting("derivatives", self.derivatives, ("auto",), 1e-10, 1e-1)
        self._check_setting("tolerance", self.tolerance, adaptive(), 1e-14, 1e-1)

    @property
    def adaptive(self) -> bool:
        """Whether the method takes a tolerance."""
        return METHODS[self.method].adaptive

    @property
    def locates_events(self) -> bool:
        """Whether the method finds the events of a motion."""
        return METHODS[self.method].locates_events

    @property
    def order_8(self) -> bool:
        """Whether a symbolic scene becomes a loop of order-8 steps."""
        return self.method in ORDER_8

    @property
    def wanted_derivatives(self) -> float:
        """Wanted error of derivatives."""
        return self.derivatives or DEFAULT_DERIVATIVES

    def _check_setting(self, name: str, value: float | None, methods: tuple[str, ...], low: float, high: float) -> None:
        if value is None:
            return
        if self.method not in methods:
            raise InputError(f"method '{self.method}' has no setting '{name}': it belongs to {', '.join(methods)}")
        whole = name == "steps"
        sound = is_count(value) if whole else isinstance(value, int | float | np.number) and not isinstance(value, bool)
        value = float(value) if isinstance(value, np.floating) else value  # of few bytes it is compared with its like
        if not (sound and low <= value <= high):
            kind, given = ", as a whole number" if whole else "", f"{min(value, 1e300):g}" if sound else shown(value)
            raise InputError(f"accuracy {name} = {given} must lie between {low:g} and {high:g}{kind}")
