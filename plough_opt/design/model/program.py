"""The scaled program of a design, from its declarations to IPOPT solvers, built once for all solves."""

from __future__ import annotations

import contextlib
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.checks import INSIDE
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Column
from plough_opt.design.declarations import Declarations, Requirement
from plough_opt.design.model.ipopt import FROM_AFAR, Point, SolveOptions, Solver, Vector
from plough_opt.design.model.nlp import MANY_STEPS, Nlp, as_machine_code, build_nlp, first_slack, relaxed, split
from plough_opt.design.model.population import Population
from plough_opt.design.model.tight_integration import (
    TightEvaluation,
    check_bounds,
    corners,
    rough_steps,
    steps_at,
    steps_factor,
    values_at_guess,
)
from plough_opt.motion.methods import DEFAULT_ERROR
from plough_opt.motion.solvers.derivatives import derivative_error


@dataclass(frozen=True, eq=False)
class BuiltProgram:
    """A program with certain numbers of integration steps; its solvers are built when first needed.

    Attributes:
        program: the scaled program.
        steps: for each run, the number of steps, or None for the method it was written with.
        write: builds the program from numbers of steps.
        errors: cache of the errors of derivatives, by scaled design and parameters.
    """

    program: Program
    steps: list[int | None]
    write: Callable[[list[int | None]], Nlp]
    errors: dict[Hashable, float] = field(default_factory=dict)

    @cached_property
    def plain(self) -> Nlp:
        """The program, interpreted."""
        return self.write(self.steps)

    @cached_property
    def nlp(self) -> Nlp:
        """The program, in machine code if that is wanted and if there is a compiler."""
        return (as_machine_code(self.plain) if self.program.compiled else None) or self.plain

    @cached_property
    def rough(self) -> Nlp:
        """The program with two fifths of the steps, enough to tell the sign of the Lagrangian's curvatures."""
        return self.write(rough_steps(self.steps))

    @cached_property
    def solver(self) -> Solver:
        """IPOPT on the program."""
        return Solver(self.nlp, self.program.low, self.program.high, self.program.ipopt)

    @cached_property
    def relaxed(self) -> Solver:
        """IPOPT on the sum of the requirements' violations."""
        nlp = relaxed(self.nlp, self.program.owner)
        return Solver(nlp, self.program.low, self.program.high, self.program.ipopt)


# Built programs that are cached, for different numbers of steps or scales.
_MOST_PROGRAMS = 6

Cached = TypeVar("Cached")


