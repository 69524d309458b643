"""Count lines of code by room, without docstrings, comments and blank lines, and how many pieces a folder is made of.

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


def rooms(folder: Path) -> Counter[str]:
    """Return the number of lines of code of each room of a folder; "." is for files that are in none."""
    lines: Counter[str] = Counter()
    for path in folder.rglob("*.py"):
        room = path.relative_to(folder).parts
        lines[room[0] if len(room) > 1 else "."] += lines_of_code(path.read_text(encoding="utf-8"))
    return lines


def pieces(folder: Path) -> dict[str, int]:
    """Return how many files, functions, classes and numbers at module level a folder has, and its longest function."""
    sources = [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]
    trees = [ast.parse(source) for source in sources]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return {
        "files": len(sources),
        "functions": len(functions),
        "classes": sum(isinstance(node, ast.ClassDef) for node in nodes),
        "numbers": sum(_is_number(node) for tree in trees for node in tree.body),
        "longest": max((_length(function) for function in functions), default=0),
    }


def _is_number(node: ast.stmt) -> bool:
    """Return whether a statement gives a number a name in capitals."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    name = node.targets[0] if isinstance(node, ast.Assign) else node.target
    value = {type(part) for part in ast.walk(node.value)}
    arithmetic = {ast.Constant, ast.UnaryOp, ast.USub, ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow}
    constants = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
    numeric = bool(constants) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in constants)
    return isinstance(name, ast.Name) and name.id.isupper() and value <= arithmetic and numeric


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of a function's lines without its docstring."""
    first = function.body[0]
    has_docstring = ast.get_docstring(function, clean=False) is not None
    docstring = (first.end_lineno or first.lineno) - first.lineno + 1 if has_docstring else 0
    return (function.end_lineno or function.lineno) - function.lineno + 1 - docstring


def main(folders: list[str]) -> None:
    """Print the lines of each room, the total of each folder and its pieces."""
    for folder in folders:
        lines = rooms(Path(folder))
        for room, count in sorted(lines.items()):
            print(f"{count:7d}  {folder}/{room}")
        print(f"{lines.total():7d}  {folder}: {pieces(Path(folder))}")


if __name__ == "__main__":
    main(sys.argv[1:] or ["plough_opt", "tests"])
