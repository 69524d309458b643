"""Compilation of C source into shared libraries by the system's compiler, kept in one private folder of the user.

A library is code that runs with the user's rights, so nobody else may be able to write where it is kept. It is renamed
to its place once it is complete and has been loaded: processes share it, and a killed one leaves no half of it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import stat
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from string import Template
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, short
from plough_opt.core.files import text_of
from plough_opt.core.plain_data import Array

Variant = tuple[tuple[str, ...], tuple[str, ...]]
"""Compiler flags and libraries of one attempt to compile."""

NOT_FOUND: Final = "no C compiler was found ($CC, cc, gcc, clang)"
"""Beginning of a message."""

# Time limit [s] of a compilation. The largest designs take a minute on a busy machine.
_TIMEOUT = 300.0
# Why the last library could not be compiled.
_failure = NOT_FOUND


def find_compiler() -> tuple[str, ...] | None:
    """Return the command of the system's C compiler, preferring ``$CC``, or None if there is none.

    Raises:
        InputError: ``$CC`` is not a valid command line.
    """
    for command in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise InputError(f"$CC = {command!r} is not a command: {error}; correct or unset it") from None
        if words and (program := shutil.which(words[0])) is not None:
            return (program, *words[1:])
    return None


def compiler_problem() -> str:
    """Return why there is no compiled code, as a clause that begins a warning."""
    return _failure


def interpretation_warning() -> str:
    """Return the warning for a model that was to be compiled and is interpreted instead."""
    return f"{compiler_problem()}: the model is interpreted, which takes longer"


def library(source: str, variants: tuple[Variant, ...]) -> Path | None:
    """Return the path of the library compiled from a C source; None if there is none: see `compiler_problem`.

    Args:
        source: the C source.
        variants: flags and libraries to try, fastest first; the first that compiles and loads is used.
    """
    global _failure
    if (command := find_compiler()) is None:
        _failure = NOT_FOUND
        return None
    name = hashlib.sha256("\0".join((source, str(variants), _identity(command))).encode()).hexdigest()
    try:
        path = _private_folder() / f"{name[:32]}.so"
        if not path.is_file():
            with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
                _first(source, command, variants, Path(scratch)).replace(path)
        return path
    except OSError as error:
        _failure = f"compiled code cannot be made or kept ({error})"
        return None


def _first(source: str, command: tuple[str, ...], variants: tuple[Variant, ...], folder: Path) -> Path:
    """Return the library of the first variant that can be compiled, and then be loaded on this system.

    Raises:
        OSError: there is none; the message is about the first variant.
    """
    problems = []
    for number, (flags, libraries) in enumerate(variants):
        compiled = folder / f"{number}.so"
        problem = compile_library(source, (*command, *flags), compiled, libraries)
        if problem is None:
            try:
                ctypes.CDLL(str(compiled))
                return compiled
            except OSError as error:
                problem = str(error)
        problems.append(problem)
    raise OSError(f"the C compiler {command[0]} failed: {problems[0]}")


def loaded(source: str, variants: tuple[Variant, ...], arguments: Mapping[str, Sequence[Any]]) -> ctypes.CDLL | None:
    """Return the library compiled from a C source, to be called; None if there is none: see `compiler_problem`.

    Args:
        source: the C source.
        variants: as in `library`.
        arguments: function that the library has -> types of its arguments.
    """
    if (path := library(source, variants)) is None:
        return None
    opened = ctypes.CDLL(str(path))
    for name, types in arguments.items():
        getattr(opened, name).argtypes = types
    return opened


def in_machine_code(functions: Sequence[ca.Function], variants: tuple[Variant, ...]) -> list[ca.Function] | None:
    """Return functions in machine code, or None if there is no library: see `library`."""
    path = library(code_of("functions", functions), variants)
    return None if path is None else [ca.external(function.name(), str(path)) for function in functions]


def code_of(name: str, functions: Iterable[ca.Function], **options: Any) -> str:
    """Return the C code that CasADi generates for Functions; a name precedes its internal symbols."""
    generator = ca.CodeGenerator(f"{name}.c", options)
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def compile_library(source: str, command: Sequence[str], into: Path, libraries: Sequence[str]) -> str | None:
    """Compile a C source into a library.

    Args:
        source: the C source.
        command: compiler and flags.
        into: path of the library. The compiler's temporary files go into the same folder.
        libraries: linker flags for the libraries it needs.

    Returns:
        None, or the first line of the compiler's output.
    """
    arguments = [*command, "-shared", "-fPIC", "-x", "c", "-", "-o", str(into), *libraries]
    environment = os.environ | {"TMPDIR": str(into.parent)}
    try:
        done = subprocess.run(arguments, input=source.encode(), capture_output=True, timeout=_TIMEOUT, env=environment)
    except OSError as error:
        return str(error)
    except subprocess.TimeoutExpired:
        return f"it did not end within {_TIMEOUT:g} s"
    if done.returncode == 0 and into.is_file():
        return None
    lines = (done.stderr + done.stdout).decode(errors="backslashreplace").strip().splitlines()
    return short(lines[0], 160) if lines else f"it wrote no library (exit status {done.returncode})"


def cache_folder() -> Path:
    """Return the user's cache folder: ``$XDG_CACHE_HOME/plough_opt``, or ``~/.cache/plough_opt``.

    Raises:
        OSError: the home folder is not an absolute path.
        RuntimeError: the user has no home folder.
    """
    chosen = Path(os.environ.get("XDG_CACHE_HOME", ""))
    folder = chosen if chosen.is_absolute() else Path.home() / ".cache"
    if not folder.is_absolute():
        raise NotADirectoryError(f"the home folder '{Path.home()}' is not an absolute path")
    return folder / "plough_opt"


def _private_folder() -> Path:
    """Return the folder of libraries, or if it is of no use a temporary one, which this process removes at its end."""
    try:
        folder = cache_folder() / "code"
        folder.mkdir(stat.S_IRWXU, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "geteuid") and (status.st_uid != os.geteuid() or status.st_mode & (stat.S_IRWXG | stat.S_IRWXO)):
            raise PermissionError(f"'{folder}' is not private: chmod 700 '{folder}', or remove it")
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError, ValueError) as error:
        return _temporary_folder(str(error))


@lru_cache(maxsize=1)
def _temporary_folder(why: str) -> Path:
    warnings.warn(f"compiled code is not kept for other runs: {why}", stacklevel=4)
    _temporary.append(tempfile.TemporaryDirectory(prefix="plough_opt-"))
    return Path(_temporary[-1].name)


# Folders that are removed when this process ends.
_temporary: list[tempfile.TemporaryDirectory[str]] = []


@lru_cache(maxsize=4)
def _identity(command: tuple[str, ...]) -> str:
    """Return a text that identifies compiler and processor, on which a compiled library depends besides its source."""
    texts = [*command, platform.system(), platform.release(), platform.machine(), *platform.libc_ver()]
    with suppress(OSError, subprocess.TimeoutExpired):  # the compilation reports it
        done = subprocess.run([*command, "--version"], capture_output=True, timeout=_TIMEOUT)
        texts.append(done.stdout.decode(errors="backslashreplace"))
    with suppress(OSError):  # of systems other than Linux
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        texts += sorted({line for line in lines if line.startswith(("flags", "model", "Features", "CPU part"))})
    return "\n".join(texts)


def _named(names: str) -> dict[int, str]:
    """Return CasADi's operation -> C function, for functions that have the same name in both."""
    return {int(getattr(ca, f"OP_{name.upper()}")): name for name in names.split()}


