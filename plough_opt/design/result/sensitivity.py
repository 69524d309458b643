"""Sensitivities of a solved design to parameters and limits, and values of expressions at its optimum."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind, check_switch, shown
from plough_opt.core.errors import InputError, NotConverged, nearest, printable
from plough_opt.core.units import in_words
from plough_opt.design.declarations import EVERYWHERE
from plough_opt.design.model.ipopt import Point, SolveOptions, Solver, Vector
from plough_opt.design.model.optimality import (
    Zero,
    decides,
    free_directions,
    newton_step,
    reduced_curvatures,
    symmetric,
)
from plough_opt.design.model.program import Program
from plough_opt.design.model.tight_integration import TightEvaluation

NO_PERCENTAGE = 1e-9
"""A smaller percentage is rounding, and shown as 0."""


# One-sided derivatives with a smaller relative difference count as equal.
_ONE_SIDED: Final = 1e-9


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
        sides = (("down to", self.valid_from, self.then[0]), ("up to", self.valid_to, self.then[1]))
        ends = [f"{side} {in_words(end, self.unit)}, where {then}" for side, end, then in sides if end is not None]
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
    return f"{name} by 0 %" if abs(elasticity) < NO_PERCENTAGE else f"{name} by {elasticity:+.4g} %"


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
        self._fixed = list(fixed)
        self.values = program.values(point.y)
        self.values[self._fixed] = list(fixed.values())

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
        value, unit, domain, change = self._asked(name)
        active, program = self._active, self.program
        named, scale = program.declared.named, program.objective_scale
        up, until_up, above = active.move(change, 1.0)
        down, until_down, below = active.move(change, -1.0)
        differs = bool(np.max(np.abs(up - down)) > _ONE_SIDED * np.max(np.abs([up, down])))
        objective, slopes = active.objective_slope(change) * scale, self._slopes
        rising, sizes, values = named(up * slopes), named(slopes), named(self._unscaled(active.y))
        (lowest, below), (highest, above) = (
            (
                None if math.isinf(end) else inside,
                then if inside == end or math.isinf(end) else "the model's domain ends",
            )
            for end, then in ((value - until_down, below), (value + until_up, above))
            for inside in [min(max(end, domain[0]), domain[1])]
        )
        return Sensitivity(
            name=name,
            value=value,
            unit=unit,
            objective=objective,
            variables=rising,
            elasticity=_elasticity(objective, value, active.f * scale, scale),
            elasticities={v: _elasticity(rising[v], value, values[v], sizes[v]) for v in rising},
            valid_from=lowest,
            valid_to=highest,
            then=(below, above),
            touching=active.names(active.weak) if differs else (),
            falling=named(down * slopes),
            difference=self._difference(value, change, objective, differs) if check else None,
        )

    def every(self) -> tuple[Sensitivity, ...]:
        """Return the sensitivities to all parameters that matter and all limits that decide, largest first."""
        active = self._active
        # A parameter matters if it changes the objective, a requirement or one of their slopes here.
        matters = np.any(np.vstack([active.gradient, active.gradients, active.hessian])[:, active.n :] != 0.0, axis=0)
        names = [p.name for p, matter in zip(self.program.declared.parameters, matters, strict=True) if matter]
        names += [name for name in active.names(active.deciding) if name in self._limits]
        return tuple(sorted(map(self.sensitivity, names), key=lambda item: -abs(item.elasticity or 0.0)))

    def _asked(self, name: str) -> tuple[float, str, tuple[float, float], Change]:
        """Return value, unit, domain and a change by one unit of the parameter or limit with a name.

        Raises:
            InputError: there is none; the message lists all names.
        """
        check_kind("the name", name, str, "that of a parameter or a limit")
        parameters, sides = self.program.declared.parameters, self._active.sides
        names = [parameter.name for parameter in parameters]
        if name in names:
            k = names.index(name)
            change = np.eye(len(names))[k], np.zeros(len(sides))
            return float(self.p[k]), parameters[k].unit, parameters[k].domain, change
        if asked := self._limits.get(name):
            moved = np.array([side.per_unit * (side.name == asked.name) for side in sides])
            return asked.limit, asked.unit, asked.domain, (np.zeros(len(names)), moved)
        own = [limit for limit in self._limits if limit.rpartition(" ")[0] == name]
        hint = f"did you mean {' or '.join(map(repr, own))}?" if own else nearest(name, [*names, *self._limits])
        end = "" if hint.endswith("?") else "."
        raise InputError(
            f"{shown(name)} is neither a parameter nor a limit of this design: {hint}{end} Parameters:"
            f" {', '.join(names) or 'none'}; limits: {', '.join(self._limits)}. To get the sensitivity to a"
            " quantity that was given as a number, declare it with design.parameter"
        )

    @cached_property
    def _limits(self) -> dict[str, Side]:
        """Limits by the names that users may give: a requirement's own name will do if it has just one limit."""
        limits = {side.name: side for side in self._active.sides if not side.hidden}
        owners = [side.owner for side in limits.values()]
        return limits | {side.owner: side for side in limits.values() if owners.count(side.owner) == 1}

    @property
    def _slopes(self) -> Vector:
        """Derivatives of the variables in their units by the scaled variables."""
        pairs = zip(self.program.declared.variables, self._active.y.tolist(), strict=True)
        return np.array([v.slope(y) for v, y in pairs])

    def _unscaled(self, y: Vector) -> list[float]:
        """Return the variables in their units, also beyond their declared bounds, which a check may move."""
        return [float(v.unscaled(float(x))) for v, x in zip(self.program.declared.variables, y, strict=True)]

    def _difference(self, value: float, change: Change, objective: float, differs: bool) -> float:
        """Return `Sensitivity.difference`, from solving again with a smaller and with a larger value."""
        active, scale, size = self._active, self.program.objective_scale, abs(value) or 1.0
        here = np.r_[active.f * scale, self._unscaled(active.y)]
        scales = np.r_[max(abs(here[0]), scale), [v.upper - v.lower for v in self.program.declared.variables]]
        errors, steps = [], []
        for sign in (1.0, -1.0):
            move, until, _ = active.move(change, sign)
            # The differences have errors of the square of this relative change, and of IPOPT's 1e-10 divided by it.
            step = min(2e-4 * size, 0.5 * until)
            slope = (self._solved_at(change, sign * step) - here) / (sign * step)
            errors.append((slope - np.r_[objective, move * self._slopes]) * size / scales)
            steps.append(step)
        # If the same limits decide on both sides, the mean is free of the curvature.
        return float(np.max(np.abs(errors if differs else np.average(errors, axis=0, weights=steps[::-1]))))

    def _solved_at(self, change: Change, step: float) -> Vector:
        """Return objective and variables of the design solved again after a step of a change."""
        program, active, count = self.program, self._active, len(self.program.low)
        low, high = np.r_[program.low, np.zeros(active.n)], np.r_[program.high, np.ones(active.n)]
        held = count + np.array(self._fixed, dtype=int)
        low[held] = high[held] = active.y[self._fixed]
        for side, moved in zip(active.sides, change[1].tolist(), strict=True):
            if moved:
                end = side.sign * (side.bound + step * moved)
                if side.row >= count:
                    end = program.declared.variables[side.row - count].scaled(side.limit + step)
                if side.sign > 0.0:
                    low[side.row] = end
                if side.sign < 0.0 or side.equality:
                    high[side.row] = end
        lower, upper = low[count:], high[count:]
        solver = Solver(program.built.nlp, low[:count], high[:count], program.ipopt)
        start, p = np.clip(active.y, lower, upper), self.p + step * change[0]
        point = solver.solve(start, p, lower, upper, SolveOptions(near=True))
        if not point.solved:
            raise NotConverged(f"the check could not solve the design near the value: {point.status}", point.status)
        return np.array([point.f * program.objective_scale, *self._unscaled(point.y)])


