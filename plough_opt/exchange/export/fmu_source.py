"""C source of an exported share: its numbers, its equations, and the functions of the FMI around them."""

import hashlib
import math
from collections.abc import Iterable
from importlib.resources import files

import casadi as ca

from plough_opt.exchange.export.fmu_equations import Model

# Numbers of variables by kind, as the runtime calls them.
_COUNTS = {
    "NX": "states", "NY": "outputs", "NZ": "indicators", "NC": "calculated", "NU": "inputs", "NP": "parameters",
    "ND": "discrete",
}  # fmt: skip


def c_source(model: Model, *, pushes: bool, by_speed: bool) -> tuple[str, str]:
    """Return the C source of an FMU, and the token that belongs to it.

    Args:
        model: the equations.
        pushes: whether the soil would push a share that retreats; the FMU warns if it happens.
        by_speed: whether the strut's speed is the input.
    """
    folder = files("plough_opt.exchange.export")
    functions = (folder.joinpath(name).read_text(encoding="utf-8") for name in ("fmu_runtime.c", "fmu_optional.c"))
    # CasADi's functions are for this source alone.
    generator = ca.CodeGenerator("share.c", {"with_header": False, "main": False, "casadi_int": "long long"})
    for function in model.functions.values():
        generator.add(function)
    equations = f"#define CASADI_SYMBOL_EXPORT static\n{generator.dump()}"
    parts = (_numbers(model, pushes, by_speed), equations, *functions)
    # Names and units stand in the description: two FMUs that compute the same may share a token.
    token = hashlib.sha256("".join(parts).encode()).hexdigest()[:32]
    return "\n".join((f'#define TOKEN "{token}"', *parts)), token


def _numbers(model: Model, pushes: bool, by_speed: bool) -> str:
    """Return the numbers of variables, and their domains, starts and orders of magnitude."""
    of_kind, functions = model.of_kind, model.functions
    counts = {count: len(of_kind[kind]) for count, kind in _COUNTS.items()} | {
        "NQ": functions["derive"].numel_out(0),
        "NW": max(function.sz_w() for function in functions.values()),
        "PUSHES": int(pushes),
        "NEEDS_SPEED": int(by_speed),
        "HAS_DERIVATIVES": int("forward_derive" in functions),
    }
    limits = ",\n".join(
        f'  {{"{one.name}", {_row((one.low, one.high))}, {int(one.above)}, {int(one.below)}}}'
        for one in of_kind["parameters"]
    )
    starts = _row(variable.start for kind in ("inputs", "parameters") for variable in of_kind[kind])
    return "\n".join(
        (
            *(f"#define {name} {count}" for name, count in counts.items()),
            "#include <math.h>",
            "typedef struct { const char *name; double low, high; int above, below; } Limits;",
            f"static const Limits limits[] = {{\n{limits}}};",
            f"static const double starts[] = {{{starts}}};",
            f"static const double nominals[] = {{{_row(variable.magnitude for variable in of_kind['states'])}}};",
        )
    )


def _row(values: Iterable[float]) -> str:
    """Return numbers as C writes them."""
    infinite = {math.inf: "INFINITY", -math.inf: "-INFINITY"}
    return ", ".join(infinite.get(value, repr(float(value))) for value in values)
