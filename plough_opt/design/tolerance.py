"""A design as a workshop makes it: its objective and margins over a box of tolerances around it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from plough_opt.design.declarations import Variable
from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import FEASIBLE, FINER, Landscape
from plough_opt.design.sampling import sobol_points

Judge = Literal["tolerance", "bare"]
"""By what optima are compared: the median objective over the tolerances, or the objective itself."""

NEEDLE = 0.05
"""A median this part above an optimum's own objective makes it a needle, which no workshop can hit."""

BOX_DESIGNS = 64
"""Designs that are sampled in a box."""

_SEED = 64
# Standard error of the median of so many designs, of their distance between quartiles: 1.25 sigma/sqrt(64), and sigma
# is 1/1.35 of that distance.
_OF_QUARTILES = 1.25 / np.sqrt(BOX_DESIGNS) / 1.35


@dataclass(frozen=True)
class Spread:
    """Objective and margins of a design within its tolerances, from a sample of `BOX_DESIGNS` designs.

    Attributes:
        median: of the objective, over the designs that have a value.
        worst: largest objective of them.
        margins: least margin of each requirement, positive inside, in its unit.
        kept: part of the designs that meets all requirements. Where two limits decide a design it is about a tenth: a
            design that shall keep its limits as made needs a margin.
        needle: whether the median lies more than 5 % of the objective above the design's own, or half of the designs
            have no value.
    """

    median: float
    worst: float
    margins: dict[str, float]
    kept: float
    needle: bool

    def in_words(self) -> str:
        """Say what becomes of the design."""
        kept = f"; {100.0 * self.kept:.0f} % of the designs keep all requirements" if self.margins else ""
        return (
            f"As it is made, within the tolerances: objective {self.median:.6g} in the middle of the cases,"
            f" {self.worst:.6g} at worst{kept}."
        )


def boxes(variables: Sequence[Variable], points: Vector) -> Vector:
    """Return the designs of the boxes around scaled designs, one box after the other."""
    unit = unit_box(len(variables))
    found = np.empty((len(points), BOX_DESIGNS, len(variables)))
    for k, v in enumerate(variables):
        low, high = v.tolerance_interval(points[:, k, None])
        found[:, :, k] = low + (high - low) * unit[:, k]
    return found.reshape(-1, len(variables))


def ranking_criterion(landscape: Landscape, judge: Judge) -> Callable[[Vector], Vector]:
    """Return what gives the scaled value by which designs, a row each, are compared."""

    def bare(points: Vector) -> Vector:
        return landscape(points).merit

    def over_tolerances(points: Vector) -> Vector:
        if not len(points):
            return np.empty(0)
        median: Vector = np.median(_objectives(landscape, points), axis=1)
        return median

    # What is asked of the whole box needs no further box around it.
    several = landscape.program.bare is None and landscape.vectorised
    return over_tolerances if judge == "tolerance" and several else bare


def ranked(landscape: Landscape, judge: Judge, points: Vector) -> list[int]:
    """Return designs, a row each, in the order in which they are best.

    Medians of samples differ by chance: designs whose medians 64 designs cannot tell apart are compared by their own
    objectives, needles excepted.
    """
    if len(points) == 1:
        return [0]
    own = landscape(points, finer=FINER).f
    if judge == "bare" or not landscape.vectorised:
        return [int(k) for k in np.argsort(own, kind="stable")]
    low, median, high = np.quantile(_objectives(landscape, points, FINER), (0.25, 0.5, 0.75), axis=1, method="higher")
    error = _OF_QUARTILES * np.where(np.isfinite(high), high - low, np.inf)
    best = int(np.argmin(median))
    broad = median <= (1.0 + NEEDLE) * np.abs(own)
    with np.errstate(invalid="ignore"):
        equal = broad & (median - median[best] <= 2.0 * np.hypot(error, error[best]))
    equal[best] = True
    return sorted(range(len(points)), key=lambda k: (not equal[k], own[k] if equal[k] else median[k]))


def _objectives(landscape: Landscape, points: Vector, finer: float = 1.0) -> Vector:
    """Return the objectives over the boxes around designs, a row for each box; infinite without a value."""
    f = landscape(boxes(landscape.program.declared.variables, points), finer=finer).f
    return np.where(np.isnan(f), np.inf, f).reshape(len(points), -1)


def spread(landscape: Landscape, y: Vector, objective: float) -> Spread | None:
    """Return what becomes of a scaled design within its tolerances; None where that takes too long to look at.

    Args:
        landscape: of the design.
        y: the design.
        objective: its own.
    """
    if not landscape.vectorised:
        return None
    landscape = landscape.of_single_design()
    program = landscape.program
    y = y[: len(program.declared.variables)]
    _, f, g = landscape.rows_after_elimination(boxes(program.declared.variables, y[None]), finer=FINER)
    sound = np.isfinite(f)
    values = f[sound] * landscape.objective_scale if np.any(sound) else np.array([objective])
    median = float(np.median(values))
    margins = np.minimum(g - program.low, program.high - g)[sound] if np.any(sound) else np.zeros((1, len(program.low)))
    least = np.array([margins[:, np.array(program.owner) == k].min() for k in range(len(program.scales))])
    return Spread(
        median=median,
        worst=float(values.max()),
        margins={
            r.name: float(margin * scale)
            for r, margin, scale in zip(program.declared.requirements, least, program.scales, strict=True)
        },
        kept=float(np.mean(landscape.violations(g).sum(axis=1) <= FEASIBLE)),
        needle=bool(median - objective > NEEDLE * abs(objective) or 2 * np.sum(sound) < len(sound)),
    )


@lru_cache(maxsize=16)
def unit_box(n: int) -> Vector:
    """Return the designs of a box between 0 and 1, a row each; the first of them, a power of two, are even too."""
    return sobol_points(n, BOX_DESIGNS, np.random.default_rng(_SEED))
