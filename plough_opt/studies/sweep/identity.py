"""A digest of the code and the values that a function's results depend on, by which a store recognises its own sweep.

It covers the function's code, defaults, attributes, closure, imports and the globals that it names, the state and the
class of objects, and so on inwards. Modules of the standard library and of installed packages are identified by name
and, if they have one, version. The bytecode of functions is compared and not their source, so comments and the place in
a file do not matter; a module of a user's is compared as text, with the modules that it imports. No module is imported
for that.
"""

import contextlib
import copyreg
import dis
import functools
import hashlib
import importlib.metadata
import importlib.util
import itertools
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CellType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
    WrapperDescriptorType,
)
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_casadi

# Types whose repr is their whole content.
_PLAIN: Final = (type(None), bool, int, float, complex, str, bytes, type(...), type(NotImplemented), range, slice)
# Types that are identified by name, because they hold no code of a user's.
_NAMED: Final = (BuiltinFunctionType, GetSetDescriptorType, MemberDescriptorType, WrapperDescriptorType, np.ufunc)
# What code does, without its name and its place in a file.
_OF_CODE: Final = (
    "co_code", "co_consts", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_argcount",
    "co_posonlyargcount", "co_kwonlyargcount", "co_flags", "co_exceptiontable",
)  # fmt: skip
# What Python itself keeps in a class.
_KEPT: Final = {"__module__", "__qualname__", "__dict__", "__weakref__", "__doc__", "__annotations__",
                "__static_attributes__", "__firstlineno__", "__annotate_func__", "__annotations_cache__",
                "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__abstractmethods__"}  # fmt: skip
_CACHE: Final = type(functools.lru_cache(lambda: None))
_STANDARD: Final = Path(sysconfig.get_path("stdlib")).resolve()


def digest_of(item: object) -> str:
    """Return a digest of a function or an object, the same in every process on a machine.

    Raises:
        InputError: a part of it has no content that another process would recognise, such as a lock or an open file, or
            lies too deep.
    """
    try:
        return _Reader().digest(item).hex()[:16]
    except RecursionError:
        raise InputError(
            f"a store cannot recognise the function again, because {shown(item)} refers to objects that are nested too"
            " deeply: use a flatter structure, or sweep without a store"
        ) from None


@dataclass(frozen=True)
class _Source:
    """A module: its name, and its file if it has one."""

    name: str
    file: str | None

    @property
    def installed(self) -> bool:
        """Whether it belongs to Python, to this package or to an installed one."""
        top, parts = self.name.partition(".")[0], Path(self.file or "").parts
        if top in sys.stdlib_module_names:  # a file of the user's may have such a name
            return self.file is None or Path(self.file).resolve().is_relative_to(_STANDARD)
        return top == "plough_opt" or not {"site-packages", "dist-packages"}.isdisjoint(parts)


class _Reader:
    """Reads an object and everything that it refers to, each object once."""

    def __init__(self) -> None:
        # id -> object, which is kept so that the id remains its own, and its digest; while it is read, its number.
        self._read: dict[int, tuple[object, bytes]] = {}
        self._sources: dict[str | None, _Source | None] = {}

    def digest(self, item: Any) -> bytes:
        """Return the digest of an object."""
        if type(item) in _PLAIN:
            return _hash(type(item).__name__, repr(item))
        if id(item) not in self._read:
            self._read[id(item)] = item, _hash("itself", str(len(self._read)))
            kind, parts = self._parts(item)
            self._read[id(item)] = item, _hash(kind, *map(self.digest, parts))
        return self._read[id(item)][1]

    def _parts(self, item: Any) -> tuple[str, Iterable[Any]]:
        """Return a text and objects that together are the content of an object."""
        if isinstance(item, ModuleType):
            others = (value.__name__ for value in vars(item).values() if isinstance(value, ModuleType))
            return "module", map(self._source, (item.__name__, *others))
        if isinstance(item, _Source):
            if item.installed:
                return f"module {item.name} {_version(item)}", ()
            return f"module {item.name}", self._contents(item)
        function = isinstance(item, FunctionType)
        # `functools.wraps` copies the name of another function's module.
        module = item.__globals__.get("__name__") if function else getattr(item, "__module__", None)
        name = f"{module}.{getattr(item, '__qualname__', '')}"
        if isinstance(item, type | FunctionType) and (source := self._source(module)) and source.installed:
            return f"{name} {_version(source)}", ()
        if isinstance(item, type):
            return f"class {name}", (*item.__bases__, *_attributes(item))
        if isinstance(item, FunctionType):
            parts = (item.__code__, item.__defaults__, item.__kwdefaults__, item.__closure__, item.__dict__)
            imports = self._imports(item.__code__, item.__globals__.get("__package__") or "")
            return "function", (*parts, *_globals(item.__code__, item.__globals__), *imports)
        if isinstance(item, CodeType):
            return "code", [getattr(item, name) for name in _OF_CODE]
        if isinstance(item, _NAMED):
            owner = getattr(item, "__self__", None)
            return f"{type(item).__name__} {name or item.__name__}", () if isinstance(owner, ModuleType) else (owner,)
        if isinstance(item, set | frozenset):
            return type(item).__name__, sorted(_Reader().digest(part) for part in item)
        if (type(item) is np.ndarray or isinstance(item, np.generic)) and not item.dtype.hasobject:
            return f"array {item.dtype.descr} {np.shape(item)}", (item.tobytes(),)
        return type(item).__name__, _inside(item)

    def _source(self, name: str | None) -> _Source | None:
        """Return where a module comes from, the same object at every call; None if it is not found."""
        if name not in self._sources:
            self._sources[name] = _found(name)
        return self._sources[name]

    def _contents(self, source: _Source) -> Iterator[Any]:
        """Yield the text of a user's module, and the modules that it imports."""
        file = Path(source.file or "")
        text = file.read_bytes() if file.is_file() else b""
        yield text
        if file.suffix == ".py":
            package = source.name if file.stem == "__init__" else source.name.rpartition(".")[0]
            with contextlib.suppress(SyntaxError, ValueError):  # who imports it will see the error
                yield from self._imports(compile(text, str(file), "exec"), package)

    def _imports(self, code: CodeType, package: str) -> Iterator[Any]:
        """Yield the modules that code imports, with their packages; for one that is not found, its name."""
        steps = [step for step in dis.get_instructions(code) if step.opname != "EXTENDED_ARG"]
        for level, members, step in zip(steps, steps[1:], steps[2:], strict=False):
            if step.opname == "IMPORT_NAME":
                name = step.argval
                with contextlib.suppress(ImportError):  # more dots than packages
                    name = importlib.util.resolve_name("." * level.argval + name, package)
                for outer in itertools.accumulate(name.split("."), "{}.{}".format):
                    yield self._source(outer) or outer
                yield from filter(None, (self._source(f"{name}.{member}") for member in members.argval or ()))
        for inner in code.co_consts:
            if isinstance(inner, CodeType):
                yield from self._imports(inner, package)


