"""Runs of order 8 in machine code: the same operations as in CasADi's loop, built by the system's compiler."""

import ctypes
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import Variant, library
from plough_opt.motion.equation import signals, start_state
from plough_opt.motion.runge_kutta import step
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline, readings

Array = NDArray[np.float64]

# Without fused multiply-add the results are equal to those of CasADi's interpreter.
_FLAGS = ("-O2", "-ffp-contract=off")
_VARIANTS: tuple[Variant, ...] = (((*_FLAGS, "-fno-semantic-interposition"), ("-lm",)), (_FLAGS, ("-lm",)))

_SOURCE = """
#include <stdlib.h>
#include <string.h>
enum {{ SIGNALS = {count}, SQUARED = {squared}, MOMENTS = SIGNALS + SQUARED, DURATION = {given} }};

/* Interpolates the outputs. Each is read from `count` ends of steps, from `first` on. Each end has four weights: of w
   and of its rate in w, of w and of its rate in the rate. */
static double *read(long long outputs, const long long *first, const long long *count, const double *weight,
                    const double *x, double duration, double *out) {{
  for (long long o = 0; o < outputs; o++) {{
    double sum[4] = {{0.0, 0.0, 0.0, 0.0}};
    const double *end = x + 2 * first[o];
    for (long long n = count[o]; n > 0; n--, end += 2, weight += 4)
      for (int j = 0; j < 4; j++) sum[j] += end[j % 2] * weight[j];
    *out++ = sum[0] + duration * sum[1];
    *out++ = sum[2] / duration + sum[3];
  }}
  return out;
}}

static void average(long long steps, const double *span, const double *moments, double *mean, double *variance) {{
  memset(mean, 0, SIGNALS * sizeof(double));
  memset(variance, 0, SQUARED * sizeof(double));
  for (long long k = 0; k < steps; k++)
    for (int j = 0; j < SIGNALS; j++) mean[j] += moments[MOMENTS * k + j] * span[2 * k + 1];
  for (long long k = 0; k < steps; k++)
    for (int j = 0; j < SQUARED; j++) {{
      const double drift = moments[MOMENTS * k + j] - mean[j];
      variance[j] += (moments[MOMENTS * k + SIGNALS + j] + drift * drift) * span[2 * k + 1];
    }}
}}

/* Writes the states at the outputs, the means and the mean squares about them. Returns 1 if out of memory. */
CASADI_SYMBOL_EXPORT int motion_follow(long long steps, long long outputs, const double *span, const long long *first,
    const long long *count, const double *weight, const double *p, double *out) {{
  double *x = malloc((2 * (steps + 1) + MOMENTS * steps) * sizeof(double));
  if (!x) return 1;
  double *moments = x + 2 * (steps + 1), *into[{sz_res}] = {{x}}, work[{sz_w}];
  const double *given[{sz_arg}] = {{p}};
  casadi_int places[{sz_iw}];
  motion_start(given, into, places, work, 0);
  for (long long k = 0; k < steps; k++) {{
    given[0] = x + 2 * k;
    given[1] = span + 2 * k;
    given[2] = p;
    into[0] = x + 2 * (k + 1);
    into[1] = moments + MOMENTS * k;
    motion_step(given, into, places, work, 0);
  }}
  out = read(outputs, first, count, weight, x, p[DURATION], out);
  average(steps, span, moments, out, out + SIGNALS);
  free(x);
  return 0;
}}
"""


class CompiledSteps:
    """Integration of a structure's equation by steps of order 8 in machine code."""

    def __init__(self, structure: Structure, loaded: ctypes.CDLL) -> None:
        """Wrap a loaded library that was compiled for the structure."""
        self._observed = signals(structure)
        self._follow = loaded.motion_follow
        self._follow.argtypes = [*[ctypes.c_longlong] * 2, *[ctypes.c_void_p] * 6]

    def __call__(self, timeline: Timeline, p: list[float]) -> tuple[Array, Array, Array] | None:
        """Return the states at the outputs (a row each), means and mean squares; None if any is not finite.

        Args:
            timeline: steps and outputs, not aligned.
            p: the equation's parameters with the duration last.

        Raises:
            MemoryError: there is not enough memory for the steps.
        """
        (arrays, addresses), given = _times(timeline), np.array(p)
        end = 2 * len(timeline.output_fractions)
        found = np.empty(end + self._observed.count + self._observed.squared)
        if self._follow(len(arrays[0]), end // 2, *addresses, given.ctypes.data, found.ctypes.data):
            raise MemoryError(f"not enough memory for the states at the ends of {timeline.steps} steps")
        if not np.isfinite(found).all():
            return None
        averages = end + self._observed.count
        return found[:end].reshape(-1, 2), found[end:averages], found[averages:]


@lru_cache(maxsize=64)
def compiled_steps(structure: Structure) -> CompiledSteps | None:
    """Return a structure's steps in machine code, compiled or from the user's cache; None without a compiler."""
    path = library(_source(structure), _VARIANTS, ("motion_follow",))
    return None if path is None else CompiledSteps(structure, ctypes.CDLL(str(path)))


def _source(structure: Structure) -> str:
    one, observed = step(structure), signals(structure)
    p, known = observed.symbols(ca.SX)
    first = ca.densify(ca.SX(start_state(structure, known)))
    functions = (
        ca.Function("motion_start", [p], [first]),
        ca.Function("motion_step", one.sx_in(), one.call(one.sx_in())),
    )
    generator = ca.CodeGenerator("motion.c")
    for function in functions:
        generator.add(function)
    # Work memory for functions that an own effect calls, such as a lookup table.
    sizes = {size: max(1, *(getattr(f, size)() for f in functions)) for size in ("sz_arg", "sz_res", "sz_iw", "sz_w")}
    own = _SOURCE.format(count=observed.count, squared=observed.squared, given=len(observed.parameters), **sizes)
    return str(generator.dump()) + own


@lru_cache(maxsize=256)
def _times(timeline: Timeline) -> tuple[list[NDArray[Any]], list[int]]:
    """Return the arrays of a timeline for C, and their addresses.

    They hold the spans of the steps and, for each output, the first end that it is read from, the number of ends, and
    their weights.
    """
    read, nodes = readings(timeline), timeline.nodes
    pattern = read.w_by_w.sparsity()
    # The ends from which an output is read are consecutive.
    starts = np.array(pattern.colind(), dtype=np.int64)
    arrays = [
        np.column_stack([nodes[:-1], np.diff(nodes)]),
        np.array(pattern.row(), dtype=np.int64)[starts[:-1]],
        np.diff(starts),
        np.column_stack([part.nonzeros() for part in read]),
    ]
    return arrays, [array.ctypes.data for array in arrays]
