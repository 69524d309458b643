"""Program of a trade-off: its parameters choose which objective is minimised and where the others must stay.

With weights w, and for each further objective a normal n and a limit c, all of them parameters, the program is

    minimise  w0 + sum_i w_i f_i/s_i   subject to   sum_i n_ki f_i/s_i - c_k <= 0   and the requirements.

One choice of parameters is one subproblem: an objective alone (n = 0), an objective with limits on the others, or the
normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003; for three objectives Messac and Mattson 2004) with
w and n in units of the objectives' ranges. The rows with n and c are the position constraints.
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
from plough_opt.studies.tradeoff.corrector import BatchCorrector, Corrector
from plough_opt.studies.tradeoff.front import Goal

_POSITION = "position on the front"
# Factor on the number of integration steps for each refinement.
_FINER = 1.5
# Position constraints with smaller scaled multipliers are inactive.
_PULLS = 1e-6
# Errors of objectives that are smaller than this, in units of their size at the guess, are relative to this.
_SMALL = 1e-3


class FrontProgram:
    """Program of a design with several objectives.

    Attributes:
        program: the program.
        count: number of objectives.
        declared: declarations of the design.
        values: values of the design's own parameters.
        scales: sizes of the objectives at the guess, in their units.
        signs: -1 for an objective that is maximised, else 1.
        units: factors that turn scaled objectives into objectives in their units.
        position_rows: numbers of the position constraints among the requirements.
        correctors: solver of the built program with exact slopes (True), and the faster one with slopes by differences
            of batched runs (False). Both are exact if no run takes automatic steps, or runs are integrated one by one.
        low: scaled objectives that are 0 when normalised.
        span: ranges of the scaled objectives that are 1 when normalised.
        building: time spent on writing the program since it was last prepared [s].
        ignored_conflict: largest relative change of an objective that was taken for none.
    """

    def __init__(self, declared: Declarations, goals: Sequence[Goal], *, compiled: bool = False) -> None:
        """Declare the program of a design's `declarations`.

        Raises:
            InputError: an objective holds symbols of another design.
        """
        for goal in goals:
            if strangers := declared.strangers(ca.MX(goal.expression)):
                raise InputError(
                    f"the objective '{goal.name}' holds symbols that this design did not declare"
                    f" ({', '.join(strangers)}): make them with design.variable or design.parameter of this design"
                )
        self.count = count = len(goals)
        self.signs = np.array([goal.sign for goal in goals])
        self.declared = declared
        self.values = [parameter.value for parameter in declared.parameters]
        objectives = [goal.sign * ca.MX(goal.expression) for goal in goals]
        self.scales = _sizes(objectives, declared.symbols(), [*(v.guess for v in declared.variables), *self.values])
        self.units = self.signs * self.scales
        scaled = ca.vertcat(*(objective / size for objective, size in zip(objectives, self.scales, strict=True)))
        own = [ca.MX.sym(f"{_POSITION} {k}") for k in range(count * (count + 1))]
        weights, limits = ca.vertcat(*own[: 1 + count]), ca.vertcat(*own[1 - count :])
        normals = ca.reshape(ca.vertcat(*own[1 + count : 1 - count]), count, count - 1).T
        self.program = Program.of(
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
        self.position_rows = np.arange(first, first + count - 1)
        self._tight: dict[bytes, tuple[Vector, list[Vector]]] = {}
        self.correctors: dict[bool, Corrector] = {}
        self.building = 0.0
        self.ignored_conflict = 0.0
        self._refinement = 1.0
        self._starts: list[Vector] = []

    def prepare(self, values: Vector) -> None:
        """Check the program for values of the design's parameters.

        Args:
            values: of the parameters, in the order of their declaration.

        Raises:
            InputError: the model has no value at the guess.
            DomainError: the bounds lead out of the model's domain.
        """
        self.values = values.tolist()
        self._tight.clear()
        self.normalise(np.zeros(self.count), np.ones(self.count))
        # With these parameters the program's objective and position constraints are the scaled objectives themselves.
        count = self.count
        self._objectives_only = self._parameters(
            (0.0, 1.0, *np.zeros(count - 1)), np.eye(count)[1:], np.zeros(count - 1)
        )
        self._refinement, self.building = 1.0, 0.0
        self.program = self.program.at(self.neutral_parameters())

    def build(self, starts: Sequence[Vector]) -> None:
        """Write the program with enough integration steps for some scaled designs, unless that is already so."""
        self._starts = list(starts)
        self._build()

    def refine(self) -> None:
        """Write the program with more integration steps."""
        self._refinement *= _FINER
        self._build()

    def _build(self) -> None:
        began = time.perf_counter()
        program = self.program.with_steps(self.neutral_parameters(), self._refinement, self._starts)
        self.program = program
        self.building += time.perf_counter() - began
        batched = program.wanted_error and program.population.vectorised
        self.correctors[True] = Corrector(program)
        self.correctors[False] = BatchCorrector(program) if batched else self.correctors[True]
        self.normalise(self.low, self.span)

    def normalise(self, low: Vector, span: Vector) -> None:
        """Set which scaled objectives are 0 when normalised, and which ranges are 1."""
        self.low, self.span = low, span
        quick = self.correctors.get(False)
        if isinstance(quick, BatchCorrector):
            quick.set_largest_objective(float(np.max((np.abs(low) + span) / span)))

    def normalised(self, scaled: Vector) -> Vector:
        """Return scaled objectives in units of their ranges over the front."""
        return np.asarray((scaled - self.low) / self.span)

    def scaled(self, normalised: Vector) -> Vector:
        """Return normalised objectives as the program scales them."""
        return np.asarray(normalised * self.span + self.low)

    # --- subproblems -------------------------------------------------------------------------------------

    def _parameters(self, weights: Sequence[float], normals: Vector, limits: Vector) -> Vector:
        """Return the program's parameters for w, n (a row for each constraint) and c, in scaled units."""
        return np.array([*self.values, *weights, *np.ravel(normals), *limits])

    def neutral_parameters(self) -> Vector:
        """Return parameters for which the objective is constantly 1 and no position constraint is active.

        The program is scaled by its values with these, so that the scales of objective and position constraints are 1.
        """
        nothing = self.weighted(np.zeros(self.count))
        nothing[len(self.values)] = 1.0
        return nothing

    def weighted(self, weights: Vector) -> Vector:
        """Return the parameters that minimise a weighted sum of the scaled objectives, without position constraints."""
        count = self.count
        return self._parameters((0.0, *weights), np.zeros((count - 1, count)), np.ones(count - 1))

    def limited(
        self, objective: int, limits: Mapping[int, float], others: float = 0.0, *, relative: bool = False
    ) -> Vector:
        """Return the parameters that minimise one normalised objective with limits on the others.

        Args:
            objective: number of the objective to minimise.
            limits: largest value of each other objective, normalised.
            others: weight of the other objectives, which decides what the limits leave open.
            relative: whether the limits are on the excess of each other objective over the minimised one.
        """
        weights, normals = np.full(self.count, others), np.zeros((self.count - 1, self.count))
        weights[objective] = 1.0
        normals[np.arange(len(limits)), list(limits)] = 1.0
        normals[:, objective] = -1.0 if relative else 0.0
        zero = self.low / self.span
        return self._parameters(
            (-float(weights @ zero), *(weights / self.span)),
            normals / self.span,
            np.array(list(limits.values())) + normals @ zero,
        )

    def subproblem(self, p: Vector) -> tuple[Vector, Vector, Vector]:
        """Return w, n and c of parameters, in scaled units."""
        count, own = self.count, p[len(self.values) :]
        return own[: 1 + count], own[1 + count : 1 - count].reshape(count - 1, count), own[1 - count :]

    def solve(self, neighbour: Point, start: Vector, p: Vector, *, exact: bool = False) -> Point:
        """Return the optimum of a subproblem near a start, from a neighbour's multipliers or, failing that, without.

        Args:
            neighbour: an optimum nearby.
            start: scaled variables.
            p: parameters of the subproblem.
            exact: whether to use exact slopes.
        """
        corrector = self.correctors[exact]
        point = corrector.correct(neighbour, start, p)
        return point if point.solved else corrector.solve_from_afar(neighbour, start, p)

    def position_decides(self, point: Point) -> bool:
        """Return whether all position constraints are active at an optimum."""
        return bool(np.all(point.lam_g[self.position_rows] > _PULLS))

    def weights_at(self, point: Point, p: Vector) -> Vector:
        """Return the weights with which the scaled objectives' gradients balance at an optimum of a subproblem."""
        weights, normals, _ = self.subproblem(p)
        return np.asarray(weights[1:] + point.lam_g[self.position_rows] @ normals)

    # --- values ------------------------------------------------------------------------------------------

    def objectives(self, y: Vector, *, exact: bool = False) -> Vector:
        """Return the normalised objectives of a design, as the optimiser computes them."""
        f, g = self.correctors[exact].values(y, self._objectives_only)
        return self.normalised(np.concatenate([f, g[self.position_rows]]))

    def evaluate(self, points: Vector, finer: float, together: int) -> tuple[Vector, Vector]:
        """Return scaled objectives and all rows of requirements, in their units, a row for each design.

        Args:
            points: scaled variables, a row for each design.
            finer: as in `Population`.
            together: as in `Population`.
        """
        with np.errstate(all="ignore"):
            f, g = self.program.population(points, self._objectives_only, finer=finer, together=together)
        return np.column_stack([f, g[:, self.position_rows]]), g

    def tight(self, y: Vector) -> tuple[Vector, list[Vector]]:
        """Return the scaled objectives and all requirements of a design by a tight integration."""
        key = y.tobytes()
        if key not in self._tight:
            found = self.program.exact.values([*self.program.values(y), *self._objectives_only])
            row = 1 + self.program.owner[self.position_rows[0]]
            self._tight[key] = np.concatenate([found[0].ravel(), found[row].ravel()]), found[1:]
        return self._tight[key]

    def gap(self, y: Vector, *, exact: bool = True) -> float:
        """Return the largest relative difference of the optimiser's objectives from the tightly integrated ones."""
        found, tight = self.scaled(self.objectives(y, exact=exact)), self.tight(y)[0]
        return float(np.max(np.abs(found - tight) / np.maximum(np.abs(tight), _SMALL)))

    def runs(self, y: Vector) -> list[Run]:
        """Return the runs of a design by a tight integration."""
        exact = self.program.exact
        return [exact.followed(k, *exact.inputs(k, self._numbers(y))) for k in range(len(exact.runs))]

    def still_scenes(self, y: Vector) -> list[Scene]:
        """Return the scenes of a design that are not integrated, with numbers."""
        return self.program.exact.quasi_static_scenes(self._numbers(y))

    def _numbers(self, y: Vector) -> list[float]:
        """Return the values of all symbols at a design."""
        return [*self.program.values(y), *self.neutral_parameters()]


def declarations(design: Design, goals: Sequence[Goal]) -> Declarations:
    """Return what a design declares, with an objective in place of its own.

    Raises:
        InputError: the design has no variables.
    """
    own = copy.copy(design)
    own.minimise(goals[0].expression)
    return own.declared


def _sizes(expressions: list[ca.MX], symbols: list[ca.MX], numbers: list[float]) -> list[float]:
    """Return the sizes of the objectives at the guess; 1 for an objective that is zero or has no value there."""
    try:
        with np.errstate(all="ignore"):
            found = TightEvaluation(expressions, symbols).values(numbers)
    except (PloughError, RuntimeError, ValueError):  # building the program reports which objective fails, and why
        return [1.0] * len(expressions)
    sizes = (abs(float(value.item())) for value in found)
    return [size if np.isfinite(size) and size > 0.0 else 1.0 for size in sizes]
