"""Integration methods by name: Butcher tableaus, CasADi's integrators, and `Accuracy`, a method with its setting."""

from dataclasses import dataclass, field
from typing import Final

from plough_opt.core.checks import check_named, plain_number, whole_number
from plough_opt.core.errors import InputError

# Rounding of sums of a tableau's coefficients, which may be as large as about 50.
_ROUNDING_OF_TABLEAU = 1e-12


@dataclass(frozen=True)
class Method:
    """Integration method.

    Attributes:
        order: order of a fixed-step method; otherwise None.
        adaptive: whether its setting is a tolerance instead of a number of steps.
        locates_events: whether it locates the events of a motion, with the derivatives of their times.
        finer: number of its steps that replace one step of order 8.
    """

    order: int | None = None
    adaptive: bool = False
    locates_events: bool = False
    finer: float = 1.0


@dataclass(frozen=True)
class Tableau(Method):
    """Explicit Runge-Kutta method given by its Butcher tableau: fixed steps, differentiable any number of times.

    Args:
        order: order of the error.
        nodes: times of the stages, as fractions of a step.
        weights: weights of the stages' rates in the step.
        stages: for each stage, the weights of the rates of the stages before it; the first row is empty.

    Raises:
        InputError: a row has the wrong length, or the coefficients are inconsistent with the order.

    Example:
        >>> Tableau(2, nodes=(0.0, 0.5), weights=(0.0, 1.0), stages=((), (0.5,))).order
        2
    """

    nodes: tuple[float, ...] = field(kw_only=True)
    weights: tuple[float, ...] = field(kw_only=True)
    stages: tuple[tuple[float, ...], ...] = field(kw_only=True)

    def __post_init__(self) -> None:
        order = self.order or 0
        lengths = [len(row) for row in self.stages]
        if order < 1 or lengths != list(range(len(self.nodes))) or len(self.weights) != len(self.nodes):
            raise InputError(
                f"a tableau of order {self.order} with {len(self.nodes)} nodes, {len(self.weights)} weights and rows of"
                f" lengths {lengths} must be explicit: a node and a weight for each stage, and k weights in row k,"
                " counted from 0"
            )
        for power in range(order):
            wrong = sum(w * c**power for w, c in zip(self.weights, self.nodes, strict=True)) - 1.0 / (power + 1)
            if not abs(wrong) <= _ROUNDING_OF_TABLEAU:
                raise InputError(
                    f"the weights of a tableau of order {order} integrate t^{power} with an error of {wrong:.1e}: check"
                    " nodes and weights"
                )
        for node, row in zip(self.nodes, self.stages, strict=True):
            if not abs(sum(row) - node) <= _ROUNDING_OF_TABLEAU:
                raise InputError(f"a row of the tableau adds up to {sum(row)}: it must add up to its node {node}")
        if order != ORDER:  # the error is proportional to the step size to the power of the order
            # Usual error of steps of order 8. From it follows the number of steps of a method of another order.
            object.__setattr__(self, "finer", max(1.0, 1e-10 ** (1.0 / ORDER - 1.0 / order)))


ORDER: Final = 8
"""Order of the steps that the toolkit takes by default."""

# fmt: off
DOP853: Final = Tableau(
    ORDER,
    nodes=(
        0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333, 0.25,
        0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0,
    ),
    weights=(
        0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585,
        0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259,
    ),
    stages=(
        (),
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402,
         0.008273789163814023),
        (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894,
         -43.48988418106996),
        (0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843, 21.230051448181193, 15.279233632882423,
         -33.28821096898486, -0.020331201708508627),
        (-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927, -18.52006565999696,
         22.739487099350505, 2.4936055526796523, -3.0467644718982196),
        (2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188, 27.94888452941996,
         -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636),
    ),
)
# fmt: on
"""Dormand and Prince's method of order 8: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
1993, section II.5, as doubles."""

METHODS: Final[dict[str, Method]] = {
    "auto": Method(locates_events=True),
    "dop853": DOP853,
    "cvodes": Method(adaptive=True),
    "idas": Method(adaptive=True),
    "erk": Method(adaptive=True, locates_events=True),
    "rosenbrock": Method(adaptive=True, locates_events=True),
    # Measured factors for the error of order 8.
    "collocation": Method(order=5, finer=2.0),
    "rk": Method(order=4, finer=16.0),
}
"""Name -> method. "auto" chooses one of the others. Add a `Tableau` here to use it by name."""

ORDER_8: Final = ("dop853", "auto")
"""Methods that turn a symbolic scene into a loop over steps of order 8; under "auto" a design sets their number."""


def fixed_step() -> tuple[str, ...]:
    """Return the names of the fixed-step methods."""
    return tuple(name for name, method in METHODS.items() if method.order is not None)


def adaptive() -> tuple[str, ...]:
    """Return the names of the adaptive methods."""
    return tuple(name for name, method in METHODS.items() if method.adaptive)


def locating() -> tuple[str, ...]:
    """Return the names of the methods that locate events."""
    return tuple(name for name, method in METHODS.items() if method.locates_events)


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
    def tableau(self) -> Tableau | None:
        """Tableau by which a symbolic scene becomes a loop over steps; None for other methods."""
        method = DOP853 if self.order_8 else METHODS[self.method]
        return method if isinstance(method, Tableau) else None

    @property
    def wanted_derivatives(self) -> float:
        """Error to reach in derivatives."""
        return self.derivatives or DEFAULT_DERIVATIVES

    def _check_setting(self, name: str, value: float | None, methods: tuple[str, ...], low: float, high: float) -> None:
        if value is None:
            return
        if self.method not in methods:
            raise InputError(f"method '{self.method}' has no setting '{name}', which is for {', '.join(methods)}")
        if name == "steps":
            whole_number("accuracy steps", value, int(low), int(high))
        else:
            object.__setattr__(self, name, plain_number(f"accuracy {name}", value, at_least=low, at_most=high))
