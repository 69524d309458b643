"""C source of lists of operations: each on as many designs at once as a vector register holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from plough_opt.core.errors import InputError
from plough_opt.motion.batch.operations import OperationList

_BINARY = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARISONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_LOGICAL = {ca.OP_AND: "&", ca.OP_OR: "|"}
_SIMPLE = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
}


def _named(names: str) -> dict[int, str]:
    """Return functions of C by CasADi's code of each, which has the same name."""
    return {int(getattr(ca, f"OP_{name.upper()}")): name for name in names.split()}


# C's name of each function that the vector library has, of one argument and of two, and of those that it lacks.
LIBRARY = _named("exp expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh erf")
LIBRARY_OF_TWO = {ca.OP_CONSTPOW: "pow"} | _named("pow atan2 hypot")
LANE_BY_LANE = _named("floor ceil sqrt")
_OWN = {ca.OP_FABS: "v_fabs", ca.OP_SIGN: "v_sign", ca.OP_FMIN: "v_min", ca.OP_FMAX: "v_max"}

_HEAD = """
#include <math.h>
#include <stdint.h>
#include <string.h>

#ifndef REGISTERS
#define REGISTERS 1
#endif
#if defined(__AVX512F__)
#define WIDTH 8
#define LETTER e
#elif defined(__AVX2__)
#define WIDTH 4
#define LETTER d
#else
#define WIDTH 2
#define LETTER b
#endif
#define LANES (WIDTH * REGISTERS)
typedef double V __attribute__((vector_size(8 * LANES), aligned(8 * LANES)));
typedef int64_t M __attribute__((vector_size(8 * LANES), aligned(8 * LANES)));
typedef double R __attribute__((vector_size(8 * WIDTH)));

static inline V v_pick(M m, V a, V b) { return (V)(((M)a & m) | ((M)b & ~m)); }
static inline V v_min(V a, V b) { return v_pick((a <= b) | (b != b), a, b); }
static inline V v_max(V a, V b) { return v_pick((a >= b) | (b != b), a, b); }
static inline V v_fabs(V a) { return (V)((M)a & INT64_MAX); }
static inline V v_one(M m) { const V one = {0}; return (V)((M)(one + 1.0) & m); }
static inline V v_sign(V a) { return v_one(a > 0.0) - v_one(a < 0.0); }
static inline int any(M m) { int64_t all = 0; for (int k = 0; k < LANES; k++) all |= m[k]; return all != 0; }
#define EACH(NAME) \\
  static inline V v_##NAME(V a) { V r; for (int k = 0; k < LANES; k++) r[k] = NAME(a[k]); return r; }
#define EACH_OF_TWO(NAME) \\
  static inline V v_##NAME(V a, V b) { V r; for (int k = 0; k < LANES; k++) r[k] = NAME(a[k], b[k]); return r; }
#ifdef VECTOR_LIBRARY
#define JOIN(A, B, C, D) A##B##N##C##D
#define SYMBOL(LETTER, WIDTH, MANGLED) JOIN(_ZGV, LETTER, WIDTH, MANGLED)
typedef union { V all; R part[REGISTERS]; } Parts;
#define LIBRARY(NAME) \\
  R SYMBOL(LETTER, WIDTH, v_##NAME)(R); \\
  static inline V v_##NAME(V a) { Parts x = {a}; \\
    for (int k = 0; k < REGISTERS; k++) x.part[k] = SYMBOL(LETTER, WIDTH, v_##NAME)(x.part[k]); return x.all; }
#define LIBRARY_OF_TWO(NAME) \\
  R SYMBOL(LETTER, WIDTH, vv_##NAME)(R, R); \\
  static inline V v_##NAME(V a, V b) { Parts x = {a}, y = {b}; \\
    for (int k = 0; k < REGISTERS; k++) x.part[k] = SYMBOL(LETTER, WIDTH, vv_##NAME)(x.part[k], y.part[k]); \\
    return x.all; }
#else
#define LIBRARY(NAME) EACH(NAME)
#define LIBRARY_OF_TWO(NAME) EACH_OF_TWO(NAME)
#endif

static inline V gather(const double *from, const int64_t *which) {
  V r; for (int k = 0; k < LANES; k++) r[k] = from[which[k]]; return r; }
static inline void choose(int64_t n, const int64_t *order, int64_t first, int64_t *which) {
  for (int k = 0; k < LANES; k++) which[k] = order[first + k < n ? first + k : n - 1]; }
"""

