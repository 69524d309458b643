"""Distributions of soil properties, samples of them, and results of a function over samples.

Marginals are those of scipy.stats, truncated, and correlated by a Gaussian copula. The samples are the same for every
design, so that averages over them are smooth functions of the design.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import integrate, special
from scipy.stats import qmc

from plough_opt.core.checks import (
    NOT_NUMBERS,
    array_of,
    bound_of,
    check_bounds,
    check_callable,
    check_kind,
    check_named,
    check_text,
    pair_of,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import ByValue, Column, Expression, is_casadi
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import QUANTITIES
from plough_opt.design import Optimum
from plough_opt.design.model.nlp import refusals, split
from plough_opt.design.model.population import Population
from plough_opt.soil.soil import Soil

Response = Callable[[Soil], Mapping[str, Column]]

# Factor on the number of steps in a search. Averages are then accurate to some 1e-10, far better than the statistics of
# a few thousand samples.
_MORE_STEPS = 4.0


@dataclass(frozen=True, eq=False)
class SoilSamples(ByValue):
    """Equally likely soils.

    Attributes:
        soil: the soil with the properties that all samples share.
        names: names of the properties that differ.
        values: their values, a row for each sample and a column for each property; SI units.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> samples = field.sample(8)
        >>> len(samples), samples.names
        (8, ('cohesion',))
    """

    soil: Soil
    names: tuple[str, ...]
    values: Array

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[Soil]:
        return iter(self.soils)

    @cached_property
    def soils(self) -> tuple[Soil, ...]:
        """The soils, one for each row."""
        rows: list[list[Any]] = self.values.tolist()
        return tuple(replace(self.soil, **dict(zip(self.names, row, strict=True))) for row in rows)

    def property(self, name: str) -> Array:
        """Return the values of a property, SI.

        Raises:
            InputError: the name is not that of an uncertain property.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> field.corners(part=0.8).property("cohesion").round(6).tolist()
            [11000.0, 19000.0]
        """
        check_named("{} is not an uncertain property", name, self.names)
        return np.asarray(self.values[:, self.names.index(name)])

    def each(self, response: Callable[[Soil], Mapping[str, Expression]]) -> dict[str, Expression]:
        """Return name -> result of a function of the soil, as a column over the samples.

        Args:
            response: soil -> results by name, each a number or a scalar expression of a design.

        Raises:
            InputError: the results are not given by name, or are not scalars.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> found = field.sample(8).each(lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)})
            >>> found["draft"].shape
            (8,)
        """
        check_callable("the response", response, "of a soil that returns results by name")
        rows = [response(soil) for soil in self.soils]
        if not rows or not all(isinstance(row, Mapping) and row for row in rows):
            raise InputError('the response to a soil must be results by name, like {"draft": run.mean_draft}')
        return {name: _column(name, [row[name] for row in rows]) for name in rows[0]}


@dataclass(frozen=True, eq=False)
class ResponseValues(ByValue):
    """Results over samples.

    Attributes:
        values: name -> values over the samples that have results.
        failures: number of a sample without results -> the reason.
    """

    values: dict[str, Array]
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
        self._refusals = refusals(parts, [self._y])

    def __call__(self, at: Optimum | Mapping[str, float], samples: SoilSamples) -> ResponseValues:
        """Return the results for each soil at a design.

        Args:
            at: the design: an optimum, or variables and parameters by name.
            samples: the soils.
        """
        design = [_number(at, symbol) for symbol in self._design]
        rows = np.hstack([np.tile(design, (len(samples), 1)), samples.values])
        failures = self._refusals(rows)
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
    if isinstance(at, Optimum) and symbol.name() not in values:
        return float(at(symbol))
    check_named("the design has no value for {}", symbol.name(), values)
    return plain_number(f"'{symbol.name()}'", values[symbol.name()])


def _column(name: str, values: list[Column]) -> Column:
    """Return the values of a result as a column, or raise InputError if they are not scalars."""
    try:
        single = all(ca.MX(value).numel() == 1 for value in values)
    except NOT_NUMBERS:
        single = False
    if not single:
        raise InputError(f"the result '{name}' of each soil must be one number: average it, or take its mean")
    return ca.vertcat(*values) if any(map(is_casadi, values)) else np.array(values, dtype=float).ravel()


PROPERTIES = tuple(quantity.key for quantity in QUANTITIES.values() if quantity.owner == "soil")
"""Properties of a soil that can be uncertain."""

# The quantiles of this probability and of its complement must lie in the model's domain.
_TAIL = 1e-9
# Least probability between the bounds of a distribution: with less its quantiles are inaccurate.
_LEAST_MASS = 1e-9
# A correlation matrix with a smaller eigenvalue is taken as singular.
_LEAST_EIGENVALUE = 1e-8
_MOST_SAMPLES = 1 << 20
# Least coordinate of a point in the unit cube: at 0 and 1 the normal quantile is infinite.
_LEAST_COORDINATE = 2.0**-54


@dataclass(frozen=True)
class Marginal:
    """A distribution between bounds.

    Args:
        distribution: a frozen distribution of scipy.stats, or anything with `cdf` and `ppf` (or `icdf`).
        lower: lower bound at which it is truncated, or minus infinity.
        upper: upper bound, or infinity.
        name: name of the property, for messages.

    Raises:
        InputError: the distribution is not one, or there is hardly any probability between the bounds.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> marginal = po.uncertainty.Marginal(stats.norm(2e4, 5e3), lower=0.0)
        >>> round(float(marginal.quantile(0.5)))
        20000
    """

    distribution: Any
    lower: float = -math.inf
    upper: float = math.inf
    name: str = "the property"

    def __post_init__(self) -> None:
        check_text("the name of a distribution", self.name)
        if not callable(getattr(self.distribution, "cdf", None)) or self._inverse is None:
            raise InputError(
                f"{self.name}: {shown(self.distribution)} is not a distribution: give a frozen one of scipy.stats, such"
                " as stats.lognorm(0.3, scale=20e3)"
            )
        for side in ("lower", "upper"):
            # As a float, because SciPy cannot compute with integers of more than 63 bits.
            object.__setattr__(self, side, bound_of(f"{self.name}: its {side} bound", getattr(self, side)))
        check_bounds(self.name, self.lower, self.upper)
        with np.errstate(invalid="ignore"):
            middle = float(self._inverse(0.5))
        if not math.isfinite(middle):
            raise InputError(
                f"{self.name}: its distribution has no median, which happens with parameters such as a scale of 0; set"
                " a property that is not uncertain in the soil itself"
            )
        if not self._mass > _LEAST_MASS:
            raise InputError(
                f"{self.name}: the probability between its bounds {self.lower:g} and {self.upper:g} is"
                f" {self._mass:.1g}; the median is {middle:g}: set bounds around it"
            )

    @property
    def _inverse(self) -> Any:
        return getattr(self.distribution, "ppf", None) or getattr(self.distribution, "icdf", None)

    @cached_property
    def _below(self) -> float:
        return 0.0 if self.lower == -math.inf else float(self.distribution.cdf(self.lower))

    @cached_property
    def _mass(self) -> float:
        return (1.0 if self.upper == math.inf else float(self.distribution.cdf(self.upper))) - self._below

    def quantile(self, probability: ArrayLike) -> Array:
        """Return the quantiles of the distribution.

        Args:
            probability: a number or an array, from 0 to 1.

        Raises:
            InputError: a value that is not a number from 0 to 1.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> po.uncertainty.Marginal(stats.uniform(1e4, 1e4)).quantile([0.0, 0.25]).tolist()
            [10000.0, 12500.0]
        """
        numbers = _numbers("a probability", probability)
        if not np.all((numbers >= 0.0) & (numbers <= 1.0)):
            raise InputError(f"a probability = {shown(probability)} must lie from 0 to 1")
        untruncated = self._below + numbers * self._mass
        return np.asarray(np.clip(self._inverse(untruncated), self.lower, self.upper), dtype=float)

    def cdf(self, value: ArrayLike) -> Array:
        """Return the probability of lying below a value.

        Args:
            value: a number or an array, in the property's unit.

        Raises:
            InputError: a value that is not a number.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> float(po.uncertainty.Marginal(stats.uniform(1e4, 1e4)).cdf(12.5e3))
            0.25
        """
        below = self.distribution.cdf(_numbers("a value", value))
        return np.asarray(np.clip((below - self._below) / self._mass, 0.0, 1.0), dtype=float)

    @cached_property
    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation between the bounds, by quadrature over the probability."""
        mean = float(integrate.tanhsinh(self.quantile, 0.0, 1.0).integral)
        square = integrate.tanhsinh(lambda part: (self.quantile(part) - mean) ** 2, 0.0, 1.0).integral
        return mean, math.sqrt(float(square))


