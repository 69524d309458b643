"""Program of a trade-off, and the corrector that leads from a predicted design to the optimum near it.

The program's parameters choose which objective is minimised and where the others must stay. With weights w, and for
each further objective a normal n and a limit c, all of them parameters, the program is

    minimise  w0 + sum_i w_i f_i/s_i   subject to   sum_i n_ki f_i/s_i - c_k <= 0   and the requirements.

One choice of parameters is one subproblem: an objective alone (n = 0), an objective with limits on the others, or the
normalised normal constraint (Messac, Ismail-Yahaya and Mattson 2003; for three objectives Messac and Mattson 2004) with
w and n in units of the objectives' ranges. The rows with n and c are the position constraints.

`Corrector` of the search solves a subproblem with exact slopes. `BatchCorrector` integrates a design and its neighbours
side by side and takes slopes from their differences, some twenty times as fast.
"""

import copy
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError, PloughError
from plough_opt.core.plain_data import Array
from plough_opt.design import Design
from plough_opt.design.declarations import Declarations, Parameter, Requirement
from plough_opt.design.model.ipopt import Point
from plough_opt.design.model.optimality import curvature_of, difference_quotients
from plough_opt.design.model.program import Program
from plough_opt.design.model.tight_integration import TightEvaluation
from plough_opt.design.search.descent import descend
from plough_opt.design.search.landscape import Landscape
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.studies.tradeoff.corrector import Corrector, Slopes
from plough_opt.studies.tradeoff.front import Goal

# Factor on the number of integration steps of a search. It leaves averages with errors of some 1e-10, outputs 1e-8.
_FINER: Final = 4.0
# Step of differences for slopes, between the rounding of a run (some 1e-13) and the error by its third derivatives.
_SLOPE_STEP: Final = 3e-6
# Residual of the first-order conditions that slopes by differences can reach: they have errors of some 1e-7.
_BATCH_RESIDUAL: Final = 5e-7


class BatchCorrector(Corrector):
    """Corrector with slopes by differences of designs that are integrated side by side.

    Attributes:
        largest_residual: as of `Corrector`, but with room for the errors of differences. `FrontProgram.normalise` sets
            it: it grows with the objectives' sizes in units of their ranges, because their rounding does so too.
    """

    def _evaluate(self, y: Array, p: Array) -> tuple[Array, Array]:
        f, g = self._integrate(y[None], p)
        return f, g[0]

    def _differentiate(self, y: Array, p: Array) -> Slopes:
        """Return slopes by one-sided differences of second order, from one and two steps along each variable."""
        # All steps point to the middle of a range.
        n, steps = len(y), np.where(y > 0.5, -_SLOPE_STEP, _SLOPE_STEP)
        f, g = self._integrate(np.vstack([y, y + np.diag(steps), y + 2.0 * np.diag(steps)]), p)
        gradient, jacobian = (
            (4.0 * (values[1 : n + 1] - values[0]) - (values[n + 1 :] - values[0])).T / (2.0 * steps)
            for values in (f, g)
        )
        return Slopes(f[:1], g[0], gradient, jacobian)

    def _integrate(self, designs: Array, p: Array) -> tuple[Array, Array]:
        """Return scaled objective and requirements, a row for each design, all with the same number of steps."""
        return Landscape(self._program, p).rows(designs, finer=_FINER, together=len(designs))

    def solve_from_afar(self, neighbour: Point, start: Array, p: Array) -> Point:
        """Return the optimum near a start from which `correct` fails: a descent of the search, then corrected.

        Args:
            neighbour: optimum whose multipliers to begin with.
            start: scaled variables.
            p: parameters.
        """
        end = descend(Landscape(self._program, p), start)
        if not end.feasible[0]:
            return replace(neighbour, solved=False, status="Infeasible_Problem_Detected", y=end.points[0])
        return self.correct(neighbour, end.points[0], p)

    def _initial_curvature(self, y: Array, p: Array, lam_g: Array) -> Array:
        """Return the Hessian of the Lagrangian by differences of slopes, made positive definite."""
        derivatives = difference_quotients(lambda designs: self._integrate(designs, p), y)
        if derivatives is None:
            raise ValueError("a neighbouring design has no value")
        return curvature_of(derivatives[2], lam_g)


