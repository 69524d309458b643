"""Which requirements conflict, and by how much: the same program with every requirement allowed to give way."""

from __future__ import annotations

import casadi as ca
import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.nlp import Nlp


def relaxed(nlp: Nlp, variables: int, parameters: int, owner: list[int], count: int) -> Nlp:
    """Return the program that minimises how far requirements give way.

    Args:
        nlp: the program.
        variables: number of scaled variables y.
        parameters: number of parameters.
        owner: for each scaled constraint, the number of its requirement.
        count: number of requirements.

    Returns:
        A program in (y, s, t) with s, t >= 0 for each requirement: minimise the sum of s and t subject to
        low <= g(y) + s - t <= high, with the exact derivatives of ``nlp``.
    """
    spread = ca.DM(len(owner), count)
    for row, requirement in enumerate(owner):
        spread[row, requirement] = 1.0
    give = ca.horzcat(spread, -spread)
    x, p = ca.MX.sym("x", variables + 2 * count), ca.MX.sym("p", parameters)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(owner))
    y, slack = x[:variables], x[variables:]
    f = ca.sum1(slack)
    loose = ca.mtimes(give, slack)

    def first() -> ca.Function:
        _, g, _, jacobian = nlp.slopes(y, p)
        gradient = ca.MX(ca.DM(np.r_[np.zeros(variables), np.ones(2 * count)]))
        return ca.Function("slopes", [x, p], [f, g + loose, gradient, ca.horzcat(jacobian, give)])

    def second() -> ca.Function:
        whole = ca.diagcat(nlp.hess_lag(y, p, 0.0, lam_g), ca.MX(2 * count, 2 * count))
        names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        return ca.Function("hess_lag", [x, p, lam_f, lam_g], [ca.triu(whole)], names, result)

    return Nlp(ca.Function("values", [x, p], [f, nlp.values(y, p)[1] + loose]), first, second)


def first_slack(g: Vector, low: Vector, high: Vector, owner: list[int], count: int) -> Vector:
    """Return slacks that make a start feasible: the largest violation of each requirement, either way."""
    slack = np.zeros(2 * count)
    for value, least, most, requirement in zip(g, low, high, owner, strict=True):
        slack[requirement] = max(slack[requirement], least - value)
        slack[count + requirement] = max(slack[count + requirement], value - most)
    return slack
