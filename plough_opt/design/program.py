"""The scaled program of a design, from its declarations to IPOPT solvers, built once for all solves."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column
from plough_opt.design.declarations import Declarations, Requirement
from plough_opt.design.forms import as_machine_code, first_slack, relaxed
from plough_opt.design.ipopt import FROM_AFAR, Point, SolveOptions, Solver, Vector
from plough_opt.design.nlp import Nlp, build_nlp
from plough_opt.design.population import LinearVariable, Population, linear_variables
from plough_opt.design.split import split
from plough_opt.design.verify import TightEvaluation, check_bounds, corners, rough_steps, steps_at, values_at_guess
from plough_opt.motion.accuracy import DEFAULT_ERROR

# An objective or requirement is scaled as if it had at least this size.
_SMALLEST_SCALE = 1e-12
# Built programs that are cached, for different numbers of steps or scales.
_MOST_PROGRAMS = 6
# Size and seed of the sample whose medians set the scales if the guess has no value.
_SAMPLE = 256
_SAMPLE_SEED = 256

Cached = TypeVar("Cached")


@dataclass
class BuiltProgram:
    """A program with certain numbers of integration steps; its solvers are built when first needed.

    Attributes:
        steps: for each run, the number of steps, or None for the method it was written with.
        rough_steps: the same for the rough program.
        write: builds the program from numbers of steps.
        owner: for each row of the requirements, the number of its requirement.
        limits: scaled lower and upper limits of the rows.
        compiled: whether to translate the program into machine code.
        refinement: factor on the numbers of steps, as given to `Program.build`.
        checked: parameters, scaled design and error of derivatives at the last check, if there was one.
    """

    steps: list[int | None]
    rough_steps: list[int | None]
    write: Callable[[list[int | None]], Nlp]
    owner: Sequence[int]
    limits: tuple[Vector, Vector]
    compiled: bool
    refinement: float = 1.0
    checked: tuple[Vector, Vector, float] | None = None

    @cached_property
    def plain(self) -> Nlp:
        """The program, interpreted."""
        return self.write(self.steps)

    @cached_property
    def nlp(self) -> Nlp:
        """The program, in machine code if ``compiled`` and if there is a compiler."""
        return (as_machine_code(self.plain) if self.compiled else None) or self.plain

    @cached_property
    def rough(self) -> Nlp:
        """The program with two fifths of the steps, enough to tell the sign of the Lagrangian's curvatures."""
        return self.write(self.rough_steps)

    @cached_property
    def solver(self) -> Solver:
        """IPOPT on the program."""
        return Solver(self.nlp, *self.limits)

    @cached_property
    def relaxed(self) -> Solver:
        """IPOPT on the sum of the requirements' violations."""
        return Solver(relaxed(self.nlp, self.owner), *self.limits)


