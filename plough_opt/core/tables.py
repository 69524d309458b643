"""Tables of results, shown as plain text, in notebooks and on the command line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any, TypeAlias

from plough_opt.core.errors import printable
from plough_opt.core.files import draw
from plough_opt.core.process import optional

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.table import Table


def text_table(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> str:
    """Return rows as text with aligned columns; columns with a number in `left` are aligned left, others right."""
    columns = [*zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    aligned = [
        [f"{cell:{'<' if k in left else '>'}{width}}" for cell in column]
        for k, (column, width) in enumerate(zip(columns, widths, strict=True))
    ]
    return "\n".join(f"  {'  '.join(row)}".rstrip() for row in zip(*aligned, strict=True))


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        heading: text above the column.
        left: whether cells are aligned left.
        fold: whether cells may be broken within a word on a narrow screen; other columns break between words.
        mark: whether cells are highlighted, because they report something unusual.
    """

    heading: str = ""
    left: bool = False
    fold: bool = False
    mark: bool = False


@dataclass
class Grid:
    """A table of texts.

    Attributes:
        columns: from left to right.
        title: text above the table.
        caption: text below the table.
        rows: cells of each row.
        bold: numbers of the rows in bold.
        ends: numbers of the rows followed by a rule.
        plain: whether it is drawn without a frame, for a table as wide as a page.
    """

    columns: tuple[Column, ...]
    title: str = ""
    caption: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)
    bold: list[int] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    plain: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError if a row does not have one cell per column."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"a row has {len(row)} cells, but the table has {len(self.columns)} columns")

    @classmethod
    def of(cls, title: str, *headings: str, left: Sequence[str] = (), fold: Sequence[str] = (), mark: str = "") -> Grid:
        """Return an empty table.

        Args:
            title: text above the table.
            headings: of the columns; the first column is aligned left.
            left: headings of further columns that are aligned left.
            fold: headings of columns that may be broken within a word.
            mark: heading of the column whose cells are highlighted.
        """
        return cls(tuple(Column(h, k == 0 or h in left, h in fold, k > 0 and h == mark)
                         for k, h in enumerate(headings)), title)  # fmt: skip

    @classmethod
    def pairs(cls, title: str, *rows: tuple[str, str]) -> Grid:
        """Return a table of names and values without headings."""
        return cls((Column(left=True), Column()), title, rows=[*rows])

    def row(self, *cells: str, bold: bool = False, end: bool = False) -> None:
        """Add a row."""
        if bold:
            self.bold.append(len(self.rows))
        if end:
            self.ends.append(len(self.rows))
        self.rows.append(cells)

    @property
    def headed(self) -> bool:
        """Whether any column has a heading."""
        return any(column.heading for column in self.columns)

    def __str__(self) -> str:
        """Return the table as plain text."""
        headings = [tuple(" ".join(text.split()) for text in self._headings())] if self.headed else []
        # A cell with several lines takes as many rows of text.
        rows = [line for row in self._cells() for line in _lines(row)]
        text = text_table([*headings, *rows], [k for k, column in enumerate(self.columns) if column.left])
        return "\n".join(part for part in (printable(self.title), text, printable(self.caption)) if part)

    def _headings(self) -> list[str]:
        """Return the headings of the columns as they are shown."""
        return [printable(column.heading) for column in self.columns]

    def _cells(self) -> list[list[str]]:
        """Return the cells of all rows as they are shown."""
        return [[*map(printable, row)] for row in self.rows]

    def __rich__(self) -> Table:
        """Return the table for a terminal."""
        from rich.box import HEAVY_HEAD, SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        table = Table(title=Text(printable(self.title), "table.title") if self.title else None,
                      caption=Text(printable(self.caption), "table.caption") if self.caption else None,
                      show_header=self.headed, box=SIMPLE_HEAD if self.plain else HEAVY_HEAD,
                      caption_justify="left" if self.plain else "center", show_edge=not self.plain,
                      pad_edge=not self.plain, padding=(0, 1, 0, 0) if self.plain else (0, 1))  # fmt: skip
        for heading, column in zip(self._headings(), self.columns, strict=True):
            table.add_column(
                Text(heading),
                justify="left" if column.left else "right",
                overflow="fold" if column.fold else "ellipsis",
                style="yellow" if column.mark else "",
            )
        for k, row in enumerate(self._cells()):
            table.add_row(*map(Text, row), style="bold" if k in self.bold else None, end_section=k in self.ends)
        return table

    def html(self) -> str:
        """Return the table as HTML."""
        left = ["left" if column.left else "right" for column in self.columns]

        def row(cells: Sequence[str], tag: str, style: str = "") -> str:
            inner = "".join(
                f'<{tag} style="text-align: {side}">{_escaped(cell)}</{tag}>'
                for cell, side in zip(cells, left, strict=True)
            )
            return f"<tr{style}>{inner}</tr>"

        lines = [row(self._headings(), "th")] if self.headed else []
        lines += [row(cells, "td", ' style="font-weight: bold"' if k in self.bold else "")
                  for k, cells in enumerate(self._cells())]  # fmt: skip
        title = f'<caption style="text-align: left">{_escaped(self.title)}</caption>' if self.title else ""
        below = f"<p>{_escaped(self.caption)}</p>" if self.caption else ""
        return f"<table>{title}{''.join(lines)}</table>{below}"


