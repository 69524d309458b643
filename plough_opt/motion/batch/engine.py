"""Evaluates a batch's operations: as compiled C, or by NumPy."""

import ctypes

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import Variant, library
from plough_opt.motion.batch.c_source import Kernels, c_source
from plough_opt.motion.batch.interpreter import Array, Interpreter

_FLAGS = (
    "-O3",
    "-ffp-contract=fast",
    "-fassociative-math",
    "-fno-signed-zeros",
    "-fno-trapping-math",
    "-fno-math-errno",
)
# Flags of GCC alone, which put the long run of sums and products in an order that waits less.
_ORDERED = ("-fschedule-insns", "-fsched-pressure")
# From the fastest on: with the vector functions of the GNU C library, without, and for any processor.
_VARIANTS: tuple[Variant, ...] = (
    ((*_FLAGS, *_ORDERED, "-march=native", "-DVECTOR_LIBRARY"), ("-lmvec", "-lm")),
    ((*_FLAGS, "-march=native", "-DVECTOR_LIBRARY"), ("-lmvec", "-lm")),
    ((*_FLAGS, "-march=native"), ("-lm",)),
    (_FLAGS, ("-lm",)),
)
# Designs that NumPy takes at once: enough to hide its calls, few enough for the processor's cache.
_BLOCK = 4096


class Engine:
    """Evaluates maps and integrates, here by NumPy, operation by operation.

    Arrays have a row for each element and a column for each design.
    """

    compiled = False

    def __init__(self, functions: dict[str, ca.Function], kernels: Kernels) -> None:
        """Take the maps, which CasADi evaluates, and the steps among the kernels."""
        self._functions = functions
        self._kernels = kernels

    def evaluate(self, name: str, rows: Array) -> Array:
        """Return the results of a map."""
        return np.asarray(self._functions[name].map(rows.shape[1])(rows))

    def run(self, p: Array, states: Array, order: NDArray[np.int64], most: int) -> Array:
        """Integrate designs from their states, in place; return the number of steps of each.

        Args:
            p: parameters.
            states: at the start, and afterwards at the end.
            order: the designs to integrate, in this order.
            most: limit on the number of steps.
        """
        taken = np.zeros(p.shape[1])
        with np.errstate(all="ignore"):
            for step, end in self._kernels.parts:
                interpreted = Interpreter(step)
                for first in range(0, len(order), _BLOCK):
                    which = order[first : first + _BLOCK]
                    while len(which := which[(states[0, which] < p[end, which]) & (taken[which] < most)]):
                        states[:, which] = interpreted(states[:, which], p[:, which])
                        taken[which] += 1.0
        return taken


class _Compiled(Engine):
    """The same by compiled C, a vector register of designs at a time."""

    compiled = True

    def __init__(self, functions: dict[str, ca.Function], kernels: Kernels, library: ctypes.CDLL) -> None:
        """Take the library compiled from the kernels."""
        super().__init__(functions, kernels)
        self._library = library
        library.run.restype = None

    def evaluate(self, name: str, rows: Array) -> Array:
        if name not in self._kernels.maps:
            return super().evaluate(name, rows)
        rows = np.ascontiguousarray(rows)
        results = np.empty((self._kernels.maps[name].numel_out(), rows.shape[1]))
        function = getattr(self._library, name)
        function.restype = None
        function(ctypes.c_int64(rows.shape[1]), _pointer(rows), _pointer(results))
        return results

    def run(self, p: Array, states: Array, order: NDArray[np.int64], most: int) -> Array:
        steps = np.zeros(p.shape[1])
        self._library.run(
            ctypes.c_int64(p.shape[1]),
            ctypes.c_int64(len(order)),
            _pointer(order),
            _pointer(p),
            _pointer(states),
            _pointer(steps),
            ctypes.c_double(most),
        )
        return steps


def engine_of(functions: dict[str, ca.Function], kernels: Kernels) -> Engine:
    """Return the fastest engine that this system allows.

    Args:
        functions: the maps, of a column each; those of SX are among the kernels too.
        kernels: the operations.
    """
    path = library(c_source(kernels), _VARIANTS)
    return Engine(functions, kernels) if path is None else _Compiled(functions, kernels, ctypes.CDLL(str(path)))


def _pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
