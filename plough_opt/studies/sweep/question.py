"""The question of a sweep: its points, and everything else that the results depend on.

Points are computed from their numbers when they are needed, so that a million of them take no memory.

A store recognises its own sweep by a digest of the function. It covers the function's code, defaults, attributes,
closure, imports and the globals that it names, the state and the class of objects, and so on inwards. Modules of the
standard library and of installed packages are identified by name and, if they have one, version. The bytecode of
functions is compared and not their source, so comments and the place in a file do not matter; a module of a user's is
compared as text, with the modules that it imports. No module is imported for that.
"""

import contextlib
import copyreg
import dis
import functools
import hashlib
import importlib.metadata
import importlib.util
import itertools
import math
import sys
import sysconfig
import types
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_bounds, check_switch, plain_number, shown, whole_number
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import is_casadi
from plough_opt.core.plain_data import Array

MOST_VALUES: Final = 1_000_000
"""Limit on the values of one quantity of a grid, which are held in memory, unlike the points."""
# Length of SciPy's Sobol sequence with the default 30 bits.
MOST_SAMPLES: Final = 2**30


@dataclass(frozen=True)
class Range:
    """A range of a quantity, for a grid or for a sample.

    Args:
        lower: first value, SI.
        upper: last value, above ``lower``.
        count: number of values of a grid, ends included, 2 to a million; None for a sample, which fills the range.
        log: whether values are equally spaced on a logarithmic scale; both ends must then be above 0.

    Raises:
        InputError: the ends are not finite numbers in ascending order, count is invalid, or a logarithmic range does
            not begin above 0.

    Example:
        >>> import plough_opt as po
        >>> po.Range(1.0, 3.0, 5).count
        5
    """

    lower: float
    upper: float
    count: int | None = None
    log: bool = False

    def __post_init__(self) -> None:
        for side in ("lower", "upper"):
            # As floats, so that 1, 1.0 and NumPy's 1.0 give the same question in a store.
            object.__setattr__(self, side, plain_number("the end of a range", getattr(self, side)))
        check_switch("log", self.log)
        check_bounds("a range", self.lower, self.upper, log=self.log)
        if self.count is not None and whole_number("the number of values", self.count, 2) > MOST_VALUES:
            given = f"the number of values is {shown(self.count)}"
            raise InputError(f"{given}: it can be at most {MOST_VALUES}; use a sample instead")

    def values(self) -> tuple[float, ...]:
        """Return the values for a grid, with both ends exact.

        Example:
            >>> import plough_opt as po
            >>> po.Range(1.0, 3.0, 5).values()
            (1.0, 1.5, 2.0, 2.5, 3.0)
        """
        if self.count is None:
            none = f"the range from {self.lower:g} to {self.upper:g} has no number of values"
            raise InputError(f"{none}, which a grid needs: add one, or set a number of samples")
        steps = np.geomspace if self.log else np.linspace
        return tuple(steps(self.lower, self.upper, self.count).tolist())

    def at(self, fraction: float) -> float:
        """Return the value at a fraction of the range, from 0 to 1.

        Raises:
            InputError: the fraction is not a number.

        Example:
            >>> import plough_opt as po
            >>> po.Range(10.0, 1000.0, 3, log=True).at(0.5)
            100.0
        """
        fraction = plain_number("the fraction of a range", fraction)
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** fraction)
        # The same order of operations as in scipy.stats.qmc.scale.
        return fraction * (self.upper - self.lower) + self.lower


Axis = Range | tuple[float, ...]


def axis_of(name: str, given: object) -> Axis:
    """Check and return the values over which a quantity is swept.

    Args:
        name: of the quantity.
        given: a `Range` or numbers, SI.

    Raises:
        InputError: the type is wrong, there are fewer than two numbers, or one is repeated or not finite.
    """
    if isinstance(given, Range):
        return given
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"'{name}' runs over {shown(given)}: give a po.Range or a list of numbers")
    listed = list(given)
    if not all(isinstance(x, int | float | np.number) and not isinstance(x, bool) for x in listed):
        raise InputError(f"'{name}' runs over {shown(listed)}, which are not all numbers")
    values = tuple(float(x) for x in listed)
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"'{name}' runs over {bad[0]}: every value must be finite")
    if len(values) < 2:
        some = f"'{name}' runs over {shown(listed)}"
        raise InputError(f"{some}: a sweep needs two values or more; set a single one instead")
    if len(set(values)) < len(values):
        raise InputError(f"'{name}' runs over the same value twice")
    return values


