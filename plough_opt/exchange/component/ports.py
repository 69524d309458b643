"""Inputs and outputs of a component, as requested (`Input`, `Output`) and as built (`Port`)."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_domain, check_text, plain_number, shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number
from plough_opt.core.quantities import EVERY, Quantity
from plough_opt.core.units import has_unit, in_si, unit_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import MEASURES

# An input whose bounds have at least this ratio is sampled evenly in its logarithm.
_LOG_RATIO = 10.0
# With up to this many inputs all 2^n corners of the box are sampled, otherwise 2n points with one input at a bound.
_MOST_FOR_ALL_CORNERS = 6
# Number of sampled points inside the box.
_INTERIOR_POINTS = 32
RELAXATION = 1e-6
"""An input of an export may lie outside its bounds by this part of their distance, because optimisers relax bounds."""

# A peak has no derivative where its time jumps; the signal itself serves instead.
_SIGNALS_OF_PEAKS = {"peak_force": "mount_force", "peak_deflection": "deflection"}


@dataclass(frozen=True)
class Input:
    """A requested input: a quantity of the scene by its name, or a symbol in the scene.

    Bounds and value are numbers in SI units, texts such as "50 kN/m", or pint quantities.

    Args:
        name: a quantity's name in problem files, such as "share.height"; with ``symbol`` any name.
        lower: least value that the component accepts; default: halfway from the scene's value to the lower end of the
            model's domain, which is mostly 0.
        upper: largest value that it accepts; default: halfway to the upper end of the domain, but at most twice the
            scene's value of a quantity that cannot be negative.
        value: value used if a caller omits the input; default: the scene's.
        unit: SI unit; not needed for a quantity of the scene.
        symbol: a CasADi symbol in the scene; it needs bounds.

    Raises:
        InputError: a name that is not a text, a text that is not a quantity of this kind, or plain numbers with a unit
            that is not SI.

    Example:
        >>> import plough_opt as po
        >>> po.Input("scene.stiffness", "20 kN/m", "200 kN/m").upper
        200000.0
    """

    name: str
    lower: float | None = None
    upper: float | None = None
    value: float | None = None
    unit: str | None = None
    symbol: Expression | None = None

    def __post_init__(self) -> None:
        check_text("the name of an input", self.name)
        known = EVERY.get(self.name) if self.symbol is None else None
        _read_in_si(self, None if known is None else known.unit, ("lower", "upper", "value"))


def _read_in_si(owner: Input | Output, unit: str | None, sides: Sequence[str]) -> None:
    """Convert fields of an input or output to SI; each may be a number, a text or a pint quantity.

    Args:
        owner: the input or output.
        unit: SI unit of the fields; None: the owner's unit, or that of the given values.
        sides: names of the fields.
    """
    values = [getattr(owner, side) for side in sides]
    if unit is None:
        # An infinite limit is one that was not given.
        given = [None if isinstance(value, float) and math.isinf(value) else value for value in values]
        unit, _ = unit_of(f"'{owner.name}'", owner.unit or "", *given)
        if owner.unit is not None or any(map(has_unit, values)):
            object.__setattr__(owner, "unit", unit)
    for side, value in zip(sides, values, strict=True):
        object.__setattr__(owner, side, in_si(f"'{owner.name}': {side}", value, unit))


@dataclass(frozen=True)
class Output:
    """A requested output: a result by its name in problem files, or a function of the run.

    Args:
        name: a result's name, such as "mean_draft"; with ``of`` any name.
        lower: lower limit of the result for an optimiser, if any; the component does not enforce it.
        upper: upper limit.
        of: symbolic run -> value, computed by arithmetic and the functions of `plough_opt.core.expressions`.
        unit: SI unit; not needed for a named result.

    Raises:
        InputError: a name that is not a text, or limits that contradict each other.

    Example:
        >>> import plough_opt as po
        >>> po.Output("mean_draft", upper="8 kN").upper
        8000.0
    """

    name: str
    lower: float = -math.inf
    upper: float = math.inf
    of: Callable[[Run], Expression] | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        check_text("the name of an output", self.name)
        known = MEASURES.get(self.name) if self.of is None else None
        _read_in_si(self, None if known is None else known.unit.symbol, ("lower", "upper"))
        for side in ("lower", "upper"):
            limit = getattr(self, side)
            if not (isinstance(limit, float) and math.isinf(limit)):
                object.__setattr__(self, side, plain_number(f"'{self.name}': {side}", limit))
        if not self.lower <= self.upper:
            raise InputError(
                f"the limits of '{self.name}' contradict each other: {self.lower:g} is above {self.upper:g}"
            )


@dataclass(frozen=True)
class Port:
    """An input or output of a component.

    Attributes:
        name: its name, such as "share.height".
        unit: SI unit, "" for a pure number.
        lower: lower bound of an input; lower limit of an output, or minus infinity.
        upper: upper bound or limit.
        value: for an input, the value used if a caller omits it; for an output, its value at these inputs, the largest
            one of a column.
        size: number of values: 1, or the number of output times.
    """

    name: str
    unit: str
    lower: float
    upper: float
    value: float
    size: int = 1

    @property
    def argument(self) -> str:
        """The name as an identifier, such as "share_height"."""
        return identifier(self.name)


def port_of(request: Input, quantity: Quantity, value: Expression) -> Port:
    """Return an input's port.

    Args:
        request: the requested input, whose own value takes precedence over the scene's.
        quantity: unit and domain.
        value: the scene's value.

    Raises:
        InputError: bounds that contradict each other or the value, or another unit.
        DomainError: a number that is not finite.
    """
    name = request.name
    value = float(as_number(value)) if request.value is None else request.value
    # Default bounds lie halfway to the ends of the domain, the upper one at no more than twice a non-negative value.
    lower = quantity.low + (value - quantity.low) / 2.0 if request.lower is None else request.lower
    twice = 2.0 * value if quantity.low >= 0.0 else math.inf
    upper = min(twice, (value + quantity.high) / 2.0) if request.upper is None else request.upper
    if request.unit is not None and request.unit != quantity.unit:
        raise InputError(f"'{name}' is in {quantity.unit or 'no unit'}, not in {request.unit}")
    for side, bound in (("lower", lower), ("upper", upper), ("value", value)):
        check_domain(f"{side} of '{name}'", bound, quantity.unit)
    if not lower < upper:
        raise InputError(f"'{name}': lower {lower:g} is not below upper {upper:g} {quantity.unit}: give bounds")
    if not lower <= value <= upper:
        raise InputError(f"'{name}' = {value:g} lies outside its bounds {lower:g} to {upper:g}")
    return Port(name, quantity.unit, float(lower), float(upper), float(value))


def identifier(name: str) -> str:
    """Return a name as an identifier that is valid in Python, C and CasADi."""
    return re.sub(r"\W+|_{2,}", "_", name, flags=re.ASCII).strip("_")


def point_text(inputs: Sequence[Port], x: Iterable[float]) -> str:
    """Return values of the inputs as text: "share.height = 0.25 m, ..."."""
    return ", ".join(f"{port.name} = {value:.6g} {port.unit}".rstrip() for port, value in zip(inputs, x, strict=True))


def check_names(kind: str, names: Sequence[str]) -> None:
    """Raise InputError if there are no names, one gives no identifier, or two give the same identifier."""
    if not names:
        raise InputError(f"a component needs {kind}s: name at least one")
    name_of: dict[str, str] = {}
    for name in names:
        argument = identifier(name)
        if not argument.isidentifier():
            raise InputError(f"{kind} {shown(name)} must be a name that begins with a letter")
        if argument in name_of:
            other = name_of[argument]
            raise InputError(f"{kind} '{name}' is given twice" if other == name else f"'{other}' and '{name}' clash")
        name_of[argument] = name


def measure_of(output: Output, law: ResistanceLaw) -> tuple[str, Callable[[Run], Expression]]:
    """Return an output's unit, and the function that computes it from a run.

    Raises:
        InputError: an unknown result, or one that this scene does not have.
    """
    if output.of is not None:
        return output.unit or "", output.of
    if output.name in _SIGNALS_OF_PEAKS:
        signal = _SIGNALS_OF_PEAKS[output.name]
        raise InputError(f"'{output.name}' has no derivative: use '{signal}', which has a value at every output time")
    if output.name not in MEASURES:
        raise InputError(f"no result is named '{output.name}': {nearest(output.name, MEASURES)}")
    measure = MEASURES[output.name]
    measure.check(output.name, law)
    return measure.unit.symbol, measure.of


def corner_points(inputs: Sequence[Port]) -> list[NDArray[np.float64]]:
    """Return the inputs' values, and the corners of the box between their bounds.

    With many inputs there would be too many corners: then each point has one input at a bound and the others at their
    values.
    """
    values = np.array([port.value for port in inputs])
    if len(inputs) <= _MOST_FOR_ALL_CORNERS:
        return [values, *map(np.array, itertools.product(*((port.lower, port.upper) for port in inputs)))]
    points = [values]
    for k, port in enumerate(inputs):
        for bound in (port.lower, port.upper):
            points.append(np.concatenate([values[:k], [bound], values[k + 1 :]]))
    return points


def interior_points(inputs: Sequence[Port]) -> list[NDArray[np.float64]]:
    """Return points spread evenly inside the box between the inputs' bounds."""
    # Roberts's low-discrepancy sequence: its increments are negative powers of the root of x^(n + 1) = x + 1.
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (len(inputs) + 1))
    increments = root ** -np.arange(1.0, len(inputs) + 1)
    fractions = (0.5 + np.outer(np.arange(1, _INTERIOR_POINTS + 1), increments)) % 1.0
    return [np.array([_between(port, f) for port, f in zip(inputs, row, strict=True)]) for row in fractions]


def _between(port: Port, fraction: float) -> float:
    """Return the value at a fraction of the way from the lower to the upper bound."""
    if port.lower > 0.0 and port.upper > _LOG_RATIO * port.lower:
        return float(port.lower * (port.upper / port.lower) ** fraction)
    return float(port.lower + (port.upper - port.lower) * fraction)
