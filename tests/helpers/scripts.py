"""The scripts of problems/ as modules, although they are in no package."""

import importlib.util
import sys
from contextlib import contextmanager

from helpers.problem_files import PROBLEMS


@contextmanager
def imported(name):
    """Yield a script as a module that is known by its name meanwhile, as classes and processes need."""
    spec = importlib.util.spec_from_file_location(name, PROBLEMS / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        yield module
    finally:
        del sys.modules[name]
