"""The nonlinear program of a design, with exact first and second derivatives.

A run enters it by its Taylor coefficients (`plough_opt.motion.jets`), the algebra around the runs by automatic
differentiation of a small scalar graph; the chain rule joins the two. With o(theta(y)) the runs' results::

    grad f = J_y + J_o o_y,   o_y = o_theta theta_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where z = (y, o), S = dz/dy, mu = L_o and c = mu' o_theta.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import casadi as ca

from plough_opt.design.alike_runs import Alike, alike_runs
from plough_opt.design.split import EmbeddedRun, Split
from plough_opt.motion.signals import signals

PARTS: Final = {
    "f": {"f": 0},
    "g": {"g": 1},
    "grad_f": {"f": 0, "grad_f_x": 2},
    "jac_g": {"g": 1, "jac_g_x": 3},
}
"""What IPOPT asks for: names of results, and which they are of the values or of the slopes."""


@dataclass(frozen=True)
class Nlp:
    """Functions of scaled variables y and parameters p, as IPOPT wants them.

    Attributes:
        values: (y, p) -> (scaled objective f, scaled requirements g), from one integration of each run.
        first: returns `slopes`; not all programs are asked for derivatives, which take time to build.
        second: returns `hess_lag`, which takes longest.
        parts: `PARTS` that remember their last point, by name; without them a caller has to.
        alike: the runs, as they are integrated.
    """

    values: ca.Function
    first: Callable[[], ca.Function]
    second: Callable[[], ca.Function]
    parts: Mapping[str, ca.Function] | None = None
    alike: tuple[Alike, ...] = ()

    @cached_property
    def slopes(self) -> ca.Function:
        """(y, p) -> (f, g, gradient, Jacobian), from one integration of each run."""
        return self.first()

    @cached_property
    def hess_lag(self) -> ca.Function:
        """(y, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g."""
        return self.second()

    @cached_property
    def f(self) -> ca.Function:
        """(y, p) -> f."""
        return self._part("f", self.values)

    @cached_property
    def g(self) -> ca.Function:
        """(y, p) -> g, a column."""
        return self._part("g", self.values)

    @cached_property
    def grad_f(self) -> ca.Function:
        """(y, p) -> (f, gradient)."""
        return self._part("grad_f", self.slopes)

    @cached_property
    def jac_g(self) -> ca.Function:
        """(y, p) -> (g, Jacobian)."""
        return self._part("jac_g", self.slopes)

    def _part(self, name: str, function: ca.Function) -> ca.Function:
        """Return a Function of (y, p) with some of another's results."""
        if self.parts is not None:
            return self.parts[name]
        y, p = inputs = function.mx_in()
        found = function.call(inputs)
        results = PARTS[name]
        return ca.Function(name, [y, p], [found[k] for k in results.values()], ["x", "p"], list(results))


def averages_only(run: EmbeddedRun, algebra: ca.Function, result: int) -> bool:
    """Return whether the expressions use no more of a run than its averages.

    Args:
        run: the run.
        algebra: the expressions as a Function whose input number ``result`` is the run's results.
        result: that number.
    """
    observed = signals(run.integration.structure)
    states = sum(output.numel() for output in run.outputs) - observed.count - observed.squared
    for k in range(algebra.n_out()):
        columns = algebra.jac_sparsity(k, result).get_col()
        if any(column < states for column in columns):
            return False
    return True


@dataclass(frozen=True)
class Algebra:
    """Objective and requirements as algebra over the runs' results o, and the runs' parameters theta over y.

    The results, and the parameters that vary, are ordered by `Alike` runs.

    Attributes:
        values: (y, p, o) -> (J, g).
        slopes: (y, p, o) -> (J, g, J_y, J_o, g_y, g_o).
        curvature: (y, p, o, S, lam_f, lam_g) -> (L_zz S with z = (y, o), L_o). S has few columns, z may have thousands
            of rows, and L_zz be full.
        theta_slopes: for alike runs each, (y, p) -> theta_y, side by side for each run.
        theta_curvature: (y, p, c) -> sum_v c_v theta_v,yy.
    """

    values: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    theta_slopes: list[ca.Function]
    theta_curvature: ca.Function


def build_nlp(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> Nlp:
    """Assemble the program of an objective and requirements.

    Args:
        parts: objective (first) and requirements (second, a column), split around their runs.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
    """
    full = _full(parts, y, p)
    alike = _alike(parts, full, y, p, steps)
    algebra = _algebra(parts, full, alike, (y.numel(), p.numel()))
    given = [own.inputs(y, p) for own in alike]

    results = _column([ca.vec(own.value(theta)) for own, theta in zip(alike, given, strict=True)])
    f, g = map(ca.densify, algebra.values(y, p, results))

    def first() -> ca.Function:
        return ca.Function("slopes", [y, p], list(_first_derivatives(algebra, alike, given, y, p)))

    def second() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        upper = _hessian(algebra, alike, given, (y, p, lam_f, lam_g))
        names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        return ca.Function("hess_lag", [y, p, lam_f, lam_g], [upper], names, result)

    return Nlp(ca.Function("values", [y, p], [f, g]), first, second, alike=tuple(alike))


def runs_of(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> list[Alike]:
    """Return the runs that `build_nlp` would give a program."""
    return _alike(parts, _full(parts, y, p), y, p, steps)


def _full(parts: Split, y: ca.MX, p: ca.MX) -> ca.Function:
    full = ca.Function("full", [y, p, *parts.results], list(parts.expressions))
    return full if holds_maps(full) else full.expand()


def _alike(parts: Split, full: ca.Function, y: ca.MX, p: ca.MX, steps: list[int | None]) -> list[Alike]:
    only_averages = [averages_only(run, full, 2 + k) for k, run in enumerate(parts.runs)]
    return alike_runs(parts.runs, only_averages, y, p, steps)


def _algebra(parts: Split, full: ca.Function, alike: list[Alike], sizes: tuple[int, int]) -> Algebra:
    """Differentiate the algebra around the runs, in its own form and over those results only that are used."""
    kind: Any = ca.SX if full.is_a("SXFunction") else ca.MX
    y, p = kind.sym("y", sizes[0]), kind.sym("p", sizes[1])
    used = {k: kind.sym("o", own.size) for own in alike for k in own.members}
    padded = [
        ca.vertcat(kind.zeros(symbol.numel() - used[k].numel()), used[k]) for k, symbol in enumerate(parts.results)
    ]
    objective, requirements = full(y, p, *padded)
    o = _column(list(used.values()), kind)
    theta = [ca.vec(own.inputs(y, p)[list(own.varying), :]) for own in alike]
    lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", requirements.numel())
    weights, seeds = kind.sym("c", sum(part.numel() for part in theta)), kind.sym("S", sizes[0] + o.numel(), sizes[0])
    lagrangian = lam_f * objective + ca.dot(lam_g, requirements)
    slopes = [ca.jacobian(e, v) for e in (objective, requirements) for v in (y, o)]
    z = ca.vertcat(y, o)
    gradient = ca.gradient(lagrangian, z)
    curvature = [ca.jtimes(gradient, z, seeds), gradient[sizes[0] :]]
    bend = ca.hessian(ca.dot(weights, _column(theta, kind)), y)[0]
    return Algebra(
        values=ca.Function("values", [y, p, o], [objective, requirements]),
        slopes=ca.Function("slopes", [y, p, o], [objective, requirements, *slopes]),
        curvature=ca.Function("curvature", [y, p, o, seeds, lam_f, lam_g], curvature),
        theta_slopes=[
            ca.Function("theta_slopes", [y, p], [ca.densify(own.beside(ca.jacobian(part, y)))])
            for own, part in zip(alike, theta, strict=True)
        ],
        theta_curvature=ca.Function("theta_curvature", [y, p, weights], [bend]),
    )


def _first_derivatives(
    algebra: Algebra, alike: list[Alike], given: list[ca.MX], y: ca.MX, p: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return J, g, the gradient of J as a column and the Jacobian of g, from the runs' first-order jets."""
    theta_y = [slopes(y, p) for slopes in algebra.theta_slopes]
    o, o_y = _joined(alike, [own.slopes.call(at) for own, *at in zip(alike, given, theta_y, strict=True)], y)
    f, g, f_y, f_o, g_y, g_o = algebra.slopes(y, p, o)
    return ca.densify(f), ca.densify(g), ca.densify(f_y + ca.mtimes(f_o, o_y)).T, ca.densify(g_y + ca.mtimes(g_o, o_y))


def _hessian(algebra: Algebra, alike: list[Alike], given: list[ca.MX], at: tuple[ca.MX, ca.MX, ca.MX, ca.MX]) -> ca.MX:
    """Return the upper triangle of the Lagrangian's Hessian, from the runs' parameters and second-order jets."""
    y, p, lam_f, lam_g = at
    theta_y = [slopes(y, p) for slopes in algebra.theta_slopes]
    jets = [own.jets(theta) for own, theta in zip(alike, given, strict=True)]
    o, o_y = _joined(alike, [own.chained.call(both) for own, *both in zip(alike, jets, theta_y, strict=True)], y)
    z_y = ca.vertcat(ca.MX.eye(y.numel()), o_y)
    l_zz_z_y, mu = algebra.curvature(y, p, o, z_y, lam_f, lam_g)
    hessian, adjoints, position = ca.mtimes(z_y.T, l_zz_z_y), [], 0
    for own, theta, jet, slopes in zip(alike, given, jets, theta_y, strict=True):
        count = len(own.members)
        weights = ca.reshape(mu[position : position + own.size * count], own.size, count)
        position += own.size * count
        bent, adjoint = own.bent(theta, jet, slopes, weights)
        hessian += ca.repsum(bent, 1, count)
        adjoints.append(ca.vec(adjoint))
    return ca.triu(ca.densify(hessian + algebra.theta_curvature(y, p, _column(adjoints))))


def _joined(alike: list[Alike], found: list[list[ca.MX]], y: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return all results as a column, and their slopes by y as a matrix, from those of alike runs."""
    if not found:
        return ca.MX(0, 1), ca.MX(0, y.numel())
    slopes = [own.stacked(o_y) for own, (_, o_y) in zip(alike, found, strict=True)]
    return ca.vertcat(*(ca.vec(o) for o, _ in found)), ca.vertcat(*slopes)


def holds_maps(function: ca.Function) -> bool:
    """Return whether a graph calls mapped Functions, of which a scalar form would hold every copy."""
    calls = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL)
    return any(function.instruction_MX(k).which_function().is_a("Map") for k in calls)


def _column(parts: list[Any], kind: Any = ca.MX) -> Any:
    """Stack columns; without any, return a column of no rows."""
    return ca.vertcat(*parts) if parts else kind(0, 1)
