"""The progress bar of a sweep: points done, points per second, and remaining time."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import (
    Progress as Bar,
)
from rich.text import Text

from plough_opt.core.process import heartbeat
from plough_opt.studies.sweep.engine import Progress


class RateColumn(ProgressColumn):
    """Points per second of this run, without those that were stored before."""

    def render(self, task: Task) -> Text:
        """Return the rate as text."""
        rate = task.finished_speed or task.speed
        return Text("" if rate is None else f"{rate:.3g} points/s")


@contextmanager
def bar(console: Console) -> Iterator[Progress]:
    """Show the progress of a sweep, by a bar on a terminal and else by lines; yield the function that updates it."""
    if not console.is_terminal:
        with heartbeat(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True)) as note:
            yield lambda stored, count, failed: note(
                f"sweep: {stored} of {count} points{f', {failed} failed' if failed else ''}"
            )
        return
    columns = (
        TextColumn("sweep"), BarColumn(bar_width=24), MofNCompleteColumn(), RateColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[failures]}"),
    )  # fmt: skip
    with Bar(*columns, console=console, transient=True) as shown:
        task = shown.add_task("sweep", total=None, failures="")

        def update(stored: int, count: int, failed: int) -> None:
            failures = f"{failed} failed" if failed else ""
            if shown.tasks[0].total is None:
                # Points stored before this run do not count for its speed.
                shown.reset(task, total=count, completed=stored, failures=failures)
            shown.update(task, completed=stored, failures=failures)

        yield update


def silent(stored: int, count: int, failed: int) -> None:
    """Show nothing."""
