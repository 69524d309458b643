"""Print the tables of docs/explanation/validation.md, which hold the model against others, and draw its pictures.

python problems/validation.py [--plot FOLDER]
"""

import argparse
from pathlib import Path

from measured import compare
from particles import findings


def tables() -> list[str]:
    """Return all tables of the page in Markdown."""
    found = []
    for table in (*findings.TABLES, *compare.TABLES):
        headings, *rows = table()
        lines = [headings, ["---"] * len(headings), *rows]
        found.append("\n".join("| " + " | ".join(cells) + " |" for cells in lines))
    return found


def main() -> None:
    """Print the tables and, on demand, draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FOLDER", help="where to draw both pictures")
    chosen = parser.parse_args()
    print(*tables(), sep="\n\n")
    if chosen.plot:
        findings.plot(chosen.plot / "validation_particles.png")
        compare.plot(chosen.plot / "validation_blade.png")


if __name__ == "__main__":
    main()
