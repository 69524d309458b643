"""Goal: an objective with a name, a unit and a direction."""

from dataclasses import dataclass, field

import casadi as ca

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, is_casadi


@dataclass(frozen=True)
class Goal:
    """One objective of a trade-off.

    Attributes:
        name: what reports call it.
        expression: scalar CasADi expression of the design's variables.
        unit: its unit, for reports.
        maximise: whether more of it is better.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> po.Goal("draft", 5e4 * height**2, unit="N").sign
        1.0
    """

    name: str
    expression: Expression = field(repr=False)
    unit: str = ""
    maximise: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(
                f"an objective's name = {shown(self.name)} must be a text that says what it is, as 'draft'"
            )
        if not is_casadi(self.expression) or isinstance(self.expression, ca.SX):
            raise InputError(f"the objective '{self.name}' is not an expression of a design's variables")
        if self.expression.numel() != 1:
            raise InputError(
                f"the objective '{self.name}' must be one number, not {self.expression.numel()}: sum or average it"
            )

    @property
    def sign(self) -> float:
        """1 for what is minimised, -1 for what is maximised."""
        return -1.0 if self.maximise else 1.0


@dataclass(frozen=True)
class Axis:
    """An objective or a variable, as reports and pictures need it.

    Attributes:
        name: as declared.
        unit: SI unit.
        maximise: whether more is better; False for a variable.
        log: whether a variable is scaled by its logarithm.
        lower: lower bound of a variable, None for an objective.
        upper: upper bound of a variable, None for an objective.
    """

    name: str
    unit: str
    maximise: bool = False
    log: bool = False
    lower: float | None = None
    upper: float | None = None

    @property
    def sign(self) -> float:
        """-1 for what is maximised."""
        return -1.0 if self.maximise else 1.0
