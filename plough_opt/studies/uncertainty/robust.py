"""`Robust`: results of a design over common soils, their mean and spread; `verify`, which checks them on fresh soils.

A requirement that must hold with a probability limits mean + k standard deviations, with the k that gives this
probability for a normal distribution. The optimiser's soils flatter the design, and a result need not be normal: soils
that are drawn independently, and that the optimiser did not use, show how often the limit holds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final

import casadi as ca
import numpy as np
from scipy import stats

from plough_opt.core.checks import (
    INSIDE,
    LARGEST,
    NOT_NUMBERS,
    array_of,
    check_callable,
    check_kind,
    check_limits,
    check_named,
    check_text,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import InputError, printable
from plough_opt.core.expressions import ByValue, Column, Expression, is_casadi, sqrt, total
from plough_opt.core.plain_data import Array
from plough_opt.core.units import Display, in_words
from plough_opt.design import Design, Optimum
from plough_opt.design.model.nlp import refusals, split
from plough_opt.design.model.population import Population
from plough_opt.soil.soil import Soil
from plough_opt.studies.uncertainty.distribution import SoilDistribution

Response = Callable[[Soil], Mapping[str, Expression]]

CONFIDENCE: Final = 0.95
# Spread that a standard deviation has at least, relative to the mean: the square root has no derivative at 0.
_LEAST_SPREAD: Final = 1e-10
# Verification raises an error if a larger part of the fresh soils has no result.
_MOST_FAILURES: Final = 0.01
# Factor on the steps of a search, with which averages are right to some 1e-10.
_MORE_STEPS: Final = 4.0


def expected(values: Column) -> Column:
    """Return the mean of a result over equally likely soils.

    Example:
        >>> import plough_opt as po
        >>> float(po.uncertainty.expected([1.0, 2.0, 3.0, 10.0]))
        4.0
    """
    column = _column(values)
    mean: Column = total(column) / column.shape[0]
    return mean


def standard_deviation(values: Column) -> Column:
    """Return the standard deviation of a result over equally likely soils, with 1/n.

    It has a derivative even if all values are equal: it is at least 1e-10 of the mean.

    Example:
        >>> import plough_opt as po
        >>> round(float(po.uncertainty.standard_deviation([1.0, 2.0, 3.0, 10.0])), 3)
        3.536
    """
    column = _column(values)
    mean = expected(column)
    return sqrt(expected((column - mean) ** 2) + (_LEAST_SPREAD * mean) ** 2 + 1.0 / LARGEST**2)


class Robust:
    """The results of a design over common soils.

    For example::

        def response(soil):
            scene = po.Scene(soil, share, k0, mass, 2.0, effects)
            return {"draft": po.simulate(scene, 2.0).mean_draft, "radius": scene.loosened_radius}

        robust = po.Robust(field, response, samples=64, seed=1)
        d.minimise(robust.mean_plus("draft", 2.0) / 1e3)
        robust.require_probability(d, "radius", "radius", 0.95, at_least=0.15, unit="m")
        best = d.solve()
        print(po.uncertainty.verify(robust, best))

    The soils are the same for every design, so that means and spreads are smooth functions of the design. All of them
    are in one program: their runs share one integrator, which is mapped over them.

    Args:
        field: the distribution of the soil.
        response: soil -> results by name, each a scalar expression of the design.
        samples: number of soils, drawn by `SoilDistribution.sample`; best a power of two.
        seed: seed of the soils.

    Raises:
        InputError: the response does not return scalars by name, or the number of samples is invalid.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> cone = po.Cone("10 deg", "25 cm")
        >>> po.Robust(field, lambda soil: {"radius": po.loosened_radius(cone, soil)}, samples=8)
        <Robust: radius over 8 soils of cohesion 1.5e+04 +- 2.9e+03>
    """

    def __init__(self, field: SoilDistribution, response: Response, *, samples: int = 64, seed: int = 1) -> None:
        check_kind("the field", field, SoilDistribution, "a SoilDistribution")
        check_callable("the response", response, "of a soil that returns results by name")
        whole_number("the number of samples", samples, 1)
        symbols: list[Any] = [ca.MX.sym(name) for name in field.names]
        results = response(replace(field.soil, **dict(zip(field.names, symbols, strict=True))))
        if not isinstance(results, Mapping) or not results:
            raise InputError('the response to a soil must be results by name, like {"draft": run.mean_draft}')
        self.field, self.samples, self.seed = field, samples, seed
        self._symbols, self._results = symbols, ca.vertcat(*(_single(*item) for item in results.items()))
        soils = field.values(samples, seed=seed).tolist()
        rows = [ca.graph_substitute([self._results], symbols, [ca.MX(x) for x in soil])[0] for soil in soils]
        columns = ca.vertsplit(ca.horzcat(*rows))
        numeric = not ca.symvar(ca.veccat(*columns))
        self.columns: dict[str, Column] = {
            name: np.asarray(ca.evalf(column)).ravel() if numeric else column.T
            for name, column in zip(results, columns, strict=True)
        }
        self.requested: list[Requested] = []

    def __repr__(self) -> str:
        """Return the results and the uncertain properties in a line."""
        own = repr(self.field).partition(": ")[2]
        return f"<Robust: {', '.join(self.columns)} over {self.samples} soils of {own}"

    def __getitem__(self, name: str) -> Column:
        """Return a result as a column over the soils."""
        check_named("{} is not a result of the response", name, self.columns)
        return self.columns[name]

    def expected(self, name: str) -> Expression:
        """Return the mean of a result, which `verify` checks.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> round(float(robust.expected("draft")), -2)
            2000.0
        """
        return self.mean_plus(name, 0.0)

    def mean_plus(self, name: str, kappa: float) -> Expression:
        """Return mean + kappa * standard deviation of a result, which `verify` checks; kappa may be negative.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> bool(robust.mean_plus("draft", 2.0) > robust.expected("draft"))
            True
        """
        values, kappa = self[name], plain_number("kappa", kappa)
        side = f" {'+' if kappa > 0.0 else '-'} {abs(kappa):.4g} standard deviations" if kappa else ""
        self.requested.append(Requested(name, f"mean{side}", kappa))
        measure: Expression = _mean_plus(values, kappa)
        return measure

    def require_probability(
        self,
        design: Design,
        requirement: str,
        name: str,
        probability: float,
        *,
        at_least: float | None = None,
        at_most: float | None = None,
        unit: str = "",
        display: Display | None = None,
    ) -> None:
        """Require a result to keep a limit with a probability, or in every one of the common soils.

        With the normal quantile k of the probability, mean + k standard deviations must keep an upper limit, and mean -
        k standard deviations a lower one. `verify` tells in what part of fresh soils the result keeps its limit.

        Args:
            design: the design that gets the requirement.
            requirement: name of the requirement in reports.
            name: name of the result.
            probability: above 0; 1 requires every one of the common soils to keep the limits.
            at_least: lower limit, or None.
            at_most: upper limit, or None; with a probability below 1 there must be only one limit.
            unit: unit of the result, for reports.
            display: unit in reports, if it is another.

        Raises:
            InputError: no limit, two limits with a probability below 1, or an invalid probability.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> robust.require_probability(design, "draft", "draft", 0.9, at_most=3e3, unit="N")
            >>> design.minimise(-height)
            >>> round(design.solve(search="near").variables["height"], 2)
            0.3
        """
        check_kind("the design", design, Design, "a Design")
        check_text("the name of a requirement", requirement)
        values, part = self[name], plain_number("the probability", probability, above=0.0, at_most=1.0)
        low, high = (None if end is None else plain_number("a limit", end, unit) for end in (at_least, at_most))
        check_limits(f"'{requirement}'", low, high, partial(in_words, unit=unit))
        if part < 1.0:
            if low is not None and high is not None:
                raise InputError(f"'{requirement}': with a probability give one limit; two limits are two requirements")
            kappa = float(stats.norm.ppf(part))
            values = _mean_plus(values, -kappa if high is None else kappa)
        design.require(requirement, values, at_least=low, at_most=high, unit=unit, display=display)
        shown_ends = (
            f"at {side} {in_words(end, unit)}" for side, end in (("least", low), ("most", high)) if end is not None
        )
        limits = -math.inf if low is None else low, math.inf if high is None else high
        self.requested.append(Requested(name, f"probability of {' and '.join(shown_ends)}", 0.0, part, limits))

    def values(self, at: Optimum | Mapping[str, float], properties: Array | None = None) -> dict[str, Array]:
        """Return name -> values of each result over soils at a design; NaN in soils that have none.

        Args:
            at: an optimum, or a design by the names of its variables and parameters.
            properties: the soils, as `SoilDistribution.values` returns them (default: the common ones).

        Raises:
            InputError: a variable or parameter is missing.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> robust.values({"height": 0.3})["draft"].shape
            (8,)
        """
        if properties is None:
            properties = self.field.values(self.samples, seed=self.seed)
        wanted = "{} must have a column for each of " + ", ".join(self.field.names)
        properties = array_of(properties, wanted, lambda own: own.ndim == 2 and own.shape[1] == len(self.field.names))
        symbols, evaluate = self._evaluation
        chosen = np.array([_number(at, symbol) for symbol in symbols])
        values = evaluate(np.hstack([np.tile(chosen, (len(properties), 1)), properties]))
        return dict(zip(self.columns, values.T, strict=True))

    @cached_property
    def _evaluation(self) -> tuple[list[ca.MX], Callable[[Array], Array]]:
        """The design's symbols, and (their values beside those of a soil, a row for each soil) -> results."""
        own = {hash(symbol) for symbol in self._symbols}
        symbols = [symbol for symbol in ca.symvar(self._results) if hash(symbol) not in own]
        y, none = ca.MX.sym("design and soil", len(symbols) + len(own)), ca.MX.sym("none", 0)
        (column,) = ca.graph_substitute([self._results], [*symbols, *self._symbols], ca.vertsplit(y))
        parts = split([column[0], column], [y, none])
        population, refused = Population(parts, y, none, rough=False), refusals(parts, [y])

        def evaluate(rows: Array) -> Array:
            values = population(rows, np.empty(0), finer=_MORE_STEPS)[1]
            values[[*refused(rows)]] = np.nan
            return values

        return symbols, evaluate


