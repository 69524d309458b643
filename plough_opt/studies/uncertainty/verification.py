"""Verification of a robust design: every requested measure over fresh samples, with a confidence interval.

An optimum is fitted to the optimiser's samples, and looks better on them than it is. Samples that are drawn
independently, and that the optimiser did not use, show by how much.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from plough_opt.core.checks import check_kind, shown
from plough_opt.core.errors import InputError, printable
from plough_opt.core.expressions import is_count
from plough_opt.core.plain_data import Array as Vector
from plough_opt.design import Optimum
from plough_opt.studies.uncertainty.robust import RequestedMeasure, Robust

SAMPLES = 4096
"""Default number of fresh samples."""
SEED = 20_000
"""Default seed of the fresh samples."""

CONFIDENCE = 0.95
_RESAMPLES = 500
# Number of resamples that are evaluated together, which limits the memory.
_BATCH = 50
# Verification raises an error if a larger part of the fresh samples has no result.
_MOST_FAILURES = 0.01
# Relative range below which values are equal but for rounding: the bootstrap has no interval for them.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Check:
    """One measure of a design, over the optimiser's samples and over fresh ones.

    Attributes:
        result: name of its result.
        text: the measure in words.
        seen: the optimiser's value: smoothed, over its own samples.
        sharp: the exact value over the optimiser's samples.
        fresh: the exact value over the fresh samples.
        low: lower end of the confidence interval for the whole distribution; None for a worst case.
        high: upper end of this interval.
        width: width over which the optimiser's measure is smoothed; 0 if it is not.
        rounding: change of the value by smoothing, over the fresh samples.
        note: method of the interval, or a text instead of one.
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
        """The value over fresh samples minus the optimiser's value."""
        return self.fresh - self.seen

    @property
    def confirmed(self) -> bool:
        """Whether the optimiser's value is in the interval; for a worst case, whether no fresh sample is worse."""
        if self.low is None or self.high is None:
            return self.worse == 0
        return self.low <= self.seen <= self.high

    @property
    def verdict(self) -> str:
        """Whether fresh samples confirm the optimiser's value, and otherwise on which side of it they lie."""
        if self.confirmed:
            return "confirmed"
        return f"{'larger' if self.fresh > self.seen else 'smaller'} than seen"

    @property
    def interval(self) -> str:
        """The confidence interval as text."""
        if self.low is None or self.high is None:
            return self.note
        return f"{100 * CONFIDENCE:.0f} %: {self.low:.6g} to {self.high:.6g}, {self.note}"

    def __str__(self) -> str:
        """Return the check in a sentence."""
        smoothing = f"; smoothed over {self.width:.4g}, which changes it by {self.rounding:+.2g}" if self.width else ""
        return printable(
            f"{self.result}, {self.text}: the optimiser saw {self.seen:.6g}, fresh samples give {self.fresh:.6g}"
            f" ({self.interval}): {self.verdict}{smoothing}"
        )


@dataclass(frozen=True)
class Verification:
    """The measures of a design over fresh samples.

    Attributes:
        checks: the check of every requested measure.
        samples: number of fresh samples with results.
        failures: number of a fresh sample without results -> the reason.
        values: name of a result -> its values over the fresh samples.
        seed: seed of the fresh samples.
        seconds: time taken [s].
    """

    checks: tuple[Check, ...]
    samples: int
    failures: Mapping[int, str]
    values: Mapping[str, Vector]
    seed: int
    seconds: float

    def __getitem__(self, key: tuple[str, str]) -> Check:
        """Return a check by the name of its result and the beginning of its measure's text."""
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
        """Return one line for each check."""
        return "\n".join(map(str, self.checks))


def verify(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = SAMPLES, seed: int = SEED
) -> Verification:
    """Evaluate every requested measure of a design over fresh, independently drawn samples.

    Means, standard deviations and CVaR get percentile intervals of the bootstrap (scipy.stats.bootstrap),
    probabilities the exact interval of Clopper and Pearson (scipy.stats.binomtest). The worst sample has no interval,
    because the distribution may extend beyond the samples: its check gives the probability of worse soils instead.

    Args:
        robust: the results in the design.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: number of fresh samples, at least 100.
        seed: seed of the fresh samples; their generator differs from that of the optimiser's samples.

    Raises:
        InputError: too few samples, or too many soils without results.
    """
    check_kind("the results", robust, Robust, "a Robust")
    started = time.perf_counter()
    if not is_count(samples) or samples < 100:
        raise InputError(f"samples = {shown(samples)} must be a whole number of at least 100, for confidence intervals")
    own = robust.values(at)
    fresh = robust.responses(at, robust.field.draw(samples, seed=seed))
    valid = samples - len(fresh.failures)
    if len(fresh.failures) > _MOST_FAILURES * samples:
        number, reason = next(iter(fresh.failures.items()))
        raise InputError(
            f"{len(fresh.failures)} of {samples} fresh soils have no result, such as number {number}: {reason};"
            " truncate the distribution at the ends of the model's domain"
        )
    requested = {(one.result, one.text): one for one in robust.requested}
    checks = tuple(_checked(one, own[one.result], fresh.values[one.result], seed) for one in requested.values())
    return Verification(checks, valid, fresh.failures, fresh.values, seed, time.perf_counter() - started)


def _checked(requested: RequestedMeasure, own: Vector, fresh: Vector, seed: int) -> Check:
    """Return the check of a measure, from the values over the optimiser's own samples and over fresh ones."""
    seen, sharp = float(requested.smoothed(own)), float(requested.exact(own))
    found = float(requested.exact(fresh))
    rounding = float(requested.smoothed(fresh)) - found if requested.width else 0.0
    ends: tuple[float, float] | tuple[None, None] = None, None
    worse = None
    if requested.kind == "probability":
        ends, note = _binomial(round(found * len(fresh)), len(fresh)), "Clopper and Pearson"
    elif requested.kind == "mean":
        ends, note = _bootstrap(requested, fresh, seed), "bootstrap"
    else:
        worse = int(np.sum(fresh > seen if requested.kind == "largest" else fresh < seen))
        least, most = _binomial(worse, len(fresh))
        note = f"{worse} of {len(fresh)} are worse: {100 * least:.2g} to {100 * most:.2g} % of the whole distribution"
    low, high = ends
    return Check(
        requested.result, requested.text, seen, sharp, found, low, high, requested.width, rounding, note, worse
    )


def _binomial(count: int, total: int) -> tuple[float, float]:
    """Return the exact interval of a probability from the number of cases."""
    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def _bootstrap(requested: RequestedMeasure, values: Vector, seed: int) -> tuple[float, float]:
    """Return the percentile interval of a measure; if all values are equal, their range."""
    if float(np.ptp(values)) <= _NEGLIGIBLE * float(np.max(np.abs(values))):
        return float(np.min(values)), float(np.max(values))
    generator = np.random.default_rng([seed, 1])
    interval = stats.bootstrap(
        (values,), requested.exact, n_resamples=_RESAMPLES, batch=_BATCH, vectorized=False, confidence_level=CONFIDENCE,
        method="percentile", rng=generator,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)


def in_words(checks: Sequence[Check]) -> str:
    """Return a sentence that says whether fresh samples confirm the optimiser's values."""
    doubtful = [f"{check.result} ({check.text}: {check.verdict})" for check in checks if not check.confirmed]
    if not doubtful:
        return "fresh samples confirm every measure"
    return f"fresh samples do not confirm {', '.join(doubtful)}; optimise over more samples for a closer value"