# CasADi's operation -> C function: in the vector library with one argument, with two, and missing from it. `vectors.c`
# has a line for each.
LIBRARY = _named("exp expm1 log log1p sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh erf")
LIBRARY_OF_TWO = {ca.OP_CONSTPOW: "pow"} | _named("pow atan2 hypot")
LANE_BY_LANE = _named("floor ceil sqrt")
# CasADi's operation -> its result in C, given vectors; that of a condition is 1 where it holds, and else 0.
_FORMS = {
    **{code: f"v_{name}({{0}})" for code, name in (LIBRARY | LANE_BY_LANE).items()},
    **{code: f"v_{name}({{0}}, {{1}})" for code, name in LIBRARY_OF_TWO.items()},
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "1.0 / {0}",
    ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}",
    ca.OP_LT: "v_one({0} < {1})", ca.OP_LE: "v_one({0} <= {1})", ca.OP_EQ: "v_one({0} == {1})",
    ca.OP_NE: "v_one({0} != {1})", ca.OP_NOT: "v_one({0} == 0.0)", ca.OP_AND: "v_one(({0} != 0.0) & ({1} != 0.0))",
    ca.OP_OR: "v_one(({0} != 0.0) | ({1} != 0.0))", ca.OP_IF_ELSE_ZERO: "(V)((M)({1}) & ({0} != 0.0))",
    ca.OP_FABS: "v_fabs({0})", ca.OP_SIGN: "v_sign({0})", ca.OP_FMIN: "v_min({0}, {1})", ca.OP_FMAX: "v_max({0}, {1})",
}  # fmt: skip


