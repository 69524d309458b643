"""The nonlinear program of a design, with exact first and second derivatives.

A run enters it by its Taylor coefficients (`plough_opt.motion.jets`), the algebra around the runs by automatic
differentiation of a small scalar graph; the chain rule joins the two. With o(theta(y)) the runs' results::

    grad f = J_y + J_o o_theta theta_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where z = (y, o), S = dz/dy, mu = L_o and c = mu' o_theta.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.accuracy import ORDER_8
from plough_opt.design.split import EmbeddedRun, Split
from plough_opt.motion.integrators import Integration, integration, quiet_events
from plough_opt.motion.jets import jets_of, pairs, weighted_curvature
from plough_opt.motion.signals import signals
from plough_opt.motion.timeline import Timeline


@dataclass(frozen=True)
class Nlp:
    """Functions of scaled variables y and parameters p, as IPOPT wants them.

    Attributes:
        values: (y, p) -> (scaled objective f, scaled requirements g), from one integration of each run.
        first: returns `slopes`; not all programs are asked for derivatives, which take time to build.
        second: returns `hess_lag`, which takes longest.
    """

    values: ca.Function
    first: Callable[[], ca.Function]
    second: Callable[[], ca.Function]

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
        return _some("f", self.values, {0: "f"})

    @cached_property
    def g(self) -> ca.Function:
        """(y, p) -> g, a column."""
        return _some("g", self.values, {1: "g"})

    @cached_property
    def grad_f(self) -> ca.Function:
        """(y, p) -> (f, gradient)."""
        return _some("grad_f", self.slopes, {0: "f", 2: "grad_f_x"})

    @cached_property
    def jac_g(self) -> ca.Function:
        """(y, p) -> (g, Jacobian)."""
        return _some("jac_g", self.slopes, {1: "g", 3: "jac_g_x"})


def _some(name: str, function: ca.Function, results: dict[int, str]) -> ca.Function:
    """Return a Function of (y, p) with some of another's results, by the names that IPOPT's interface wants."""
    y, p = inputs = function.mx_in()
    found = function.call(inputs)
    return ca.Function(name, [y, p], [found[k] for k in results], ["x", "p"], list(results.values()))


@dataclass(frozen=True)
class RunInNlp:
    """One run as the program sees it: its results, or just their averages when no more is asked for.

    Attributes:
        solver: the run.
        first: number of its first result that is asked for; the others follow.
        varying: positions of the parameters that vary.
    """

    solver: Integration
    first: int
    varying: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of results asked for."""
        function = self.solver.function
        return sum(function.numel_out(k) for k in range(function.n_out())) - self.first

    @cached_property
    def value(self) -> ca.Function:
        """Parameters -> results."""
        p = self._parameters()
        stacked = ca.vertcat(*(ca.vec(result) for result in self.solver.function.call([p])))
        return ca.Function("value", [p], [stacked[self.first :]])

    @cached_property
    def slopes(self) -> ca.Function:
        """Parameters -> results and their first derivatives, as columns."""
        return self._jets(1)

    @cached_property
    def curvatures(self) -> ca.Function:
        """Parameters -> the same and the second derivatives; without these where events make them `weighted`."""
        return self._jets(1 if self.solver.structure.events else 2)

    @cached_property
    def weighted(self) -> ca.Function | None:
        """(parameters, weights) -> second derivatives of the weighted sum of the results, or None without events."""
        if not self.solver.structure.events:
            return None
        p, weights = self._parameters(), ca.MX.sym("weights", self.size)
        every = ca.vertcat(ca.MX.zeros(self.first), weights)
        return ca.Function("weighted", [p, weights], [weighted_curvature(self.solver, self.varying)(p, every)])

    def _parameters(self) -> ca.MX:
        return ca.MX.sym("p", self.solver.function.numel_in(0))

    def _jets(self, order: int) -> ca.Function:
        p = self._parameters()
        with quiet_events():
            return ca.Function("jets", [p], [jets_of(self.solver, self.varying, order)(p)[self.first :, :]])


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
    """Prepare a run's values and derivatives, with ``steps`` in place of the steps that it was written with.

    A periodic orbit is found by so many harmonics that balance: the orbit of shooting, in a fraction of its time.
    """
    own = run.integration
    accuracy, timeline, structure = own.accuracy, own.timeline, own.structure
    if structure.orbit == "periodic" and steps is not None:
        structure, steps = replace(structure, orbit="harmonic_balance", harmonics=steps), None
    if only_averages and accuracy.method in ORDER_8:
        timeline = Timeline(1, timeline.steps, timeline.kink)
    if steps is not None:
        timeline = Timeline(timeline.outputs, steps, timeline.kink)
    solver = integration(structure, accuracy, timeline)
    observed = signals(structure)
    size = sum(solver.function.numel_out(k) for k in range(solver.function.n_out()))
    return RunInNlp(solver, size - observed.count - observed.squared if only_averages else 0, varying)


