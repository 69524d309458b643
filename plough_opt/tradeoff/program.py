"""The one program of a trade-off: its parameters say which objective is minimised and where the other must stay.

With weights w, a normal n and a position c as parameters it is

    minimise  w0 + w1 f1/s1 + w2 f2/s2   subject to   n1 f1/s1 + n2 f2/s2 - c <= 0   and the requirements,

which is an objective alone (n = 0), the normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003) with
w and n in units of the objectives' ranges, or the limit of one objective beside the other.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import casadi as ca
import numpy as np

from plough_opt.design import Design
from plough_opt.design.declarations import Parameter, Requirement
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.program import Program
from plough_opt.design.verify import TightEvaluation
from plough_opt.errors import InputError, PloughError
from plough_opt.tradeoff.follower import Follower
from plough_opt.tradeoff.goal import Goal

POSITION = "position on the front"
_FINER = 1.5
# Multipliers below this pull at nothing.
_PULLS = 1e-6
_EXTRA = ("w0", "w1", "w2", "n1", "n2", "c")


class FrontProgram:
    """A design's program with two objectives.

    Attributes:
        program: the program.
        row: number of the constraint that sets the position.
        low: normalised objectives' zero, in scaled units.
        span: their range.
    """

    def __init__(self, design: Design, goals: tuple[Goal, Goal], *, compiled: bool = False) -> None:
        """Declare the program and build it.

        Raises:
            InputError: nothing to vary, a symbol of another design, or a model without a value at the guess.
            DomainError: bounds that lead out of the model's domain.
        """
        own = copy.copy(design)
        own.minimise(goals[0].expression)
        declared = own.declared
        for goal in goals:
            if strangers := declared.strangers(ca.MX(goal.expression)):
                raise InputError(
                    f"the objective '{goal.name}' holds symbols that this design did not declare"
                    f" ({', '.join(strangers)}): make them with design.variable or design.parameter of this design"
                )
        self._values = [parameter.value for parameter in declared.parameters]
        self.scales = _sizes([goal.sign * ca.MX(goal.expression) for goal in goals], declared.symbols(),
                             [*(v.guess for v in declared.variables), *self._values])  # fmt: skip
        scaled = [goal.sign * ca.MX(goal.expression) / s for goal, s in zip(goals, self.scales, strict=True)]
        w0, w1, w2, n1, n2, c = symbols = [ca.MX.sym(name) for name in _EXTRA]
        extra = tuple(Parameter(symbol.name(), symbol, 0.0, "") for symbol in symbols)
        position = Requirement(POSITION, n1 * scaled[0] + n2 * scaled[1] - c, None, 0.0, "")
        self.program = Program(
            replace(
                declared,
                parameters=(*declared.parameters, *extra),
                objective=w0 + w1 * scaled[0] + w2 * scaled[1],
                requirements=(*declared.requirements, position),
            ),
            compiled=compiled,
        )
        self._plain = self.parameters((1.0, 0.0, 0.0), (0.0, 0.0), 1.0)
        self.row = self.program.owner.index(len(declared.requirements))
        self.low, self.span = np.zeros(2), np.ones(2)
        self._refinement = 1.0
        self._build()

    def parameters(self, weights: tuple[float, ...], normal: tuple[float, ...], position: float) -> Vector:
        """Return the program's parameters for (w0, w1, w2), (n1, n2) and c, in scaled units."""
        return np.array([*self._values, *weights, *normal, position])

    def refine(self) -> None:
        """Take more integration steps."""
        self._refinement *= _FINER
        self._build()

    def _build(self) -> None:
        self.program.build(self._plain, self._refinement)
        program = self.program
        sizes = (len(program.declared.variables), len(program.declared.parameters))
        self._follower = Follower(program.nlp, *sizes, program.low, program.high)

    def normalise(self, first: Vector, second: Vector) -> None:
        """Make the scaled objectives of the two anchors (0, 1) and (1, 0)."""
        self.low = np.array([first[0], second[1]])
        self.span = np.array([second[0], first[1]]) - self.low

    # --- questions ---------------------------------------------------------------------------------------

    def alone(self, objective: int, other: float) -> Vector:
        """Return the parameters for one objective, and a little of the other where the first does not care."""
        weights = (1.0, other) if objective == 0 else (other, 1.0)
        return self.parameters((0.0, *weights), (0.0, 0.0), 1.0)

    def beside(self, objective: int, difference: float) -> Vector:
        """Return the parameters for one normalised objective where the other exceeds it by at most so much.

        Args:
            objective: which is minimised, 0 or 1.
            difference: largest value of the other one minus this one, normalised.
        """
        other = 1 - objective
        return self._question(objective, {other: 1.0, objective: -1.0}, difference)

    def below(self, objective: int, limit: float) -> Vector:
        """Return the parameters for one normalised objective with the other one at most at a limit."""
        return self._question(objective, {1 - objective: 1.0}, limit)

    def _question(self, objective: int, normal: dict[int, float], position: float) -> Vector:
        weights, along = np.zeros(2), np.zeros(2)
        weights[objective] = 1.0
        for k, value in normal.items():
            along[k] = value
        offset = -float(np.sum(weights * self.low / self.span))
        shift = float(np.sum(along * self.low / self.span))
        return self.parameters((offset, *(weights / self.span)), tuple(along / self.span), position + shift)

    # --- answers -----------------------------------------------------------------------------------------

    def solve(self, at: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start: from a neighbour's multipliers, without these, or from afar."""
        point = self._follower.follow(at, start, p)
        if not point.solved:
            point = self.program.solve(start, p, near=True)
        return point if point.solved else self.program.solve(start, p)

    def _both(self) -> Vector:
        return self.parameters((0.0, 1.0, 0.0), (0.0, 1.0), 0.0)

    def objectives(self, y: Vector) -> Vector:
        """Return both scaled objectives as the optimiser has them."""
        f, g = (np.asarray(result).ravel() for result in self.program.nlp.values(y, self._both()))
        return np.array([f[0] * self.program.objective_scale, g[self.row] * self._row_scale])

    def exact(self, y: Vector) -> tuple[Vector, list[Vector]]:
        """Return both scaled objectives and all requirements, integrated tightly."""
        found, _ = self.program.exact_values(y, self._both())
        return np.array([found[0].item(), found[1 + self.program.owner[self.row]].item()]), found[1:]

    def numbers(self, y: Vector) -> list[float]:
        """Return the values of all symbols at a design."""
        return [*self.program.values(y), *self._plain]

    def normalised(self, scaled: Vector) -> Vector:
        """Return scaled objectives in units of the front's range."""
        return np.asarray((scaled - self.low) / self.span)

    def gap(self, y: Vector) -> float:
        """Return the largest relative difference of the optimiser's objectives from the tightly integrated ones."""
        exact = self.exact(y)[0]
        return float(np.max(np.abs(self.objectives(y) - exact) / np.maximum(np.abs(exact), 1e-3)))

    def holds(self, point: Point) -> bool:
        """Return whether it is the position that decides where on the front an optimum lies."""
        return bool(point.lam_g[self.row] > _PULLS)

    @property
    def _row_scale(self) -> float:
        return float(self.program.scales[self.program.owner[self.row]])

    def slopes(self, point: Point, p: Vector) -> Vector:
        """Return how strongly an optimum weighs each scaled objective: their gradients so weighted balance."""
        _, w1, w2, n1, n2, _ = p[len(self._values) :]
        pull = point.lam_g[self.row] / self._row_scale
        weights = np.array([w1, w2]) / self.program.objective_scale
        return np.asarray(weights + pull * np.array([n1, n2]))


def _sizes(expressions: list[ca.MX], symbols: list[ca.MX], numbers: list[float]) -> list[float]:
    """Return the sizes of the objectives at the guess, 1 for one that is zero or has no value there."""
    try:
        found, _ = TightEvaluation(expressions, symbols)(numbers)
    except (PloughError, RuntimeError):  # building the program says which of them, and why
        return [1.0] * len(expressions)
    sizes = (abs(float(value.item())) for value in found)
    return [size if np.isfinite(size) and size > 0.0 else 1.0 for size in sizes]
