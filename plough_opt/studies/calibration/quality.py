"""What an estimate is worth: intervals, what to measure next, warnings, and cross-validation."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, stats

from plough_opt.core.checks import check_kind, check_named, plain_number, whole_number
from plough_opt.core.errors import DomainError, InputError, IntegrationError, NotConverged
from plough_opt.core.expressions import ByValue, as_number
from plough_opt.core.plain_data import Array, IntervalEnd, MaybeInfinite
from plough_opt.core.quantities import EVERY
from plough_opt.core.units import in_words
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT
from plough_opt.studies.calibration.estimate import AT_BOUND, UNIFORM, Estimate, Setup, estimate
from plough_opt.studies.calibration.model import RECORD, Measurements, Rows, SceneOfRows, is_closed, predictor

Kind = Literal["profile", "linearised"]

# If an interval's half width is a smaller part of the bounds, the loss is quadratic over it.
_QUADRATIC: Final = 1e-6
# Accuracy of an interval's ends, as a part of a standard error.
_ACCURACY: Final = 1e-7


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
    return plain_number("level", level, above=0.0, below=1.0, why="0.95 is usual")


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
    lower = unknown.lower if clipped["lower"] else float(unknown.unscaled(low))
    upper = unknown.upper if clipped["upper"] else float(unknown.unscaled(high))
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
        words = (f"{key} = {in_words(x, EVERY[key].unit, 3)}" for key, x in self.conditions.items())
        return f"{self.result} at {', '.join(words)}"


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
        gains = sorted(self.errors.items(), key=lambda item: item[1][1] / item[1][0])[:3]
        largest = [f"{name} from ±{now:.3g} to ±{then:.3g} {self.units[name]}".rstrip()
                   for name, (now, then) in gains if then < 0.9 * now]  # fmt: skip
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
            return candidate.sigma or unknown.direct_error, slopes[k] * np.eye(len(slopes))[k]
    keys = dict.fromkeys(key for m in fit.setup.measured for key in m.conditions)
    medians = {key: median for key in keys if (median := _median(key, fit.setup)) is not None}
    added = Measurements(candidate.result, [0.0], {**medians, **candidate.conditions})
    if added.direct:
        raise InputError(f"'{candidate.result}' is neither a result of a run nor one of the unknowns")
    value, slope = predictor((Rows(added, fit.setup.model),), fit.setup.model)(fit.y)
    size, observed = abs(float(value)), np.abs(fit.data.observed)
    counted = (fit.data.weights > 0.0) & (observed > 0.0)
    relative = float(np.median(fit.deviation[counted] / observed[counted]))
    return candidate.sigma or max(relative * size, 1e-12 * max(1.0, size)), np.asarray(slope).ravel()


def _proposals(setup: Setup) -> list[Candidate]:
    """Return the default candidates: other conditions, other results, and direct measurements of the unknowns."""
    names = {unknown.name for unknown in setup.model.unknowns}
    results = [m.result for m in setup.measured if not m.direct and m.result != RECORD] or ["mean_draft"]
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
        why = f"{unknown.name} measured directly, to ±{in_words(unknown.direct_error, unknown.unit, 3)}"
        candidates.append(Candidate(unknown.name, sigma=unknown.direct_error, why=why))
    return candidates


def _median(key: str, setup: Setup) -> float | None:
    """Return the median of a condition over all rows that count; the scene's own value if it was not varied."""
    columns = [m.conditions[key][m.counted] for m in setup.measured if key in m.conditions]
    return float(np.median(np.concatenate(columns))) if columns else setup.model.current.get(key)


# Significance level of the tests for scatter and correlation.
_SIGNIFICANCE: Final = 1e-3
# Significance level of the test for errors that grow with the result: one fit in twenty is warned of in vain. Of fits
# to 24 rows with proportional errors, whose results differ by a factor of five, five in six are warned of.
_GROWING: Final = 0.05
# Differences and parts below this are rounding.
_NO_DIFFERENCE: Final = 1e-9
# A residual above this many standard deviations is an outlier.
_OUTLIER: Final = 4.0
# The scale of a robust loss has not settled if the residuals differ from it by more than this part.
_DRIFT: Final = 0.01
# Least number of residuals of a record, or of degrees of freedom, from which a correlation is estimated.
_FEWEST_CORRELATED: Final = 8
# Differences between checked runs and predictions are reported above this part of a standard deviation.
_NOTABLE_ERROR: Final = 0.1
# Largest number of runs that are checked.
_MOST_CHECKED: Final = 12
# By default cross-validation leaves out one row at a time up to this number of rows, if they need no runs.
_MOST_LEFT_OUT: Final = 60


