"""Reading of text files, and atomic writing: each file is written under a temporary name, then renamed."""

from __future__ import annotations

import difflib
import os
import secrets
import stat
import tempfile
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from importlib import import_module
from importlib.resources import files as beside
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Literal, TypeAlias

from plough_opt.core.errors import InputError, listed, short, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Content: TypeAlias = str | bytes | Callable[[IO[bytes]], object]
"""Content of a file: text (written as UTF-8), bytes, or a function that writes into a binary file."""

_LONGEST_STEM: Final = 100

BYTE_ORDER_MARK: Final = "\ufeff"
"""Character with which some editors begin a file in UTF-8."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A8A8A")
"""The colours of Okabe and Ito (2008), which colour-blind readers can distinguish, and a grey."""

CONSTANT: Final = 1e-6
"""Relative change below which a result counts as constant in pictures: smaller changes are rounding."""

# Positive values whose largest exceeds the smallest by more than this factor have a logarithmic axis.
_LOG_AXIS_RATIO: Final = 20.0


def read_text(path: Path, kind: str, ending: str, most: int, missing: str = "") -> str:
    """Return the content of a text file as it is, with its line ends and its byte order mark.

    Args:
        path: the file.
        kind: what it should be, such as "a problem file".
        ending: usual ending of such files; if the file is missing, the message suggests similar names with it.
        most: largest size [B].
        missing: what to do if there is none with that ending in the folder; by default, to check the path.

    Raises:
        InputError: the file does not exist, is a folder, JSON under another ending, a database, too long, or not UTF-8.
    """
    name = shown(str(path), 200)
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
        if ending != ".json" and content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
            raise InputError(f"{name} is JSON, not {kind}: print a saved result by plough-opt show")
        if content.startswith(b"SQLite format 3"):
            raise InputError(f"{name} is the store of a sweep of version 0.2: sweep again into a CSV file")
        if len(content) > most:
            size = f"{most // 1000} kB" if most < 1_000_000 else f"{most // 1_000_000} MB"
            raise InputError(f"{name} is too long for {kind}: at most {size} can be read")
        return content.decode()
    except FileNotFoundError:
        there = sorted(file.name for file in path.parent.glob(f"*{ending}")) if path.parent.is_dir() else []
        close = [repr(str(path.parent / file)) for file in difflib.get_close_matches(path.name, there, n=2, cutoff=0.7)]
        none = missing or f"its folder does not contain any {ending} file; check the path"
        others = f"that folder contains {short(', '.join(there), 200)}" if there else none
        hint = f"did you mean {' or '.join(close)}?" if close else others
        raise InputError(f"there is no file {name}: {hint}") from None
    except IsADirectoryError:
        raise InputError(f"{name} is a folder: name {kind} in it") from None
    except UnicodeError:
        raise InputError(f"{name} cannot be read as text: it is not UTF-8") from None
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror}") from None


@lru_cache(maxsize=8)
def text_of(package: str, name: str) -> str:
    """Return a text file that lies beside the modules of a package of this toolkit, such as C source."""
    return beside(package).joinpath(name).read_text(encoding="utf-8")


def exact_text(path: Path) -> str:
    """Return the content of a text file that `read_text` has read before."""
    return path.read_bytes().decode()


def write_file(path: str | Path, kind: str, content: Content) -> Path:
    """Write a file completely or not at all, creating its folder; return the given path.

    The target of a symbolic link is replaced, not the link. Permissions are preserved. Pipes and devices are written
    to directly.

    Args:
        path: the file; an existing one is replaced.
        kind: name of the file in messages, such as "table".
        content: content to write.

    Raises:
        InputError: the file cannot be written or the disk is full; an existing file is unchanged.
    """
    write_files({Path(path): content}, kind)
    return Path(path)


def write_files(files: Mapping[Path, Content], kind: str) -> None:
    """Write several files as `write_file` does; none is renamed to its final name before all are complete.

    Raises:
        InputError: as `write_file`.
    """
    target, moves = next(iter(files)), dict[Path, Path]()
    try:
        for target, content in files.items():
            place = Path(os.path.realpath(target))
            if place.exists() and not (place.is_file() or place.is_dir()):  # a pipe, a terminal or a device
                with place.open("wb") as stream:
                    _fill(stream, content)
                continue
            _check_place(place)
            place.parent.mkdir(parents=True, exist_ok=True)
            temporary = place.with_name(f".{place.name[:_LONGEST_STEM]}.{secrets.token_hex(4)}")
            moves[temporary] = place
            with temporary.open("xb") as file:
                if place.exists():
                    temporary.chmod(stat.S_IMODE(place.stat().st_mode))
                _fill(file, content)
                file.flush()
                os.fsync(file.fileno())  # some file systems report a full disk only now
        for temporary, place in moves.items():
            temporary.replace(place)
    except OSError as error:
        raise _write_error(kind, target, error) from None
    finally:
        for temporary in moves:
            temporary.unlink(missing_ok=True)


def check_writable(path: str | Path, kind: str) -> None:
    """Raise InputError if a file could not be written, as `write_file` would."""
    try:
        _check_place(Path(os.path.realpath(path)))
    except OSError as error:
        raise _write_error(kind, Path(path), error) from None


def _check_place(place: Path) -> None:
    """Raise OSError if a place is a folder, read-only or in no folder, or if its links lead in a circle."""
    if place.is_symlink():
        raise OSError(0, "the link leads in a circle")
    if place.is_dir():
        raise IsADirectoryError(0, "it is a folder")
    around = next(folder for folder in place.parents if folder.exists())
    if not around.is_dir():
        raise NotADirectoryError(0, f"'{around}' is not a folder")
    # An existing file is replaced by a new one, so its folder must be writable too.
    if not os.access(around, os.W_OK) or (place.exists() and not os.access(place, os.W_OK)):
        raise PermissionError(0, "permission denied")


def _fill(file: IO[bytes], content: Content) -> None:
    if callable(content):
        content(file)
    else:
        file.write(content.encode() if isinstance(content, str) else content)


def _write_error(kind: str, target: Path, error: OSError) -> InputError:
    why = error.strerror or str(error)
    return InputError(
        f"the {kind} '{target}' cannot be written: {why[:1].lower()}{why[1:]}; nothing was changed: choose another"
        " path, or free some space"
    )


def write_new(path: str | Path, kind: str, content: Content) -> Path:
    """Write a new file as `write_file` does; return its path.

    Raises:
        InputError: the file exists already or cannot be written.
    """
    if os.path.lexists(path):
        raise InputError(f"'{path}' exists already and is left as it is: name another file")
    return write_file(path, kind, content)


def write_folder(target: Path, kind: str, files: Mapping[str, Content]) -> Path:
    """Write files into a new folder, completely or not at all, creating its parents; return its path.

    Raises:
        InputError: the folder exists already or cannot be written.
    """
    try:
        _check_place(Path(os.path.realpath(target.parent / "new")))
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{target.name[:_LONGEST_STEM]}.", dir=target.parent) as scratch:
            # A subfolder has the usual permissions; only the user can read what `tempfile` creates.
            inner = Path(scratch) / "made"
            inner.mkdir()
            for name, content in files.items():
                with (inner / name).open("xb") as file:
                    _fill(file, content)
            check_new_folder(target, kind)
            inner.rename(target)
    except OSError as error:
        raise _write_error(kind, target, error) from None
    return target


def check_new_folder(path: str | Path, kind: str) -> Path:
    """Return the path of a folder to be written.

    Raises:
        InputError: the folder exists already.
    """
    target = Path(path)
    if os.path.lexists(target):
        raise InputError(f"'{target}' exists already and is left as it is: name a new folder for the {kind}")
    return target


def check_file(path: str | Path, kind: str, *endings: str) -> Path:
    """Return the path of a file to be written.

    Raises:
        InputError: the path has another ending, or is a folder.
    """
    target = Path(path)
    if target.suffix.lower() not in endings:
        raise InputError(f"'{path}' is not a valid file name for the {kind}: it must end in {listed(endings, 'or')}")
    if target.is_dir():
        raise InputError(f"'{target}' is a folder: name a file in it")
    return target


def from_above(module: str, name: str) -> Any:
    """Return a function of a module in `plough_opt.app`, imported only when it is needed.

    That package draws every kind of result and so imports all others; a regular import would be circular.

    Args:
        module: name of the module, such as "plots".
        name: name of the function.
    """
    return getattr(import_module(f"plough_opt.app.{module}"), name)


def drawn(name: str, *arguments: Any, target: str | Path | None = None) -> Figure:
    """Return a picture drawn by a function of `plough_opt.app.plots`, and write it to a file if one is given.

    Args:
        name: name of the function.
        arguments: its arguments.
        target: file to write, or None.

    Raises:
        InputError: the file name has no known ending, or the file cannot be written.
    """
    return written(from_above("plots", name)(*arguments), target)


def written(figure: Figure, target: str | Path | None) -> Figure:
    """Write a figure to a file as `save_figure` does, if one is given; return the figure."""
    if target is not None:
        save_figure(figure, target)
    return figure


def figure_of_size(width: float, height: float) -> Figure:
    """Return an empty figure of a size [inch]; matplotlib is loaded only to draw."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def figure_with_panels(count: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row, each of a size [inch]; the places after them stay empty."""
    rows = max(1, -(-count // columns))
    figure = figure_of_size(size[0] * columns, size[1] * rows)
    places = [*figure.subplots(rows, columns, squeeze=False).flat]
    for axes in places[count:]:
        axes.set_visible(False)
    return figure, places[:count]


def scale_of(values: Collection[float]) -> Literal["log", "linear"]:
    """Return the scale of an axis, or of colours, that shows values."""
    return "log" if 0.0 < _LOG_AXIS_RATIO * min(values) < max(values) else "linear"


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure to a file as `write_file` does; the ending determines the format.

    Raises:
        InputError: the ending is not a known format, or the file cannot be written.

    Example:
        >>> import tempfile
        >>> from matplotlib.figure import Figure
        >>> import plough_opt as po
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.plots.save(Figure(), f"{folder}/empty.svg")
        >>> path.name
        'empty.svg'
    """
    ending = check_format(path).suffix[1:].lower()
    return write_file(path, "plot", lambda file: draw(figure, file, dpi=130, format=ending))


def draw(figure: Figure, file: IO[bytes], **options: Any) -> None:
    """Write a figure into a file; a dollar sign in its texts, which may be a user's, does not begin a formula."""
    from matplotlib.text import Text

    axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis) if axis.get_scale() != "linear"]
    powers = {text for axis in axes for text in axis.findobj(Text) if text is not axis.label}
    for text in {*figure.findobj(Text)} - powers:
        text.set_parse_math(False)
    figure.savefig(file, **options)


def check_format(path: str | Path) -> Path:
    """Return the path of a picture to be written.

    Raises:
        InputError: the path does not end in a picture format, or is a folder.
    """
    return check_file(path, "picture", ".png", ".svg", ".pdf")
