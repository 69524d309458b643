"""What a reader of a fit must know: scatter, outliers, neighbours, bounds, other optima, the model's own limits."""

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
from plough_opt.studies.calibration.measurements import RECORD, RESULTS
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.prediction import Rows, checked, is_closed
from plough_opt.studies.calibration.unknown import Unknown

Vector = NDArray[np.float64]

# A scatter that is chance less often than this is none.
_CHANCE: Final = 1e-3
_OUTLIER: Final = 4.0
_AT_BOUND: Final = 1e-6
# Errors of a prediction above this part of a standard deviation count.
_TELLING: Final = 0.1
_MOST_CHECKED: Final = 12


def caveats(rows: Sequence[Rows], model: Model, unknowns: Sequence[Unknown], found: Estimate) -> tuple[str, ...]:
    """Return sentences for whoever reads a fit."""
    return (
        *_scatter(found),
        *_outliers(rows, found),
        *_neighbours(rows, found),
        *_bounds(unknowns, found),
        *_optima(found),
        *_checked(rows, model, found),
        *_scenes(rows, unknowns, found),
    )


def _scatter(found: Estimate) -> list[str]:
    if not found.normal or found.freedom < 1:
        return []
    square = float(found.residuals @ found.residuals)
    ratio = math.sqrt(square / found.freedom)
    if stats.chi2.sf(square, found.freedom) < _CHANCE:
        return [
            f"residuals are {ratio:.3g} times what the stated sigma lets expect: the model does not follow the data, or"
            " sigma is too small, and the intervals with it; without sigma the scatter itself is taken"
        ]
    if stats.chi2.cdf(square, found.freedom) < _CHANCE:
        return [f"residuals are only {ratio:.3g} times what the stated sigma lets expect: sigma is too large"]
    return []


def _outliers(rows: Sequence[Rows], found: Estimate) -> list[str]:
    size = np.abs(found.residuals) / math.sqrt(found.variance)
    places = [r.measured.row(k) for r in rows for k in range(r.measured.rows)]
    far = [k for k in np.argsort(-size) if size[k] > _OUTLIER]
    if not far:
        return []
    more = f" and {len(far) - 3} more" if len(far) > 3 else ""
    told = ", ".join(f"{places[k]} ({size[k]:.2g} sigma)" for k in far[:3])
    return [f"outliers: {told}{more}; a robust loss, such as 'huber', lets them pull less"]


def _neighbours(rows: Sequence[Rows], found: Estimate) -> list[str]:
    """Return a warning where neighbouring residuals of a record tell each other's values."""
    first, warned = 0, []
    for r in rows:
        own = found.residuals[first : first + r.measured.rows]
        first += r.measured.rows
        if r.measured.result != RECORD or len(own) < 8 or not np.any(own):
            continue
        assert r.measured.time is not None
        own = own[np.lexsort((r.measured.time, *r.measured.conditions.values()))]
        correlation = float(own[1:] @ own[:-1] / (own @ own))
        if correlation > stats.norm.ppf(1.0 - _CHANCE) / math.sqrt(len(own)):
            wider = math.sqrt((1.0 + correlation) / (1.0 - correlation))
            warned.append(
                f"{r.measured.name}: residuals of neighbouring times are correlated ({correlation:.2g}): intervals take"
                f" them as independent, and are too narrow by a factor of about {wider:.2g}"
            )
    return warned


def _bounds(unknowns: Sequence[Unknown], found: Estimate) -> list[str]:
    warned = []
    for k, unknown in enumerate(unknowns):
        side = "lower" if found.y[k] < _AT_BOUND else "upper" if found.y[k] > 1.0 - _AT_BOUND else ""
        if side and found.spread.determined[k]:
            value = unknown.lower if side == "lower" else unknown.upper
            warned.append(
                f"{unknown.name} is at its {side} bound {value:g} {unknown.unit}".rstrip()
                + ": the data want it beyond, and intervals hold only as far as the bound does"
            )
    return warned


def _optima(found: Estimate) -> list[str]:
    near = [
        loss for loss in found.optima[1:] if loss - found.optima[0] < 0.5 * found.quantile(0.95) ** 2 * found.raise_
    ]
    if not near:
        return []
    return [
        f"{len(near)} other local optima fit almost as well: intervals are those around the best alone; narrower bounds"
        " or other measurements tell them apart"
    ]


def _checked(rows: Sequence[Rows], model: Model, found: Estimate) -> list[str]:
    """Return a warning where runs that check themselves differ from what was fitted."""
    first, worst, done = 0, 0.0, 0
    for r in rows:
        own = slice(first, first + r.measured.rows)
        first += r.measured.rows
        if r.measured.result not in RESULTS:
            continue
        for scene, duration, which in r.scenes(found.y):
            if is_closed(scene, r.measured.result) or done >= _MOST_CHECKED:
                continue
            done += 1
            try:
                run = checked(scene, duration, r.measured, which, model)
            except IntegrationError as error:
                return [f"the run of the fitted scene could not be checked: {error}"]
            gap = np.abs(run - found.predicted[own][which]) * found.weights[own][which] / math.sqrt(found.variance)
            worst = max(worst, float(np.max(gap)))
    if worst <= _TELLING:
        return []
    return [f"runs that check themselves differ from the fitted ones by up to {worst:.2g} standard deviations"]


def _scenes(rows: Sequence[Rows], unknowns: Sequence[Unknown], found: Estimate) -> list[str]:
    """Return the limits of the theory at the measured conditions."""
    scenes = [scene for r in rows if r.measured.result in RESULTS for scene, _, _ in r.scenes(found.y)]
    if not scenes:
        return []
    blunt = sum(float(as_number(scene.cone.half_angle)) > PLANE_SECTIONS_LIMIT for scene in scenes)
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
                " static draft: what is found of the soil's strength depends on it"
            )
    return warned
