"""Estimate of a calibration: how far data determine the unknowns, intervals, and what to measure next."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, stats
from scipy.stats import qmc

from plough_opt.core.checks import check_kind, shown
from plough_opt.core.errors import DomainError, InputError, NotConverged, listed
from plough_opt.core.plain_data import Array, IntervalEnd, MaybeInfinite
from plough_opt.core.units import in_words
from plough_opt.studies.calibration.least_squares import AT_BOUND, UNIFORM, Data, LeastSquares, Minimum
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable, result_unit
from plough_opt.studies.calibration.model import INSIDE, Rows, Setup, Unknown, predictor

# Singular values below this part of the largest are rounding: the predictions do not depend on such directions.
_STRUCTURAL: Final = 1e-9
# Smaller components of a direction without effect (a unit vector) are rounding.
_ROUNDING: Final = 1e-6
# Smaller components of a combination with little effect, relative to its largest, are left out.
_MINOR: Final = 0.02


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


@dataclass(frozen=True)
class Identifiability:
    """How far the data determine the scaled unknowns.

    Attributes:
        covariance: covariance of the scaled unknowns (p, p); rows of undetermined ones are 0.
        along: covariance of the scaled unknowns along the determined directions alone (p, p). Predictions that depend
            on no other direction have its errors, even where single unknowns are undetermined.
        determined: whether an unknown's variance is smaller than that from its bounds alone (p).
        free: undetermined directions of the scaled unknowns, as columns (p, d).
        structural: for each of these, whether the predictions do not depend on it at all (d).
        rank: number of directions that the predictions depend on.
    """

    covariance: Array
    along: Array
    determined: NDArray[np.bool_]
    free: Array
    structural: NDArray[np.bool_]
    rank: int


def identifiability_of(slope: Array, noise: float) -> Identifiability:
    """Return how far data determine scaled unknowns.

    Args:
        slope: Jacobian of the weighted residuals by the unknowns (n, p).
        noise: standard deviation of a weighted residual.
    """
    count = slope.shape[1]
    _, sizes, right = np.linalg.svd(slope, full_matrices=True)
    sizes = np.concatenate([sizes, np.zeros(max(0, count - len(sizes)))])
    directions = right.T
    structural = sizes <= _STRUCTURAL * max(float(sizes[0]), np.finfo(float).tiny)
    deviation = np.full(count, np.inf)
    deviation[~structural] = noise / sizes[~structural]
    undetermined_directions = deviation >= UNIFORM
    parts = np.where(np.abs(directions) > np.where(structural, _ROUNDING, 0.0), directions, 0.0)
    with np.errstate(invalid="ignore"):
        variance = np.where(parts != 0.0, parts**2 * deviation**2, 0.0).sum(axis=1)
    determined = variance < UNIFORM**2
    finite = np.where(np.isfinite(deviation), deviation, 0.0)
    covariance = (directions * finite**2) @ directions.T
    mask = determined.astype(float)
    within = directions[:, ~undetermined_directions] * deviation[~undetermined_directions]
    return Identifiability(
        covariance=covariance * np.outer(mask, mask),
        along=within @ within.T,
        determined=determined,
        free=directions[:, undetermined_directions],
        structural=structural[undetermined_directions],
        rank=int(np.sum(~structural)),
    )


def undetermined(unknowns: Sequence[Unknown], y: Array, spread: Identifiability) -> tuple[Undetermined, ...]:
    """Return the undetermined combinations, each of as few unknowns as possible."""
    without_effect, pivots = _sparse(spread.free[:, spread.structural], _ROUNDING)
    # Directions without effect may be subtracted from those with little effect, which leaves fewer unknowns in these.
    weak = spread.free[:, ~spread.structural]
    weak, _ = _sparse(weak - without_effect @ weak[pivots, :], _MINOR)
    combinations = [_combination(unknowns, y, direction, structural=True) for direction in without_effect.T]
    combinations += [_combination(unknowns, y, direction, structural=False) for direction in weak.T]
    # An unknown may be undetermined by a component that was left out: name it alone.
    named = {name for item in combinations for name in item.changes}
    for k, unknown in enumerate(unknowns):
        if not spread.determined[k] and unknown.name not in named:
            alone = np.zeros(len(unknowns))
            alone[k] = 1.0
            combinations.append(_combination(unknowns, y, alone, structural=False))
    return tuple(combinations)


def _sparse(free: Array, least: float) -> tuple[Array, NDArray[np.intp]]:
    """Return a basis of the same space, and its pivots: each basis vector is the only one with its pivot unknown.

    Components of a basis vector below ``least``, relative to its largest, are set to 0.
    """
    if free.shape[1] == 0:
        return free, np.zeros(0, dtype=np.intp)
    _, _, order = linalg.qr(free.T, pivoting=True, mode="economic")
    pivots = order[: free.shape[1]]
    basis = np.linalg.solve(free[pivots, :].T, free.T).T
    return np.where(np.abs(basis) > least * np.max(np.abs(basis), axis=0), basis, 0.0), pivots


def _combination(unknowns: Sequence[Unknown], y: Array, direction: Array, structural: bool) -> Undetermined:
    """Return a direction as a combination: changes of the unknowns in SI units, and a sentence."""
    order = np.argsort(-np.abs(direction), kind="stable")
    members = [k for k in order if direction[k] != 0.0]
    size = 0.01 / direction[members[0]]
    changes = {unknowns[k].name: float(size * direction[k] * unknowns[k].slope(float(y[k]))) for k in members}
    return Undetermined(changes, structural, _words([unknowns[k] for k in members], changes, structural))


def _words(members: Sequence[Unknown], changes: Mapping[str, float], structural: bool) -> str:
    """Return the sentence about a combination."""
    names = [unknown.name for unknown in members]
    if len(names) == 1:
        if structural:
            return f"{names[0]} has no effect on the measured results: the data do not determine it"
        return f"{names[0]} is hardly determined: the data do not narrow it further than its bounds"
    first = changes[names[0]]
    moves = ", ".join(f"{_size(u, changes)} {'less' if changes[u.name] * first < 0.0 else 'more'} {u.name}"
                      for u in members[1:])  # fmt: skip
    apart = "cannot be told apart" if structural else "can hardly be told apart, with this scatter"
    sentence = f"{listed(names)} {apart}: {_size(members[0], changes)} more {names[0]} can be offset by {moves}"
    if len(names) == 2:
        ratio = -first / changes[names[1]]
        units = [f" [{u.unit}]" if u.unit else "" for u in members]
        sign = "+" if ratio > 0.0 else "-"
        held = f"{names[0]}{units[0]} {sign} {abs(ratio):.4g} x {names[1]}{units[1]}"
        sentence += f"; near the fit the data determine {held}, and neither alone"
    return sentence


def _size(unknown: Unknown, changes: Mapping[str, float]) -> str:
    return in_words(abs(changes[unknown.name]), unknown.unit, 3)


Kind = Literal["profile", "linearised"]

# Number of points between the bounds at which the loss is evaluated to choose starts.
_SCANNED: Final = 64
# The same if the predictions need runs, which take longer.
_SCANNED_WITH_RUNS: Final = 16
_SEED: Final = 7
# Standard deviation of normal errors over their median absolute deviation.
_MAD: Final = 1.4826
# Limit on the number of fits that determine the scale of a robust loss. Poor data take some fifty, rarely more.
_MOST_RESCALINGS: Final = 100
# The scale has settled when it changes by less than this part.
_SETTLED: Final = 1e-4
# Least scale of residuals relative to the nominal one per cent: runs predict to 1e-8, so less is not scatter of data.
# With a much smaller one the search, whose steps end at 1e-8, would never count as converged.
_LEAST_SCALE: Final = 1e-6
# Optima whose losses differ by less than this, relative, count as the same.
_SAME: Final = 1e-6
# Least mean curvature of a robust loss: with less, nearly all rows are outliers.
_LEAST_CURVATURE: Final = 0.05
# If an interval's half width is a smaller part of the bounds, the loss is quadratic over it.
_QUADRATIC: Final = 1e-6
# Accuracy of an interval's ends, as a part of a standard error.
_ACCURACY: Final = 1e-7


@dataclass(frozen=True)
class Estimate:
    """The best fit, with its calibration; n rows and p unknowns.

    Attributes:
        setup: model, measurements and problem.
        data: observed values and weights; the weights include the estimated scale.
        best: the best optimum.
        optima: sums of losses of all distinct local optima, the best first.
        residuals: weighted residuals, predicted minus observed (n).
        spread: how far the data determine the unknowns.
        freedom: degrees of freedom: number of rows of weight above 0, minus the rank.
        variance: variance of a weighted residual in the covariance; 1 if sigma is stated.
        rise: rise of twice the sum of losses at the end of an interval, over the squared quantile.
        normal: whether quantiles are normal, because the variance is known; otherwise they are Student's.
        drift: ratio of the residuals' scale to the scale that a robust loss assumed; 1 where the two have settled.
    """

    setup: Setup
    data: Data
    best: Minimum
    optima: tuple[float, ...]
    residuals: Array
    spread: Identifiability
    freedom: int
    variance: float
    rise: float
    normal: bool
    drift: float

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns with their bounds."""
        return self.setup.model.unknowns

    @property
    def y(self) -> Array:
        """Scaled unknowns (p)."""
        return self.best.y

    @property
    def predicted(self) -> Array:
        """Predictions (n), SI."""
        return self.setup.problem.at(self.y)[0]

    @property
    def slope(self) -> Array:
        """Jacobian of the predictions (n, p)."""
        return self.setup.problem.at(self.y)[1]

    @property
    def deviation(self) -> Array:
        """Standard deviation of each measurement (n), SI; infinite for a row of weight 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.variance**0.5 / self.data.weights)

    def quantile(self, level: float) -> float:
        """Return the two-sided quantile at a confidence level."""
        side = 0.5 + level / 2.0
        return float(stats.norm.ppf(side) if self.normal else stats.t.ppf(side, self.freedom))


def estimate(setup: Setup, data: Data, guess: Array, starts: int) -> Estimate:
    """Return the best fit from a guess and further starts between the bounds.

    Raises:
        NotConverged: no start led to an optimum.
    """
    problem, drift = setup.problem, 1.0
    # Where errors are relative, the first weights are those of errors relative to the measured values.
    scaled = data.at(data.observed)
    best, optima = _best(problem, scaled, guess, starts)
    if (problem.loss.robust or data.relative) and not data.stated:
        # Relative weights, and the scale that a robust loss needs, depend on the fit: repeat until all settle.
        for _ in range(_MOST_RESCALINGS):
            before, scaled = scaled, _rescaled(problem, data, best.y)
            if np.all(np.abs(scaled.weights - before.weights) <= _SETTLED * before.weights):
                break
            best = problem.solve(best.y, scaled)
        best, optima = _best(problem, scaled, best.y, starts)
        drift = _drift(scaled, _rescaled(problem, data, best.y))
    return _with_accuracy(setup, scaled, best, optima, drift)


def _rescaled(problem: LeastSquares, data: Data, y: Array) -> Data:
    """Return the data with the weights that belong to a fit: over its predictions, and over the residuals' scale."""
    sized = data.at(problem.predict(y))
    return replace(sized, weights=sized.weights / _scale(problem, sized, y)) if problem.loss.robust else sized


