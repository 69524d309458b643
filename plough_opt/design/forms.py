"""Variants of a program: in machine code, and with relaxed requirements."""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from plough_opt.core.compiler import Variant, library
from plough_opt.design.ipopt import Vector
from plough_opt.design.nlp import Nlp, hessian_function

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
    path = library(generator.dump(), _VARIANTS, tuple(functions))
    if path is None:
        return None
    values, slopes = (ca.external(name, str(path)) for name in functions)
    return replace(nlp, values=values, build_slopes=lambda: slopes)


def _named(function: ca.Function, name: str) -> ca.Function:
    inputs = function.mx_in()
    return ca.Function(name, inputs, function.call(inputs))


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
    """Return the least slacks (s, t) of `relaxed` that make a start feasible; 0 where a row has no value there.

    Args:
        g: rows of the requirements at the start.
        limits: lower and upper limits of the rows.
        owner: for each row, the number of its requirement.
    """
    count = len(set(owner))
    slack = np.zeros(2 * count)
    np.fmax.at(slack[:count], owner, limits[0] - g)
    np.fmax.at(slack[count:], owner, g - limits[1])
    return slack