def _elasticity(derivative: float, value: float, result: float, size: float) -> float | None:
    """Return per cent of a result per per cent of a value; None if the result is 0 but for rounding of its size."""
    # Results below this part of their size, the optimiser's tolerance, count as 0: they have no elasticity.
    return None if abs(result) <= 1e-10 * size else derivative * value / result


# Scaled margins and multipliers below this count as zero.
_VANISHING: Final = 1e-8


_FLAT = (
    "the objective does not curve along some direction at this optimum: designs near it are as good to second order,"
    " and the optimum has no derivative"
)


@dataclass(frozen=True)
class Side:
    """One side of a limit, scaled: sign * (row of (g, y)) - bound >= 0, or == 0 for an equality.

    Attributes:
        name: the name that a user gives, such as "stiffness lower" or "loosened radius at_least".
        owner: name of the requirement or variable.
        limit: the limit, in ``unit``.
        unit: SI unit.
        row: number of the limited value among the rows of the requirements followed by the variables.
        sign: 1 for a lower limit, -1 for an upper one.
        bound: the scaled limit times the sign.
        per_unit: derivative of ``bound`` with respect to the limit.
        equality: whether lower and upper limit are equal.
        log: for a bound of a log-scaled variable, d ln(slope) / d scaled variable; else 0.
        domain: ends of the model's domain, in ``unit``.
        hidden: whether users cannot ask for it, because the program added it or its variable is held.
    """

    name: str
    owner: str
    limit: float
    unit: str
    row: int
    sign: float
    bound: float
    per_unit: float
    equality: bool = False
    log: float = 0.0
    domain: tuple[float, float] = EVERYWHERE
    hidden: bool = False