def _drift(used: Data, settled: Data) -> float:
    """Return the factor by which errors exceed those of the weights that were used, where it differs most from 1."""
    counted = used.weights > 0.0
    ratios = used.weights[counted] / settled.weights[counted]
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def _best(problem: LeastSquares, data: Data, guess: Array, starts: int) -> tuple[Minimum, tuple[float, ...]]:
    """Return the best optimum, and the losses of all distinct ones."""
    inside = np.clip(guess, INSIDE, 1.0 - INSIDE)
    # Along an undetermined direction there are many optima: take the nearest to the guess.
    open_ended = identifiability_of(problem.at(inside)[1] * data.weights[:, None], 1.0).free.shape[1] > 0
    centre = inside if open_ended else None
    minima = [problem.solve(y, data, centre) for y in (inside, *_starts(problem, data, starts - 1))]
    converged = sorted((minimum for minimum in minima if minimum.converged), key=lambda minimum: minimum.loss)
    if not converged:
        raise NotConverged(
            f"the fit did not converge from any of {len(minima)} starts ({minima[0].status}): narrow the bounds,"
            " give guesses, or fix unknowns that the data do not determine",
            minima[0].status,
        )
    losses = [converged[0].loss]
    for minimum in converged[1:]:
        if minimum.loss - losses[-1] > _SAME * (1.0 + losses[-1]):
            losses.append(minimum.loss)
    return converged[0], tuple(losses)


