"""Verification of a robust design: every requested measure over fresh samples, with a confidence interval.

An optimum over some samples fits these samples: it looks better on them than the design is. Samples that are drawn
independently, and that the optimiser did not use, show by how much.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.checks import check_kind, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.design import Optimum
from plough_opt.studies.uncertainty.robust import RequestedMeasure, Robust

Vector = NDArray[np.float64]

SAMPLES, SEED = 4096, 20_000
"""Default number of fresh samples, and default seed."""

CONFIDENCE = 0.95
_RESAMPLES = 500
_AT_ONCE = 50
# Part of the fresh samples without a result above which verification raises an error.
_MOST_FAILURES = 0.01


@dataclass(frozen=True)
class Check:
    """One measure of a design, on its own samples and on fresh ones.

    Attributes:
        result: name of its result.
        text: the measure in words.
        seen: the optimiser's value, smoothed, over its own samples.
        sharp: the exact value over these samples.
        fresh: the exact value over the fresh samples.
        low: lower end of the confidence interval of the measure of the whole distribution; None for a worst case.
        high: upper end.
        width: over which the optimiser's measure is smoothed; 0 if it is not.
        rounding: effect of the smoothing, over the fresh samples.
        note: method of the interval, or words instead of it.
        worse: for a worst case, the number of worse fresh samples; otherwise None.
    """

    result: str
    text: str
    seen: float
    sharp: float
    fresh: float
    low: float | None
    high: float | None
    width: float
    rounding: float
    note: str
    worse: int | None = None

    @property
    def optimism(self) -> float:
        """The measure on fresh samples less the optimiser's value."""
        return self.fresh - self.seen

    @property
    def confirmed(self) -> bool:
        """Whether the optimiser's value lies within the interval; for a worst case, whether no sample is worse."""
        if self.low is None or self.high is None:
            return self.worse == 0
        return self.low <= self.seen <= self.high

    @property
    def verdict(self) -> str:
        """Whether fresh samples confirm the optimiser's value, or on which side of it they lie, in words."""
        if self.confirmed:
            return "confirmed"
        return f"{'larger' if self.fresh > self.seen else 'smaller'} than seen"

    @property
    def interval(self) -> str:
        """The confidence interval in words."""
        if self.low is None or self.high is None:
            return self.note
        return f"{100 * CONFIDENCE:.0f} %: {self.low:.6g} to {self.high:.6g}, {self.note}"

    def __str__(self) -> str:
        """Return the check in a sentence."""
        rounded = f"; rounded off over {self.width:.4g}, which changes it by {self.rounding:+.2g}" if self.width else ""
        return (
            f"{self.result}, {self.text}: the optimiser saw {self.seen:.6g}, fresh samples give {self.fresh:.6g}"
            f" ({self.interval}): {self.verdict}{rounded}"
        )


@dataclass(frozen=True)
class Verification:
    """The measures of a design over fresh samples.

    Attributes:
        checks: every requested measure.
        samples: number of fresh samples with results.
        failures: number of a fresh sample without results -> the reason.
        values: name of a result -> its values over the fresh samples.
        seed: of the fresh samples.
        seconds: time taken [s].
    """

    checks: tuple[Check, ...]
    samples: int
    failures: Mapping[int, str]
    values: Mapping[str, Vector]
    seed: int
    seconds: float

    def __getitem__(self, key: tuple[str, str]) -> Check:
        """Return the check of a result's measure, by the result's name and the beginning of the measure's words."""
        for check in self.checks:
            if check.result == key[0] and check.text.startswith(key[1]):
                return check
        known = ", ".join(f"{check.result}: {check.text}" for check in self.checks)
        raise InputError(f"{key} is not among the checks, which are {known}")

    @property
    def confirmed(self) -> bool:
        """Whether every measure is confirmed."""
        return all(check.confirmed for check in self.checks)

    def __str__(self) -> str:
        """Return the checks, a line for each measure."""
        return "\n".join(map(str, self.checks))


