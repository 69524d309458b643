"""Values in somebody's graph that carry a meaning along, so that a design that holds them can find it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from typing import Any, Final, Generic, ParamSpec, TypeVar

import casadi as ca

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

# Functions that are kept although nothing may call them any more: some designs' worth.
_MOST_LATELY: Final = 64
# Below so many, looking for those that nothing calls is not worth it.
_FEWEST_LOOKED_AT: Final = 128


@dataclass(frozen=True)
class Label:
    """A call that returns its value unchanged, beside expressions that it carries along.

    Attributes:
        meaning: what the carried expressions are: any object that whoever looks for it knows.
    """

    meaning: object


@dataclass(frozen=True)
class Limit:
    """A meaning: the carried expression must not exceed a number, or the labelled value has left its domain.

    Attributes:
        name: what the limited expression is, as a report names it.
        at_most: its largest value.
        unit: unit of both.
    """

    name: str
    at_most: float
    unit: str = ""


@dataclass(frozen=True)
class Call:
    """A meaning: the labelled value is of a law, whose arguments' quantities are carried.

    Attributes:
        law: the function.
        template: its arguments, and those with a name, with a placeholder for each quantity in them.
    """

    law: Callable[..., object]
    template: tuple[tuple[Any, ...], dict[str, Any]]

    def check(self, numbers: Sequence[float]) -> None:
        """Refuse numbers of the quantities that are outside the law's domain.

        Raises:
            DomainError: they are.
        """
        arguments, named = with_numbers(self.template, numbers)
        self.law(*arguments, **named)


class Meanings(Generic[Meaning]):
    """What Functions in graphs mean, which is forgotten with the last graph that calls them.

    Functions lately made are kept for graphs alike. Threads may share it.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._known: dict[int, tuple[ca.WeakRef, Meaning]] = {}
        self._lately: OrderedDict[Hashable, tuple[ca.Function, Meaning]] = OrderedDict()
        self._look_at = _FEWEST_LOOKED_AT

    def shared(self, key: Hashable, make: Callable[[], tuple[ca.Function, Meaning]]) -> ca.Function:
        """Return the Function that was lately made by a key, or make it with what it means."""
        with self._lock:
            if key not in self._lately:
                function, meaning = self._lately[key] = make()
                self._known[hash(function)] = ca.WeakRef(function), meaning
                self._forget()
            self._lately.move_to_end(key)
            return self._lately[key][0]

    def of(self, function: ca.Function) -> Meaning | None:
        """Return what a Function in a graph means, or None for any other Function."""
        reference, meaning = self._known.get(hash(function), (None, None))
        # The hash is a place in memory, which another Function may have taken over.
        return meaning if reference is not None and reference.alive() else None

    def _forget(self) -> None:
        """Forget Functions that nothing calls; looks at all of them whenever their number has doubled."""
        while len(self._lately) > _MOST_LATELY:
            self._lately.popitem(last=False)
        if len(self._known) >= self._look_at:
            self._known = {at: known for at, known in self._known.items() if known[0].alive()}
            self._look_at = max(_FEWEST_LOOKED_AT, 2 * len(self._known))

    def __len__(self) -> int:
        """Return how many are remembered."""
        return len(self._known)


_LABELS: Meanings[Label] = Meanings()


def attach(value: Expression, carried: Expression, meaning: object, key: Hashable) -> Expression:
    """Return a value as it is; where value and carried expressions hold MX symbols, labelled in the graph.

    Args:
        value: what an expression is computed from.
        carried: a column of expressions that give the meaning its numbers.
        meaning: what they are.
        key: equal for equal meanings, which then share one Function.
    """
    if not (isinstance(value, ca.MX) and isinstance(carried, ca.MX) and is_symbolic(carried)):
        return value
    layout = (key, value.shape, carried.numel())

    def make() -> tuple[ca.Function, Label]:
        x, c = ca.MX.sym("x", *value.shape), ca.MX.sym("c", carried.numel())
        names = ["value", "carried"], ["value_again"]
        return ca.Function("label", [x, c], [x], *names, {"never_inline": True}), Label(meaning)

    return _LABELS.shared(layout, make)(ca.densify(value), carried)


def label_of(function: ca.Function) -> Label | None:
    """Return the label that a Function in a graph is, or None for any other Function."""
    return _LABELS.of(function)


def without_labels(expressions: list[ca.MX], labels: list[ca.MX]) -> list[ca.MX]:
    """Return expressions with the labels' values in their place, which are computed faster.

    Args:
        expressions: of a graph.
        labels: the calls of labels in it, inner ones first, as a Function of the expressions lists them.
    """
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for node in labels:
        value = node.dep(0)
        new.append(ca.graph_substitute([value], old, new)[0] if old else value)
        old.append(node.get_output(0))
    return list(ca.graph_substitute(expressions, old, new))


def labels_in(function: ca.Function) -> list[ca.MX]:
    """Return the calls of labels in a Function's graph of MX, inner ones first."""
    places = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL]
    calls = {hash(node): node for node in map(function.instruction_MX, places)}
    return [node for node in calls.values() if label_of(node.which_function()) is not None]


# Whether what is computed is part of something that is checked as a whole.
_INSIDE: ContextVar[bool] = ContextVar("inside", default=False)


@contextmanager
def unlabelled() -> Iterator[None]:
    """Let laws return their values without labels, for a value that is checked with what it becomes a part of."""
    before = _INSIDE.set(True)
    try:
        yield
    finally:
        _INSIDE.reset(before)


def checked_in_designs(
    law: Callable[_Given, _Result], check: Callable[_Given, object] | None = None
) -> Callable[_Given, _Result]:
    """Decorate a law, so that a design that holds its values can refuse bounds beyond its domain.

    Numbers a law refuses by itself. Symbols have no value yet: the values are then labelled with the call, which a
    design repeats with its bounds.

    Args:
        law: the function.
        check: what is called in its place with the bounds.
    """

    @wraps(law)
    def labelled(*arguments: _Given.args, **named: _Given.kwargs) -> _Result:
        if _INSIDE.get():
            return law(*arguments, **named)
        with unlabelled():
            result = law(*arguments, **named)
        if not holds_casadi(result):
            return result
        template, quantities = template_of((arguments, named))
        carried = ca.vertcat(*quantities)
        # An argument of several numbers has no placeholder of its own for each of them; CasADi's numbers need no label.
        several = not isinstance(carried, ca.MX) or carried.numel() != len(quantities)
        if several or not any(map(is_symbolic, quantities)):
            return result
        # Functions in arguments, as a density profile's, may print alike.
        functions: list[int] = []

        def noted(function: object) -> object:
            functions.append(id(function))
            return function

        map_expressions(template, noted, callable)
        key = law.__module__, law.__qualname__, repr(template), classes_in(template), tuple(functions)
        meaning = Call(check or law, template)
        checked: _Result = map_expressions(result, lambda value: attach(value, carried, meaning, key))
        return checked

    return labelled