def _single(name: str, value: Any) -> ca.MX:
    """Return a result as a scalar expression, or raise InputError if it is none."""
    with suppress(*NOT_NUMBERS):
        expression: ca.MX = ca.MX(value)
        if expression.numel() == 1:
            return expression
    raise InputError(f"the result '{name}' of each soil must be one number: average it, or take its mean")


def _column(values: Column) -> Any:
    """Return values as a column; raise InputError if there are none, or if some are no finite numbers."""
    column: Any = ca.vec(values) if is_casadi(values) else array_of(values, "{} are not values over soils").ravel()
    if not column.shape[0] or not (is_casadi(values) or np.all(np.abs(column) <= LARGEST)):
        raise InputError(f"{shown(values)} must be one or more finite numbers within {LARGEST:g}")
    return column


def _mean_plus(values: Column, kappa: float) -> Column:
    return expected(values) + kappa * standard_deviation(values) if kappa else expected(values)


def _number(at: Optimum | Mapping[str, float], symbol: ca.MX) -> float:
    """Return the value of a design's variable or parameter."""
    check_kind("the design", at, Optimum | Mapping, "an Optimum, or its values by name")
    if isinstance(at, Optimum):
        return float(at(symbol))
    check_named("the design has no value for {}", symbol.name(), at)
    return plain_number(f"'{symbol.name()}'", at[symbol.name()])


