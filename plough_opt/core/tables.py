"""Tables of plain text, as results print themselves."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines with aligned columns, the first to the left, the others to the right."""
    columns = [*zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    aligned = [[f"{cell:>{width}}" for cell in column] for column, width in zip(columns, widths, strict=True)]
    aligned[0] = [f"{cell:<{widths[0]}}" for cell in columns[0]]
    return "\n".join(f"  {'  '.join(row)}".rstrip() for row in zip(*aligned, strict=True))
