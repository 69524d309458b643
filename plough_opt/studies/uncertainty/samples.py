"""Samples of a soil, and results of a function over them: as expressions for a design, and as numbers.

The samples are the same for every design, so that averages over them are smooth functions of the design.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import NOT_NUMBERS, check_callable, check_kind, check_named, plain_number
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Column, Expression, is_casadi
from plough_opt.design import Optimum
from plough_opt.design.population import Population
from plough_opt.design.scene_checks import SceneChecks
from plough_opt.design.split import split
from plough_opt.soil.soil import Soil

Vector = NDArray[np.float64]
Response = Callable[[Soil], Mapping[str, Column]]

# Factor on the number of steps in a search. Averages are then accurate to some 1e-10, far better than the statistics of
# a few thousand samples.
_MORE_STEPS = 4.0


@dataclass(frozen=True)
class SoilSamples:
    """Equally likely soils.

    Attributes:
        soil: the soil with the properties that all samples share.
        names: names of the properties that differ.
        values: their values, a row for each sample and a column for each property; SI units.
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
            InputError: the name is not that of an uncertain property.
        """
        check_named("{} is not an uncertain property", name, self.names)
        column: Vector = self.values[:, self.names.index(name)]
        return column

    def each(self, response: Callable[[Soil], Mapping[str, Expression]]) -> dict[str, Expression]:
        """Return name -> result of a function of the soil, as a column over the samples.

        Args:
            response: soil -> results by name, each a number or a scalar expression of a design.

        Raises:
            InputError: the results are not given by name, or are not scalars.
        """
        check_callable("the response", response, "of a soil that returns results by name")
        rows = [response(soil) for soil in self.soils]
        if not rows or not all(isinstance(row, Mapping) and row for row in rows):
            raise InputError('the response to a soil must be results by name, like {"draft": run.mean_draft}')
        return {name: _column(name, [row[name] for row in rows]) for name in rows[0]}


@dataclass(frozen=True)
class ResponseValues:
    """Results over samples.

    Attributes:
        values: name -> values over the samples that have results.
        failures: number of a sample without results -> the reason.
    """

    values: dict[str, Vector]
    failures: dict[int, str]


class Responses:
    """The results of a function for very many soils, at one numeric design.

    The function is called once, with symbols for the uncertain properties. Design and properties are then the variables
    of a `Population`, which integrates the runs of all soils side by side where possible, and evaluates the algebra
    around them.
    """

    def __init__(self, response: Response, soil: Soil, names: Sequence[str]) -> None:
        """Call the function with symbols for the properties of the given names."""
        properties: list[Any] = [ca.MX.sym(name) for name in names]
        results = response(replace(soil, **dict(zip(names, properties, strict=True))))
        self.names = tuple(results)
        column: ca.MX = ca.vertcat(*(ca.MX(value) for value in results.values()))
        of_soil = {hash(symbol) for symbol in properties}
        self._design = [symbol for symbol in ca.symvar(column) if hash(symbol) not in of_soil]
        self._y = ca.MX.sym("design and soil", len(self._design) + len(properties))
        (column,) = ca.graph_substitute([column], [*self._design, *properties], ca.vertsplit(self._y))
        none = ca.MX.sym("none", 0)
        parts = split([column[0], column], [self._y, none])
        self._population = Population(parts, self._y, none, rough=False)
        self._checks = SceneChecks(parts, [self._y])

    def __call__(self, at: Optimum | Mapping[str, float], samples: SoilSamples) -> ResponseValues:
        """Return the results for each soil at a design.

        Args:
            at: the design: an optimum, or variables and parameters by name.
            samples: the soils.
        """
        design = [_number(at, symbol) for symbol in self._design]
        rows = np.hstack([np.tile(design, (len(samples), 1)), samples.values])
        failures = self._checks.reasons(rows)
        _, values = self._population(rows, np.empty(0), finer=_MORE_STEPS)
        for bad in np.flatnonzero(~np.all(np.isfinite(values), axis=1)):
            failures.setdefault(int(bad), "a result is not a finite number")
        kept = np.delete(values, list(failures), axis=0)
        return ResponseValues(dict(zip(self.names, kept.T, strict=True)), failures)


def _number(at: Optimum | Mapping[str, float], symbol: ca.MX) -> float:
    """Return the value of a design's variable or parameter.

    Raises:
        InputError: the design has no value for it.
    """
    check_kind("the design", at, Optimum | Mapping, "an Optimum, or its values by name")
    values = at.variables if isinstance(at, Optimum) else at
    if symbol.name() in values:
        return plain_number(f"'{symbol.name()}'", values[symbol.name()])
    if isinstance(at, Optimum):
        return float(at(symbol))
    raise InputError(f"the design has no value for '{symbol.name()}': {nearest(symbol.name(), values)}")


def _column(name: str, values: list[Column]) -> Column:
    """Return the values of a result as a column, or raise InputError if they are not scalars."""
    try:
        single = all(ca.MX(value).numel() == 1 for value in values)
    except NOT_NUMBERS:
        single = False
    if not single:
        raise InputError(f"the result '{name}' of each soil must be one number: average it, or take its mean")
    return ca.vertcat(*values) if any(map(is_casadi, values)) else np.array(values, dtype=float).ravel()
