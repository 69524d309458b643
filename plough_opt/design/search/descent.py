"""The descent of a search: quadratic programs whose derivatives come from designs integrated side by side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.optimality import (
    Zero,
    curvature_of,
    difference_quotients,
    free_directions,
    lagrangian,
    lowest_dips,
    optimum_step,
    reduced_curvatures,
    relaxed_step,
)
from plough_opt.design.search.landscape import FINER, Evaluations, Landscape, Violation

Box = tuple[Vector | float, Vector | float]
"""Lower and upper bounds of scaled variables."""

LONGEST = 0.3
"""Longest move of a variable, as far as the quadratic programs of a multimodal landscape mean anything."""


# A descent ends when a step is shorter than this, or lowers the merit by less than this fraction: along a flat
# valley IPOPT goes on.
_SHORTEST: Final = 1e-7
# Fractions of a step that are tried side by side. Steps where curvatures are negative are too short; therefore
# these parts of the longest step are tried, too, along the direction of the most negative curvature. From a place
# between two ripples quadratic programs lead to the wide one, and a search of eight variables misses the narrow
# one.
_FRACTIONS: Final = np.array([0.0, 1.0, 4.0, 2.0, 0.7, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01, 0.003, 0.0005])
# A requirement with more rows, such as a deflection at every output, enters with its worst rows only.
_MOST_ROWS: Final = 6


def descend(
    landscape: Landscape,
    start: Vector,
    box: Box = (0.0, 1.0),
    *,
    longest: float = LONGEST,
    objective: Callable[[Vector], Vector] | None = None,
) -> Evaluations:
    """Return the best design on the way of a descent from a scaled start; never worse than the start.

    If runs are integrated one by one, a descent takes too long and the start is returned.

    Args:
        landscape: the landscape.
        start: scaled variables.
        box: their bounds.
        longest: longest move of a variable. A short one keeps the descent in the basin of its start.
        objective: scaled designs, a row each -> what to minimise in place of the landscape's objective.
    """
    start = np.clip(start, *box)
    if not landscape.vectorised:
        return landscape(start[None])
    return _Descent(landscape, box, longest, objective).end_from(start)


class _Descent:
    """Quadratic programs, whose limits give way by a slack where they contradict each other.

    Of the fractions of each step, which are integrated side by side, the one with the lowest merit is taken.
    """

    def __init__(
        self, landscape: Landscape, box: Box, longest: float, objective: Callable[[Vector], Vector] | None
    ) -> None:
        self._landscape, self._program, self._box = landscape, landscape.program, box
        self._longest, self._objective = longest, objective
        self._owner = np.array(self._program.owner, dtype=int)
        self._fractions = _FRACTIONS if longest == LONGEST else _FRACTIONS[_FRACTIONS <= 1.0]
        # The best design so far: whether it is infeasible, its merit, and its variables.
        self._best: tuple[bool, float, list[float]] | None = None

    def end_from(self, start: Vector) -> Evaluations:
        y, lam_g, rows, weight, reach = start, np.zeros(len(self._owner)), np.empty(0, dtype=int), 1.0, 1.0
        for number in range(25):
            derivatives = difference_quotients(self._values, y, reach)
            if derivatives is None:
                break
            rows = np.union1d(rows, self._worst_rows(derivatives[0][1:]))
            # The curvature depends on the multipliers that the first step yields.
            moves, lam_g[rows] = self._moves(y, derivatives, rows, lam_g[rows], 1 if number else 3, reach)
            if np.max(np.abs(moves[1])) < reach * _SHORTEST:
                break
            # Above the largest multiplier no optimum breaks a limit.
            weight = max(0.5 * weight, 2.0 * float(np.max(np.abs(lam_g), initial=0.0)))
            line = np.clip(y + moves, *self._box)
            merit = self._merits(line, weight)
            lowest, least_gain = int(np.nanargmin(merit)), _SHORTEST * abs(merit[0])
            if merit[lowest] < merit[0] - least_gain:
                y = line[lowest]
            elif merit[1] <= merit[0] + least_gain or reach < 1e-4:
                break
            else:
                # If even the whole step leads up and no fraction down, there is a kink nearby, across which quotients
                # show no slope: they are formed over this part of the distance, and so is the longest step, until it is
                # this part of the first. Over much less a run's rounding (about 1e-13) would drown the slopes.
                reach *= 0.03
        return self._landscape(np.array([start if self._best is None else self._best[2]]), finer=FINER)

    def _values(self, designs: Vector) -> tuple[Vector, Vector]:
        """Return what to minimise, and the requirements, of designs that are integrated with equal steps."""
        f, g = self._landscape.valued(designs, finer=FINER, together=len(designs))
        return (f if self._objective is None else np.where(np.isnan(f), f, self._objective(designs))), g

    def _merits(self, designs: Vector, weight: float) -> Vector:
        """Return what to minimise plus weighted violations, of designs with equal steps; the best of them is kept.

        The neighbours that only yield quotients are not kept: the best of them would move a start off a hilltop, to the
        side on which they happen to lie.
        """
        f, g = self._values(designs)
        violation = self._landscape.violations(g).sum(axis=1)
        feasible = violation <= Violation.allowed
        with np.errstate(invalid="ignore"):
            # Weight of a violation within the feasibility tolerance: the objective must not exploit the tolerance.
            merit = f + np.where(feasible, 1e4, Violation.weight) * violation
        merit[~np.isfinite(merit)] = np.inf
        k = np.lexsort((merit, ~feasible))[0]
        if np.isfinite(merit[k]):
            key = not feasible[k], float(merit[k]), designs[k].tolist()
            self._best = key if self._best is None else min(self._best, key)
        return np.asarray(f + weight * violation)

    def _moves(
        self, y: Vector, derivatives: tuple[Vector, ...], rows: np.ndarray, lam_g: Vector, rounds: int, reach: float
    ) -> tuple[Vector, Vector]:
        """Return the moves to try, a row each, and the multipliers of some rows of the requirements.

        The moves are fractions of the step of a quadratic program subject to these rows, and any along the direction of
        the most negative curvature.
        """
        (_, *g), (gradient, *jacobian), hessians = (part[np.r_[0, 1 + rows]] for part in derivatives)
        # A steep objective, as one that is scaled by a value near 0, would drown the limits in rounding.
        size = max(1.0, float(np.max(np.abs(gradient))))
        hessians[0] /= size
        at = np.array(g), gradient / size, np.reshape(jacobian, (len(rows), len(y)))
        limits, longest = (self._program.low[rows], self._program.high[rows]), reach * self._longest
        box = np.maximum(self._box[0], y - longest), np.minimum(self._box[1], y + longest)
        step, lam_g, lam_y = np.zeros(len(y)), lam_g / size, np.zeros(len(y))
        for _ in range(rounds):
            curvature = curvature_of(hessians, lam_g)
            found = optimum_step(curvature, y, at, limits, box=box)
            found = found or relaxed_step(curvature, y, at, limits, box, self._owner[rows], Violation.weight)
            if found is None:
                break
            step, lam_g, lam_y = found
        moves = self._fractions[:, None] * step
        bent = lagrangian(hessians, lam_g)
        if np.linalg.eigvalsh(bent)[0] >= 0.0:
            return moves, lam_g * size
        held = (np.abs(lam_y) > Zero.multiplier) & (np.abs(step) < longest)
        free = free_directions(np.vstack([at[2][np.abs(lam_g) > Zero.multiplier], np.eye(len(y))[held]]))
        curvatures, directions = reduced_curvatures(bent, free)
        # A curvature counts as negative below this, relative to the largest: quotients are not more accurate. A slope
        # below this part of what the curvature adds over the longest step does not show the lower side: both are tried.
        if np.any(curvatures < -1e-4):
            aside = directions[:, 0] / np.max(np.abs(directions[:, 0]))
            slope = gradient @ aside
            farther = 0.5 ** np.arange(12.0)[:, None] * -np.copysign(longest, slope) * aside
            level = abs(slope) < 1e-3 * abs(curvatures[0]) * longest
            moves = np.vstack([moves, farther, *([-farther] if level else [])])
        return moves, lam_g * size

    def _worst_rows(self, g: Vector) -> np.ndarray:
        """Return the rows nearest to their limits: of a curve over time each dip of its margin can become active."""
        margin, chosen = self._program.margins(g), [np.empty(0, dtype=int)]
        for rows in np.split(np.arange(len(g)), self._program.first_rows[1:]) if len(g) else ():
            few = len(rows) <= _MOST_ROWS
            chosen.append(rows if few else rows[lowest_dips(margin[rows], _MOST_ROWS)])
        return np.concatenate(chosen)
