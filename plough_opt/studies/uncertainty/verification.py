"""What fresh samples say of a robust design: every measure that it was asked for, with a confidence interval.

An optimum over some samples fits these samples: it looks better on them than the design is. Samples that are drawn
independently, and that the optimiser never saw, tell by how much.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import is_count
from plough_opt.core.kinds import check_kind, shown
from plough_opt.design import Optimum
from plough_opt.studies.uncertainty.robust import Asked, Robust

Vector = NDArray[np.float64]

SAMPLES, SEED = 4096, 20_000
"""Fresh samples, and what they are drawn with unless another seed is given."""

CONFIDENCE = 0.95
_RESAMPLES = 500
_AT_ONCE = 50
# Part of the fresh samples without a result above which nothing can be said.
_MOST_FAILURES = 0.01


@dataclass(frozen=True)
class Check:
    """One measure of a design, on its own samples and on fresh ones.

    Attributes:
        result: name of the result that it is of.
        text: the measure in words.
        seen: what the optimiser saw, rounded off, over its own samples.
        sharp: the same, sharp.
        fresh: sharp, over the fresh samples.
        low: lower end of the confidence interval of the measure of the whole distribution; None of a worst case.
        high: upper end.
        width: over which the optimiser's measure is rounded off; 0 where it is not.
        rounding: what the rounding-off changes, over the fresh samples.
        note: how the interval was found, or what stands in its place.
        worse: of a worst case, how many fresh samples are worse; else None.
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
        """How much larger the measure is on fresh samples than the optimiser saw."""
        return self.fresh - self.seen

    @property
    def confirmed(self) -> bool:
        """Whether what the optimiser saw lies within the interval; of a worst case, whether none is worse."""
        if self.low is None or self.high is None:
            return self.worse == 0
        return self.low <= self.seen <= self.high

    @property
    def verdict(self) -> str:
        """Whether fresh samples confirm what the optimiser saw, or on which side of it the distribution lies."""
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
        """Say what was found."""
        rounded = f"; rounded off over {self.width:.4g}, which changes it by {self.rounding:+.2g}" if self.width else ""
        return (
            f"{self.result}, {self.text}: the optimiser saw {self.seen:.6g}, fresh samples give {self.fresh:.6g}"
            f" ({self.interval}): {self.verdict}{rounded}"
        )


@dataclass(frozen=True)
class Verification:
    """What fresh samples say of a design.

    Attributes:
        checks: every measure that was asked for.
        samples: number of fresh samples with results.
        failures: number of a fresh sample without results -> why.
        values: name of a result -> its values over the fresh samples.
        seed: what they were drawn with.
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
        raise InputError(f"{key} was not asked for; known are {known}")

    @property
    def confirmed(self) -> bool:
        """Whether every measure is confirmed."""
        return all(check.confirmed for check in self.checks)

    def __str__(self) -> str:
        """Say everything, a line for each measure."""
        return "\n".join(map(str, self.checks))


def verify(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = SAMPLES, seed: int = SEED
) -> Verification:
    """Take every measure that a design was asked for over fresh, independently drawn samples.

    Means, standard deviations and CVaR get percentile intervals of the bootstrap (scipy.stats.bootstrap),
    probabilities the exact interval of Clopper and Pearson (scipy.stats.binomtest). Of the worst of the samples there
    is no interval, for the distribution may go on beyond them: it gets the part of the distribution that is worse.

    Args:
        robust: the results that the design was built of.
        at: the optimum, or a design by the names of its variables and parameters.
        samples: number of fresh ones, at least 100.
        seed: of their generator, which is not the one of the samples that the optimiser saw.

    Raises:
        InputError: too few samples, or too many soils without result.
    """
    check_kind("the results", robust, Robust, "a Robust")
    started = time.perf_counter()
    if not is_count(samples) or samples < 100:
        raise InputError(f"samples = {shown(samples)} must be a whole number of at least 100, for confidence intervals")
    own = robust.values(at)
    found = robust.responses(at, robust.field.draw(samples, seed=seed))
    kept = samples - len(found.failures)
    if len(found.failures) > _MOST_FAILURES * samples:
        number, reason = next(iter(found.failures.items()))
        raise InputError(
            f"{len(found.failures)} of {samples} fresh soils have no result, such as number {number}: {reason};"
            " truncate the distribution where the model ends"
        )
    asked = {(one.result, one.text): one for one in robust.asked}
    checks = tuple(_checked(one, own[one.result], found.values[one.result], seed) for one in asked.values())
    return Verification(checks, kept, found.failures, found.values, seed, time.perf_counter() - started)


def _checked(asked: Asked, own: Vector, fresh: Vector, seed: int) -> Check:
    """Return one measure on its own and on fresh samples."""
    seen, sharp, found = (float(value) for value in (asked.rounded(own), asked.sharp(own), asked.sharp(fresh)))
    rounding = float(asked.rounded(fresh)) - found if asked.width else 0.0
    low: float | None
    high: float | None
    worse: int | None = None
    if asked.kind == "probability":
        low, high = _binomial(round(found * len(fresh)), len(fresh))
        note = "Clopper and Pearson"
    elif asked.kind in ("largest", "smallest"):
        worse = int(np.sum(fresh > seen if asked.kind == "largest" else fresh < seen))
        share_low, share_high = _binomial(worse, len(fresh))
        low = high = None
        note = (
            f"{worse} of {len(fresh)} are worse, so of the whole distribution {100 * share_low:.2g} to"
            f" {100 * share_high:.2g} %"
        )
    else:
        low, high = _bootstrap(asked, fresh, seed)
        note = "bootstrap"
    return Check(asked.result, asked.text, seen, sharp, found, low, high, asked.width, rounding, note, worse)


def _binomial(count: int, total: int) -> tuple[float, float]:
    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def _bootstrap(asked: Asked, values: Vector, seed: int) -> tuple[float, float]:
    """Return the percentile interval of a measure; of values that are all alike, that value."""
    if float(np.ptp(values)) <= 1e-9 * float(np.max(np.abs(values))):
        return float(np.min(values)), float(np.max(values))

    def measure(resampled: Vector, axis: int = -1) -> Vector:
        return np.apply_along_axis(asked.sharp, axis, resampled)

    generator = np.random.default_rng([seed, 1])
    interval = stats.bootstrap(
        (values,), measure, n_resamples=_RESAMPLES, batch=_AT_ONCE, vectorized=True, confidence_level=CONFIDENCE,
        method="percentile", rng=generator,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)


def in_words(checks: Sequence[Check]) -> str:
    """Return one sentence on whether fresh samples confirm what the optimiser saw."""
    doubtful = [f"{check.result} ({check.text}: {check.verdict})" for check in checks if not check.confirmed]
    if not doubtful:
        return "fresh samples confirm every measure"
    return f"fresh samples do not confirm {', '.join(doubtful)}; more samples would come nearer"