@dataclass(frozen=True)
class Algebra:
    """Objective and requirements as algebra over the runs' results o, and the runs' parameters theta over y.

    Attributes:
        values: (y, p, o) -> (J, g).
        slopes: (y, p, o) -> (J, g, J_y, J_o, g_y, g_o).
        curvature: (y, p, o, lam_f, lam_g) -> (L_zz with z = (y, o), L_o).
        theta_slopes: (y, p) -> theta_y, of those parameters that vary.
        theta_curvature: (y, p, c) -> sum_v c_v theta_v,yy.
    """

    values: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    theta_slopes: ca.Function
    theta_curvature: ca.Function


def build_nlp(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None]) -> Nlp:
    """Assemble the program of an objective and requirements.

    Args:
        parts: objective (first) and requirements (second, a column), split around their runs.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
    """
    full = ca.Function("full", [y, p, *parts.results], list(parts.expressions))
    if not _holds_maps(full):
        full = full.expand()
    inputs = [ca.Function("inputs", [y, p], [run.inputs]).expand() for run in parts.runs]
    runs = []
    for k, run in enumerate(parts.runs):
        varying = tuple(sorted(set(inputs[k].jac_sparsity(0, 0).row())))
        runs.append(run_in_nlp(run, averages_only(run, full, 2 + k), varying, steps[k]))
    algebra = _algebra(parts, full, inputs, runs, (y.numel(), p.numel()))

    results = _column([run.value(function(y, p)) for run, function in zip(runs, inputs, strict=True)])
    f, g = map(ca.densify, algebra.values(y, p, results))
    given = [function(y, p) for function in inputs]

    def first() -> ca.Function:
        jets = [run.slopes(own) for run, own in zip(runs, given, strict=True)]
        return ca.Function("slopes", [y, p], list(_first_derivatives(algebra, runs, jets, y, p)))

    def second() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        jets = [run.curvatures(own) for run, own in zip(runs, given, strict=True)]
        upper = _hessian(algebra, runs, (given, jets), (y, p, lam_f, lam_g))
        names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        return ca.Function("hess_lag", [y, p, lam_f, lam_g], [upper], names, result)

    return Nlp(ca.Function("values", [y, p], [f, g]), first, second)


def _algebra(
    parts: Split, full: ca.Function, inputs: list[ca.Function], runs: list[RunInNlp], sizes: tuple[int, int]
) -> Algebra:
    """Differentiate the algebra around the runs, in its own form and over those results only that are used."""
    kind: Any = ca.SX if full.is_a("SXFunction") else ca.MX
    y, p = kind.sym("y", sizes[0]), kind.sym("p", sizes[1])
    used = [kind.sym("o", run.size) for run in runs]
    padded = [
        ca.vertcat(kind.zeros(symbol.numel() - results.numel()), results)
        for symbol, results in zip(parts.results, used, strict=True)
    ]
    objective, requirements = full(y, p, *padded)
    o = _column(used, kind)
    theta = _column([f(y, p)[list(run.varying)] for f, run in zip(inputs, runs, strict=True)], kind)
    lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", requirements.numel())
    weights = kind.sym("c", theta.numel())
    lagrangian = lam_f * objective + ca.dot(lam_g, requirements)
    slopes = [ca.jacobian(e, v) for e in (objective, requirements) for v in (y, o)]
    curvature = [ca.hessian(lagrangian, ca.vertcat(y, o))[0], ca.gradient(lagrangian, o)]
    return Algebra(
        values=ca.Function("values", [y, p, o], [objective, requirements]),
        slopes=ca.Function("slopes", [y, p, o], [objective, requirements, *slopes]),
        curvature=ca.Function("curvature", [y, p, o, lam_f, lam_g], curvature),
        theta_slopes=ca.Function("theta_slopes", [y, p], [ca.jacobian(theta, y)]),
        theta_curvature=ca.Function("theta_curvature", [y, p, weights], [ca.hessian(ca.dot(weights, theta), y)[0]]),
    )


