"""Labels in a CasADi graph, by which a design finds the meaning of values in it.

A label is a call that returns its value unchanged, and carries other expressions along, which have a meaning.
"""

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

# Number of Functions that are kept for reuse, though no graph may call them any more: those of several designs.
_MOST_LATELY: Final = 64
# Number of Functions from which it is worth looking for those that no graph calls.
_FEWEST_LOOKED_AT: Final = 128


@dataclass(frozen=True)
class Limit:
    """A meaning: the labelled value is valid only if the carried expression does not exceed a number.

    Attributes:
        name: of the limited expression, in reports.
        at_most: its largest value.
        unit: unit of both.
    """

    name: str
    at_most: float
    unit: str = ""


@dataclass(frozen=True)
class Call:
    """A meaning: the labelled value is a law's, and the carried expressions are the quantities in its arguments.

    Attributes:
        law: the function.
        template: its positional and named arguments, with a placeholder for each quantity in them.
    """

    law: Callable[..., object]
    template: tuple[tuple[Any, ...], dict[str, Any]]

    def check(self, numbers: Sequence[float]) -> None:
        """Raise DomainError if numbers of the quantities are outside the law's domain."""
        arguments, named = with_numbers(self.template, numbers)
        self.law(*arguments, **named)


class Meanings(Generic[Meaning]):
    """The meanings of Functions in graphs; each is forgotten with the last graph that calls its Function.

    The latest Functions are kept, to be used again in similar graphs. Threads may share an object of this class.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._known: dict[int, tuple[ca.WeakRef, Meaning]] = {}
        self._lately: OrderedDict[Hashable, tuple[ca.Function, Meaning]] = OrderedDict()
        self._look_at = _FEWEST_LOOKED_AT

    def shared(self, key: Hashable, make: Callable[[], tuple[ca.Function, Meaning]]) -> ca.Function:
        """Return the Function with a key, which is made together with its meaning if it is not kept."""
        with self._lock:
            if key not in self._lately:
                function, meaning = self._lately[key] = make()
                self._known[hash(function)] = ca.WeakRef(function), meaning
                self._forget()
            self._lately.move_to_end(key)
            return self._lately[key][0]

    def of(self, function: ca.Function) -> Meaning | None:
        """Return the meaning of a Function in a graph, or None for any other Function."""
        reference, meaning = self._known.get(hash(function), (None, None))
        # The hash is an address in memory, which another Function may use now.
        return meaning if reference is not None and reference.alive() else None

    def _forget(self) -> None:
        """Forget Functions that no graph calls; all of them are checked whenever their number has doubled."""
        while len(self._lately) > _MOST_LATELY:
            self._lately.popitem(last=False)
        if len(self._known) >= self._look_at:
            self._known = {at: known for at, known in self._known.items() if known[0].alive()}
            self._look_at = max(_FEWEST_LOOKED_AT, 2 * len(self._known))

    def __len__(self) -> int:
        """Return the number of known meanings."""
        return len(self._known)


_LABELS: Meanings[object] = Meanings()


def attach(value: Expression, carried: Expression, meaning: object, key: Hashable) -> Expression:
    """Return a value as it is, or with a label in the graph if value and carried expressions hold MX symbols.

    Args:
        value: to be labelled.
        carried: a column of expressions.
        meaning: of the carried expressions.
        key: equal for equal meanings, which then share one Function.
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
    """Return the meaning of a label, which is a Function in a graph, or None for any other Function."""
    return _LABELS.of(function)


def without_labels(expressions: list[ca.MX], labels: list[ca.MX]) -> list[ca.MX]:
    """Return expressions with labels replaced by their values, which makes them faster.

    Args:
        expressions: of a graph.
        labels: the calls of labels in it, inner ones first, as `labels_in` returns them.
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
    return [node for node in calls.values() if meaning_of(node.which_function()) is not None]


# Whether the present computation is a part of one that is checked as a whole.
_INSIDE: ContextVar[bool] = ContextVar("inside", default=False)


@contextmanager
def unlabelled() -> Iterator[None]:
    """Let laws return values without labels as long as the context lasts, because a law that uses them is labelled."""
    before = _INSIDE.set(True)
    try:
        yield
    finally:
        _INSIDE.reset(before)


def checked_in_designs(
    law: Callable[_Given, _Result], check: Callable[_Given, object] | None = None
) -> Callable[_Given, _Result]:
    """Decorate a law, so that a design can check that its bounds are within the law's domain.

    The law itself checks numbers. If its arguments hold symbols, its values are labelled with the call, which a design
    repeats with the numbers of its bounds.

    Args:
        law: the function.
        check: function that is called with the bounds instead of the law.
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
        # An array has one placeholder for all its elements; constants of CasADi need no label.
        several = not isinstance(carried, ca.MX) or carried.numel() != len(quantities)
        if several or not any(map(is_symbolic, quantities)):
            return result
        # Functions in arguments, such as a density profile's, may have the same repr.
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
