"""What a reader of a fit must know: combinations that the data do not determine, in words, and warnings."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import linalg, stats

from plough_opt.core.errors import IntegrationError, listed
from plough_opt.core.expressions import as_number
from plough_opt.core.plain_data import Array
from plough_opt.core.units import in_words
from plough_opt.studies.calibration.least_squares import Solution
from plough_opt.studies.calibration.model import Rows, SceneOfRows, Unknown, is_closed

AT_BOUND: Final = 1e-6
"""A scaled unknown that is closer to a bound counts as being on it."""

# Part of a combination, relative to its largest, that is left out: where nothing changes, and elsewhere.
_ROUNDING, _MINOR = 1e-6, 0.02
# Significance of tests of the scatter; and of errors that grow, where one fit in twenty is warned in vain. Of fits to
# 24 rows with proportional errors, whose results differ by a factor of five, five in six are warned.
_SIGNIFICANCE, _GROWING = 1e-3, 0.05
# Fewest residuals whose correlation means something, and standard deviations from which on one is an outlier.
_FEWEST, _OUTLIER = 8, 4.0
# Error of fitted runs, in standard deviations of the data, from which on they carry a warning; and most runs checked.
_NOTABLE_ERROR, _MOST_CHECKED = 0.1, 12


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
    vectors, deviation = fit.directions.vectors, fit.directions.deviation
    without_effect, pivots = _sparse(vectors[:, np.isinf(deviation)], _ROUNDING)
    # Directions without effect may be subtracted from those with little effect, which leaves fewer unknowns in these.
    weak = vectors[:, fit.directions.free & np.isfinite(deviation)]
    weak, _ = _sparse(weak - without_effect @ weak[pivots, :], _MINOR)
    # An unknown may be undetermined by a component that was left out: name it alone.
    named = np.any(np.hstack([without_effect, weak]) != 0.0, axis=1)
    alone = np.eye(len(unknowns))[:, ~named & np.isinf(fit.errors)]
    for directions, structural in ((without_effect, True), (weak, False), (alone, False)):
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


def warnings_of(fit: Solution, sets: Sequence[Rows], unknowns: Sequence[Unknown]) -> Iterator[str]:
    """Yield the warnings about a fit."""
    yield from _scatter(fit, [rows.measured.row(k) for rows in sets for k in range(len(rows.measured.values))])
    parts = np.cumsum([len(rows.measured.values) for rows in sets])[:-1]
    yield from _growing(fit, np.split(np.abs(fit.predicted), parts))
    for rows, residuals in zip(sets, np.split(fit.residuals, parts), strict=True):
        yield from _correlated(rows, residuals)
    for k in np.flatnonzero(np.isfinite(fit.errors)).tolist():
        u, y = unknowns[k], fit.y[k]
        for side, distance, bound in (("lower", y, u.lower), ("upper", 1.0 - y, u.upper)):
            if distance < AT_BOUND:
                place = f"{u.name} is at its {side} bound {bound:g} {u.unit}".rstrip()
                yield f"{place}: the data call for a value beyond it, and the intervals are valid only if the bound is"
    near = sum(loss - fit.optima[0] < 0.5 * fit.noise[1] * fit.quantile(0.95) ** 2 for loss in fit.optima[1:])
    if near:
        remedy = "use narrower bounds or further measurements to decide between them"
        yield f"{near} other local optima fit almost as well: the intervals surround only the best; {remedy}"
    at_fit = [rows.scenes(fit.y) for rows in sets]
    yield from _inaccurate(fit, sets, at_fit)
    named = {u.name for u in unknowns}.union(*(rows.measured.conditions for rows in sets))
    scenes = [scene for of_set in at_fit for scene, *_ in of_set]
    carried = max((float(as_number(scene.ambient_share)) for scene in scenes), default=0.0)
    if carried > 0.0 and "soil.ambient_pressure" not in named:
        pressure = in_words(float(as_number(scenes[0].soil.ambient_pressure)), "Pa", 4)
        why = f"carries {100 * carried:.0f} % of the static draft: the calibrated strength of the soil depends on it"
        yield f"an ambient pressure of {pressure} is taken as known and {why}"


def _scatter(fit: Solution, places: Sequence[str]) -> Iterator[str]:
    """Yield warnings if the scatter did not settle, is not what the stated sigma implies, or leaves outliers."""
    if not fit.settled:
        yield "fit and scatter of the residuals did not settle, as few rows allow several such fits; state sigma"
    square = float(fit.residuals @ fit.residuals)
    if fit.normal and fit.freedom > 0:
        ratio = f"{math.sqrt(square / fit.freedom):.3g} times as large as the stated sigma implies"
        if stats.chi2.sf(square, fit.freedom) < _SIGNIFICANCE:
            why = "the model does not follow the data, or sigma and with it the intervals are too small"
            yield f"residuals are {ratio}: {why}; leave sigma out to derive the intervals from the scatter"
        elif stats.chi2.cdf(square, fit.freedom) < _SIGNIFICANCE:
            yield f"residuals are only {ratio}: sigma is too large"
    size = np.abs(fit.residuals) / math.sqrt(fit.noise[0])
    if far := [k for k in np.argsort(-size).tolist() if size[k] > _OUTLIER]:
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
    counted = fit.problem.counted & (left > _ROUNDING) & (size > _ROUNDING)
    logarithms, errors = np.log(size[counted]), np.abs(fit.residuals[counted]) / np.sqrt(left[counted])
    if np.ptp(logarithms) < _ROUNDING or np.ptp(errors) <= _ROUNDING * np.max(errors):
        return
    if stats.pearsonr(logarithms, errors, alternative="greater").pvalue < _GROWING:
        why = "while the intervals assume errors of equal size and are then too narrow"
        yield f"residuals grow with the predicted value, {why}: state sigma, or calibrate with errors 'relative'"


def _correlated(rows: Rows, residuals: Array) -> Iterator[str]:
    """Yield a warning if the residuals of a record are correlated in time."""
    m = rows.measured
    if m.time is None or len(residuals) < _FEWEST or not np.any(residuals):
        return
    ordered = residuals[np.lexsort((m.time, *m.conditions.values()))]
    size = float(ordered[1:] @ ordered[:-1] / (ordered @ ordered))
    if size > stats.norm.isf(_SIGNIFICANCE) / math.sqrt(len(ordered)):
        wider = f"too narrow by a factor of about {math.sqrt((1.0 + size) / (1.0 - size)):.2g}"
        why = f"intervals assume that they are independent, and are {wider}"
        yield f"{m.name}: residuals of neighbouring times are correlated ({size:.2g}): {why}"


def _inaccurate(fit: Solution, sets: Sequence[Rows], at_fit: Sequence[Sequence[SceneOfRows]]) -> Iterator[str]:
    """Yield a warning if numeric runs, whose error is checked, differ from the fitted values."""
    worst, runs, first = 0.0, 0, 0
    for rows, scenes in zip(sets, at_fit, strict=True):
        for scene, duration, which in scenes:
            if is_closed(scene, rows.measured.result) or runs >= _MOST_CHECKED:
                continue
            try:
                error = rows.checked(scene, duration, which) - fit.predicted[first + which]
            except IntegrationError as failed:
                yield f"the run of the fitted scene could not be checked: {failed}"
                return
            worst, runs = max(worst, *np.abs(error) / fit.deviation()[first + which]), runs + 1
        first += len(rows.measured.values)
    if worst > _NOTABLE_ERROR:
        yield f"runs with an error check differ from the fitted ones by up to {worst:.2g} standard deviations"