class PointGrid:
    """All combinations of the values of several quantities; the last quantity changes fastest."""

    def __init__(self, axes: Mapping[str, Axis]) -> None:
        """Take, for each quantity, values or a range with a number of values."""
        self.names = tuple(axes)
        self._values: list[Array] = []
        for name, axis in axes.items():
            with about(f"'{name}':"):
                self._values.append(np.array(axis.values() if isinstance(axis, Range) else axis))
        self.count = math.prod(map(len, self._values))
        if self.count >= 2**63:
            raise InputError(f"the grid has {self.count:.3g} points: use fewer values, or a sample")

    def block(self, first: int, last: int) -> Array:
        """Return the points from number ``first`` to before ``last``, a row each."""
        places = np.unravel_index(np.arange(first, last), [len(values) for values in self._values])
        return np.column_stack([values[k] for values, k in zip(self._values, places, strict=True)])

    def question(self) -> dict[str, str]:
        """Return the values of each quantity as texts."""
        return {f"over {name}": _short(x) for name, x in zip(self.names, self._values, strict=True)}


class PointSample:
    """A scrambled Sobol sample: scipy.stats.qmc.Sobol, scaled to the ranges of several quantities."""

    def __init__(self, axes: Mapping[str, Axis], count: int, seed: int) -> None:
        """Take a range for each quantity.

        Raises:
            InputError: values are given instead of a range, a range has a number of values, or the number of samples or
                the seed is invalid.
        """
        self.names = tuple(axes)
        self.count = whole_number("the number of samples", count, 2, MOST_SAMPLES)
        self._seed = whole_number("the seed", seed)
        self._ranges: list[Range] = []
        for name, axis in axes.items():
            if not isinstance(axis, Range):
                raise InputError(f"'{name}' runs over single values: a sample needs a range with two ends")
            if axis.count is not None:
                given = f"'{name}' has a number of values, {axis.count}"
                raise InputError(f"{given}: leave it out, because a sample fills the range")
            self._ranges.append(axis)
        self._restart()

    def block(self, first: int, last: int) -> Array:
        """Return the points from number ``first`` to before ``last``, a row each; ascending blocks are fastest."""
        if first < self._engine.num_generated:
            self._restart()
        if ahead := first - self._engine.num_generated:
            self._engine.fast_forward(ahead)
        # SciPy warns unless the size of the first draw is a power of two.
        begin = 1 if first == 0 else 0
        unit = np.concatenate([self._engine.random(begin), self._engine.random(last - first - begin)])
        # One value at a time, because NumPy may round the last ones of a block differently (outside vector registers).
        return np.array([[r.at(u) for r, u in zip(self._ranges, row, strict=True)] for row in unit.tolist()])

    def question(self) -> dict[str, str]:
        """Return the ranges, the number of samples and the seed as texts."""
        ranges = {
            f"over {name}": f"{axis.lower!r} to {axis.upper!r}{' log' * axis.log}"
            for name, axis in zip(self.names, self._ranges, strict=True)
        }
        return {**ranges, "samples": str(self.count), "seed": str(self._seed)}

    def _restart(self) -> None:
        from scipy.stats import qmc  # imported only for samples, because that is slow

        self._engine = qmc.Sobol(len(self._ranges), scramble=True, seed=self._seed)


def points_of(axes: Mapping[str, Axis], samples: int | None, seed: int) -> PointGrid | PointSample:
    """Return a grid, or a sample if a number of samples is given.

    Raises:
        InputError: there are no quantities, or `PointGrid` or `PointSample` raises.
    """
    if not axes:
        raise InputError("over is empty: a sweep needs at least one quantity")
    return PointGrid(axes) if samples is None else PointSample(axes, samples, seed)


def _short(values: Array) -> str:
    """Return a text that identifies values: all of them if they are few, otherwise the ends and a digest."""
    if len(values) <= 16:
        return ", ".join(map(repr, values.tolist()))
    first, last = values[[0, -1]].tolist()
    return f"{len(values)} from {first!r} to {last!r}, digest {hashlib.sha256(values.tobytes()).hexdigest()[:16]}"


