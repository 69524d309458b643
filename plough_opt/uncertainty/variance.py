"""Which uncertain property a result owes its spread to: Sobol indices, by scipy.stats.sobol_indices."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.design import Optimum
from plough_opt.errors import InputError
from plough_opt.expressions import is_count
from plough_opt.uncertainty.distribution import SoilDistribution
from plough_opt.uncertainty.robust import Robust

Vector = NDArray[np.float64]

_CONFIDENCE = 0.95
_RESAMPLES = 200
# Relative spread that is none.
_NONE = 1e-9


@dataclass(frozen=True)
class SobolIndices:
    """Parts of the variance of one result at one design.

    Attributes:
        result: name of the result.
        names: the uncertain properties; where they are correlated, "b given a" is what a leaves to b.
        first: part of the variance that each explains by itself.
        total: part that would go with it alone: with what it explains together with others.
        first_low: lower ends of the confidence intervals (95 %, bootstrap) of `first`.
        first_high: upper ends.
        total_low: lower ends of those of `total`.
        total_high: upper ends.
        note: what a reader must know, or "".
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
        """Say what each property explains, the largest first."""
        order = np.argsort(-self.total)
        parts = [
            f"{self.names[k]} {100 * self.first[k]:.3g} % alone ({100 * self.first_low[k]:.2g} to"
            f" {100 * self.first_high[k]:.2g}), {100 * self.total[k]:.3g} % with others"
            for k in order
        ]
        return f"variance of {self.result}: {'; '.join(parts)}{'. ' + self.note if self.note else ''}"


def sobol_indices(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = 1024, seed: int = 1, correlated: bool = False
) -> dict[str, SobolIndices]:
    """Return, for each result, what part of its variance each uncertain property explains.

    Sobol indices (Sobol 1993; estimators of Saltelli et al. 2010, as scipy.stats.sobol_indices has them) split a
    variance among independent inputs. Correlated properties are therefore refused, unless it is said that the indices
    may be those of the independent coordinates behind the copula (Mara and Tarantola 2012): the first property in full,
    with all that it shares with the others, and each further one only as far as the earlier ones leave it open.
    A result that does not vary has no indices.

    Args:
        robust: the results.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: a power of two; the response is evaluated samples (properties + 2) times.
        seed: of the samples and of the bootstrap.
        correlated: accept the coordinates behind the copula.

    Raises:
        InputError: correlated properties, a number that is no power of two, or soils without result.
    """
    field = robust.field
    if not is_count(samples) or samples < 2 or samples & (samples - 1):
        raise InputError(f"samples = {samples!r} must be a power of two, as the Sobol sequence needs")
    if field.correlated and not correlated:
        raise InputError(
            "correlated properties share variance, which Sobol indices cannot split between them: leave the correlation"
            " out, or say correlated=True for the independent coordinates behind the copula"
        )

    own = robust.values(at)
    results = [name for name, value in own.items() if np.ptp(value) > _NONE * np.max(np.abs(value))]
    if not results:
        return {}

    def response(uniforms: Vector) -> Vector:
        values = robust.values(at, field.at(uniforms.T))
        return np.stack([values[name] for name in results])

    generator = np.random.default_rng(seed)
    dists = [stats.uniform()] * len(field.names)
    found = stats.sobol_indices(func=response, n=samples, dists=dists, rng=generator)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        # Of a property that a result does not depend on, all resampled indices are alike.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        spread = found.bootstrap(confidence_level=_CONFIDENCE, n_resamples=_RESAMPLES)
    first, total = np.atleast_2d(found.first_order), np.atleast_2d(found.total_order)
    pairs = ((first, spread.first_order), (total, spread.total_order))
    ends = [
        np.where(np.isfinite(end), end, index)
        for index, own in pairs
        for end in (np.atleast_2d(own.confidence_interval.low), np.atleast_2d(own.confidence_interval.high))
    ]
    note = "the properties are correlated: each counts as far as the ones before it leave it open"
    return {
        name: SobolIndices(
            result=name,
            names=_names(field),
            first=first[k],
            total=total[k],
            first_low=ends[0][k],
            first_high=ends[1][k],
            total_low=ends[2][k],
            total_high=ends[3][k],
            note=note if field.correlated else "",
        )
        for k, name in enumerate(results)
    }


def _names(field: SoilDistribution) -> tuple[str, ...]:
    """Return the properties' names, each with those before it on which it depends."""
    found = []
    for k, name in enumerate(field.names):
        before = [other for other, weight in zip(field.names, field.factor[k, :k], strict=False) if weight != 0.0]
        found.append(f"{name} given {' and '.join(before)}" if before else name)
    return tuple(found)
