"""Inputs and outputs of the component that a problem file describes."""

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
    """Return the input ports of a file.

    Args:
        name: the file's name.
        keys: keys of quantities; empty for the variables.
        bounds: key of each variable -> its bounds.
        values: key -> value in SI, guesses for variables.

    Raises:
        InputError: there is nothing to vary, or a key is unknown or has no value.
    """
    check_kind("inputs", keys, list | tuple, "a list of keys")
    keys = keys or tuple(bounds)
    if not keys:
        raise InputError(f"{name}: nothing to vary: name inputs, or give the file a [variables] table")
    for key in keys:
        if isinstance(key, str) and key in EVERY and key not in values:
            raise InputError(f"'{key}' cannot be an input, because {name} gives no value for it: add one")
        check_named("no quantity is named {}", key, values)
    return [port_of(bounds.get(key, Input(key)), EVERY[key], values[key]) for key in keys]


def wanted_outputs(
    name: str, table: ProblemTable, names: Sequence[str], objective: Callable[[Run], Expression]
) -> list[Output]:
    """Return the outputs of a file, with its requirements as limits.

    Args:
        name: the file's name.
        table: its tables.
        names: names of results, or "objective"; empty for all results that the file minimises, trades or requires.
        objective: function from a run to the sum of [minimise].

    Raises:
        InputError: no results are named, and the file minimises, trades and requires none.
    """
    check_kind("outputs", names, list | tuple, "a list of names")
    every = dict.fromkeys([*table.minimise, *table.goals, *table.require])
    names = names or [*([OBJECTIVE] if table.minimise else []), *every]
    if not names:
        raise InputError(f"{name} minimises, trades and requires nothing: name outputs")
    return [_output(one, table, objective) for one in names]


def _output(name: str, table: ProblemTable, objective: Callable[[Run], Expression]) -> Output:
    check_kind("an output", name, str, "the name of a result")
    if name == OBJECTIVE and table.minimise:
        return Output(name, of=objective)
    measure = measures_of(table).get(name)
    if measure is None:  # `build` raises InputError for unknown names
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
