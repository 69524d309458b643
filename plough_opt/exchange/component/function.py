"""`Component`: a CasADi Function whose inputs and outputs have names, units and bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import Limit, shown
from plough_opt.core.errors import DomainError, InputError, nearest
from plough_opt.core.expressions import Expression, as_number, is_casadi, is_symbolic
from plough_opt.exchange.component.ports import Port, point_text
from plough_opt.motion.methods import Accuracy

# A number may lie outside its bounds by this part of their distance, because conversion of units rounds.
_SLACK = 1e-9


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
        error_estimate: largest relative error [-] found at corners of the bounds and points inside. Errors of mean
            draft and RMS force are relative to the larger of the two, those of the mount force to its peak.
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
        domain: tuple[tuple[Limit, ...], ca.Function],
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
            results = [_float_or_array(value) for value in results]
            self._check_finite(results, x)
        if named:
            return dict(zip((port.name for port in self.outputs), results, strict=True))
        return results[0] if len(results) == 1 else tuple(results)

    def _complete(self, named: Mapping[str, Expression]) -> list[Expression]:
        """Return every input in order; those that are not named have their values."""
        known = {name: port for port in self.inputs for name in (port.argument, port.name)}
        values: dict[Port, Expression] = {port: port.value for port in self.inputs}
        for name, value in named.items():
            if name not in known:
                raise InputError(
                    f"'{self.name()}' has no input '{name}': {nearest(name, [p.name for p in self.inputs])}"
                )
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
            raise DomainError(
                f"{port.name} = {plain:g}{unit} must lie between {port.lower:g} and {port.upper:g}{unit}, the bounds"
                " for which this component was made: make one with wider bounds"
            )
        return plain

    def _check_finite(self, results: Sequence[Any], x: Sequence[float]) -> None:
        """Raise DomainError if a result is not finite."""
        for port, value in zip(self.outputs, results, strict=True):
            if not np.all(np.isfinite(value)):
                where = point_text(self.inputs, x)
                raise DomainError(f"'{port.name}' has no finite value at {where}: narrow the component's bounds")

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

    def __copy__(self) -> Component:
        """Return itself: it is immutable, and CasADi's copy would lose the ports."""
        return self

    def __deepcopy__(self, memo: Any = None) -> Component:
        """Return itself."""
        return self

    def __str__(self) -> str:
        """Return names, units, bounds and accuracy as text."""
        lines = [f"{self.name()}: {len(self.inputs)} inputs, {len(self.outputs)} outputs, SI units"]
        for kind, ports in (("in ", self.inputs), ("out", self.outputs)):
            for port in ports:
                shape = f"[{port.size}]" if port.size > 1 else ""
                lines.append(f"{kind} {port.name}{shape} [{port.unit or '1'}]{_limits(port)}, value {port.value:g}")
        steps = f", {self.accuracy.steps} steps" if self.accuracy.steps else ""
        lines.append(
            f"{self.accuracy.method}{steps}, relative error at most {self.error_estimate:.1e} at the points tried"
        )
        return "\n".join([*lines, *self.warnings])


def _limits(port: Port) -> str:
    """Return the bounds of a port as text."""
    if math.isfinite(port.lower) and math.isfinite(port.upper):
        return f" {port.lower:g} to {port.upper:g}"
    limits = (("at least", port.lower), ("at most", port.upper))
    return "".join(f" {side} {limit:g}" for side, limit in limits if math.isfinite(limit))


def _float_or_array(value: Any) -> float | NDArray[np.float64]:
    array = np.asarray(value, dtype=float).ravel()
    return float(array[0]) if array.size == 1 else array