def _escaped(text: str) -> str:
    """Return a text as HTML, with its lines."""
    return escape(printable(text)).replace("\n", "<br>")


def _lines(row: Sequence[str]) -> list[tuple[str, ...]]:
    """Return a row whose cells may have several lines as rows of single lines."""
    cells = [cell.splitlines() or [""] for cell in row]
    most = max(map(len, cells))
    return [tuple(cell[k] if k < len(cell) else "" for cell in cells) for k in range(most)]


Part: TypeAlias = Grid | str


@dataclass(frozen=True)
class Page:
    """A result as shown to the user.

    Attributes:
        heading: one line that says what was found.
        parts: tables and sentences, in order.
        notes: remarks that readers of the numbers must know, each without its full stop.
        footer: how far the numbers can be trusted.
        title: title of the question, shown first.
    """

    heading: str
    parts: tuple[Part, ...] = ()
    notes: tuple[str, ...] = ()
    footer: str = ""
    title: str = ""

    def __str__(self) -> str:
        """Return the page as plain text."""
        notes = (f"Note: {text}." for text in dict.fromkeys(self.notes))
        parts = (self.title, self.heading, *map(str, self.parts), *notes, self.footer)
        return "\n".join(printable(part) for part in parts if part)

    def html(self, picture: str = "") -> str:
        """Return the page as HTML, with a picture after its tables."""
        parts = (part.html() if isinstance(part, Grid) else f"<p>{_escaped(part)}</p>" for part in self.parts)
        notes = "".join(f"<li>{_escaped(text)}.</li>" for text in dict.fromkeys(self.notes))
        heading = f"<p>{_escaped(self.heading)}</p>" if self.title else ""
        footer = f"<p>{_escaped(self.footer)}</p>" if self.footer else ""
        return (
            f"<div><p><b>{_escaped(self.title or self.heading)}</b></p>{heading}{''.join(parts)}{picture}"
            f"{f'<ul>{notes}</ul>' if notes else ''}{footer}</div>"
        )


class Readable(ABC):
    """A result that prints as tables, and shows them and its picture in a notebook.

    Subclasses define `page`, and `plot` if they have a picture.
    """

    @abstractmethod
    def page(self) -> Page:
        """Return tables and text that present the result."""

    def shown_page(self) -> Page:
        """Return the page; for a result read from a file, the page as it was saved."""
        return getattr(self, "_shown", None) or self.page()

    def picture(self) -> Figure | None:
        """Return the picture shown in a notebook, or None."""
        plot = getattr(self, "plot", None)
        return None if plot is None else plot()

    def __str__(self) -> str:
        """Return the page as plain text."""
        return str(self.shown_page())

    def __repr__(self) -> str:
        """Return one line that says what was found, because all numbers would fill pages."""
        return f"<{type(self).__name__}: {printable(self.shown_page().heading)}>"

    def _repr_html_(self) -> str:
        """Return tables and picture as HTML for a notebook."""
        figure = self.picture()
        return self.shown_page().html("" if figure is None else _image(figure))


def _image(figure: Figure) -> str:
    """Return a picture as an HTML image that holds its own data, so that no separate file is needed."""
    from base64 import b64encode
    from io import BytesIO

    file = BytesIO()
    draw(figure, file, format="png", dpi=80)
    return f'<img alt="picture of the result" src="data:image/png;base64,{b64encode(file.getvalue()).decode()}">'


def data_frame(columns: Mapping[str, Any], units: Mapping[str, str]) -> pandas.DataFrame:
    """Return columns as a pandas DataFrame; ``attrs["units"]`` gives each column's unit, "" for a pure number.

    Raises:
        InputError: pandas is not installed.
    """
    frame: pandas.DataFrame = optional("pandas").DataFrame(dict(columns))
    frame.attrs["units"] = {name: units[name] for name in columns if name in units}
    return frame