_MAP = """
/* Rows of results from rows of arguments, each of n designs. */
void {name}(int64_t n, const double *in, double *out) {{
  for (int64_t first = 0; first < n; first += LANES) {{
    const int64_t many = n - first < LANES ? n - first : LANES;
    V x[{inputs}], y[{results}];
    for (int j = 0; j < {inputs}; j++) for (int k = 0; k < LANES; k++)
      x[j][k] = in[j * n + first + (k < many ? k : many - 1)];
{body}
    for (int j = 0; j < {results}; j++) for (int k = 0; k < many; k++) out[j * n + first + k] = y[j][k];
  }}
}}
"""

_RUN = """
/* Integrates designs in an order, in groups of LANES, from and into the state x; rows of n designs. */
void run(int64_t n, int64_t count, const int64_t *order, const double *in, double *states, double *steps,
         double most) {{
  for (int64_t first = 0; first < count; first += LANES) {{
    int64_t which[LANES];
    choose(count, order, first, which);
    V p[{parameters}], x[{state}], y[{state}], taken = {{0}};
    for (int j = 0; j < {parameters}; j++) p[j] = gather(in + j * n, which);
    for (int j = 0; j < {state}; j++) x[j] = gather(states + j * n, which);
{parts}
    for (int k = 0; k < LANES && first + k < count; k++) {{
      for (int j = 0; j < {state}; j++) states[j * n + which[k]] = x[j][k];
      steps[which[k]] = taken[k];
    }}
  }}
}}
"""

_PART = """    {{
{once}
    for (;;) {{
      const M open = (x[0] < p[{end}]) & (taken < most);
      if (!any(open)) break;
{each}
      for (int j = 0; j < {state}; j++) x[j] = v_pick(open, y[j], x[j]);
      taken += v_one(open);
    }}
    }}"""


def _in_c(code: int) -> str:
    """Return C's name of a function.

    Raises:
        InputError: an operation that has no vector form.
    """
    functions = LIBRARY | LIBRARY_OF_TWO | LANE_BY_LANE
    if code not in functions:
        raise InputError(f"a batch cannot do CasADi's operation number {code}")
    return functions[code]


@dataclass(frozen=True)
class Kernels:
    """The operations that a batch compiles.

    Attributes:
        maps: Functions of SX of one argument, by name.
        parts: of the motion, in time: (one step, of SX, position in the parameters of the time at which the part ends).
        parameters: number of a step's parameters.
    """

    maps: dict[str, ca.Function]
    parts: tuple[tuple[ca.Function, int], ...]
    parameters: int


def c_source(kernels: Kernels) -> str:
    """Return the C source of a library with a function for each map, and one that runs all steps.

    Raises:
        InputError: an operation that has no vector form.
    """
    maps = {name: OperationList.of(one) for name, one in kernels.maps.items()}
    steps = [(OperationList.of(step), end) for step, end in kernels.parts]
    lines = head([*maps.values(), *(step for step, _ in steps)])
    lines.append("int64_t lanes(void) { return LANES; }")
    for name, one in maps.items():
        inputs = 1 + max((element for _, element in one.inputs.values()), default=0)
        body = Statements(one, ("x",)).body(None)
        lines.append(_MAP.format(name=name, inputs=inputs, results=len(one.results), body=body))
    state = len(steps[0][0].results)
    parts = []
    for step, end in steps:
        text = Statements(step, ("x", "p"))
        parts.append(_PART.format(once=text.body(True), each=text.body(False), end=end, state=state))
    lines.append(_RUN.format(parameters=kernels.parameters, state=state, parts="\n".join(parts)))
    return "\n".join(lines)


