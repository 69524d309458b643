"""Cross-validation: each row predicted by a fit to the others."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.studies.calibration.estimate import Estimate, estimate
from plough_opt.studies.calibration.measurements import RECORD, measurable
from plough_opt.studies.calibration.setup import Setup

Vector = NDArray[np.float64]

_MOST_LEFT_OUT = 60


@dataclass(frozen=True)
class CrossValidation:
    """Errors of the predictions for rows left out of the fit.

    Attributes:
        folds: number of parts that were left out in turn; with the number of rows, each row by itself.
        rows: numbers of the rows that were left out; rows that measure an unknown itself stay in.
        errors: predicted less observed in these, by the fit without them, SI.
        standardised: the same over the standard deviation of a measurement.
        rms: result -> root mean square of its errors, SI.
        rms_fitted: the same of the residuals of the fit to all rows, which is smaller.
    """

    folds: int
    rows: NDArray[np.intp]
    errors: Vector
    standardised: Vector
    rms: Mapping[str, float]
    rms_fitted: Mapping[str, float]


def cross_validate(setup: Setup, fit: Estimate, folds: int | None, seed: int) -> CrossValidation:
    """Leave parts of the rows out in turn.

    Args:
        setup: model, data and unknowns.
        fit: the fit to all rows.
        folds: number of parts, from 2 to the number of rows; None: each row by itself, 20 parts for over 60 rows, and 5
            if the rows need runs.
        seed: of the shuffling; rows of a record stay in order, as the errors of neighbours are correlated.

    Raises:
        InputError: an invalid number of folds.
        NotConverged: a fit without some of the rows has no optimum.
    """
    problem, data = setup.problem, fit.data
    results = np.array([m.result for m in setup.measured for _ in range(m.rows)])
    order = np.flatnonzero(np.isin(results, measurable()))
    count = len(order)
    if folds is None:
        folds = (count if count <= _MOST_LEFT_OUT else 20) if problem.closed else min(5, count)
    if not is_count(folds) or not 2 <= folds <= count:
        raise InputError(f"folds = {shown(folds)} must be a whole number from 2 to {count}, the number of rows")
    rows = order.copy()
    if RECORD not in results and folds < count:
        np.random.default_rng(seed).shuffle(order)
    errors = np.zeros(len(results))
    for part in np.array_split(order, folds):
        weights = setup.data.weights.copy()
        weights[part] = 0.0
        if np.sum(weights > 0.0) < problem.unknowns:
            raise InputError(f"{folds} folds leave fewer rows than unknowns: use more folds")
        without = estimate(problem, replace(data, weights=weights), fit.y, starts=1)
        errors[part] = (without.predicted - data.observed)[part]

    def rms(of: Vector) -> dict[str, float]:
        return {str(name): float(np.sqrt(np.mean(of[results == name] ** 2))) for name in dict.fromkeys(results[rows])}

    standardised = errors[rows] / fit.deviation[rows]
    return CrossValidation(folds, rows, errors[rows], standardised, rms(errors), rms(fit.predicted - data.observed))
