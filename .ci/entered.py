"""A pytest plugin that notes which functions of the package the tests enter, in this process.

The package's modules are compiled with a call at the head of each function. `ENTERED` in the environment names the
JSON file that is written: processor time of the whole session [s], and per module the first lines of the functions.
"""

import ast
import builtins
import importlib.machinery
import json
import os
import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

NAME = "plough_opt"
_entered = set()


def first_line(function):
    """Return the line at which Python says that a function begins: that of its first decorator."""
    return min(part.lineno for part in (function, *function.decorator_list))


class Noting(importlib.machinery.SourceFileLoader):
    """Compiles a module so that each of its functions says that it is entered."""

    def get_code(self, fullname):
        """Return the module's code, from its source in any case."""
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path), path)
        module = Path(path).as_posix().rpartition(f"/{NAME}/")[2]
        for function in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]:
            note = ast.parse(f"__entered__(({module!r}, {first_line(function)}))").body[0]
            function.body.insert(1 if ast.get_docstring(function) is not None else 0, note)
        return compile(ast.fix_missing_locations(tree), path, "exec")


class Finder(importlib.machinery.PathFinder):
    """Finds the package's modules, and gives them the loader above."""

    @classmethod
    def find_spec(cls, fullname, path=None, target=None):
        """Return the module's specification, or None for modules of others."""
        if fullname.partition(".")[0] != NAME:
            return None
        spec = super().find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = Noting(spec.loader.name, spec.loader.path)
        return spec


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests():
    """Take over before the first module of the package is read."""
    builtins.__entered__ = _entered.add
    sys.meta_path.insert(0, Finder)


def pytest_sessionfinish():
    """Write what was entered."""
    modules = defaultdict(list)
    for module, line in sorted(_entered):
        modules[module].append(line)
    told = {"seconds": time.process_time(), "entered": modules}
    Path(os.environ["ENTERED"]).write_text(json.dumps(told), encoding="utf-8")