def variants(*flags: str) -> tuple[Variant, ...]:
    """Return how to compile: with the vector functions of the GNU C library, without them, and for any processor.

    Args:
        flags: flags of every attempt, besides those that let floating-point operations be reordered.
    """
    flags = (*flags, "-ffp-contract=fast", "-fno-signed-zeros", "-fno-trapping-math", "-fno-math-errno")
    own, vector = (*flags, "-march=native"), (*flags, "-march=native", "-DVECTOR_LIBRARY")
    return (vector, ("-lmvec", "-lm")), (own, ("-lm",)), (flags, ("-lm",))


def instructions(function: ca.Function) -> Iterator[tuple[int, list[int], list[int], float]]:
    """Yield each operation of a Function of SX: its code, the places of results and operands, and its constant."""
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        constant = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        yield code, function.instruction_output(k), function.instruction_input(k), constant


def name_of(code: int) -> str:
    """Return CasADi's name of an operation, such as "floor"."""
    return next(name[3:].lower() for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)


class Statements:
    """The C statements of a Function of SX with one result, a dense column.

    Attributes:
        once: statements to run once before all steps: what depends on the last argument alone.
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
        self._inverses: dict[str, tuple[str, bool]] = {}
        work: dict[int, tuple[str, bool]] = {}  # place -> name, and whether it is the same in every step
        results = []
        for code, into, of, constant in instructions(function):
            if code == ca.OP_INPUT:
                work[into[0]] = f"{arrays[of[0]]}[{of[1]}]", of[0] == function.n_in() - 1
            elif code == ca.OP_CONST:
                work[into[0]] = f"((V){{0}} + ({constant!r}))".replace("inf", "INFINITY"), True
            elif code == ca.OP_OUTPUT:
                results.append(f"y[{into[1]}] = (V){{0}} + {work[of[0]][0]};")
            else:
                work[into[0]] = self._apply(code, [work[j] for j in of])
        self.each += results

    def _apply(self, code: int, of: list[tuple[str, bool]]) -> tuple[str, bool]:
        """Add the statement of an operation and return its result.

        A division by a value that is the same in every step becomes a product with the inverse, computed once.
        """
        if code == ca.OP_DIV and of[1][1] and not of[0][1]:
            if of[1][0] not in self._inverses:
                self._inverses[of[1][0]] = self._apply(ca.OP_INV, [of[1]])
            code, of = ca.OP_MUL, [of[0], self._inverses[of[1][0]]]
        if code not in _FORMS:
            raise InputError(f"a batch cannot evaluate the operation '{name_of(code)}': simulate each design")
        name, once = f"a{len(self.once) + len(self.each)}", all(same for _, same in of)
        (self.once if once else self.each).append(f"const V {name} = {_FORMS[code].format(*(x for x, _ in of))};")
        return name, once


# --- a Function for many designs at once, by a library that reads the list of its operations ---


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

    def call(given: list[Array]) -> list[Array]:
        if not len(given[0]):
            return [np.empty((0, size)) for size in sizes]
        return [np.asarray(result).T for result in mapped(len(given[0])).call([rows.T for rows in given])]

    return call


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
    room, places = _WIDE * function.sz_w() + _WIDEST, ctypes.c_void_p * (len(taken) + len(given))

    def call(arguments: list[Array]) -> list[Array]:
        count, memory = len(arguments[0]), np.empty(room)
        assert [one.shape for one in arguments] == [(count, size) for size in taken]
        results = [np.empty((count, size)) for size in given]
        at = places(*[array.ctypes.data for array in (*arguments, *results)])
        library.rows(count, len(program[0]), *listed, len(taken), at, memory.ctypes.data)
        return results

    return call


# Codes of the operations that the library executes.
_CODES = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_FORMS}


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
def _library() -> ctypes.CDLL | None:
    """Return the library of `rows.c`, or None without a compiler or if ``$CC`` is not a command."""
    forms = {code: form.format("a[k]", "b[k]") for code, form in _FORMS.items()}
    cases = "\n".join(f"        case {code}: OF_PARTS({form})" for code, form in forms.items())
    own = Template(text_of(__package__, "rows.c")).substitute(
        wide=_WIDE, input=ca.OP_INPUT, output=ca.OP_OUTPUT, constant=ca.OP_CONST, cases=cases
    )
    arguments = [ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 3, ctypes.c_int64, *[ctypes.c_void_p] * 2]
    with suppress(InputError):
        return loaded(text_of("plough_opt.core", "vectors.c") + own, variants("-O2"), {"rows": arguments})
    return None
