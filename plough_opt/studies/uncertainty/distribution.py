"""Soils whose properties are known only roughly: distributions of scipy.stats, truncated and correlated by rank."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy import integrate, special
from scipy.stats import qmc

from plough_opt.core.checks import (
    check_kind,
    check_named,
    check_switch,
    mapping_of,
    pair_of,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import is_casadi
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import QUANTITIES
from plough_opt.soil.soil import Soil

PROPERTIES = tuple(quantity.key for quantity in QUANTITIES.values() if quantity.owner == "soil")
"""Properties of a soil that can be uncertain."""
MOST_SAMPLES: Final = 1 << 20
# Soils lie between the quantiles of this probability and of its complement, which the model must accept: without it a
# normal score would be infinite.
_TAIL: Final = 1e-9


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

    A correlation c is that of the properties' normal scores. Whatever the distributions, the rank correlations are then
    6/pi arcsin(c/2) by Spearman and 2/pi arcsin(c) by Kendall.

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
        >>> field
        <SoilDistribution: cohesion 1.5e+04 +- 2.9e+03>
    """

    def __init__(
        self,
        soil: Soil,
        *,
        within: Mapping[str, tuple[float, float]] | None = None,
        correlation: Mapping[tuple[str, str], float] | None = None,
        **properties: Any,
    ) -> None:
        check_kind("the soil", soil, Soil, "a soil, which po.named_soil(...) or po.Soil(...) makes")
        if not properties:
            raise InputError("nothing is uncertain: give a property a distribution, such as cohesion=stats.norm(...)")
        ends = dict.fromkeys(properties, (-math.inf, math.inf))
        for name, pair in mapping_of("within", within, "a property -> its bounds").items():
            check_named("within names {}, which has no distribution", name, properties)
            ends[name] = pair_of(f"within: {name}", pair)
        self.soil, self.names = soil, tuple(properties)
        self.correlation = dict(mapping_of("correlation", correlation, "two properties -> a number"))
        self._factor = _cholesky(self.names, self.correlation)
        self._quantiles: dict[str, Callable[[Array], Array]] = {}
        for name, distribution in properties.items():
            check_named("{} is not a property of a soil", name, PROPERTIES)
            self._quantiles[name] = _truncated(soil, name, distribution, ends[name])

    def __repr__(self) -> str:
        """Return mean and standard deviation of every property, SI."""
        moments = ", ".join(f"{name} {mean:.4g} +- {spread:.2g}" for name, (mean, spread) in self.moments.items())
        return f"<SoilDistribution: {moments}>"

    @cached_property
    def moments(self) -> dict[str, tuple[float, float]]:
        """Property -> its mean and standard deviation, SI, by quadrature over the probability."""
        moments = {}
        for name, quantile in self._quantiles.items():
            mean = float(integrate.tanhsinh(quantile, 0.0, 1.0).integral)
            variance = integrate.tanhsinh(lambda u, q=quantile, m=mean: (q(u) - m) ** 2, 0.0, 1.0).integral
            moments[name] = mean, math.sqrt(float(variance))
        return moments

    def sample(self, count: int, *, seed: int = 0, independent: bool = False) -> tuple[Soil, ...]:
        """Return soils of equal probability; the arguments are those of `values`.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> 1e4 < field.sample(8)[0].cohesion < 2e4
            True
        """
        rows: list[list[Any]] = self.values(count, seed=seed, independent=independent).tolist()
        return tuple(replace(self.soil, **dict(zip(self.names, row, strict=True))) for row in rows)

    def values(self, count: int, *, seed: int = 0, independent: bool = False) -> Array:
        """Return the uncertain properties of soils of equal probability, SI: a row for each soil, columns as `names`.

        By default they are points of a scrambled Sobol sequence (scipy.stats.qmc), which cover the distribution evenly:
        best with a power of two. The same seed gives the same soils, and a larger sample begins with the smaller one.

        Args:
            count: number of soils, at most 2^20.
            seed: seed of the random numbers.
            independent: draw the soils independently of each other, as confidence intervals require.

        Raises:
            InputError: an invalid count or seed.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> round(float(field.values(64).mean()), -2)
            15000.0
        """
        whole_number("the number of samples", count, 1, MOST_SAMPLES)
        check_switch("independent", independent)
        generator = np.random.default_rng(whole_number("the seed", seed))
        if independent:
            points = generator.random((count, len(self.names)))
        else:
            points = qmc.Sobol(len(self.names), rng=generator).random_base2(math.ceil(math.log2(count)))[:count]
        scores = special.ndtri(np.clip(points, _TAIL, 1.0 - _TAIL)) @ self._factor.T
        ranks = np.clip(special.ndtr(scores), _TAIL, 1.0 - _TAIL)
        return np.stack([own(column) for own, column in zip(self._quantiles.values(), ranks.T, strict=True)], axis=1)