@dataclass(frozen=True)
class Requested:
    """What a design uses of a result: mean + kappa standard deviations, or limits that hold with a probability."""

    result: str
    text: str
    kappa: float = 0.0
    probability: float | None = None
    limits: tuple[float, float] = (-math.inf, math.inf)

    def check(self, common: Array, fresh: Array) -> Check:
        """Return the check of values over the common soils by those over fresh ones."""
        count = len(fresh)
        if self.probability is not None:
            (low, high), rounding = self.limits, INSIDE * np.abs(fresh)
            inside = int(np.sum((fresh >= low - rounding) & (fresh <= high + rounding)))
            ends = stats.binomtest(inside, count).proportion_ci(CONFIDENCE)
            return Check(self.result, self.text, self.probability, inside / count, ends.low, ends.high, True)
        value, off = float(_mean_plus(fresh, self.kappa)), fresh - np.mean(fresh)
        # How a soil's weight changes mean and standard deviation: the variance over n is that of the estimate.
        influence = off + self.kappa * off**2 / (2.0 * float(standard_deviation(fresh)))
        half = float(stats.norm.ppf(0.5 + CONFIDENCE / 2.0) * np.std(influence)) / math.sqrt(count)
        half += INSIDE * abs(value)
        return Check(self.result, self.text, float(_mean_plus(common, self.kappa)), value, value - half, value + half)


