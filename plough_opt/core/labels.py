"""Labels in CasADi graphs, which tell a design what the values in a graph mean.

A label is a call node that returns its first argument unchanged. Its second argument carries further expressions, and
the meaning says what they are for.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, Final, Generic, ParamSpec, TypeVar

import casadi as ca

from plough_opt.core.checks import DomainLimit, Recorded, limits_of_symbols
from plough_opt.core.expressions import (
    Expression,
    classes_in,
    holds_casadi,
    is_symbolic,
    map_expressions,
    template_of,
    with_numbers,
)

Meaning = TypeVar("Meaning")
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")

# Functions kept alive for reuse even if no graph calls them any more; enough for several designs.
_CACHE_SIZE: Final = 64
# Number of registered Functions that triggers the first purge of dead ones.
_FIRST_PURGE: Final = 128


@dataclass(frozen=True)
class Domain:
    """A meaning: the labelled value is valid only if the carried expressions keep limits.

    Attributes:
        limits: the limit of each carried expression.
        bare: for each of them whether it is a symbol by itself, so that the bounds of a variable must keep the limit.
    """

    limits: tuple[DomainLimit, ...]
    bare: tuple[bool, ...]


@dataclass(frozen=True)
class Call:
    """A meaning: the labelled value was returned by a law, and the carried expressions are its arguments' quantities.

    Attributes:
        law: the function.
        template: its positional and named arguments, with a placeholder for each quantity in them.
    """

    law: Callable[..., object]
    template: tuple[tuple[Any, ...], dict[str, Any]]

    def check(self, numbers: Sequence[float]) -> None:
        """Raise DomainError if these values of the quantities lie outside the law's domain."""
        self.run(with_numbers(self.template, numbers))

    def run(self, given: tuple[tuple[Any, ...], dict[str, Any]]) -> object:
        """Return what the law returns for arguments like those of the template."""
        return self.law(*given[0], **given[1])


class Meanings(Generic[Meaning]):
    """A thread-safe registry of the meanings of Functions in graphs.

    A meaning is dropped once no graph calls its Function any more, except that the most recently used Functions are
    kept for reuse in similar graphs.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._known: dict[int, tuple[ca.WeakRef, Meaning]] = {}
        self._recent: OrderedDict[Hashable, tuple[ca.Function, Meaning]] = OrderedDict()
        self._next_purge = _FIRST_PURGE

    def shared(self, key: Hashable, make: Callable[[], tuple[ca.Function, Meaning]]) -> ca.Function:
        """Return the cached Function of a key, or make it together with its meaning."""
        with self._lock:
            if key not in self._recent:
                function, meaning = self._recent[key] = make()
                self._known[hash(function)] = ca.WeakRef(function), meaning
                self._purge()
            self._recent.move_to_end(key)
            return self._recent[key][0]

    def of(self, function: ca.Function) -> Meaning | None:
        """Return the meaning of a registered Function, or None for any other Function."""
        reference, meaning = self._known.get(hash(function), (None, None))
        # The hash is an address in memory, which another Function may have taken over.
        return meaning if reference is not None and reference.alive() else None

    def _purge(self) -> None:
        """Drop the oldest cached Functions, and whenever the registry has doubled, all that no graph calls."""
        while len(self._recent) > _CACHE_SIZE:
            self._recent.popitem(last=False)
        if len(self._known) >= self._next_purge:
            self._known = {at: known for at, known in self._known.items() if known[0].alive()}
            self._next_purge = max(_FIRST_PURGE, 2 * len(self._known))

    def __len__(self) -> int:
        """Return the number of registered meanings."""
        return len(self._known)


_LABELS: Meanings[object] = Meanings()


def attach(value: Expression, carried: Expression, meaning: object, key: Hashable) -> Expression:
    """Return a value with a label if it and the carried expressions depend on MX symbols, else unchanged.

    Args:
        value: value to label.
        carried: a column of expressions.
        meaning: meaning of the carried expressions.
        key: identifies the meaning; labels with equal keys share one Function.
    """
    if not (isinstance(value, ca.MX) and isinstance(carried, ca.MX) and is_symbolic(carried)):
        return value
    layout = (key, value.shape, carried.numel())

    def make() -> tuple[ca.Function, object]:
        x, c = ca.MX.sym("x", *value.shape), ca.MX.sym("c", carried.numel())
        names = ["value", "carried"], ["value_again"]
        return ca.Function("label", [x, c], [x], *names, {"never_inline": True}), meaning

    return _LABELS.shared(layout, make)(ca.densify(value), carried)


def meaning_of(function: ca.Function) -> object | None:
    """Return the meaning of a label's Function, or None for any other Function."""
    return _LABELS.of(function)


