"""A design as a scaled program: declarations in, IPOPT's functions out, built once for all solves."""

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
from plough_opt.design.forms import ActiveRows, as_machine_code, chosen_rows, first_slack, relaxed
from plough_opt.design.ipopt import FROM_AFAR, Point, SolveOptions, Solver, Vector
from plough_opt.design.nlp import Nlp, build_nlp
from plough_opt.design.population import LinearVariable, Population, linear_variables
from plough_opt.design.split import split
from plough_opt.design.verify import TightEvaluation, check_bounds, corners, rough_steps, steps_at, values_at_guess
from plough_opt.motion.accuracy import DEFAULT_ERROR

_SMALLEST_SCALE = 1e-12
# Programs that are kept, of other numbers of steps or scales.
_MOST_KEPT = 6
# Designs whose middle values set the scales where the guess has none.
_SAMPLE, _SAMPLE_SEED = 256, 256

Kept = TypeVar("Kept")


@dataclass
class BuiltProgram:
    """A program that is written for numbers of steps; its parts are made once they are needed.

    Attributes:
        steps: for each run their number, or None for the method it was written with.
        fewer: the same of a rough program.
        write: numbers of steps -> objective and requirements.
        owner: for each row of the requirements the number of its requirement.
        limits: scaled lower and upper limits of the rows.
        compiled: whether machine code is wanted.
        refinement: the factor on the steps that was asked for.
        checked: parameters and a scaled design, with the error of derivatives that was found there.
    """

    steps: list[int | None]
    fewer: list[int | None]
    write: Callable[[list[int | None]], Nlp]
    owner: Sequence[int]
    limits: tuple[Vector, Vector]
    compiled: bool
    refinement: float = 1.0
    checked: tuple[Vector, Vector, float] | None = None

    @cached_property
    def plain(self) -> Nlp:
        """Objective and requirements, interpreted."""
        return self.write(self.steps)

    @cached_property
    def nlp(self) -> Nlp:
        """The same, in machine code where that is wanted and there is a compiler."""
        return (as_machine_code(self.plain) if self.compiled else None) or self.plain

    @cached_property
    def rough(self) -> Nlp:
        """The same with two fifths of the steps, by which it shows as well which way the Lagrangian curves."""
        return self.write(self.fewer)

    @cached_property
    def solver(self) -> Solver:
        """IPOPT on it."""
        return Solver(self.nlp, *self.limits)

    @cached_property
    def near_solver(self) -> Solver | ActiveRows:
        """IPOPT on those of its rows that can decide, from nearly optimal starts."""
        few = chosen_rows(self.owner) < len(self.owner)
        return ActiveRows(self.nlp, self.owner, self.limits) if few else self.solver

    @cached_property
    def relaxed(self) -> Solver:
        """IPOPT on the sum of violations."""
        return Solver(relaxed(self.nlp, self.owner), *self.limits)