def caveats(fit: Estimate) -> tuple[str, ...]:
    """Return the warnings about a fit."""
    at_fit = [rows.scenes(fit.y) for rows in fit.setup.rows]
    scenes = [scene for of_set in at_fit for scene, _, _ in of_set]
    of_scatter = (*_scatter_notes(fit), *_scale_notes(fit), *_error_notes(fit), *_outlier_notes(fit))
    of_fit = (*of_scatter, *_correlation_notes(fit), *_bound_notes(fit), *_optima_notes(fit))
    return (*of_fit, *_accuracy_notes(fit, at_fit), *_bluntness_notes(scenes), *_pressure_notes(fit, scenes))


def _scatter_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning if the residuals are larger or smaller than the stated sigma implies."""
    if not fit.normal or fit.freedom < 1:
        return
    square = float(fit.residuals @ fit.residuals)
    ratio = f"{math.sqrt(square / fit.freedom):.3g} times as large as the stated sigma implies"
    if stats.chi2.sf(square, fit.freedom) < _SIGNIFICANCE:
        yield (
            f"residuals are {ratio}: the model does not follow the data, or sigma and with it the intervals are too"
            " small; leave sigma out to derive the intervals from the scatter"
        )
    elif stats.chi2.cdf(square, fit.freedom) < _SIGNIFICANCE:
        yield f"residuals are only {ratio}: sigma is too large"


def _scale_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning if a robust loss and the scale of its residuals did not settle."""
    if abs(fit.drift - 1.0) > _DRIFT:
        yield (
            f"the residuals scatter {fit.drift:.3g} times as much as the robust loss assumes: fit and scatter did not"
            " settle, as few rows allow several such fits; state sigma, or use loss 'squares'"
        )


def _error_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning if errors that are assumed constant grow with the result.

    Glejser's test: the absolute residuals, free of the fit's leverage, are correlated with the logarithm of the result.
    """
    if fit.data.stated or fit.data.relative or fit.freedom < _FEWEST_CORRELATED:
        return
    base = linalg.orth(fit.slope * fit.data.weights[:, None])
    left = np.maximum(1.0 - np.sum(base**2, axis=1), 0.0)
    by_set = _by_set(fit, np.abs(fit.predicted))
    sizes = np.concatenate([predicted / np.mean(predicted[rows.measured.counted]) for rows, predicted in by_set])
    counted = (fit.data.weights > 0.0) & (left > _NO_DIFFERENCE) & (sizes > _NO_DIFFERENCE)
    logarithms = np.log(sizes[counted])
    errors = np.abs(fit.residuals[counted]) / np.sqrt(left[counted])
    if np.ptp(logarithms) < _NO_DIFFERENCE or np.ptp(errors) <= _NO_DIFFERENCE * np.max(errors):
        return
    if stats.pearsonr(logarithms, errors, alternative="greater").pvalue < _GROWING:
        yield (
            "residuals grow with the predicted value, while the intervals assume errors of equal size and are then too"
            " narrow: state sigma, or calibrate with errors 'relative'"
        )


def _outlier_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning that names rows with large residuals."""
    size = np.abs(fit.residuals) / math.sqrt(fit.variance)
    if far := [k for k in np.argsort(-size) if size[k] > _OUTLIER]:
        more = f" and {len(far) - 3} more" if len(far) > 3 else ""
        first = ", ".join(f"{fit.setup.places[k]} ({size[k]:.2g} sigma)" for k in far[:3])
        yield f"outliers: {first}{more}; a robust loss, such as 'huber', gives them less weight"


def _by_set(fit: Estimate, values: NDArray[Any]) -> Iterator[tuple[Rows, NDArray[Any]]]:
    """Yield every set of measurements with its part of a column over all rows."""
    ends = np.cumsum([m.rows for m in fit.setup.measured])[:-1]
    yield from zip(fit.setup.rows, np.split(values, ends), strict=True)


def _correlation_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning for each record whose residuals are correlated in time."""
    for rows, residuals in _by_set(fit, fit.residuals):
        m = rows.measured
        if m.time is None or len(residuals) < _FEWEST_CORRELATED or not np.any(residuals):
            continue
        residuals = residuals[np.lexsort((m.time, *m.conditions.values()))]
        correlation = float(residuals[1:] @ residuals[:-1] / (residuals @ residuals))
        if correlation > stats.norm.isf(_SIGNIFICANCE) / math.sqrt(len(residuals)):
            wider = math.sqrt((1.0 + correlation) / (1.0 - correlation))
            yield (
                f"{m.name}: residuals of neighbouring times are correlated ({correlation:.2g}): intervals"
                f" assume that they are independent, and are too narrow by a factor of about {wider:.2g}"
            )


def _bound_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning for each determined unknown that is on a bound."""
    for k in np.flatnonzero(fit.spread.determined):
        unknown = fit.unknowns[k]
        for side, distance, bound in (("lower", fit.y[k], unknown.lower), ("upper", 1.0 - fit.y[k], unknown.upper)):
            if distance < AT_BOUND:
                place = f"{unknown.name} is at its {side} bound {bound:g} {unknown.unit}".rstrip()
                yield f"{place}: the data call for a value beyond it, and the intervals are valid only if the bound is"


