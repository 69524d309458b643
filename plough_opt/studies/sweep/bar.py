"""The progress bar of a sweep: how much is done, how fast, and how long the rest will take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from plough_opt.core.heartbeat import heartbeat
from plough_opt.studies.sweep.engine import Told


class RateColumn(ProgressColumn):
    """Points per second of this run; those that were stored before do not count."""

    def render(self, task: Task) -> Text:
        """Return the rate as text."""
        rate = task.finished_speed or task.speed
        return Text("" if rate is None else f"{rate:.3g} points/s")


@contextmanager
def bar(console: Console) -> Iterator[Told]:
    """Show how far a sweep is, by a bar where a console is a terminal, else by lines; yield what updates it."""
    if not console.is_terminal:
        with heartbeat(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True)) as said:

            def say(stored: int, count: int, failed: int) -> None:
                said(f"sweep: {stored} of {count} points{f', {failed} failed' if failed else ''}")

            yield say
        return
    columns = (
        TextColumn("sweep"), BarColumn(bar_width=24), MofNCompleteColumn(), RateColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[failures]}"),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("sweep", total=None, failures="")
        began = False

        def told(stored: int, count: int, failed: int) -> None:
            nonlocal began
            failures = f"{failed} failed" if failed else ""
            if not began:
                # What was there before is no speed of this run.
                progress.reset(task, total=count, completed=stored, failures=failures)
                began = True
            progress.update(task, completed=stored, failures=failures)

        yield told


def silent(stored: int, count: int, failed: int) -> None:
    """Tell nobody."""
