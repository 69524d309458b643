"""A CasADi Function of SX as a list of operations, each of them on many designs side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Operation:
    """One operation: its result is the value of a function of other values.

    Attributes:
        value: number of the result.
        code: CasADi's code of the operation.
        of: numbers of the operands.
        once: whether it depends on the last argument alone, which is the same in every step.
        spent: operands that no later operation needs, if it is carried out in every step.
    """

    value: int
    code: int
    of: tuple[int, ...]
    once: bool
    spent: tuple[int, ...] = ()


@dataclass(frozen=True)
class OperationList:
    """A Function as operations on numbered values.

    Attributes:
        operations: in order.
        inputs: number of a value -> (argument, element).
        constants: number of a value -> the constant.
        results: number of the value of each element of the result.
    """

    operations: tuple[Operation, ...]
    inputs: dict[int, tuple[int, int]]
    constants: dict[int, float]
    results: tuple[int, ...]

    @classmethod
    def of(cls, function: ca.Function) -> OperationList:
        """Return the operations of a Function of SX whose only result is a dense column.

        Raises:
            InputError: an operation that arrays cannot do.
        """
        inputs: dict[int, tuple[int, int]] = {}
        results = [-1] * function.numel_out(0)
        values = _Values()
        work: dict[int, int] = {}
        for k in range(function.n_instructions()):
            code, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if code == ca.OP_INPUT:
                work[into[0]] = values.number(once=of[0] == function.n_in() - 1)
                inputs[work[into[0]]] = (of[0], of[1])
            elif code == ca.OP_CONST:
                work[into[0]] = values.constant(function.instruction_constant(k))
            elif code == ca.OP_OUTPUT:
                results[into[1]] = work[of[0]]
            elif code in MEANING:
                work[into[0]] = values.apply(code, tuple(work[j] for j in of))
            else:
                raise InputError(f"a batch cannot do CasADi's operation number {code}")
        return cls(_until_spent(values.operations, results), inputs, values.constants, tuple(results))

    def once(self, arguments: list[Array]) -> list[Any]:
        """Return the values that are the same in every step, of arguments with a row for each element."""
        values: list[Any] = [None] * (1 + max([0, *self.inputs, *self.constants, *(o.value for o in self.operations)]))
        for k, constant in self.constants.items():
            values[k] = constant
        for k, (argument, element) in self.inputs.items():
            values[k] = arguments[argument][element]
        self._apply(values, once=True)
        return values

    def __call__(self, arguments: list[Array], values: list[Any] | None = None) -> Array:
        """Return the result, a row for each element, of arguments with a row for each element.

        Args:
            arguments: arrays of (elements, designs).
            values: of `once`, if the last argument is still the same.
        """
        known = self.once(arguments) if values is None else list(values)
        for k, (argument, element) in self.inputs.items():
            known[k] = arguments[argument][element]
        self._apply(known, once=False)
        shape = (len(self.results), arguments[0].shape[1])
        result = np.empty(shape)
        for row, k in zip(result, self.results, strict=True):
            row[:] = known[k]
        return result

    def _apply(self, values: list[Any], once: bool) -> None:
        for operation in self.operations:
            if operation.once == once:
                values[operation.value] = MEANING[operation.code](*[values[k] for k in operation.of])
                # An array freed at once is used again while it is in the processor's cache.
                for k in operation.spent:
                    values[k] = None


class _Values:
    """Numbers the values of a Function one after the other, and notes the operations that make them."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.constants: dict[int, float] = {}
        self._fixed: set[int] = set()
        self._inverses: dict[int, int] = {}
        self._count = 0

    def number(self, once: bool) -> int:
        """Return the number of a new value; once: whether it is the same in every step."""
        self._count += 1
        if once:
            self._fixed.add(self._count)
        return self._count

    def constant(self, value: float) -> int:
        number = self.number(once=True)
        self.constants[number] = value
        return number

    def apply(self, code: int, of: tuple[int, ...]) -> int:
        """Return the number of an operation's result.

        A division by what is the same in every step becomes a product with its inverse, which is computed once.
        """
        if code == ca.OP_DIV and of[1] in self._fixed and of[0] not in self._fixed:
            code, of = ca.OP_MUL, (of[0], self._inverse(of[1]))
        once = all(k in self._fixed for k in of)
        value = self.number(once)
        self.operations.append(Operation(value, code, of, once))
        return value

    def _inverse(self, of: int) -> int:
        if of not in self._inverses:
            known = self.constants.get(of)
            self._inverses[of] = self.apply(ca.OP_INV, (of,)) if known is None else self.constant(1.0 / known)
        return self._inverses[of]


def _until_spent(operations: list[Operation], results: list[int]) -> tuple[Operation, ...]:
    """Return operations with the operands that no later operation needs."""
    needed, reverse = set(results), []
    for operation in reversed(operations):
        if operation.once:
            reverse.append(operation)
            continue
        reverse.append(replace(operation, spent=tuple(set(operation.of) - needed)))
        needed.update(operation.of)
    return tuple(reversed(reverse))


def _as_number(condition: Callable[..., Any]) -> Callable[..., Any]:
    """Return a condition as 0 or 1, for arithmetic."""
    return lambda *of: np.multiply(condition(*of), 1.0)


def _error_function(x: Array) -> Array:
    from scipy.special import erf  # slow to import, and rarely needed

    found: Array = erf(x)
    return found


def code_of(name: str) -> int:
    """Return CasADi's code of an operation, whose name in C is given."""
    return int(getattr(ca, f"OP_{name.upper()}"))


# Functions that CasADi, NumPy and C call by the same name: those that C's vector library has, and the others.
LIBRARY = ("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan",
           "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")  # fmt: skip
LIBRARY_OF_TWO = ("pow", "atan2", "hypot")
LANE_BY_LANE = ("floor", "ceil", "sqrt")

MEANING: dict[int, Callable[..., Any]] = {
    **{code_of(name): getattr(np, name) for name in (*LIBRARY, *LIBRARY_OF_TWO, *LANE_BY_LANE)},
    ca.OP_CONSTPOW: np.pow,
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_INV: np.reciprocal,
    ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_ERF: _error_function,
    ca.OP_LT: _as_number(np.less),
    ca.OP_LE: _as_number(np.less_equal),
    ca.OP_EQ: _as_number(np.equal),
    ca.OP_NE: _as_number(np.not_equal),
    ca.OP_NOT: _as_number(np.logical_not),
    ca.OP_AND: _as_number(np.logical_and),
    ca.OP_OR: _as_number(np.logical_or),
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition, x, 0.0),
}
"""NumPy's function for each operation, by CasADi's code."""
