"""A design's Functions as machine code: the C that CasADi writes of them, by the system's compiler."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from plough_opt.core.compiler import Variant, library
from plough_opt.design.nlp import PARTS, Nlp

# The reciprocal of what divides often, as the inertia, is taken once.
_FAST = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-freciprocal-math")
_VARIANTS: tuple[Variant, ...] = ((_FAST, ("-lm",)), (("-O1",), ("-lm",)))

# IPOPT asks for values and slopes of a point one after the other: the last point is remembered. It mostly asks for the
# slopes wherever it asked for values, so values come with their slopes at once, unless the point before was rejected.
_MEMORY = """
#include <string.h>
#define MORE(a, b) ((a) > (b) ? (a) : (b))
static _Thread_local struct {{ int known, unwanted; double at[{given} + 1], found[{results}]; }} last;
static const double* found_at(int slopes, const double** arg, const double** inner, double** into,
                              casadi_int* iw, double* w, int mem) {{
  static const casadi_int first[] = {{{first}}};
  double at[{given} + 1] = {{0}};
  if (arg[0]) memcpy(at, arg[0], {variables} * sizeof(double));
  if (arg[1]) memcpy(at + {variables}, arg[1], ({given} - {variables}) * sizeof(double));
  int fresh = !last.known || memcmp(at, last.at, sizeof(at));
  if (fresh || last.known < 1 + slopes) {{
    int all = slopes || (fresh && !last.unwanted);
    last.known = 0;
    inner[0] = at;
    inner[1] = at + {variables};
    for (int k = 0; k < (all ? 4 : 2); k++) into[k] = last.found + first[k];
    if (all ? own_slopes(inner, into, iw, w, mem) : own_values(inner, into, iw, w, mem)) return 0;
    memcpy(last.at, at, sizeof(at));
    last.known = 1 + all;
    last.unwanted = 1;
  }}
  if (slopes) last.unwanted = 0;
  return last.found;
}}
"""
_PART = """
CASADI_SYMBOL_EXPORT casadi_int {part}_n_in(void) {{ return 2; }}
CASADI_SYMBOL_EXPORT casadi_int {part}_n_out(void) {{ return {count}; }}
CASADI_SYMBOL_EXPORT const char* {part}_name_in(casadi_int i) {{ return i ? "p" : "x"; }}
CASADI_SYMBOL_EXPORT const char* {part}_name_out(casadi_int i) {{
  static const char* names[] = {{{names}}};
  return names[i];
}}
CASADI_SYMBOL_EXPORT const casadi_int* {part}_sparsity_in(casadi_int i) {{ return own_slopes_sparsity_in(i); }}
CASADI_SYMBOL_EXPORT const casadi_int* {part}_sparsity_out(casadi_int i) {{
  static const casadi_int which[] = {{{which}}};
  return own_slopes_sparsity_out(which[i]);
}}
CASADI_SYMBOL_EXPORT int {part}_work(casadi_int* a, casadi_int* r, casadi_int* i, casadi_int* w) {{
  casadi_int needed[4];
  if (own_values_work(needed, needed + 1, needed + 2, needed + 3) || own_slopes_work(a, r, i, w)) return 1;
  *a = 2 + MORE(*a, needed[0]);
  *r = {count} + MORE(*r, needed[1]);
  *i = MORE(*i, needed[2]);
  *w = MORE(*w, needed[3]);
  return 0;
}}
CASADI_SYMBOL_EXPORT int {part}(const double** arg, double** res, casadi_int* iw, double* w, int mem) {{
  static const casadi_int first[] = {{{first}}}, size[] = {{{size}}};
  const double* found = found_at({slopes}, arg, arg + 2, res + {count}, iw, w, mem);
  if (!found) return 1;
  for (int k = 0; k < {count}; k++) if (res[k]) memcpy(res[k], found + first[k], size[k] * sizeof(double));
  return 0;
}}
"""


def as_machine_code(nlp: Nlp, rough: Nlp) -> tuple[Nlp, Nlp] | None:
    """Return a program and a rough one with what a solve asks for most in machine code; None without a compiler.

    Second derivatives, which few solves need and which take a compiler longest, stay interpreted.

    Args:
        nlp: the program; its values and its first derivatives are compiled.
        rough: one of fewer steps; its values are compiled.
    """
    functions = {"own_values": nlp.values, "own_slopes": nlp.slopes, "rough_values": rough.values}
    generator = ca.CodeGenerator("design.c")
    for name, function in functions.items():
        generator.add(_named(function, name))
    path = library(generator.dump() + _remembering(nlp.slopes), _VARIANTS)
    if path is None:
        return None
    values, slopes, roughly = (ca.external(name, str(path)) for name in functions)
    parts = {name: ca.external(f"own_{name}", str(path)) for name in PARTS}
    return replace(nlp, values=values, first=lambda: slopes, parts=parts), replace(rough, values=roughly)


def _remembering(slopes: ca.Function) -> str:
    """Return C of `PARTS` of a program, whose slopes have these shapes, by `_MEMORY`."""
    sizes = [slopes.nnz_out(k) for k in range(slopes.n_out())]
    first = [sum(sizes[:k]) for k in range(len(sizes))]
    text = _MEMORY.format(
        variables=slopes.nnz_in(0),
        given=slopes.nnz_in(0) + slopes.nnz_in(1),
        results=sum(sizes),
        first=", ".join(map(str, first)),
    )
    for part, which in PARTS.items():
        text += _PART.format(
            part=f"own_{part}",
            slopes=int(max(which.values()) > 1),
            count=len(which),
            names=", ".join(f'"{result}"' for result in which),
            which=", ".join(map(str, which.values())),
            first=", ".join(str(first[k]) for k in which.values()),
            size=", ".join(str(sizes[k]) for k in which.values()),
        )
    return text


def _named(function: ca.Function, name: str) -> ca.Function:
    inputs = function.mx_in()
    return ca.Function(name, inputs, function.call(inputs))
