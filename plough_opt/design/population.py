"""Objective and requirements at very many designs, side by side and roughly: what a search looks at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.process import available
from plough_opt.design.declarations import Variable
from plough_opt.design.ipopt import Vector
from plough_opt.design.nlp import algebra_of, averages_only, holds_maps
from plough_opt.design.split import EmbeddedRun, Split, split
from plough_opt.motion.batch.many_runs import ManyRuns
from plough_opt.motion.integrators import Integration, integration

# Slopes below this, scaled, are none.
_NO_SLOPE = 1e-300


@dataclass(frozen=True)
class Linear:
    """A variable that enters no run and all else in proportion, as a peak's bound: it is solved from the algebra.

    Attributes:
        number: of the variable.
        variable: the variable.
        objective: slope of the objective.
        rows: slopes of the requirements' rows.
    """

    number: int
    variable: Variable
    objective: float
    rows: Vector

    def settled(self, points: Vector, f: Vector, g: Vector, low: Vector, high: Vector) -> tuple[Vector, Vector, Vector]:
        """Return designs with this variable where it is best, the others held, with their objective and rows.

        Args:
            points: scaled variables, a row for each design.
            f: objective, in its unit.
            g: rows of the requirements, in their units.
            low: lower limits of the rows.
            high: upper limits.
        """
        v, moving = self.variable, np.flatnonzero(np.abs(self.rows) > _NO_SLOPE)
        y = points[:, self.number]
        value = np.asarray(v.unscaled(y))
        slopes, own = self.rows[moving], g[:, moving]
        with np.errstate(invalid="ignore"):
            ends = (low[moving] - own) / slopes, (high[moving] - own) / slopes
        least = np.where(slopes > 0.0, *ends).max(axis=1, initial=-np.inf)
        most = np.where(slopes > 0.0, *ends[::-1]).min(axis=1, initial=np.inf)
        nearest = np.minimum(np.maximum(0.0, least), most)
        wanted = least if self.objective > 0.0 else most if self.objective < 0.0 else nearest
        best = np.clip(np.where(np.isnan(wanted), value, value + wanted), v.lower, v.upper)
        moved = points.copy()
        moved[:, self.number] = np.clip(np.asarray(v.scaled(best)), 0.0, 1.0)
        change = best - value
        return moved, f + self.objective * change, g + change[:, None] * self.rows


def linear_variables(
    expressions: Sequence[ca.MX], variables: Sequence[Variable], parameters: Sequence[ca.MX], p: Vector
) -> list[Linear]:
    """Return the variables that enter no run, and objective and requirements in proportion; no two the same row.

    Args:
        expressions: objective and requirements of the variables and parameters.
        variables: of the design, one of which at least is left out.
        parameters: their symbols.
        p: parameters.
    """
    symbols = [v.symbol for v in variables]
    parts = split(list(expressions), [*symbols, *parameters])
    given = ca.vertcat(*(ca.vec(item) for run in parts.runs for item in (run.inputs, run.quantities)))
    f, g = parts.expressions[0], ca.vertcat(*(ca.vec(one) for one in parts.expressions[1:]))
    changing = ca.vertcat(*symbols, *parts.results)
    found: list[Linear] = []
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
        found.append(Linear(number, v, objective, own))
    return found


# Numbers of results that are in memory at once.
_MOST_RESULTS = 4_000_000
# Rows of the largest map of algebra over designs: many beside what a call costs, few to make; and up to how many, as
# descents take, there is a map for each number of them.
_MOST_MAPPED, _FEW = 256, 12
# Of runs that are integrated one by one, for a look at them: of some 1e-5.
_TOLERANCE = 1e-7
_HARMONICS = 8


@dataclass(frozen=True)
class _Group:
    """Runs of one structure that are followed together.

    Attributes:
        members: their numbers among the design's runs.
        follow: (parameters, a row for each run; finer; together) -> results, a row for each.
        size: number of results of each.
    """

    members: tuple[int, ...]
    follow: Callable[[Vector, float, int], Vector]
    size: int


class Population:
    """Objective and requirements of many designs, by steps of each design's own.

    Attributes:
        vectorised: whether all runs are followed side by side, some ten microseconds each; runs with events and lasting
            orbits are integrated one by one, at a thousand times that.
        runs: number of runs in a design.
    """

    def __init__(self, parts: Split, y: ca.MX, p: ca.MX, *, rough: bool = True) -> None:
        """Take objective (first) and requirements (second, a column) of scaled variables y and of parameters p.

        Args:
            parts: the expressions, split around their runs.
            y: scaled variables.
            p: parameters.
            rough: whether runs that go one by one are integrated roughly, and runs of a method that was named by steps.
        """
        full = algebra_of(parts, y, p)
        self.runs = len(parts.runs)
        self.vectorised, self._rough = True, rough
        found: dict[object, list[int]] = {}
        for k, run in enumerate(parts.runs):
            averages = averages_only(run, full, 2 + k)
            outputs = 0 if averages else run.integration.timeline.outputs
            stepped = run.integration.structure.stepped and (rough or run.integration.accuracy.method == "auto")
            key = (run.integration.structure, outputs) if stepped else k
            found.setdefault(key, []).append(k)
        self._groups = [self._group(parts, members, key) for key, members in found.items()]
        inputs = [ca.horzcat(*(parts.runs[k].inputs for k in group.members)) for group in self._groups]
        given = ca.Function("inputs", [y, p], [ca.densify(one) for one in inputs])
        self._inputs = _OfRows(given if holds_maps(given) else given.expand())
        self._algebra = _OfRows(_of_groups(full, parts, self._groups))
        self._rows = self._algebra.function.numel_out(1)

    def _group(self, parts: Split, members: list[int], key: object) -> _Group:
        if isinstance(key, tuple):
            try:
                many = ManyRuns(*key)
            except InputError:  # an operation without a vector form
                pass
            else:
                threads = available()

                def follow(theta: Vector, finer: float, together: int) -> Vector:
                    return many(theta, finer=finer, together=together, threads=threads)

                return _Group(tuple(members), follow, many.size)
        self.vectorised = False
        run = parts.runs[members[0]]
        solver = _roughly(run) if self._rough else run.integration
        return _Group(tuple(members), lambda theta, _finer, _together: _each(solver, theta), solver.results)

    def __call__(self, points: Vector, p: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the objective, and the requirements, a row for each design; NaN where a design has no value.

        Args:
            points: scaled variables, a row for each design.
            p: parameters.
            finer: factor on the steps of the runs.
            together: designs, of rows one after the other, whose runs take equal numbers of steps.
        """
        each = max(1, sum(group.size * len(group.members) for group in self._groups) + self._rows)
        chunk = max(1, _MOST_RESULTS // each // together) * together
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
            # Runs of equal steps are the same run of designs one after the other.
            count = len(group.members)
            rows = theta.reshape(n, count, -1).transpose(1, 0, 2).reshape(n * count, -1)
            found = group.follow(rows, finer, together).reshape(count, n, -1)
            results.append(found.transpose(1, 0, 2).reshape(n, -1))
        f, g = self._algebra(*given, *results)
        return f.ravel(), g


class _OfRows:
    """A Function of dense columns, of many of them at once: a row of each argument and each result for each."""

    def __init__(self, function: ca.Function) -> None:
        """Take the Function."""
        self.function = function
        self._sizes_in = [function.numel_in(k) for k in range(function.n_in())]
        self._sizes = [function.numel_out(k) for k in range(function.n_out())]
        # By number of rows: its map with what evaluates it. Maps take long to make, the longer the more rows they have.
        self._buffers: dict[int, tuple[Any, Callable[[], None]]] = {}

    def __call__(self, *arguments: Vector) -> list[Vector]:
        """Return the results."""
        count = len(arguments[0])
        kept = [np.ascontiguousarray(argument, dtype=float).reshape(-1) for argument in arguments]
        results = [np.empty((count, size)) for size in self._sizes]
        flat = [result.reshape(-1) for result in results]
        first = 0
        while first < count:
            left = count - first
            rows = left if left <= _FEW else min(_MOST_MAPPED, 1 << (left.bit_length() - 1))
            buffer, evaluate = self._buffer(rows)
            for k, (array, size) in enumerate(zip(kept, self._sizes_in, strict=True)):
                buffer.set_arg(k, array[first * size : (first + rows) * size].data)
            for k, (array, size) in enumerate(zip(flat, self._sizes, strict=True)):
                buffer.set_res(k, array[first * size : (first + rows) * size].data)
            evaluate()
            first += rows
        return results

    def _buffer(self, rows: int) -> tuple[Any, Callable[[], None]]:
        if rows not in self._buffers:
            mapped = self.function.map(rows) if rows > 1 else self.function
            made: Any = mapped.buffer()  # its stubs know no arrays
            self._buffers[rows] = made
        return self._buffers[rows]


def _of_groups(full: ca.Function, parts: Split, groups: list[_Group]) -> ca.Function:
    """Return (y, p, results of each group's members, one below the other) -> (objective, requirements)."""
    kind: Any = ca.SX if full.is_a("SXFunction") else ca.MX
    y, p = kind.sym("y", full.numel_in(0)), kind.sym("p", full.numel_in(1))
    given, results = [], {}
    for group in groups:
        column = kind.sym("o", group.size * len(group.members))
        given.append(column)
        for j, k in enumerate(group.members):
            own = column[j * group.size : (j + 1) * group.size]
            results[k] = ca.vertcat(kind.zeros(parts.results[k].numel() - group.size), own)
    ordered = [results[k] for k in range(len(parts.results))]
    return ca.Function("algebra", [y, p, *given], [ca.densify(one) for one in full(y, p, *ordered)])


def _roughly(run: EmbeddedRun) -> Integration:
    """Return what integrates a run one by one and roughly: events by a loose tolerance, orbits by few harmonics."""
    own = run.integration
    if own.structure.orbit == "periodic":
        structure = replace(own.structure, orbit="harmonic_balance", harmonics=_HARMONICS)
        return integration(structure, own.accuracy, own.timeline)
    if own.accuracy.adaptive:
        return integration(own.structure, replace(own.accuracy, tolerance=_TOLERANCE), own.timeline)
    return own


def _each(solver: Integration, theta: Vector) -> Vector:
    """Return the results of runs, a row each, integrated one by one; NaN where that fails."""
    found = np.full((len(theta), solver.results), np.nan)
    for k, row in enumerate(theta):
        try:
            found[k] = np.concatenate([np.asarray(part).ravel(order="F") for part in solver.function.call([row])])
        except RuntimeError:  # no orbit, or no end of an integration
            continue
    return found
