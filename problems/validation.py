"""Print tables and numbers of docs/explanation/validation.md, which hold the model against others; draw its picture.

python problems/validation.py [--plot FOLDER]
"""

import argparse
from pathlib import Path

from measured import compare
from particles import findings, sentences


def markdown(table: list[list[str]]) -> str:
    """Return a table, whose first row holds the headings, in Markdown."""
    headings, *rows = table
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (headings, ["---"] * len(headings), *rows))


def tables() -> list[str]:
    """Return all tables of the page."""
    return [markdown(table()) for table in findings.TABLES]


def main() -> None:
    """Print the tables and the parts of sentences with numbers and, on demand, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FOLDER", help="where to draw the picture")
    chosen = parser.parse_args()
    further = [markdown(table()) for table in (*findings.FURTHER, *compare.TABLES)]
    print(*tables(), *further, *sentences.sentences(), *sentences.experiment(), sep="\n\n")
    if chosen.plot:
        findings.plot(chosen.plot)


if __name__ == "__main__":
    main()
