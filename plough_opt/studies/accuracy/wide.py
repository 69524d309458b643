"""The machine's widest floats, and CasADi's graphs of scalars computed in them."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeAlias

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError

WIDE: Final = np.longdouble
"""The widest floats of the machine: 64 bits of mantissa on x86, elsewhere often the 53 of a double."""

EPS: Final = np.finfo(WIDE).eps
"""Rounding of `WIDE`."""

WIDER: Final = bool(np.finfo(WIDE).eps < np.finfo(np.float64).eps)
"""Whether the machine has floats wider than a double."""

PI: Final = WIDE("3.14159265358979323846264338327950288419716939937511")

Wide: TypeAlias = Any
"""A number of `WIDE`, or an array of them."""

_OPERATIONS: Final[dict[int, Callable[..., Wide]]] = {
    ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide, ca.OP_NEG: np.negative,
    ca.OP_SQ: np.square, ca.OP_TWICE: lambda x: x + x, ca.OP_INV: lambda x: 1 / x, ca.OP_SQRT: np.sqrt,
    ca.OP_POW: np.power, ca.OP_CONSTPOW: np.power, ca.OP_EXP: np.exp, ca.OP_LOG: np.log, ca.OP_EXPM1: np.expm1,
    ca.OP_LOG1P: np.log1p, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan, ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan, ca.OP_ATAN2: np.arctan2, ca.OP_SINH: np.sinh, ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh, ca.OP_ASINH: np.arcsinh, ca.OP_FABS: np.abs, ca.OP_SIGN: np.sign, ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum, ca.OP_LT: np.less, ca.OP_LE: np.less_equal, ca.OP_EQ: np.equal, ca.OP_NE: np.not_equal,
    ca.OP_NOT: np.logical_not, ca.OP_AND: np.logical_and, ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, value: np.where(condition, value, WIDE(0)),
}  # fmt: skip


WideGraph: TypeAlias = Callable[..., list[Wide]]
"""Takes for each argument its elements, numbers or arrays over places; returns each result, a row for each element."""


def in_wide_floats(arguments: Sequence[ca.SX], results: Sequence[Any]) -> WideGraph:
    """Return a graph of scalars as a function that computes in the widest floats.

    Raises:
        InputError: an operation that has no counterpart here, such as a table's.
    """
    graph = ca.Function("graph", list(arguments), [ca.densify(ca.SX(result)) for result in results])
    steps = []
    for k in range(graph.n_instructions()):
        kind = graph.instruction_id(k)
        if kind not in _OPERATIONS and kind not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT):
            raise InputError("an own effect holds a function that takes no wide floats")
        constant = WIDE(graph.instruction_constant(k)) if kind == ca.OP_CONST else None
        steps.append((kind, graph.instruction_input(k), graph.instruction_output(k), constant))
    rows = [graph.nnz_out(k) for k in range(graph.n_out())]

    def evaluate(*given: Iterable[Wide]) -> list[Wide]:
        elements = [list(argument) for argument in given]
        places = max(np.size(element) for argument in elements for element in argument)
        work: list[Wide] = [None] * graph.sz_w()
        found = [np.zeros((count, places), WIDE) for count in rows]
        for kind, sources, targets, constant in steps:
            if kind == ca.OP_CONST:
                work[targets[0]] = constant
            elif kind == ca.OP_INPUT:
                work[targets[0]] = elements[sources[0]][sources[1]]
            elif kind == ca.OP_OUTPUT:
                found[targets[0]][targets[1]] = work[sources[0]]
            else:
                work[targets[0]] = _OPERATIONS[kind](*(work[source] for source in sources))
        return found

    return evaluate
