"""Examples in docstrings: every public name has one, and all give the results shown."""

import doctest
import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

import plough_opt as po

ROOT = Path(__file__).parents[1]


def examples():
    """Return every docstring of the package that has an example, by its full name."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    names = [name for _, name, _ in pkgutil.walk_packages(po.__path__, "plough_opt.")]
    modules = [name for name in names if not name.endswith("__main__")]
    found = [one for name in modules for one in finder.find(importlib.import_module(name)) if one.examples]
    return {one.name: one for one in found}


EXAMPLES = examples()


@pytest.mark.parametrize("name", po.__all__)
def test_each_public_name_has_an_example(name):
    thing = getattr(po, name)
    if inspect.ismodule(thing):  # whose functions have theirs
        name = thing.__name__
        assert thing.__doc__
        return
    assert ">>> " in inspect.getdoc(thing)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run_as_shown(name, monkeypatch):
    monkeypatch.chdir(ROOT)  # where its problem files are
    one = EXAMPLES[name]
    # Run as a user's program, because some warnings appear only for values that a user passes.
    one.globs = {**one.globs, "__name__": "__main__"}
    said = []
    results = doctest.DocTestRunner().run(one, out=said.append)
    assert results.failed == 0, "".join(said)