def verify(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = SAMPLES, seed: int = SEED
) -> Verification:
    """Evaluate every requested measure of a design over fresh, independently drawn samples.

    Means, standard deviations and CVaR get percentile intervals of the bootstrap (scipy.stats.bootstrap),
    probabilities the exact interval of Clopper and Pearson (scipy.stats.binomtest). The worst of the samples has no
    interval, because the distribution may extend beyond them: it gets the probability of worse soils.

    Args:
        robust: the results in the design.
        at: the optimum, or a design by the names of its variables and parameters.
        samples: number of fresh samples, at least 100.
        seed: of the fresh samples; they are drawn by another generator than the optimiser's.

    Raises:
        InputError: too few samples, or too many soils without results.
    """
    check_kind("the results", robust, Robust, "a Robust")
    started = time.perf_counter()
    if not is_count(samples) or samples < 100:
        raise InputError(f"samples = {shown(samples)} must be a whole number of at least 100, for confidence intervals")
    own = robust.values(at)
    fresh = robust.responses(at, robust.field.draw(samples, seed=seed))
    kept = samples - len(fresh.failures)
    if len(fresh.failures) > _MOST_FAILURES * samples:
        number, reason = next(iter(fresh.failures.items()))
        raise InputError(
            f"{len(fresh.failures)} of {samples} fresh soils have no result, such as number {number}: {reason};"
            " truncate the distribution where the model ends"
        )
    requested = {(one.result, one.text): one for one in robust.requested}
    checks = tuple(_checked(one, own[one.result], fresh.values[one.result], seed) for one in requested.values())
    return Verification(checks, kept, fresh.failures, fresh.values, seed, time.perf_counter() - started)


def _checked(requested: RequestedMeasure, own: Vector, fresh: Vector, seed: int) -> Check:
    """Return one measure on the optimiser's samples and on fresh ones."""
    seen, sharp = float(requested.rounded(own)), float(requested.sharp(own))
    found = float(requested.sharp(fresh))
    rounding = float(requested.rounded(fresh)) - found if requested.width else 0.0
    low: float | None
    high: float | None
    worse: int | None = None
    if requested.kind == "probability":
        low, high = _binomial(round(found * len(fresh)), len(fresh))
        note = "Clopper and Pearson"
    elif requested.kind in ("largest", "smallest"):
        worse = int(np.sum(fresh > seen if requested.kind == "largest" else fresh < seen))
        share_low, share_high = _binomial(worse, len(fresh))
        low = high = None
        note = (
            f"{worse} of {len(fresh)} are worse: {100 * share_low:.2g} to {100 * share_high:.2g} % of the whole"
            " distribution"
        )
    else:
        low, high = _bootstrap(requested, fresh, seed)
        note = "bootstrap"
    return Check(
        requested.result, requested.text, seen, sharp, found, low, high, requested.width, rounding, note, worse
    )


def _binomial(count: int, total: int) -> tuple[float, float]:
    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def _bootstrap(requested: RequestedMeasure, values: Vector, seed: int) -> tuple[float, float]:
    """Return the percentile interval of a measure; if all values are equal, that value."""
    if float(np.ptp(values)) <= 1e-9 * float(np.max(np.abs(values))):
        return float(np.min(values)), float(np.max(values))

    def measure(resampled: Vector, axis: int = -1) -> Vector:
        return np.apply_along_axis(requested.sharp, axis, resampled)

    generator = np.random.default_rng([seed, 1])
    interval = stats.bootstrap(
        (values,), measure, n_resamples=_RESAMPLES, batch=_AT_ONCE, vectorized=True, confidence_level=CONFIDENCE,
        method="percentile", rng=generator,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)


def in_words(checks: Sequence[Check]) -> str:
    """Return one sentence on whether fresh samples confirm the optimiser's values."""
    doubtful = [f"{check.result} ({check.text}: {check.verdict})" for check in checks if not check.confirmed]
    if not doubtful:
        return "fresh samples confirm every measure"
    return f"fresh samples do not confirm {', '.join(doubtful)}; an optimisation over more samples would come nearer"
