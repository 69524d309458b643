"""Components: a scene as one CasADi Function of its named inputs, with their bounds, to named outputs with limits."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import DomainLimit, bound_of, check_domain, check_limits, check_named, check_text, shown
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, is_casadi, is_symbolic
from plough_opt.core.quantities import EVERY, Quantity
from plough_opt.core.units import has_unit, in_si, unit_of
from plough_opt.laws.law import ResistanceLaw
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.run import ARRAY_OF_PEAK, Run
from plough_opt.motion.vocabulary import MEASURES

# An input whose bounds have at least this ratio is sampled evenly in its logarithm.
_LOG_RATIO = 10.0
# With up to this many inputs all 2^n corners of the box are sampled, otherwise 2n points with one input at a bound.
_MOST_FOR_ALL_CORNERS = 6
# Number of sampled points inside the box.
_INTERIOR_POINTS = 32
RELAXATION = 1e-6
"""An input of an export may lie outside its bounds by this part of their distance, because optimisers relax bounds."""

# A number may lie outside its bounds by this part of their distance, because conversion of units rounds.
_SLACK = 1e-9


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
            object.__setattr__(self, side, bound_of(f"'{self.name}': {side}", getattr(self, side)))
        check_limits(f"'{self.name}'", self.lower, self.upper)


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

    @property
    def limits(self) -> str:
        """Bounds or limits as text, "" for none."""
        if math.isfinite(self.lower) and math.isfinite(self.upper):
            return f"{self.lower:g} to {self.upper:g}"
        ends = (("at least", self.lower), ("at most", self.upper))
        return "".join(f"{side} {end:g}" for side, end in ends if math.isfinite(end))


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
    arguments = [*map(identifier, names)]
    for k, (name, argument) in enumerate(zip(names, arguments, strict=True)):
        if not argument.isidentifier():
            raise InputError(f"{kind} {shown(name)} must be a name that begins with a letter")
        if argument in arguments[:k]:
            other = names[arguments.index(argument)]
            raise InputError(f"{kind} '{name}' is given twice" if other == name else f"'{other}' and '{name}' clash")


def measure_of(output: Output, law: ResistanceLaw) -> tuple[str, Callable[[Run], Expression]]:
    """Return an output's unit, and the function that computes it from a run.

    Raises:
        InputError: an unknown result, or one that this scene does not have.
    """
    if output.of is not None:
        return output.unit or "", output.of
    # A peak has no derivative where its time jumps; the signal itself serves instead.
    if (signal := ARRAY_OF_PEAK.get(output.name)) is not None:
        raise InputError(f"'{output.name}' has no derivative: use '{signal}', which has a value at every output time")
    check_named("no result is named {}", output.name, MEASURES)
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
    lower, upper = (np.array([getattr(port, side) for port in inputs]) for side in ("lower", "upper"))
    wide = (lower > 0.0) & (upper > _LOG_RATIO * lower)
    ratio = np.where(wide, upper / np.where(wide, lower, 1.0), 1.0)
    return [*np.where(wide, lower * ratio**fractions, lower + (upper - lower) * fractions)]


class Component(ca.Function):
    """A scene as a CasADi Function with named inputs and outputs; it accepts numbers only between its bounds.

    Called with numbers it returns floats and arrays; called with SX or MX symbols it returns expressions with exact
    derivatives::

        draft, rms = component(0.4, 0.25, 5e4)          # in the order of the inputs
        component(scene_stiffness=4e4)["mean_draft"]    # by name, the others at their values

    It has all methods of a Function, such as ``map``, ``jacobian``, ``save``, and ``call``, which does not check
    bounds. Inputs and outputs are scalars and columns, named by `Port.argument`. It can be pickled.

    Attributes:
        inputs: names, units, bounds and values.
        outputs: names, units, limits, and values at the inputs' values.
        accuracy: method and steps.
        error_estimate: largest relative error [-] found at corners of the bounds and points inside, as in `simulate`.
        warnings: warnings about its results.
        domain: limits of the law of resistance, and a Function of the same inputs that returns the limited values.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> scene = po.Scene(soil, cone, 5e4, 30.0, 2.0, po.Effects(motion=False))
        >>> made = po.component(scene, 1.0, inputs=["share.height"], outputs=["mean_draft"])
        >>> [port.name for port in made.inputs]
        ['share.height']
    """

    def __init__(
        self,
        function: ca.Function,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        accuracy: Accuracy,
        error_estimate: float,
        warnings: tuple[str, ...],
        domain: tuple[tuple[DomainLimit, ...], ca.Function],
    ) -> None:
        super().__init__(function)
        self.inputs, self.outputs, self.accuracy = inputs, outputs, accuracy
        self.error_estimate, self.warnings, self.domain = error_estimate, warnings, domain

    def __call__(self, *values: Any, **named: Any) -> Any:
        """Return the outputs: as a tuple, or alone if there is one; as a dictionary if the inputs are given by name.

        Args:
            values: every input, in order: floats, or SX or MX expressions.
            named: inputs by name, with dots or underscores; omitted ones have their values.

        Raises:
            InputError: too many or too few inputs, an unknown name, or an array (``map`` takes many values).
            DomainError: a number outside the bounds, for which the steps were not chosen, or outside the domain of the
                law of resistance; ``call`` accepts it.
        """
        if named and values:
            raise InputError("give the inputs in order or by name, not both")
        if not named and len(values) != len(self.inputs):
            names = ", ".join(port.name for port in self.inputs)
            raise InputError(f"'{self.name()}' takes {len(self.inputs)} inputs ({names}), not {len(values)}")
        x: list[Any] = self._complete(named) if named else list(values)
        numeric = not any(map(is_symbolic, x))
        if numeric:
            x = [self._number(port, value) for port, value in zip(self.inputs, x, strict=True)]
            limits, values_of = self.domain
            for limit, value in zip(limits, values_of.call(x)[0].full().ravel().tolist(), strict=True):
                limit.check(value)
        results: list[Any] = self.call(x)
        if numeric:
            arrays = [np.asarray(value, dtype=float).ravel() for value in results]
            results = [float(array[0]) if array.size == 1 else array for array in arrays]
            for port, array in zip(self.outputs, arrays, strict=True):
                if not np.all(np.isfinite(array)):
                    where = point_text(self.inputs, x)
                    raise DomainError(f"'{port.name}' has no finite value at {where}: narrow the component's bounds")
        if named:
            return dict(zip((port.name for port in self.outputs), results, strict=True))
        return results[0] if len(results) == 1 else tuple(results)

    def _complete(self, named: Mapping[str, Expression]) -> list[Expression]:
        """Return every input in order; those that are not named have their values."""
        known = {name: port for port in self.inputs for name in (port.argument, port.name)}
        values: dict[Port, Expression] = {port: port.value for port in self.inputs}
        for name, value in named.items():
            check_named(f"'{self.name()}' has no input {{}}", name, known)
            port = known[name]
            if name == port.name != port.argument in named:
                raise InputError(f"'{port.name}' is given twice, also as '{port.argument}': leave one of the two out")
            values[port] = value
        return [*values.values()]

    def _number(self, port: Port, value: Expression) -> float:
        """Return an input as a float.

        Raises:
            InputError: a value that is not a single number.
            DomainError: a number outside the input's bounds.
        """
        number = as_number(value) if is_casadi(value) else np.asarray(value)
        if number.dtype.kind not in "iuf":
            raise InputError(f"'{port.name}' = {shown(value)} must be a number or a CasADi expression")
        if number.size != 1:
            raise InputError(f"'{port.name}' is an array of {number.size} values: component.map takes many at a time")
        plain, slack = float(number.reshape(())), _SLACK * (port.upper - port.lower)
        if not port.lower - slack <= plain <= port.upper + slack:
            unit = f" {port.unit}" if port.unit else ""
            bounds = f"{port.lower:g} and {port.upper:g}{unit}, the bounds for which this component was made"
            raise DomainError(f"{port.name} = {plain:g}{unit} must lie between {bounds}: make it with wider ones")
        return plain

    @cached_property
    def slopes(self) -> ca.Function:
        """Function of the same inputs that returns the derivatives of all outputs, stacked, as one dense matrix."""
        x = [ca.MX.sym(port.argument) for port in self.inputs]
        column = ca.MX.sym("inputs", len(x))
        stacked = ca.vertcat(*self.call(ca.vertsplit(column)))
        jacobian = ca.Function("jacobian", [column], [ca.densify(ca.jacobian(stacked, column))])
        options = {"default_in": [port.value for port in self.inputs]}
        names = [port.argument for port in self.inputs]
        return ca.Function(f"{self.name()}_slopes", x, [jacobian(ca.vertcat(*x))], names, ["slopes"], options)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the slopes, which are built anew when needed."""
        own = {key: value for key, value in self.__dict__.items() if key not in ("this", "slopes")}
        return {**super().__getstate__(), "own": own}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore a pickled state."""
        Component.__init__(self, ca.Function.deserialize(state["serialization"]), **state["own"])

    def __deepcopy__(self, memo: Any = None) -> Component:
        """Return itself: it is immutable, and CasADi's copy would lose the ports."""
        return self

    __copy__ = __deepcopy__

    def __str__(self) -> str:
        """Return names, units, bounds and accuracy as text."""
        lines = [f"{self.name()}: {len(self.inputs)} inputs, {len(self.outputs)} outputs, SI units"]
        for kind, ports in (("in ", self.inputs), ("out", self.outputs)):
            for port in ports:
                shape = f"[{port.size}]" if port.size > 1 else ""
                limits = f" {port.limits}" if port.limits else ""
                lines.append(f"{kind} {port.name}{shape} [{port.unit or '1'}]{limits}, value {port.value:g}")
        steps = f", {self.accuracy.steps} steps" if self.accuracy.steps else ""
        error = f"relative error at most {self.error_estimate:.1e} at the points tried"
        return "\n".join([*lines, f"{self.accuracy.method}{steps}, {error}", *self.warnings])
