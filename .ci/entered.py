"""A pytest plugin that records which functions of the package the tests enter in this process.

It compiles the package's modules with a recording call at the head of each function. The environment variable
`ENTERED` names the JSON file to write: the processor time of the session [s], and for each module the first line of
every function entered.
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
    """Return the first line of a function as Python counts it: the line of its first decorator."""
    return min(part.lineno for part in (function, *function.decorator_list))


class Recording(importlib.machinery.SourceFileLoader):
    """Compiles a module so that each of its functions records that it was entered."""

    def get_code(self, fullname):
        """Return the module's code, always compiled from its source."""
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path), path)
        module = Path(path).as_posix().rpartition(f"/{NAME}/")[2]
        for function in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]:
            call = ast.parse(f"__entered__(({module!r}, {first_line(function)}))").body[0]
            function.body.insert(1 if ast.get_docstring(function) is not None else 0, call)
        return compile(ast.fix_missing_locations(tree), path, "exec")


class Finder(importlib.machinery.PathFinder):
    """Finds the package's modules and loads them with `Recording`."""

    @classmethod
    def find_spec(cls, fullname, path=None, target=None):
        """Return the module's specification, or None outside the package."""
        if fullname.partition(".")[0] != NAME:
            return None
        spec = super().find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = Recording(spec.loader.name, spec.loader.path)
        return spec


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests():
    """Install the finder before the first module of the package is imported."""
    builtins.__entered__ = _entered.add
    sys.meta_path.insert(0, Finder)


def pytest_sessionfinish():
    """Write the record."""
    modules = defaultdict(list)
    for module, line in sorted(_entered):
        modules[module].append(line)
    record = {"seconds": time.process_time(), "entered": modules}
    Path(os.environ["ENTERED"]).write_text(json.dumps(record), encoding="utf-8")
