"""Confidence intervals: of the profile likelihood, and linearised."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy import optimize

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.studies.calibration.estimate import Estimate
from plough_opt.studies.calibration.least_squares import AT_BOUND
from plough_opt.studies.calibration.unknown import Unknown

Kind = Literal["profile", "linearised"]

# Within so small a part of the bounds the loss is quadratic.
_STRAIGHT: Final = 1e-6
# Of a standard error: how accurately the ends are found.
_ACCURACY: Final = 1e-7


@dataclass(frozen=True)
class Interval:
    """A confidence interval of one unknown, SI.

    Attributes:
        lower: its lower end; minus infinity if the data do not determine the unknown.
        upper: its upper end.
        clipped: the ends that are the unknown's bounds, "lower" or "upper", because the data do not exclude them.
        kind: "profile", or "linearised" if requested or if the profile could not be computed.
    """

    lower: float
    upper: float
    clipped: tuple[str, ...] = ()
    kind: Kind = "profile"

    def __contains__(self, value: float) -> bool:
        return self.lower <= value <= self.upper

    def __iter__(self) -> Iterator[float]:
        return iter((self.lower, self.upper))


def check_level(level: float) -> float:
    """Return a level, or raise InputError if it is not between 0 and 1."""
    if not isinstance(level, int | float) or not 0.0 < level < 1.0:
        raise InputError(f"level = {shown(level)} must lie between 0 and 1, such as 0.95")
    return float(level)


def interval(fit: Estimate, unknown: Unknown, k: int, level: float, kind: Kind) -> Interval:
    """Return the interval of unknown number k.

    Profile: all values with which, the other unknowns adjusted, the loss rises by no more than the quantile allows.
    Linearised: standard error times quantile, on the unknown's own scale (its logarithm where that is scaled).
    """
    if not fit.spread.determined[k]:
        return Interval(-np.inf, np.inf, kind=kind)
    reach = fit.quantile(level) * float(np.sqrt(fit.spread.covariance[k, k]))
    low, high = fit.y[k] - reach, fit.y[k] + reach
    if reach < _STRAIGHT:
        kind = "linearised"
    if kind == "profile":
        try:
            low, high = (_profile_end(fit, k, sign, fit.quantile(level)) for sign in (-1.0, 1.0))
        except NotConverged:
            kind = "linearised"
    beyond = {"lower": low <= AT_BOUND, "upper": high >= 1.0 - AT_BOUND}
    lower = unknown.lower if beyond["lower"] else float(unknown.value(low))
    upper = unknown.upper if beyond["upper"] else float(unknown.value(high))
    return Interval(lower, upper, tuple(side for side, clipped in beyond.items() if clipped), kind)


def _profile_end(fit: Estimate, k: int, sign: float, quantile: float) -> float:
    """Return the end of the profile's interval in scaled unknown k on one side, or the bound if that comes first.

    Raises:
        NotConverged: the other unknowns could not be adjusted.
    """
    error = float(np.sqrt(fit.spread.covariance[k, k]))
    along = fit.spread.covariance[:, k] / error**2
    centre = fit.y if fit.spread.free.shape[1] else None
    known = {float(fit.y[k]): fit.best}

    def excess(own: float) -> float:
        """Return the root of the loss's rise, in quantiles: nearly a straight line."""
        if own not in known:
            nearest = min(known, key=lambda other: abs(other - own))
            start = np.clip(known[nearest].y + (own - nearest) * along, 0.0, 1.0)
            start[k] = own
            known[own] = found = fit.problem.solve(start, fit.data, centre, held=k)
            if not found.converged:
                raise NotConverged(f"the profile likelihood has no optimum: {found.status}", found.status)
        return float(np.sqrt(max(2.0 * (known[own].loss - fit.best.loss), 0.0) / fit.rise)) - quantile

    near, reach = float(fit.y[k]), sign * quantile * error
    while True:
        far = min(max(near + reach, 0.0), 1.0)
        if excess(far) >= 0.0:
            return float(optimize.brentq(excess, near, far, xtol=_ACCURACY * error))
        if far in (0.0, 1.0):
            return far
        near, reach = far, 2.0 * reach
