"""A CasADi Function of SX on arrays: operation by operation as NumPy does it, on many designs side by side."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.batch.c_source import LANE_BY_LANE, LIBRARY, LIBRARY_OF_TWO

Array = NDArray[np.float64]


def _error_function(x: Array) -> Array:
    from scipy.special import erf  # slow to import, and rarely needed

    found: Array = erf(x)
    return found


# NumPy's function for each operation, by CasADi's code. C has most of them by the same names.
_FUNCTIONS: dict[int, Callable[..., Any]] = {
    **{code: getattr(np, name) for code, name in (LIBRARY | LIBRARY_OF_TWO | LANE_BY_LANE).items() if name != "erf"},
    ca.OP_ERF: _error_function,
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
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_NOT: np.logical_not,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition, x, 0.0),
}
_CONDITIONS = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)


class Interpreter:
    """Evaluates a Function of SX whose only result is a dense column."""

    def __init__(self, function: ca.Function) -> None:
        """Read the Function's operations; their results lie in as few places as CasADi's own do."""
        self._results, self._places = function.numel_out(), function.sz_w()
        self._operations = [
            (
                code := function.instruction_id(k),
                function.instruction_output(k),
                function.instruction_input(k),
                function.instruction_constant(k) if code == ca.OP_CONST else 0.0,
            )
            for k in range(function.n_instructions())
        ]

    def __call__(self, *arguments: Array) -> Array:
        """Return the result, a row for each element, of arguments with a row for each element."""
        work: list[Any] = [None] * self._places
        results = np.empty((self._results, arguments[0].shape[1]))
        for code, into, of, constant in self._operations:
            if code == ca.OP_INPUT:
                work[into[0]] = arguments[of[0]][of[1]]
            elif code == ca.OP_CONST:
                work[into[0]] = constant
            elif code == ca.OP_OUTPUT:
                results[into[1]] = work[of[0]]
            else:
                found = _FUNCTIONS[code](*[work[k] for k in of])
                # Conditions are numbers, for arithmetic.
                work[into[0]] = np.multiply(found, 1.0) if code in _CONDITIONS else found
        return results