def without_labels(expressions: list[ca.MX], labels: list[ca.MX]) -> list[ca.MX]:
    """Return expressions with every label replaced by its value, which makes them faster to evaluate.

    Args:
        expressions: expressions of one graph.
        labels: calls of labels in it, inner ones first, as `labels_in` returns them.
    """
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for node in labels:
        value = node.dep(0)
        new.append(ca.graph_substitute([value], old, new)[0] if old else value)
        old.append(node.get_output(0))
    return list(ca.graph_substitute(expressions, old, new))


def labels_in(function: ca.Function) -> list[ca.MX]:
    """Return the calls of labels in a Function's MX graph, inner ones first."""
    places = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL]
    calls = {hash(node): node for node in map(function.instruction_MX, places)}
    return [node for node in calls.values() if meaning_of(node.which_function()) is not None]


# Whether the current computation is part of a law that is labelled as a whole.
_INSIDE: ContextVar[bool] = ContextVar("inside", default=False)


class unlabelled:  # noqa: N801 (a context, entered too often for a generator)
    """Return laws' values without labels inside this context, because the calling law is labelled itself."""

    def __enter__(self) -> None:
        self._before = _INSIDE.set(True)

    def __exit__(self, *error: object) -> None:
        _INSIDE.reset(self._before)


def checked_in_designs(
    law: Callable[_Given, _Result], check: Callable[_Given, object] | None = None
) -> Callable[_Given, _Result]:
    """Decorate a law so that a design can check whether its bounds lie inside the law's domain.

    The law itself checks numbers. If its arguments hold symbols, the result is labelled with the call, and a design
    repeats the call with the numbers at its bounds.

    Args:
        law: the function.
        check: function called with the bounds in place of the law.
    """

    @wraps(law)
    def labelled(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        if _INSIDE.get():
            return law(*arguments, **named)
        with unlabelled():
            result = law(*arguments, **named)
        if not holds_casadi(result):
            return result
        with limits_of_symbols():  # limits of placeholders mean nothing
            template, quantities = template_of((arguments, named))
        carried = ca.vertcat(*quantities)
        # An array has one placeholder for all its elements; CasADi constants need no label.
        several = not isinstance(carried, ca.MX) or carried.numel() != len(quantities)
        if several or not any(map(is_symbolic, quantities)):
            return result
        # Different functions among the arguments, such as density profiles, can have the same repr.
        functions: list[int] = []

        def note(function: object) -> object:
            functions.append(id(function))
            return function

        map_expressions(template, note, callable)
        key = law.__module__, law.__qualname__, repr(template), classes_in(template), tuple(functions)
        meaning = Call(check or law, template)
        checked: _Result = map_expressions(result, lambda value: attach(value, carried, meaning, key))
        return checked

    return labelled


# Collects the limits of laws, with the limited expressions; None outside of `limits_of_laws`.
_LIMITS: ContextVar[Recorded | None] = ContextVar("limits", default=None)


@contextmanager
def limits_of_laws() -> Iterator[Recorded]:
    """Collect the limits of the laws that are called with symbols inside this context."""
    found: Recorded = []
    before = _LIMITS.set(found)
    try:
        yield found
    finally:
        _LIMITS.reset(before)


def limited_in_designs(label: str) -> Callable[[Callable[_Given, _Result]], Callable[_Given, _Result]]:
    """Return a decorator of a law, with which a design keeps the limits that `check_domain` finds on symbols in it.

    Each limit becomes a requirement of the design. A limit on a symbol by itself does not: the bounds of that variable
    must keep it.

    Args:
        label: name of the law in the requirements' names.
    """

    def decorated(law: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
        @wraps(law)
        def labelled(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
            with limits_of_symbols() as found:
                result = law(*arguments, **named)
            # Columns are points at which a law is evaluated, such as nodes of a quadrature.
            kept = [
                (replace(limit, name=f"{label}: {limit.name}"), value)
                for limit, value in found
                if value.numel() == 1 and limit.kept != (None, None)
            ]
            if not kept:
                return result
            if (collected := _LIMITS.get()) is not None:
                collected += kept
            domain = Domain(tuple(limit for limit, _ in kept), tuple(value.is_symbolic() for _, value in kept))
            carried = ca.vertcat(*(value for _, value in kept))
            limited: _Result = map_expressions(result, lambda value: attach(value, carried, domain, domain))
            return limited

        return labelled

    return decorated
