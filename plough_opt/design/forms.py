"""Variants of a program: in machine code, restricted to rows that can be active, and with relaxed requirements."""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from plough_opt.core.compiler import Variant, library
from plough_opt.design.ipopt import Point, SolveOptions, Solver, Vector
from plough_opt.design.nlp import Nlp, hessian_function
from plough_opt.design.optimality import lowest_dips

# -freciprocal-math takes the reciprocal of a frequent divisor, such as the inertia, only once.
_FAST = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-freciprocal-math")
_VARIANTS: tuple[Variant, ...] = ((_FAST, ("-lm",)), (("-O1",), ("-lm",)))


def as_machine_code(nlp: Nlp) -> Nlp | None:
    """Return a program with values and first derivatives in machine code, or None without a compiler.

    Second derivatives stay interpreted: few solves need them, and they take a compiler longest.
    """
    functions = {"own_values": nlp.values, "own_slopes": nlp.slopes}
    generator = ca.CodeGenerator("design.c")
    for name, function in functions.items():
        generator.add(_named(function, name))
    path = library(generator.dump(), _VARIANTS)
    if path is None:
        return None
    values, slopes = (ca.external(name, str(path)) for name in functions)
    return replace(nlp, values=values, build_slopes=lambda: slopes)


def _named(function: ca.Function, name: str) -> ca.Function:
    inputs = function.mx_in()
    return ca.Function(name, inputs, function.call(inputs))


# For a requirement with many rows, the program keeps the rows around this many local minima of its margin.
_DIPS = 4
# Rows kept on both sides of each minimum, because the minimum moves with the design.
_BESIDE = 2
_MOST_ROWS = _DIPS * (2 * _BESIDE + 1)
# Choices of rows that are tried until a solution keeps all other rows.
_MOST_CHOICES = 5
# Scaled violation above which an omitted row is broken.
_BROKEN = 1e-10
# Lowers the score of a chosen row below that of every row that was not chosen; margins are of order 1.
_CHOSEN = 1e6