def _first_derivatives(
    algebra: Algebra, runs: list[RunInNlp], jets: list[ca.MX], y: ca.MX, p: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return J, g, the gradient of J as a column and the Jacobian of g, from the runs' first-order jets."""
    f, g, f_y, f_o, g_y, g_o = algebra.slopes(y, p, _column([jet[:, 0] for jet in jets]))
    o_y = ca.mtimes(_run_slopes(runs, jets), algebra.theta_slopes(y, p))
    return ca.densify(f), ca.densify(g), ca.densify(f_y + ca.mtimes(f_o, o_y)).T, ca.densify(g_y + ca.mtimes(g_o, o_y))


def _hessian(
    algebra: Algebra,
    runs: list[RunInNlp],
    second: tuple[list[ca.MX], list[ca.MX]],
    at: tuple[ca.MX, ca.MX, ca.MX, ca.MX],
) -> ca.MX:
    """Return the upper triangle of the Lagrangian's Hessian, from the runs' parameters and second-order jets."""
    y, p, lam_f, lam_g = at
    given, jets = second
    results = _column([jet[:, 0] for jet in jets])
    l_zz, l_o = algebra.curvature(y, p, results, lam_f, lam_g)
    theta_y, o_theta = algebra.theta_slopes(y, p), _run_slopes(runs, jets)
    z_y = ca.vertcat(ca.MX.eye(y.numel()), ca.mtimes(o_theta, theta_y))
    hessian = ca.mtimes([z_y.T, l_zz, z_y]) + algebra.theta_curvature(y, p, ca.mtimes(o_theta.T, l_o))
    if runs:
        hessian += ca.mtimes([theta_y.T, _contracted(runs, given, jets, l_o), theta_y])
    return ca.triu(ca.densify(hessian))


def _holds_maps(function: ca.Function) -> bool:
    """Return whether a graph calls mapped Functions, of which a scalar form would hold every copy."""
    calls = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL)
    return any(function.instruction_MX(k).which_function().is_a("Map") for k in calls)


def _column(parts: list[Any], kind: Any = ca.MX) -> Any:
    """Stack columns; without any, return a column of no rows."""
    return ca.vertcat(*parts) if parts else kind(0, 1)


def _run_slopes(runs: list[RunInNlp], jets: list[ca.MX]) -> ca.MX:
    """Return o_theta: one block for each run."""
    blocks = [jet[:, 1 : 1 + len(run.varying)] for jet, run in zip(jets, runs, strict=True)]
    return ca.diagcat(*blocks) if blocks else ca.MX(0, 0)


def _contracted(runs: list[RunInNlp], given: list[ca.MX], jets: list[ca.MX], mu: ca.MX) -> ca.MX:
    """Return the runs' second derivatives contracted with the adjoints mu: one symmetric block for each run."""
    blocks, position = [], 0
    for own, jet, run in zip(given, jets, runs, strict=True):
        count = len(run.varying)
        weights = mu[position : position + run.size]
        position += run.size
        if run.weighted is not None:
            blocks.append(run.weighted(own, weights))
            continue
        row = ca.mtimes(weights.T, jet[:, 1 + count :])
        block = ca.MX.zeros(count, count)
        for k, (a, b) in enumerate(pairs(count)):
            block[a, b] = row[k]
            block[b, a] = row[k]
        blocks.append(block)
    return ca.diagcat(*blocks)
