"""The active set of an optimum, and how the optimum moves with parameters and limits.

Let z = (y, q) hold the scaled variables y and the parameters q, and write every side of every limit as c(z) - b >= 0.
At an optimum f_y = sum mu c_y over the active sides. To first order in q and b it moves by::

    H dy - A' dmu = -L_yq dq,    A dy = db - c_q dq

where A holds the gradients of the active sides, and H and L_yq are blocks of the Hessian of the Lagrangian
L = f - mu'(c - b) (Fiacco 1983, "Introduction to sensitivity and stability analysis in nonlinear programming",
chapter 3). A side with mu > 0 is strongly active. A side that the optimum touches with mu = 0 is weakly active: it may
or may not hold the optimum as it moves.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError, NotConverged
from plough_opt.design.declarations import EVERYWHERE
from plough_opt.design.model.ipopt import Point, Vector
from plough_opt.design.model.optimality import (
    FLAT_CURVATURE,
    PULLS,
    free_directions,
    independent,
    newton_step,
    reduced_curvatures,
    symmetric,
)
from plough_opt.design.model.program import Program

Mask = NDArray[np.bool_]

# Newton's method ends when no scaled variable moves by more than this: the conditions then hold to rounding.
_NEWTON_CONVERGED = 1e-12
_MOST_NEWTON_STEPS = 10
# Scaled distance from IPOPT's point beyond which Newton's method has left for another optimum.
_LOST = 1e-3
# Scaled margins and multipliers below this count as zero.
_ZERO = 1e-8
# Scaled gradients below this count as zero: a side that no variable changes cannot be touched by a design.
_NO_GRADIENT = 1e-12
# Where Newton's method fails and the curvature at IPOPT's point is below this, vanishing curvature is the reason.
_SLOW_CURVATURE = 1e-4
# Gradients of length 1 are linearly dependent if their matrix has a singular value below this. Rates of weakly active
# sides count as zero if they are smaller than this part of the largest rate.
_RANK = 1e-9
# Relative rates below this are rounding: the side never begins or ceases to decide.
_NO_RATE = 1e-13
# More weakly active sides have too many subsets to try.
_MOST_WEAK = 8

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


@dataclass(frozen=True)
class Change:
    """A change of the problem: ``q`` of the parameters, and ``b`` of the scaled bounds of the sides."""

    q: Vector
    b: Vector


@dataclass(frozen=True)
class Move:
    """The move of the optimum per unit of a change.

    Attributes:
        y: derivatives of the scaled variables.
        until: amount of the change at which the active set changes, to first order; infinity if it never does.
        then: in words, the side that begins or ceases to decide there; "" if none does.
    """

    y: Vector
    until: float
    then: str


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
        self.sides = sides_of(program, point, fixed)
        self._rows = np.array([side.row for side in self.sides])
        self._equal = np.array([side.equality for side in self.sides], dtype=bool)
        self._signs, self._bounds, self._logs = np.array([(one.sign, one.bound, one.log) for one in self.sides]).T
        self._settle(point)
        self.deciding = self._equal | (self.mu > _ZERO)
        touching = np.abs(self.slack) <= _ZERO
        touching &= np.any(np.abs(self.gradients[:, : self.n]) > _NO_GRADIENT, axis=1)
        self.weak = np.flatnonzero(touching & ~self.deciding)
        self._refuse_degenerate()

    # --- the optimum itself ------------------------------------------------------------------------------

    def _settle(self, point: Point) -> None:
        """Solve the optimality conditions by Newton's method, correcting the active set after each step."""
        both = np.r_[point.lam_g, point.lam_y]
        mu = np.maximum(0.0, -self._signs * both[self._rows])
        mu[self._equal] = (-self._signs * both[self._rows])[self._equal]
        self._evaluate(point.y, mu)
        active = self._equal | ((mu > PULLS) & (mu > self.slack))
        for _ in range(_MOST_NEWTON_STEPS):
            mu = np.zeros(len(mu))
            step, mu[active] = self._newton_step(active, self.gradient[: self.n], self.slack[active])
            y = self.y + step
            if not np.all(np.abs(y - point.y) < _LOST):
                break
            self._evaluate(y, mu)
            # An active side that pushes outwards is released; a broken one becomes active.
            wrong = ~self._equal & np.where(active, mu < -_ZERO, self.slack < -_ZERO)
            if not np.any(wrong) and np.max(np.abs(step)) < _NEWTON_CONVERGED:
                return
            active = active ^ wrong
        if not self._curved(self.gradients[active, : self.n], _SLOW_CURVATURE):
            raise InputError(_FLAT)
        raise NotConverged(
            "the limits that decide this optimum cannot be distinguished from those that it only touches", "unsettled"
        )

    def _newton_step(self, active: Mask, gradient: Vector, gaps: Vector) -> tuple[Vector, Vector]:
        """Return `newton_step` with certain sides active."""
        return newton_step(self.hessian[: self.n, : self.n], gradient, self.gradients[active, : self.n], gaps)

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

    # --- how it moves ------------------------------------------------------------------------------------

    def objective_slope(self, change: Change) -> float:
        """Return d objective / d change, scaled: the change of the Lagrangian (envelope theorem)."""
        lagrangian = self.gradient - self.gradients.T @ self.mu
        return float(lagrangian[self.n :] @ change.q + self.mu @ change.b)

    def move(self, change: Change, direction: float) -> Move:
        """Return the move of the optimum per unit of a change, for a growing (1) or falling (-1) amount of it.

        Any subset of the weakly active sides may hold the optimum as it moves. The subsets are tried from small to
        large.

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

    def _along(self, active: Mask, change: Change, direction: float) -> Move | None:
        """Return the move with certain sides active, or None if it would break a side or need a negative multiplier."""
        n = self.n
        if not self._curved(self.gradients[active, :n]):
            return None
        l_yq_dq = self.hessian[:n, n:] @ change.q
        # Rates of the slacks: first with the variables held, later with their move.
        opening = self.gradients[:, n:] @ change.q - change.b
        mu_rate = np.zeros(len(self.mu))
        dy, mu_rate[active] = self._newton_step(active, l_yq_dq, opening[active])
        size = float(np.max(np.abs(np.r_[l_yq_dq, opening[active]])))
        moved = self.gradients[:, :n] @ dy
        opening += moved
        # Multipliers of log-scaled variables' bounds are followed in the variable's own unit.
        mu_rate -= self.mu * self._logs * self._signs * moved
        # Active sides lose their multiplier, the others their slack.
        stock = np.where(active, self.mu, np.maximum(self.slack, 0.0))
        rate = direction * np.where(active, mu_rate, opening)
        rate[self._equal] = 0.0
        size = max(size, float(np.max(np.abs(rate), initial=0.0)))
        if np.any(rate[self.weak] < -_RANK * size):
            return None
        rate[self.weak] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(rate < -_NO_RATE * size, stock / -rate, np.inf)
        first = int(np.argmin(reach)) if len(reach) else 0
        if not len(reach) or not np.isfinite(reach[first]):
            return Move(dy, math.inf, "")
        verb = "ceases" if active[first] else "begins"
        return Move(dy, float(reach[first]), f"{self.sides[first].name} {verb} to decide")

    def change(self, parameter: int | None, side: str) -> Change:
        """Return the change by one unit of a parameter, given by number, or of the limit of the sides with a name."""
        q, b = np.zeros(len(self._p)), np.zeros(len(self.sides))
        if parameter is not None:
            q[parameter] = 1.0
        for k, own in enumerate(self.sides):
            if own.name == side:
                b[k] = own.per_unit
        return Change(q, b)

    @property
    def parameters_that_matter(self) -> list[bool]:
        """For each parameter, whether it changes the objective, a requirement or one of their slopes here."""
        columns = np.vstack([self.gradient, self.gradients, self.hessian])[:, self.n :]
        return [bool(matters) for matters in np.any(columns != 0.0, axis=0)]

    @property
    def deciding_names(self) -> tuple[str, ...]:
        """Names of the deciding sides, each once."""
        return self._names(self.deciding)

    @property
    def touching(self) -> tuple[str, ...]:
        """Names of the weakly active sides, each once."""
        return self._names(self.weak)

    def _names(self, which: Mask | NDArray[np.intp]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self.sides[k].name for k in np.arange(len(self.sides))[which]))

    # --- optima without a derivative ---------------------------------------------------------------------

    def _refuse_degenerate(self) -> None:
        a = self.gradients[self.deciding, : self.n]
        if not independent(a, _RANK):
            raise InputError(
                f"the limits that decide ({', '.join(self.deciding_names)}) are not independent: their multipliers are"
                " not unique, so there are no derivatives; drop or loosen one of them"
            )
        if len(self.weak) > _MOST_WEAK:
            raise InputError(
                f"too many limits just touch the optimum without deciding it: {', '.join(self.touching)}; loosen them"
            )
        if not self._curved(a):
            raise InputError(_FLAT)

    def _curved(self, a: Vector, least: float = FLAT_CURVATURE) -> bool:
        """Return True if the Lagrangian curves upwards wherever sides with independent gradients ``a`` hold."""
        free = free_directions(a)
        # Dependent sides cannot all hold once one of their limits moves; least squares would move them apart.
        if free.shape[1] > self.n - len(a):
            return False
        curvatures, _ = reduced_curvatures(self.hessian[: self.n, : self.n], free)
        return not curvatures.size or bool(curvatures[0] > least)


def sides_of(program: Program, point: Point, fixed: Sequence[int]) -> list[Side]:
    """Return every side of every limit; a variable that is held becomes one equality."""
    found = []
    declared, own = program.declared, len(program.own_requirements)
    for row, k in enumerate(program.owner):
        r, scale = declared.requirements[k], program.scales[k]
        hidden = r.auxiliary or k >= own
        if r.at_least is not None and r.at_least == r.at_most:
            bound = r.at_least / scale
            found.append(Side(r.name, r.name, r.at_least, r.unit, row, 1.0, bound, 1.0 / scale, True, hidden=hidden))
            continue
        for end, sign, limit in (("at_least", 1.0, r.at_least), ("at_most", -1.0, r.at_most)):
            if limit is not None:
                name, bound = r.name.strip() if r.auxiliary else f"{r.name} {end}", sign * limit / scale
                found.append(Side(name, r.name, limit, r.unit, row, sign, bound, sign / scale, hidden=hidden))
    for k, v in enumerate(declared.variables):
        if v.auxiliary:  # The solve extends its bounds until none of them decides.
            continue
        row, y = len(program.owner) + k, float(point.y[k])
        per_unit, log = 1.0 / v.slope(y), math.log(v.upper / v.lower) if v.log else 0.0
        if k in fixed:
            found.append(Side(v.name, v.name, v.value(y), v.unit, row, 1.0, y, per_unit, True, hidden=True))
            continue
        for end, sign, limit, bound in (("lower", 1.0, v.lower, 0.0), ("upper", -1.0, v.upper, -1.0)):
            how = (row, sign, bound, sign * per_unit, False, log, v.domain)
            found.append(Side(f"{v.name} {end}", v.name, limit, v.unit, *how))
    return found
