"""IPOPT on the rows of requirements that can decide: of a limit at every output, those where a curve comes nearest.

A deflection that is limited at 401 outputs gives 401 rows, of which two or three decide. The optimiser is given the
nearest ones, and again with others where its design breaks one that was left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from plough_opt.design.ipopt import Point, Solver, Vector
from plough_opt.design.nlp import Nlp

# Dips of a requirement's margin over its rows that are taken, each with its neighbours on both sides, for the lowest
# output moves with the design.
_DIPS, _BESIDE = 4, 2
_OF_ONE = _DIPS * (2 * _BESIDE + 1)
_ROUNDS = 5
# Scaled violation of a row that was left out.
_BROKEN = 1e-10


class ActiveRows:
    """IPOPT on a choice of rows, built once for all choices."""

    def __init__(self, nlp: Nlp, sizes: tuple[int, int], owner: Sequence[int], limits: tuple[Vector, Vector]) -> None:
        """Take the program, its numbers of variables and parameters, each row's requirement, the limits of the rows.

        Args:
            nlp: the program.
            sizes: its numbers of variables and of parameters.
            owner: for each row the number of its requirement.
            limits: lower and upper limits of the rows.
        """
        self._nlp, self._owner, self._limits = nlp, np.array(owner), limits
        self._count = chosen_rows(owner)
        low, high = (side[: self._count] for side in limits)
        chosen = _of_rows(nlp, sizes, len(owner), self._count)
        self._solver = Solver(chosen, sizes[0], sizes[1] + self._count, low, high)

    def solve(
        self,
        start: Vector,
        p: Vector,
        lower: Vector,
        upper: Vector,
        *,
        near: bool = False,
        exact: bool | None = None,
        enough: bool = False,
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a start: see `Solver.solve`."""
        rows = self._nearest(self._margins(start, p), np.empty(0, dtype=int))
        point, y = None, start
        for _ in range(_ROUNDS):
            limits = self._limits[0][rows], self._limits[1][rows]
            found = self._solver.solve(y, np.r_[p, rows], lower, upper, limits, near=near, exact=exact, enough=enough)
            pulls = np.zeros(len(self._owner))
            pulls[rows] = found.lam_g
            point = replace(found, lam_g=pulls)
            margins = self._margins(point.y, p)
            broken = np.flatnonzero(margins < -_BROKEN)
            if not point.solved or np.all(np.isin(broken, rows)):
                return point
            rows = self._nearest(margins, rows[np.abs(found.lam_g) > 0.0][: self._count // 2])
            y = point.y
        return replace(point, solved=False, status="Rows_Not_Settled") if point else self._solver.solve(start, p)

    def _margins(self, y: Vector, p: Vector) -> Vector:
        g = np.asarray(self._nlp.values(y, p)[1]).ravel()
        return np.nan_to_num(np.minimum(g - self._limits[0], self._limits[1] - g), nan=-np.inf)

    def _nearest(self, margins: Vector, kept: np.ndarray) -> np.ndarray:
        """Return the rows to take, by their margins, some of which are kept from before."""
        score = margins.copy()
        for requirement in np.unique(self._owner):
            own = np.flatnonzero(self._owner == requirement)
            if len(own) <= _OF_ONE:
                score[own] = -np.inf
                continue
            curve = margins[own]
            dips = np.flatnonzero((curve <= np.r_[np.inf, curve[:-1]]) & (curve <= np.r_[curve[1:], np.inf]))
            for k in dips[np.argsort(curve[dips], kind="stable")[:_DIPS]]:
                beside = slice(max(0, k - _BESIDE), k + _BESIDE + 1)
                score[own[beside]] = np.minimum(score[own[beside]], curve[k] - 1e6)
        score[kept] = -np.inf
        return np.sort(np.argsort(score, kind="stable")[: self._count])


def chosen_rows(owner: Sequence[int]) -> int:
    """Return how many rows are taken of those whose requirements have these numbers."""
    counts = np.unique(np.array(owner, dtype=int), return_counts=True)[1]
    return int(np.sum(np.minimum(counts, _OF_ONE)))


def _of_rows(nlp: Nlp, sizes: tuple[int, int], rows: int, count: int) -> Nlp:
    """Return a program with a choice of another's rows, whose numbers follow its parameters."""
    y, given = ca.MX.sym("y", sizes[0]), ca.MX.sym("p", sizes[1] + count)
    p, which = given[: sizes[1]], given[sizes[1] :]

    def first() -> ca.Function:
        f, g, gradient, jacobian = nlp.slopes(y, p)
        return ca.Function("slopes", [y, given], [f, g[which], gradient, jacobian[which, :]])

    def second() -> ca.Function:
        lam_f, lam_g, every = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", count), ca.MX(ca.DM.zeros(rows))
        every.set_nz(lam_g, False, which)
        names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        return ca.Function("hess_lag", [y, given, lam_f, lam_g], [nlp.hess_lag(y, p, lam_f, every)], names, result)

    f, g = nlp.values(y, p)
    return Nlp(ca.Function("values", [y, given], [f, g[which]]), first, second)
