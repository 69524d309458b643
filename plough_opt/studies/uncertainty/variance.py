"""Sobol indices: the part of a result's variance that each uncertain property explains."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from plough_opt.core.checks import check_kind, shown
from plough_opt.core.errors import InputError, printable
from plough_opt.core.expressions import is_count
from plough_opt.core.plain_data import Array as Vector
from plough_opt.design import Optimum
from plough_opt.studies.uncertainty.distribution import SoilDistribution
from plough_opt.studies.uncertainty.robust import Robust

_CONFIDENCE = 0.95
_RESAMPLES = 200
# A result whose relative range is smaller does not vary: the rest is rounding.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class SobolIndices:
    """The Sobol indices of one result at one design.

    Attributes:
        result: name of the result.
        names: the uncertain properties; if they are correlated, "b given a" is b for a known a.
        first: first-order indices: the part of the variance that each property explains alone.
        total: total indices: the part that each explains alone and in interaction with others.
        first_low: lower ends of the confidence intervals (95 %, bootstrap) of `first`.
        first_high: upper ends of these intervals.
        total_low: lower ends of the confidence intervals of `total`.
        total_high: upper ends of these intervals.
        note: a warning, or "".
    """

    result: str
    names: tuple[str, ...]
    first: Vector
    total: Vector
    first_low: Vector
    first_high: Vector
    total_low: Vector
    total_high: Vector
    note: str

    def __str__(self) -> str:
        """Return the part of the variance that each property explains, the largest first."""
        order = np.argsort(-self.total)
        parts = [
            f"{self.names[k]} {100 * self.first[k]:.3g} % alone ({100 * self.first_low[k]:.2g} to"
            f" {100 * self.first_high[k]:.2g}), {100 * self.total[k]:.3g} % with others"
            for k in order
        ]
        return printable(f"variance of {self.result}: {'; '.join(parts)}{'. ' + self.note if self.note else ''}")


def sobol_indices(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = 1024, seed: int = 1, correlated: bool = False
) -> dict[str, SobolIndices]:
    """Return, for each result, the part of its variance that each uncertain property explains.

    Sobol indices (Sobol 1993; estimators of Saltelli et al. 2010, table 2, b and f) divide a variance among independent
    inputs. Correlated properties therefore raise an error, unless ``correlated`` accepts indices of the independent
    coordinates behind the copula (Mara and Tarantola 2012). The first property then includes all that it shares with
    the others, and each further one only the part that is independent of those before it. A result that does not vary
    has no indices. Confidence intervals are percentile intervals of the bootstrap (Efron 1979).

    Args:
        robust: the results.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: a power of two; the response is evaluated samples * (properties + 2) times.
        seed: seed of the samples and of the bootstrap.
        correlated: whether to accept the coordinates behind the copula.

    Raises:
        InputError: the properties are correlated, the number of samples is not a power of two, or a soil has no result.
    """
    check_kind("the results", robust, Robust, "a Robust")
    field = robust.field
    if not is_count(samples) or samples < 2 or samples & (samples - 1):
        raise InputError(f"samples = {shown(samples)} must be a power of two, as the Sobol sequence needs")
    if field.correlated and not correlated:
        raise InputError(
            "Sobol indices cannot divide the variance that correlated properties share: leave the correlation out, or"
            " use correlated=True for the independent coordinates behind the copula"
        )

    over_samples = robust.values(at)
    results = [name for name, value in over_samples.items() if np.ptp(value) > _NEGLIGIBLE * np.max(np.abs(value))]
    if not results:
        return {}

    # Two independent samples, and for each property a third: the first sample with this property from the second.
    count, generator = len(field.names), np.random.default_rng(seed)
    both = qmc.Sobol(2 * count, bits=64, rng=generator).random(samples)
    designs = np.repeat(both[None, :, :count], count + 2, axis=0)
    designs[-1] = both[:, count:]
    for k in range(count):
        designs[1 + k, :, k] = both[:, count + k]
    values = robust.values(at, field.at(designs.reshape(-1, count)))
    answers = np.stack([values[name] for name in results]).reshape(len(results), count + 2, samples)
    first, total = _indices(answers)
    again = [_indices(answers[..., generator.integers(samples, size=samples)]) for _ in range(_RESAMPLES)]
    tail = (1.0 - _CONFIDENCE) / 2.0
    (first_low, total_low), (first_high, total_high) = np.quantile(again, (tail, 1.0 - tail), axis=0)
    note = "the properties are correlated: each counts only as far as it is independent of those before it"
    return {
        name: SobolIndices(
            result=name,
            names=_names(field),
            first=first[k],
            total=total[k],
            first_low=first_low[k],
            first_high=first_high[k],
            total_low=total_low[k],
            total_high=total_high[k],
            note=note if field.correlated else "",
        )
        for k, name in enumerate(results)
    }


def _indices(answers: Vector) -> tuple[Vector, Vector]:
    """Return first-order and total indices, each of the shape (results, properties).

    Args:
        answers: results (results, properties + 2, samples) over the first sample, over those with one property from
            the second, and over the second sample.
    """
    variance = np.var(answers[:, [0, -1]], axis=(1, 2))[:, None]
    variance[variance == 0.0] = 1.0  # a resample may repeat a single point: its indices are then 0
    # Subtracting the mean first makes the products more accurate (Sobol and Levitan 1999).
    other = answers[:, -1] - np.mean(answers[:, [0, -1]], axis=(1, 2))[:, None]
    change = answers[:, 1:-1] - answers[:, :1]
    first = np.mean(other[:, None] * change, axis=-1) / variance
    return first, np.mean(change**2, axis=-1) / (2.0 * variance)


def _names(field: SoilDistribution) -> tuple[str, ...]:
    """Return the properties' names, each with the earlier ones that it depends on."""
    names = []
    for k, name in enumerate(field.names):
        before = [other for other, weight in zip(field.names, field.factor[k, :k], strict=False) if weight != 0.0]
        names.append(f"{name} given {' and '.join(before)}" if before else name)
    return tuple(names)
