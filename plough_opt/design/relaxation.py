"""Which requirements conflict, and by how much: the same program with every requirement allowed to give way."""

import casadi as ca
import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.nlp import Nlp, hessian_function


def relaxed(nlp: Nlp, owner: list[int], count: int) -> Nlp:
    """Return the program that minimises how far requirements give way.

    Args:
        nlp: the program.
        owner: for each scaled constraint, the number of its requirement.
        count: number of requirements.

    Returns:
        A program in (y, s, t) with s, t >= 0 for each requirement: minimise the sum of s and t subject to
        low <= g(y) + s - t <= high, with the exact derivatives of ``nlp``.
    """
    spread = np.eye(count)[owner]
    give = ca.sparsify(ca.DM(np.hstack([spread, -spread])))
    own, p = nlp.values.mx_in()
    x = ca.MX.sym("x", own.numel() + 2 * count)
    y, slack = ca.vertsplit(x, [0, own.numel(), x.numel()])
    f, loose = ca.sum1(slack), ca.mtimes(give, slack)

    def build_slopes() -> ca.Function:
        _, g, _, jacobian = nlp.slopes(y, p)
        gradient = ca.DM(np.r_[np.zeros(own.numel()), np.ones(2 * count)])
        return ca.Function("slopes", [x, p], [f, g + loose, gradient, ca.horzcat(jacobian, give)])

    def build_hessian() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(owner))
        return hessian_function(
            x, p, lam_f, lam_g, ca.diagcat(nlp.hess_lag(y, p, 0.0, lam_g), ca.MX(2 * count, 2 * count))
        )

    return Nlp(ca.Function("values", [x, p], [f, nlp.values(y, p)[1] + loose]), build_slopes, build_hessian)


def first_slack(g: Vector, low: Vector, high: Vector, owner: list[int], count: int) -> Vector:
    """Return slacks that make a start feasible: the largest violation of each requirement, either way."""
    slack = np.zeros(2 * count)
    np.maximum.at(slack[:count], owner, low - g)
    np.maximum.at(slack[count:], owner, g - high)
    return slack
