"""Sensitivities of a solved design to parameters and limits, and values of expressions at its optimum."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_kind, check_switch, shown
from plough_opt.core.errors import InputError, NotConverged, nearest, printable
from plough_opt.core.units import in_words
from plough_opt.design.certify.active_set import ActiveSet, Move, sides_of
from plough_opt.design.declarations import EVERYWHERE
from plough_opt.design.model.ipopt import Point, SolveOptions, Solver, Vector
from plough_opt.design.model.program import Program
from plough_opt.design.model.tight_integration import TightEvaluation

# Relative change of the value for which a check solves again: the differences have errors of its square, and of the
# optimiser's 1e-10 divided by it.
_CHECK_STEP = 2e-4
# Elasticities below this are shown as 0 %.
_NO_ELASTICITY = 1e-9
# Results below this part of their size, the optimiser's tolerance, count as 0: they have no elasticity.
_NO_RESULT = 1e-10
# One-sided derivatives with a smaller relative difference count as equal.
_SAME_RATE = 1e-9


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the best objective and the best variables with respect to a parameter or a limit.

    Attributes:
        name: name of the parameter or limit, as given.
        value: its value, in ``unit``.
        unit: SI unit.
        objective: d objective / d value.
        variables: name -> d variable / d value; for a growing value if ``touching`` is not empty.
        elasticity: per cent of the objective per per cent of the value; None if the objective is 0.
        elasticities: name -> the same for each variable.
        valid_from: lower end of the range within which, to first order, the same limits decide, or of the model's
            declared domain if that is nearer; None if there is no end.
        valid_to: upper end of that range.
        then: in words, what begins or ceases to decide below ``valid_from`` and above ``valid_to``.
        touching: limits that just touch the optimum, so that the variables move differently up and down.
        falling: name -> d variable / d value for a falling value.
        difference: with ``check``, the largest difference between these derivatives and finite differences of optima
            solved again: of the objective relative to its size, and of each variable relative to its range, per
            relative change of the value.
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
        """Return the elasticities, the range in which they hold and the result of a check, in words."""
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
            text += f" These figures apply to increasing values: {met} is just met, and decides on one side only."
        if self.difference is not None:
            text += f" Solving again near this value gives a difference of {self.difference:.1e}."
        return printable(text)


def _percent(name: str, elasticity: float | None, derivative: float, unit: str) -> str:
    if elasticity is None:
        return f"{name} by {derivative:.4g} per {unit or 'unit'}"
    return f"{name} by 0 %" if abs(elasticity) < _NO_ELASTICITY else f"{name} by {elasticity:+.4g} %"


@dataclass(frozen=True)
class _Target:
    """A parameter, given by its number, or a limit, given by the name of its sides."""

    value: float
    unit: str
    parameter: int | None = None
    side: str = ""
    domain: tuple[float, float] = EVERYWHERE

    def within(self, end: float, then: str) -> tuple[float | None, str]:
        """Return the end of a range, clipped at the model's domain, and what happens there; None without an end."""
        if not math.isfinite(end):
            return None, then
        inside = min(max(end, self.domain[0]), self.domain[1])
        return inside, then if inside == end else "the model's domain ends"