class Program:
    """The scaled program of a design: variables between 0 and 1, objective and requirements of order 1.

    It is made in three stages. The constructor splits the declared expressions around their runs. `prepare` sets the
    scales, which depend on the values of the parameters. `build` chooses the numbers of integration steps and writes
    the program, which can then be solved.

    Attributes:
        declared: the declarations; limits of theories that the expressions use are appended to the requirements.
        exact: objective and requirements by tight integration.
        owner: for each row of the requirements, the number of its requirement.
        compiled: whether to translate the program into machine code.
        bare: as given to the constructor.
        over: as given to the constructor.
        objective_scale: divisor of the objective, after `prepare`.
        scales: divisor of each requirement, after `prepare`.
        low: scaled lower limits of the rows, after `prepare`.
        high: scaled upper limits of the rows, after `prepare`.
    """

    def __init__(
        self, declared: Declarations, *, compiled: bool = False, bare: Program | None = None, over: str = ""
    ) -> None:
        """Split the expressions around their runs, and add the limits of the theories that they use as requirements.

        Args:
            declared: the declarations.
            compiled: whether to translate the program into machine code.
            bare: if this program covers the tolerance box around a design, the program of the design alone.
            over: a sentence on the objective over that box, for reports.

        Raises:
            InputError: an expression contains a symbol that was not declared, or a run uses the method 'idas'.
        """
        self.declared = declared
        self._refuse_undeclared()
        self.exact = TightEvaluation(self.expressions, declared.symbols())
        self._implied = tuple(
            Requirement(limit.name, carried, None, limit.at_most, limit.unit)
            for limit, carried in self.exact.limits.items()
        )
        if self._implied:
            self.declared = replace(declared, requirements=(*declared.requirements, *self._implied))
            self.exact = TightEvaluation(self.expressions, declared.symbols(), shared=self.exact)
        self._refuse_idas()
        self.owner = [k for k, r in enumerate(self.declared.requirements) for _ in range(r.expression.numel())]
        self._y, self._p = ca.MX.sym("y", len(declared.variables)), ca.MX.sym("p", len(declared.parameters))
        self.compiled, self.bare, self.over = compiled, bare, over
        self.objective_scale = 1.0
        self.scales: list[float] = []
        self._built: BuiltProgram | None = None
        self._prepared: bytes | None = None
        # Caches, each by what its entries depend on. Several built programs are kept, so that solving the same question
        # again gives the same result to the last bit, whatever was solved in between.
        self._programs: dict[Hashable, BuiltProgram] = {}
        self._values_at_guess: dict[bytes, list[Vector]] = {}
        self._linear: dict[Hashable, list[LinearVariable]] = {}
        self._exact_values: dict[Hashable, tuple[list[Vector], list[Vector]]] = {}

    @property
    def expressions(self) -> list[ca.MX]:
        """Objective and requirements."""
        return [self.declared.objective, *(r.expression for r in self.declared.requirements)]

    @property
    def own_requirements(self) -> tuple[Requirement, ...]:
        """The requirements that were declared, without the limits of theories."""
        return self.declared.requirements[: len(self.declared.requirements) - len(self._implied)]

    def _refuse_undeclared(self) -> None:
        names = ["objective", *(r.name for r in self.declared.requirements)]
        for name, expression in zip(names, self.expressions, strict=True):
            if strangers := self.declared.strangers(expression):
                raise InputError(
                    f"'{name}' holds symbols that this design did not declare ({', '.join(strangers)}): create them"
                    " with its design.variable or design.parameter"
                )

    def _refuse_idas(self) -> None:
        if any(run.integration.accuracy.method == "idas" for run in self.exact.runs):
            raise InputError(
                "method 'idas' has no second derivatives, which a design needs: use 'auto', 'erk' or 'cvodes'"
            )

    def start(self) -> Vector:
        """Return the guess, scaled."""
        return np.array([v.scaled(v.guess) for v in self.declared.variables])

    def values(self, y: Vector) -> Vector:
        """Return the variables of a scaled design in their own units."""
        return np.array([v.value(float(x)) for v, x in zip(self.declared.variables, y, strict=True)])

    def values_of(self, points: Vector) -> Vector:
        """Return the variables of many scaled designs in their own units, a row for each design."""
        columns = [
            np.select([y <= 0.0, y >= 1.0], [v.lower, v.upper], np.asarray(v.unscaled(y)))
            for v, y in zip(self.declared.variables, points.T, strict=True)
        ]
        return np.column_stack(columns)

    def exact_values(self, y: Vector, p: Vector) -> tuple[list[Vector], list[Vector]]:
        """Return objective and requirements by tight integration, and again by the method that checks it."""
        numbers = [*self.values(y), *p]
        evaluate = self.exact.values
        at = y.tobytes(), p.tobytes()
        return _cached(self._exact_values, at, 1, lambda: (evaluate(numbers), evaluate(numbers, check=True)))

    def prepare(self, p: Vector, *, any_guess: bool = False) -> None:
        """Check the bounds and set the scales from the values at the guess.

        Args:
            p: parameters.
            any_guess: whether to scale by a sample of designs if the guess has no value.

        Raises:
            InputError: the objective or a requirement has no value at the guess nor, with ``any_guess``, in the sample.
            DomainError: the bounds exceed the model's domain.
        """
        key = p.tobytes()
        values = self._values_at_guess.get(key)
        if values is None:
            check_bounds(self.declared, self.exact, p)
            try:
                values = values_at_guess(self.declared, self.exact, self._implied, p)
                self._values_at_guess = {key: values}
            except InputError as error:
                if not any_guess:
                    raise
                values = self._typical_values(p, error)
        self._set_scales(values)
        self._prepared = key

    def build(self, p: Vector, refinement: float = 1.0, starts: Sequence[Vector] | None = None) -> None:
        """Write the program with as many integration steps as certain designs need.

        Args:
            p: parameters.
            refinement: factor on the numbers of steps.
            starts: the designs, scaled; by default the guess and the guess with each variable at either of its bounds.

        Raises:
            InputError, DomainError: as `prepare`, or the motion of one of the designs is too fast to integrate.
        """
        if self._prepared != p.tobytes():
            self.prepare(p)
        variables = self.declared.variables
        if starts is None:
            ends = (values for _, values in corners(self.declared))
            starts = [np.array([v.scaled(x) for v, x in zip(variables, values, strict=True)]) for values in ends]
        steps = steps_at(self.exact, [[*self.values(y), *p] for y in starts], refinement)
        key = (*steps, self.objective_scale, *self.scales)
        self._built = _cached(self._programs, key, _MOST_PROGRAMS, lambda: self._write(steps))
        self._built.refinement = refinement

    def _write(self, steps: list[int | None]) -> BuiltProgram:
        """Return the program with certain numbers of steps."""
        write = partial(build_nlp, split(self.scaled(self._y, self._p), [self._y, self._p]), self._y, self._p)
        limits = self.low, self.high
        return BuiltProgram(steps, rough_steps(self.exact, steps), write, self.owner, limits, self.compiled)

    def linear_variables(self, p: Vector) -> list[LinearVariable]:
        """Return the variables that follow from the others by algebra: see `plough_opt.design.population`."""
        declared = self.declared
        symbols = [own.symbol for own in declared.parameters]
        return _cached(
            self._linear, p.tobytes(), 1, lambda: linear_variables(self.expressions, declared.variables, symbols, p)
        )

    @property
    def built(self) -> BuiltProgram:
        """The program that was built last."""
        assert self._built is not None, "build the program first"
        return self._built

    @property
    def nlp(self) -> Nlp:
        """Objective and requirements of the program that was built last."""
        return self.built.nlp

    @cached_property
    def population(self) -> Population:
        """Evaluates objective and requirements, unscaled, at many scaled designs at once."""
        raw = [self.declared.objective, ca.vertcat(*(r.expression for r in self.declared.requirements))]
        return Population(split(self._of_scaled(raw, self._y, self._p), [self._y, self._p]), self._y, self._p)

    def scaled(self, y: ca.MX, p: ca.MX) -> list[ca.MX]:
        """Return scaled objective and requirements as expressions of scaled variables and parameters."""
        rows = [r.expression / scale for r, scale in zip(self.declared.requirements, self.scales, strict=True)]
        return self._of_scaled([self.declared.objective / self.objective_scale, ca.vertcat(*rows)], y, p)

    def _of_scaled(self, expressions: list[ca.MX], y: ca.MX, p: ca.MX) -> list[ca.MX]:
        """Return expressions with the design's symbols replaced by scaled variables and parameters."""
        declared = self.declared
        unscaled: list[Column] = [v.unscaled(x) for v, x in zip(declared.variables, ca.vertsplit(y), strict=True)]
        replacements = [*unscaled, *(ca.vertsplit(p) if declared.parameters else [])]
        return list(ca.graph_substitute(expressions, declared.symbols(), replacements))

    def with_parameters_varied(self) -> Nlp:
        """Return the program that was built last as one of variables (y, p), so that derivatives by p are available."""
        n = self._y.numel()
        both, none = ca.MX.sym("z", n + self._p.numel()), ca.MX.sym("p", 0)
        parts = split(self.scaled(both[:n], both[n:]), [both, none])
        return build_nlp(parts, both, none, self.built.steps)

    def _set_scales(self, values: list[Vector]) -> None:
        """Scale the objective by its value, and each requirement by its limits or, if these are 0, by its value."""
        self.objective_scale = _power_of_four(float(values[0].item()))
        requirements = self.declared.requirements
        self.scales = [
            r.scale or (_power_of_four(size) if (size := float(np.max(np.abs(value)))) else 1.0)
            for r, value in zip(requirements, values[1:], strict=True)
        ]
        self.low = np.array([requirements[k].low / self.scales[k] for k in self.owner])
        self.high = np.array([requirements[k].high / self.scales[k] for k in self.owner])

    def scale_by(self, objective: float) -> None:
        """Scale the objective by another of its values, which a search found better than the guess."""
        self.objective_scale = _power_of_four(objective)

    def _typical_values(self, p: Vector, error: InputError) -> list[Vector]:
        """Return the medians of the expressions' sizes over a sample.

        Args:
            p: parameters.
            error: the reason why the guess has no value, raised if the sample has none either.
        """
        points = np.random.default_rng(_SAMPLE_SEED).random((_SAMPLE, len(self.declared.variables)))
        with np.errstate(all="ignore"):
            f, g = self.population(points, p)
        sound = np.isfinite(f) & np.all(np.isfinite(g), axis=1)
        if not np.any(sound):
            raise error
        rows, owner = np.median(np.abs(g[sound]), axis=0), np.array(self.owner)
        return [np.median(np.abs(f[sound])), *(rows[owner == k] for k in range(len(self.declared.requirements)))]

    @property
    def wanted_error(self) -> float | None:
        """Smallest relative error that a run with method 'auto' must reach; None if no run has this method."""
        automatic = [run.integration.accuracy for run in self.exact.runs if run.integration.accuracy.method == "auto"]
        return min((accuracy.error or DEFAULT_ERROR for accuracy in automatic), default=None)

    def solve(
        self, start: Vector, p: Vector, options: SolveOptions = FROM_AFAR, box: float = 1.0, fixed: Sequence[int] = ()
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a scaled start.

        Args:
            start: scaled variables.
            p: parameters.
            options: options of the solve.
            box: largest distance of a scaled variable from the start.
            fixed: numbers of variables that are held at the start.
        """
        return self.built.solver.solve(start, p, *_bounds(start, box, fixed), options)

    def solve_relaxed(
        self, start: Vector, p: Vector, box: float = 1.0, fixed: Sequence[int] = (), *, exact: bool | None = None
    ) -> tuple[Point, Vector]:
        """Return the design that breaks the requirements least, found from a start, and the violations.

        The arguments are those of `solve`, and ``exact`` is that of `SolveOptions`.

        Returns:
            The point, and the scaled violation of each requirement there; their sum is least.
        """
        g = np.asarray(self.nlp.values(start, p)[1]).ravel()
        slack = first_slack(g, (self.low, self.high), self.owner)
        # Limits of theories are kept: beyond them the model has no value.
        count, n = len(self.declared.requirements), len(start)
        breakable = np.tile(np.arange(count) < len(self.own_requirements), 2)
        slack[~breakable] = 0.0
        lower, upper = _bounds(start, box, fixed)
        lower, upper = np.r_[lower, np.zeros(2 * count)], np.r_[upper, np.where(breakable, np.inf, 0.0)]
        # With variables held, or within a box, the start is taken to be nearly optimal.
        options = SolveOptions(near=len(fixed) > 0 or box < 1.0, exact=exact)
        point = self.built.relaxed.solve(np.r_[start, slack], p, lower, upper, options)
        y, slack = np.clip(point.y[:n], 0.0, 1.0), point.y[n:]
        return replace(point, y=y, lam_y=point.lam_y[:n]), slack[:count] + slack[count:]


def _bounds(start: Vector, box: float, fixed: Sequence[int]) -> tuple[Vector, Vector]:
    """Return bounds of the scaled variables: a box around a start, with some variables held at the start."""
    lower, upper = np.maximum(start - box, 0.0), np.minimum(start + box, 1.0)
    held = list(fixed)
    lower[held] = upper[held] = start[held]
    return lower, upper


def _cached(cache: dict[Hashable, Cached], key: Hashable, most: int, make: Callable[[], Cached]) -> Cached:
    """Return a cache's entry, made if it is missing; the oldest are dropped beyond ``most`` entries."""
    if key not in cache:
        while len(cache) >= most:
            cache.pop(next(iter(cache)))
        cache[key] = make()
    return cache[key]


def _power_of_four(value: float) -> float:
    """Return the power of four nearest to a value's size, so that slightly different questions are scaled alike."""
    return float(4.0 ** round(math.log(max(abs(value), _SMALLEST_SCALE), 4.0)))
