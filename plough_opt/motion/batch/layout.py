"""The columns of numbers on which a step of a batch works: its state and its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import casadi as ca

from plough_opt.motion.batch.series import Graph, Series, series_of
from plough_opt.motion.effects import StrengthWaves
from plough_opt.motion.equation import equation_of_motion, signals
from plough_opt.motion.terms import Structure


@dataclass(frozen=True)
class Layout:
    """Positions in the columns of state and parameters.

    The parameters are those of the equation of motion, followed by the end of the tow ramp [s], the duration [s], the
    longest first step [s], and the error of the deflection [m] that one step may make.

    The state is time [s], w [m], w' [m/s], the averages so far (means, then variances), `Switch.kept` of each switch of
    the equation, and four numbers for the error so far: the three of the error ellipse, and the time average of the
    squared error of the mount force over the stiffness (see `plough_opt.motion.batch.error_ellipse`).

    Attributes:
        structure: the terms that are on.
        names: names of the equation's parameters.
        averaged: number of signals whose mean is taken: see `plough_opt.motion.equation`.
        squared: how many of these, from the first, also have a variance.
        switches: number of switches that select the formula of the equation of motion.
    """

    structure: Structure
    names: tuple[str, ...]
    averaged: int
    squared: int
    switches: int

    @classmethod
    def of(cls, structure: Structure) -> Layout:
        """Return the layout of a structure."""
        observed, motion = signals(structure), equation_of_motion(structure)
        graph, unknown = Graph(), ca.SX.sym("unknown")
        state, known = [graph.given(unknown) for _ in range(2)], [graph.constant(unknown) for _ in motion.names]
        series_of(graph, motion.function, [[graph.clock(unknown)], state, known])
        return cls(structure, observed.parameters, observed.count, observed.squared, len(graph.switches))

    @property
    def ends(self) -> tuple[int, ...]:
        """Positions of the end times of the motion's phases: a tow ramp, if there is one, and the rest."""
        after = len(self.names)
        return (after, after + 1) if self.structure.ramp else (after + 1,)

    @property
    def longest_first_step(self) -> int:
        """Position of the longest first step."""
        return len(self.names) + 2

    @property
    def allowed_error(self) -> int:
        """Position of the error that one step may make."""
        return len(self.names) + 3

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.names) + 4

    @property
    def states(self) -> int:
        """Size of the state."""
        return 7 + self.averaged + self.squared + self.switches

    def value(self, p: ca.SX, name: str) -> ca.SX:
        """Return a parameter of the equation by its name."""
        return p[self.names.index(name)]

    def mount_frequency(self, p: ca.SX) -> ca.SX:
        """Return sqrt(|k|/M), the angular frequency of the share on its mount [rad/s]."""
        return ca.sqrt(ca.fabs(self.value(p, "stiffness")) / self.value(p, "inertia"))

    def fastest_frequency(self, p: ca.SX) -> ca.SX:
        """Return the sum of the angular frequencies of the mount and of the fastest strength wave [rad/s]."""
        known = dict(zip(self.names, ca.vertsplit(p), strict=False))
        passing: ca.SX = reduce(ca.fmax, StrengthWaves.imposed(known), ca.SX(0)) / 2.0
        return self.mount_frequency(p) + passing


@dataclass(frozen=True)
class StepStart:
    """A design at the start of a step, as symbols.

    Attributes:
        layout: positions in the two columns.
        state: its state.
        p: its parameters.
        ramp_ended: whether the tow ramp is over.
    """

    layout: Layout
    state: ca.SX
    p: ca.SX
    ramp_ended: bool

    def graph(self, kept: Sequence[ca.SX] = ()) -> Graph:
        """Return an empty graph of Taylor series in the time since this moment."""
        return Graph(self.ramp_ended, kept)

    def series(self, graph: Graph, function: ca.Function, motion: list[Series], names: Sequence[str]) -> list[Series]:
        """Enter a Function of (time, (w, w'), parameters) in a graph and return the series of its results.

        Args:
            graph: the graph.
            function: the Function, of SX.
            motion: the series of w and w'.
            names: names of the Function's parameters, in order.
        """
        known = [graph.constant(self.layout.value(self.p, name)) for name in names]
        return series_of(graph, function, [[graph.clock(self.state[0])], motion, known])
