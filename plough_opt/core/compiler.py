"""Compilation of C source into shared libraries by the system's compiler, cached in the user's cache folder."""

import atexit
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
"""Compiler flags and libraries of one attempt to compile."""

NO_COMPILER = "no C compiler was found ($CC, cc, gcc, clang): the model is interpreted, which takes longer"
"""Warning if compiled code was requested."""

_FLAGS = ("-shared", "-fPIC")
# Timeout of the compiler [s].
_TIMEOUT = 300.0
_DIGEST_SIZE = hashlib.sha256().digest_size


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


def library(source: str, variants: tuple[Variant, ...]) -> Path | None:
    """Return the path of the library compiled from a C source, cached if possible; None if it cannot be compiled.

    The cache is ``$XDG_CACHE_HOME/plough_opt``, or a temporary folder of this process if that is not writable or the
    user has no home folder. A library is moved there only once complete, so processes can share it; a library with a
    wrong digest is compiled again.

    Args:
        source: the C source.
        variants: flags and libraries to try, fastest first; the first that compiles and loads is used.
    """
    command = find_compiler()
    if command is None:
        return None
    name = hashlib.sha256("\0".join((source, *_FLAGS, str(variants), _identity(command))).encode()).hexdigest()
    for folder_of in (_cache_folder, _temporary_folder):
        try:
            folder = folder_of()
            folder.mkdir(parents=True, exist_ok=True)
            return _library_at(folder / f"{name[:32]}.so", source, command, variants)
        except (OSError, RuntimeError):  # `expanduser` raises RuntimeError
            continue
    return None


def _library_at(path: Path, source: str, command: tuple[str, ...], variants: tuple[Variant, ...]) -> Path | None:
    """Return the path of a library, which is compiled first if missing or damaged.

    Raises:
        OSError: the folder is not writable, or the system forbids loading libraries from it.
    """
    if _is_intact(path):
        ctypes.CDLL(str(path))
        return path
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        for number, (flags, libraries) in enumerate(variants):
            compiled = Path(scratch) / f"{number}.so"
            if compile_library(source, (*command, *flags), compiled, libraries) is None:
                content = compiled.read_bytes()
                compiled.write_bytes(content + hashlib.sha256(content).digest())
                # Loading fails if the C library lacks a function.
                if _loads(compiled):
                    compiled.replace(path)
                    return path
    return None


def _is_intact(path: Path) -> bool:
    """Return whether a library exists and ends with its digest."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return hashlib.sha256(content[:-_DIGEST_SIZE]).digest() == content[-_DIGEST_SIZE:]


def compile_library(source: str, command: Sequence[str], into: Path, libraries: Sequence[str]) -> str | None:
    """Compile a C source into a library.

    Args:
        source: the C source.
        command: compiler and flags.
        into: path of the library.
        libraries: linker flags for the libraries it needs.

    Returns:
        None, or the first line of the compiler's error message.
    """
    arguments = [*command, *_FLAGS, "-x", "c", "-", "-o", str(into), *libraries]
    try:
        done = subprocess.run(arguments, input=source.encode(), capture_output=True, timeout=_TIMEOUT, check=False)
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


def _cache_folder() -> Path:
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(chosen) if chosen else Path("~/.cache").expanduser()) / "plough_opt"


@lru_cache(maxsize=1)
def _temporary_folder() -> Path:
    """Return a folder that is removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="plough_opt-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@lru_cache(maxsize=4)
def _identity(command: tuple[str, ...]) -> str:
    """Return a text that identifies compiler and processor, on which a compiled library depends besides its source."""
    try:
        done = subprocess.run([*command, "--version"], capture_output=True, timeout=_TIMEOUT, check=False)
        version = done.stdout.decode(errors="replace")
    except (OSError, subprocess.SubprocessError):
        version = ""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    processor = [line for line in lines if line.startswith(("flags", "model", "Features", "CPU part"))]
    # platform.platform() would start another process to identify the processor.
    system = platform.system(), platform.release(), platform.machine(), *platform.libc_ver()
    return "\n".join((*command, version, *system, *sorted(set(processor))))
