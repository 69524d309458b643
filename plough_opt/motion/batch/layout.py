"""Positions of the parameters and of the state in the columns of a batch's step, and rates from the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import casadi as ca

from plough_opt.motion.effects import StrengthWaves
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import Structure


@dataclass(frozen=True)
class Layout:
    """Positions in the columns that are the arguments of a step.

    Attributes:
        structure: the terms that are on.
        parameters: names of the equation's parameters; after them follow the end of the ramp [s], the duration [s], the
            longest first step [s] and the error of the deflection [m] that a step may make.
        means: number of signals that are averaged: see `plough_opt.motion.signals`.
        squares: how many of them have an RMS.
    """

    structure: Structure
    parameters: tuple[str, ...]
    means: int
    squares: int

    @classmethod
    def of(cls, structure: Structure) -> Layout:
        """Return the layout of a structure."""
        observed = signals(structure)
        return cls(structure, observed.parameters, observed.count, observed.squared)

    @property
    def ends(self) -> tuple[int, ...]:
        """Positions in the parameters of the time at which each part of the motion ends."""
        after = len(self.parameters)
        return (after, after + 1) if self.structure.ramp else (after + 1,)

    @property
    def longest_first_step(self) -> int:
        """Position in the parameters of the longest first step."""
        return len(self.parameters) + 2

    @property
    def allowed(self) -> int:
        """Position in the parameters of the error that a step may make, the last of them."""
        return len(self.parameters) + 3

    @property
    def state(self) -> int:
        """Size of the state: time, w, w', means, variances, and four numbers for the errors so far.

        Those are the three of `plough_opt.motion.batch.deviation.grown`, and the mean of
        `plough_opt.motion.batch.deviation.square_of_error` over the time until now.
        """
        return 7 + self.means + self.squares

    def value(self, p: ca.SX, name: str) -> ca.SX:
        """Return a parameter by its name, of a column of them."""
        return p[self.parameters.index(name)]

    def own_frequency(self, p: ca.SX) -> ca.SX:
        """Return sqrt(|k|/M) [rad/s]."""
        return ca.sqrt(ca.fabs(self.value(p, "stiffness")) / self.value(p, "inertia"))

    def fastest_frequency(self, p: ca.SX) -> ca.SX:
        """Return the sum of the mount's own frequency and the fastest wave's [rad/s]."""
        known = dict(zip(self.parameters, ca.vertsplit(p), strict=False))
        passing: ca.SX = reduce(ca.fmax, StrengthWaves.imposed(known), ca.SX(0)) / 2.0
        return self.own_frequency(p) + passing
