"""Pictures as files: known formats, written whole or not at all; and their colours."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plough_opt.core.errors import InputError
from plough_opt.core.files import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A8A8A")
"""The colours of Okabe and Ito (2008), which colour-blind people can distinguish, and a grey."""


def from_above(module: str, name: str) -> Any:
    """Return a function of the pictures' room, which knows every result and stands above them all.

    It is imported when a picture is drawn.

    Args:
        module: such as "plots".
        name: of the function.
    """
    return getattr(import_module(f"plough_opt.app.{module}"), name)


def drawn(name: str, *arguments: Any, target: str | Path | None = None) -> Figure:
    """Return a picture by a function of `plough_opt.plots`, written to a file where one is named.

    Args:
        name: of the function.
        arguments: what it draws.
        target: file to write, or None.

    Raises:
        InputError: a file name without a known ending, or a place that cannot be written.
    """
    figure: Figure = from_above("plots", name)(*arguments)
    if target is not None:
        save(figure, target)
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure to a file whole or not at all, making its folder; the ending determines the format.

    Raises:
        InputError: an ending that is not a known format, or a place that cannot be written.
    """
    check_format(path)
    ending = Path(path).suffix[1:].lower()
    return write_file(path, "plot", lambda file: figure.savefig(file, dpi=130, format=ending))


def check_format(path: str | Path) -> None:
    """Raise InputError for a file whose ending is not a picture format, or for a folder."""
    if Path(path).suffix[1:].lower() not in FORMATS:
        endings = ", ".join(f".{ending}" for ending in FORMATS)
        raise InputError(f"the plot '{path}' has no known picture format: end its name in one of {endings}")
    if Path(path).is_dir():
        raise InputError(f"the plot '{path}' is a folder: name a file in it")
