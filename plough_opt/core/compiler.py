"""Compilation of C source into shared libraries by the system's compiler, cached in the user's cache folder.

A library is code that runs with the user's rights. It is loaded from a folder only if nobody else could have put it
there: file and folders belong to the user or to root, and others may not write to them, as ssh requires of a user's
keys. A library ends with a digest of its name and content, which reveals one that is truncated, damaged or another's.

A library that a compiler left incomplete would kill Python by a signal. So a process of its own loads each library
once, right after its compilation and before it gets its digest, which takes a few hundredths of a second. A library
from the cache needs no such trial: its digest proves that it is the file that passed it.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from string import Template
from typing import Any, Final

import casadi as ca

from plough_opt.core.errors import InputError, short
from plough_opt.core.files import text_of

Variant = tuple[tuple[str, ...], tuple[str, ...]]
"""Compiler flags and libraries of one attempt to compile."""

NOT_FOUND: Final = "no C compiler was found ($CC, cc, gcc, clang)"
"""Beginning of a message."""

_FLAGS = ("-shared", "-fPIC")
# Time limit [s] of a compilation. The largest designs take a minute on a busy machine.
_TIMEOUT = 300.0
# Time limit [s] of an answer that takes milliseconds on an idle machine.
_ANSWER = 30.0
_DIGEST_SIZE = hashlib.sha256().digest_size
# Prefix of temporary folders; the number of the process follows.
_PREFIX = "plough_opt-"
# Age [s] from which a folder is no longer in use if there is no process of its number, not even in another container.
_ABANDONED = 3600.0
# Loads a library and its symbols.
_TRIAL = """import ctypes, sys
sys.tracebacklimit = 0
library = ctypes.CDLL(sys.argv[1])
[library[name] for name in sys.argv[2:]]"""
# Most characters of a compiler's output in a message.
_LONGEST_LINE = 160

# Why the last library could not be compiled; "" if none failed.
_failure = ""
# Compilers that did not end within the time limit, which are not tried again, and the sentence about each.
_hanging: dict[str, str] = {}


class _CompilationFailed(Exception):
    """The compiler failed; the message names it and quotes the first line of its output."""


class _UnsafeFolder(OSError):
    """Another user could put a library into a folder."""


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
        if words and (found := shutil.which(words[0])) is not None:
            return (found, *words[1:])
    return None


def compiler_problem() -> str:
    """Return why there is no compiled code, as a clause that begins a warning."""
    return _failure or NOT_FOUND


def interpretation_warning() -> str:
    """Return the warning for a model that was to be compiled and is interpreted instead."""
    return f"{compiler_problem()}: the model is interpreted, which takes longer"


def library(source: str, variants: tuple[Variant, ...], symbols: Sequence[str] = ()) -> Path | None:
    """Return the path of the library compiled from a C source; None if there is none: see `compiler_problem`.

    The cache is ``$XDG_CACHE_HOME/plough_opt``, or ``~/.cache/plough_opt`` if that variable is not an absolute path. If
    it is not writable or not safe, a temporary folder of this process is used instead. A library is moved to its place
    only once complete, so processes can share it; another file in its place is replaced.

    Args:
        source: the C source.
        variants: flags and libraries to try, fastest first; the first that compiles and loads is used.
        symbols: functions that the library must have.
    """
    global _failure
    command = find_compiler()
    if command is None:
        _failure = NOT_FOUND
        return None
    name = hashlib.sha256("\0".join((source, *_FLAGS, str(variants), _identity(command))).encode()).hexdigest()
    failure = ""
    for folder_of in (cache_folder, _temporary_folder):
        if command[0] in _hanging:
            failure = _hanging[command[0]]
            break
        try:
            path = _private(folder_of()) / f"{name[:32]}.so"
            if _is_intact(path):
                ctypes.CDLL(str(path))
            else:
                _compile(path, source, command, variants, symbols)
            return path
        except _CompilationFailed as error:
            failure = str(error)
        except (OSError, RuntimeError) as error:  # `expanduser` raises RuntimeError
            if isinstance(error, _UnsafeFolder):
                warnings.warn(f"compiled code is not kept for other runs: {error}", stacklevel=2)
            failure = failure or f"compiled code cannot be stored or loaded ({error})"
    _failure = failure
    return None


def loaded(source: str, variants: tuple[Variant, ...], arguments: Mapping[str, Sequence[Any]]) -> ctypes.CDLL | None:
    """Return the library compiled from a C source, to be called; None if there is none: see `compiler_problem`.

    Args:
        source: the C source.
        variants: as in `library`.
        arguments: function that the library must have -> types of its arguments.
    """
    path = library(source, variants, tuple(arguments))
    if path is None:
        return None
    found = ctypes.CDLL(str(path))
    for name, types in arguments.items():
        getattr(found, name).argtypes = types
    return found


def _compile(
    path: Path, source: str, command: tuple[str, ...], variants: tuple[Variant, ...], symbols: Sequence[str]
) -> None:
    """Compile a library in a temporary folder and move it to its path.

    Raises:
        _CompilationFailed: no variant compiles.
        OSError: the folder is not writable, or none of the libraries can be loaded from it.
    """
    _remove_abandoned(path.parent)
    uncompiled, unloaded = [], []
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f"{_PREFIX}{os.getpid()}-") as scratch:
        for number, (flags, libraries) in enumerate(variants):
            compiled = Path(scratch) / f"{number}.so"
            if (problem := compile_library(source, (*command, *flags), compiled, libraries)) is not None:
                uncompiled.append(problem)
                if command[0] in _hanging:
                    break
            # Loading fails if the C library lacks a function, or if the system forbids it in this folder.
            elif (problem := _trial(compiled, symbols)) is not None:
                unloaded.append(problem)
            else:
                content = compiled.read_bytes()
                compiled.write_bytes(content + _digest(path, content))
                compiled.chmod(stat.S_IRWXU)
                compiled.replace(path)
                return
    if unloaded:
        raise OSError(unloaded[-1])
    raise _CompilationFailed(f"the C compiler {command[0]} failed ({uncompiled[0]})")


def in_machine_code(functions: Sequence[ca.Function], variants: tuple[Variant, ...]) -> list[ca.Function] | None:
    """Return functions in machine code, or None if there is no library: see `library`."""
    names = [function.name() for function in functions]
    path = library(code_of("functions", functions), variants, names)
    return None if path is None else [ca.external(name, str(path)) for name in names]


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
    arguments = [*command, *_FLAGS, "-x", "c", "-", "-o", str(into), *libraries]
    try:
        status, line = _run(arguments, source, _TIMEOUT, os.environ | {"TMPDIR": str(into.parent)})
    except OSError as error:
        return str(error)
    except subprocess.TimeoutExpired:
        return _note_hanging(command[0], _TIMEOUT)
    if status == 0 and into.is_file():
        return None
    how = f"ended by signal {-status}" if status < 0 else f"exit status {status}" if status else "it wrote no library"
    return line or how


def _note_hanging(compiler: str, seconds: float) -> str:
    problem = f"it did not end within {seconds:g} s"
    _hanging[compiler] = f"the C compiler {compiler} failed ({problem})"
    return problem


def _run(
    arguments: Sequence[str], text: str, seconds: float, environment: Mapping[str, str] | None = None
) -> tuple[int, str]:
    """Run a program, and return its exit status and the first line of its output.

    A program that takes too long, or is interrupted by Ctrl-C, is killed with all processes that it has started.

    Raises:
        OSError: it cannot be started.
        subprocess.TimeoutExpired: it takes too long.
    """
    pipe: Final = subprocess.PIPE
    with subprocess.Popen(
        arguments, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, env=environment, start_new_session=True
    ) as process:
        try:
            output, _ = process.communicate(text.encode(), timeout=seconds)
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL) if hasattr(os, "killpg") else process.kill()
            raise
    lines = output.decode(errors="backslashreplace").strip().splitlines()
    return process.returncode, short(lines[0], _LONGEST_LINE) if lines else ""


def _trial(path: Path, symbols: Sequence[str]) -> str | None:
    """Load a library in a process of its own; return None, or why that fails."""
    if not sys.executable:  # Python within another program
        return None
    try:
        # -I, because the current folder or $PYTHONPATH may hold modules of any name; -S, because no package is needed.
        status, line = _run([sys.executable, "-I", "-S", "-c", _TRIAL, str(path), *symbols], "", _ANSWER)
    except subprocess.TimeoutExpired:
        return f"loading it takes more than {_ANSWER:g} s"
    return None if status == 0 else f"the compiled library cannot be loaded: {line or f'exit status {status}'}"


def _is_intact(path: Path) -> bool:
    """Return whether a file is a library that this user, or root, has stored under this name."""
    try:
        status = path.lstat()
        if not (stat.S_ISREG(status.st_mode) and _is_safe(status)):
            return False
        content = path.read_bytes()
    except OSError:
        return False
    return _digest(path, content[:-_DIGEST_SIZE]) == content[-_DIGEST_SIZE:]


def _digest(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + content).digest()


def _is_safe(status: os.stat_result) -> bool:
    """Return whether only root and this user can change a file, or replace what a folder holds."""
    if not hasattr(os, "geteuid"):
        return True
    sticky = stat.S_ISDIR(status.st_mode) and status.st_mode & stat.S_ISVTX
    shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not sticky
    return status.st_uid in (0, os.geteuid()) and not shared


def _private(folder: Path) -> Path:
    """Create a folder that only this user can read, unless it exists; return its path without links.

    Raises:
        OSError: it cannot be created.
        _UnsafeFolder: another user could replace it, or what it holds.
    """
    for missing in reversed([part for part in (folder, *folder.parents) if not part.exists()]):
        missing.mkdir(stat.S_IRWXU, exist_ok=True)
    place = folder.resolve()
    for part in (place, *place.parents):
        if not _is_safe(part.stat()):
            raise _UnsafeFolder(f"'{part}' belongs to another user, or others can write to it (chmod go-w '{part}')")
    return place


def cache_folder() -> Path:
    """Return the folder of the user's libraries.

    Raises:
        OSError: the home folder is not an absolute path.
        RuntimeError: the user has no home folder.
    """
    chosen = Path(os.environ.get("XDG_CACHE_HOME", ""))
    folder = chosen if chosen.is_absolute() else Path("~/.cache").expanduser()
    if not folder.is_absolute():
        raise NotADirectoryError(f"the home folder '{folder.parent}' is not an absolute path")
    return folder / "plough_opt"


@lru_cache(maxsize=1)
def _temporary_folder() -> Path:
    """Return a folder that is removed when this process ends."""
    process, place = os.getpid(), Path(tempfile.gettempdir())
    _remove_abandoned(place)
    folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{process}-", dir=place))

    def remove() -> None:
        if os.getpid() == process:  # not in a forked child
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def _remove_abandoned(place: Path) -> None:
    """Remove the temporary folders of processes that were killed."""
    for folder in place.glob(f"{_PREFIX}[0-9]*-*"):
        # The folder may belong to another user or be removed meanwhile.
        with contextlib.suppress(OSError, ValueError, OverflowError):
            if time.time() - folder.lstat().st_mtime > _ABANDONED:
                try:
                    os.kill(int(folder.name.split("-")[1]), 0)
                except ProcessLookupError:
                    shutil.rmtree(folder)


@lru_cache(maxsize=4)
def _identity(command: tuple[str, ...]) -> str:
    """Return a text that identifies compiler and processor, on which a compiled library depends besides its source."""
    try:
        _, version = _run([*command, "--version"], "", _ANSWER)
    except OSError:
        version = ""
    except subprocess.TimeoutExpired:
        version = _note_hanging(command[0], _ANSWER)
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    processor = [line for line in lines if line.startswith(("flags", "model", "Features", "CPU part"))]
    # platform.platform() would start another process to identify the processor.
    system = platform.system(), platform.release(), platform.machine(), *platform.libc_ver()
    return "\n".join((*command, version, *system, *sorted(set(processor))))


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
    a_map, run, phase = map(Template, text_of(__package__, "batch.c").split("/* ---- */\n"))
    lines = [text_of(__package__, "vectors.c")]
    for name, one in maps.items():
        text = Statements(one, ("x",))
        body = "\n".join([*text.once, *text.each])
        lines.append(a_map.substitute(name=name, inputs=one.numel_in(0), results=one.numel_out(), body=body))
    state = phases[0][0].numel_out()
    loops = []
    for step, end in phases:
        text = Statements(step, ("x", "p"))
        once, each = "\n".join(text.once), "\n".join(text.each)
        loops.append(phase.substitute(once=once, each=each, end=end, state=state))
    lines.append(run.substitute(parameters=parameters, state=state, phases="\n".join(loops)))
    return "\n".join(lines)


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
        is_mask = _is_mask(code)
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


def operations(*operands: str) -> Iterator[tuple[int, str]]:
    """Yield the code of each operation that has a vector form, and its result in C, given two vectors in C."""
    one = {*SIMPLE, *LIBRARY, *LANE_BY_LANE, ca.OP_FABS, ca.OP_SIGN, ca.OP_NOT}
    two = {*BINARY, *COMPARISONS, *_LOGICAL, *LIBRARY_OF_TWO, ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO}
    for code in sorted(one | two):
        of = [_Value(operand) for operand in operands[: 1 if code in one else 2]]
        yield code, _Value(_expression(code, of), is_mask=_is_mask(code)).number


def _is_mask(code: int) -> bool:
    return code in COMPARISONS or code in _LOGICAL or code == ca.OP_NOT


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