class ActiveRows:
    """IPOPT on those rows of the requirements that can be active, built once for all choices of rows.

    A deflection that is limited at 401 outputs gives 401 rows, of which two or three are active. The solver gets the
    rows where the curve comes nearest to its limit. If its solution breaks an omitted row, the rows are chosen anew.
    """

    def __init__(self, nlp: Nlp, owner: Sequence[int], limits: tuple[Vector, Vector]) -> None:
        """Build the program with as many rows as a choice has.

        Args:
            nlp: the program with all rows.
            owner: for each row, the number of its requirement.
            limits: lower and upper limits of the rows.
        """
        self._nlp, self._owner, self._limits = nlp, np.array(owner), limits
        self._count = chosen_rows(owner)
        self._solver = Solver(_of_rows(nlp, self._count), *(side[: self._count] for side in limits))

    def solve(self, start: Vector, p: Vector, lower: Vector, upper: Vector, options: SolveOptions) -> Point:
        """Return the local optimum that IPOPT reaches from a start: see `Solver.solve`."""
        rows = self._nearest(self._margins(start, p), np.empty(0, dtype=int))
        y = start
        for _ in range(_MOST_CHOICES):
            limits = self._limits[0][rows], self._limits[1][rows]
            found = self._solver.solve(y, np.r_[p, rows], lower, upper, options, limits)
            lam_g = np.zeros(len(self._owner))
            lam_g[rows] = found.lam_g
            point, y = replace(found, lam_g=lam_g), found.y
            margins = self._margins(y, p)
            broken = np.flatnonzero(margins < -_BROKEN)
            if not point.solved or np.all(np.isin(broken, rows)):
                return point
            rows = self._nearest(margins, rows[np.abs(found.lam_g) > 0.0][: self._count // 2])
        return replace(point, solved=False, status="Rows_Not_Settled")

    def _margins(self, y: Vector, p: Vector) -> Vector:
        g = np.asarray(self._nlp.values(y, p)[1]).ravel()
        return np.nan_to_num(np.minimum(g - self._limits[0], self._limits[1] - g), nan=-np.inf)

    def _nearest(self, margins: Vector, kept: np.ndarray) -> np.ndarray:
        """Return the numbers of the rows to solve with.

        Args:
            margins: margin of every row.
            kept: rows that must be among them, because they were active before.
        """
        score = margins.copy()
        for requirement in np.unique(self._owner):
            own = np.flatnonzero(self._owner == requirement)
            if len(own) <= _MOST_ROWS:
                score[own] = -np.inf
                continue
            curve = margins[own]
            for k in lowest_dips(curve, _DIPS):
                beside = slice(max(0, k - _BESIDE), k + _BESIDE + 1)
                score[own[beside]] = np.minimum(score[own[beside]], curve[k] - _CHOSEN)
        score[kept] = -np.inf
        return np.sort(np.argsort(score, kind="stable")[: self._count])


def chosen_rows(owner: Sequence[int]) -> int:
    """Return the number of rows that `ActiveRows` solves with; ``owner`` has the requirement's number of each row."""
    counts = np.unique(np.array(owner, dtype=int), return_counts=True)[1]
    return int(np.sum(np.minimum(counts, _MOST_ROWS)))


def _of_rows(nlp: Nlp, count: int) -> Nlp:
    """Return a program with ``count`` rows of another; their numbers are further parameters, after its own."""
    y, own = nlp.values.mx_in()
    given = ca.MX.sym("p", own.numel() + count)
    p, which = ca.vertsplit(given, [0, own.numel(), given.numel()])

    def build_slopes() -> ca.Function:
        f, g, gradient, jacobian = nlp.slopes(y, p)
        return ca.Function("slopes", [y, given], [f, g[which], gradient, jacobian[which, :]])

    def build_hessian() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", count)
        lam_all = ca.MX(ca.DM.zeros(nlp.values.numel_out(1)))
        lam_all.set_nz(lam_g, False, which)
        return hessian_function(y, given, lam_f, lam_g, nlp.hess_lag(y, p, lam_f, lam_all))

    f, g = nlp.values(y, p)
    return Nlp(ca.Function("values", [y, given], [f, g[which]]), build_slopes, build_hessian)


def relaxed(nlp: Nlp, owner: Sequence[int]) -> Nlp:
    """Return the program that minimises the sum of the requirements' violations.

    Args:
        nlp: the program.
        owner: for each row, the number of its requirement; every requirement has at least one row.

    Returns:
        A program in x = (y, s, t) with slacks s, t >= 0 of each requirement: minimise the sum of s and t subject to
        low <= g(y) + s - t <= high, with the exact derivatives of ``nlp``.
    """
    count = len(set(owner))
    spread = np.eye(count)[list(owner)]
    slack_rows = ca.sparsify(ca.DM(np.hstack([spread, -spread])))
    own, p = nlp.values.mx_in()
    x = ca.MX.sym("x", own.numel() + 2 * count)
    y, slack = ca.vertsplit(x, [0, own.numel(), x.numel()])
    f, loose = ca.sum1(slack), ca.mtimes(slack_rows, slack)

    def build_slopes() -> ca.Function:
        _, g, _, jacobian = nlp.slopes(y, p)
        gradient = ca.DM(np.r_[np.zeros(own.numel()), np.ones(2 * count)])
        return ca.Function("slopes", [x, p], [f, g + loose, gradient, ca.horzcat(jacobian, slack_rows)])

    def build_hessian() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(owner))
        return hessian_function(
            x, p, lam_f, lam_g, ca.diagcat(nlp.hess_lag(y, p, 0.0, lam_g), ca.MX(2 * count, 2 * count))
        )

    return Nlp(ca.Function("values", [x, p], [f, nlp.values(y, p)[1] + loose]), build_slopes, build_hessian)


def first_slack(g: Vector, limits: tuple[Vector, Vector], owner: Sequence[int]) -> Vector:
    """Return the least slacks (s, t) of `relaxed` that make a start feasible.

    Args:
        g: rows of the requirements at the start.
        limits: lower and upper limits of the rows.
        owner: for each row, the number of its requirement.
    """
    count = len(set(owner))
    slack = np.zeros(2 * count)
    np.maximum.at(slack[:count], owner, limits[0] - g)
    np.maximum.at(slack[count:], owner, g - limits[1])
    return slack