@dataclass(frozen=True, eq=False)
class Program:
    """The scaled program of a design: variables between 0 and 1, objective and requirements of order 1.

    A program never changes. `Program.of` splits the declared expressions around their runs, `at` returns the program
    with scales, which depend on the values of the parameters, and `with_steps` the one with numbers of integration
    steps, which can be solved. All of them share the functions that were built. Several built programs are
    kept, so that solving the same question again gives the same result to the last bit, whatever was solved in between.

    Attributes:
        declared: the declarations; limits of theories that the expressions use are appended to the requirements.
        own_requirements: the requirements that were declared, without the limits of theories.
        exact: objective and requirements by tight integration.
        owner: for each row of the requirements, the number of its requirement.
        compiled: whether to translate the program into machine code.
        many_slopes: as given to `Program.of`.
        ipopt: as given to `Program.of`.
        objective_scale: divisor of the objective.
        scales: divisor of each requirement.
        low: scaled lower limits of the rows.
        high: scaled upper limits of the rows.
        refinement: factor on the numbers of steps.
        checked: scaled design and error of derivatives at the last check of this program, if there was one.
    """

    declared: Declarations
    own_requirements: tuple[Requirement, ...]
    exact: TightEvaluation
    owner: list[int]
    compiled: bool
    many_slopes: bool
    _y: ca.MX
    _p: ca.MX
    ipopt: dict[str, Any] = field(default_factory=dict)
    _caches: dict[str, dict[Hashable, Any]] = field(default_factory=partial(defaultdict, dict))
    objective_scale: float = 1.0
    scales: tuple[float, ...] = ()
    low: Vector = field(default_factory=partial(np.empty, 0))
    high: Vector = field(default_factory=partial(np.empty, 0))
    refinement: float = 1.0
    checked: tuple[Vector, float] | None = None
    _scaled_at: bytes | None = None
    _built: BuiltProgram | None = None

    @classmethod
    def of(
        cls,
        declared: Declarations,
        *,
        compiled: bool = False,
        many_slopes: bool = False,
        ipopt: Mapping[str, Any] | None = None,
    ) -> Program:
        """Split the expressions around their runs, and add the limits of the theories that they use as requirements.

        Args:
            declared: the declarations.
            compiled: whether to translate the program into machine code.
            many_slopes: whether enough slopes will be taken for machine code to pay even for single runs.
            ipopt: options of IPOPT that the user gave, with the prefix of CasADi.

        Raises:
            InputError: an expression contains a symbol that was not declared, or a run uses the method 'idas'.
        """
        own = declared.requirements
        for name, expression in zip(["objective", *(r.name for r in own)], declared.expressions(), strict=True):
            if strangers := declared.strangers(expression):
                raise InputError(
                    f"'{name}' holds symbols that this design did not declare ({', '.join(strangers)}): create them"
                    " with its design.variable or design.parameter"
                )
        exact = TightEvaluation(declared.expressions(), declared.symbols())
        if exact.limits:
            implied = (Requirement(*limit, inside=INSIDE) for limit in exact.limits)
            declared = replace(declared, requirements=(*own, *implied))
            exact = TightEvaluation(declared.expressions(), declared.symbols(), shared=exact)
        if any(run.integration.accuracy.method == "idas" for run in exact.runs):
            raise InputError(
                "method 'idas' has no second derivatives, which a design needs: use 'auto', 'erk' or 'cvodes'"
            )
        owner = [k for k, r in enumerate(declared.requirements) for _ in range(r.expression.numel())]
        y, p = ca.MX.sym("y", len(declared.variables)), ca.MX.sym("p", len(declared.parameters))
        return cls(declared, own, exact, owner, compiled, many_slopes, y, p, dict(ipopt or {}))

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

    def exact_values(self, y: Vector, p: Vector, *, check: bool = False) -> list[Vector]:
        """Return objective and requirements by tight integration, or by the method that checks it."""
        return self.exact.values([*self.values(y), *p], check=check)

    @cached_property
    def first_rows(self) -> list[int]:
        """Number of each requirement's first row."""
        return [int(k) for k in np.flatnonzero(np.diff(np.array(self.owner, dtype=int), prepend=-1))]

    @cached_property
    def row_scales(self) -> Vector:
        """Divisor of each row of the requirements."""
        return np.array([self.scales[k] for k in self.owner])

    def margins(self, g: Vector) -> Vector:
        """Return the scaled distance of each row of the requirements from its limit, positive inside."""
        return np.minimum(g - self.low, self.high - g)

    def least_margins(self, g: Vector) -> Vector:
        """Return the smallest of the `margins` of each requirement; ``g`` has a row for each design."""
        if not self.first_rows:
            return np.zeros((len(g), 0))
        return np.minimum.reduceat(self.margins(g), self.first_rows, axis=1)

    def violation(self, g: Vector) -> float:
        """Return the largest scaled violation of any row, 0 if all limits are met."""
        return float(np.max(-self.margins(g), initial=0.0))

    def refuses(self, y: Vector, p: Vector) -> bool:
        """Return whether a scaled design lies outside the domain of a law."""
        return bool(self.exact.refusal([*self.values(np.clip(y, 0.0, 1.0)), *p]))

    def at(self, p: Vector, *, any_guess: bool = False) -> Program:
        """Return the program scaled by its values at the guess, after a check of the bounds.

        Args:
            p: parameters.
            any_guess: whether to scale by a sample of designs if the guess has no value.

        Raises:
            InputError: the objective or a requirement has no value at the guess nor, with ``any_guess``, in the sample.
            DomainError: the bounds exceed the model's domain.
        """
        key, cache = p.tobytes(), self._caches["at guess"]
        if key not in cache:
            check_bounds(self.declared, self.exact, p)
        try:
            own = len(self.own_requirements)
            values = cached(cache, key, lambda: values_at_guess(self.declared, self.exact, own, p))
        except InputError as error:
            if not any_guess:
                raise
            values = self._typical_values(p, error)
        return self._scaled_by(values, key)

    def with_steps(self, p: Vector, refinement: float = 1.0, starts: Sequence[Vector] | None = None) -> Program:
        """Return the program with as many integration steps as certain designs need.

        Args:
            p: parameters.
            refinement: factor on the number of steps.
            starts: the designs, scaled; by default the guess and the guess with each variable at either of its bounds.

        Raises:
            InputError, DomainError: as `at`, or the motion of one of the designs is too fast to integrate.
        """
        if self._scaled_at != p.tobytes():
            return self.at(p).with_steps(p, refinement, starts)
        designs = [at for _, at in corners(self.declared)] if starts is None else map(self.values, starts)
        steps = steps_at(self.exact, [[*values, *p] for values in designs], refinement)
        key = (*steps, self.objective_scale, *self.scales)
        built = cached(self._caches["built"], key, lambda: self._write(steps), _MOST_PROGRAMS)
        return replace(self, refinement=refinement, checked=None, _built=built)

    def _write(self, steps: list[int | None]) -> BuiltProgram:
        """Return the program with certain numbers of steps."""
        key = (self.objective_scale, *self.scales)
        y, p = self._y, self._p
        parts = cached(self._caches["parts"], key, lambda: split(self.scaled(y, p), [y, p]))
        # A program that is translated as a whole cannot call machine code.
        by_code = math.inf if self.compiled else 1 if self.many_slopes else MANY_STEPS
        # The scaled program alone: what is built must not refer to the cache that it is kept in.
        scaled = replace(self, checked=None, _built=None, _caches={})
        return BuiltProgram(scaled, steps, partial(build_nlp, parts, y, p, by_code=by_code))

    @property
    def built(self) -> BuiltProgram:
        """The program with its numbers of integration steps."""
        assert self._built is not None, "choose the numbers of steps first"
        return self._built

    @property
    def population(self) -> Population:
        """Evaluates objective and requirements, unscaled, at many scaled designs at once."""
        y, p, (objective, *rows) = self._y, self._p, self.declared.expressions()

        def write() -> Population:
            return Population(split(self._of_scaled([objective, ca.vertcat(*rows)], y, p), [y, p]), y, p)

        population: Population = cached(self._caches["population"], None, write)
        return population

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
        """Return the program as one of variables (y, p), so that derivatives by p are available."""
        n = self._y.numel()
        both, none = ca.MX.sym("z", n + self._p.numel()), ca.MX.sym("p", 0)
        parts = split(self.scaled(both[:n], both[n:]), [both, none])
        return build_nlp(parts, both, none, self.built.steps)

    def _scaled_by(self, values: list[Vector], key: bytes) -> Program:
        """Return the program with its objective scaled by a value, and each requirement by its limits or else a value.

        Args:
            values: of objective and requirements.
            key: the parameters, as bytes.
        """
        scales = tuple(
            r.scale or (_power_of_four(size) if (size := float(np.max(np.abs(value)))) else 1.0)
            for r, value in zip(self.declared.requirements, values[1:], strict=True)
        )
        return replace(self._with_scales(scales), _scaled_at=key).with_objective_scale(float(values[0].item()))

    def with_scales_around(self, y: Vector, p: Vector) -> Program:
        """Return the program with smaller scales of limits of 0 whose values near a design are far below those.

        Only a limit of 0 has no size of its own. If its expression spans many decades, as exp(100 x) does, its value at
        the guess says nothing about the size that matters at an optimum.

        Args:
            y: scaled design.
            p: parameters.
        """
        sizeless = [k for k, r in enumerate(self.declared.requirements) if not r.scale]
        if not sizeless:
            return self
        near, far_below = 0.01, 1e-3  # changes of a scaled variable, and of the size
        moves = np.vstack([np.zeros(len(y)), np.eye(len(y)), -np.eye(len(y))])
        _, g = self.population(np.clip(y + near * moves, 0.0, 1.0), p)
        sizes = np.maximum.reduceat(np.max(np.where(np.isfinite(g), np.abs(g), np.inf), axis=0), self.first_rows)
        smaller = {k: _power_of_four(sizes[k]) for k in sizeless if 0.0 < sizes[k] < far_below * self.scales[k]}
        scales = tuple(smaller.get(k, scale) for k, scale in enumerate(self.scales))
        return self._with_scales(scales) if smaller else self

    def _with_scales(self, scales: tuple[float, ...]) -> Program:
        """Return the program with its requirements scaled."""
        limits = [(r.low / scale, r.high / scale) for r, scale in zip(self.declared.requirements, scales, strict=True)]
        low, high = np.array([limits[k] for k in self.owner]).reshape(-1, 2).T
        return replace(self, scales=scales, low=low, high=high, _built=None)

    def with_objective_scale(self, objective: float) -> Program:
        """Return the program with its objective scaled by a value, such as one that a search found."""
        return replace(self, objective_scale=_power_of_four(objective), _built=None)

    def _typical_values(self, p: Vector, error: InputError) -> list[Vector]:
        """Return the medians of the expressions' sizes over a sample.

        Args:
            p: parameters.
            error: the reason why the guess has no value, raised if the sample has none either.
        """
        # Sizes of the sample; the larger one is tried if no design of the smaller one has a value.
        for count in (256, 4096):
            points = np.random.default_rng(256).random((count, len(self.declared.variables)))
            f, g = self.population(points, p)
            sound = np.isfinite(f) & np.all(np.isfinite(g), axis=1)
            if np.any(sound):
                break
        else:
            raise InputError(
                f"none of {count} designs between the bounds has a value, with {self.declared.ranges()}: {error}"
            )
        rows, owner = np.median(np.abs(g[sound]), axis=0), np.array(self.owner)
        return [np.median(np.abs(f[sound])), *(rows[owner == k] for k in range(len(self.declared.requirements)))]

    @property
    def wanted_error(self) -> float | None:
        """Smallest relative error that a run with method 'auto' must reach; None if no run has this method."""
        automatic = [run.integration.accuracy for run in self.exact.runs if run.integration.accuracy.method == "auto"]
        return min((accuracy.error or DEFAULT_ERROR for accuracy in automatic), default=None)

    @property
    def wanted_of_derivatives(self) -> float:
        """The error that the derivatives of the runs should reach."""
        return min((run.integration.accuracy.wanted_derivatives for run in self.exact.runs), default=math.inf)

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
        point = self.built.solver.solve(start, p, *_bounds(start, box, fixed), options)
        return replace(point, solved=False) if point.solved and self.refuses(point.y, p) else point

    def solve_relaxed(
        self, start: Vector, p: Vector, box: float = 1.0, fixed: Sequence[int] = (), *, exact: bool | None = None
    ) -> tuple[Point, Vector]:
        """Return the design that breaks the requirements least, found from a start, and the violations.

        The arguments are those of `solve`, and ``exact`` is that of `SolveOptions`.

        Returns:
            The point, and the scaled violation of each requirement there; their sum is least.
        """
        g = np.asarray(self.built.nlp.values(start, p)[1]).ravel()
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