def _starts(problem: LeastSquares, data: Data, count: int) -> list[Array]:
    """Return the points between the bounds with the smallest losses, out of many."""
    if count < 1:
        return []
    points = qmc.Sobol(problem.unknowns, seed=_SEED).random(_SCANNED if problem.closed else _SCANNED_WITH_RUNS)
    losses = np.nan_to_num([problem.total(point, data) for point in points], nan=np.inf, posinf=np.inf)
    return [points[k] for k in np.argsort(losses)[:count]]


def _scale(problem: LeastSquares, data: Data, y: Array) -> float:
    """Return the standard deviation of the residuals, estimated from the median of their absolute values."""
    size = np.abs(data.weights * (problem.predict(y) - data.observed))[data.weights > 0.0]
    freedom = max(len(size) - problem.unknowns, 1)
    return max(_MAD * float(np.median(size)) * math.sqrt(len(size) / freedom), _LEAST_SCALE)


def _with_accuracy(setup: Setup, data: Data, best: Minimum, optima: tuple[float, ...], drift: float) -> Estimate:
    """Return the estimate with the accuracy of the unknowns."""
    problem = setup.problem
    predicted, slope = problem.at(best.y)
    residuals, weighted = data.weights * (predicted - data.observed), slope * data.weights[:, None]
    freedom = data.count - identifiability_of(weighted, 1.0).rank
    counted = residuals[data.weights > 0.0]
    normal = data.stated and not problem.loss.robust
    pull = problem.loss.weight(counted) * counted
    square = 1.0 if normal else max(float(np.sum(pull**2)) / max(freedom, 1), _LEAST_SCALE**2)
    curvature = max(float(np.mean(problem.loss.curvature(counted))), _LEAST_CURVATURE)
    variance = square / curvature**2
    spread = identifiability_of(weighted, variance**0.5)
    return Estimate(setup, data, best, optima, residuals, spread, freedom, variance, square / curvature, normal, drift)


