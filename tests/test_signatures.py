"""Signatures of public names read as a user writes them."""

import inspect
import re

import pytest
from helpers.extras import needs

import plough_opt as po

ODD = re.compile(r"Annotated|<function|<lambda| at 0x|_Expression|plough_opt\.|numpy\.|typing\.|Union\[|Optional\[")


def described(thing):
    """Yield name and signature of a public function or class and of its methods, or of all names in a module."""
    if inspect.ismodule(thing):
        public = [x for name, x in vars(thing).items() if not name.startswith("_") and callable(x)]
        for value in public:
            if getattr(value, "__module__", "").startswith("plough_opt"):
                yield from described(value)
        return
    if callable(thing) and not (inspect.isclass(thing) and issubclass(thing, Exception)):
        yield thing.__name__, str(inspect.signature(thing))
    for name in dir(thing) if inspect.isclass(thing) else ():
        value = inspect.getattr_static(thing, name)
        value = getattr(value, "__func__", value)
        if inspect.isfunction(value) and value.__module__.startswith("plough_opt"):
            yield f"{thing.__name__}.{name}", str(inspect.signature(value))


@pytest.mark.parametrize("name", po.__all__)
def test_the_signature_of_a_public_name_has_no_converters(name):
    assert [(one, text) for one, text in described(getattr(po, name)) if ODD.search(text)] == []


def test_numbers_are_floats_and_a_class_of_ones_own_keeps_its_signature():
    assert str(inspect.signature(po.Wedge)) == "(angle: float, chisel_angle: float, height: float) -> None"

    class Mine(po.Wedge):
        def __init__(self, size):
            super().__init__(0.5, 0.6, size)

    assert str(inspect.signature(Mine)) == "(size)"


@pytest.mark.parametrize("name", [name for name in po.__all__ if inspect.ismodule(getattr(po, name))])
def test_a_public_module_shows_its_public_names_alone(name):
    if name == "export":
        needs("openmdao.api")
    module = getattr(po, name)
    assert sorted(dir(module)) == sorted(module.__all__)
    of_its_own = {key for key, x in vars(module).items() if getattr(x, "__module__", "") == module.__name__}
    assert {key for key in of_its_own if not key.startswith("_")} <= {*module.__all__}
    assert all(hasattr(module, key) for key in module.__all__)
