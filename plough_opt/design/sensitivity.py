"""Questions to a solved design: values of expressions, and how it changes with a parameter or a limit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_kind, check_switch, shown
from plough_opt.core.errors import InputError, NotConverged, nearest
from plough_opt.core.units import in_words
from plough_opt.design.active_set import ActiveSet, Move, sides_of
from plough_opt.design.declarations import EVERYWHERE
from plough_opt.design.ipopt import Point, SolveOptions, Solver, Vector
from plough_opt.design.program import Program
from plough_opt.design.verify import TightEvaluation

# Of the value asked for: differences leave its square, and the optimiser's 1e-10 divided by it.
_CHECK_STEP = 2e-4
# An elasticity below this is the rounding of none.
_ROUNDING = 1e-9
# Two one-sided derivatives nearer than this are one.
_SAME = 1e-9


@dataclass(frozen=True)
class Sensitivity:
    """How the best objective and the best variables change with a parameter or a limit, the design solved again.

    Attributes:
        name: as asked for.
        value: of the parameter or limit, in ``unit``.
        unit: SI unit.
        objective: d objective / d value.
        variables: name -> d variable / d value; where ``touching`` is not empty, for a value that grows.
        elasticity: per cent of the objective per per cent of the value; None where the objective is 0.
        elasticities: the same of the variables.
        valid_from: value down to which, to first order, the same limits decide, or end of the model's domain, where
            that is declared and nearer; None: all the way.
        valid_to: value up to which they do, or the domain's other end.
        then: what begins or ceases to decide below ``valid_from`` and above ``valid_to``, in words.
        touching: limits that just touch the optimum, so that the variables move differently up and down.
        falling: name -> d variable / d value for a value that falls.
        difference: with ``check``: largest difference from solving again beside the value, as change of the
            objective, relative, or of a variable, of its range, per relative change of the value.
    """

    name: str
    value: float
    unit: str
    objective: float
    variables: dict[str, float]
    elasticity: float | None
    elasticities: dict[str, float | None]
    valid_from: float | None
    valid_to: float | None
    then: tuple[str, str]
    touching: tuple[str, ...]
    falling: dict[str, float]
    difference: float | None = None

    def __str__(self) -> str:
        """Say it in words."""
        moves = [_percent("the objective", self.elasticity, self.objective, self.unit)]
        moves += [_percent(n, self.elasticities[n], self.variables[n], self.unit) for n in self.variables]
        text = f"{self.name} = {in_words(self.value, self.unit)}; one per cent more changes {', '.join(moves)}"
        ends = [
            f"{side} {in_words(end, self.unit)}, where {then}"
            for side, end, then in (("down to", self.valid_from, self.then[0]), ("up to", self.valid_to, self.then[1]))
            if end is not None
        ]
        text += f". The same limits decide {' and '.join(ends) if ends else 'whatever its value'}, to first order."
        if self.touching:
            met = ", ".join(self.touching)
            text += f" This is for a value that grows: {met} is just met, and decides on one side only."
        if self.difference is not None:
            text += f" Solving again beside it differs by {self.difference:.1e}."
        return text


def _percent(name: str, elasticity: float | None, derivative: float, unit: str) -> str:
    if elasticity is None:
        return f"{name} by {derivative:.4g} per {unit or 'unit'}"
    return f"{name} by 0 %" if abs(elasticity) < _ROUNDING else f"{name} by {elasticity:+.4g} %"


@dataclass(frozen=True)
class _Target:
    """A parameter by its number, or a limit by the name of its sides."""

    value: float
    unit: str
    parameter: int | None = None
    side: str = ""
    domain: tuple[float, float] = EVERYWHERE

    def within(self, end: float, then: str) -> tuple[float | None, str]:
        """Return how far a range goes, and what is there: no further than the model."""
        if not math.isfinite(end):
            return None, then
        inside = min(max(end, self.domain[0]), self.domain[1])
        return inside, then if inside == end else "the model's domain ends"


class Solved:
    """A program with its optimum: values of expressions there, and sensitivities.

    Attributes:
        program: built.
        p: its parameters.
        point: the optimum.
        values: of the variables, in their units.
    """

    def __init__(
        self, program: Program, p: Vector, point: Point, fixed: Mapping[int, float] = MappingProxyType({})
    ) -> None:
        """Take an optimum of a built program, with some of its variables, by number, held at values."""
        self.program, self.p, self.point = program, p, point
        self._fixed = tuple(fixed)
        self.values = program.values(point.y)
        self.values[list(self._fixed)] = list(fixed.values())

    def evaluate(self, expression: ca.MX) -> Vector:
        """Return an expression of the design's symbols at the optimum, its runs integrated tightly.

        Raises:
            InputError: it holds symbols that are not of this design.
        """
        if isinstance(expression, ca.SX):
            raise InputError("an SX expression cannot be of this design, whose variables are MX")
        declared, expression = self.program.declared, ca.MX(expression)
        if strangers := declared.strangers(expression):
            raise InputError(f"the expression holds symbols that are not of this design: {', '.join(strangers)}")
        evaluation = TightEvaluation([expression], declared.symbols(), beside=self.program.exact)
        return np.squeeze(evaluation.values([*self.values, *self.p])[0])

    @cached_property
    def _active(self) -> ActiveSet:
        """The data that all sensitivities share."""
        return ActiveSet(self.program, self.p, self.point, self._fixed)

    def sensitivity(self, name: str, *, check: bool = False) -> Sensitivity:
        """Return the sensitivity to a parameter or a limit: see `Optimum.sensitivity`."""
        check_switch("check", check)
        target = self._target(name)
        change = self._active.change(target.parameter, target.side)
        up, down = self._active.move(change, 1.0), self._active.move(change, -1.0)
        objective = self._active.objective_slope(change) * self.program.objective_scale
        best = self._active.f * self.program.objective_scale
        rising, falling = self._in_units(up.y), self._in_units(down.y)
        values = dict(zip(rising, self._unscaled(self._active.y), strict=True))
        lowest, below = target.within(target.value - down.until, down.then)
        highest, above = target.within(target.value + up.until, up.then)
        names = [v.name for v in self.program.declared.variables if not v.auxiliary]
        differs = bool(np.max(np.abs(up.y - down.y)) > _SAME * np.max(np.abs([up.y, down.y])))
        return Sensitivity(
            name=name,
            value=target.value,
            unit=target.unit,
            objective=objective,
            variables={v: rising[v] for v in names},
            elasticity=_elasticity(objective, target.value, best),
            elasticities={v: _elasticity(rising[v], target.value, values[v]) for v in names},
            valid_from=lowest,
            valid_to=highest,
            then=(below, above),
            touching=self._active.touching if differs else (),
            falling={v: falling[v] for v in names},
            difference=self._difference(target, objective, up, down) if check else None,
        )

    def every(self) -> tuple[Sensitivity, ...]:
        """Return those to all parameters that matter and all limits that decide, the largest elasticity first."""
        matters = self._active.parameters_that_matter
        names = [p.name for p, matter in zip(self.program.declared.parameters, matters, strict=True) if matter]
        names += [name for name in self._active.deciding_names if name in self._limits]
        return tuple(sorted(map(self.sensitivity, names), key=lambda found: -abs(found.elasticity or 0.0)))

    # --- what can be asked -------------------------------------------------------------------------------

    def _target(self, name: str) -> _Target:
        check_kind("the name", name, str, "that of a parameter or a limit")
        for k, (parameter, value) in enumerate(zip(self.program.declared.parameters, self.p, strict=True)):
            if parameter.name == name:
                return _Target(float(value), parameter.unit, parameter=k, domain=parameter.domain)
        if name in self._limits:
            return self._limits[name]
        parameters = [parameter.name for parameter in self.program.declared.parameters]
        own = [limit for limit in self._limits if limit.rpartition(" ")[0] == name]
        hint = f"did you mean {' or '.join(map(repr, own))}?" if own else nearest(name, [*parameters, *self._limits])
        end = "" if hint.endswith("?") else "."
        raise InputError(
            f"{shown(name)} is neither a parameter nor a limit of this design: {hint}{end} Parameters:"
            f" {', '.join(parameters) or 'none'}; limits: {', '.join(self._limits)}. A quantity that was given as a"
            " number is not a part of the design: declare it with design.parameter"
        )

    @cached_property
    def _limits(self) -> dict[str, _Target]:
        """Limits that can be asked for: those of a requirement by its name too, where it has just one."""
        sides = [side for side in sides_of(self.program, self.point, self._fixed) if not side.hidden]
        found = {side.name: _Target(side.limit, side.unit, side=side.name, domain=side.domain) for side in sides}
        names: dict[str, set[str]] = {}
        for side in sides:
            names.setdefault(side.owner, set()).add(side.name)
        return found | {owner: found[min(own)] for owner, own in names.items() if len(own) == 1}

    # --- units -------------------------------------------------------------------------------------------

    def _in_units(self, dy: Vector) -> dict[str, float]:
        """Return derivatives of the scaled variables as derivatives of the variables."""
        return {
            v.name: float(d) * v.slope(float(y))
            for v, d, y in zip(self.program.declared.variables, dy, self._active.y, strict=True)
        }

    def _unscaled(self, y: Vector) -> list[float]:
        """Return the variables, beyond their bounds too where these have moved."""
        return [float(v.unscaled(float(x))) for v, x in zip(self.program.declared.variables, y, strict=True)]

    # --- solving again -----------------------------------------------------------------------------------

    def _difference(self, target: _Target, objective: float, up: Move, down: Move) -> float:
        """Return how far differences of optima beside the value are from the derivatives, per relative change."""
        size = abs(target.value) or 1.0
        ranges = [v.upper - v.lower for v in self.program.declared.variables]
        here = np.r_[self._active.f * self.program.objective_scale, self._unscaled(self._active.y)]
        scales = np.r_[max(abs(here[0]), self.program.objective_scale), ranges]
        found = []
        for move, sign in ((up, 1.0), (down, -1.0)):
            step = min(_CHECK_STEP * size, 0.5 * move.until)
            expected = np.r_[objective, list(self._in_units(move.y).values())]
            found.append(
                (((self._solved_at(target, sign * step) - here) / (sign * step) - expected) * size / scales, step)
            )
        (rising, up_step), (falling, down_step) = found
        # The curvature cancels where both differences belong to the same limits.
        mean = (rising * down_step + falling * up_step) / (up_step + down_step)
        same = np.allclose(up.y, down.y, rtol=1e-9, atol=0.0)
        return float(np.max(np.abs(mean if same else np.r_[rising, falling])))

    def _solved_at(self, target: _Target, step: float) -> Vector:
        """Return objective and variables of the design solved again with the parameter or limit moved by a step."""
        program, p = self.program, self.p.copy()
        low, high = program.low.copy(), program.high.copy()
        lower, upper = np.zeros(len(self._active.y)), np.ones(len(self._active.y))
        held = list(self._fixed)
        lower[held] = upper[held] = self._active.y[held]
        if target.parameter is not None:
            p[target.parameter] += step
        count = len(low)
        for side in self._active.sides:
            if side.name != target.side:
                continue
            if side.row >= count:
                v = program.declared.variables[side.row - count]
                (lower if side.sign > 0.0 else upper)[side.row - count] = v.scaled(target.value + step)
                continue
            if side.sign > 0.0:
                low[side.row] += step * side.per_unit
            if side.sign < 0.0 or side.equality:
                high[side.row] += step * abs(side.per_unit)
        solver = Solver(program.nlp, low, high)
        point = solver.solve(np.clip(self._active.y, lower, upper), p, lower, upper, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged(f"beside the value the design cannot be solved: {point.status}", point.status)
        return np.array([point.f * program.objective_scale, *self._unscaled(point.y)])


def _elasticity(derivative: float, value: float, result: float) -> float | None:
    return None if result == 0.0 else derivative * value / result