# --- the digest of a function ---

# Types whose repr is their whole content.
_PLAIN: Final = (type(None), bool, int, float, complex, str, bytes, type(...), type(NotImplemented), range, slice)
# Types that are identified by name, because they hold no code of a user's.
_NAMED: Final = (types.BuiltinFunctionType, types.GetSetDescriptorType, types.MemberDescriptorType,
                 types.WrapperDescriptorType, np.ufunc)  # fmt: skip
_CACHE: Final = type(functools.lru_cache(lambda: None))
# Attributes that are the content of an object; of code what it does, without its name and its place in a file.
_MADE_OF: Final[dict[type, tuple[str, ...]]] = {
    types.CodeType: ("co_code", "co_consts", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_argcount",
               "co_posonlyargcount", "co_kwonlyargcount", "co_flags", "co_exceptiontable"),
    types.MethodType: ("__func__", "__self__"),
    staticmethod: ("__func__",),
    classmethod: ("__func__",),
    property: ("fget", "fset", "fdel"),
    functools.cached_property: ("func",),
    _CACHE: ("__wrapped__",),
}  # fmt: skip
# What Python itself keeps in a class.
_KEPT: Final = {"__module__", "__qualname__", "__dict__", "__weakref__", "__doc__", "__annotations__",
                "__static_attributes__", "__firstlineno__", "__annotate_func__", "__annotations_cache__",
                "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__abstractmethods__"}  # fmt: skip
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
        if isinstance(item, types.ModuleType):
            others = (value.__name__ for value in vars(item).values() if isinstance(value, types.ModuleType))
            return "module", map(self._source, (item.__name__, *others))
        if isinstance(item, _Source):
            if item.installed:
                return f"module {item.name} {_version(item)}", ()
            return f"module {item.name}", self._contents(item)
        function = isinstance(item, types.FunctionType)
        # `functools.wraps` copies the name of another function's module.
        module = item.__globals__.get("__name__") if function else getattr(item, "__module__", None)
        name = f"{module}.{getattr(item, '__qualname__', '')}"
        if isinstance(item, type | types.FunctionType) and (source := self._source(module)) and source.installed:
            return f"{name} {_version(source)}", ()
        if isinstance(item, type):
            return f"class {name}", (*item.__bases__, *_attributes(item))
        if isinstance(item, types.FunctionType):
            parts = (item.__code__, item.__defaults__, item.__kwdefaults__, item.__closure__, item.__dict__)
            imports = self._imports(item.__code__, item.__globals__.get("__package__") or "")
            return "function", (*parts, *_globals(item.__code__, item.__globals__), *imports)
        if isinstance(item, _NAMED):
            owner = getattr(item, "__self__", None)
            owners = [] if isinstance(owner, types.ModuleType) else [owner]
            return f"{type(item).__name__} {name or item.__name__}", owners
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

    def _imports(self, code: types.CodeType, package: str) -> Iterator[Any]:
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
            if isinstance(inner, types.CodeType):
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
    if isinstance(item, dict | types.MappingProxyType) and type(item) in (dict, types.MappingProxyType):
        return [part for pair in item.items() for part in pair]
    if isinstance(item, types.CellType):
        with contextlib.suppress(ValueError):  # empty
            return (item.cell_contents,)
        return ()
    for kind, names in _MADE_OF.items():
        if isinstance(item, kind):
            return [getattr(item, name) for name in names]
    try:
        if is_casadi(item) and not isinstance(item, ca.DM):
            return (ca.Function("item", ca.symvar(item), [item]).serialize(),)
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


def _globals(code: types.CodeType, names: dict[str, Any]) -> list[Any]:
    """Return the globals that code names, each after its name."""
    named = [part for name in code.co_names if name in names for part in (name, names[name])]
    inner = [_globals(constant, names) for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return [*named, *(part for parts in inner for part in parts)]


def _attributes(of: type) -> Iterator[Any]:
    """Yield the names and the values that a class defines, without what Python and libraries keep there."""
    for name, value in vars(of).items():
        if name not in _KEPT and not name.startswith("_abc_") and not isinstance(value, types.GetSetDescriptorType):
            yield name
            yield value


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
