"""The nonlinear program of a design, with exact first and second derivatives.

A run enters it by its Taylor coefficients (`plough_opt.motion.jets`), the algebra around the runs by automatic
differentiation of a small scalar graph; the chain rule joins the two. With o(theta(y)) the runs' results::

    grad f = J_y + J_o o_theta theta_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where z = (y, o), S = dz/dy, mu = L_o and c = mu' o_theta.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from plough_opt.accuracy import ORDER_8
from plough_opt.design.split import EmbeddedRun, Split
from plough_opt.motion.integrators import integration
from plough_opt.motion.jets import jets_of, pairs
from plough_opt.motion.signals import signals
from plough_opt.motion.timeline import Timeline


@dataclass(frozen=True)
class Nlp:
    """Functions of scaled variables y and parameters p, as IPOPT wants them.

    Attributes:
        f: (y, p) -> scaled objective.
        g: (y, p) -> scaled requirements, a column.
        grad_f: (y, p) -> (f, gradient).
        jac_g: (y, p) -> (g, Jacobian).
        hess_lag: (y, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g.
    """

    f: ca.Function
    g: ca.Function
    grad_f: ca.Function
    jac_g: ca.Function
    hess_lag: ca.Function


@dataclass(frozen=True)
class RunInNlp:
    """One run as the program sees it: its results, or just their averages when no more is asked for."""

    value: ca.Function
    slopes: ca.Function
    curvatures: ca.Function
    varying: tuple[int, ...]
    size: int


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


def run_in_nlp(run: EmbeddedRun, only_averages: bool, varying: tuple[int, ...], steps: int | None) -> RunInNlp:
    """Prepare a run's values and derivatives, with ``steps`` in place of the steps that it was written with."""
    own = run.integration
    accuracy, timeline = own.accuracy, own.timeline
    if only_averages and accuracy.method in ORDER_8:
        timeline = Timeline(1, timeline.steps, timeline.kink)
    if steps is not None:
        timeline = Timeline(timeline.outputs, steps, timeline.kink)
    solver = integration(own.structure, accuracy, timeline)
    observed = signals(own.structure)
    size = sum(solver.function.numel_out(k) for k in range(solver.function.n_out()))
    first = size - observed.count - observed.squared if only_averages else 0
    p = ca.MX.sym("p", solver.function.numel_in(0))
    stacked = ca.vertcat(*(ca.vec(result) for result in solver.function.call([p])))
    return RunInNlp(
        value=ca.Function("value", [p], [stacked[first:]]),
        slopes=ca.Function("slopes", [p], [jets_of(solver, varying, 1)(p)[first:, :]]),
        curvatures=ca.Function("curvatures", [p], [jets_of(solver, varying, 2)(p)[first:, :]]),
        varying=varying,
        size=size - first,
    )


def build_nlp(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> Nlp:
    """Assemble the program of an objective and requirements.

    Args:
        parts: objective (first) and requirements (second, a column), split around their runs.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
    """
    full = ca.Function("full", [y, p, *parts.results], list(parts.expressions)).expand()
    inputs = [ca.Function("inputs", [y, p], [run.inputs]).expand() for run in parts.runs]
    runs = []
    for k, run in enumerate(parts.runs):
        varying = tuple(sorted(set(inputs[k].jac_sparsity(0, 0).row())))
        runs.append(run_in_nlp(run, averages_only(run, full, 2 + k), varying, steps[k]))

    # The algebra in scalar form, over the results that are really used.
    ys, ps = ca.SX.sym("y", y.numel()), ca.SX.sym("p", p.numel())
    results = [ca.SX.sym("o", run.size) for run in runs]
    padded = [
        ca.vertcat(ca.SX.zeros(symbol.numel() - result.numel()), result)
        for symbol, result in zip(parts.results, results, strict=True)
    ]
    o = ca.vertcat(*results) if results else ca.SX(0, 1)
    objective, requirements = full(ys, ps, *padded)
    theta = ca.vertcat(
        *(function(ys, ps)[list(run.varying)] for function, run in zip(inputs, runs, strict=True))
    ) if runs else ca.SX(0, 1)  # fmt: skip
    lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", requirements.numel())
    weights = ca.SX.sym("c", theta.numel())
    lagrangian = lam_f * objective + ca.dot(lam_g, requirements)
    z = ca.vertcat(ys, o)
    algebra = ca.Function("algebra", [ys, ps, o], [objective, requirements])
    slopes = ca.Function(
        "algebra_slopes",
        [ys, ps, o],
        [objective, requirements] + [ca.jacobian(e, v) for e in (objective, requirements) for v in (ys, o)],
    )
    curvature = ca.Function(
        "algebra_curvature",
        [ys, ps, o, lam_f, lam_g],
        [ca.hessian(lagrangian, z)[0], ca.gradient(lagrangian, o)],
    )
    theta_slopes = ca.Function("theta_slopes", [ys, ps], [ca.jacobian(theta, ys)])
    theta_curvature = ca.Function("theta_curvature", [ys, ps, weights], [ca.hessian(ca.dot(weights, theta), ys)[0]])

    def jets(order: int) -> list[ca.MX]:
        return [
            (run.slopes if order == 1 else run.curvatures)(function(y, p))
            for run, function in zip(runs, inputs, strict=True)
        ]

    def column(parts_of: list[ca.MX]) -> ca.MX:
        return ca.vertcat(*parts_of) if parts_of else ca.MX(0, 1)

    def run_slopes(found: list[ca.MX]) -> ca.MX:
        blocks = [jet[:, 1 : 1 + len(run.varying)] for jet, run in zip(found, runs, strict=True)]
        return ca.diagcat(*blocks) if blocks else ca.MX(0, 0)

    values = column([run.value(function(y, p)) for run, function in zip(runs, inputs, strict=True)])
    f_value, g_value = algebra(y, p, values)

    first = jets(1)
    o_y = ca.mtimes(run_slopes(first), theta_slopes(y, p))
    f_first, g_first, f_y, f_o, g_y, g_o = slopes(y, p, column([jet[:, 0] for jet in first]))
    gradient = ca.densify(f_y + ca.mtimes(f_o, o_y)).T
    jacobian = ca.densify(g_y + ca.mtimes(g_o, o_y))

    second = jets(2)
    lf, lg = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", requirements.numel())
    theta_y = theta_slopes(y, p)
    o_theta = run_slopes(second)
    hessian_z, mu = curvature(y, p, column([jet[:, 0] for jet in second]), lf, lg)
    s = ca.vertcat(ca.MX.eye(y.numel()), ca.mtimes(o_theta, theta_y))
    hessian = ca.mtimes([s.T, hessian_z, s]) + theta_curvature(y, p, ca.mtimes(o_theta.T, mu))
    if runs:
        hessian += ca.mtimes([theta_y.T, _contracted(second, runs, mu), theta_y])
    names = ["x", "p"]
    return Nlp(
        f=ca.Function("f", [y, p], [f_value], names, ["f"]),
        g=ca.Function("g", [y, p], [g_value], names, ["g"]),
        grad_f=ca.Function("grad_f", [y, p], [f_first, gradient], names, ["f", "grad_f_x"]),
        jac_g=ca.Function("jac_g", [y, p], [g_first, jacobian], names, ["g", "jac_g_x"]),
        hess_lag=ca.Function(
            "hess_lag",
            [y, p, lf, lg],
            [ca.triu(ca.densify(hessian))],
            [*names, "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
    )


def _contracted(second: list[ca.MX], runs: list[RunInNlp], mu: ca.MX) -> ca.MX:
    """Return the runs' second derivatives contracted with the adjoints mu: one symmetric block for each run."""
    blocks, position = [], 0
    for jet, run in zip(second, runs, strict=True):
        count = len(run.varying)
        row = ca.mtimes(mu[position : position + run.size].T, jet[:, 1 + count :])
        position += run.size
        block = ca.MX.zeros(count, count)
        for k, (a, b) in enumerate(pairs(count)):
            block[a, b] = row[k]
            block[b, a] = row[k]
        blocks.append(block)
    return ca.diagcat(*blocks)
