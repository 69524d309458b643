"""The next measurement: candidates ranked by how much they would reduce the uncertainty of the unknowns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.plain_data import MaybeInfinite
from plough_opt.core.units import in_words
from plough_opt.studies.calibration.estimate import Estimate
from plough_opt.studies.calibration.identifiability import UNIFORM
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable, result_unit
from plough_opt.studies.calibration.model import Unknown
from plough_opt.studies.calibration.setup import Rows, Setup, predictor

Vector = NDArray[np.float64]

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
        """Return the measurement as text."""
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
    for one in candidates:
        check_kind("a candidate", one, Candidate, "a po.Candidate")
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


def _predicted(candidate: Candidate, fit: Estimate, slopes: Vector) -> tuple[float, Vector]:
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