@dataclass(frozen=True)
class Interval:
    """A confidence interval of one unknown, SI.

    Attributes:
        lower: its lower end; minus infinity if the data do not determine the unknown.
        upper: its upper end.
        clipped: which ends ("lower", "upper") are bounds of the unknown, because the data do not exclude the bounds.
        kind: "profile"; "linearised" if that was requested, if the interval is too short for the two to differ, or if
            the profile could not be computed.
    """

    lower: IntervalEnd
    upper: IntervalEnd
    clipped: tuple[str, ...] = ()
    kind: Kind = "profile"

    def __contains__(self, value: float) -> bool:
        return self.lower <= value <= self.upper

    def __iter__(self) -> Iterator[float]:
        return iter((self.lower, self.upper))


def check_level(level: float) -> float:
    """Return a confidence level as a float, or raise InputError if it is not between 0 and 1."""
    if not isinstance(level, int | float) or not 0.0 < level < 1.0:
        raise InputError(f"level = {shown(level)} must lie between 0 and 1, such as 0.95")
    return float(level)


def interval(fit: Estimate, k: int, level: float, kind: Kind) -> Interval:
    """Return the interval of unknown number k.

    A profile interval holds all values at which the loss, with the other unknowns fitted anew, rises by no more than
    the quantile allows. A linearised one is the value ± quantile times standard error, on the scale of the unknown (its
    logarithm if that is what is scaled).
    """
    if not fit.spread.determined[k]:
        return Interval(-np.inf, np.inf, kind=kind)
    reach = fit.quantile(level) * float(np.sqrt(fit.spread.covariance[k, k]))
    low, high = fit.y[k] - reach, fit.y[k] + reach
    if reach < _QUADRATIC:
        kind = "linearised"
    if kind == "profile":
        try:
            low, high = (_profile_end(fit, k, sign, fit.quantile(level)) for sign in (-1.0, 1.0))
        except NotConverged:
            kind = "linearised"
    unknown = fit.unknowns[k]
    clipped = {"lower": low <= AT_BOUND, "upper": high >= 1.0 - AT_BOUND}
    lower = unknown.lower if clipped["lower"] else float(unknown.value(low))
    upper = unknown.upper if clipped["upper"] else float(unknown.value(high))
    return Interval(lower, upper, tuple(side for side, at_bound in clipped.items() if at_bound), kind)