Change = tuple[Vector, Vector]
"""A change of the problem: of the parameters, and of the scaled bounds of the sides."""


class ActiveSet:
    """The sides that decide an optimum, and how it moves with parameters and limits.

    Attributes:
        n: number of variables.
        sides: every side of every limit.
        y: the optimum, scaled.
        f: scaled objective.
        mu: multiplier of each side.
        slack: c - b of each side.
        gradient: derivatives of the objective by (y, q).
        gradients: derivatives of the sides by (y, q), a row for each.
        hessian: Hessian of the Lagrangian by (y, q).
        deciding: for each side, whether it is an equality or strongly active.
        weak: numbers of the weakly active sides.
    """

    def __init__(self, program: Program, p: Vector, point: Point, fixed: Sequence[int] = ()) -> None:
        """Find the optimum to rounding, starting at the point where IPOPT stopped.

        Args:
            program: the design's program, built.
            p: parameters of the optimum.
            point: the optimum, as IPOPT left it.
            fixed: numbers of variables that are held at their values.

        Raises:
            InputError: the active sides are linearly dependent, or the optimum has no curvature.
            NotConverged: the active set cannot be determined.
        """
        self._program, self._p = program, p
        self._nlp = program.with_parameters_varied()
        self.n = len(point.y)
        self.sides = [*_sides_of_requirements(program), *_sides_of_variables(program, point, fixed)]
        self._rows = np.array([side.row for side in self.sides])
        self._equal = np.array([side.equality for side in self.sides], dtype=bool)
        self._signs, self._bounds, self._logs = np.array([(side.sign, side.bound, side.log) for side in self.sides]).T
        self._settle(point)
        self.deciding = self._equal | (self.mu > _VANISHING)
        touching = np.abs(self.slack) <= _VANISHING
        # Scaled gradients below this count as zero: a side that no variable changes cannot be touched by a design.
        touching &= np.any(np.abs(self.gradients[:, : self.n]) > 1e-12, axis=1)
        self.weak = np.flatnonzero(touching & ~self.deciding)
        self._refuse_degenerate()

    def _settle(self, point: Point) -> None:
        """Solve the optimality conditions by Newton's method, correcting the active set after each step."""
        pulls = -self._signs * np.r_[point.lam_g, point.lam_y][self._rows]
        mu = np.where(self._equal, pulls, np.maximum(0.0, pulls))
        self._evaluate(point.y, mu)
        active = self._equal | decides(self.slack, mu)
        for _ in range(10):
            mu = np.zeros(len(mu))
            step, mu[active] = self._step(active, self.gradient[: self.n], self.slack)
            y = self.y + step
            # Farther from IPOPT's point it has left for another optimum.
            if not np.all(np.abs(y - point.y) < 1e-3):
                break
            self._evaluate(y, mu)
            # An active side that pushes outwards is released; a broken one becomes active.
            wrong = ~self._equal & np.where(active, mu < -_VANISHING, self.slack < -_VANISHING)
            # The conditions then hold to rounding.
            if not np.any(wrong) and np.max(np.abs(step)) < 1e-12:
                return
            active = active ^ wrong
        # Where it fails and the curvature at IPOPT's point is below this, vanishing curvature is the reason.
        if not self._curved(self.gradients[active, : self.n], 1e-4):
            raise InputError(_FLAT)
        raise NotConverged(
            "the limits that decide this optimum cannot be distinguished from those that it only touches", "unsettled"
        )

    def _step(self, active: NDArray[np.bool_], gradient: Vector, gaps: Vector) -> tuple[Vector, Vector]:
        """Return `newton_step` with certain sides active."""
        h, rows = self.hessian[: self.n, : self.n], self.gradients[active, : self.n]
        return newton_step(h, gradient, rows, gaps[active])

    def _evaluate(self, y: Vector, mu: Vector) -> None:
        """Set the values, gradients and Hessian of the Lagrangian at a design with certain multipliers."""
        program, count = self._program, len(self._program.low)
        lam = np.zeros(count + self.n)
        np.add.at(lam, self._rows, -self._signs * mu)
        z = np.r_[y, self._p]
        f, g, gradient, jacobian = (np.asarray(result) for result in self._nlp.slopes(z, []))
        values = np.r_[g.ravel(), y]
        rows = np.vstack([jacobian, np.eye(self.n, len(z))])
        self.y, self.mu, self.f = y, mu, float(f.item())
        self.gradient = gradient.ravel()
        self.hessian = symmetric(np.asarray(self._nlp.hess_lag(z, [], 1.0, lam[:count])))
        self.gradients = self._signs[:, None] * rows[self._rows]
        self.slack = self._signs * values[self._rows] - self._bounds
        for k, side in enumerate(self.sides):
            if side.row >= count and not side.equality:
                # A bound moves in the variable's own unit, so its distance is measured in that, whatever the scale.
                v = program.declared.variables[side.row - count]
                self.slack[k] = (float(v.unscaled(float(y[side.row - count]))) - side.limit) * side.per_unit

    def objective_slope(self, change: Change) -> float:
        """Return d objective / d change, scaled: the change of the Lagrangian (envelope theorem)."""
        q, b = change
        return float((self.gradient - self.gradients.T @ self.mu)[self.n :] @ q + self.mu @ b)

    def move(self, change: Change, direction: float) -> tuple[Vector, float, str]:
        """Return the move of the optimum per unit of a change, for a growing (1) or falling (-1) amount of it.

        Any subset of the weakly active sides may hold the optimum as it moves. The subsets are tried from small to
        large.

        Returns:
            Derivatives of the scaled variables; the amount of the change at which the active set changes, to first
            order, infinity if it never does; and in words the side that begins or ceases to decide there, or "".

        Raises:
            InputError: no subset fits, so the optimum does not move along a line.
        """
        for size in range(len(self.weak) + 1):
            for chosen in itertools.combinations(self.weak, size):
                active = self.deciding.copy()
                active[list(chosen)] = True
                if (move := self._along(active, change, direction)) is not None:
                    return move
        raise InputError("the optimum has no derivative here: limits that just touch it leave no single direction")

    def _along(self, active: NDArray[np.bool_], change: Change, direction: float) -> tuple[Vector, float, str] | None:
        """Return the move with certain sides active, or None if it would break a side or need a negative multiplier."""
        n, (q, b) = self.n, change
        if not self._curved(self.gradients[active, :n]):
            return None
        l_yq_dq = self.hessian[:n, n:] @ q
        # Rates of the slacks: first with the variables held, later with their move.
        opening = self.gradients[:, n:] @ q - b
        mu_rate = np.zeros(len(self.mu))
        dy, mu_rate[active] = self._step(active, l_yq_dq, opening)
        size = float(np.max(np.abs(np.r_[l_yq_dq, opening[active]])))
        moved = self.gradients[:, :n] @ dy
        opening += moved
        # Multipliers of log-scaled variables' bounds are followed in the variable's own unit.
        mu_rate -= self.mu * self._logs * self._signs * moved
        # Active sides lose their multiplier, the others their slack.
        stock = np.where(active, self.mu, np.maximum(self.slack, 0.0))
        rate = direction * np.where(active, mu_rate, opening)
        rate[self._equal] = 0.0
        size = max(size, float(np.max(np.abs(rate))))
        # Rates of weakly active sides below this part of the largest rate count as zero.
        if np.any(rate[self.weak] < -1e-9 * size):
            return None
        rate[self.weak] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            # Relative rates below this are rounding: the side never begins or ceases to decide.
            reach = np.where(rate < -1e-13 * size, stock / -rate, np.inf)
        first = int(np.argmin(reach))  # A design has bounds, so it has sides.
        then = f"{self.sides[first].name} {'ceases' if active[first] else 'begins'} to decide"
        return dy, float(reach[first]), then if np.isfinite(reach[first]) else ""

    def names(self, which: NDArray[Any]) -> tuple[str, ...]:
        """Return the names of some sides, such as the deciding or the weakly active ones, each once."""
        return tuple(dict.fromkeys(self.sides[k].name for k in np.arange(len(self.sides))[which]))

    def _refuse_degenerate(self) -> None:
        a = self.gradients[self.deciding, : self.n]
        if free_directions(a).shape[1] > self.n - len(a):
            raise InputError(
                f"the limits that decide ({', '.join(self.names(self.deciding))}) are not independent: their"
                " multipliers are not unique, so there are no derivatives; drop or loosen one of them"
            )
        # More weakly active sides have too many subsets to try.
        if len(self.weak) > 8:
            raise InputError(
                f"too many limits just touch the optimum without deciding it: {', '.join(self.names(self.weak))};"
                " loosen them"
            )
        if not self._curved(a):
            raise InputError(_FLAT)

    def _curved(self, a: Vector, least: float = Zero.curvature) -> bool:
        """Return True if the Lagrangian curves upwards wherever sides with independent gradients ``a`` hold."""
        free = free_directions(a)
        # Dependent sides cannot all hold once one of their limits moves; least squares would move them apart.
        if free.shape[1] > self.n - len(a):
            return False
        curvatures, _ = reduced_curvatures(self.hessian[: self.n, : self.n], free)
        return not curvatures.size or bool(curvatures[0] > least)


