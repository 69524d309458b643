"""A design's Functions as machine code: the C that CasADi writes of them, by the system's compiler."""

from dataclasses import replace

import casadi as ca

from plough_opt.core.compiler import Variant, library
from plough_opt.design.nlp import Nlp

# The reciprocal of what divides often, as the inertia, is taken once.
_FAST = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-freciprocal-math")
_VARIANTS: tuple[Variant, ...] = ((_FAST, ("-lm",)), (("-O1",), ("-lm",)))


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
    path = library(generator.dump(), _VARIANTS)
    if path is None:
        return None
    values, slopes, roughly = (ca.external(name, str(path)) for name in functions)
    return replace(nlp, values=values, build_slopes=lambda: slopes), replace(rough, values=roughly)


def _named(function: ca.Function, name: str) -> ca.Function:
    inputs = function.mx_in()
    return ca.Function(name, inputs, function.call(inputs))
