"""Fast, rough evaluation of objective and requirements at very many designs, for searches."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.process import available
from plough_opt.core.rows import by_rows
from plough_opt.design.declarations import Variable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.nlp import EmbeddedRun, Split, algebra_of, averages_only, has_own_law, holds_maps, refusals
from plough_opt.motion.solvers.compiled_steps import ManyRuns
from plough_opt.motion.solvers.integrators import Integration, integration

# Slopes smaller than this count as 0, so that a division by them cannot overflow.
_NO_SLOPE = 1e-300


@dataclass(frozen=True)
class LinearVariable:
    """A variable in which objective and requirements are linear and on which no run depends, like a bound on a peak.

    Its best value follows from the others in closed form, so that it need not be searched. IPOPT keeps it as a
    variable, but of designs drawn at random hardly any would have it near the rows that it bounds.

    Attributes:
        number: of the variable among the design's variables.
        variable: the variable.
        objective: slope of the objective.
        rows: slopes of the requirements' rows.
    """

    number: int
    variable: Variable
    objective: float
    rows: Vector

    def solved(self, points: Vector, f: Vector, g: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector, Vector]:
        """Return designs with this variable at its best value for the others, and their objective and rows.

        Args:
            points: scaled variables, a row for each design.
            f: objective, in its unit.
            g: rows of the requirements, in their units.
            low: lower limits of the rows.
            high: upper limits.
        """
        v, dependent = self.variable, np.flatnonzero(np.abs(self.rows) > _NO_SLOPE)
        y = points[:, self.number]
        value = np.asarray(v.unscaled(y))
        slopes, own = self.rows[dependent], g[:, dependent]
        with np.errstate(invalid="ignore"):
            ends = (low[dependent] - own) / slopes, (high[dependent] - own) / slopes
        # The rows keep their limits for changes of the variable from `least` to `most`.
        least = np.where(slopes > 0.0, *ends).max(axis=1, initial=-np.inf)
        most = np.where(slopes > 0.0, *ends[::-1]).min(axis=1, initial=np.inf)
        smallest = np.minimum(np.maximum(0.0, least), most)
        wanted = least if self.objective > 0.0 else most if self.objective < 0.0 else smallest
        best = np.clip(np.where(np.isnan(wanted), value, value + wanted), v.lower, v.upper)
        moved = points.copy()
        moved[:, self.number] = np.clip(np.asarray(v.scaled(best)), 0.0, 1.0)
        change = best - value
        return moved, f + self.objective * change, g + change[:, None] * self.rows


def linear_variables(
    parts: Split, variables: Sequence[Variable], parameters: Sequence[ca.MX], p: Vector
) -> list[LinearVariable]:
    """Return variables that can be solved for in closed form: see `LinearVariable`. No two of them share a row.

    Args:
        parts: objective and requirements in terms of the variables and parameters, split around their runs.
        variables: of the design. At least one of them remains to be searched.
        parameters: symbols of the parameters.
        p: values of the parameters.
    """
    given = ca.vertcat(*(ca.vec(item) for run in parts.runs for item in (run.inputs, run.quantities)))
    f, g = parts.expressions[0], ca.vertcat(*(ca.vec(one) for one in parts.expressions[1:]))
    changing = ca.vertcat(*(v.symbol for v in variables), *parts.results)
    found: list[LinearVariable] = []
    taken = np.zeros(g.numel(), dtype=bool)
    for number, v in enumerate(variables):
        if len(found) == len(variables) - 1 or (given.numel() and ca.depends_on(given, v.symbol)):
            continue
        slopes = ca.vertcat(ca.jacobian(f, v.symbol), ca.jacobian(g, v.symbol))
        if ca.depends_on(slopes, changing):
            continue
        numbers = ca.Function("slopes", list(parameters), [ca.densify(slopes)]).call([*map(ca.DM, p)])[0]
        objective, *rows = np.asarray(numbers).ravel().tolist()
        own = np.array(rows)
        if np.any(taken & (own != 0.0)) or not np.all(np.isfinite(own)):
            continue
        taken |= own != 0.0
        found.append(LinearVariable(number, v, objective, own))
    return found


# Numbers kept in memory at once: designs are evaluated in chunks of this many results.
_MOST_RESULTS = 4_000_000
# The integrator's tolerance for runs that are integrated one by one, which leaves relative errors of about 1e-5.
_ROUGH_TOLERANCE = 1e-7


@dataclass(frozen=True)
class _Group:
    """Runs of the same structure, which are integrated together.

    Attributes:
        members: their numbers among the design's runs.
        integrate: (parameters, a row for each run; finer=; together=) -> results, a row for each run.
        size: number of results of a run.
    """

    members: tuple[int, ...]
    integrate: Callable[..., Vector]
    size: int


class Population:
    """Objective and requirements of many designs, whose runs each take as many steps as they need.

    Attributes:
        vectorised: whether all runs are integrated together, at about ten microseconds each. Runs with events are
            integrated one by one, which takes a thousand times as long.
        compiled: whether machine code integrates those that are integrated together.
        runs: number of runs in a design.
    """

    def __init__(self, parts: Split, y: ca.MX, p: ca.MX, *, rough: bool = True) -> None:
        """Create the evaluation of an objective and its requirements.

        Args:
            parts: the objective and a column of requirements, split around their runs.
            y: symbol of the scaled variables.
            p: symbol of the parameters.
            rough: whether runs may be integrated by another method than the one the user named, and those that are
                integrated one by one less accurately.
        """
        full = algebra_of(parts, y, p)
        self.runs = len(parts.runs)
        self.vectorised, self.compiled, self._rough = True, True, rough
        members_by_key: dict[object, list[int]] = {}
        for k, run in enumerate(parts.runs):
            averages = averages_only(run, full, 2 + k)
            outputs = 0 if averages else run.integration.timeline.outputs
            structure = run.integration.structure
            stepped = structure.stepped or structure.orbit == "periodic"
            stepped &= rough or run.integration.accuracy.method == "auto"
            key = (structure, outputs) if stepped else k
            members_by_key.setdefault(key, []).append(k)
        self._groups = [self._group(parts, members, key) for key, members in members_by_key.items()]
        inputs = [ca.horzcat(*(parts.runs[k].inputs for k in group.members)) for group in self._groups]
        given = ca.Function("inputs", [y, p], [ca.densify(one) for one in inputs])
        self._inputs = by_rows(given if holds_maps(given) else given.expand())
        algebra = _algebra_of_groups(full, parts, self._groups)
        self._algebra, self._rows = by_rows(algebra), algebra.numel_out(1)
        self._own_laws = refusals(parts, [y, p], has_own_law)

    def _group(self, parts: Split, members: list[int], key: object) -> _Group:
        if isinstance(key, tuple):
            try:
                many = ManyRuns(*key)
            except InputError:  # an operation without a vector form
                pass
            else:
                self.compiled &= many.compiled
                return _Group(tuple(members), partial(many, threads=available()), many.size)
        run = parts.runs[members[0]]
        self.vectorised = False
        solver = _rough_integration(run) if self._rough else run.integration
        return _Group(tuple(members), lambda theta, **_: _one_by_one(solver, theta), solver.results)

    @np.errstate(all="ignore")
    def __call__(self, points: Vector, p: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the objective and the requirements, a row for each design; NaN where it cannot be evaluated.

        Args:
            points: scaled variables, a row for each design.
            p: parameters.
            finer: factor on the number of integration steps.
            together: this many consecutive designs are integrated with equal numbers of steps.
        """
        results_per_design = max(1, sum(group.size * len(group.members) for group in self._groups) + self._rows)
        chunk = max(1, _MOST_RESULTS // results_per_design // together) * together
        f, g = np.empty(len(points)), np.empty((len(points), self._rows))
        for first in range(0, len(points), chunk):
            part = slice(first, first + chunk)
            f[part], g[part] = self._values(points[part], p, finer, together)
        return f, g

    def _values(self, points: Vector, p: Vector, finer: float, together: int) -> tuple[Vector, Vector]:
        n = len(points)
        given = [points, np.repeat(p[None], n, axis=0)]
        results = []
        for group, theta in zip(self._groups, self._inputs(*given), strict=True):
            # The same run of consecutive designs takes equal steps: sort the rows by run, then by design.
            if (count := len(group.members)) == 1:
                results.append(group.integrate(theta, finer=finer, together=together))
                continue
            rows = theta.reshape(n, count, -1).transpose(1, 0, 2).reshape(n * count, -1)
            found = group.integrate(rows, finer=finer, together=together).reshape(count, n, -1)
            results.append(found.transpose(1, 0, 2).reshape(n, -1))
        f, g = self._algebra(*given, *results)
        # A user's law may refuse numbers although its expressions have values.
        f[[*self._own_laws(*given, declared=False)]] = np.nan
        return f.ravel(), g


def _algebra_of_groups(full: ca.Function, parts: Split, groups: list[_Group]) -> ca.Function:
    """Return the Function (y, p, stacked results of each group's members) -> (objective, requirements)."""
    kind: Any = ca.SX if full.is_a("SXFunction") else ca.MX
    y, p = kind.sym("y", full.numel_in(0)), kind.sym("p", full.numel_in(1))
    given, results = [], {}
    for group in groups:
        column = kind.sym("o", group.size * len(group.members))
        given.append(column)
        for j, k in enumerate(group.members):
            own = column[j * group.size : (j + 1) * group.size]
            results[k] = ca.vertcat(kind.zeros(parts.results[k].numel() - group.size), own)
    ordered = map(results.__getitem__, range(len(parts.results)))
    return ca.Function("algebra", [y, p, *given], [ca.densify(one) for one in full(y, p, *ordered)])


def _rough_integration(run: EmbeddedRun) -> Integration:
    """Return a less accurate integration of a run: with a loose tolerance."""
    own = run.integration
    if own.accuracy.adaptive:
        return integration(own.structure, replace(own.accuracy, tolerance=_ROUGH_TOLERANCE), own.timeline)
    return own


def _one_by_one(solver: Integration, theta: Vector) -> Vector:
    """Return the results of runs that are integrated one by one, a row each; NaN where an integration fails."""
    found = np.full((len(theta), solver.results), np.nan)
    for k, row in enumerate(theta):
        try:
            found[k] = np.concatenate([np.asarray(part).ravel(order="F") for part in solver.function.call([row])])
        except RuntimeError:  # no orbit exists, or the integration does not finish
            continue
    return found
