"""Runs that differ in nothing but numbers, carried out side by side by one Function that maps over them.

A design over many samples of a soil holds as many runs of one structure. They share one integrator, and the chain rule
from a run's parameters to the few variables of the design is applied run by run inside the map, so that building takes
no longer for many of them and every evaluation grows with their number alone.

Whatever belongs to one run, such as its parameters, its results or the slopes of either, is a block of columns, and the
blocks of all runs stand side by side: that is the layout which CasADi's `map` takes and gives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.process import available
from plough_opt.design.split import EmbeddedRun
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.jets import jets_of, weighted_curvature
from plough_opt.motion.pooling import pairs
from plough_opt.motion.signals import signals


@dataclass(frozen=True)
class RunGroup:
    """Runs of one structure as the program sees them: their results, or just their averages if no more is asked for.

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
