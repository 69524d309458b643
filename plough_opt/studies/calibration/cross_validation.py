"""Cross-validation: each row predicted by a fit to the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.kinds import shown
from plough_opt.studies.calibration.estimate import Data, estimate
from plough_opt.studies.calibration.least_squares import LeastSquares
from plough_opt.studies.calibration.measurements import RECORD, measurable

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


def cross_validate(
    program: LeastSquares, data: Data, y: Vector, deviation: Vector, results: list[str], folds: int | None, seed: int
) -> CrossValidation:
    """Leave parts out in turn.

    Args:
        program: the fit.
        data: all rows.
        y: scaled unknowns of the fit to all rows.
        deviation: standard deviation of each measurement, SI.
        results: what each row measured.
        folds: number of parts, from 2 to the number of rows; None: each row by itself, 20 parts for over 60 rows, and 5
            if the rows need runs.
        seed: of the shuffling; rows of a record stay in order, as the errors of neighbours are correlated.
    """
    order = np.array([k for k, result in enumerate(results) if result in measurable()], dtype=np.intp)
    count = len(order)
    if folds is None:
        folds = (count if count <= _MOST_LEFT_OUT else 20) if program.predictor.closed else min(5, count)
    if not is_count(folds) or not 2 <= folds <= count:
        raise InputError(f"folds = {shown(folds)} must be a whole number from 2 to {count}, the number of rows")
    if RECORD not in results and folds < count:
        np.random.default_rng(seed).shuffle(order)
    errors = np.zeros(len(data.observed))
    for part in np.array_split(order, folds):
        kept = data.weights.copy()
        kept[part] = 0.0
        if np.sum(kept > 0.0) < program.unknowns:
            raise InputError(f"{folds} folds leave fewer rows than unknowns: use more folds")
        without = Data(data.observed, kept, data.stated)
        fit = estimate(program, without, y, starts=1)
        errors[part] = (program.predict(fit.y) - data.observed)[part]
    fitted = program.predict(y) - data.observed
    names = np.array(results)
    every = [result for result in dict.fromkeys(results) if result in measurable()]
    rows = np.sort(order)
    return CrossValidation(
        folds,
        rows,
        errors[rows],
        errors[rows] / deviation[rows],
        {name: float(np.sqrt(np.mean(errors[names == name] ** 2))) for name in every},
        {name: float(np.sqrt(np.mean(fitted[names == name] ** 2))) for name in every},
    )
