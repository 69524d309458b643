"""Evaluation of a CasADi Function at many designs at once."""

from collections.abc import Callable
from contextlib import suppress
from ctypes import CDLL, c_int64, c_void_p
from functools import lru_cache
from string import Template

import casadi as ca
import numpy as np

from plough_opt.core.compiler import instructions, loaded, operations, variants
from plough_opt.core.errors import InputError
from plough_opt.core.files import text_of
from plough_opt.core.plain_data import Array

# Numbers in a register of `rows.c`, and in the widest vector of a processor.
_WIDE, _WIDEST = 16, 8
# Maps that are kept: building one takes about as long as a call of it.
_MAPS = 32


def by_rows(function: ca.Function) -> Callable[..., list[Array]]:
    """Return a Function of dense columns for many designs at once, with a row for each in arguments and results.

    A library reads the list of a Function's scalar operations and executes each for 16 designs at a time. CasADi's
    `map`, which takes several times as long, replaces it without a compiler, and for Functions that are not in scalar
    operations or contain one that the library lacks.
    """
    call = _in_vectors(function) or _by_map(function)
    return lambda *arguments: call([np.ascontiguousarray(argument, dtype=float) for argument in arguments])


def _by_map(function: ca.Function) -> Callable[[list[Array]], list[Array]]:
    """Return the evaluation by CasADi."""
    mapped, sizes = lru_cache(_MAPS)(function.map), [function.numel_out(k) for k in range(function.n_out())]

    def by_map(given: list[Array]) -> list[Array]:
        if not len(given[0]):
            return [np.empty((0, size)) for size in sizes]
        return [np.asarray(result).T for result in mapped(len(given[0])).call([rows.T for rows in given])]

    return by_map


def _in_vectors(function: ca.Function) -> Callable[[list[Array]], list[Array]] | None:
    """Return the evaluation by the library; None without it, or if it lacks an operation."""
    if not function.is_a("SXFunction") or (library := _library()) is None:
        return None
    rows, constants = _listed(function)
    if not {code for code, *_ in rows} <= _CODES:
        return None
    taken = [function.numel_in(k) for k in range(function.n_in())]
    given = [function.numel_out(k) for k in range(function.n_out())]
    program = np.array(rows, dtype=np.int32), np.array(constants), np.array([*taken, *given], dtype=np.int64)
    listed = [array.ctypes.data for array in program]
    room, places = _WIDE * function.sz_w() + _WIDEST, c_void_p * (len(taken) + len(given))

    def call(arguments: list[Array]) -> list[Array]:
        count, memory = len(arguments[0]), np.empty(room)
        assert [one.shape for one in arguments] == [(count, size) for size in taken]
        results = [np.empty((count, size)) for size in given]
        at = places(*[array.ctypes.data for array in (*arguments, *results)])
        library.rows(count, len(program[0]), *listed, len(taken), at, memory.ctypes.data)
        return results

    return call


# Codes of the operations that the library executes.
_CODES = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *(code for code, _ in operations("", ""))}


def _listed(function: ca.Function) -> tuple[list[tuple[int, int, int, int]], list[float]]:
    """Return the operations of a Function of SX as `rows.c` reads them, and the constants."""
    rows: list[tuple[int, int, int, int]] = []
    constants: list[float] = []
    for code, into, of, constant in instructions(function):
        if code == ca.OP_INPUT:
            rows.append((code, into[0], of[0], of[1]))
        elif code == ca.OP_OUTPUT:
            rows.append((code, of[0], into[0], into[1]))
        elif code == ca.OP_CONST:
            rows.append((code, into[0], len(constants), 0))
            constants.append(constant)
        else:
            rows.append((code, into[0], of[0], of[-1]))
    return rows, constants


@lru_cache(maxsize=1)
def _library() -> CDLL | None:
    """Return the library of `rows.c`, or None without a compiler or if ``$CC`` is not a command."""
    cases = "\n".join(f"        case {code}: OF_PARTS({result})" for code, result in operations("a[k]", "b[k]"))
    own = Template(text_of(__package__, "rows.c")).substitute(
        wide=_WIDE, input=ca.OP_INPUT, output=ca.OP_OUTPUT, constant=ca.OP_CONST, cases=cases
    )
    arguments = [c_int64, c_int64, *[c_void_p] * 3, c_int64, *[c_void_p] * 2]
    with suppress(InputError):
        return loaded(text_of("plough_opt.core", "vectors.c") + own, variants("-O2"), {"rows": arguments})
    return None