_POSITION = "position on the front"
# Factor on the number of integration steps for each refinement.
_REFINES: Final = 1.5
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
        symbols = [ca.MX.sym(f"{_POSITION} {k}") for k in range(count * (count + 1))]
        weights, limits = ca.vertcat(*symbols[: 1 + count]), ca.vertcat(*symbols[1 - count :])
        normals = ca.reshape(ca.vertcat(*symbols[1 + count : 1 - count]), count, count - 1).T
        self.program = Program.of(
            replace(
                declared,
                parameters=(*declared.parameters, *(Parameter(symbol.name(), symbol, 0.0, "") for symbol in symbols)),
                objective=weights[0] + ca.dot(weights[1:], scaled),
                requirements=(*declared.requirements, Requirement(_POSITION, normals @ scaled - limits, None, 0.0, "")),
            ),
            compiled=compiled,
            many_slopes=True,
        )
        first = self.program.owner.index(len(declared.requirements))
        self.position_rows = np.arange(first, first + count - 1)
        self._tight: dict[bytes, tuple[Array, list[Array]]] = {}
        self.correctors: dict[bool, Corrector] = {}
        self.building = 0.0
        self.ignored_conflict = 0.0
        self._refinement = 1.0
        self._starts: list[Array] = []

    def prepare(self, values: Array) -> None:
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

    def build(self, starts: Sequence[Array]) -> None:
        """Write the program with enough integration steps for some scaled designs, unless that is already so."""
        self._starts = list(starts)
        self._build()

    def refine(self) -> None:
        """Write the program with more integration steps."""
        self._refinement *= _REFINES
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

    def normalise(self, low: Array, span: Array) -> None:
        """Set which scaled objectives are 0 when normalised, and which ranges are 1."""
        self.low, self.span = low, span
        quick = self.correctors.get(False)
        if isinstance(quick, BatchCorrector):
            quick.largest_residual = _BATCH_RESIDUAL * float(np.max((np.abs(low) + span) / span))

    def normalised(self, scaled: Array) -> Array:
        """Return scaled objectives in units of their ranges over the front."""
        return np.asarray((scaled - self.low) / self.span)

    def scaled(self, normalised: Array) -> Array:
        """Return normalised objectives as the program scales them."""
        return np.asarray(normalised * self.span + self.low)

    # --- subproblems -------------------------------------------------------------------------------------

    def _parameters(self, weights: Sequence[float], normals: Array, limits: Array) -> Array:
        """Return the program's parameters for w, n (a row for each constraint) and c, in scaled units."""
        return np.array([*self.values, *weights, *np.ravel(normals), *limits])

    def neutral_parameters(self) -> Array:
        """Return parameters for which the objective is constantly 1 and no position constraint is active.

        The program is scaled by its values with these, so that the scales of objective and position constraints are 1.
        """
        nothing = self.weighted(np.zeros(self.count))
        nothing[len(self.values)] = 1.0
        return nothing

    def weighted(self, weights: Array) -> Array:
        """Return the parameters that minimise a weighted sum of the scaled objectives, without position constraints."""
        count = self.count
        return self._parameters((0.0, *weights), np.zeros((count - 1, count)), np.ones(count - 1))

    def limited(self, objective: int, limits: Array, others: float = 0.0, *, relative: bool = False) -> Array:
        """Return the parameters that minimise one normalised objective with limits on the others.

        Args:
            objective: number of the objective to minimise.
            limits: largest value of each objective, normalised; that of the minimised one has no effect.
            others: weight of the other objectives, which decides what the limits leave open.
            relative: whether the limits are on the excess of each other objective over the minimised one.
        """
        is_other = np.arange(self.count) != objective
        weights, normals = np.where(is_other, others, 1.0), np.eye(self.count)[is_other]
        normals[:, objective] = -1.0 if relative else 0.0
        zero = self.low / self.span
        return self._parameters(
            (-float(weights @ zero), *(weights / self.span)),
            normals / self.span,
            limits[is_other] + normals @ zero,
        )

    def subproblem(self, p: Array) -> tuple[Array, Array, Array]:
        """Return w, n and c of parameters, in scaled units."""
        count, posed = self.count, p[len(self.values) :]
        return posed[: 1 + count], posed[1 + count : 1 - count].reshape(count - 1, count), posed[1 - count :]

    def solve(self, neighbour: Point, start: Array, p: Array, *, exact: bool = False) -> Point:
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

    def weights_at(self, point: Point, p: Array) -> Array:
        """Return the weights with which the scaled objectives' gradients balance at an optimum of a subproblem."""
        weights, normals, _ = self.subproblem(p)
        return np.asarray(weights[1:] + point.lam_g[self.position_rows] @ normals)

    # --- values ------------------------------------------------------------------------------------------

    def objectives(self, y: Array, *, exact: bool = False) -> Array:
        """Return the normalised objectives of a design, as the optimiser computes them."""
        f, g = self.correctors[exact].values(y, self._objectives_only)
        return self.normalised(np.concatenate([f, g[self.position_rows]]))

    def evaluate(self, points: Array, finer: float, together: int) -> tuple[Array, Array]:
        """Return scaled objectives and all rows of requirements, in their units, a row for each design.

        Args:
            points: scaled variables, a row for each design.
            finer: as in `Population`.
            together: as in `Population`.
        """
        f, g = self.program.population(points, self._objectives_only, finer=finer, together=together)
        return np.column_stack([f, g[:, self.position_rows]]), g

    def tight(self, y: Array) -> tuple[Array, list[Array]]:
        """Return the scaled objectives and all requirements of a design by a tight integration."""
        key = y.tobytes()
        if key not in self._tight:
            results = self.program.exact.values([*self.program.values(y), *self._objectives_only])
            row = 1 + self.program.owner[self.position_rows[0]]
            self._tight[key] = np.concatenate([results[0].ravel(), results[row].ravel()]), results[1:]
        return self._tight[key]

    def gap(self, y: Array, *, exact: bool = True) -> float:
        """Return the largest relative difference of the optimiser's objectives from the tightly integrated ones."""
        scaled, tight = self.scaled(self.objectives(y, exact=exact)), self.tight(y)[0]
        return float(np.max(np.abs(scaled - tight) / np.maximum(np.abs(tight), _SMALL)))

    def scenes(self, y: Array) -> list[Scene]:
        """Return the scenes of a design's runs, with numbers."""
        exact, numbers = self.program.exact, self._numbers(y)
        return [exact.inputs(k, numbers)[1] for k in range(len(exact.runs))]

    def runs(self, y: Array) -> list[Run]:
        """Return the runs of a design by a tight integration."""
        exact = self.program.exact
        return [exact.followed(k, *exact.inputs(k, self._numbers(y))) for k in range(len(exact.runs))]

    def still_scenes(self, y: Array) -> list[Scene]:
        """Return the scenes of a design that are not integrated, with numbers."""
        return self.program.exact.quasi_static_scenes(self._numbers(y))

    def _numbers(self, y: Array) -> list[float]:
        """Return the values of all symbols at a design."""
        return [*self.program.values(y), *self.neutral_parameters()]


def declarations(design: Design, goals: Sequence[Goal]) -> Declarations:
    """Return what a design declares, with an objective in place of its own.

    Raises:
        InputError: the design has no variables.
    """
    copied = copy.copy(design)
    copied.minimise(goals[0].expression)
    return copied.declared


def _sizes(expressions: list[ca.MX], symbols: list[ca.MX], numbers: list[float]) -> list[float]:
    """Return the sizes of the objectives at the guess; 1 for an objective that is zero or has no value there."""
    try:
        with np.errstate(all="ignore"):
            values = TightEvaluation(expressions, symbols).values(numbers)
    except (PloughError, RuntimeError, ValueError):  # building the program reports which objective fails, and why
        return [1.0] * len(expressions)
    sizes = (abs(float(value.item())) for value in values)
    return [size if np.isfinite(size) and size > 0.0 else 1.0 for size in sizes]
