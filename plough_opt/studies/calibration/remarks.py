"""What a reader of a fit must know: combinations that the data do not determine, in words, and warnings."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import linalg, stats

from plough_opt.core.errors import IntegrationError, listed
from plough_opt.core.plain_data import Array
from plough_opt.core.units import in_words
from plough_opt.studies.calibration.least_squares import Solution, quantile
from plough_opt.studies.calibration.measurements import Measurements
from plough_opt.studies.calibration.model import Model, Unknown, is_closed

# Significance of tests of the scatter; and of errors that grow, where one fit in twenty is warned in vain.
_SIGNIFICANCE, _GROWING = 1e-3, 0.05
# Fewest residuals whose correlation means something.
_FEWEST: Final = 8


@dataclass(frozen=True)
class Undetermined:
    """A combination of unknowns along which predictions change by less than the scatter of the data, or not at all.

    Attributes:
        changes: unknown -> its change along the direction, SI, at the fit; the first is one per cent of its bounds.
        structural: whether the predictions do not change at all; otherwise the data are not accurate enough.
        words: a sentence about it.
    """

    changes: Mapping[str, float]
    structural: bool
    words: str


def undetermined(unknowns: Sequence[Unknown], fit: Solution) -> Iterator[Undetermined]:
    """Yield the undetermined combinations, each of as few unknowns as possible."""
    without_effect, pivots = _sparse(fit.vectors[:, np.isinf(fit.deviation)], 1e-6)
    # Directions without effect may be subtracted from those with little effect, which leaves fewer unknowns in these.
    weak = fit.vectors[:, fit.free & np.isfinite(fit.deviation)]
    weak, _ = _sparse(weak - without_effect @ weak[pivots, :], 5e-3)
    for directions, structural in ((without_effect, True), (weak, False)):
        for direction in directions.T:
            members = [k for k in np.argsort(-np.abs(direction), kind="stable") if direction[k] != 0.0]
            size = 0.01 / direction[members[0]]
            changes = {unknowns[k].name: float(size * direction[k] * unknowns[k].slope(fit.y[k])) for k in members}
            yield Undetermined(changes, structural, _words([unknowns[k] for k in members], changes, structural))


def _sparse(free: Array, least: float) -> tuple[Array, list[int]]:
    """Return a basis of the same space, and its pivots: each basis vector is the only one with its pivot unknown.

    Components of a basis vector below ``least``, relative to its largest, are set to 0.
    """
    if free.shape[1] == 0:
        return free, []
    pivots = linalg.qr(free.T, pivoting=True, mode="economic")[2][: free.shape[1]].tolist()
    basis = np.linalg.solve(free[pivots, :].T, free.T).T
    return np.where(np.abs(basis) > least * np.max(np.abs(basis), axis=0), basis, 0.0), pivots


def _words(members: Sequence[Unknown], changes: Mapping[str, float], structural: bool) -> str:
    """Return the sentence about a combination."""
    names, first = [unknown.name for unknown in members], changes[members[0].name]
    if len(names) == 1 and structural:
        return f"{names[0]} has no effect on the measured results: the data do not determine it"
    if len(names) == 1:
        return f"{names[0]} is hardly determined: the data do not narrow it further than its bounds"
    sizes = {u.name: in_words(abs(changes[u.name]), u.unit, 3) for u in members}
    moves = [f"{sizes[name]} {'less' if changes[name] * first < 0.0 else 'more'} {name}" for name in names[1:]]
    how = "cannot be told apart" if structural else "can hardly be told apart, with this scatter"
    return f"{listed(names)} {how}: {sizes[names[0]]} more {names[0]} can be offset by {', '.join(moves)}"


def warnings_of(fit: Solution, sets: Sequence[Measurements], model: Model) -> Iterator[str]:
    """Yield the warnings about a fit."""
    yield from _scatter(fit, [m.row(k) for m in sets for k in range(len(m.values))])
    parts = np.cumsum([len(m.values) for m in sets])[:-1]
    yield from _growing(fit, np.split(np.abs(fit.predicted), parts))
    for m, residuals in zip(sets, np.split(fit.residuals, parts), strict=True):
        yield from _correlated(m, residuals)
    if near := sum(loss - fit.optima[0] < 0.5 * fit.rise * quantile(0.95, fit.student) ** 2 for loss in fit.optima[1:]):
        remedy = "use narrower bounds or further measurements to decide between them"
        yield f"{near} other local optima fit almost as well: the intervals surround only the best; {remedy}"
    yield from _inaccurate(fit, sets, model)


def _scatter(fit: Solution, places: Sequence[str]) -> Iterator[str]:
    """Yield warnings if the scatter is more than the stated sigma implies, or leaves outliers."""
    square = float(fit.residuals @ fit.residuals)
    if fit.student == np.inf and fit.freedom > 0 and stats.chi2.sf(square, fit.freedom) < _SIGNIFICANCE:
        ratio = f"{math.sqrt(square / fit.freedom):.3g} times as large as the stated sigma implies"
        why = "the model does not follow the data, or sigma and with it the intervals are too small"
        yield f"residuals are {ratio}: {why}; leave sigma out to derive the intervals from the scatter"
    size = np.abs(fit.residuals) / math.sqrt(fit.variance)
    if far := [k for k in np.argsort(-size).tolist() if size[k] > 4.0]:
        first = ", ".join(f"{places[k]} ({size[k]:.2g} sigma)" for k in far[:3])
        more = f" and {len(far) - 3} more" if len(far) > 3 else ""
        yield f"outliers: {first}{more}; the loss 'soft_l1' gives them less weight"


def _growing(fit: Solution, predicted: Sequence[Array]) -> Iterator[str]:
    """Yield a warning if errors that are assumed constant grow with the result, given by its absolute value per set.

    Glejser's test: the absolute residuals, free of the fit's leverage, are correlated with the logarithm of the result.
    """
    if fit.problem.stated or fit.problem.relative or fit.freedom < _FEWEST:
        return
    left = 1.0 - np.sum(linalg.orth(fit.problem.slopes(fit.y)) ** 2, axis=1)
    size = np.concatenate([own / (np.mean(own) or 1.0) for own in predicted])
    counted = fit.problem.counted & (left > 1e-6) & (size > 1e-6)
    logarithms, errors = np.log(size[counted]), np.abs(fit.residuals[counted]) / np.sqrt(left[counted])
    if np.ptp(logarithms) < 1e-6 or np.ptp(errors) <= 1e-6 * np.max(errors):
        return
    if stats.pearsonr(logarithms, errors, alternative="greater").pvalue < _GROWING:
        why = "while the intervals assume errors of equal size and are then too narrow"
        yield f"residuals grow with the predicted value, {why}: state sigma, or calibrate with errors 'relative'"


def _correlated(m: Measurements, residuals: Array) -> Iterator[str]:
    """Yield a warning if the residuals of a record are correlated in time."""
    if m.time is None or len(residuals) < _FEWEST or not np.any(residuals):
        return
    ordered = residuals[np.lexsort((m.time, *m.conditions.values()))]
    size = float(ordered[1:] @ ordered[:-1] / (ordered @ ordered))
    if size > stats.norm.isf(_SIGNIFICANCE) / math.sqrt(len(ordered)):
        wider = f"too narrow by a factor of about {math.sqrt((1.0 + size) / (1.0 - size)):.2g}"
        why = f"intervals assume that they are independent, and are {wider}"
        yield f"{m.name}: residuals of neighbouring times are correlated ({size:.2g}): {why}"


def _inaccurate(fit: Solution, sets: Sequence[Measurements], model: Model) -> Iterator[str]:
    """Yield a warning if numeric runs, whose error is checked, differ from the fitted values; at most 12 are made."""
    first = np.cumsum([0, *(len(m.values) for m in sets)])
    cases = [(m, start, case) for m, start in zip(sets, first, strict=False) for case in model.cases(m, fit.y)]
    runs, worst = [own for own in cases if not is_closed(own[2][0], own[0].result)], 0.0
    for m, start, case in runs[:12]:
        rows = start + case[2]
        try:
            error = np.abs(model.checked(m, case) - fit.predicted[rows]) / fit.sigma[rows]
        except IntegrationError as failed:
            yield f"the run of the fitted scene could not be checked: {failed}"
            return
        worst = max(worst, *error)
    if worst > 0.1:
        yield f"runs with an error check differ from the fitted ones by up to {worst:.2g} standard deviations"
