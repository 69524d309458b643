"""Inputs and outputs of a component that a problem file describes."""

import math
from collections.abc import Callable, Mapping, Sequence

from plough_opt.core.checks import check_kind, check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression
from plough_opt.core.quantities import EVERY
from plough_opt.exchange.component import Input, Output, Port
from plough_opt.exchange.component.ports import port_of
from plough_opt.motion import Run
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.schema import LimitTable, ProblemTable

OBJECTIVE = "objective"
"""Name of the sum of the [minimise] table."""


def input_ports(name: str, keys: Sequence[str], bounds: Mapping[str, Input], values: Mapping[str, float]) -> list[Port]:
    """Return the inputs of a file.

    Args:
        name: the file's name.
        keys: of quantities; none: the variables.
        bounds: key of each variable -> its bounds.
        values: key of every quantity that has a value -> it, of variables the guess.

    Raises:
        InputError: nothing to vary, or a key that is unknown or has no value.
    """
    check_kind("inputs", keys, list | tuple, "a list of keys")
    keys = keys or tuple(bounds)
    if not keys:
        raise InputError(f"{name}: nothing to vary: name inputs, or give the file a [variables] table")
    for key in keys:
        if isinstance(key, str) and key in EVERY and key not in values:
            raise InputError(f"{name} gives '{key}' no value, so it cannot be an input")
        check_named("no quantity is named {}", key, values)
    return [port_of(bounds.get(key, Input(key)), EVERY[key], values[key]) for key in keys]


def wanted_outputs(
    name: str, table: ProblemTable, names: Sequence[str], objective: Callable[[Run], Expression]
) -> list[Output]:
    """Return the outputs of a file, its requirements as their limits.

    Args:
        name: the file's name.
        table: what it says.
        names: of results, or "objective"; none: all that the file minimises, trades and requires.
        objective: run -> sum of what the file minimises.

    Raises:
        InputError: nothing to give.
    """
    check_kind("outputs", names, list | tuple, "a list of names")
    every = dict.fromkeys([*table.minimise, *table.goals, *table.require])
    names = names or [*([OBJECTIVE] if table.minimise else []), *every]
    if not names:
        raise InputError(f"{name} minimises and requires nothing: name outputs")
    return [_output(one, table, objective) for one in names]


def _output(name: str, table: ProblemTable, objective: Callable[[Run], Expression]) -> Output:
    check_kind("an output", name, str, "the name of a result")
    if name == OBJECTIVE and table.minimise:
        return Output(name, of=objective)
    measure = measures_of(table).get(name)
    if measure is None:  # which `build` refuses
        return Output(name)
    low, high = table.require.get(name, LimitTable()).ends(measure.unit)
    own = name in table.measures
    return Output(
        name,
        unit=measure.unit.symbol if own else None,
        of=measure.of if own else None,
        lower=-math.inf if low is None else low,
        upper=math.inf if high is None else high,
    )
