"""C source of CasADi Functions in which every operation works on a vector register of designs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import casadi as ca

from plough_opt.core.compiler import Variant
from plough_opt.core.errors import InputError

Phase = tuple[ca.Function, int]
"""A phase of a motion: (Function of SX for one step, position of the phase's end time among its parameters)."""

# CasADi's operation -> its sign or its text in C and in Python.
BINARY = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
COMPARISONS = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_LOGICAL = {ca.OP_AND: "&", ca.OP_OR: "|"}
SIMPLE = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
}


def _named(names: str) -> dict[int, str]:
    """Return CasADi's operation -> C function, for functions that have the same name in both."""
    return {int(getattr(ca, f"OP_{name.upper()}")): name for name in names.split()}


# CasADi's operation -> C function: in the vector library with one argument, with two, and missing from it. `vectors.c`
# has a line for each.
LIBRARY = _named("exp expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh erf")
LIBRARY_OF_TWO = {ca.OP_CONSTPOW: "pow"} | _named("pow atan2 hypot")
LANE_BY_LANE = _named("floor ceil sqrt")
# Operation -> function that `vectors.c` defines.
_OWN = {ca.OP_FABS: "v_fabs", ca.OP_SIGN: "v_sign", ca.OP_FMIN: "v_min", ca.OP_FMAX: "v_max"}

_MAP = """
/* Evaluates a function. Arrays have a column for each of n designs. */
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
/* Integrates designs in the given order, LANES at a time. Arrays have a column for each of n designs. */
void run(int64_t n, int64_t count, const int64_t *order, const double *in, double *states, double *steps,
         double most) {{
  for (int64_t first = 0; first < count; first += LANES) {{
    int64_t which[LANES];
    choose(count, order, first, which);
    V p[{parameters}], x[{state}], y[{state}], taken = {{0}};
    for (int j = 0; j < {parameters}; j++) p[j] = gather(in + j * n, which);
    for (int j = 0; j < {state}; j++) x[j] = gather(states + j * n, which);
{phases}
    for (int k = 0; k < LANES && first + k < count; k++) {{
      for (int j = 0; j < {state}; j++) states[j * n + which[k]] = x[j][k];
      steps[which[k]] = taken[k];
    }}
  }}
}}
"""

_PHASE = """    {{
{once}
    for (;;) {{
      const M open = (x[0] < p[{end}]) & (taken < most);
      if (!any(open)) break;
{each}
      for (int j = 0; j < {state}; j++) x[j] = v_pick(open, y[j], x[j]);
      taken += v_one(open);
    }}
    }}"""


def variants(*flags: str, scheduling: tuple[str, ...] = ()) -> tuple[Variant, ...]:
    """Return how to compile: with the vector functions of the GNU C library, without them, and for any processor.

    Args:
        flags: flags of every attempt, besides those that let floating-point operations be reordered.
        scheduling: flags of a first attempt, which not every compiler has.
    """
    flags = (*flags, "-ffp-contract=fast", "-fno-signed-zeros", "-fno-trapping-math", "-fno-math-errno")
    own, vector = (*flags, "-march=native"), (*flags, "-march=native", "-DVECTOR_LIBRARY")
    first = [(*vector, *scheduling)] if scheduling else []
    return (*((one, ("-lmvec", "-lm")) for one in (*first, vector)), (own, ("-lm",)), (flags, ("-lm",)))


def instructions(function: ca.Function) -> Iterator[tuple[int, list[int], list[int], float]]:
    """Yield each operation of a Function of SX: its code, the places of results and operands, and its constant."""
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        constant = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        yield code, function.instruction_output(k), function.instruction_input(k), constant


def name_of(code: int) -> str:
    """Return CasADi's name of an operation, such as "floor"."""
    return next(name[3:].lower() for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)


def c_source(maps: Mapping[str, ca.Function], phases: Sequence[Phase], parameters: int) -> str:
    """Return the C source of a library with a function for each map and the function ``run``, which takes all steps.

    Args:
        maps: Functions of SX of one argument, by name.
        phases: of the motion, in their order.
        parameters: number of a step's parameters.

    Raises:
        InputError: an operation without a vector form.
    """
    lines = [c_file("vectors.c")]
    for name, one in maps.items():
        text = Statements(one, ("x",))
        body = "\n".join([*text.once, *text.each])
        lines.append(_MAP.format(name=name, inputs=one.numel_in(0), results=one.numel_out(), body=body))
    state = phases[0][0].numel_out()
    loops = []
    for step, end in phases:
        text = Statements(step, ("x", "p"))
        once, each = "\n".join(text.once), "\n".join(text.each)
        loops.append(_PHASE.format(once=once, each=each, end=end, state=state))
    lines.append(_RUN.format(parameters=parameters, state=state, phases="\n".join(loops)))
    return "\n".join(lines)


