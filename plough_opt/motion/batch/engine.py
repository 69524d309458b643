"""The arithmetic of a batch: C whose operations work on a vector register of designs, or NumPy without a compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import library
from plough_opt.motion.c_source import (
    BINARY,
    COMPARISONS,
    LANE_BY_LANE,
    LIBRARY,
    LIBRARY_OF_TWO,
    SIMPLE,
    Phase,
    c_source,
    instructions,
    variants,
)

Array = NDArray[np.float64]

# Only GCC has the flags of the first attempt, which reorder the long sequences of sums and products so that the
# processor waits less.
_BATCH_VARIANTS = variants("-O3", "-fassociative-math", scheduling=("-fschedule-insns", "-fsched-pressure"))
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
        path = library(c_source(self._compiled, phases, parameters), _BATCH_VARIANTS, (*self._compiled, "run"))
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


# Python's expression for each of CasADi's frequent operations; CasADi calculates with conditions as with 0 and 1.
_EXPRESSIONS = {
    **SIMPLE,
    **{code: f"{{0}} {sign} {{1}}" for code, sign in BINARY.items()},
    **{code: f"({{0}} {sign} {{1}}) * 1.0" for code, sign in COMPARISONS.items()},
    ca.OP_NOT: "({0} == 0.0) * 1.0",
    ca.OP_AND: "logical_and({0}, {1}) * 1.0",
    ca.OP_OR: "logical_or({0}, {1}) * 1.0",
    ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "sign({0})",
    ca.OP_FMIN: "fmin({0}, {1})",
    ca.OP_FMAX: "fmax({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "where({0}, {1}, 0.0)",
    **{code: f"{name}({{0}})" for code, name in (LIBRARY | LANE_BY_LANE).items()},
    **{code: f"{name}({{0}}, {{1}})" for code, name in LIBRARY_OF_TWO.items()},
}
# Up to this many designs are evaluated one by one, because arithmetic of NumPy's numbers is many times faster than that
# of short arrays. The results are the same.
_FEW = 8


class Interpreter:
    """Evaluates a Function of SX with one result, a dense column, by Python and NumPy."""

    def __init__(self, function: ca.Function) -> None:
        """Write the Function's operations in Python; intermediate results share names as in CasADi's own evaluation."""
        self._results = function.numel_out()
        names: dict[str, Any] = {**vars(np), "erf": _error_function}
        lines = [f"def evaluate({', '.join(f'x{k}' for k in range(function.n_in()))}, results):"]
        for number, (code, into, of, constant) in enumerate(instructions(function)):
            if code == ca.OP_OUTPUT:
                line = f"results[{into[1]}] = w{of[0]}"
            elif code == ca.OP_INPUT:
                line = f"w{into[0]} = x{of[0]}[{of[1]}]"
            elif code == ca.OP_CONST:
                names[f"c{number}"] = np.float64(constant)
                line = f"w{into[0]} = c{number}"
            else:
                line = f"w{into[0]} = " + _EXPRESSIONS[code].format(*(f"w{k}" for k in of))
            lines.append(f"  {line}")
        exec("\n".join(lines), names)
        self._evaluate = names["evaluate"]

    def __call__(self, *arguments: Array) -> Array:
        """Return the result, a row for each element; arguments have a row for each element too."""
        count = arguments[0].shape[1]
        results = np.empty((self._results, count))
        if count > _FEW:
            self._evaluate(*arguments, results)
        else:
            for k in range(count):
                self._evaluate(*(argument[:, k] for argument in arguments), results[:, k])
        return results