def _found(name: str | None) -> _Source | None:
    """Return where a module comes from, or None; neither it nor its packages are imported."""
    if name in sys.modules:
        return _Source(name, getattr(sys.modules[name], "__file__", None))
    try:
        spec = None if name is None else _spec(name)  # code that `exec` has read has no module
    except Exception:  # a finder of some package's own
        return None
    return None if spec is None else _Source(spec.name, spec.origin if spec.has_location else None)


def _spec(name: str) -> ModuleSpec | None:
    """Return the specification of a module; `importlib.util.find_spec` would import its packages."""
    package, places = name.rpartition(".")[0], None
    if package:
        outer = sys.modules[package].__spec__ if package in sys.modules else _spec(package)
        if outer is None or outer.submodule_search_locations is None:
            return None
        places = outer.submodule_search_locations
    specs = (finder.find_spec(name, places) for finder in sys.meta_path)
    return next((spec for spec in specs if spec is not None), None)


def _inside(item: Any) -> Iterable[Any]:
    """Return the parts of an object, by which its class could make it again.

    Raises:
        InputError: it has none.
    """
    if isinstance(item, tuple | list) and type(item) in (tuple, list):
        return item
    if isinstance(item, dict | MappingProxyType) and type(item) in (dict, MappingProxyType):
        return [part for pair in item.items() for part in pair]
    if isinstance(item, CellType):
        return _in_cell(item)
    if isinstance(item, MethodType):
        return item.__func__, item.__self__
    if isinstance(item, staticmethod | classmethod):
        return (item.__func__,)
    if isinstance(item, property):
        return item.fget, item.fset, item.fdel
    if isinstance(item, functools.cached_property):
        return (item.func,)
    if isinstance(item, _CACHE):
        return type(item), item.__wrapped__
    try:
        if isinstance(item, ca.DM):
            return item.shape, item.sparsity().serialize(), item.nonzeros()
        if is_casadi(item):
            return (ca.Function("item", ca.symvar(item), [item]).serialize(),)
        if isinstance(item, ca.Function):
            return (item.serialize(),)
        registered = copyreg.dispatch_table.get(type(item))
        made = item.__reduce_ex__(4) if registered is None else registered(item)
        parts = (made,) if isinstance(made, str) else made
        return [list(part) if isinstance(part, Iterator) else part for part in parts]
    except RecursionError:
        raise
    except Exception as error:
        raise InputError(
            f"a store cannot recognise the function again, because it depends on {shown(item)}, whose content cannot be"
            f" read ({error}): create it inside the function, or sweep without a store"
        ) from None


def _globals(code: CodeType, names: dict[str, Any]) -> list[Any]:
    """Return the globals that code names, each after its name."""
    named = [part for name in code.co_names if name in names for part in (name, names[name])]
    inner = [_globals(constant, names) for constant in code.co_consts if isinstance(constant, CodeType)]
    return [*named, *(part for parts in inner for part in parts)]


def _attributes(of: type) -> Iterator[Any]:
    """Yield the names and the values that a class defines, without what Python and libraries keep there."""
    for name, value in vars(of).items():
        if name not in _KEPT and not name.startswith("_abc_") and not isinstance(value, GetSetDescriptorType):
            yield name
            yield value


def _in_cell(cell: CellType) -> tuple[Any, ...]:
    try:
        return (cell.cell_contents,)
    except ValueError:  # empty
        return ()


@functools.lru_cache
def _version(source: _Source) -> str:
    """Return the versions of the installed packages that a module may belong to; Python's own has none."""
    top = source.name.partition(".")[0]
    if top in sys.stdlib_module_names:
        return ""
    try:
        return importlib.metadata.version(top)
    except importlib.metadata.PackageNotFoundError:
        packages = set(importlib.metadata.packages_distributions().get(top, ()))
        return ", ".join(f"{package} {importlib.metadata.version(package)}" for package in sorted(packages))


def _hash(*parts: str | bytes) -> bytes:
    """Return the digest of texts and digests; their lengths keep them apart."""
    digest = hashlib.sha256()
    for part in parts:
        content = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.digest()
