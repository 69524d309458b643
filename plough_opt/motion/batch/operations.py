"""A CasADi Function of SX as a list of operations on numbered values, to be written in C."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Operation:
    """One operation: its result is the value of a function of other values.

    Attributes:
        value: number of the result.
        code: CasADi's code of the operation.
        of: numbers of the operands.
        once: whether it depends on the last argument alone, which is the same in every step.
    """

    value: int
    code: int
    of: tuple[int, ...]
    once: bool


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
        """Return the operations of a Function of SX whose only result is a dense column."""
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
            else:
                work[into[0]] = values.apply(code, tuple(work[j] for j in of))
        return cls(tuple(values.operations), inputs, values.constants, tuple(results))


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
