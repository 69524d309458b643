"""Accuracy: an integration method with its setting, or the error to reach."""

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
    """Accuracy with which the equation of motion is integrated.

    Args:
        method: ``"auto"``, the default, chooses a method that reaches ``error``. Named methods are ``"dop853"``, fixed
            steps of order 8, cheapest inside a design and twice differentiable at every setting; CasADi's adaptive
            ``"cvodes"``, ``"idas"``, ``"erk"`` and ``"rosenbrock"``; CasADi's fixed-step ``"collocation"`` and
            ``"rk"``, of order 5 and 4 (an RMS by ``"rk"``: order 3 if the force has a slope at the start); or the name
            of your own tableau in `plough_opt.motion.methods.METHODS`.
        error: for ``"auto"``, the relative error to reach in a numeric run, for every result on its own scale, as in
            ``error_estimate``; default 1e-8.
        steps: for a fixed-step method, number of steps over the whole duration. Default: as many as the fastest
            oscillation of the scene needs for 1e-8; for a symbolic scene, whose time scales are unknown, at least 400
            of order 8. Under ``"auto"`` a design chooses and refines the number. A numeric run of order 8 takes a few
            more, because it halves the first and the last step and needs some steps on either side of the end of a
            ramp.
        derivatives: for ``"auto"``, the error to reach in the first and second derivatives of a symbolic scene's
            averages; default 1e-6. Derivatives are by relative changes of the scene's numbers, and their error is
            relative to the largest of average, first and second derivatives. Smooth contact may need more than 400
            steps, and events are located more tightly. A symbolic scene has no numbers, so its error is checked later
            by finer steps: at the optimum of a design, and at points between the bounds of a component. A warning
            reports an error that was not reached.
        tolerance: for an adaptive method, relative tolerance; default 1e-10. Absolute tolerances follow from it and
            from the scene's own scales of deflection and speed.

    Raises:
        InputError: the method is unknown, or does not have one of the settings.

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
        """Whether the setting of the method is a tolerance."""
        return METHODS[self.method].adaptive

    @property
    def locates_events(self) -> bool:
        """Whether the method locates the events of a motion."""
        return METHODS[self.method].locates_events

    @property
    def order_8(self) -> bool:
        """Whether a symbolic scene becomes a loop over steps of order 8."""
        return self.method in ORDER_8

    @property
    def wanted_derivatives(self) -> float:
        """Error to reach in derivatives."""
        return self.derivatives or DEFAULT_DERIVATIVES

    def _check_setting(self, name: str, value: float | None, methods: tuple[str, ...], low: float, high: float) -> None:
        if value is None:
            return
        if self.method not in methods:
            raise InputError(f"method '{self.method}' has no setting '{name}', which is for {', '.join(methods)}")
        whole = name == "steps"
        sound = is_count(value) if whole else isinstance(value, int | float | np.number) and not isinstance(value, bool)
        value = float(value) if isinstance(value, np.floating) else value  # NumPy would round the bounds to float16
        if not (sound and low <= value <= high):
            kind, given = " and be a whole number" if whole else "", f"{min(value, 1e300):g}" if sound else shown(value)
            raise InputError(f"accuracy {name} = {given} must lie between {low:g} and {high:g}{kind}")
