"""Services of the running process: processors, error stream, progress lines, additions, libraries, signatures."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from importlib.metadata import entry_points
from inspect import Parameter, formatannotation, isclass, isfunction, ismodule, signature, unwrap
from types import SimpleNamespace
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from plough_opt.core.errors import InputError

# A context variable, so that other threads keep their own values.
_one_of_several: ContextVar[bool] = ContextVar("one_of_several", default=False)

# Prefix of every line that CasADi prints.
_PREFIX: Final = "CasADi - "
# Text of the lines that commands suppress.
_NOTICE: Final = "Event support is experimental"

INTERVAL: Final = 10.0
"""Seconds between progress lines; after a longer silence a user may think that the process hangs."""

GROUP: Final = "plough_opt"
"""Group of entry points: ``[project.entry-points.plough_opt]`` in a package's pyproject.toml."""


def available() -> int:
    """Return the number of processors, at least 1, that the calling code may use.

    It is the process's affinity, which `taskset`, containers and batch systems restrict.
    """
    if _one_of_several.get():
        return 1
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on; it respects -X cpu_count too
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_of_several() -> Iterator[None]:
    """Make `available` return 1 inside this context, because other workers use the other processors."""
    token = _one_of_several.set(True)
    try:
        yield
    finally:
        _one_of_several.reset(token)


class Sieve:
    """A stream that forwards everything except CasADi's notices that event support is experimental.

    CasADi prints one for every integrator with events and for each of its derivatives. Every run is checked by a second
    one, so users do not need them.

    CasADi writes a line in pieces. A line with its prefix is therefore buffered, separately for each thread, until it
    is complete; any other text is forwarded at once.
    """

    def __init__(self, stream: Any) -> None:
        """Set the stream to forward to."""
        self.stream = stream
        self._buffer = threading.local()

    def write(self, text: str) -> int:
        """Forward text, or buffer it until the line is complete."""
        line = getattr(self._buffer, "line", "") + text
        incomplete = line.startswith(_PREFIX) and not line.endswith("\n")
        self._buffer.line = line if incomplete else ""
        if not incomplete and not (line.startswith(_PREFIX) and _NOTICE in line):
            self.stream.write(line)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream."""
        return getattr(self.stream, name)


_sieving = threading.Lock()
_sieves: list[Sieve] = []  # one entry for each context that is entered


@contextmanager
def without_notices() -> Iterator[None]:
    """Suppress CasADi's notices on the error stream inside this context; threads share one sieve."""
    with _sieving:
        own = sys.stderr if isinstance(sys.stderr, Sieve) else Sieve(sys.stderr)
        if sys.stderr is not None:  # a process can be started without an error stream
            sys.stderr = own
        _sieves.append(own)
    try:
        yield
    finally:
        with _sieving:
            _sieves.remove(own)
            if own not in _sieves and sys.stderr is own:
                sys.stderr = own.stream


