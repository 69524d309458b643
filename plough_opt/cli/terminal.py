"""Where commands read from and write to: the problem file, the two streams, progress."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from plough_opt import design as designs
from plough_opt.problem_file import Problem, read_problem


def read(options: argparse.Namespace) -> Problem:
    """Read the problem file; refuse an impossible plot before anything is computed."""
    problem = read_problem(options.file, options.set)
    if getattr(options, "plot", None) is not None:
        from plough_opt import plots

        plots.check_format(options.plot)
    for note in problem.notes:
        Console(stderr=True).print(f"note: {note}", markup=False)
    return problem


def console() -> Console:
    """Return where results go; as wide as its tables need when it is no terminal."""
    terminal = _Console(highlight=False)
    return terminal if terminal.is_terminal else _Console(highlight=False, width=120)


class _Console(Console):
    """A console that leaves a closed pipe to `main`, which knows the exit status."""

    def on_broken_pipe(self) -> None:
        """Let the error pass."""
        raise BrokenPipeError


def wrote(path: Path) -> None:
    """Say which file was written, on the error stream."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"wrote {path}", markup=False)


@contextmanager
def progress() -> Iterator[designs.Progress]:
    """Show on the terminal's error stream what is being done, and how long it has taken."""
    stream = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), TimeElapsedColumn())
    with Progress(*columns, console=stream, transient=True, disable=not stream.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
