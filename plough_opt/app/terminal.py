"""Input and output of commands: the problem file, output files, messages and progress."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NoReturn

from plough_opt.core.errors import InputError, printable
from plough_opt.core.files import check_file, check_format, check_writable, save_figure, write_file
from plough_opt.core.process import optional
from plough_opt.core.screen import Screen, progress_on

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from plough_opt.core.tables import Page
    from plough_opt.design import Progress
    from plough_opt.problem_file import Problem

# Messages of the commands are shown unless -q is given; those of the library need -v.
LOG = logging.getLogger(__name__)
_LIBRARY = logging.getLogger("plough_opt")
_LEVELS: Final = (logging.WARNING, logging.INFO, logging.DEBUG)


class _Lines(logging.Formatter):
    """Messages as lines, without what a terminal would obey."""

    def format(self, record: logging.LogRecord) -> str:
        """Return a message as a line."""
        return printable(super().format(record))


@contextmanager
def messages(options: argparse.Namespace) -> Iterator[None]:
    """Show messages during one command, as many as -q and -v request."""
    verbose = min(options.verbose, len(_LEVELS) - 1)
    handler = logging.StreamHandler()
    handler.setFormatter(_Lines("%(relativeCreated)8.0f ms  %(message)s" if verbose else None))
    before = _LIBRARY.level, LOG.level
    _LIBRARY.addHandler(handler)
    _LIBRARY.setLevel(_LEVELS[verbose])
    LOG.setLevel(logging.ERROR if options.quiet else logging.DEBUG if verbose else logging.INFO)
    try:
        yield
    finally:
        _LIBRARY.removeHandler(handler)
        _LIBRARY.setLevel(before[0])
        LOG.setLevel(before[1])


def quiet() -> bool:
    """Return True under -q."""
    return not LOG.isEnabledFor(logging.INFO)


def read(options: argparse.Namespace) -> Problem:
    """Return the problem file, after checking before any computation that all outputs can be written.

    Raises:
        InputError: the file has a mistake, or an output cannot be written or would overwrite an input.
    """
    from plough_opt.problem_file import read_problem  # needs numerical libraries, which other commands do without

    problem = read_problem(options.file, options.set)
    check_outputs(options)
    for note in (*problem.notes, *problem.cautions):
        LOG.info("note: %s", note)
    return problem


def check_outputs(options: argparse.Namespace) -> None:
    """Check the paths of all output files.

    Raises:
        InputError: an output is an input or another output, cannot be written, or is a picture of an unknown format.
    """
    if getattr(options, "plot", None) is not None:
        check_format(options.plot)
    if (table := getattr(options, "csv", None)) is not None:
        own = options.function in ("tradeoff", "sweep")  # which write CSV without pandas
        for name in ["pandas", "openpyxl"] if _is_workbook(table) else [] if own else ["pandas"]:
            optional(name)
    file = getattr(options, "file", [])
    inputs = dict.fromkeys(file, "an input file") if isinstance(file, list) else {file: "the problem file"}
    inputs |= dict.fromkeys(getattr(options, "data", ()), "a data file")
    taken = {_place(path): what for path, what in inputs.items()}
    for name in ("plot", "csv", "output", "description"):
        if (path := getattr(options, name, None)) is None:
            continue
        if path == "-":
            raise InputError(f"--{name} - would write a file of this name: name a file; --json prints the result")
        place = _place(path)
        if other := taken.get(place):
            raise InputError(f"--{name} '{path}' is {other}, which it would overwrite: name another file")
        taken[place] = f"also the file of --{name}"
        if name == "csv" and Path(path).suffix:
            check_file(path, "table", ".csv", ".xlsx")
        if not (hasattr(options, "to") and Path(path).is_dir()):  # an export may be a folder
            check_writable(path, f"file of --{name}")


def _place(path: str) -> str:
    """Return the absolute path with links resolved, also if they lead in a circle."""
    if "\0" in path:
        raise InputError(f"{path!r} cannot be a path: it contains a null character")
    return os.path.realpath(path)


_interrupted = threading.Event()
_written: list[Path] = []


@contextmanager
def interruptible() -> Iterator[None]:
    """Record a Ctrl-C, so that `progress` can stop the command even if CasADi swallowed the KeyboardInterrupt.

    CasADi reports an exception in a callback as a failed evaluation, after which a solve would continue.
    """
    _interrupted.clear()
    _written.clear()
    main, before = threading.current_thread() is threading.main_thread(), signal.getsignal(signal.SIGINT)
    if not main or before is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    _interrupted.set()
    raise KeyboardInterrupt


def _stop_if_interrupted() -> None:
    if _interrupted.is_set():
        raise KeyboardInterrupt


def what_was_written() -> str:
    """Return a sentence on the files that an interrupted command has written."""
    return "no other file was written" if _written else "no file was written"


def console() -> Screen:
    """Return the console for results; wide enough for all tables if it is not a terminal."""
    terminal = Screen()
    return terminal if terminal.is_terminal else Screen(width=120)


def print_page(to: Screen, page: Page) -> None:
    """Print the page of a result: its tables, sentences and notes."""
    if page.title:
        to.print(page.title, style="bold")
    if page.heading:
        to.print(page.heading, soft_wrap=True)
    for part in page.parts:
        to.print(part, soft_wrap=isinstance(part, str))
    for note in dict.fromkeys(page.notes):
        to.print_labelled("Note:", "yellow", f"{note}.")
    if page.footer:
        to.print(page.footer, soft_wrap=True)


def give(
    options: argparse.Namespace,
    page: Page,
    to_json: Callable[[], str],
    plot: Callable[[], Figure] | None,
    frame: Callable[[], Any],
    to_csv: Callable[[str], Path] | None = None,
) -> None:
    """Print a result as a page, or as JSON with --json; write its picture, its table and its JSON where options say so.

    Args:
        options: the options of the command.
        page: the page of the result.
        to_json: function that returns the result as JSON.
        plot: function that returns its picture, or None.
        frame: function that returns its table as a data frame.
        to_csv: function that writes a CSV file, if it needs no data frame.
    """
    from plough_opt.core.tables import write_frame

    if options.json:
        print(to_json())
    else:
        print_page(console(), page)
    if plot is not None and options.plot is not None:
        wrote(save_figure(plot(), options.plot))
    if (path := options.csv) is not None:
        wrote(to_csv(path) if to_csv is not None and not _is_workbook(path) else write_frame(path, frame()))
    if options.output is not None:
        wrote(write_file(options.output, "output", f"{to_json()}\n"))


def _is_workbook(path: str) -> bool:
    return path.lower().endswith(".xlsx")


def wrote(path: Path) -> None:
    """Log the name of a written file."""
    _written.append(path)
    LOG.info("wrote %s", path)


@contextmanager
def progress() -> Iterator[Progress]:
    """Yield a function that shows the present step on the error stream: a bar on a terminal, otherwise lines."""
    last, debugs = "", quiet() or LOG.isEnabledFor(logging.DEBUG)
    with nullcontext(None) if debugs else progress_on(Screen(stderr=True)) as show:

        def notify(stage: str, fraction: float) -> None:
            nonlocal last
            _stop_if_interrupted()
            if show is not None:
                show(stage, fraction)
            elif stage != last:
                last = stage
                LOG.debug(stage)

        yield notify
    _stop_if_interrupted()