def _profile_end(fit: Estimate, k: int, sign: float, quantile: float) -> float:
    """Return one end of the profile interval of scaled unknown k, or the bound on that side if it comes first.

    Raises:
        NotConverged: the other unknowns could not be fitted.
    """
    error = float(np.sqrt(fit.spread.covariance[k, k]))
    # Change of all unknowns per change of this one, to first order: it predicts the fit of the others.
    direction = fit.spread.covariance[:, k] / error**2
    centre = fit.y if fit.spread.free.shape[1] else None
    solved = {float(fit.y[k]): fit.best}

    def excess(value: float) -> float:
        """Return the square root of the loss's rise minus the quantile; it is nearly linear in the value."""
        if value not in solved:
            nearest = min(solved, key=lambda other: abs(other - value))
            start = np.clip(solved[nearest].y + (value - nearest) * direction, 0.0, 1.0)
            start[k] = value
            solved[value] = minimum = fit.setup.problem.solve(start, fit.data, centre, held=k)
            if not minimum.converged:
                raise NotConverged(f"the profile likelihood has no optimum: {minimum.status}", minimum.status)
        return float(np.sqrt(max(2.0 * (solved[value].loss - fit.best.loss), 0.0) / fit.rise)) - quantile

    near, reach = float(fit.y[k]), sign * quantile * error
    while True:
        far = min(max(near + reach, 0.0), 1.0)
        if excess(far) >= 0.0:
            return float(optimize.brentq(excess, near, far, xtol=_ACCURACY * error))
        if far in (0.0, 1.0):
            return far
        near, reach = far, 2.0 * reach