@dataclass(frozen=True)
class Check:
    """One measure of a design over fresh soils.

    Attributes:
        result: name of its result.
        text: the measure in words.
        wanted: the optimiser's value over its own soils; of a probability, the one that was required.
        fresh: the value over the fresh soils.
        low: lower end of the 95 % confidence interval for the whole distribution.
        high: upper end of this interval.
        probability: whether the measure is the probability that a limit holds.

    Example:
        >>> from plough_opt.uncertainty import Check
        >>> print(Check("draft", "mean", 2000.0, 2010.0, 1995.0, 2025.0))
        draft, mean: wanted 2000, fresh soils give 2010 (95 %: 1995 to 2025): confirmed
    """

    result: str
    text: str
    wanted: float
    fresh: float
    low: float
    high: float
    probability: bool = False

    @property
    def verdict(self) -> str:
        """Whether fresh soils confirm the value: it must be in the interval, or a probability not above it."""
        if self.wanted <= self.high and (self.probability or self.wanted >= self.low):
            return "confirmed"
        return "larger than wanted" if self.wanted < self.low else "smaller than wanted"

    @property
    def confirmed(self) -> bool:
        """Whether fresh soils confirm the value."""
        return self.verdict == "confirmed"

    def __str__(self) -> str:
        """Return the check in a sentence."""
        interval = f"{100 * CONFIDENCE:.0f} %: {self.low:.6g} to {self.high:.6g}"
        pair = f"wanted {self.wanted:.6g}, fresh soils give {self.fresh:.6g}"
        return printable(f"{self.result}, {self.text}: {pair} ({interval}): {self.verdict}")


@dataclass(frozen=True, eq=False)
class Verification(ByValue):
    """The measures of a design over fresh soils.

    Attributes:
        checks: the check of every measure that the design uses.
        samples: number of fresh soils with results.
        failures: number of fresh soils without results, which are left out.
        values: name of a result -> its values over the fresh soils.
        seed: seed of the fresh soils.
        seconds: time taken [s].

    Example:
        >>> from plough_opt.uncertainty import Check, Verification
        >>> check = Check("draft", "mean", 2000.0, 2010.0, 1995.0, 2025.0)
        >>> Verification((check,), 256, 0, {}, 1, 0.1).confirmed
        True
    """

    checks: tuple[Check, ...]
    samples: int
    failures: int
    values: Mapping[str, Array]
    seed: int
    seconds: float

    @property
    def confirmed(self) -> bool:
        """Whether every measure is confirmed."""
        return all(check.confirmed for check in self.checks)

    def __str__(self) -> str:
        """Return one line for each check."""
        return "\n".join(map(str, self.checks))


def verify(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = 4096, seed: int = 20_000
) -> Verification:
    """Check every measure that a design uses on fresh soils, drawn independently of each other.

    Probabilities get the exact interval of Clopper and Pearson (scipy.stats.binomtest), means and standard deviations
    the normal interval of their influence functions.

    Args:
        robust: the results in the design.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: number of fresh soils, at least 100.
        seed: seed of the fresh soils.

    Raises:
        InputError: too few samples, or too many soils without results.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> objective = robust.expected("draft")
        >>> po.uncertainty.verify(robust, {"height": 0.3}, samples=256).confirmed
        True
    """
    check_kind("the results", robust, Robust, "a Robust")
    started = time.perf_counter()
    whole_number("samples for confidence intervals", samples, 100)
    common, fresh = robust.values(at), robust.values(at, robust.field.values(samples, seed=seed, independent=True))
    for where, values in (("its own soils", common), ("the fresh soils", fresh)):
        without = ~np.all(np.isfinite([*values.values()]), axis=0)
        if np.mean(without) > (_MOST_FAILURES if values is fresh else 0.0):
            lost = f"at this design {np.sum(without)} of {len(without)} of {where} have no result"
            raise InputError(f"{lost}: keep the design in the model's domain, and truncate the distribution there")
    values = {name: column[~without] for name, column in fresh.items()}
    checks = tuple(dict.fromkeys(own.check(common[own.result], values[own.result]) for own in robust.requested))
    seconds = time.perf_counter() - started
    return Verification(checks, int(np.sum(~without)), int(np.sum(without)), values, seed, seconds)
