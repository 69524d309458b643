"""Files, and pictures as files: written whole or not at all, first beside their places, then moved there together."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Any, Final, TypeAlias

from plough_opt.core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content: TypeAlias = str | bytes | Callable[[IO[bytes]], object]
"""Content of a file: text (written as UTF-8), bytes, or a function that writes into a binary file."""

# Signals that end a process at once, and would leave unfinished files.
_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
_LONGEST_STEM: Final = 100

PICTURE_FORMATS = ("png", "svg", "pdf")

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A8A8A")
"""The colours of Okabe and Ito (2008), which colour-blind people can distinguish, and a grey."""


def write_file(path: str | Path, kind: str, content: Content) -> Path:
    """Write a file whole or not at all, making its folder; return the given path.

    A link stays, and the file that it leads to is replaced. Permissions are kept. A pipe or a device is written to
    directly.

    Args:
        path: the file; an existing one is replaced.
        kind: its name in messages, such as "table".
        content: to write.

    Raises:
        InputError: a place that cannot be written, or a full disk; an existing file is unchanged.
    """
    write_files({Path(path): content}, kind)
    return Path(path)


def write_files(files: Mapping[Path, Content], kind: str) -> None:
    """Write several files as `write_file` does; none is moved to its place before all of them are written.

    Raises:
        InputError: as `write_file`.
    """
    target = next(iter(files))
    unfinished: list[Path] = []
    try:
        with _tidied(unfinished):
            moves: list[tuple[Path, Path]] = []
            for target, content in files.items():
                if _is_stream(target):
                    with target.open("wb") as stream:
                        _fill(stream, content)
                    continue
                place = _place(target)
                _make_folder(place.parent)
                moves.append((_written_beside(place, content, unfinished), place))
            for beside, place in moves:
                beside.replace(place)
    except OSError as error:
        raise _refused(kind, target, error) from None


def write_new(path: str | Path, kind: str, content: Content) -> Path:
    """Write a file that must not exist yet as `write_file` does; return its path.

    Raises:
        InputError: it exists, or cannot be written.
    """
    if os.path.lexists(path):
        raise InputError(f"'{path}' exists already and is left as it is: name another file")
    return write_file(path, kind, content)


def write_folder(target: Path, kind: str, files: Mapping[str, Content]) -> Path:
    """Write files into a new folder, whole or not at all, making the folders around it; return its path.

    Raises:
        InputError: it exists, or cannot be written.
    """
    unfinished: list[Path] = []
    try:
        _make_folder(target.parent)
        with _tidied(unfinished):
            scratch = Path(tempfile.mkdtemp(prefix=f".{target.name[:_LONGEST_STEM]}.", dir=target.parent))
            unfinished.append(scratch)
            inner = scratch / "made"  # with the permissions of any new folder: mkdtemp gives them to the user alone
            inner.mkdir()
            for name, content in files.items():
                with (inner / name).open("xb") as file:
                    _fill(file, content)
            check_new_folder(target, kind)
            inner.rename(target)
    except OSError as error:
        raise _refused(kind, target, error) from None
    return target


def check_new_folder(path: str | Path, kind: str) -> Path:
    """Return the path of a folder to be written.

    Raises:
        InputError: it exists already.
    """
    target = Path(path)
    if os.path.lexists(target):
        raise InputError(f"'{target}' exists already and is left as it is: name a new folder for the {kind}")
    return target


def check_file(path: str | Path, ending: str, kind: str) -> Path:
    """Return the path of a file to be written.

    Raises:
        InputError: another ending, or a folder.
    """
    target = Path(path)
    if target.suffix.lower() != ending:
        raise InputError(f"'{target}' cannot be the name of the {kind}: end it in {ending}")
    if target.is_dir():
        raise InputError(f"'{target}' is a folder: name a file in it")
    return target


def _is_stream(target: Path) -> bool:
    """Return whether a path leads to a pipe, a terminal or a device."""
    try:
        mode = target.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _place(target: Path) -> Path:
    """Return the place of a file, with links followed.

    Raises:
        OSError: a folder, a file without permission to write, or links in a circle.
    """
    place = Path(os.path.realpath(target))
    if place.is_symlink():
        raise OSError(0, "the link leads in a circle")
    if place.is_dir():
        raise IsADirectoryError(0, "it is a folder")
    if place.exists() and not os.access(place, os.W_OK):
        raise PermissionError(0, "permission denied")
    return place


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(0, f"'{folder}' is not a folder") from None


def _written_beside(place: Path, content: Content, unfinished: list[Path]) -> Path:
    """Write a file with a unique name beside its place, with the permissions of the existing file; return its path."""
    beside = place.with_name(f".{place.name[:_LONGEST_STEM]}.{secrets.token_hex(4)}")
    unfinished.append(beside)
    with beside.open("xb") as file:
        if place.exists() and hasattr(os, "fchmod"):
            os.fchmod(file.fileno(), stat.S_IMODE(place.stat().st_mode))
        _fill(file, content)
        file.flush()
        os.fsync(file.fileno())  # some file systems report a full disk only now
    return beside


def _fill(file: IO[bytes], content: Content) -> None:
    if callable(content):
        content(file)
    else:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def _tidied(unfinished: Sequence[Path]) -> Iterator[None]:
    """Remove unfinished files however the writing ends: complete, by an error, or by a signal that ends the process."""

    def remove() -> None:
        for path in unfinished:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)

    def end(number: int, _frame: FrameType | None) -> None:
        remove()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)

    here = threading.current_thread() is threading.main_thread()  # the only one in which Python can catch signals
    caught = [number for number in _ENDING if here and signal.getsignal(number) is signal.SIG_DFL]
    for number in caught:
        signal.signal(number, end)
    try:
        yield
    finally:
        remove()
        for number in caught:
            signal.signal(number, signal.SIG_DFL)


def _refused(kind: str, target: Path, error: OSError) -> InputError:
    why = error.strerror or str(error)
    return InputError(
        f"the {kind} '{target}' cannot be written: {why[:1].lower()}{why[1:]}; nothing was changed: name another place,"
        " or make room there"
    )


def from_above(module: str, name: str) -> Any:
    """Return a function of the pictures' room, which knows every result and stands above them all.

    It is imported when a picture is drawn.

    Args:
        module: such as "plots".
        name: of the function.
    """
    return getattr(import_module(f"plough_opt.app.{module}"), name)


def drawn(name: str, *arguments: Any, target: str | Path | None = None) -> Figure:
    """Return a picture by a function of `plough_opt.app.plots`, written to a file where one is named.

    Args:
        name: of the function.
        arguments: what it draws.
        target: file to write, or None.

    Raises:
        InputError: a file name without a known ending, or a place that cannot be written.
    """
    figure: Figure = from_above("plots", name)(*arguments)
    if target is not None:
        save_figure(figure, target)
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure to a file whole or not at all, making its folder; the ending determines the format.

    Raises:
        InputError: an ending that is not a known format, or a place that cannot be written.
    """
    check_format(path)
    ending = Path(path).suffix[1:].lower()
    return write_file(path, "plot", lambda file: figure.savefig(file, dpi=130, format=ending))


def check_format(path: str | Path) -> None:
    """Raise InputError for a file whose ending is not a picture format, or for a folder."""
    if Path(path).suffix[1:].lower() not in PICTURE_FORMATS:
        endings = ", ".join(f".{ending}" for ending in PICTURE_FORMATS)
        raise InputError(f"the plot '{path}' has no known picture format: end its name in one of {endings}")
    if Path(path).is_dir():
        raise InputError(f"the plot '{path}' is a folder: name a file in it")
