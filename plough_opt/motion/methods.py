"""The integration methods by name, and which of them are steps of a Butcher tableau, CasADi's, or chosen."""

from dataclasses import dataclass, field
from typing import Final

from plough_opt.core.errors import InputError
from plough_opt.motion.dop853 import NODES, STAGES, WEIGHTS

# Rounding of a tableau's coefficients, which may be as large as some tens.
_ROUNDING = 1e-12
# Error that steps of order 8 are usually chosen for: by the law of its order a method of another one then takes others.
_USUAL_ERROR = 1e-10


@dataclass(frozen=True)
class Method:
    """An integration method.

    Attributes:
        order: of a method of fixed steps.
        adaptive: whether it takes a tolerance, and no number of steps.
        locates_events: whether it finds the events of a motion, and differentiates through their times.
        finer: how many steps it takes for one of order 8.
    """

    order: int | None = None
    adaptive: bool = False
    locates_events: bool = False
    finer: float = 1.0


@dataclass(frozen=True)
class Tableau(Method):
    """An explicit Runge-Kutta method by its Butcher tableau: fixed steps, any number of derivatives.

    Args:
        order: of its error.
        nodes: times of the stages, as fractions of a step.
        weights: of the stages' rates in the step.
        stages: weights of the rates before a stage in that stage; the first row is empty.

    Raises:
        InputError: rows of another length, or coefficients that are not those of a method of first order at least.

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
                f" {lengths} must be explicit: a node and a weight for each stage, and in row k the weights of k rates"
            )
        for power in range(order):
            wrong = sum(w * c**power for w, c in zip(self.weights, self.nodes, strict=True)) - 1.0 / (power + 1)
            if not abs(wrong) <= _ROUNDING:
                raise InputError(
                    f"the weights of a tableau of order {order} integrate the power {power} with an error of"
                    f" {wrong:.1e}: check nodes and weights"
                )
        for node, row in zip(self.nodes, self.stages, strict=True):
            if not abs(sum(row) - node) <= _ROUNDING:
                raise InputError(f"the row of a tableau's stage at {node} adds up to {sum(row)}: it must be the node")
        if order != ORDER:  # by the law of the order
            object.__setattr__(self, "finer", max(1.0, _USUAL_ERROR ** (1.0 / ORDER - 1.0 / order)))


ORDER: Final = 8
"""Order of the steps that the toolkit takes by itself."""

DOP853: Final = Tableau(ORDER, nodes=NODES, weights=WEIGHTS, stages=STAGES)

METHODS: Final[dict[str, Method]] = {
    "auto": Method(locates_events=True),
    "dop853": DOP853,
    "cvodes": Method(adaptive=True),
    "idas": Method(adaptive=True),
    "erk": Method(adaptive=True, locates_events=True),
    "rosenbrock": Method(adaptive=True, locates_events=True),
    # By trial they take so many steps for the error of order 8.
    "collocation": Method(order=5, finer=2.0),
    "rk": Method(order=4, finer=16.0),
}
"""Name -> method; a `Tableau` that is added here is a method like the others. "auto" chooses, and checks itself."""

ORDER_8: Final = ("dop853", "auto")
"""Methods by which a symbolic scene becomes a loop of order-8 steps; under "auto" a design sets their number."""


def fixed_step() -> tuple[str, ...]:
    """Return the names of the methods that take a number of steps."""
    return tuple(name for name, method in METHODS.items() if method.order is not None)


def adaptive() -> tuple[str, ...]:
    """Return the names of the methods that take a tolerance."""
    return tuple(name for name, method in METHODS.items() if method.adaptive)


def locating() -> tuple[str, ...]:
    """Return the names of the methods that find the events of a motion."""
    return tuple(name for name, method in METHODS.items() if method.locates_events)


def is_stepped(name: str) -> bool:
    """Return whether a symbolic scene becomes a loop over steps of a tableau."""
    return name == "auto" or isinstance(METHODS[name], Tableau)


def tableau_of(name: str) -> Tableau:
    """Return the tableau of a method that `is_stepped`."""
    method = METHODS[name]
    return method if isinstance(method, Tableau) else DOP853
