"""The next measurement: candidates ranked by how much they would reduce the uncertainty that the data leave."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError
from plough_opt.studies.calibration.identifiability import UNIFORM
from plough_opt.studies.calibration.measurements import RECORD, Measurements, measurable, result_unit
from plough_opt.studies.calibration.model import Model
from plough_opt.studies.calibration.unknown import Unknown, amount

Vector = NDArray[np.float64]

# A candidate that measures an unknown by itself does so within this part of its bounds.
_DIRECT: Final = 0.05
# Conditions of the proposed measurements: factors on the middle of those measured.
_FACTORS: Final = {"share.wedge_angle": (0.6, 1.5), "share.height": (0.7, 1.4), "scene.tow_speed": (0.5, 1.7)}
_STEEPEST: Final = math.radians(70.0)
# A tool of known friction: steel with a coating of polyethylene.
_COATED: Final = 0.2
# Pressure ahead of the front at another depth.
_DEEPER: Final = 10e3


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made.

    Attributes:
        result: the result to measure, as in `Measurements`; or an unknown by itself.
        conditions: key -> value, SI; the others are at the middle of those measured.
        sigma: standard deviation of its error, in the result's SI unit; None: the relative error of the data.
        why: its name, or "" for a description.
    """

    result: str
    conditions: Mapping[str, float] = field(default_factory=dict)
    sigma: float | None = None
    why: str = ""

    def describe(self) -> str:
        """Return the measurement in words."""
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
        information: gain, ln of the ratio by which the volume of possible values shrinks.
        errors: unknown -> (standard error now, with the measurement), SI; the bounds count as knowledge.
        units: unknown -> SI unit.
    """

    candidate: Candidate
    sigma: float
    information: float
    errors: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]

    def words(self) -> str:
        """Return a sentence."""
        gains = sorted(self.errors.items(), key=lambda item: item[1][1] / item[1][0])
        largest = [
            f"{name} from ±{now:.3g} to ±{then:.3g} {self.units[name]}".rstrip()
            for name, (now, then) in gains[:3]
            if then < 0.9 * now
        ]
        return f"{self.candidate.describe()}: {'; '.join(largest) or 'hardly any gain'}"


def ranked(
    candidates: Sequence[tuple[Candidate, float, Vector]], unknowns: Sequence[Unknown], y: Vector, information: Vector
) -> tuple[NextMeasurement, ...]:
    """Return candidates by their gain of information, the best first.

    This is D-optimal, with the bounds as prior knowledge: a uniform distribution between them.

    Args:
        candidates: each with the standard deviation of its error and its derivatives by the scaled unknowns (p).
        unknowns: to be found.
        y: scaled unknowns at the fit.
        information: of the data (p, p).
    """
    now = np.linalg.inv(information + np.eye(len(unknowns)) / UNIFORM**2)
    slopes = np.array([unknown.slope(float(y[k])) for k, unknown in enumerate(unknowns)])
    before = np.sqrt(np.diag(now)) * slopes
    units = {unknown.name: unknown.unit for unknown in unknowns}
    ranking = []
    for candidate, sigma, slope in candidates:
        row = slope / sigma
        step = now @ row
        gain = float(row @ step)
        after = np.sqrt(np.maximum(np.diag(now - np.outer(step, step) / (1.0 + gain)), 0.0)) * slopes
        errors = {u.name: (float(before[k]), float(after[k])) for k, u in enumerate(unknowns)}
        ranking.append(NextMeasurement(candidate, sigma, 0.5 * math.log1p(gain), errors, units))
    return tuple(sorted(ranking, key=lambda item: -item.information))


def proposals(model: Model, measured: Sequence[Measurements], unknowns: Sequence[Unknown]) -> list[Candidate]:
    """Return candidates beside the data: other conditions, other results, and the unknowns by themselves."""
    names = {unknown.name for unknown in unknowns}
    results = [m.result for m in measured if m.result in measurable() and m.result != RECORD] or ["mean_draft"]
    candidates: list[Candidate] = []
    for result in dict.fromkeys(results):
        candidates.append(Candidate(result))
        for key, factors in _FACTORS.items():
            if key not in names and (middle := _middle(key, model, measured)):
                ends = [min(x, _STEEPEST) if key == "share.wedge_angle" else x for x in (f * middle for f in factors)]
                candidates += [Candidate(result, {key: value}) for value in ends]
        if "soil.ambient_pressure" not in names and (middle := _middle("soil.ambient_pressure", model, measured)):
            candidates.append(
                Candidate(
                    result,
                    {"soil.ambient_pressure": middle + _DEEPER},
                    why=f"{result} at an ambient pressure {_DEEPER / 1e3:g} kPa higher",
                )
            )
        if "soil.tool_friction" in names:
            why = f"{result} of a coated share, of known tool friction {_COATED:g}"
            candidates.append(Candidate(result, {"soil.tool_friction": _COATED}, why=why))
    if "loosened_radius" not in results:
        candidates.append(Candidate("loosened_radius", why="loosened_radius"))
    direct = [Candidate(u.name, sigma=_DIRECT * (u.upper - u.lower),
                        why=f"{u.name} by itself, to ±{amount(_DIRECT * (u.upper - u.lower), u.unit)}")
              for u in unknowns]  # fmt: skip
    return [*candidates, *direct]


def evaluated(
    candidates: Sequence[Candidate],
    unknowns: Sequence[Unknown],
    y: Vector,
    error: float,
    row: Callable[[Candidate], tuple[float, Vector]],
) -> list[tuple[Candidate, float, Vector]]:
    """Return candidates with standard deviation and derivatives, without those that the scene cannot have.

    Args:
        candidates: possible measurements.
        unknowns: to be found.
        y: scaled unknowns at the fit.
        error: relative standard deviation of the data.
        row: candidate -> its value and derivatives by the scaled unknowns.
    """
    names = [unknown.name for unknown in unknowns]
    rows = []
    for candidate in candidates:
        if candidate.result in names:
            k = names.index(candidate.result)
            slope = np.zeros(len(names))
            slope[k] = unknowns[k].slope(float(y[k]))
            rows.append((candidate, candidate.sigma or _DIRECT * (unknowns[k].upper - unknowns[k].lower), slope))
            continue
        try:
            value, slope = row(candidate)
        except (DomainError, InputError):
            continue
        sigma = candidate.sigma or max(error * abs(value), 1e-12 * max(1.0, abs(value)))
        rows.append((candidate, sigma, slope))
    return rows


def _middle(key: str, model: Model, measured: Sequence[Measurements]) -> float | None:
    columns = [m.conditions[key] for m in measured if key in m.conditions]
    return float(np.median(np.concatenate(columns))) if columns else model.current.get(key)


def _condition(key: str, value: float) -> str:
    return f"{key} = {amount(value, result_unit(key).symbol)}"
