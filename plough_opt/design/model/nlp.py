"""The nonlinear program of a design, with exact first and second derivatives.

Notation of the formulas and the code; what follows an underscore is differentiated by, as in theta_y = d theta/d y::

    y      scaled variables of the design       p      parameters of the design
    theta  parameters of runs that depend on y  o      results of runs
    J, g   objective and requirements           z      (y, o)

J and g are algebra over y and o, a small graph that automatic differentiation handles well. The runs o(theta) are
differentiated apart from it: their integration carries Taylor coefficients along, called jets
(`plough_opt.motion.solvers.derivatives`). The chain rule joins the two::

    o_y    = o_theta theta_y
    grad f = J_y + J_o o_y
    Hess L = S' L_zz S + theta_y' (sum_i mu_i o_i,theta theta) theta_y + sum_v c_v theta_v,yy

where L = lam_f J + lam_g' g is the Lagrangian, S = dz/dy, mu = L_o and c = mu' o_theta. The columns o and theta hold
all runs, one below the other, in the order of the `RunGroup` s and of the runs within each group.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import Call, meaning_of, without_labels
from plough_opt.core.compiler import Variant, in_machine_code
from plough_opt.core.errors import InputError
from plough_opt.core.process import available
from plough_opt.motion.domain import DomainCheck
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.derivatives import jets_of, weighted_curvature
from plough_opt.motion.solvers.integrators import Embedding, Integration, integration
from plough_opt.motion.solvers.steps import pairs

_GIVEN_RESULTS = "a run in a design cannot depend on the results of another run: give both the same variables instead"


@dataclass(frozen=True)
class EmbeddedRun(Embedding):
    """A run inside a design's expressions.

    Attributes:
        inputs: its parameters, with the duration last, as expressions of the design's symbols.
        quantities: all quantities of its scene, as expressions of the design's symbols.
        outputs: its results in the graph: states, means, variances.
    """

    inputs: ca.MX
    quantities: ca.MX
    outputs: tuple[ca.MX, ...]


@dataclass(frozen=True)
class Split:
    """Expressions in which symbols replace the results of every run.

    Attributes:
        runs: the runs, each once.
        expressions: the expressions in terms of the design's symbols and the runs' results.
        results: for each run a symbol of its stacked results: states column by column, means, variances.
        labels: the meaning of each label in the expressions, with the quantities that the label carries.
        algebra: for runs grouped alike, the graph around them and its derivatives, which programs with other numbers
            of steps share.
    """

    runs: tuple[EmbeddedRun, ...]
    expressions: tuple[ca.MX, ...]
    results: tuple[ca.MX, ...]
    labels: tuple[tuple[Any, ca.MX], ...]
    algebra: dict[Hashable, _Algebra] = field(default_factory=dict, compare=False)


def split(expressions: list[ca.MX], symbols: list[ca.MX]) -> Split:
    """Return expressions of ``symbols`` with the runs in them replaced by symbols of their results.

    Raises:
        InputError: a run's parameters depend on the results of another run.
    """
    found, calls = _calls(ca.Function("whole", symbols, expressions, {"never_inline": True}))
    labels = _carried(calls, symbols, bool(found))
    if calls:
        expressions = without_labels(expressions, [node for _, node in calls])
        found, _ = _calls(ca.Function("whole", symbols, expressions, {"never_inline": True}))
    results = tuple(ca.MX.sym(f"results_{i}", sum(o.numel() for o in run.outputs)) for i, run in enumerate(found))
    old: list[ca.MX] = []
    new: list[ca.MX] = []
    for run, result in zip(found, results, strict=True):
        ends = np.cumsum([0, *(output.numel() for output in run.outputs)]).tolist()
        old += run.outputs
        new += [ca.reshape(result[i:j], o.shape) for o, i, j in zip(run.outputs, ends, ends[1:], strict=False)]
    flat = [*expressions, *(run.inputs for run in found), *(run.quantities for run in found)]
    flat = ca.graph_substitute(flat, old, new) if found else flat
    n, count = len(expressions), len(found)
    inputs, quantities = flat[n : n + count], flat[n + count :]
    if found and ca.depends_on(_column([ca.vec(item) for item in inputs]), _column([*results])):
        raise InputError(_GIVEN_RESULTS)
    runs = (replace(run, inputs=p, quantities=q) for run, p, q in zip(found, inputs, quantities, strict=True))
    return Split(tuple(runs), tuple(flat[:n]), results, tuple(labels))


def _carried(calls: list[tuple[object, ca.MX]], symbols: list[ca.MX], runs: bool) -> list[tuple[object, ca.MX]]:
    """Return labels with the quantities they carry, except laws of a run's results: these are unknown before the run.

    Raises:
        InputError: a label that is not a law's carries results of a run.
    """
    found = []
    # Hardly any design has a label that carries results: all labels are looked through at once first.
    every = [node.dep(1) for _, node in calls]
    runs = runs and bool(_calls(ca.Function("carried", symbols, every, {"never_inline": True}))[0])
    for meaning, node in calls:
        if not runs or not _calls(ca.Function("carried", symbols, [node.dep(1)], {"never_inline": True}))[0]:
            found.append((meaning, node.dep(1)))
        elif not isinstance(meaning, Call) or meaning.limited:
            raise InputError(_GIVEN_RESULTS)
    return found


def _calls(whole: ca.Function) -> tuple[list[EmbeddedRun], list[tuple[object, ca.MX]]]:
    """Return the runs and the labels that a Function's graph calls, each once."""
    runs: dict[int, EmbeddedRun] = {}
    labels: dict[int, tuple[object, ca.MX]] = {}
    for k in range(whole.n_instructions()):
        if whole.instruction_id(k) != ca.OP_CALL:
            continue
        node = whole.instruction_MX(k)
        meaning = meaning_of(node.which_function())
        if isinstance(meaning, Embedding):
            outputs = tuple(node.get_output(i) for i in range(meaning.integration.function.n_out()))
            runs[hash(node)] = EmbeddedRun(meaning.integration, meaning.template, node.dep(0), node.dep(1), outputs)
        elif meaning is not None:
            labels[hash(node)] = (meaning, node)
    return list(runs.values()), list(labels.values())