def _optima_notes(fit: Estimate) -> Iterator[str]:
    """Yield a warning if other local optima fit almost as well."""
    if near := [loss for loss in fit.optima[1:] if loss - fit.optima[0] < 0.5 * fit.quantile(0.95) ** 2 * fit.rise]:
        yield (
            f"{len(near)} other local optima fit almost as well: the intervals surround only the best; use narrower"
            " bounds or further measurements to decide between them"
        )


def _accuracy_notes(fit: Estimate, at_fit: list[list[SceneOfRows]]) -> Iterator[str]:
    """Yield a warning if numeric runs, whose error is checked, differ from the fitted values."""
    worst, count = 0.0, 0
    for (rows, numbers), scenes in zip(_by_set(fit, np.arange(len(fit.residuals))), at_fit, strict=True):
        for scene, duration, which in scenes:
            if is_closed(scene, rows.measured.result) or count >= _MOST_CHECKED:
                continue
            count += 1
            try:
                run = rows.checked(scene, duration, which)
            except IntegrationError as error:
                yield f"the run of the fitted scene could not be checked: {error}"
                return
            places = numbers[which]
            worst = max(worst, float(np.max(np.abs(run - fit.predicted[places]) / fit.deviation[places])))
    if worst > _NOTABLE_ERROR:
        yield f"runs with an error check differ from the fitted ones by up to {worst:.2g} standard deviations"


def _bluntness_notes(scenes: list[Scene]) -> Iterator[str]:
    """Yield a warning if the equivalent cone is too blunt for the theory at measured conditions."""
    angles = [float(as_number(scene.cone.half_angle)) for scene in scenes if scene.law.slender]
    if blunt := sum(angle > PLANE_SECTIONS_LIMIT for angle in angles):
        yield (
            f"at {blunt} of {len(scenes)} conditions the equivalent cone's half angle is above"
            f" {math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg, where the hypothesis of plane sections does not hold"
        )


def _pressure_notes(fit: Estimate, scenes: list[Scene]) -> Iterator[str]:
    """Yield a warning if an ambient pressure that carries a part of the draft is taken as known."""
    named = {unknown.name for unknown in fit.unknowns}.union(*(m.conditions for m in fit.setup.measured))
    share = max((float(as_number(scene.ambient_share)) for scene in scenes), default=0.0)
    if "soil.ambient_pressure" not in named and share > 0.0:
        pressure = float(as_number(scenes[0].soil.ambient_pressure)) / 1e3
        yield (
            f"an ambient pressure of {pressure:.4g} kPa is taken as known and carries {100 * share:.0f} % of the"
            " static draft: the calibrated strength of the soil depends on it"
        )


@dataclass(frozen=True, eq=False)
class CrossValidation(ByValue):
    """Errors of the predictions for rows left out of the fit.

    Attributes:
        folds: number of parts that were left out in turn; equal to the number of rows if each was left out alone.
        rows: numbers of the rows that were left out; neither rows of weight 0 nor rows that
            measure an unknown directly are among them.
        errors: predicted minus observed values of these rows, by the fits without them, SI.
        rms: result -> root mean square of its errors, SI.
        rms_fitted: result -> root mean square of its residuals in the fit to all rows, which is smaller, SI.
    """

    folds: int
    rows: NDArray[np.intp]
    errors: Array
    rms: Mapping[str, float]
    rms_fitted: Mapping[str, float]


def cross_validate(fit: Estimate, folds: int | None, seed: int) -> CrossValidation:
    """Return the errors of predictions for rows that are left out of the fit, part by part.

    Args:
        fit: the fit to all rows.
        folds: number of parts, from 2 to the number of rows; None: one for each row, 20 for over 60 rows, and 5 if the
            rows need runs.
        seed: seed of the shuffling; rows of a record are not shuffled, because errors of neighbours are correlated.

    Raises:
        InputError: an invalid number of folds.
        NotConverged: a fit without some of the rows did not converge.
    """
    setup, data = fit.setup, fit.data
    results, order = _counted(fit)
    count = len(order)
    if count < 2:
        raise InputError("cross-validation needs two rows or more that are not left out by a weight of 0")
    if folds is None:
        folds = (count if count <= _MOST_LEFT_OUT else 20) if setup.problem.closed else min(5, count)
    folds = whole_number("folds", folds, 2, count)
    rows, names = order.copy(), dict.fromkeys(results[order])
    if RECORD not in results and folds < count:
        np.random.default_rng(seed).shuffle(order)
    errors = np.zeros(len(results))
    for part in np.array_split(order, folds):
        if data.count - len(part) < setup.problem.unknowns:
            raise InputError(f"{folds} folds leave fewer rows than unknowns: use more folds")
        without = _without(fit, part, fit.y, starts=1)
        errors[part] = (without.predicted - data.observed)[part]

    def rms(values: Array) -> dict[str, float]:
        return {str(name): float(np.sqrt(np.mean(values[rows][results[rows] == name] ** 2))) for name in names}

    return CrossValidation(folds, rows, errors[rows], rms(errors), rms(fit.predicted - data.observed))


