"""Runs that differ in nothing but numbers, carried out side by side by one Function that maps over them.

A design over many samples of a soil holds as many runs of one structure. They share one integrator, and the chain rule
from a run's parameters to the few variables of the design is applied run by run inside the map, so that building takes
no longer for many of them and every evaluation grows with their number alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.processors import available
from plough_opt.design.split import EmbeddedRun
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.jets import jets_of, weighted_curvature
from plough_opt.motion.pooling import pairs
from plough_opt.motion.signals import signals


@dataclass(frozen=True)
class Alike:
    """Runs of one structure as the program sees them: their results, or just their averages if no more is asked for.

    Attributes:
        solver: what integrates each of them.
        first: number of the first result that is asked for; the others follow.
        varying: positions of the parameters that vary.
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
        function = self.solver.function
        return sum(function.numel_out(k) for k in range(function.n_out())) - self.first

    @cached_property
    def value(self) -> ca.Function:
        """Parameters -> results, a column for each run."""
        p = self._parameters()
        stacked = ca.vertcat(*(ca.vec(result) for result in self.solver.function.call([p])))
        return self._mapped(ca.Function("value", [p], [stacked[self.first :]]))

    @cached_property
    def slopes(self) -> ca.Function:
        """(Parameters, their slopes by y) -> results and their slopes by y, side by side for each run."""
        p, theta_y = self._parameters(), self._theta_slopes()
        jet = self._jets(1)(p)
        return self._mapped(ca.Function("slopes", [p, theta_y], [jet[:, 0], ca.mtimes(jet[:, 1:], theta_y)]))

    @cached_property
    def jets(self) -> ca.Function:
        """Parameters -> results with first and second derivatives by the varying ones; through events without these."""
        return self._mapped(self._jets(1 if self._events else 2))

    @cached_property
    def chained(self) -> ca.Function:
        """(Jets, slopes of the parameters by y) -> results and their slopes by y, side by side for each run."""
        jet, theta_y = self._jet(), self._theta_slopes()
        slopes = ca.mtimes(jet[:, 1 : 1 + len(self.varying)], theta_y)
        return self._mapped(ca.Function("chained", [jet, theta_y], [jet[:, 0], slopes]))

    @cached_property
    def bent(self) -> ca.Function:
        """(Parameters, jets, slopes of the parameters by y, adjoints of the results) -> second derivatives by y.

        These are through the runs' own curvature; beside them the adjoints of the varying parameters.
        """
        p, jet, theta_y, mu = self._parameters(), self._jet(), self._theta_slopes(), ca.MX.sym("mu", self.size)
        count = len(self.varying)
        if self._events:
            curvature = weighted_curvature(self.solver, self.varying)(p, ca.vertcat(ca.MX.zeros(self.first), mu))
        else:
            row, curvature = ca.mtimes(mu.T, jet[:, 1 + count :]), ca.MX.zeros(count, count)
            for k, (a, b) in enumerate(pairs(count)):
                curvature[a, b] = curvature[b, a] = row[k]
        results = [ca.mtimes([theta_y.T, curvature, theta_y]), ca.mtimes(jet[:, 1 : 1 + count].T, mu)]
        return self._mapped(ca.Function("bent", [p, jet, theta_y, mu], [ca.densify(result) for result in results]))

    def stacked(self, slopes: ca.MX) -> ca.MX:
        """Return slopes by y that lie side by side for each run as one matrix, a row for each result."""
        columns = [ca.vec(slopes[:, k :: self.variables]) for k in range(self.variables)]
        return ca.horzcat(*columns)

    def beside(self, slopes: Any) -> Any:
        """Return slopes of all varying parameters by y, run below run, as blocks side by side."""
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

    def _jets(self, order: int) -> ca.Function:
        p = self._parameters()
        return ca.Function("jets", [p], [jets_of(self.solver, self.varying, order)(p)[self.first :, :]])

    def _mapped(self, function: ca.Function) -> ca.Function:
        """Return a Function of one run as one of all of them, our own steps on all processors that it may keep busy."""
        if len(self.members) == 1:
            return function
        own = self.solver.accuracy.order_8 and self.solver.structure.orbit == "transient"
        if own and (processors := available()) > 1:
            return function.map(len(self.members), "thread", processors)
        return function.map(len(self.members), "serial")


def alike_runs(
    runs: Sequence[EmbeddedRun], only_averages: Sequence[bool], y: ca.MX, p: ca.MX, steps: Sequence[int | None]
) -> list[Alike]:
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
    alike = []
    for (_, first), (solver, members) in found.items():
        parameters = ca.horzcat(*(runs[k].inputs for k in members))
        inputs = ca.Function("inputs", [y, p], [ca.densify(parameters)]).expand()
        rows = parameters.shape[0]
        sparsity = ca.Function("given", [y, p], [ca.vec(parameters)]).jac_sparsity(0, 0)
        varying = tuple(sorted({row % rows for row in sparsity.row()}))
        alike.append(Alike(solver, first, varying, tuple(members), inputs, y.numel()))
    return alike


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
    size = sum(solver.function.numel_out(k) for k in range(solver.function.n_out()))
    return solver, size - observed.count - observed.squared if only_averages else 0