Vector = NDArray[np.float64]


def is_own(item: Any) -> bool:
    """Return whether a class or a function is the user's, which may raise an error of any kind."""
    return str(item.__module__).partition(".")[0] != __name__.partition(".")[0]


def has_own_law(scene: Scene) -> bool:
    """Return whether a user's class is the law of resistance."""
    return is_own(type(scene.law))


def refusals(parts: Split, symbols: Sequence[ca.MX], *, own_laws_only: bool = False) -> Callable[..., dict[int, str]]:
    """Return a function for the refusals of all scenes in split expressions, or of those with a user's law.

    It takes values of each symbol (a column), with a row for each design, and returns number -> reason of every design
    with a scene outside the model's domain; ``declared`` is as in `DomainCheck.reasons`.
    """
    # Runs that share a template are checked together.
    columns: dict[int, tuple[Scene, list[ca.MX]]] = {}
    for template, column in _scenes(parts):
        if has_own_law(template) or not own_laws_only:
            columns.setdefault(id(template), (template, []))[1].append(column)
    checks: list[tuple[DomainCheck, ca.Function]] = []
    for template, own in columns.values():
        rows = list(zip(*map(ca.vertsplit, own), strict=True))
        numbers = [{float(value) if value.is_constant() else None for value in row} for row in rows[:-1]]
        fixed = [own.pop() if len(own) == 1 else None for own in numbers]
        varying = [ca.horzcat(*row) for row, number in zip(rows, [*fixed, None], strict=True) if number is None]
        quantities = ca.Function("quantities", list(symbols), [ca.densify(ca.vertcat(*varying))])
        checks.append((DomainCheck(template, fixed), quantities))

    def reasons(*rows: Vector, declared: bool = True) -> dict[int, str]:
        found: dict[int, str] = {}
        for check, quantities in checks:
            given = np.asarray(quantities.map(len(rows[0]))(*(row.T for row in rows)))
            for k, reason in check.reasons(given, declared=declared).items():
                found.setdefault(k // quantities.size2_out(0), reason)
        return found

    return reasons


def _scenes(parts: Split) -> Iterator[tuple[Scene, ca.MX]]:
    """Yield the template of each scene, and a column of its quantities and duration."""
    for run in parts.runs:
        yield run.template, ca.vertcat(run.quantities, run.inputs[-1])
    for meaning, carried in parts.labels:
        given = meaning.template[0][:1] if isinstance(meaning, Call) else (meaning,)
        for scene in given:
            if isinstance(scene, Scene):
                # The duration does not matter to a scene without a run.
                yield scene, ca.vertcat(ca.vec(carried), 1.0)


@dataclass(frozen=True)
class RunGroup:
    """Runs that differ only in the values of their parameters, evaluated together by CasADi's `map`.

    A design over many samples of a soil has as many runs of one structure. They share one integrator, and the chain
    rule from a run's parameters to the variables of the design is applied to each run inside the map, so the time to
    build the program does not grow with the number of runs.

    Every matrix that enters or leaves a map has one block of columns for each run. The block is a single column for
    parameters and results, has a column for each variable for derivatives by y, and the columns of a jet for jets.

    Attributes:
        solver: integrates each of the runs.
        first: number of the first result that the design uses. It uses all results from there on; averages come last.
        varying: positions of theta among a run's parameters.
        members: numbers of these runs among all runs of the design.
        inputs: (y, p) -> all parameters of the runs, a column for each run.
        variables: number of variables y.
        compiled: whether first derivatives are machine code; of second ones a compiler takes four times as long.
    """

    solver: Integration
    first: int
    varying: tuple[int, ...]
    members: tuple[int, ...]
    inputs: ca.Function
    variables: int
    compiled: bool

    @property
    def size(self) -> int:
        """Number of results of each run that the design uses."""
        return self.solver.results - self.first

    # Functions of one run, mapped over the runs of the group:

    @cached_property
    def results(self) -> ca.Function:
        """Parameters -> results."""
        p = self._parameters()
        stacked = ca.vertcat(*(ca.vec(result) for result in self.solver.function.call([p])))
        return self._mapped([p], [stacked[self.first :]])

    @cached_property
    def slopes(self) -> ca.Function:
        """(Parameters, theta_y) -> results and o_y."""
        p, theta_y = self._parameters(), self._theta_slopes()
        jet = self._jets(p, 1)
        return self._mapped([p, theta_y], [jet[:, 0], ca.mtimes(jet[:, 1:], theta_y)])

    @cached_property
    def jets(self) -> ca.Function:
        """Parameters -> results, o_theta and, unless the runs have events, second derivatives by pairs of theta."""
        p = self._parameters()
        return self._mapped([p], [self._jets(p, 1 if self._events else 2)])

    @cached_property
    def slopes_of_jets(self) -> ca.Function:
        """(Jets, theta_y) -> results and o_y."""
        jet, theta_y = self._jet(), self._theta_slopes()
        return self._mapped([jet, theta_y], [jet[:, 0], ca.mtimes(jet[:, 1 : 1 + len(self.varying)], theta_y)])

    @cached_property
    def curvature(self) -> ca.Function:
        """(Parameters, jets, theta_y, mu) -> theta_y' (mu' o)_theta,theta theta_y, and c = mu' o_theta as a column.

        Runs with events have no second-order jets: their weighted sum is differentiated instead.
        """
        p, jet, theta_y, mu = self._parameters(), self._jet(), self._theta_slopes(), ca.MX.sym("mu", self.size)
        count = len(self.varying)
        if self._events:
            by_theta = weighted_curvature(self.solver, self.varying)(p, ca.vertcat(ca.MX.zeros(self.first), mu))
        else:
            row, by_theta = ca.mtimes(mu.T, jet[:, 1 + count :]), ca.MX.zeros(count, count)
            for k, (a, b) in enumerate(pairs(count)):
                by_theta[a, b] = by_theta[b, a] = row[k]
        results = [ca.mtimes([theta_y.T, by_theta, theta_y]), ca.mtimes(jet[:, 1 : 1 + count].T, mu)]
        return self._mapped([p, jet, theta_y, mu], [ca.densify(result) for result in results])

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
        return jets_of(self.solver, self.varying, order, compiled=self.compiled and order == 1)(p)[self.first :, :]

    def _mapped(self, inputs: list[ca.MX], results: list[ca.MX]) -> ca.Function:
        """Return a Function of all runs from one of a single run; only the toolkit's own steps run in threads."""
        one, count = ca.Function("one", inputs, results), len(self.members)
        if count == 1:
            return one
        own_steps = self.solver.accuracy.order_8 and self.solver.structure.orbit == "transient"
        if own_steps and (processors := available()) > 1:
            return one.map(count, "thread", processors)
        return one.map(count, "serial")


MANY_STEPS = 3000
"""Least number of steps of a group's runs, all together, at which compiling their jets, half a second, soon pays."""


def grouped_runs(
    runs: Sequence[EmbeddedRun],
    only_averages: Sequence[bool],
    y: ca.MX,
    p: ca.MX,
    steps: Sequence[int | None],
    by_code: float,
) -> list[RunGroup]:
    """Return the runs of a design in groups that share one integrator.

    Args:
        runs: the runs.
        only_averages: for each run, whether the design uses nothing but its averages.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
        by_code: as in `build_nlp`.
    """
    members_of: dict[tuple[int, int], tuple[Integration, list[int]]] = {}
    for k, (run, averages, count) in enumerate(zip(runs, only_averages, steps, strict=True)):
        solver, first = _integration_of(run, averages, count)
        # `integration` returns the same object for the same settings.
        members_of.setdefault((id(solver), first), (solver, []))[1].append(k)
    groups = []
    for (_, first), (solver, members) in members_of.items():
        parameters = ca.horzcat(*(runs[k].inputs for k in members))
        inputs = ca.Function("inputs", [y, p], [ca.densify(parameters)]).expand()
        sparsity = ca.Function("stacked", [y, p], [ca.vec(parameters)]).jac_sparsity(0, 0)
        varying = tuple(sorted({row % parameters.shape[0] for row in sparsity.row()}))
        compiled = len(members) * solver.timeline.steps >= by_code
        groups.append(RunGroup(solver, first, varying, tuple(members), inputs, y.numel(), compiled))
    return groups


def _integration_of(run: EmbeddedRun, only_averages: bool, steps: int | None) -> tuple[Integration, int]:
    """Return the integration of a run, and the number of the first result that the design uses.

    Args:
        run: the run.
        only_averages: whether the design uses nothing but its averages; states at the outputs are then left out.
        steps: number of steps in place of the run's own, or None.
    """
    own = run.integration
    accuracy, timeline = own.accuracy, own.timeline
    if only_averages and accuracy.order_8:
        timeline = replace(timeline, outputs=1, aligned=True)
    if steps is not None:
        timeline = replace(timeline, steps=steps, aligned=timeline.moving)
    solver = integration(own.structure, accuracy, timeline)
    return solver, solver.results - solver.equation.averages if only_averages else 0


@dataclass(frozen=True)
class Nlp:
    """Functions of scaled variables y and parameters p; those of derivatives are built when first needed.

    Attributes:
        values: (y, p) -> (scaled objective f, scaled requirements g), from one integration of each run.
        build_slopes: returns `slopes`.
        build_hessian: returns `hess_lag`, which takes longest to build.
        groups: the runs, with their integrators.
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


def ipopt_functions(values: ca.Function, slopes: ca.Function) -> dict[str, ca.Function]:
    """Return `Nlp.values` and `Nlp.slopes` as the four functions, by name, that CasADi's interface to IPOPT expects."""
    y, p = slopes.mx_in()
    (f, g), (f_again, g_again, gradient, jacobian) = values(y, p), slopes(y, p)
    results: dict[str, dict[str, ca.MX]] = {"f": {"f": f}, "g": {"g": g}}
    results |= {"grad_f": {"f": f_again, "grad_f_x": gradient}, "jac_g": {"g": g_again, "jac_g_x": jacobian}}
    return {name: ca.Function(name, [y, p], list(own.values()), ["x", "p"], list(own)) for name, own in results.items()}


def hessian_function(y: ca.MX, p: ca.MX, lam_f: ca.MX, lam_g: ca.MX, hessian: ca.MX) -> ca.Function:
    """Return `Nlp.hess_lag` from a full Hessian, with the names that CasADi's interface to IPOPT expects."""
    names, result = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    return ca.Function("hess_lag", [y, p, lam_f, lam_g], [ca.triu(hessian)], names, result)


def build_nlp(parts: Split, y: ca.MX, p: ca.MX, steps: list[int | None], by_code: float = MANY_STEPS) -> Nlp:
    """Return the program of an objective and requirements.

    Args:
        parts: objective (first) and requirements (second, a column), split around their runs.
        y: scaled variables.
        p: parameters.
        steps: for each run, the number of steps, or None for the method it was written with.
        by_code: number of steps of a group's runs from which on their first derivatives are machine code.
    """
    every = algebra_of(parts, y, p)
    averages = [averages_only(run, every, 2 + k) for k, run in enumerate(parts.runs)]
    groups = grouped_runs(parts.runs, averages, y, p, steps, by_code)
    alike = tuple((group.first, group.members) for group in groups)
    if alike not in parts.algebra:
        parts.algebra[alike] = _Algebra.around(groups, parts, y, p)
    algebra = parts.algebra[alike]
    o = _column([ca.vec(group.results(group.inputs(y, p))) for group in groups])
    f, g = map(ca.densify, algebra.values(y, p, o))

    def build_slopes() -> ca.Function:
        by_group = [
            group.slopes.call([group.inputs(y, p), theta_y(y, p)])
            for group, theta_y in zip(groups, algebra.theta_slopes, strict=True)
        ]
        o, o_y = _all_results(groups, by_group, y)
        f, g, f_y, f_o, g_y, g_o = algebra.slopes(y, p, o)
        gradient, jacobian = (f_y + ca.mtimes(f_o, o_y)).T, g_y + ca.mtimes(g_o, o_y)
        return ca.Function("slopes", [y, p], [*map(ca.densify, (f, g, gradient, jacobian))])

    def build_hessian() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        return hessian_function(y, p, lam_f, lam_g, _hessian(algebra, groups, (y, p), (lam_f, lam_g)))

    return Nlp(ca.Function("values", [y, p], [f, g]), build_slopes, build_hessian, tuple(groups))


def algebra_of(parts: Split, y: ca.MX, p: ca.MX) -> ca.Function:
    """Return (y, p, results of each run) -> expressions, in scalar operations unless the graph contains maps."""
    whole = ca.Function("whole", [y, p, *parts.results], list(parts.expressions))
    return whole if holds_maps(whole) else whole.expand()


def around_runs(
    algebra: ca.Function, parts: Split, sizes: Mapping[int, int]
) -> tuple[Any, Any, dict[int, Any], Sequence[Any]]:
    """Return symbols of y, p and the last results of each run, as many as are used, and `algebra_of` them."""
    kind: Any = ca.SX if algebra.is_a("SXFunction") else ca.MX
    y, p = kind.sym("y", algebra.numel_in(0)), kind.sym("p", algebra.numel_in(1))
    used = {k: kind.sym("o", size) for k, size in sizes.items()}
    # Zeros stand for the results before the first one used: nothing depends on them.
    padded = [ca.vertcat(kind.zeros(own.numel() - sizes[k]), used[k]) for k, own in enumerate(parts.results)]
    return y, p, used, algebra(y, p, *padded)


def averages_only(run: EmbeddedRun, algebra: ca.Function, result: int) -> bool:
    """Return True if the expressions use nothing of a run but its averages.

    Args:
        run: the run.
        algebra: the expressions as a Function; its input number ``result`` is the run's results.
        result: that number.
    """
    states = sum(output.numel() for output in run.outputs) - run.integration.equation.averages
    columns = (algebra.jac_sparsity(k, result).get_col() for k in range(algebra.n_out()))
    return all(column >= states for own in columns for column in own)


def holds_maps(function: ca.Function) -> bool:
    """Return True if a graph calls mapped Functions, whose operations a scalar form would repeat for every column."""
    calls = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL)
    return any(function.instruction_MX(k).which_function().is_a("Map") for k in calls)


