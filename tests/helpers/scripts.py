"""The scripts of problems/ as modules, although they are in no package."""

import importlib.util
import sys
from contextlib import contextmanager

from helpers.problem_files import PROBLEMS


@contextmanager
def imported(name):
    """Yield a script as a module that is known by its name meanwhile, as classes and processes need.

    As when it is run, it finds the other scripts of its folder.
    """
    path = PROBLEMS / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(path.parent))
        del sys.modules[name]
