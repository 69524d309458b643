"""Warnings about a fit: scatter, outliers, correlated errors, bounds, other optima, the model's own limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.errors import IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT
from plough_opt.studies.calibration.estimate import Estimate
from plough_opt.studies.calibration.measurements import RECORD, measurable
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.prediction import Rows, checked, is_closed
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]

# Probability below which a scatter is not taken for chance.
_CHANCE: Final = 1e-3
_OUTLIER: Final = 4.0
_AT_BOUND: Final = 1e-6
# Errors of a prediction above this part of a standard deviation count.
_TELLING: Final = 0.1
_MOST_CHECKED: Final = 12


def caveats(rows: Sequence[Rows], model: Model, unknowns: Sequence[Unknown], fit: Estimate) -> tuple[str, ...]:
    """Return the warnings about a fit."""
    return (
        *_scatter(fit),
        *_outliers(rows, fit),
        *_neighbours(rows, fit),
        *_bounds(unknowns, fit),
        *_optima(fit),
        *_checked(rows, model, fit),
        *_scenes(rows, unknowns, fit),
    )


def _scatter(fit: Estimate) -> list[str]:
    if not fit.normal or fit.freedom < 1:
        return []
    square = float(fit.residuals @ fit.residuals)
    ratio = math.sqrt(square / fit.freedom)
    if stats.chi2.sf(square, fit.freedom) < _CHANCE:
        return [
            f"residuals are {ratio:.3g} times as large as the stated sigma implies: the model does not follow the data,"
            " or sigma is too small, and the intervals with it; without sigma they follow from the scatter itself"
        ]
    if stats.chi2.cdf(square, fit.freedom) < _CHANCE:
        return [f"residuals are only {ratio:.3g} times as large as the stated sigma implies: sigma is too large"]
    return []


def _outliers(rows: Sequence[Rows], fit: Estimate) -> list[str]:
    size = np.abs(fit.residuals) / math.sqrt(fit.variance)
    places = [r.measured.row(k) for r in rows for k in range(r.measured.rows)]
    far = [k for k in np.argsort(-size) if size[k] > _OUTLIER]
    if not far:
        return []
    more = f" and {len(far) - 3} more" if len(far) > 3 else ""
    first = ", ".join(f"{places[k]} ({size[k]:.2g} sigma)" for k in far[:3])
    return [f"outliers: {first}{more}; a robust loss, such as 'huber', gives them less weight"]


def _neighbours(rows: Sequence[Rows], fit: Estimate) -> list[str]:
    """Return a warning for each record whose residuals are correlated in time."""
    first, warned = 0, []
    for r in rows:
        own = fit.residuals[first : first + r.measured.rows]
        first += r.measured.rows
        if r.measured.result != RECORD or len(own) < 8 or not np.any(own):
            continue
        assert r.measured.time is not None
        own = own[np.lexsort((r.measured.time, *r.measured.conditions.values()))]
        correlation = float(own[1:] @ own[:-1] / (own @ own))
        if correlation > stats.norm.ppf(1.0 - _CHANCE) / math.sqrt(len(own)):
            wider = math.sqrt((1.0 + correlation) / (1.0 - correlation))
            warned.append(
                f"{r.measured.name}: residuals of neighbouring times are correlated ({correlation:.2g}): intervals"
                f" assume that they are independent, and are too narrow by a factor of about {wider:.2g}"
            )
    return warned


def _bounds(unknowns: Sequence[Unknown], fit: Estimate) -> list[str]:
    warned = []
    for k, unknown in enumerate(unknowns):
        side = "lower" if fit.y[k] < _AT_BOUND else "upper" if fit.y[k] > 1.0 - _AT_BOUND else ""
        if side and fit.spread.determined[k]:
            value = unknown.lower if side == "lower" else unknown.upper
            warned.append(
                f"{unknown.name} is at its {side} bound {value:g} {unknown.unit}".rstrip()
                + ": the data call for a value beyond it, and intervals are valid only if the bound is"
            )
    return warned


def _optima(fit: Estimate) -> list[str]:
    near = [loss for loss in fit.optima[1:] if loss - fit.optima[0] < 0.5 * fit.quantile(0.95) ** 2 * fit.raise_]
    if not near:
        return []
    return [
        f"{len(near)} other local optima fit almost as well: intervals are those around the best alone; use narrower"
        " bounds or other measurements to decide between them"
    ]


def _checked(rows: Sequence[Rows], model: Model, fit: Estimate) -> list[str]:
    """Return a warning if runs of numbers, which check their own error, differ from the fitted values."""
    first, worst, done = 0, 0.0, 0
    for r in rows:
        own = slice(first, first + r.measured.rows)
        first += r.measured.rows
        if r.measured.result not in measurable():
            continue
        for scene, duration, which in r.scenes(fit.y):
            if is_closed(scene, r.measured.result) or done >= _MOST_CHECKED:
                continue
            done += 1
            try:
                run = checked(scene, duration, r.measured, which, model)
            except IntegrationError as error:
                return [f"the run of the fitted scene could not be checked: {error}"]
            gap = np.abs(run - fit.predicted[own][which]) * fit.weights[own][which] / math.sqrt(fit.variance)
            worst = max(worst, float(np.max(gap)))
    if worst <= _TELLING:
        return []
    return [f"runs with an error check differ from the fitted ones by up to {worst:.2g} standard deviations"]


def _scenes(rows: Sequence[Rows], unknowns: Sequence[Unknown], fit: Estimate) -> list[str]:
    """Return the limits of the theory at the measured conditions."""
    scenes = [scene for r in rows if r.measured.result in measurable() for scene, _, _ in r.scenes(fit.y)]
    if not scenes:
        return []
    slender = [scene for scene in scenes if scene.law.slender]
    blunt = sum(float(as_number(scene.cone.half_angle)) > PLANE_SECTIONS_LIMIT for scene in slender)
    warned = []
    if blunt:
        warned.append(
            f"at {blunt} of {len(scenes)} conditions the equivalent cone's half angle is above"
            f" {math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg, where the hypothesis of plane sections does not hold"
        )
    own = {unknown.name for unknown in unknowns}
    if "soil.ambient_pressure" not in own and not any("soil.ambient_pressure" in r.measured.conditions for r in rows):
        share = max(float(as_number(scene.ambient_share)) for scene in scenes)
        pressure = float(as_number(scenes[0].soil.ambient_pressure)) / 1e3
        if share > 0.0:
            warned.append(
                f"an ambient pressure of {pressure:.4g} kPa is taken as known and carries {100 * share:.0f} % of the"
                " static draft: the calibrated strength of the soil depends on it"
            )
    return warned
