"""`make lines` counts code without docstrings, comments and blank lines."""

import runpy
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / ".ci" / "lines.py"


def test_only_code_counts():
    count = runpy.run_path(str(SCRIPT))["lines_of_code"]
    head = '"""A module\nof two lines."""\n\n# a comment\nimport math  # behind code\n\n\n'
    source = head + 'def f():\n    """Text."""\n    return (\n        1\n    )\n'
    # The import, the def, and the three lines of the return.
    assert count(source) == 5
    assert count("") == 0
