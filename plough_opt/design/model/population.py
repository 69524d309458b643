"""Fast, rough evaluation of objective and requirements at very many designs, for searches."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np

from plough_opt.core.compiler import by_rows
from plough_opt.core.errors import InputError
from plough_opt.core.process import available
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.nlp import EmbeddedRun, Split, algebra_of, around_runs, averages_only, holds_maps, refusals
from plough_opt.motion.solvers.compiled_steps import ManyRuns
from plough_opt.motion.solvers.integrators import Integration, integration

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
        sizes = {k: group.size for group in self._groups for k in group.members}
        own_y, own_p, used, values = around_runs(full, parts, sizes)
        columns = [ca.vertcat(*(used[k] for k in group.members)) for group in self._groups]
        algebra = ca.Function("algebra", [own_y, own_p, *columns], [ca.densify(value) for value in values])
        self._algebra, self._rows = by_rows(algebra), algebra.numel_out(1)
        self._own_laws = refusals(parts, [y, p], own_laws_only=True)

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