@dataclass(frozen=True)
class _Algebra:
    """The graph around the runs, J and g over (y, p, o), and theta over (y, p); derivatives are built when needed.

    Attributes:
        y: symbol of the variables.
        p: symbol of the parameters.
        o: symbol of the results of all runs.
        objective: J.
        requirements: g.
        groups: the runs.
        theta: for each group, theta as a column.
    """

    y: Any
    p: Any
    o: Any
    objective: Any
    requirements: Any
    groups: list[RunGroup]
    theta: list[Any]

    @classmethod
    def around(cls, groups: list[RunGroup], parts: Split, variables: ca.MX, parameters: ca.MX) -> _Algebra:
        """Write the graph around runs with those results only that the groups provide."""
        sizes = {k: group.size for group in groups for k in group.members}
        y, p, used, (objective, requirements) = around_runs(algebra_of(parts, variables, parameters), parts, sizes)
        theta = [ca.vec(group.inputs(y, p)[list(group.varying), :]) for group in groups]
        return cls(y, p, _column([used[k] for k in sizes], type(y)), objective, requirements, groups, theta)

    @cached_property
    def values(self) -> ca.Function:
        """(y, p, o) -> (J, g)."""
        return ca.Function("values", [self.y, self.p, self.o], [self.objective, self.requirements])

    @cached_property
    def slopes(self) -> ca.Function:
        """(y, p, o) -> (J, g, J_y, J_o, g_y, g_o)."""
        results = [self.objective, self.requirements]
        slopes = [ca.jacobian(e, v) for e in results for v in (self.y, self.o)]
        return ca.Function("slopes", [self.y, self.p, self.o], [*results, *slopes])

    @cached_property
    def curvature(self) -> ca.Function:
        """(y, p, o, S, lam_f, lam_g) -> (L_zz S, L_o).

        The product with S is formed by directional derivatives, because S has few columns, while z may have thousands
        of rows and L_zz may be full.
        """
        kind, variables = type(self.y), self.y.numel()
        lam_f, lam_g = kind.sym("lam_f"), kind.sym("lam_g", self.requirements.numel())
        z = ca.vertcat(self.y, self.o)
        seeds = kind.sym("S", z.numel(), variables)
        gradient = ca.gradient(lam_f * self.objective + ca.dot(lam_g, self.requirements), z)
        results = [ca.jtimes(gradient, z, seeds), gradient[variables:]]
        return ca.Function("curvature", [self.y, self.p, self.o, seeds, lam_f, lam_g], results)

    @cached_property
    def theta_slopes(self) -> list[ca.Function]:
        """For each group, (y, p) -> theta_y, a block of columns for each run."""
        functions = []
        for group, part in zip(self.groups, self.theta, strict=True):
            slopes, count = ca.jacobian(part, self.y), len(group.varying)
            block = ca.horzcat(*(slopes[k * count : (k + 1) * count, :] for k in range(len(group.members))))
            functions.append(ca.Function("theta_slopes", [self.y, self.p], [ca.densify(block)]))
        return functions

    @cached_property
    def theta_curvature(self) -> ca.Function:
        """(y, p, c) -> sum_v c_v theta_v,yy."""
        kind = type(self.y)
        theta = _column(self.theta, kind)
        weights = kind.sym("c", theta.numel())
        bent, _ = ca.hessian(ca.dot(weights, theta), self.y)
        return ca.Function("theta_curvature", [self.y, self.p, weights], [bent])


