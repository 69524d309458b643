"""A design's Functions as machine code: the C that CasADi writes of them, by the system's compiler."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from plough_opt.compiler import Variant, library
from plough_opt.design.nlp import PARTS, Nlp

_VARIANTS: tuple[Variant, ...] = ((("-O3", "-march=native"), ("-lm",)), (("-O1",), ("-lm",)))

# Of a Function whose results come from one integration, and for which IPOPT asks one after the other: the last point.
_MEMORY = """
#include <string.h>
static _Thread_local struct {{ int known; double at[{given} + 1], found[{results}]; }} {name}_last;
static const double* {name}_found(const double** arg, const double** inner, double** into,
                                  casadi_int* iw, double* w, int mem) {{
  static const casadi_int first[] = {{{first}}};
  double at[{given} + 1] = {{0}};
  if (arg[0]) memcpy(at, arg[0], {variables} * sizeof(double));
  if (arg[1]) memcpy(at + {variables}, arg[1], ({given} - {variables}) * sizeof(double));
  if (!{name}_last.known || memcmp(at, {name}_last.at, sizeof(at))) {{
    {name}_last.known = 0;
    inner[0] = at;
    inner[1] = at + {variables};
    for (int k = 0; k < {count}; k++) into[k] = {name}_last.found + first[k];
    if ({name}(inner, into, iw, w, mem)) return 0;
    memcpy({name}_last.at, at, sizeof(at));
    {name}_last.known = 1;
  }}
  return {name}_last.found;
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
CASADI_SYMBOL_EXPORT const casadi_int* {part}_sparsity_in(casadi_int i) {{ return {name}_sparsity_in(i); }}
CASADI_SYMBOL_EXPORT const casadi_int* {part}_sparsity_out(casadi_int i) {{
  static const casadi_int which[] = {{{which}}};
  return {name}_sparsity_out(which[i]);
}}
CASADI_SYMBOL_EXPORT int {part}_work(casadi_int* a, casadi_int* r, casadi_int* i, casadi_int* w) {{
  int failed = {name}_work(a, r, i, w);
  *a += 2;
  *r += {count};
  return failed;
}}
CASADI_SYMBOL_EXPORT int {part}(const double** arg, double** res, casadi_int* iw, double* w, int mem) {{
  static const casadi_int first[] = {{{first}}}, size[] = {{{size}}};
  const double* found = {name}_found(arg, arg + 2, res + {count}, iw, w, mem);
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
    source = [generator.dump(), _remembering("own_values", nlp.values, ("f", "g"))]
    source.append(_remembering("own_slopes", nlp.slopes, ("grad_f", "jac_g")))
    path = library("\n".join(source), _VARIANTS)
    if path is None:
        return None
    values, slopes, roughly = (ca.external(name, str(path)) for name in functions)
    parts = {name: ca.external(f"own_{name}", str(path)) for name in PARTS}
    return replace(nlp, values=values, first=lambda: slopes, parts=parts), replace(rough, values=roughly)


def _remembering(name: str, function: ca.Function, parts: Sequence[str]) -> str:
    """Return C of `PARTS` of a Function, which is evaluated once at a point."""
    sizes = [function.nnz_out(k) for k in range(function.n_out())]
    first = [sum(sizes[:k]) for k in range(len(sizes))]
    text = _MEMORY.format(
        name=name,
        variables=function.nnz_in(0),
        given=function.nnz_in(0) + function.nnz_in(1),
        results=sum(sizes),
        count=len(sizes),
        first=", ".join(map(str, first)),
    )
    for part in parts:
        which = PARTS[part]
        text += _PART.format(
            name=name,
            part=f"own_{part}",
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