@dataclass(frozen=True, init=False)
class SoilDistribution:
    """A soil with uncertain properties.

    For example::

        field = po.SoilDistribution(
            po.named_soil("serozem"),
            cohesion=stats.lognorm(0.3, scale=20e3),
            friction_angle=stats.norm(po.deg(28), po.deg(3)),
            within={"friction_angle": (po.deg(20), po.deg(36))},
            correlation={("cohesion", "friction_angle"): -0.4},
        )
        soils = field.sample(64, seed=1)

    Correlated properties are joined by a Gaussian copula: a correlation c is that of their normal scores. Whatever the
    marginals, the rank correlations are then 6/pi arcsin(c/2) by Spearman and 2/pi arcsin(c) by Kendall.

    Args:
        soil: the soil, with the values of the properties that are not uncertain.
        within: property -> (lower, upper) bounds at which its distribution is truncated; either may be infinite.
        correlation: pair of properties -> correlation of their normal scores, between -1 and 1; other pairs are
            independent.
        **properties: property of `Soil` -> a frozen distribution of scipy.stats, in SI units and radians.

    Raises:
        InputError: an unknown property, no uncertain property, an object that is not a distribution, bounds without
            any probability between them, or contradictory correlations.
        DomainError: a distribution that extends outside the model's domain.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> "cohesion" in field.in_words()
        True
    """

    soil: Soil
    marginals: Mapping[str, Marginal]
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)

    def __init__(
        self,
        soil: Soil,
        *,
        within: Mapping[str, tuple[float, float]] | None = None,
        correlation: Mapping[tuple[str, str], float] | None = None,
        **properties: Any,
    ) -> None:
        for name in properties:
            check_named("{} is not a property of a soil", name, PROPERTIES)
        if not properties:
            raise InputError("nothing is uncertain: give a property a distribution, such as cohesion=stats.norm(...)")
        check_kind("the soil", soil, Soil, "a soil, which po.named_soil(...) or po.Soil(...) makes")
        for what, given in (("within", within), ("correlation", correlation)):
            check_kind(what, given, Mapping | None, "a dictionary with properties as keys")
        bounds = {name: pair_of(f"within: {name}", ends) for name, ends in (within or {}).items()}
        for name in bounds:
            check_named("within names {}, which has no distribution", name, properties)
        ends = {name: bounds.get(name, (-math.inf, math.inf)) for name in properties}
        marginals = {name: Marginal(given, *ends[name], name) for name, given in properties.items()}
        vars(self).update(soil=soil, marginals=marginals, correlation=dict(correlation or {}))
        self._check_domain()
        _ = self.factor

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the uncertain properties, in the given order."""
        return tuple(self.marginals)

    @property
    def correlated(self) -> bool:
        """Whether any two properties are correlated."""
        return any(value != 0.0 for value in self.correlation.values())

    @cached_property
    def matrix(self) -> Array:
        """Correlations of the normal scores, in the order of `names`."""
        matrix = np.eye(len(self.names))
        for pair, value in self.correlation.items():
            if isinstance(pair, str) or len(pair) != 2 or pair[0] == pair[1]:
                raise InputError(f"a correlation needs a pair of properties, not {shown(pair)}")
            for name in pair:
                check_named("the correlation names {}, which has no distribution", name, self.names)
            a, b = map(self.names.index, pair)
            what = f"the correlation of {pair[0]} and {pair[1]}"
            if matrix[a, b] != 0.0:
                raise InputError(f"{what} is given twice")
            matrix[a, b] = matrix[b, a] = plain_number(what, value, above=-1.0, below=1.0)
        return matrix

    @cached_property
    def factor(self) -> Array:
        """Cholesky factor of `matrix`: the lower triangle whose product with its transpose it is.

        Raises:
            InputError: correlations whose matrix is not positive definite.
        """
        least = float(np.linalg.eigvalsh(self.matrix)[0])
        if least < _LEAST_EIGENVALUE:
            pairs = ", ".join(f"{a} and {b} {value:g}" for (a, b), value in self.correlation.items())
            raise InputError(
                f"these correlations contradict each other ({pairs}): their matrix is not positive definite, with a"
                f" smallest eigenvalue of {least:.3g}; weaken one of them"
            )
        return np.asarray(np.linalg.cholesky(self.matrix), dtype=np.float64)

    def sample(self, count: int, *, seed: int = 0) -> SoilSamples:
        """Return samples that cover the distribution evenly: points of a scrambled Sobol sequence (scipy.stats.qmc).

        The same seed always gives the same samples, so that an objective over them is a smooth function of the design.
        A larger sample begins with the smaller one. Powers of two cover the distribution best.

        Raises:
            InputError: an invalid count or seed.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> samples = field.sample(64)
            >>> round(float(samples.property("cohesion").mean()), -2)
            15000.0
        """
        _check_draw(count, seed)
        sequence = qmc.Sobol(len(self.names), scramble=True, rng=np.random.default_rng(seed))
        return self.at(sequence.random_base2(math.ceil(math.log2(count)))[:count])

    def draw(self, count: int, *, seed: int) -> SoilSamples:
        """Return samples drawn independently of each other, as confidence intervals require.

        Raises:
            InputError: an invalid count or seed.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> len(field.draw(100, seed=1))
            100
        """
        _check_draw(count, seed)
        return self.at(np.random.default_rng(seed).random((count, len(self.names))))

    def corners(self, part: float = 0.9) -> SoilSamples:
        """Return the corners of a box of properties, for the worst case over a set.

        Args:
            part: probability that each property lies within the box, which ends at its quantiles (1 -+ part)/2.

        Raises:
            InputError: a part that is not between 0 and 1.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> field.corners(part=0.8).property("cohesion").round(6).tolist()
            [11000.0, 19000.0]
        """
        part = plain_number("the part of each distribution within the box", part, above=0.0, below=1.0)
        ends = [marginal.quantile([(1.0 - part) / 2.0, (1.0 + part) / 2.0]) for marginal in self.marginals.values()]
        grid = np.stack([axis.ravel() for axis in np.meshgrid(*ends, indexing="ij")], axis=1)
        return SoilSamples(self.soil, self.names, grid)

    def at(self, uniforms: ArrayLike) -> SoilSamples:
        """Return the samples at points of the unit cube, one per row, by the inverse Rosenblatt transform.

        The first property depends on the first coordinate; each further one also on the coordinates before its own.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> field.at([[0.25], [0.5]]).property("cohesion").tolist()
            [12500.0, 15000.0]
        """
        given = _numbers("points of the unit cube", uniforms)
        points: NDArray[Any] = np.clip(given, _LEAST_COORDINATE, 1.0 - 2.0 * _LEAST_COORDINATE)
        if points.ndim != 2 or points.shape[1] != len(self.names):
            raise InputError(f"points of the shape {points.shape} do not have a column for each of {self.names}")
        if self.correlated:
            points = np.asarray(special.ndtr(special.ndtri(points) @ self.factor.T))
        columns = [m.quantile(column) for m, column in zip(self.marginals.values(), points.T, strict=True)]
        return SoilSamples(self.soil, self.names, np.stack(columns, axis=1))

    def in_words(self) -> str:
        """Return mean and standard deviation of every property as text, SI units.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> field.in_words()
            'cohesion 1.5e+04 +- 2.9e+03'
        """
        return ", ".join(f"{name} {mean:.4g} +- {spread:.2g}" for name, (mean, spread) in self.moments.items())

    @property
    def moments(self) -> dict[str, tuple[float, float]]:
        """Property -> its mean and standard deviation, SI."""
        return {name: marginal.moments for name, marginal in self.marginals.items()}

    def _check_domain(self) -> None:
        """Raise DomainError if a distribution extends outside the model's domain."""
        for name, marginal in self.marginals.items():
            if is_casadi(getattr(self.soil, name)):
                raise InputError(f"'{name}' is an expression in the soil, so it cannot be uncertain too: give a number")
            for end in (_TAIL, 1.0 - _TAIL):
                value: Any = float(marginal.quantile(end))
                try:
                    replace(self.soil, **{name: value})
                except DomainError as error:
                    raise DomainError(
                        f"the distribution of {name} reaches {value:.4g}, outside the model's domain: {error}; truncate"
                        f' it: within={{"{name}": (lower, upper)}}, in a file lower = ... and upper = ...'
                    ) from None


def _numbers(what: str, values: ArrayLike) -> Array:
    """Return a number or an array as an array; raise InputError for anything else, including NaN."""
    taken_for_numbers = isinstance(values, str | bytes | bool | np.bool_)  # by NumPy
    refusal = f"{what} = {{}} must be a number or an array of numbers"
    return array_of(values, refusal, lambda array: not taken_for_numbers and not np.any(np.isnan(array)))


def _check_draw(count: int, seed: int) -> None:
    """Raise InputError for an invalid number of samples or an invalid seed."""
    whole_number("the number of samples", count, 1, _MOST_SAMPLES)
    whole_number("the seed", seed)