def _hessian(
    algebra: _Algebra, groups: list[RunGroup], at: tuple[ca.MX, ca.MX], multipliers: tuple[ca.MX, ca.MX]
) -> ca.MX:
    """Return Hess L at (y, p) for multipliers (lam_f, lam_g), from second-order jets of the runs."""
    y, p = at
    theta = [group.inputs(y, p) for group in groups]
    theta_y = [slopes(y, p) for slopes in algebra.theta_slopes]
    jets = [group.jets(own) for group, own in zip(groups, theta, strict=True)]
    by_group = [group.slopes_of_jets.call([*own]) for group, *own in zip(groups, jets, theta_y, strict=True)]
    o, o_y = _all_results(groups, by_group, y)
    s = ca.vertcat(ca.MX.eye(y.numel()), o_y)
    l_zz_s, mu = algebra.curvature(y, p, o, s, *multipliers)
    hessian, weights = ca.mtimes(s.T, l_zz_s), []
    ends = np.cumsum([0, *(group.size * len(group.members) for group in groups)]).tolist()
    for group, i, j, *own in zip(groups, ends, ends[1:], theta, jets, theta_y, strict=False):
        curvature, c = group.curvature.call([*own, ca.reshape(mu[i:j], group.size, -1)])
        # The sum of the runs' square blocks.
        hessian += ca.repsum(curvature, 1, len(group.members))
        weights.append(ca.vec(c))
    return ca.densify(hessian + algebra.theta_curvature(y, p, _column(weights)))


