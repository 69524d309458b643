"""Objective and margins over the tolerance box around a design, that is, of the share as a workshop makes it."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plough_opt.design.declarations import Variable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.search.landscape import FEASIBLE, FINER, NEEDLE, Landscape
from plough_opt.design.search.points import sobol_points

Judge = Literal["tolerance", "bare"]
"""What optima are ranked by: the median objective over the tolerance box, or the objective itself."""

# That quarter: near an objective of 0 a fraction of it would mean nothing.
_SMALL_OBJECTIVE = 0.25

BOX_DESIGNS = 64
"""Number of designs sampled in a tolerance box."""

_SEED = 64
# Standard error of the median of 64 designs in units of the interquartile range: 1.25 sigma/sqrt(64) for a normal
# distribution, whose interquartile range is 1.35 sigma.
_MEDIAN_ERROR = 1.25 / np.sqrt(BOX_DESIGNS) / 1.35


@dataclass(frozen=True)
class Spread:
    """Objective and margins of a design within its tolerances, from a sample of `BOX_DESIGNS` designs.

    Attributes:
        median: median objective of the designs that can be evaluated.
        worst: largest objective of these.
        margins: smallest margin of each requirement in the sample and at corners of the box (all of them with up to six
            variables), positive if met, in its unit.
        kept: fraction of the designs that meet all requirements. It is about a tenth if two limits are active: a share
            that must meet its limits as made needs a margin.
        needle: whether the median exceeds the design's own objective by more than 5 % (of a quarter of its median size
            between the bounds if it is smaller than that), or half of the designs cannot be evaluated.
    """

    median: float
    worst: float
    margins: dict[str, float]
    kept: float
    needle: bool

    def in_words(self) -> str:
        """Return a sentence about the design as made."""
        kept = f"; {100.0 * self.kept:.0f} % of the designs meet all requirements" if self.margins else ""
        return f"As made, within the tolerances: median objective {self.median:.6g}, worst {self.worst:.6g}{kept}."


def boxes(variables: Sequence[Variable], points: Vector, unit: Vector | None = None) -> Vector:
    """Return the sampled designs of the tolerance boxes around scaled designs, box after box.

    Args:
        variables: of the design.
        points: scaled designs, a row each.
        unit: designs in the unit box, a row each (default: `unit_box`).
    """
    unit = unit_box(len(variables)) if unit is None else unit
    found = np.empty((len(points), len(unit), len(variables)))
    for k, v in enumerate(variables):
        low, high = v.tolerance_interval(points[:, k, None])
        found[:, :, k] = low + (high - low) * unit[:, k]
    return found.reshape(-1, len(variables))


def ranking_criterion(landscape: Landscape, judge: Judge) -> Callable[[Vector], Vector]:
    """Return the function from designs, a row each, to the values by which they are ranked, in units of the merit."""

    def bare(points: Vector) -> Vector:
        return landscape(points).merit

    def over_tolerances(points: Vector) -> Vector:
        median: Vector = np.median(_objectives(landscape, points), axis=1)
        return median

    # A program over a whole tolerance box accounts for the tolerances already.
    samples_boxes = landscape.program.bare is None and landscape.vectorised
    return over_tolerances if judge == "tolerance" and samples_boxes else bare


def ranked(landscape: Landscape, judge: Judge, points: Vector) -> list[int]:
    """Return the numbers of designs, a row each, best first.

    Sample medians differ by chance. Designs whose medians cannot be distinguished from the best one's with 64 samples
    are ranked by their own objectives, unless they are needles.
    """
    if len(points) == 1:
        return [0]
    own = landscape(points, finer=FINER).f
    # A program over a whole tolerance box accounts for the tolerances already.
    if judge == "bare" or not landscape.vectorised or landscape.program.bare is not None:
        return [int(k) for k in np.argsort(own, kind="stable")]
    low, median, high = np.quantile(_objectives(landscape, points, FINER), (0.25, 0.5, 0.75), axis=1, method="higher")
    error = _MEDIAN_ERROR * np.where(np.isfinite(high), high - low, np.inf)
    best = int(np.argmin(median))
    broad = ~_too_high(landscape, median, own)
    with np.errstate(invalid="ignore"):
        equal = broad & (median - median[best] <= 2.0 * np.hypot(error, error[best]))
    equal[best] = True
    return sorted(range(len(points)), key=lambda k: (not equal[k], own[k] if equal[k] else median[k]))


def _objectives(landscape: Landscape, points: Vector, finer: float = 1.0) -> Vector:
    """Return the objectives in the boxes around designs, a row for each box; infinite where not evaluable."""
    f = _as_made(landscape)(boxes(landscape.program.declared.variables, points), finer=finer).f
    return np.where(np.isnan(f), np.inf, f).reshape(len(points), -1)


def _as_made(landscape: Landscape) -> Landscape:
    """Return the landscape of made designs: a workshop does not choose a made dimension again.

    Only a variable without a declared tolerance, such as a bound on a peak, is solved for in each of them.
    """
    made = [k for k, v in enumerate(landscape.program.declared.variables) if v.tolerance is not None]
    if {variable.number for variable in landscape.eliminated}.isdisjoint(made):
        return landscape
    return Landscape(landscape.program, landscape.p, sorted({*landscape.held, *made}))


def spread(landscape: Landscape, y: Vector, objective: float) -> Spread | None:
    """Return the spread of a scaled design within its tolerances; None if runs are integrated one by one.

    Args:
        landscape: of the design, or of its tolerance box.
        y: the scaled design.
        objective: the design's own objective, in its unit.
    """
    if not landscape.vectorised:
        return None
    if (bare := landscape.program.bare) is not None:
        program = bare.at(landscape.p, any_guess=True)
        landscape = Landscape(program, landscape.p, range(len(program.declared.variables)))
    landscape, y = _as_made(landscape), y[: landscape.dimensions]
    program = landscape.program
    n = len(program.declared.variables)
    designs = boxes(program.declared.variables, y[None], np.vstack([unit_box(n), corners(n, BOX_DESIGNS)]))
    _, f, g = landscape.rows_after_elimination(designs, finer=FINER)
    everywhere, g_everywhere, f, g = np.isfinite(f), g, f[:BOX_DESIGNS], g[:BOX_DESIGNS]
    valid = np.isfinite(f)
    scale = landscape.objective_scale
    values = f[valid] * scale if np.any(valid) else np.array([objective])
    median = float(np.median(values))
    too_high = _too_high(landscape, np.array([median / scale]), np.array([objective / scale]))
    margins = program.least_margins(g_everywhere)[everywhere]
    least = margins.min(axis=0) if np.any(everywhere) else np.zeros(len(program.scales))
    return Spread(
        median=median,
        worst=float(values.max()),
        margins={
            r.name: float(margin * scale)
            for r, margin, scale in zip(program.declared.requirements, least, program.scales, strict=True)
        },
        kept=float(np.mean(landscape.violations(g).sum(axis=1) <= FEASIBLE)),
        needle=bool(too_high[0] or 2 * np.sum(valid) < len(valid)),
    )


def _too_high(landscape: Landscape, median: Vector, own: Vector) -> NDArray[np.bool_]:
    """Return for each design whether the median over its tolerances is a needle's; both in units of the merit."""
    with np.errstate(all="ignore"):
        everywhere = landscape.program.population(unit_box(landscape.dimensions), landscape.p)[0]
    sizes = np.abs(everywhere[np.isfinite(everywhere)]) / landscape.objective_scale
    typical = float(np.median(sizes)) if len(sizes) else 0.0
    found: NDArray[np.bool_] = median - own > NEEDLE * np.maximum(np.abs(own), _SMALL_OBJECTIVE * typical)
    return found


def corners(n: int, most: int) -> Vector:
    """Return the corners of the unit box, a row each; of more than ``most``, only those nearest to a sample."""
    if n < most.bit_length():
        return np.array([*itertools.product((0.0, 1.0), repeat=n)])
    return np.unique(np.round(unit_box(n)[:most]), axis=0)


@lru_cache(maxsize=16)
def unit_box(n: int) -> Vector:
    """Return the designs sampled in the unit box, a row each. The first 2^k of them are evenly spread, too."""
    return sobol_points(n, BOX_DESIGNS, np.random.default_rng(_SEED))