def _truncated(soil: Soil, name: str, distribution: Any, bounds: tuple[float, float]) -> Callable[[Array], Array]:
    """Return the quantiles of a distribution of scipy.stats between bounds.

    Raises:
        InputError: it has none, or none between the bounds.
        DomainError: it extends outside the model's domain.
    """
    inverse = getattr(distribution, "ppf", None) or getattr(distribution, "icdf", None)
    if inverse is None or not callable(getattr(distribution, "cdf", None)):
        example = "give a frozen one of scipy.stats, such as stats.lognorm(0.3, scale=20e3)"
        raise InputError(f"{name}: {shown(distribution)} is not a distribution: {example}")
    if is_casadi(getattr(soil, name)):
        raise InputError(f"'{name}' is an expression in the soil, so it cannot be uncertain too: give a number")
    with np.errstate(invalid="ignore"):
        median, (first, last) = float(inverse(0.5)), (float(distribution.cdf(end)) for end in bounds)
    if not math.isfinite(median):
        why = "which happens with parameters such as a scale of 0; set a property without spread in the soil itself"
        raise InputError(f"{name}: its distribution has no median, {why}")
    if not last - first > _TAIL:
        between = f"the probability between its bounds {bounds[0]:g} and {bounds[1]:g} is {last - first:.1g}"
        raise InputError(f"{name}: {between}; the median is {median:g}: set bounds around it")

    def quantiles(probability: Array) -> Array:
        return np.asarray(np.clip(inverse(first + probability * (last - first)), *bounds), dtype=float)

    for value in quantiles(np.array([_TAIL, 1.0 - _TAIL])).tolist():
        try:
            replace(soil, **{name: value})
        except DomainError as error:
            how = f'truncate it: within={{"{name}": (lower, upper)}}, in a file lower = ... and upper = ...'
            reaches = f"the distribution of {name} reaches {value:.4g}, outside the model's domain"
            raise DomainError(f"{reaches}: {error}; {how}") from None
    return quantiles


def _cholesky(names: tuple[str, ...], correlation: Mapping[tuple[str, str], float]) -> Array:
    """Return the lower triangle whose product with its transpose has the correlations of normal scores."""
    matrix = np.eye(len(names))
    for pair, value in correlation.items():
        if not isinstance(pair, tuple) or len(pair) != 2 or pair[0] == pair[1]:
            raise InputError(f"a correlation needs a pair of properties, not {shown(pair)}")
        for name in pair:
            check_named("the correlation names {}, which has no distribution", name, names)
        a, b = map(names.index, pair)
        what = f"the correlation of {pair[0]} and {pair[1]}"
        if matrix[a, b] != 0.0:
            raise InputError(f"{what} is given twice")
        matrix[a, b] = matrix[b, a] = plain_number(what, value, above=-1.0, below=1.0)
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        pairs = ", ".join(f"{a} and {b} {value:g}" for (a, b), value in correlation.items())
        contradict = f"these correlations contradict each other ({pairs})"
        raise InputError(f"{contradict}: their matrix is not positive definite; weaken one") from None