def _all_results(groups: list[RunGroup], by_group: list[list[ca.MX]], y: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Return o and o_y of all runs, from (results, o_y) of each group in blocks of columns."""
    if not by_group:
        return ca.MX(0, 1), ca.MX(0, y.numel())
    # One slice for each variable and none for each run: the graph does not grow with the number of runs.
    slopes = [
        ca.horzcat(*(ca.vec(o_y[:, k :: group.variables]) for k in range(group.variables)))
        for group, (_, o_y) in zip(groups, by_group, strict=True)
    ]
    return ca.vertcat(*(ca.vec(o) for o, _ in by_group)), ca.vertcat(*slopes)


def _column(parts: list[Any], kind: Any = ca.MX) -> Any:
    """Return columns stacked into one; without any, a column of no rows."""
    return ca.vertcat(*parts) if parts else kind(0, 1)


# -freciprocal-math takes the reciprocal of a frequent divisor, such as the inertia, only once.
_FAST = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-freciprocal-math")
_VARIANTS: tuple[Variant, ...] = ((_FAST, ("-lm",)), (("-O1",), ("-lm",)))


def as_machine_code(nlp: Nlp) -> Nlp | None:
    """Return a program with values and first derivatives in machine code, or None without a compiler.

    Second derivatives stay interpreted: few solves need them, and they take a compiler longest.
    """
    y, p = nlp.values.mx_in()
    functions = {"own_values": nlp.values, "own_slopes": nlp.slopes}
    named = [ca.Function(name, [y, p], function.call([y, p])) for name, function in functions.items()]
    if (compiled := in_machine_code(named, _VARIANTS)) is None:
        return None
    values, slopes = compiled
    return replace(nlp, values=values, build_slopes=lambda: slopes)


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
    loose = ca.mtimes(slack_rows, slack)

    def values(objective: ca.MX, g: ca.MX) -> list[ca.MX]:
        # A design without an objective has no value here either, so that IPOPT turns back from it.
        return [ca.sum1(slack) + ca.if_else(ca.fabs(objective) < np.inf, 0.0, np.nan), g + loose]

    def build_slopes() -> ca.Function:
        objective, g, _, jacobian = nlp.slopes(y, p)
        gradient = ca.DM(np.r_[np.zeros(own.numel()), np.ones(2 * count)])
        return ca.Function("slopes", [x, p], [*values(objective, g), gradient, ca.horzcat(jacobian, slack_rows)])

    def build_hessian() -> ca.Function:
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(owner))
        return hessian_function(
            x, p, lam_f, lam_g, ca.diagcat(nlp.hess_lag(y, p, 0.0, lam_g), ca.MX(2 * count, 2 * count))
        )

    return Nlp(ca.Function("values", [x, p], values(*nlp.values(y, p))), build_slopes, build_hessian)


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
