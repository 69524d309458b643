"""Samples of a soil: the same ones for every design, so that averages over them are smooth."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_callable, check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, is_casadi
from plough_opt.soil.soil import Soil

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class SoilSamples:
    """Equally likely soils.

    Attributes:
        soil: with the values that they have in common.
        names: the properties that differ.
        values: their values, a row for each sample, a column for each property; SI units.
    """

    soil: Soil
    names: tuple[str, ...]
    values: Vector

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[Soil]:
        return iter(self.soils)

    @cached_property
    def soils(self) -> tuple[Soil, ...]:
        """The soils, one for each row."""
        rows: list[list[Any]] = self.values.tolist()
        return tuple(replace(self.soil, **dict(zip(self.names, row, strict=True))) for row in rows)

    def property(self, name: str) -> Vector:
        """Return the values of a property, SI.

        Raises:
            InputError: a name that is not among the uncertain properties.
        """
        check_named("{} is not an uncertain property", name, self.names)
        column: Vector = self.values[:, self.names.index(name)]
        return column

    def each(self, response: Callable[[Soil], Mapping[str, Expression]]) -> dict[str, Expression]:
        """Return the results of a function for each soil, by name, as columns over the samples.

        Args:
            response: soil -> results by name, each a number or a scalar expression of a design.

        Raises:
            InputError: results that are not given by name, or not scalars.
        """
        check_callable("the response", response, "of a soil that returns results by name")
        rows = [response(soil) for soil in self.soils]
        if not rows or not all(isinstance(row, Mapping) and row for row in rows):
            raise InputError('the response to a soil must be results by name, like {"draft": run.mean_draft}')
        return {name: _column(name, [row[name] for row in rows]) for name in rows[0]}


def _column(name: str, values: list[Expression]) -> Expression:
    if any(is_casadi(value) for value in values):
        if any(ca.MX(value).numel() != 1 for value in values):
            raise InputError(f"the result '{name}' of each soil must be one number: average it, or take its mean")
        return ca.vertcat(*values)
    column = np.asarray(values, dtype=float)
    if column.ndim != 1:
        raise InputError(f"the result '{name}' of each soil must be one number, not of the shape {column.shape[1:]}")
    return column