@contextmanager
def heartbeat(write: Callable[[str], object]) -> Iterator[Callable[[str], None]]:
    """Write the current activity and the elapsed time every few seconds; yield a function that sets the activity.

    A computation shorter than `INTERVAL` writes nothing.

    Args:
        write: called with each line, from another thread.
    """
    activity, done, started = "working", threading.Event(), time.monotonic()

    def beat() -> None:
        # If the stream is closed, writing the results raises the error.
        with contextlib.suppress(OSError, ValueError):
            while not done.wait(INTERVAL):
                write(f"{activity}: {time.monotonic() - started:.0f} s so far")

    def note(text: str) -> None:
        nonlocal activity
        activity = text

    thread = threading.Thread(target=beat, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield note
    finally:
        done.set()
        thread.join()


def load_additions() -> None:
    """Import the modules that installed packages declare as additions; each adds itself to a registry.

    Raises:
        InputError: a module cannot be imported; the message gives it, its package and the reason.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist is not None else "an installed package"
            raise InputError(
                f"the addition '{entry.name}' = {entry.value} of {package} cannot be imported"
                f" ({type(error).__name__}: {error}): repair it, or uninstall {package}"
            ) from error


def additions() -> set[str]:
    """Return the top-level packages that installed packages declare as additions."""
    return {entry.module.partition(".")[0] for entry in entry_points(group=GROUP)}


# Module of a library -> the extra of this package that installs it.
_EXTRAS: Final = {
    "build123d": "step", "distributed": "cluster", "ezdxf": "parts", "jinja2": "report", "openmdao.api": "openmdao",
    "pandas": "pandas", "trimesh": "parts",
}  # fmt: skip


def optional(name: str) -> Any:
    """Return a module of a library that an extra of this package installs, or that users install themselves.

    Raises:
        InputError: the library, or one that it needs, is not installed; the message names the extra.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        wanted = f"plough_opt[{_EXTRAS[name]}]" if name in _EXTRAS else name
        raise InputError(f"{missing.name or name} is not installed: pip install '{wanted}'") from None


# Types as Python writes them -> as a user does. An expression is a number, an array or a CasADi symbol.
_SHORT: Final = {
    r"Annotated\[(.*?), \w+\(\)\]": r"\1",
    r"\b[a-z_]\w*\.(?=\w)": "",  # names of modules
    r"\b(?:_?Expression|MaybeInfinite|IntervalEnd)\b": "float",
    r"\b(?:Array|Column)\b": "ndarray",
    r"\bndarray\[(?:tuple\[Any, \.\.\.\]|Any), dtype\[float64\]\]|\bNDArray\[float64\]": "ndarray",
    r"\bNoneType\b": "None",
}
# A union within another type.
_UNION: Final = re.compile(r"\bUnion\[((?:[^\[\]]|\[[^\[\]]*\])*)\]")


class _Words(str):
    """A text that stands in a signature without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return the text."""
        return str(self)


def readable(thing: Any) -> Any:
    """Return a function, class or module after giving its public functions and methods readable signatures.

    ``dir`` of a module then lists its public names, without those that it imports.
    """
    if isclass(thing):
        inner = [value for kind in thing.__mro__ if _is_here(kind) for value in vars(kind).values()]
        for value in inner:
            if isfunction(own := getattr(value, "__func__", value)):
                _describe(own)
    elif ismodule(thing):
        for name, value in vars(thing).items():
            if not (name.startswith("_") or ismodule(value)) and _is_here(value):
                readable(value)
        if public := getattr(thing, "__all__", None):
            vars(thing)["__dir__"] = lambda: [*public]
    elif isfunction(unwrap(thing)):
        _describe(thing)
    return thing


def _is_here(thing: Any) -> bool:
    """Return whether the toolkit defines a function or class."""
    return str(getattr(thing, "__module__", "")).partition(".")[0] == "plough_opt"


def _describe(function: Any) -> None:
    """Give a function a readable signature, which `help` and editors show; that of `__init__` is its class's too."""
    if "__signature__" in vars(function):
        return
    written = signature(function)
    parameters = [one.replace(annotation=_words(one.annotation)) for one in written.parameters.values()]
    function.__signature__ = written.replace(parameters=parameters, return_annotation=_words(written.return_annotation))


def _words(annotation: Any) -> Any:
    """Return an annotation in words, without what `Annotated` adds for converters."""
    if annotation is Parameter.empty:
        return annotation
    if not isinstance(annotation, str):
        annotation = get_type_hints(SimpleNamespace(__annotations__={"it": annotation}))["it"]
        if get_origin(annotation) is Union:
            return _Words(" | ".join(map(_words, get_args(annotation))))
        annotation = formatannotation(annotation)
    for pattern, words in _SHORT.items():
        annotation = re.sub(pattern, words, annotation)
    return _Words(_UNION.sub(lambda inner: re.sub(r", (?![^\[]*\])", " | ", inner[1]), annotation))
