"""The one program of a trade-off: its parameters say which objective is minimised and where the others must stay.

With weights w, and for each further objective a normal n and a position c, all of them parameters, it is

    minimise  w0 + sum_i w_i f_i/s_i   subject to   sum_i n_ki f_i/s_i - c_k <= 0   and the requirements,

which is an objective alone (n = 0), the normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003; of three
objectives Messac and Mattson 2004) with w and n in units of the objectives' ranges, or limits of the others beside one.
"""

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, PloughError
from plough_opt.design import Design
from plough_opt.design.declarations import Declarations, Parameter, Requirement
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.program import Program
from plough_opt.design.verify import TightEvaluation
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.studies.tradeoff.front import Goal
from plough_opt.studies.tradeoff.level import BatchLevel, Level

_POSITION = "position on the front"
_FINER = 1.5
# Multipliers below this pull at nothing.
_PULLS = 1e-6


class FrontProgram:
    """A design's program with several objectives.

    Attributes:
        program: the program.
        count: number of objectives.
        declared: by the design.
        scales: sizes of the objectives, in their units.
        signs: -1 for an objective that is maximised.
        units: what a scaled objective is multiplied by to be one in its unit.
        rows: numbers of the constraints that set the position.
        levels: what solves the built program, by whether with exact slopes. Without them it does by the steps of a
            batch, with slopes by differences; where no run takes automatic steps, or runs are integrated one by one,
            both are exact.
        low: normalised objectives' zero, in scaled units.
        span: their range.
        building: time that was spent on writing it since it was last prepared [s].
        rounded_off: largest part of an objective by which it changes and is taken to change by nothing.
    """

    def __init__(self, declared: Declarations, goals: Sequence[Goal], *, compiled: bool = False) -> None:
        """Declare the program of a design's `declarations`.

        Raises:
            InputError: a symbol of another design.
        """
        for goal in goals:
            if strangers := declared.strangers(ca.MX(goal.expression)):
                raise InputError(
                    f"the objective '{goal.name}' holds symbols that this design did not declare"
                    f" ({', '.join(strangers)}): make them with design.variable or design.parameter of this design"
                )
        self.count = len(goals)
        self.signs = np.array([goal.sign for goal in goals])
        self.declared = declared
        self._values = [parameter.value for parameter in declared.parameters]
        self.scales = _sizes([goal.sign * ca.MX(goal.expression) for goal in goals], declared.symbols(),
                             [*(v.guess for v in declared.variables), *self._values])  # fmt: skip
        self.units = self.signs * self.scales
        scaled = ca.vertcat(
            *(goal.sign * ca.MX(goal.expression) / s for goal, s in zip(goals, self.scales, strict=True))
        )
        count = self.count
        own = [ca.MX.sym(f"{_POSITION} {k}") for k in range(count * (count + 1))]
        weights, limits = ca.vertcat(*own[: 1 + count]), ca.vertcat(*own[1 - count :])
        normals = ca.reshape(ca.vertcat(*own[1 + count : 1 - count]), count, count - 1).T
        self.program = Program(
            replace(
                declared,
                parameters=(*declared.parameters, *(Parameter(symbol.name(), symbol, 0.0, "") for symbol in own)),
                objective=weights[0] + ca.dot(weights[1:], scaled),
                requirements=(
                    *declared.requirements,
                    Requirement(_POSITION, normals @ scaled - limits, None, 0.0, ""),
                ),
            ),
            compiled=compiled,
        )
        first = self.program.owner.index(len(declared.requirements))
        self.rows = np.arange(first, first + count - 1)
        self._tight: dict[bytes, tuple[Vector, list[Vector]]] = {}
        self.levels: dict[bool, Level] = {}
        self.building = 0.0
        self.rounded_off = 0.0
        self._refinement = 1.0
        self._starts: list[Vector] = []

    def prepare(self, values: Vector) -> None:
        """Check the program for values of the design's parameters.

        Args:
            values: of the parameters, as they were declared.

        Raises:
            InputError: a model without a value at the guess and in a sample.
            DomainError: bounds that lead out of the model's domain.
        """
        self._values = values.tolist()
        self._tight.clear()
        self.levels.clear()
        self.normalise(np.zeros(self.count), np.ones(self.count))
        # With these parameters objective and positions are the scaled objectives.
        count = self.count
        self._all = self.parameters((0.0, 1.0, *np.zeros(count - 1)), np.eye(count)[1:], np.zeros(count - 1))
        self._refinement, self.building = 1.0, 0.0
        self.program.prepare(self.nowhere())

    def own_values(self) -> dict[str, float]:
        """Return the values of the design's own parameters by name."""
        return {p.name: float(value) for p, value in zip(self.declared.parameters, self._values, strict=True)}

    def parameters(self, weights: Sequence[float], normals: Vector, positions: Vector) -> Vector:
        """Return the program's parameters for w, n (a row for each position) and c, in scaled units."""
        return np.array([*self._values, *weights, *np.ravel(normals), *positions])

    def build(self, starts: Sequence[Vector]) -> None:
        """Write the program with enough integration steps at some scaled designs, or keep what is written."""
        self._starts = list(starts)
        self._build()

    def refine(self) -> None:
        """Take more integration steps."""
        self._refinement *= _FINER
        self._build()

    def _build(self) -> None:
        program, began = self.program, time.perf_counter()
        program.build(self.nowhere(), self._refinement, self._starts)
        self.building += time.perf_counter() - began
        if not self.levels or self.levels[True].nlp is not program.built.nlp:
            batched = program.wanted_error and program.population.vectorised
            self.levels[True] = Level(program)
            self.levels[False] = BatchLevel(program) if batched else self.levels[True]
        self.normalise(self.low, self.span)

    def nowhere(self) -> Vector:
        """Return parameters with which the objective is 1 and no position is set.

        The program is scaled by its values with these, so that the scales of objective and positions are 1.
        """
        nothing = self.weighted(np.zeros(self.count))
        nothing[len(self._values)] = 1.0
        return nothing

    def normalise(self, low: Vector, span: Vector) -> None:
        """Set the scaled objectives that are 0, and the range that is 1."""
        self.low, self.span = low, span
        quick = self.levels.get(False)
        if isinstance(quick, BatchLevel):
            quick.normalised(float(np.max((np.abs(low) + span) / span)))

    # --- questions ---------------------------------------------------------------------------------------

    def weighted(self, weights: Vector) -> Vector:
        """Return the parameters for a weighted sum of the scaled objectives."""
        count = self.count
        return self.parameters((0.0, *weights), np.zeros((count - 1, count)), np.ones(count - 1))

    def limited(
        self, objective: int, limits: Mapping[int, float], others: float = 0.0, *, beside: bool = False
    ) -> Vector:
        """Return the parameters for one normalised objective with limits on the others.

        Args:
            objective: which is minimised.
            limits: largest value of each other one, normalised.
            others: weight of the others, which decides what the limits leave open.
            beside: whether limits are on what the others exceed the objective by.
        """
        weights, normals = np.full(self.count, others), np.zeros((self.count - 1, self.count))
        weights[objective] = 1.0
        normals[np.arange(len(limits)), list(limits)] = 1.0
        normals[:, objective] = -1.0 if beside else 0.0
        zero = self.low / self.span
        return self.parameters(
            (-float(weights @ zero), *(weights / self.span)),
            normals / self.span,
            np.array(list(limits.values())) + normals @ zero,
        )

    def question(self, p: Vector) -> tuple[Vector, Vector, Vector]:
        """Return w, n and c of parameters."""
        count, own = self.count, p[len(self._values) :]
        return own[: 1 + count], own[1 + count : 1 - count].reshape(count - 1, count), own[1 - count :]

    # --- answers -----------------------------------------------------------------------------------------

    def solve(self, at: Point, start: Vector, p: Vector, *, exact: bool = False) -> Point:
        """Return the optimum near a start: from a neighbour's multipliers, or without these.

        Args:
            at: the neighbour.
            start: scaled variables.
            p: parameters.
            exact: whether with exact slopes.
        """
        level = self.levels[exact]
        point = level.correct(at, start, p)
        return point if point.solved else level.from_afar(at, start, p)

    def objectives(self, y: Vector, *, exact: bool = False) -> Vector:
        """Return the normalised objectives as the optimiser has them."""
        f, g = self.levels[exact].values(y, self._all)
        return self.normalised(np.concatenate([f, g[self.rows]]))

    def look(self, points: Vector, finer: float, together: int) -> tuple[Vector, Vector]:
        """Return scaled objectives and all rows of requirements, in their units, of designs, a row for each.

        Args:
            points: scaled variables.
            finer: as in `Population`.
            together: as in `Population`.
        """
        with np.errstate(all="ignore"):
            f, g = self.program.population(points, self._all, finer=finer, together=together)
        return np.column_stack([f, g[:, self.rows]]), g

    def tight(self, y: Vector) -> tuple[Vector, list[Vector]]:
        """Return the scaled objectives and all requirements, integrated tightly."""
        key = y.tobytes()
        if key not in self._tight:
            found = self.program.exact.values([*self.program.values(y), *self._all])
            row = 1 + self.program.owner[self.rows[0]]
            self._tight[key] = np.concatenate([found[0].ravel(), found[row].ravel()]), found[1:]
        return self._tight[key]

    def runs(self, y: Vector) -> list[Run]:
        """Return the runs at a design, integrated tightly."""
        exact = self.program.exact
        return [exact.followed(k, *exact.inputs(k, self._numbers(y))) for k in range(len(exact.runs))]

    def still_scenes(self, y: Vector) -> list[Scene]:
        """Return the scenes at a design, with numbers, that are not integrated."""
        return self.program.exact.quasi_static_scenes(self._numbers(y))

    def _numbers(self, y: Vector) -> list[float]:
        """Return the values of all symbols at a design."""
        return [*self.program.values(y), *self.nowhere()]

    def normalised(self, scaled: Vector) -> Vector:
        """Return scaled objectives in units of the front's range."""
        return np.asarray((scaled - self.low) / self.span)

    def scaled(self, normalised: Vector) -> Vector:
        """Return objectives in units of the front's range as the program scales them."""
        return np.asarray(normalised * self.span + self.low)

    def gap(self, y: Vector, *, exact: bool = True) -> float:
        """Return the largest relative difference of the optimiser's objectives from the tightly integrated ones."""
        found, tight = self.scaled(self.objectives(y, exact=exact)), self.tight(y)[0]
        return float(np.max(np.abs(found - tight) / np.maximum(np.abs(tight), 1e-3)))

    def holds(self, point: Point) -> bool:
        """Return whether it is the position that decides where on the front an optimum lies."""
        return bool(np.all(point.lam_g[self.rows] > _PULLS))

    def slopes(self, point: Point, p: Vector) -> Vector:
        """Return how strongly an optimum weighs each scaled objective: their gradients so weighted balance."""
        weights, normals, _ = self.question(p)
        return np.asarray(weights[1:] + point.lam_g[self.rows] @ normals)


def declarations(design: Design, goals: Sequence[Goal]) -> Declarations:
    """Return what a design declares, with an objective in the place of its own.

    Raises:
        InputError: nothing to vary.
    """
    own = copy.copy(design)
    own.minimise(goals[0].expression)
    return own.declared


def _sizes(expressions: list[ca.MX], symbols: list[ca.MX], numbers: list[float]) -> list[float]:
    """Return the sizes of the objectives at the guess, 1 for one that is zero or has no value there."""
    try:
        found = TightEvaluation(expressions, symbols).values(numbers)
    except (PloughError, RuntimeError):  # building the program says which of them, and why
        return [1.0] * len(expressions)
    sizes = (abs(float(value.item())) for value in found)
    return [size if np.isfinite(size) and size > 0.0 else 1.0 for size in sizes]
