"""The nonlinear program of a design, with exact first and second derivatives.

A run enters it by its Taylor coefficients (`plough_opt.motion.derivatives`), the algebra around the runs by automatic
differentiation of a small scalar graph; the chain rule joins the two. With o(theta(y)) the runs' results::

    grad f = J_y + J_o o_y,   o_y = o_theta theta_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where z = (y, o), S = dz/dy, mu = L_o and c = mu' o_theta. The results o of all runs are one column, and so are the
varying parameters theta, both in the order of the `RunGroup` s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.process import available
from plough_opt.design.split import EmbeddedRun, Split
from plough_opt.motion.derivatives import jets_of, weighted_curvature
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.runge_kutta import pairs


@dataclass(frozen=True)
class RunGroup:
    """Runs of one structure, side by side: their results, or just their averages if no more is asked for.

    A design over many samples of a soil holds as many runs of one structure. They share one integrator, and the chain
    rule from a run's parameters to the few variables of the design is applied run by run inside CasADi's `map`, so that
    building takes no longer for many of them. What belongs to one run, as its parameters, its results or the slopes of
    either, is a block of columns, and the blocks of all runs stand side by side: the layout of that map.

    Attributes:
        solver: what integrates each of them.
        first: number of the first result that is asked for; the others follow.
        varying: positions of the parameters that vary, theta.
        members: numbers of the runs among all of the design.
        inputs: (y, p) -> their parameters, a column for each run.
        variables: number of scaled variables y.
    """

    solver: Integration
    first: int
    varying: tuple[int, ...]
    members: tuple[int, ...]
    inputs: ca.Function
    variables: int

    @property
    def size(self) -> int:
        """Number of results asked for of each run."""
        return self.solver.results - self.first

    # Each of the following is a Function of one run, mapped over all of them.

    @cached_property
    def value(self) -> ca.Function:
        """Parameters -> results."""
        p = self._parameters()
        stacked = ca.vertcat(*(ca.vec(result) for result in self.solver.function.call([p])))
        return self._mapped([p], [stacked[self.first :]])

    @cached_property
    def slopes(self) -> ca.Function:
        """(Parameters, theta_y) -> results and their slopes by y."""
        p, theta_y = self._parameters(), self._theta_slopes()
        jet = self._jets(p, 1)
        return self._mapped([p, theta_y], [jet[:, 0], ca.mtimes(jet[:, 1:], theta_y)])

    @cached_property
    def jets(self) -> ca.Function:
        """Parameters -> results with first and second derivatives by theta; through events without second ones."""
        p = self._parameters()
        return self._mapped([p], [self._jets(p, 1 if self._events else 2)])

    @cached_property
    def chained(self) -> ca.Function:
        """(Jets, theta_y) -> results and their slopes by y."""
        jet, theta_y = self._jet(), self._theta_slopes()
        return self._mapped([jet, theta_y], [jet[:, 0], ca.mtimes(jet[:, 1 : 1 + len(self.varying)], theta_y)])

    @cached_property
    def bent(self) -> ca.Function:
        """(Parameters, jets, theta_y, weights mu) -> theta_y' (mu' o)_theta,theta theta_y, and (mu' o_theta)'."""
        p, jet, theta_y, mu = self._parameters(), self._jet(), self._theta_slopes(), ca.MX.sym("mu", self.size)
        count = len(self.varying)
        if self._events:
            curvature = weighted_curvature(self.solver, self.varying)(p, ca.vertcat(ca.MX.zeros(self.first), mu))
        else:
            row, curvature = ca.mtimes(mu.T, jet[:, 1 + count :]), ca.MX.zeros(count, count)
            for k, (a, b) in enumerate(pairs(count)):
                curvature[a, b] = curvature[b, a] = row[k]
        results = [ca.mtimes([theta_y.T, curvature, theta_y]), ca.mtimes(jet[:, 1 : 1 + count].T, mu)]
        return self._mapped([p, jet, theta_y, mu], [ca.densify(result) for result in results])

    # The layouts of what is not mapped.

    def below_each_other(self, slopes: ca.MX) -> ca.MX:
        """Return slopes by y, of which each run has a block of columns, as one matrix with a row for each result."""
        return ca.horzcat(*(ca.vec(slopes[:, k :: self.variables]) for k in range(self.variables)))

    def side_by_side(self, slopes: Any) -> Any:
        """Return the slopes of all varying parameters by y, run below run, as blocks of columns."""
        count = len(self.varying)
        return ca.horzcat(*(slopes[k * count : (k + 1) * count, :] for k in range(len(self.members))))

    @property
    def _events(self) -> bool:
        return self.solver.structure.events

    def _parameters(self) -> ca.MX:
        return ca.MX.sym("p", self.solver.function.numel_in(0))

    def _theta_slopes(self) -> ca.MX:
        return ca.MX.sym("theta_y", len(self.varying), self.variables)

    def _jet(self) -> ca.MX:
        count = len(self.varying)
        return ca.MX.sym("jet", self.size, 1 + count + (0 if self._events else len(pairs(count))))

    def _jets(self, p: ca.MX, order: int) -> ca.MX:
        return jets_of(self.solver, self.varying, order)(p)[self.first :, :]

    def _mapped(self, inputs: list[ca.MX], results: list[ca.MX]) -> ca.Function:
        """Return a Function of all runs, our own steps on all processors that it may keep busy."""
        one, count = ca.Function("one", inputs, results), len(self.members)
        if count == 1:
            return one
        own = self.solver.accuracy.order_8 and self.solver.structure.orbit == "transient"
        if own and (processors := available()) > 1:
            return one.map(count, "thread", processors)
        return one.map(count, "serial")


def grouped(
    runs: Sequence[EmbeddedRun], only_averages: Sequence[bool], y: ca.MX, p: ca.MX, steps: Sequence[int | None]
) -> list[RunGroup]:
    """Sort a design's runs into those that differ in numbers only.

    Args:
        runs: the runs.
        only_averages: of each whether no more than its averages is asked for.
        y: scaled variables.
        p: parameters.
        steps: of each the number of steps, or None for the method it was written with.
    """
    found: dict[tuple[int, int], tuple[Integration, list[int]]] = {}
    for k, (run, averages, count) in enumerate(zip(runs, only_averages, steps, strict=True)):
        solver, first = _prepared(run, averages, count)
        found.setdefault((id(solver), first), (solver, []))[1].append(k)
    groups = []
    for (_, first), (solver, members) in found.items():
        parameters = ca.horzcat(*(runs[k].inputs for k in members))
        inputs = ca.Function("inputs", [y, p], [ca.densify(parameters)]).expand()
        sparsity = ca.Function("given", [y, p], [ca.vec(parameters)]).jac_sparsity(0, 0)
        varying = tuple(sorted({row % parameters.shape[0] for row in sparsity.row()}))
        groups.append(RunGroup(solver, first, varying, tuple(members), inputs, y.numel()))
    return groups


def _prepared(run: EmbeddedRun, only_averages: bool, steps: int | None) -> tuple[Integration, int]:
    """Return what integrates a run, with ``steps`` in place of its own, and the number of the first result wanted.

    A periodic orbit is found by so many harmonics that balance: the orbit of shooting, in a fraction of its time.
    """
    own = run.integration
    accuracy, timeline, structure = own.accuracy, own.timeline, own.structure
    if structure.orbit == "periodic" and steps is not None:
        structure, steps = replace(structure, orbit="harmonic_balance", harmonics=steps), None
    if only_averages and accuracy.order_8:
        timeline = replace(timeline, outputs=1, aligned=True)
    if steps is not None:
        timeline = replace(timeline, steps=steps, aligned=timeline.moving)
    solver = integration(structure, accuracy, timeline)
    observed = signals(structure)
    return solver, solver.results - observed.count - observed.squared if only_averages else 0


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
    whole = algebra_of(parts, y, p)
    averages = [averages_only(run, whole, 2 + k) for k, run in enumerate(parts.runs)]
    groups = grouped(parts.runs, averages, y, p, steps)
    algebra = _Algebra.around(groups, parts, y, p)
    results = _column([ca.vec(group.value(group.inputs(y, p))) for group in groups])
    f, g = map(ca.densify, algebra.values(y, p, results))

    def build_slopes() -> ca.Function:
        return ca.Function("slopes", [y, p], _first_derivatives(algebra, groups, y, p))

    def build_hessian() -> ca.Function:
        multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        return hessian_function(y, p, *multipliers, _hessian(algebra, groups, (y, p), multipliers))

    return Nlp(ca.Function("values", [y, p], [f, g]), build_slopes, build_hessian, tuple(groups))


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