def _sides_of_requirements(program: Program) -> Iterator[Side]:
    """Yield every side of every row of the requirements; equal limits are one equality."""
    for row, k in enumerate(program.owner):
        r, scale, hidden = program.declared.requirements[k], program.scales[k], k >= len(program.own_requirements)
        equal = r.at_least is not None and r.at_least == r.at_most
        for end, sign, limit in (("at_least", 1.0, r.at_least), ("at_most", -1.0, None if equal else r.at_most)):
            if limit is not None:
                name, bound = r.name if equal else f"{r.name} {end}", sign * limit / scale
                yield Side(name, r.name, limit, r.unit, row, sign, bound, sign / scale, equal, hidden=hidden)


def _sides_of_variables(program: Program, point: Point, fixed: Sequence[int]) -> Iterator[Side]:
    """Yield both bounds of every variable; a variable that is held becomes one equality."""
    for k, (v, y) in enumerate(zip(program.declared.variables, point.y.tolist(), strict=True)):
        row, per_unit, log = len(program.owner) + k, 1.0 / v.slope(y), math.log(v.upper / v.lower) if v.log else 0.0
        if k in fixed:
            yield Side(v.name, v.name, v.value(y), v.unit, row, 1.0, y, per_unit, equality=True, hidden=True)
            continue
        for end, sign, limit, bound in (("lower", 1.0, v.lower, 0.0), ("upper", -1.0, v.upper, -1.0)):
            how = (row, sign, bound, sign * per_unit, False, log, v.domain)
            yield Side(f"{v.name} {end}", v.name, limit, v.unit, *how)
