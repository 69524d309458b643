"""`Screen`: the console on which everything is printed, and progress on it."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.text import Text

from plough_opt.core.errors import printable
from plough_opt.core.process import heartbeat


class Screen(Console):
    """A console for texts of any origin: none is markup, and what a terminal would obey or hide is escaped."""

    def __init__(self, **options: Any) -> None:
        """Set further options of rich's console, such as ``stderr``."""
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def print_labelled(self, label: str, style: str, text: str) -> None:
        """Print a text after a label in a style, without breaking its lines."""
        self.print(Text.assemble((printable(label), style), " ", printable(text)), soft_wrap=True)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a string as rich's text, which would drop some control characters."""
        return super().render_str(printable(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield what is written, of tables and progress bars too."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError, which commands handle, instead of ending the process."""
        raise BrokenPipeError


@contextmanager
def progress_on(stream: Screen) -> Iterator[Callable[[str, float], object]]:
    """Show progress on a stream, as a bar on a terminal or as lines; yield a function of the step and the part done."""
    if stream.is_terminal:
        text = TextColumn("{task.description}", markup=False)
        columns = text, BarColumn(bar_width=24), TimeElapsedColumn(), TimeRemainingColumn()
        with Progress(*columns, console=stream, transient=True) as bar:
            task = bar.add_task("reading", total=1.0)
            yield lambda step, done: bar.update(task, description=step, completed=done)
    else:
        with heartbeat(stream.out) as note:
            yield lambda step, _done: note(step)