def head(lists: Sequence[OperationList]) -> list[str]:
    """Return the C types and functions that the statements of some lists use."""
    codes = {operation.code for one in lists for operation in one.operations}
    lines = [_HEAD]
    lines += [f"EACH({name})" for code, name in LANE_BY_LANE.items() if code in codes]
    lines += [f"LIBRARY({name})" for code, name in LIBRARY.items() if code in codes]
    lines += [f"LIBRARY_OF_TWO({name})" for name in sorted({LIBRARY_OF_TWO[c] for c in codes & set(LIBRARY_OF_TWO)})]
    return lines


class Statements:
    """A list of operations as C statements.

    Values are vectors of doubles, and conditions vectors of masks, whose bits are all 0 or all 1.
    """

    def __init__(self, operations: OperationList, arrays: tuple[str, ...]) -> None:
        """Take the operations, and the names of the arrays that hold the arguments."""
        self._list = operations
        self._arrays = arrays
        self._masks: set[int] = set()

    def body(self, once: bool | None) -> str:
        """Return the statements that run once before all steps (True), in every step (False), or all (None)."""
        lines = []
        for operation in self._list.operations:
            text = self._expression(operation.code, operation.of)
            if self._is_mask(operation.code):
                self._masks.add(operation.value)
            if once is None or operation.once == once:
                kind = "M" if operation.value in self._masks else "V"
                lines.append(f"const {kind} a{operation.value} = {text};")
        if not once:
            lines += [f"y[{j}] = (V){{0}} + {self._number(k)};" for j, k in enumerate(self._list.results)]
        return "\n".join(lines)

    @staticmethod
    def _is_mask(code: int) -> bool:
        return code in _COMPARISONS or code in _LOGICAL or code == ca.OP_NOT

    def _number(self, k: int) -> str:
        """Return a value as an operand of arithmetic."""
        if k in self._list.constants:
            value = self._list.constants[k]
            if math.isinf(value):
                return "INFINITY" if value > 0.0 else "(-INFINITY)"
            return f"({value!r})" if value < 0.0 else repr(value)
        if k in self._list.inputs:
            argument, element = self._list.inputs[k]
            return f"{self._arrays[argument]}[{element}]"
        return f"v_one(a{k})" if k in self._masks else f"a{k}"

    def _vector(self, k: int) -> str:
        """Return a value as an argument of a function of vectors."""
        text = self._number(k)
        return f"((V){{0}} + {text})" if k in self._list.constants else text

    def _mask(self, k: int) -> str:
        """Return a value as a condition."""
        return f"a{k}" if k in self._masks else f"({self._vector(k)} != 0.0)"

    def _expression(self, code: int, of: tuple[int, ...]) -> str:
        if code in _BINARY:
            left, right = (self._vector(of[0]), self._number(of[1]))
            return f"{left} {_BINARY[code]} {right}"
        if code in _SIMPLE:
            return _SIMPLE[code].format(self._vector(of[0]))
        if code in (ca.OP_EQ, ca.OP_NE) and all(k in self._masks for k in of):
            both = f"a{of[0]} ^ a{of[1]}"
            return both if code == ca.OP_NE else f"~({both})"
        if code in _COMPARISONS:
            return f"{self._vector(of[0])} {_COMPARISONS[code]} {self._vector(of[1])}"
        if code in _LOGICAL:
            return f"{self._mask(of[0])} {_LOGICAL[code]} {self._mask(of[1])}"
        if code == ca.OP_NOT:
            return f"~{self._mask(of[0])}"
        if code == ca.OP_IF_ELSE_ZERO:
            return f"(V)((M){self._vector(of[1])} & {self._mask(of[0])})"
        name = _OWN.get(code) or f"v_{_in_c(code)}"
        return f"{name}({', '.join(self._vector(k) for k in of)})"
