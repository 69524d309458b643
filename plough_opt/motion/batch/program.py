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
    """One operation: a value is a code applied to others.

    Attributes:
        value: number of the result.
        code: CasADi's code of the operation.
        of: numbers of the operands.
        once: whether it depends on the last argument alone, and so on nothing that changes from step to step.
        spent: operands that nothing after it needs, if it is carried out in every step.
    """

    value: int
    code: int
    of: tuple[int, ...]
    once: bool
    spent: tuple[int, ...] = ()


@dataclass(frozen=True)
class Program:
    """A Function as operations on numbered values.

    Attributes:
        operations: in order.
        inputs: number of a value -> (argument, element).
        constants: number of a value -> what it is.
        results: number of the value of each element of the result.
    """

    operations: tuple[Operation, ...]
    inputs: dict[int, tuple[int, int]]
    constants: dict[int, float]
    results: tuple[int, ...]

    @classmethod
    def of(cls, function: ca.Function) -> Program:
        """Read the operations off a Function of SX with one dense column as result.

        A division by what does not change from step to step becomes a product with its inverse.
        """
        operations: list[Operation] = []
        inputs: dict[int, tuple[int, int]] = {}
        constants: dict[int, float] = {}
        results = [-1] * function.numel_out(0)
        work: dict[int, int] = {}
        fixed: set[int] = set()
        inverses: dict[int, int] = {}
        count = 0

        def number(once: bool) -> int:
            nonlocal count
            count += 1
            if once:
                fixed.add(count)
            return count

        def apply(code: int, of: tuple[int, ...]) -> int:
            once = all(k in fixed for k in of)
            value = number(once)
            operations.append(Operation(value, code, of, once))
            return value

        def inverse(of: int) -> int:
            if of not in inverses:
                if of in constants:
                    inverses[of] = number(once=True)
                    constants[inverses[of]] = 1.0 / constants[of]
                else:
                    inverses[of] = apply(ca.OP_INV, (of,))
            return inverses[of]

        for k in range(function.n_instructions()):
            code, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
            if code == ca.OP_INPUT:
                work[into[0]] = number(once=of[0] == function.n_in() - 1)
                inputs[work[into[0]]] = (of[0], of[1])
            elif code == ca.OP_CONST:
                work[into[0]] = number(once=True)
                constants[work[into[0]]] = function.instruction_constant(k)
            elif code == ca.OP_OUTPUT:
                results[into[1]] = work[of[0]]
            elif code == ca.OP_DIV and work[of[1]] in fixed and (work[of[0]] not in fixed):
                work[into[0]] = apply(ca.OP_MUL, (work[of[0]], inverse(work[of[1]])))
            elif code in MEANING:
                work[into[0]] = apply(code, tuple(work[j] for j in of))
            else:
                raise InputError(f"a batch does not know CasADi's operation number {code}")
        return cls(_until_spent(operations, results), inputs, constants, tuple(results))

    def once(self, arguments: list[Array]) -> list[Any]:
        """Return the values that do not change from step to step, of arguments with a row for each element."""
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
            values: what `once` gave for the last argument.
        """
        known = self.once(arguments) if values is None else list(values)
        for k, (argument, element) in self.inputs.items():
            known[k] = arguments[argument][element]
        self._apply(known, once=False)
        shape = (len(self.results), arguments[0].shape[1])
        found = np.empty(shape)
        for row, k in zip(found, self.results, strict=True):
            row[:] = known[k]
        return found

    def _apply(self, values: list[Any], once: bool) -> None:
        for operation in self.operations:
            if operation.once == once:
                values[operation.value] = MEANING[operation.code](*[values[k] for k in operation.of])
                # Arrays that are given back at once are taken again while they are in the processor's cache.
                for k in operation.spent:
                    values[k] = None


def _until_spent(operations: list[Operation], results: list[int]) -> tuple[Operation, ...]:
    """Return operations that know what nothing after them needs."""
    needed, found = set(results), []
    for operation in reversed(operations):
        if operation.once:
            found.append(operation)
            continue
        found.append(replace(operation, spent=tuple(set(operation.of) - needed)))
        needed.update(operation.of)
    return tuple(reversed(found))


def _as_number(condition: Callable[..., Any]) -> Callable[..., Any]:
    """Return a condition as 0 or 1, with which one can calculate."""
    return lambda *of: np.multiply(condition(*of), 1.0)


def _error_function(x: Array) -> Array:
    from scipy.special import erf  # slow to import, and rarely needed

    found: Array = erf(x)
    return found


MEANING: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_LT: _as_number(np.less),
    ca.OP_LE: _as_number(np.less_equal),
    ca.OP_EQ: _as_number(np.equal),
    ca.OP_NE: _as_number(np.not_equal),
    ca.OP_NOT: _as_number(np.logical_not),
    ca.OP_AND: _as_number(np.logical_and),
    ca.OP_OR: _as_number(np.logical_or),
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition, x, 0.0),
    ca.OP_ERF: _error_function,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_INV: lambda x: 1.0 / x,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
    ca.OP_HYPOT: np.hypot,
}
"""What each operation does to arrays, by CasADi's code."""