class Program:
    """The scaled program of some declarations: variables between 0 and 1, requirements and objective of order 1.

    It comes about in three stages. What was declared is known at once; `prepare` sets the scales for values of the
    parameters; `build` writes the program for numbers of integration steps, after which it can be solved.

    Attributes:
        declared: what was declared, with the requirements that theories bring at the end.
        exact: the same expressions, integrated tightly.
        owner: for each row of the requirements the number of its requirement.
        objective_scale: what the objective is divided by, after `prepare`.
        scales: what each requirement is divided by, after `prepare`.
        low: scaled lower limits of the rows, after `prepare`.
        high: scaled upper limits of the rows, after `prepare`.
        built: the program that was built last.
    """

    def __init__(
        self, declared: Declarations, *, compiled: bool = False, bare: Program | None = None, over: str = ""
    ) -> None:
        """Split the expressions around their runs, and add the requirements that the theories in them bring.

        Args:
            declared: what was declared.
            compiled: whether to translate the program into machine code.
            bare: where this asks for the tolerance box around a design: the same question of the design alone.
            over: in words, what is then minimised.

        Raises:
            InputError: an expression holds a symbol that was not declared.
        """
        self.declared = declared
        self._refuse_strangers()
        self.exact = TightEvaluation(self.expressions, declared.symbols())
        self._implied = tuple(
            Requirement(limit.name, carried, None, limit.at_most, limit.unit)
            for limit, carried in self.exact.limits.items()
        )
        if self._implied:
            self.declared = replace(declared, requirements=(*declared.requirements, *self._implied))
            self.exact = TightEvaluation(self.expressions, declared.symbols(), beside=self.exact)
        self._refuse_idas()
        self.owner = [k for k, r in enumerate(self.declared.requirements) for _ in range(r.expression.numel())]
        self._y, self._p = ca.MX.sym("y", len(declared.variables)), ca.MX.sym("p", len(declared.parameters))
        self.compiled, self.bare, self.over = compiled, bare, over
        self.objective_scale = 1.0
        self.scales: list[float] = []
        self._built: BuiltProgram | None = None
        self._prepared: bytes | None = None
        # The same question is solved by the same program again, whatever was asked in between.
        self._programs: dict[Hashable, BuiltProgram] = {}
        # Values that objective and requirements have at the guess, with the parameters of the last solve.
        self._at_guess: dict[bytes, list[Vector]] = {}
        self._linear: dict[Hashable, list[LinearVariable]] = {}
        # A report asks several times for the values at its point.
        self._exact_at: dict[Hashable, tuple[list[Vector], list[Vector]]] = {}

    @property
    def expressions(self) -> list[ca.MX]:
        """Objective and requirements."""
        return [self.declared.objective, *(r.expression for r in self.declared.requirements)]

    @property
    def own_requirements(self) -> tuple[Requirement, ...]:
        """The requirements that were declared, without those that theories bring."""
        return self.declared.requirements[: len(self.declared.requirements) - len(self._implied)]

    def _refuse_strangers(self) -> None:
        names = ["objective", *(r.name for r in self.declared.requirements)]
        for name, expression in zip(names, self.expressions, strict=True):
            if strangers := self.declared.strangers(expression):
                raise InputError(
                    f"'{name}' holds symbols that this design did not declare ({', '.join(strangers)}): make them"
                    " with design.variable or design.parameter of this design"
                )

    def _refuse_idas(self) -> None:
        if any(run.integration.accuracy.method == "idas" for run in self.exact.runs):
            raise InputError(
                "method 'idas' has no second derivatives, which a design needs: take 'auto', 'erk' or 'cvodes'"
            )

    # --- scaling -----------------------------------------------------------------------------------------

    def start(self) -> Vector:
        """Return the guesses, scaled."""
        return np.array([v.scaled(v.guess) for v in self.declared.variables])

    def values(self, y: Vector) -> Vector:
        """Return the variables in their own units."""
        return np.array([v.value(float(x)) for v, x in zip(self.declared.variables, y, strict=True)])

    def values_of(self, points: Vector) -> Vector:
        """Return the same of many designs, a row each."""
        columns = [
            np.select([y <= 0.0, y >= 1.0], [v.lower, v.upper], np.asarray(v.unscaled(y)))
            for v, y in zip(self.declared.variables, points.T, strict=True)
        ]
        return np.column_stack(columns)

    def exact_values(self, y: Vector, p: Vector) -> tuple[list[Vector], list[Vector]]:
        """Return objective and requirements, tightly integrated, and the same by the checking method."""
        at = y.tobytes(), p.tobytes()
        return _kept(self._exact_at, at, 1, lambda: self.exact([*self.values(y), *p]))

    # --- building ----------------------------------------------------------------------------------------

    def prepare(self, p: Vector, *, any_guess: bool = False) -> None:
        """Check the bounds, and scale the program by its guess, or by a sample where the guess has no value.

        Args:
            p: parameters.
            any_guess: whether a guess without a value will do.

        Raises:
            InputError: the objective or a requirement has no value at the guess, nor, if any will do, in a sample.
            DomainError: bounds that lead out of the model's domain.
        """
        key = p.tobytes()
        found = self._at_guess.get(key)
        if found is None:
            check_bounds(self.declared, self.exact, p)
            try:
                found = values_at_guess(self.declared, self.exact, self._implied, p)
                self._at_guess = {key: found}
            except InputError as error:
                if not any_guess:
                    raise
                found = self._typical(p, error)
        self._set_scales(found)
        self._prepared = key

    def build(self, p: Vector, refinement: float = 1.0, starts: Sequence[Vector] | None = None) -> None:
        """Write the program with enough integration steps at some designs, times ``refinement``.

        A program that has enough of them already is kept.

        Args:
            p: parameters.
            refinement: factor on the steps.
            starts: scaled designs; by default the guess and that with each variable at each of its bounds.

        Raises:
            InputError, DomainError: as `prepare`; or a motion too fast to integrate at one of the designs.
        """
        if self._prepared != p.tobytes():
            self.prepare(p)
        variables = self.declared.variables
        if starts is None:
            ends = (values for _, values in corners(self.declared))
            starts = [np.array([v.scaled(x) for v, x in zip(variables, values, strict=True)]) for values in ends]
        steps = steps_at(self.exact, [[*self.values(y), *p] for y in starts], refinement)
        key = (*steps, self.objective_scale, *self.scales)
        self._built = _kept(self._programs, key, _MOST_KEPT, lambda: self._write(steps))
        self._built.refinement = refinement

    def _write(self, steps: list[int | None]) -> BuiltProgram:
        """Return the program with numbers of steps."""
        write = partial(build_nlp, split(self.scaled(self._y, self._p), [self._y, self._p]), self._y, self._p)
        limits = self.low, self.high
        return BuiltProgram(steps, rough_steps(self.exact, steps), write, self.owner, limits, self.compiled)

    def linear_variables(self, p: Vector) -> list[LinearVariable]:
        """Return the variables that are solved from the algebra: see `plough_opt.design.population`."""
        declared = self.declared
        symbols = [own.symbol for own in declared.parameters]
        return _kept(
            self._linear, p.tobytes(), 1, lambda: linear_variables(self.expressions, declared.variables, symbols, p)
        )

    @property
    def built(self) -> BuiltProgram:
        """The program that was built last."""
        assert self._built is not None, "build the program first"
        return self._built

    @property
    def nlp(self) -> Nlp:
        """The built program."""
        return self.built.nlp

    @cached_property
    def population(self) -> Population:
        """Objective and requirements, unscaled, of many scaled designs at once."""
        raw = [self.declared.objective, ca.vertcat(*(r.expression for r in self.declared.requirements))]
        return Population(split(self._of_scaled(raw, self._y, self._p), [self._y, self._p]), self._y, self._p)

    def scaled(self, y: ca.MX, p: ca.MX) -> list[ca.MX]:
        """Return scaled objective and requirements of scaled variables and of parameters."""
        rows = [r.expression / scale for r, scale in zip(self.declared.requirements, self.scales, strict=True)]
        return self._of_scaled([self.declared.objective / self.objective_scale, ca.vertcat(*rows)], y, p)

    def _of_scaled(self, expressions: list[ca.MX], y: ca.MX, p: ca.MX) -> list[ca.MX]:
        """Return expressions of the design's symbols as those of scaled variables and of parameters."""
        declared = self.declared
        unscaled: list[Column] = [v.unscaled(x) for v, x in zip(declared.variables, ca.vertsplit(y), strict=True)]
        replacements = [*unscaled, *(ca.vertsplit(p) if declared.parameters else [])]
        return list(ca.graph_substitute(expressions, declared.symbols(), replacements))

    def with_parameters_varied(self) -> Nlp:
        """Return the built program in (scaled variables, parameters) as one column, and in no parameters."""
        n = self._y.numel()
        both, none = ca.MX.sym("z", n + self._p.numel()), ca.MX.sym("p", 0)
        parts = split(self.scaled(both[:n], both[n:]), [both, none])
        return build_nlp(parts, both, none, self.built.steps)

    def _set_scales(self, start: list[Vector]) -> None:
        """Scale the objective by its value at the start, each requirement by its limits, or by its own value."""
        self.objective_scale = _power_of_four(float(start[0].item()))
        requirements = self.declared.requirements
        self.scales = [
            r.scale or (_power_of_four(size) if (size := float(np.max(np.abs(value)))) else 1.0)
            for r, value in zip(requirements, start[1:], strict=True)
        ]
        self.low = np.array([requirements[k].low / self.scales[k] for k in self.owner])
        self.high = np.array([requirements[k].high / self.scales[k] for k in self.owner])

    def scale_by(self, objective: float) -> None:
        """Scale the objective by the size of a value that a search found, which may be another than the guess's."""
        self.objective_scale = _power_of_four(objective)

    def _typical(self, p: Vector, error: InputError) -> list[Vector]:
        """Return the middle values of the expressions over a sample, or say why the guess has none."""
        points = np.random.default_rng(_SAMPLE_SEED).random((_SAMPLE, len(self.declared.variables)))
        with np.errstate(all="ignore"):
            f, g = self.population(points, p)
        sound = np.isfinite(f) & np.all(np.isfinite(g), axis=1)
        if not np.any(sound):
            raise error
        rows, owner = np.median(np.abs(g[sound]), axis=0), np.array(self.owner)
        return [
            np.median(np.abs(f[sound])),
            *(rows[owner == k] for k in range(len(self.declared.requirements))),
        ]

    @property
    def wanted_error(self) -> float | None:
        """Tightest relative error that an automatic run of this program is to reach; None without such a run."""
        automatic = [run.integration.accuracy for run in self.exact.runs if run.integration.accuracy.method == "auto"]
        return min((accuracy.error or DEFAULT_ERROR for accuracy in automatic), default=None)

    # --- solving -----------------------------------------------------------------------------------------

    def solve(
        self,
        start: Vector,
        p: Vector,
        options: SolveOptions = FROM_AFAR,
        box: float = 1.0,
        fixed: int | Sequence[int] = (),
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a scaled start.

        Args:
            start: scaled variables.
            p: parameters.
            options: how to go about it.
            box: how far from the start a variable may go.
            fixed: numbers of variables that are held at the start.
        """
        solver = self.built.near_solver if options.near else self.built.solver
        return solver.solve(start, p, *_bounds(start, box, fixed), options)

    def solve_relaxed(
        self, start: Vector, p: Vector, box: float = 1.0, fixed: Sequence[int] = (), *, exact: bool | None = None
    ) -> tuple[Point, Vector]:
        """Return the design near a start at which the requirements give way least, and by how much each does, scaled.

        Arguments are those of `solve`; where variables are held, or within a box, the start lies near. Of ``exact`` see
        `plough_opt.design.ipopt.SolveOptions`.
        """
        g = np.asarray(self.nlp.values(start, p)[1]).ravel()
        slack = first_slack(g, (self.low, self.high), self.owner)
        # Where a theory ends nothing gives way: beyond it the model has no value.
        count, n = len(self.declared.requirements), len(start)
        gives = np.tile(np.arange(count) < len(self.own_requirements), 2)
        slack[~gives] = 0.0
        lower, upper = _bounds(start, box, fixed)
        lower, upper = np.r_[lower, np.zeros(2 * count)], np.r_[upper, np.where(gives, np.inf, 0.0)]
        options = SolveOptions(near=len(fixed) > 0 or box < 1.0, exact=exact)
        found = self.built.relaxed.solve(np.r_[start, slack], p, lower, upper, options)
        y, slack = np.clip(found.y[:n], 0.0, 1.0), found.y[n:]
        return replace(found, y=y, lam_y=found.lam_y[:n]), slack[:count] + slack[count:]


def _bounds(start: Vector, box: float, fixed: int | Sequence[int]) -> tuple[Vector, Vector]:
    """Return bounds of the scaled variables within a box around a start, at which some are held."""
    lower, upper = np.maximum(start - box, 0.0), np.minimum(start + box, 1.0)
    held = np.atleast_1d(np.asarray(fixed, dtype=int))
    lower[held] = upper[held] = start[held]
    return lower, upper


def _kept(cache: dict[Hashable, Kept], key: Hashable, most: int, make: Callable[[], Kept]) -> Kept:
    """Return what a cache has at a key, made if need be; the oldest of more than so many are dropped."""
    if key not in cache:
        while len(cache) >= most:
            cache.pop(next(iter(cache)))
        cache[key] = make()
    return cache[key]


def _power_of_four(value: float) -> float:
    """Return the power of four nearest to a size: questions that differ a little are scaled alike."""
    return float(4.0 ** round(math.log(max(abs(value), _SMALLEST_SCALE), 4.0)))
