"""`Screen`: the console on which everything is printed."""

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from plough_opt.core.errors import printable


class Screen(Console):
    """A console for texts of any origin: none is markup, and what a terminal would obey or hide is escaped."""

    def __init__(self, **options: Any) -> None:
        """Set further options of rich's console, such as ``stderr``."""
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def print_labelled(self, label: str, style: str, text: str, *, soft_wrap: bool = False) -> None:
        """Print a text after a label in a style."""
        self.print(Text.assemble((printable(label), style), " ", printable(text)), soft_wrap=soft_wrap)

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