def cached(cache: dict[Hashable, Cached], key: Hashable, make: Callable[[], Cached], most: float = 1) -> Cached:
    """Return a cache's entry, made if it is missing; the oldest are dropped beyond ``most`` entries."""
    if key not in cache:
        while len(cache) >= most:
            cache.pop(next(iter(cache)))
        cache[key] = make()
    return cache[key]


def _power_of_four(value: float) -> float:
    """Return the power of four nearest to a value's size, so that slightly different questions are scaled alike."""
    # An objective or a requirement is taken to have at least this size.
    return float(4.0 ** round(math.log(max(abs(value), 1e-12), 4.0)))


def error_of_derivatives(program: Program, y: Vector, p: Vector) -> float:
    """Return the largest error of the derivatives of a program's runs at a scaled design."""
    errors = (
        derivative_error(group.solver, group.first, group.varying, group.inputs(y, p).full())
        for group in program.built.plain.groups
    )
    return cached(program.built.errors, (y.tobytes(), p.tobytes()), lambda: max(errors, default=0.0))


def with_sure_steps(program: Program, p: Vector, starts: Sequence[Vector]) -> Program:
    """Return a program with steps for certain designs, enough for accurate derivatives at the first of them.

    Args:
        program: scaled.
        p: parameters.
        starts: scaled designs.

    Raises:
        InputError, DomainError: as `Program.with_steps`.
    """
    program = program.with_steps(p, starts=starts)
    error, wanted = error_of_derivatives(program, starts[0], p), program.wanted_of_derivatives
    if error > wanted:
        with contextlib.suppress(DomainError):  # too many steps
            return program.with_steps(p, steps_factor(error / wanted), starts)
    return replace(program, checked=(starts[0], error))
