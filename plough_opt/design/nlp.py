"""The nonlinear program of a design, with exact first and second derivatives.

A run enters it by its Taylor coefficients (`plough_opt.motion.jets`), the algebra around the runs by automatic
differentiation of a small scalar graph; the chain rule joins the two. With o(theta(y)) the runs' results::

    grad f = J_y + J_o o_y,   o_y = o_theta theta_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where z = (y, o), S = dz/dy, mu = L_o and c = mu' o_theta. The results o of all runs are one column, and so are the
varying parameters theta, both in the order of the `RunGroup` s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.design.run_groups import RunGroup, grouped
from plough_opt.design.split import EmbeddedRun, Split
from plough_opt.motion.signals import signals


@dataclass(frozen=True)
class Nlp:
    """Functions of scaled variables y and parameters p; derivatives, which take time to build, once they are needed.

    Attributes:
        values: (y, p) -> (scaled objective f, scaled requirements g), from one integration of each run.
        build_slopes: returns `slopes`.
        build_hessian: returns `hess_lag`, which takes longest.
        groups: the runs, as they are integrated.
    """

    values: ca.Function
    build_slopes: Callable[[], ca.Function]
    build_hessian: Callable[[], ca.Function]
    groups: tuple[RunGroup, ...] = ()

    @cached_property
    def slopes(self) -> ca.Function:
        """(y, p) -> (f, g, gradient of f as a column, Jacobian of g), from one integration of each run."""
        return self.build_slopes()

    @cached_property
    def hess_lag(self) -> ca.Function:
        """(y, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g."""
        return self.build_hessian()


def as_ipopt_wants(values: ca.Function, slopes: ca.Function) -> dict[str, ca.Function]:
    """Return `Nlp.values` and `Nlp.slopes` one by one, with the names that CasADi's interface to IPOPT asks for."""
    y, p = slopes.mx_in()
    f, g = values(y, p)
    again_f, again_g, gradient, jacobian = slopes(y, p)
    results = {
        "f": {"f": f},
        "g": {"g": g},
        "grad_f": {"f": again_f, "grad_f_x": gradient},
        "jac_g": {"g": again_g, "jac_g_x": jacobian},
    }
    return {name: ca.Function(name, [y, p], list(own.values()), ["x", "p"], list(own)) for name, own in results.items()}


def hessian_function(y: ca.MX, p: ca.MX, lam_f: ca.MX, lam_g: ca.MX, hessian: ca.MX) -> ca.Function:
    """Return `Nlp.hess_lag` of a Hessian, of which the upper triangle is taken."""
    names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    return ca.Function("hess_lag", [y, p, lam_f, lam_g], [ca.triu(hessian)], names, result)


def build_nlp(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> Nlp:
    """Assemble the program of an objective and requirements.

    Args:
        parts: objective (first) and requirements (second, a column), split around their runs.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
    """
    groups = run_groups(parts, y, p, steps)
    algebra = _Algebra.around(groups, parts, y, p)
    results = _column([ca.vec(group.value(group.inputs(y, p))) for group in groups])
    f, g = map(ca.densify, algebra.values(y, p, results))

    def build_slopes() -> ca.Function:
        return ca.Function("slopes", [y, p], _first_derivatives(algebra, groups, y, p))

    def build_hessian() -> ca.Function:
        multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        return hessian_function(y, p, *multipliers, _hessian(algebra, groups, (y, p), multipliers))

    return Nlp(ca.Function("values", [y, p], [f, g]), build_slopes, build_hessian, tuple(groups))


def run_groups(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> list[RunGroup]:
    """Return the runs of the program that `build_nlp` would assemble."""
    whole = algebra_of(parts, y, p)
    return grouped(parts.runs, [averages_only(run, whole, 2 + k) for k, run in enumerate(parts.runs)], y, p, steps)


def algebra_of(parts: Split, y: ca.MX, p: ca.MX) -> ca.Function:
    """Return (y, p, results of each run) -> expressions, in scalar operations unless these would be too many."""
    whole = ca.Function("whole", [y, p, *parts.results], list(parts.expressions))
    return whole if holds_maps(whole) else whole.expand()


def averages_only(run: EmbeddedRun, algebra: ca.Function, result: int) -> bool:
    """Return whether the expressions use no more of a run than its averages.

    Args:
        run: the run.
        algebra: the expressions as a Function whose input number ``result`` is the run's results.
        result: that number.
    """
    observed = signals(run.integration.structure)
    states = sum(output.numel() for output in run.outputs) - observed.count - observed.squared
    columns = (algebra.jac_sparsity(k, result).get_col() for k in range(algebra.n_out()))
    return all(column >= states for own in columns for column in own)


def holds_maps(function: ca.Function) -> bool:
    """Return whether a graph calls mapped Functions, of which a scalar form would hold every copy."""
    calls = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL)
    return any(function.instruction_MX(k).which_function().is_a("Map") for k in calls)


@dataclass(frozen=True)
class _Algebra:
    """Objective J and requirements g as algebra over the runs' results o, and the parameters theta over y.

    Attributes:
        values: (y, p, o) -> (J, g).
        slopes: (y, p, o) -> (J, g, J_y, J_o, g_y, g_o).
        curvature: (y, p, o, S, lam_f, lam_g) -> (L_zz S with z = (y, o), L_o). S has few columns, z may have thousands
            of rows, and L_zz be full.
        theta_slopes: for each group (y, p) -> theta_y, side by side for each run.
        theta_curvature: (y, p, c) -> sum_v c_v theta_v,yy.
    """

    values: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    theta_slopes: list[ca.Function]
    theta_curvature: ca.Function

    @classmethod
    def around(cls, groups: list[RunGroup], parts: Split, variables: ca.MX, parameters: ca.MX) -> _Algebra:
        """Differentiate the expressions around runs, by those results only that are used."""
        whole = algebra_of(parts, variables, parameters)
        kind: Any = ca.SX if whole.is_a("SXFunction") else ca.MX
        y, p = kind.sym("y", variables.numel()), kind.sym("p", parameters.numel())
        used = {k: kind.sym("o", group.size) for group in groups for k in group.members}
        padded = [
            ca.vertcat(kind.zeros(symbol.numel() - used[k].numel()), used[k]) for k, symbol in enumerate(parts.results)
        ]
        objective, requirements = whole(y, p, *padded)
        o = _column(list(used.values()), kind)
        slopes = [ca.jacobian(e, v) for e in (objective, requirements) for v in (y, o)]
        lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", requirements.numel())
        z, seeds = ca.vertcat(y, o), kind.sym("S", y.numel() + o.numel(), y.numel())
        gradient = ca.gradient(lam_f * objective + ca.dot(lam_g, requirements), z)
        curvature = [ca.jtimes(gradient, z, seeds), gradient[y.numel() :]]
        theta = [ca.vec(group.inputs(y, p)[list(group.varying), :]) for group in groups]
        weights = kind.sym("c", sum(part.numel() for part in theta))
        bend = ca.hessian(ca.dot(weights, _column(theta, kind)), y)[0]
        return cls(
            values=ca.Function("values", [y, p, o], [objective, requirements]),
            slopes=ca.Function("slopes", [y, p, o], [objective, requirements, *slopes]),
            curvature=ca.Function("curvature", [y, p, o, seeds, lam_f, lam_g], curvature),
            theta_slopes=[
                ca.Function("theta_slopes", [y, p], [ca.densify(group.side_by_side(ca.jacobian(part, y)))])
                for group, part in zip(groups, theta, strict=True)
            ],
            theta_curvature=ca.Function("theta_curvature", [y, p, weights], [bend]),
        )


def _first_derivatives(algebra: _Algebra, groups: list[RunGroup], y: ca.MX, p: ca.MX) -> list[ca.MX]:
    """Return J, g, the gradient of J as a column and the Jacobian of g, from the runs' first-order jets."""
    found = [
        group.slopes.call([group.inputs(y, p), slopes(y, p)])
        for group, slopes in zip(groups, algebra.theta_slopes, strict=True)
    ]
    o, o_y = _all_results(groups, found, y)
    f, g, f_y, f_o, g_y, g_o = algebra.slopes(y, p, o)
    return [*map(ca.densify, (f, g, (f_y + ca.mtimes(f_o, o_y)).T, g_y + ca.mtimes(g_o, o_y)))]


def _hessian(
    algebra: _Algebra, groups: list[RunGroup], at: tuple[ca.MX, ca.MX], multipliers: tuple[ca.MX, ca.MX]
) -> ca.MX:
    """Return the Lagrangian's Hessian, from the runs' parameters and second-order jets."""
    y, p = at
    theta = [group.inputs(y, p) for group in groups]
    theta_y = [slopes(y, p) for slopes in algebra.theta_slopes]
    jets = [group.jets(own) for group, own in zip(groups, theta, strict=True)]
    found = [group.chained.call([*own]) for group, *own in zip(groups, jets, theta_y, strict=True)]
    o, o_y = _all_results(groups, found, y)
    z_y = ca.vertcat(ca.MX.eye(y.numel()), o_y)
    l_zz_z_y, mu = algebra.curvature(y, p, o, z_y, *multipliers)
    hessian, adjoints = ca.mtimes(z_y.T, l_zz_z_y), []
    position = 0
    for group, *own in zip(groups, theta, jets, theta_y, strict=True):
        end = position + group.size * len(group.members)
        bent, adjoint = group.bent.call([*own, ca.reshape(mu[position:end], group.size, -1)])
        position = end
        hessian += ca.repsum(bent, 1, len(group.members))
        adjoints.append(ca.vec(adjoint))
    return ca.densify(hessian + algebra.theta_curvature(y, p, _column(adjoints)))


def _all_results(groups: list[RunGroup], found: list[list[ca.MX]], y: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return all results as a column, and their slopes by y as a matrix, from those of each group."""
    if not found:
        return ca.MX(0, 1), ca.MX(0, y.numel())
    slopes = [group.below_each_other(o_y) for group, (_, o_y) in zip(groups, found, strict=True)]
    return ca.vertcat(*(ca.vec(o) for o, _ in found)), ca.vertcat(*slopes)


def _column(parts: list[Any], kind: Any = ca.MX) -> Any:
    """Stack columns; without any, return a column of no rows."""
    return ca.vertcat(*parts) if parts else kind(0, 1)
