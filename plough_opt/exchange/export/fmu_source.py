"""C source of an exported share: its numbers, its equations, and the functions of the FMI around them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from importlib.resources import files

import casadi as ca

from plough_opt.exchange.export.fmu_equations import Model
from plough_opt.exchange.export.fmu_variables import Variable


def c_source(model: Model, *, pushes: bool, by_speed: bool) -> tuple[str, str]:
    """Return the C source of an FMU, and the token that belongs to it.

    Args:
        model: the equations.
        pushes: whether the soil would push a share that retreats; the FMU warns if it happens.
        by_speed: whether the strut's speed is the input.
    """
    folder = files("plough_opt.exchange.export")
    functions = (folder.joinpath(name).read_text(encoding="utf-8") for name in ("fmu_runtime.c", "fmu_optional.c"))
    parts = (_numbers(model, pushes, by_speed), _equations(model.functions), *functions)
    # Names and units stand in the description: two FMUs that compute the same may share a token.
    token = hashlib.sha256("".join(parts).encode()).hexdigest()[:32]
    return "\n".join((f'#define TOKEN "{token}"', *parts)), token


def _numbers(model: Model, pushes: bool, by_speed: bool) -> str:
    """Return the numbers of variables, and their domains, starts and orders of magnitude."""
    names = model.names
    counts = {
        "NX": len(names.states),
        "NY": len(names.outputs),
        "NZ": len(names.indicators),
        "NC": len(model.calculated),
        "NU": len(names.inputs),
        "NP": len(model.parameters),
        "ND": len(names.discrete),
        "NQ": model.functions["derive"].numel_out(0),
        "NW": max(function.sz_w() for function in model.functions.values()),
        "PUSHES": int(pushes),
        "NEEDS_SPEED": int(by_speed),
        "HAS_DERIVATIVES": int("forward_derive" in model.functions),
    }
    given = (*names.inputs, *model.parameters)
    limits = ",\n".join(f"  {_limits(variable)}" for variable in model.parameters)
    return "\n".join(
        (
            *(f"#define {name} {count}" for name, count in counts.items()),
            "#include <math.h>",
            "typedef struct { const char *name; double low, high; int above, below; } Limits;",
            f"static const Limits limits[] = {{\n{limits}}};",
            f"static const double starts[] = {{{_row(variable.start for variable in given)}}};",
            f"static const double nominals[] = {{{_row(variable.magnitude for variable in names.states)}}};",
        )
    )


def _row(values: Iterable[float]) -> str:
    return ", ".join(map(_number, values))


def _number(value: float) -> str:
    """Return a number as C writes it."""
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(float(value))


def _limits(variable: Variable) -> str:
    numbers = f"{_number(variable.low)}, {_number(variable.high)}"
    return f'{{"{variable.name}", {numbers}, {int(variable.above)}, {int(variable.below)}}}'


def _equations(functions: dict[str, ca.Function]) -> str:
    """Return the Functions in C, for this source alone."""
    generator = ca.CodeGenerator("share.c", {"with_header": False, "main": False, "casadi_int": "long long"})
    for function in functions.values():
        generator.add(function)
    code: str = generator.dump()
    return f"#define CASADI_SYMBOL_EXPORT static\n{code}"
