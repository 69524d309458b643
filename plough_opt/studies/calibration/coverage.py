"""Coverage: how often intervals contain the true value, over fits to many synthetic sets of measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.expressions import is_count
from plough_opt.studies.calibration.calibrate import Calibration
from plough_opt.studies.calibration.estimate import Data, Estimate
from plough_opt.studies.calibration.intervals import Kind, check_level

Vector = NDArray[np.float64]

_KINDS: Final[tuple[Kind, ...]] = ("profile", "linearised")


@dataclass(frozen=True)
class Covered:
    """How often the intervals of one unknown contain its true value.

    Attributes:
        name: the unknown.
        truth: its true value, SI.
        identifiable: number of trials in which the data determined it.
        covered: kind of interval -> number of those trials in which it contained the truth.
        clipped: number of profile intervals that ended at a bound.
        bias: mean of the fitted values less the truth, over their standard deviation.
        relative_error: their standard deviation over the truth.
    """

    name: str
    truth: float
    identifiable: int
    covered: Mapping[Kind, int]
    clipped: int
    bias: float
    relative_error: float

    def rate(self, kind: Kind = "profile") -> float:
        """Return the covered part of the trials in which the unknown was identifiable."""
        return self.covered[kind] / self.identifiable if self.identifiable else math.nan


@dataclass(frozen=True)
class Coverage:
    """Coverage of every unknown.

    Attributes:
        trials: number of synthetic sets.
        failed: number of sets without a converged fit.
        level: confidence of the intervals.
        unknowns: each unknown's coverage.
    """

    trials: int
    failed: int
    level: float
    unknowns: tuple[Covered, ...]

    def binomial(self, level: float = 0.999) -> tuple[float, float]:
        """Return the range in which a rate lies by chance at a level, if the intervals are right."""
        low, high = stats.binom.interval(level, self.trials, self.level)
        return float(low) / self.trials, float(high) / self.trials


def coverage(
    calibration: Calibration,
    truth: Mapping[str, float],
    *,
    sigma: Vector | None = None,
    trials: int = 500,
    level: float = 0.95,
    seed: int = 1,
) -> Coverage:
    """Fit many synthetic sets: the model's own values at the truth with independent normal errors.

    Args:
        calibration: model, conditions and unknowns; its measured values are not used.
        truth: unknown -> true value, SI.
        sigma: standard deviation of each row's error, SI; default: those stated in the data.
        trials: number of sets.
        level: confidence of the intervals.
        seed: of the errors.

    Raises:
        InputError: an invalid number of trials or level, or an unknown without its truth.
    """
    check_level(level)
    if not is_count(trials):
        raise InputError(f"trials = {trials!r} must be a whole number from 1 on")
    missing = [u.name for u in calibration.unknowns if u.name not in truth]
    if missing:
        raise InputError(f"the true value of '{missing[0]}' is missing")
    if sigma is None:
        if not calibration.data.stated:
            raise InputError("the data state no sigma: give the standard deviation of each row's error")
        sigma = 1.0 / calibration.data.weights
    exact = calibration.predict(truth)
    errors = np.random.default_rng(seed).standard_normal((trials, len(exact)))
    counts = {u.name: _Count() for u in calibration.unknowns}
    failed = 0
    for trial in range(trials):
        data = calibration.data_of(exact + sigma * errors[trial])
        try:
            fit = calibration.estimate(data)
        except NotConverged:
            failed += 1
            continue
        for k, unknown in enumerate(calibration.unknowns):
            counts[unknown.name].add(calibration, data, fit, k, truth[unknown.name], level)
    covered = tuple(counts[u.name].covered_of(u.name, truth[u.name]) for u in calibration.unknowns)
    return Coverage(trials, failed, level, covered)


class _Count:
    """Counts of one unknown over the trials."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self.identifiable = 0
        self.clipped = 0
        self.covered: dict[Kind, int] = dict.fromkeys(_KINDS, 0)

    def add(self, calibration: Calibration, data: Data, fit: Estimate, k: int, truth: float, level: float) -> None:
        """Count a trial."""
        self.values.append(float(calibration.unknowns[k].value(float(fit.y[k]))))
        if not fit.spread.determined[k]:
            return
        self.identifiable += 1
        for kind in _KINDS:
            interval = calibration.interval(data, fit, k, level, kind)
            self.covered[kind] += truth in interval
            self.clipped += kind == "profile" and bool(interval.clipped)

    def covered_of(self, name: str, truth: float) -> Covered:
        """Return the counts with bias and error of the values."""
        values = np.array(self.values)
        deviation = float(np.std(values)) if len(values) else 0.0
        bias = float(np.mean(values) - truth) / deviation if deviation > 0.0 else 0.0
        return Covered(name, truth, self.identifiable, self.covered, self.clipped, bias, deviation / abs(truth))
