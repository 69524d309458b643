"""C source to a loaded library, by the system's own compiler, kept in the user's cache."""

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from plough_opt.core.errors import InputError

Variant = tuple[tuple[str, ...], tuple[str, ...]]
"""Flags and libraries of an attempt to compile."""

NO_COMPILER = "no C compiler was found ($CC, cc, gcc, clang): the model is interpreted, which takes longer"
"""Warning about results for which machine code was requested."""

_FLAGS = ("-shared", "-fPIC")
# Limit on the time of the compiler [s].
_LONGEST = 300.0
_DIGEST = hashlib.sha256().digest_size


def find_compiler() -> tuple[str, ...] | None:
    """Return the command of the system's C compiler, ``$CC`` first, or None without one.

    Raises:
        InputError: ``$CC`` is not a command line.
    """
    for command in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise InputError(f"$CC = {command!r} is not a command: {error}; set it to one, or unset it") from None
        if words and (found := shutil.which(words[0])) is not None:
            return (found, *words[1:])
    return None


def library(source: str, variants: tuple[Variant, ...]) -> Path | None:
    """Return the library of a C source, from the cache if it is there; None if it cannot be compiled.

    The cache is ``$XDG_CACHE_HOME/plough_opt``, or a folder of this process if that cannot be written. A complete
    library is moved there, so that processes may share it, and is compiled again if its digest is wrong.

    Args:
        source: the C source.
        variants: flags and libraries, from the fastest on; the first one that compiles and loads is used.
    """
    command = find_compiler()
    if command is None:
        return None
    name = hashlib.sha256("\0".join((source, *_FLAGS, str(variants), _identity(command))).encode()).hexdigest()
    for folder in (_cache(), _private()):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            return _library_at(folder / f"{name[:32]}.so", source, command, variants)
        except OSError:
            continue
    return None


def _library_at(path: Path, source: str, command: tuple[str, ...], variants: tuple[Variant, ...]) -> Path | None:
    """Return the path of a library, compiled if it is missing or damaged.

    Raises:
        OSError: the folder cannot be written, or the system forbids loading from it.
    """
    if _is_whole(path):
        ctypes.CDLL(str(path))
        return path
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        for number, (flags, libraries) in enumerate(variants):
            made = Path(scratch) / f"{number}.so"
            if compile_library(source, (*command, *flags), made, libraries) is None:
                content = made.read_bytes()
                made.write_bytes(content + hashlib.sha256(content).digest())
                # Loading fails if the C library lacks a function.
                if _loads(made):
                    made.replace(path)
                    return path
    return None


def _is_whole(path: Path) -> bool:
    """Return whether a library exists and ends with its digest."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return hashlib.sha256(content[:-_DIGEST]).digest() == content[-_DIGEST:]


def compile_library(source: str, command: Sequence[str], into: Path, libraries: Sequence[str]) -> str | None:
    """Compile a C source into a library.

    Args:
        source: the C source.
        command: compiler and flags.
        into: path of the library.
        libraries: flags that name the libraries it needs.

    Returns:
        None, or the first line of the compiler's error.
    """
    arguments = [*command, *_FLAGS, "-x", "c", "-", "-o", str(into), *libraries]
    try:
        done = subprocess.run(arguments, input=source.encode(), capture_output=True, timeout=_LONGEST, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        return str(error)
    if done.returncode == 0 and into.exists():
        return None
    return next(iter(done.stderr.decode(errors="replace").strip().splitlines()), "no message")


def _loads(path: Path) -> bool:
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return False
    return True


def _cache() -> Path:
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(chosen) if chosen else Path("~/.cache").expanduser()) / "plough_opt"


@lru_cache(maxsize=1)
def _private() -> Path:
    return Path(tempfile.mkdtemp(prefix="plough_opt-"))


@lru_cache(maxsize=4)
def _identity(command: tuple[str, ...]) -> str:
    """Return a text that identifies compiler and processor, on which a compiled library depends beside its source."""
    try:
        done = subprocess.run([*command, "--version"], capture_output=True, timeout=_LONGEST, check=False)
        version = done.stdout.decode(errors="replace")
    except (OSError, subprocess.SubprocessError):
        version = ""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    processor = [line for line in lines if line.startswith(("flags", "model", "Features", "CPU part"))]
    # platform.platform() would start another process to find the processor.
    system = platform.system(), platform.release(), platform.machine(), *platform.libc_ver()
    return "\n".join((*command, version, *system, *sorted(set(processor))))
