"""The arithmetic of a batch: compiled C, or NumPy without a compiler, for many designs side by side."""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import library
from plough_opt.motion.batch.c_source import (
    LANE_BY_LANE,
    LIBRARY,
    LIBRARY_OF_TWO,
    Phase,
    c_source,
    instructions,
    variants,
)

Array = NDArray[np.float64]

# Only GCC has the flags of the first attempt, which reorder the long sequences of sums and products so that the
# processor waits less.
_VARIANTS = variants("-O3", "-fassociative-math", scheduling=("-fschedule-insns", "-fsched-pressure"))
# Designs that NumPy evaluates at once: enough to outweigh the cost of its calls, few enough for the processor's cache.
_BLOCK = 4096


class Engine:
    """Evaluates Functions for many designs, and integrates designs by steps.

    Arrays have a row for each element and a column for each design. Functions of SX and the steps are compiled in the
    fastest variant that this system supports. Without a compiler CasADi evaluates the Functions and NumPy the steps.

    Attributes:
        compiled: whether a compiler was found.
    """

    def __init__(self, functions: dict[str, ca.Function], phases: Sequence[Phase], parameters: int) -> None:
        """Compile the steps and the Functions of SX, if there is a compiler.

        Args:
            functions: all Functions by name, each of one column.
            phases: of the motion, in their order.
            parameters: number of a step's parameters.
        """
        self._functions, self._phases = functions, phases
        self._compiled = {name: one for name, one in functions.items() if one.is_a("SXFunction")}
        path = library(c_source(self._compiled, phases, parameters), _VARIANTS, (*self._compiled, "run"))
        self.compiled = path is not None
        self._library = None if path is None else ctypes.CDLL(str(path))

    def evaluate(self, name: str, rows: Array) -> Array:
        """Return the results of a Function, a row each."""
        if self._library is None or name not in self._compiled:
            return np.asarray(self._functions[name].map(rows.shape[1])(rows))
        rows = np.ascontiguousarray(rows)
        results = np.empty((self._compiled[name].numel_out(), rows.shape[1]))
        function = getattr(self._library, name)
        function.restype = None
        function(ctypes.c_int64(rows.shape[1]), _pointer(rows), _pointer(results))
        return results

    def run(self, p: Array, states: Array, order: NDArray[np.int64], most: int) -> Array:
        """Integrate designs and return the number of steps that each took.

        Args:
            p: parameters of the steps.
            states: at the start; they are replaced by those at the end.
            order: numbers of the designs to integrate; neighbours share a vector register.
            most: limit on the number of steps.
        """
        taken = np.zeros(p.shape[1])
        if self._library is None:
            self._run_by_numpy(p, states, order, most, taken)
            return taken
        self._library.run.restype = None
        counts = ctypes.c_int64(p.shape[1]), ctypes.c_int64(len(order))
        self._library.run(*counts, *map(_pointer, (order, p, states, taken)), ctypes.c_double(most))
        return taken

    def _run_by_numpy(self, p: Array, states: Array, order: NDArray[np.int64], most: int, taken: Array) -> None:
        with np.errstate(all="ignore"):
            for step, end in self._phases:
                interpreted = Interpreter(step)
                for first in range(0, len(order), _BLOCK):
                    which = order[first : first + _BLOCK]
                    while len(which := which[(states[0, which] < p[end, which]) & (taken[which] < most)]):
                        states[:, which] = interpreted(states[:, which], p[:, which])
                        taken[which] += 1.0


def _pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _error_function(x: Array) -> Array:
    from scipy.special import erf  # imported only if needed, because that is slow

    return np.asarray(erf(x))


# NumPy's function for each of CasADi's operations. Most have the same names in C.
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
    """Evaluates a Function of SX with one result, a dense column, by NumPy."""

    def __init__(self, function: ca.Function) -> None:
        """Read the Function's operations; intermediate results share places as in CasADi's own evaluation."""
        self._results, self._places = function.numel_out(), function.sz_w()
        self._operations = [*instructions(function)]

    def __call__(self, *arguments: Array) -> Array:
        """Return the result, a row for each element; arguments have a row for each element too."""
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
                # CasADi calculates with conditions as with the numbers 0 and 1.
                work[into[0]] = np.multiply(found, 1.0) if code in _CONDITIONS else found
        return results
