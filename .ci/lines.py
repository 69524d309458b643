"""Count lines of code by room: without docstrings, comments and blank lines.

python .ci/lines.py [FOLDER ...]
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

# Tokens that do not count as code.
_SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def lines_of_code(source: str) -> int:
    """Return the number of lines that hold code."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            text = node.body[0]
            docstrings |= {*range(text.lineno, (text.end_lineno or text.lineno) + 1)}
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    code = {line for t in tokens if t.type not in _SILENT for line in range(t.start[0], t.end[0] + 1)}
    return len(code - docstrings)


def main(folders: list[str]) -> None:
    """Print the count of each room, and the total of each folder."""
    for folder in folders:
        rooms: Counter[str] = Counter()
        for path in sorted(Path(folder).rglob("*.py")):
            room = path.relative_to(folder).parts
            rooms[room[0] if len(room) > 1 else "."] += lines_of_code(path.read_text(encoding="utf-8"))
        for room, count in sorted(rooms.items()):
            print(f"{count:7d}  {folder}/{room}")
        print(f"{sum(rooms.values()):7d}  {folder}")


if __name__ == "__main__":
    main(sys.argv[1:] or ["plough_opt", "tests"])