@lru_cache(maxsize=2)
def c_file(name: str) -> str:
    """Return the text of a C file in this folder."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class _Value:
    """A value in C: a vector of doubles, or a mask, whose bits are all 0 or all 1 in each lane.

    Attributes:
        text: its name, or the number if it is a constant.
        once: whether it depends on the last argument alone, which is the same in every step.
        constant: the number if it is a constant, else None.
        is_mask: whether it is a condition.
    """

    text: str
    once: bool = True
    constant: float | None = None
    is_mask: bool = False

    @classmethod
    def of(cls, constant: float) -> _Value:
        """Return a constant."""
        text = repr(constant).replace("inf", "INFINITY")
        return cls(f"({text})" if constant < 0.0 else text, constant=constant)

    @property
    def number(self) -> str:
        """Text for use as an operand of arithmetic."""
        return f"v_one({self.text})" if self.is_mask else self.text

    @property
    def vector(self) -> str:
        """Text for use as an argument of a vector function."""
        return self.number if self.constant is None else f"((V){{0}} + {self.text})"

    @property
    def mask(self) -> str:
        """Text for use as a condition."""
        return self.text if self.is_mask else f"({self.vector} != 0.0)"


class Statements:
    """The C statements of a Function of SX with one result, a dense column.

    Attributes:
        once: statements to run once before all steps.
        each: statements to run in every step; the last ones assign the results.
    """

    def __init__(self, function: ca.Function, arrays: tuple[str, ...]) -> None:
        """Write the statements.

        Args:
            function: the Function.
            arrays: names of the C arrays that hold its arguments.

        Raises:
            InputError: an operation without a vector form.
        """
        self.once: list[str] = []
        self.each: list[str] = []
        self._inverses: dict[str, _Value] = {}
        work: dict[int, _Value] = {}
        results = []
        for code, into, of, constant in instructions(function):
            if code == ca.OP_INPUT:
                work[into[0]] = _Value(f"{arrays[of[0]]}[{of[1]}]", once=of[0] == function.n_in() - 1)
            elif code == ca.OP_CONST:
                work[into[0]] = _Value.of(constant)
            elif code == ca.OP_OUTPUT:
                results.append(f"y[{into[1]}] = (V){{0}} + {work[of[0]].number};")
            else:
                work[into[0]] = self._apply(code, [work[j] for j in of])
        self.each += results

    def _apply(self, code: int, of: list[_Value]) -> _Value:
        """Add the statement of an operation and return its result.

        A division by a value that is the same in every step becomes a product with the inverse, computed once.
        """
        if code == ca.OP_DIV and of[1].once and not of[0].once:
            code, of = ca.OP_MUL, [of[0], self._inverse(of[1])]
        is_mask = code in COMPARISONS or code in _LOGICAL or code == ca.OP_NOT
        name = f"a{len(self.once) + len(self.each)}"
        value = _Value(name, all(each.once for each in of), is_mask=is_mask)
        lines = self.once if value.once else self.each
        lines.append(f"const {'M' if is_mask else 'V'} {name} = {_expression(code, of)};")
        return value

    def _inverse(self, of: _Value) -> _Value:
        if of.text not in self._inverses:
            self._inverses[of.text] = (
                self._apply(ca.OP_INV, [of]) if of.constant is None else _Value.of(1.0 / of.constant)
            )
        return self._inverses[of.text]


def _expression(code: int, of: list[_Value]) -> str:
    """Return an operation in C.

    Raises:
        InputError: the operation has no vector form.
    """
    if code in BINARY:
        return f"{of[0].vector} {BINARY[code]} {of[1].number}"
    if code in SIMPLE:
        return SIMPLE[code].format(of[0].vector)
    if code in (ca.OP_EQ, ca.OP_NE) and all(each.is_mask for each in of):
        both = f"{of[0].text} ^ {of[1].text}"
        return both if code == ca.OP_NE else f"~({both})"
    if code in COMPARISONS:
        return f"{of[0].vector} {COMPARISONS[code]} {of[1].vector}"
    if code in _LOGICAL:
        return f"{of[0].mask} {_LOGICAL[code]} {of[1].mask}"
    if code == ca.OP_NOT:
        return f"~{of[0].mask}"
    if code == ca.OP_IF_ELSE_ZERO:
        return f"(V)((M){of[1].vector} & {of[0].mask})"
    functions = LIBRARY | LIBRARY_OF_TWO | LANE_BY_LANE
    if code not in _OWN and code not in functions:
        raise InputError(f"a batch cannot evaluate the operation '{name_of(code)}': use po.simulate for each design")
    return f"{_OWN.get(code) or f'v_{functions[code]}'}({', '.join(each.vector for each in of)})"
