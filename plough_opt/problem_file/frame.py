"""The problem of several shares in one frame, joined of the file as it is for each of them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.shares import by_share


def joined(parts: Mapping[str, Problem], own: Mapping[str, set[str]], overrides: tuple[str, ...]) -> Problem:
    """Return the problem of several shares in one frame.

    Args:
        parts: name of a share -> the file as it is for this share alone.
        own: name of a share -> quantities and results of which its own table says something.
        overrides: changes that were made to the file.
    """

    def gathered(what: str) -> Any:
        return by_share({name: getattr(part, what) for name, part in parts.items()}, own)

    first = next(iter(parts.values()))
    require = {}
    for name, part in parts.items():
        for result, limit in part.table.require.items():
            together = measures_of(part.table)[result].adds and result not in own[name]
            require[result if together else f"{name}.{result}"] = limit
    displays = gathered("displays")
    displays |= {key: parts[key.partition(".")[0]].displays[key.partition(".")[2]] for key in require if "." in key}
    return dataclasses.replace(
        first, table=first.table.model_copy(update={"require": require}), fixed=gathered("fixed"),
        variables=gathered("variables"), displays=displays, shares=parts, overrides=overrides,
    )  # fmt: skip