class Solved:
    """A program with its optimum, which evaluates expressions and sensitivities there.

    Attributes:
        program: the program, built.
        p: parameters.
        point: the optimum.
        values: values of the variables, in their units.
        rounder: as given.
    """

    def __init__(
        self,
        program: Program,
        p: Vector,
        point: Point,
        fixed: Mapping[int, float] = MappingProxyType({}),
        rounder: Callable[[Solved, Mapping[str, Any]], Any] | None = None,
    ) -> None:
        """Store an optimum of a built program.

        Args:
            program: the program.
            p: parameters.
            point: the optimum.
            fixed: number -> value of the variables that are held.
            rounder: (this object, catalogues) -> the optimum with some variables rounded.
        """
        self.program, self.p, self.point, self.rounder = program, p, point, rounder
        self._fixed = tuple(fixed)
        self.values = program.values(point.y)
        self.values[list(self._fixed)] = list(fixed.values())

    def __deepcopy__(self, _memo: object) -> Solved:
        """Return this object, which never changes."""
        return self

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """Return None in place of the design's functions, which cannot be pickled."""
        return type(None), ()

    def evaluate(self, expression: ca.MX) -> Vector:
        """Return the value of an expression of the design's symbols at the optimum, its runs integrated tightly.

        Raises:
            InputError: the expression holds symbols that do not belong to this design.
        """
        if isinstance(expression, ca.SX):
            raise InputError("an SX expression cannot belong to this design, whose variables are MX")
        declared, expression = self.program.declared, ca.MX(expression)
        if strangers := declared.strangers(expression):
            raise InputError(f"the expression holds symbols that do not belong to this design: {', '.join(strangers)}")
        evaluation = TightEvaluation([expression], declared.symbols(), shared=self.program.exact)
        return np.squeeze(evaluation.values([*self.values, *self.p])[0])

    @cached_property
    def _active(self) -> ActiveSet:
        """The active set, which all sensitivities share."""
        return ActiveSet(self.program, self.p, self.point, self._fixed)

    def sensitivity(self, name: str, *, check: bool = False) -> Sensitivity:
        """Return the sensitivity to a parameter or a limit: see `Optimum.sensitivity`."""
        check_switch("check", check)
        target = self._target(name)
        change = self._active.change(target.parameter, target.side)
        up, down = self._active.move(change, 1.0), self._active.move(change, -1.0)
        objective = self._active.objective_slope(change) * self.program.objective_scale
        best = self._active.f * self.program.objective_scale
        rising, falling, sizes = map(self._in_units, (up.y, down.y, np.ones(len(up.y))))
        values = dict(zip(rising, self._unscaled(self._active.y), strict=True))
        lowest, below = target.within(target.value - down.until, down.then)
        highest, above = target.within(target.value + up.until, up.then)
        names = [v.name for v in self.program.declared.variables if not v.auxiliary]
        differs = bool(np.max(np.abs(up.y - down.y)) > _SAME_RATE * np.max(np.abs([up.y, down.y])))
        return Sensitivity(
            name=name,
            value=target.value,
            unit=target.unit,
            objective=objective,
            variables={v: rising[v] for v in names},
            elasticity=_elasticity(objective, target.value, best, self.program.objective_scale),
            elasticities={v: _elasticity(rising[v], target.value, values[v], sizes[v]) for v in names},
            valid_from=lowest,
            valid_to=highest,
            then=(below, above),
            touching=self._active.touching if differs else (),
            falling={v: falling[v] for v in names},
            difference=self._difference(target, objective, up, down) if check else None,
        )

    def every(self) -> tuple[Sensitivity, ...]:
        """Return the sensitivities to all parameters that matter and all limits that decide, largest first."""
        matters = self._active.parameters_that_matter
        names = [p.name for p, matter in zip(self.program.declared.parameters, matters, strict=True) if matter]
        names += [name for name in self._active.deciding_names if name in self._limits]
        return tuple(sorted(map(self.sensitivity, names), key=lambda one: -abs(one.elasticity or 0.0)))

    # --- parameters and limits by name -------------------------------------------------------------------

    def _target(self, name: str) -> _Target:
        """Return the parameter or limit with a name.

        Raises:
            InputError: there is none; the message lists all names.
        """
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
            f" {', '.join(parameters) or 'none'}; limits: {', '.join(self._limits)}. To get the sensitivity to a"
            " quantity that was given as a number, declare it with design.parameter"
        )

    @cached_property
    def _limits(self) -> dict[str, _Target]:
        """Limits by the names that users may give: a requirement's own name will do if it has just one limit."""
        sides = [side for side in sides_of(self.program, self.point, self._fixed) if not side.hidden]
        found = {side.name: _Target(side.limit, side.unit, side=side.name, domain=side.domain) for side in sides}
        names: dict[str, set[str]] = {}
        for side in sides:
            names.setdefault(side.owner, set()).add(side.name)
        return found | {owner: found[min(own)] for owner, own in names.items() if len(own) == 1}

    # --- units -------------------------------------------------------------------------------------------

    def _in_units(self, dy: Vector) -> dict[str, float]:
        """Return derivatives of the variables in their units from those of the scaled variables."""
        return {
            v.name: float(d) * v.slope(float(y))
            for v, d, y in zip(self.program.declared.variables, dy, self._active.y, strict=True)
        }

    def _unscaled(self, y: Vector) -> list[float]:
        """Return the variables in their units, also beyond their declared bounds, which a check may move."""
        return [float(v.unscaled(float(x))) for v, x in zip(self.program.declared.variables, y, strict=True)]

    # --- solving again -----------------------------------------------------------------------------------

    def _difference(self, target: _Target, objective: float, up: Move, down: Move) -> float:
        """Return `Sensitivity.difference`, from solving again with a smaller and with a larger value."""
        size = abs(target.value) or 1.0
        ranges = [v.upper - v.lower for v in self.program.declared.variables]
        here = np.r_[self._active.f * self.program.objective_scale, self._unscaled(self._active.y)]
        scales = np.r_[max(abs(here[0]), self.program.objective_scale), ranges]
        errors, steps = [], []
        for move, sign in ((up, 1.0), (down, -1.0)):
            step = min(_CHECK_STEP * size, 0.5 * move.until)
            expected = np.r_[objective, list(self._in_units(move.y).values())]
            slope = (self._solved_at(target, sign * step) - here) / (sign * step)
            errors.append((slope - expected) * size / scales)
            steps.append(step)
        (rising, falling), (up_step, down_step) = errors, steps
        # If the same limits decide on both sides, the mean is free of the curvature.
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
        solver = Solver(program.nlp, low, high, program.ipopt)
        point = solver.solve(np.clip(self._active.y, lower, upper), p, lower, upper, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged(f"the check could not solve the design near the value: {point.status}", point.status)
        return np.array([point.f * program.objective_scale, *self._unscaled(point.y)])


def _elasticity(derivative: float, value: float, result: float, size: float) -> float | None:
    """Return per cent of a result per per cent of a value; None if the result is 0 but for rounding of its size."""
    return None if abs(result) <= _NO_RESULT * size else derivative * value / result