# Assumed standard deviation of a direct measurement of an unknown, as a part of the distance of its bounds.
_DIRECT_ERROR: Final = 0.05
# Conditions of the proposed measurements, as factors on the median of the measured ones.
_FACTORS: Final = {"share.wedge_angle": (0.6, 1.5), "share.height": (0.7, 1.4), "scene.tow_speed": (0.5, 1.7)}
# Largest wedge angle that is proposed.
_STEEPEST: Final = math.radians(70.0)
# Gains that agree to this number of decimals are equal, but for rounding in the order of the rows.
_DIGITS: Final = 6
# Known tool friction of steel coated with polyethylene.
_COATED_FRICTION: Final = 0.2
# Proposed increase of the ambient pressure [Pa], as at a larger depth.
_MORE_PRESSURE: Final = 10e3


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made.

    Attributes:
        result: the result to measure, as in `Measurements`; or the name of an unknown that is measured directly.
        conditions: key -> value, SI; the other conditions are at the median of the measured ones.
        sigma: standard deviation of its error, in the result's SI unit; None: the relative error of the data.
        why: a name for reports; "" for a generated description.

    Example:
        >>> import plough_opt as po
        >>> po.Candidate("mean_draft", {"scene.tow_speed": 3.0}).result
        'mean_draft'
    """

    result: str
    conditions: Mapping[str, float] = field(default_factory=dict)
    sigma: MaybeInfinite | None = None
    why: str = ""

    def describe(self) -> str:
        """Return the measurement as text.

        Example:
            >>> import plough_opt as po
            >>> po.Candidate("mean_draft", {"scene.tow_speed": 3.0}).describe()
            'mean_draft at scene.tow_speed = 3 m/s'
        """
        if self.why:
            return self.why
        if not self.conditions:
            return f"{self.result} again"
        return f"{self.result} at " + ", ".join(_condition(key, x) for key, x in self.conditions.items())


@dataclass(frozen=True)
class NextMeasurement:
    """The gain from a candidate.

    Attributes:
        candidate: the measurement.
        sigma: assumed standard deviation of its error, SI.
        information: gain of information: ln of the factor by which the volume of possible values shrinks.
        errors: unknown -> (standard error now, and with the measurement), SI; both include what the bounds say.
        units: unknown -> SI unit.
    """

    candidate: Candidate
    sigma: MaybeInfinite
    information: float
    errors: Mapping[str, tuple[MaybeInfinite, MaybeInfinite]]
    units: Mapping[str, str]

    def words(self) -> str:
        """Return the gain in a sentence."""
        gains = sorted(self.errors.items(), key=lambda item: item[1][1] / item[1][0])
        largest = [
            f"{name} from ±{now:.3g} to ±{then:.3g} {self.units[name]}".rstrip()
            for name, (now, then) in gains[:3]
            if then < 0.9 * now
        ]
        return f"{self.candidate.describe()}: {'; '.join(largest) or 'hardly any gain'}"


def next_measurements(fit: Estimate, candidates: Sequence[Candidate] | None = None) -> tuple[NextMeasurement, ...]:
    """Return candidates with their gain of information, the best first.

    The first one is D-optimal. The prior is a uniform distribution between the bounds.

    Args:
        fit: the estimate from the data.
        candidates: candidates to rank; default: other conditions, other results, and direct measurements of unknowns.

    Raises:
        InputError: a candidate of another type, or no candidate that this scene can have.
    """
    if candidates is None:
        candidates = _proposals(fit.setup)
    check_kind("the candidates", candidates, Sequence, "a list of po.Candidate")
    for candidate in candidates:
        check_kind("a candidate", candidate, Candidate, "a po.Candidate")
    unknowns = fit.unknowns
    slopes = np.array([unknown.slope(float(y)) for unknown, y in zip(unknowns, fit.y, strict=True)])
    weighted = fit.slope * fit.data.weights[:, None]
    now = np.linalg.inv(weighted.T @ weighted / fit.variance + np.eye(len(unknowns)) / UNIFORM**2)
    before, units = np.sqrt(np.diag(now)) * slopes, {unknown.name: unknown.unit for unknown in unknowns}
    ranking = []
    for candidate in candidates:
        try:
            sigma, slope = _predicted(candidate, fit, slopes)
        except (DomainError, InputError):  # the scene does not have this result or these conditions
            continue
        row = slope / sigma
        step = now @ row
        gain = float(row @ step)
        after = np.sqrt(np.maximum(np.diag(now - np.outer(step, step) / (1.0 + gain)), 0.0)) * slopes
        errors = {u.name: (float(before[k]), float(after[k])) for k, u in enumerate(unknowns)}
        ranking.append(NextMeasurement(candidate, sigma, 0.5 * math.log1p(gain), errors, units))
    if not ranking:
        raise InputError("none of the candidates can be measured in this scene: check their results and conditions")
    return tuple(sorted(ranking, key=lambda item: (-round(item.information, _DIGITS), item.candidate.describe())))


def _predicted(candidate: Candidate, fit: Estimate, slopes: Array) -> tuple[float, Array]:
    """Return the standard deviation of a candidate's error, and its derivatives by the scaled unknowns.

    Args:
        candidate: the candidate.
        fit: the estimate from the data.
        slopes: derivatives of the unknowns by their scaled values.

    Raises:
        DomainError: the conditions are outside the model's domain.
        InputError: the scene does not have the result or a condition.
    """
    for k, unknown in enumerate(fit.unknowns):
        if unknown.name == candidate.result:
            return candidate.sigma or _direct_error(unknown), slopes[k] * np.eye(len(slopes))[k]
    if candidate.result not in measurable():
        raise InputError(f"'{candidate.result}' is neither a result of a run nor one of the unknowns")
    keys = dict.fromkeys(key for m in fit.setup.measured for key in m.conditions)
    medians = {key: median for key in keys if (median := _median(key, fit.setup)) is not None}
    added = Measurements(candidate.result, [0.0], {**medians, **candidate.conditions})
    value, slope = predictor((Rows(added, fit.setup.model),), fit.setup.model)(fit.y)
    size, observed = abs(float(value)), np.abs(fit.data.observed)
    counted = (fit.data.weights > 0.0) & (observed > 0.0)
    relative = float(np.median(fit.deviation[counted] / observed[counted]))
    return candidate.sigma or max(relative * size, 1e-12 * max(1.0, size)), np.asarray(slope).ravel()


def _proposals(setup: Setup) -> list[Candidate]:
    """Return the default candidates: other conditions, other results, and direct measurements of the unknowns."""
    names = {unknown.name for unknown in setup.model.unknowns}
    results = [m.result for m in setup.measured if m.result in measurable() and m.result != RECORD] or ["mean_draft"]
    candidates: list[Candidate] = []
    for result in dict.fromkeys(results):
        candidates.append(Candidate(result))
        for key, factors in _FACTORS.items():
            if key not in names and (median := _median(key, setup)):
                most = _STEEPEST if key == "share.wedge_angle" else math.inf
                candidates += [Candidate(result, {key: min(factor * median, most)}) for factor in factors]
        key = "soil.ambient_pressure"
        if key not in names and (median := _median(key, setup)):
            why = f"{result} at an ambient pressure {_MORE_PRESSURE / 1e3:g} kPa higher"
            candidates.append(Candidate(result, {key: median + _MORE_PRESSURE}, why=why))
        if "soil.tool_friction" in names:
            why = f"{result} of a coated share, of known tool friction {_COATED_FRICTION:g}"
            candidates.append(Candidate(result, {"soil.tool_friction": _COATED_FRICTION}, why=why))
    if "loosened_radius" not in results:
        candidates.append(Candidate("loosened_radius", why="loosened_radius"))
    for unknown in setup.model.unknowns:
        error = _direct_error(unknown)
        why = f"{unknown.name} measured directly, to ±{in_words(error, unknown.unit, 3)}"
        candidates.append(Candidate(unknown.name, sigma=error, why=why))
    return candidates


def _direct_error(unknown: Unknown) -> float:
    """Return the standard deviation that is assumed for a direct measurement of an unknown."""
    return _DIRECT_ERROR * (unknown.upper - unknown.lower)


def _median(key: str, setup: Setup) -> float | None:
    """Return the median of a condition over all rows that count; the scene's own value if it was not varied."""
    columns = [m.conditions[key][m.counted] for m in setup.measured if key in m.conditions]
    return float(np.median(np.concatenate(columns))) if columns else setup.model.current.get(key)


def _condition(key: str, value: float) -> str:
    return f"{key} = {in_words(value, result_unit(key).symbol, 3)}"