def held_out(fit: Estimate, part: float, by: str | None, seed: int) -> tuple[Estimate, NDArray[np.intp], Array]:
    """Fit to some of the rows, and return the fit with what it says of the others.

    Args:
        fit: the fit to all rows.
        part: part of the rows to hold out, or of the distinct values of a column.
        by: key of a column; None for single rows.
        seed: seed of the choice. Of a record the last rows are held out, because errors of neighbours are correlated.

    Returns:
        The fit, whose weights include those of the rows held out; their indices; and the standard errors of their
        predictions, infinite where these depend on combinations of unknowns that the other rows do not determine.

    Raises:
        InputError: no such column, or a part that leaves too few rows on either side.
        NotConverged: the fit to the other rows did not converge.
    """
    results, order = _counted(fit)
    groups = _groups(fit, order, by)
    share = plain_number("the part of the rows to hold out", part, above=0.0, below=1.0, why="1/3 is usual")
    count = max(1, round(share * len(groups)))
    chosen = np.arange(len(groups))
    if by is not None or RECORD not in results:
        np.random.default_rng(seed).shuffle(chosen)
    held = np.sort(np.concatenate([groups[k] for k in chosen[len(groups) - count :]]))
    unknowns = fit.setup.problem.unknowns
    least = unknowns + (0 if fit.normal else 1)
    if fit.data.count - len(held) < least:
        few = f"holding out {len(held)} of {len(order)} rows leaves fewer than the {least} that {unknowns} unknowns"
        raise InputError(f"{few} need: hold out a smaller part, or measure more")
    # The other rows choose their own starts, so that nothing of the rows held out enters.
    without = _without(fit, held, fit.setup.model.guess, starts=4)
    weights = fit.setup.data.at(without.predicted).weights
    kept = without.data.weights > 0.0
    # A robust loss has divided all weights by the scale of the residuals.
    weights = weights * float(np.median(without.data.weights[kept] / weights[kept]))
    whole = replace(without, data=replace(without.data, weights=weights))
    slope, spread = without.slope[held], without.spread
    errors = np.sqrt(np.einsum("ni,ij,nj->n", slope, spread.along, slope))
    # Along an undetermined direction the unknowns may be anywhere between their bounds.
    elsewhere = UNIFORM * np.linalg.norm(slope @ spread.free, axis=1)
    return whole, held, np.where(elsewhere > _NOTABLE_ERROR * whole.deviation[held], np.inf, errors)


def _counted(fit: Estimate) -> tuple[NDArray[np.str_], NDArray[np.intp]]:
    """Return the result of every row, and the indices of the rows that can be left out.

    Neither rows of weight 0 nor rows that measure an unknown directly are among these.
    """
    sets = [m for m in fit.setup.measured for _ in range(m.rows)]
    direct = np.array([m.direct for m in sets])
    return np.array([m.result for m in sets]), np.flatnonzero(~direct & (fit.data.weights > 0.0))


def _without(fit: Estimate, rows: NDArray[np.intp], guess: Array, starts: int) -> Estimate:
    """Return the fit without some rows."""
    weights = fit.setup.data.weights.copy()
    weights[rows] = 0.0
    return estimate(fit.setup, replace(fit.setup.data, observed=fit.data.observed, weights=weights), guess, starts)


def _groups(fit: Estimate, order: NDArray[np.intp], by: str | None) -> list[NDArray[np.intp]]:
    """Return the rows that are held out together: single rows, or those with one value in a column.

    Raises:
        InputError: no such column, or one with a single value.
    """
    if by is None:
        return [order[k : k + 1] for k in range(len(order))]
    measured = fit.setup.measured
    columns = dict.fromkeys(key for m in measured for key in m.conditions)
    check_named("{} is not a column of the data", by, columns)
    values = np.concatenate([m.conditions.get(by, np.full(m.rows, np.nan)) for m in measured])[order]
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < 2:
        raise InputError(f"'{by}' has one value in all rows: hold out by a column that varies, or by rows")
    return [order[values == value] for value in distinct]
