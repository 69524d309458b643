"""The scaled objective and violations over all variables: what a search samples, and rough descents in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.optimality import least
from plough_opt.design.program import Program

FEASIBLE = 1e-6
"""Scaled violation below which a search's design counts as meeting its requirements."""

MET = 5e-10
"""The same of a design that is given as an answer."""

# A violated requirement must outweigh any gain in the scaled objective, which is of order 1.
_PENALTY = 100.0
# The same within the tolerance of what meets the requirements, of which an objective may not make use.
_WITHIN = 1e4
# Above every scaled objective, and little enough for violations to count behind it.
_BEYOND = 1e8
# Scaled step of differences, between the rounding of a run (some 1e-13) and its curvature.
_STEP = 1e-6
# Descents take finer steps than a sample, so that the few steps by which a count changes shift nothing that matters.
_FINER = 2.0
_ITERATIONS = 25
# Iterations of a descent without a bend, of which others stall when they have taken more.
_LONG = 20
# Of a column of a requirement, as a deflection at every output, only the worst values enter a descent.
_MOST_ROWS = 6
# Part of the merit by which a design is lower than another, and not just differently rounded.
_LOWER = 1e-6
# Projections on what is linear of the limits, by which the nearest design that meets them is looked for, and the step
# after which they have settled: what they then miss is of its square.
_PROJECTIONS, _SETTLED = 8, 1e-4
# Times that a descent is begun anew, with further rows that it has broken, while it gains a part of its merit.
_ROUNDS, _GAIN = 6, 1e-7


@dataclass(frozen=True)
class Seen:
    """Designs that were looked at, a row each.

    Attributes:
        points: scaled variables.
        f: scaled objective; NaN where a design has no value.
        violation: sum over the requirements of what each is violated by at its worst, in its scale; infinite without
            a value.
    """

    points: Vector
    f: Vector
    violation: Vector

    @property
    def feasible(self) -> np.ndarray:
        """Whether each design meets all requirements."""
        return self.violation <= FEASIBLE

    @property
    def merit(self) -> Vector:
        """Objective and violations in one number, infinite without a value."""
        return np.where(np.isfinite(self.f), self.f + _PENALTY * self.violation, np.inf)

    @property
    def strict_merit(self) -> Vector:
        """The same with which no design that breaks a requirement is better than one that meets all."""
        beyond = _BEYOND + np.minimum(self.violation, _BEYOND)
        return np.where(np.isfinite(self.f), np.where(self.feasible, self.f, beyond), np.inf)

    def joined(self, *others: Seen) -> Seen:
        """Return the designs of all."""
        every = (self, *others)
        return Seen(*(np.concatenate([getattr(one, name) for one in every]) for name in ("points", "f", "violation")))

    def of(self, which: Any) -> Seen:
        """Return some of the designs."""
        return Seen(self.points[which], self.f[which], self.violation[which])


class Landscape:
    """Scaled objective and requirements over the scaled variables, at given parameters."""

    def __init__(self, program: Program, p: Vector) -> None:
        """Take a program whose scales are set."""
        self.program, self.p = program, p
        self.dimensions = len(program.declared.variables)
        owner = np.array(program.owner, dtype=int)
        self.first_rows: list[int] = np.flatnonzero(np.diff(owner, prepend=-1)).tolist()
        self._scale = np.array(program.scales)[owner] if len(owner) else np.empty(0)
        # Kept where the program is scaled anew by what is found here.
        self.objective_scale = program.objective_scale
        self.vectorised = program.population.vectorised
        self.settled = program.linear_variables(p)
        self.tried = 0

    def rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector]:
        """Return the scaled objective and requirements, a row for each design."""
        self.tried += len(points)
        f, g = self.program.population(points, self.p, finer=finer, together=together)
        return f / self.objective_scale, g / self._scale

    def of_the_design(self) -> Landscape:
        """Return that of the design alone, where this is of a whole tolerance box, or this one."""
        bare = self.program.bare
        if bare is None:
            return self
        bare.prepare(self.p)
        return Landscape(bare, self.p)

    def violations(self, g: Vector) -> Vector:
        """Return by what each requirement is violated at its worst, a row for each design; infinite without a value."""
        if not self.first_rows:
            return np.zeros((len(g), 0))
        excess = np.maximum(self.program.low - g, g - self.program.high)
        worst = np.maximum.reduceat(excess, self.first_rows, axis=1)
        return np.where(np.isfinite(worst), np.maximum(worst, 0.0), np.inf)

    def __call__(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> Seen:
        """Look at designs, a row each; variables that can be are solved for, given the others."""
        if not len(points):
            return Seen(points, np.empty(0), np.empty(0))
        with np.errstate(all="ignore"):
            points, f, g = self.settled_rows(points, finer=finer, together=together)
            violation = self.violations(g).sum(axis=1)
        f = np.where(np.isfinite(f), f, np.nan)
        return Seen(points, f, np.where(np.isnan(f), np.inf, violation))

    def settled_rows(self, points: Vector, *, finer: float = 1.0, together: int = 1) -> tuple[Vector, Vector, Vector]:
        """Return designs with the variables that can be solved for so solved, their objective and requirements."""
        f, g = self.rows(points, finer=finer, together=together)
        size, low, high = self.objective_scale, self.program.low * self._scale, self.program.high * self._scale
        for variable in self.settled:
            points, f, g = variable.settled(points, f * size, g * self._scale, low, high)
            f, g = f / size, g / self._scale
        return points, f, g

    # --- descents ----------------------------------------------------------------------------------------

    def descend(self, start: Vector, lower: Vector | None = None, upper: Vector | None = None) -> Seen:
        """Return where a local search by SciPy's SLSQP leads from a start; never worse than the start.

        Args:
            start: scaled variables.
            lower: lower bounds of them; default 0.
            upper: upper bounds; default 1.
        """
        box = (np.zeros(len(start)) if lower is None else lower, np.ones(len(start)) if upper is None else upper)
        start = np.clip(start, *box)
        if self.settled:
            start = np.clip(self(start[None]).points[0], *box)
        return _Descent(self, box).from_(start)

    def lower_from(self, design: Vector, start: Vector) -> Vector | None:
        """Return where a descent from a start beside a design leads, if that is lower than the design, or None."""
        end, own = self.descend(start), self(design[None], finer=_FINER)
        return end.points[0] if end.merit[0] < own.merit[0] - _LOWER * abs(own.merit[0]) else None

    def nearest_feasible(self, design: Vector, start: Vector | None = None) -> Seen:
        """Return the feasible design nearest to another, as far as a local search from it or a start finds it."""
        return _Nearest(self, design).from_(design if start is None else start)

    def least_violation(
        self,
        start: Vector,
        ignored: frozenset[int] = frozenset(),
        lower: Vector | None = None,
        upper: Vector | None = None,
    ) -> Seen:
        """Return where the sum of all violations is least beside a start, requirements numbered ``ignored`` apart.

        Bounds are those of `descend`.
        """
        box = (np.zeros(len(start)) if lower is None else lower, np.ones(len(start)) if upper is None else upper)
        return _LeastViolation(self, ignored, box).from_(start)


class _NoValue(Exception):
    """A design without a value, on which a descent ends."""


class _Descent:
    """Runs of SLSQP on the worst rows of each requirement, repeated when others turn out to be broken."""

    # Whether it is always begun anew; else where it may have stalled in a bent valley, from which it then takes steps.
    _twice = False

    def __init__(self, landscape: Landscape, box: tuple[Vector, Vector]) -> None:
        self._landscape, self._box, self._stalled = landscape, box, False
        self._known: tuple[bytes, tuple[float, Vector, Vector, Vector]] | None = None
        # What each row gives way for each further unknown, of which a descent has none.
        self._give = np.zeros((len(landscape.program.owner), 0))
        # Whether it breaks a requirement, its merit, and the design.
        self._best: tuple[tuple[bool, float], Vector] = ((True, np.inf), box[0])

    def from_(self, start: Vector) -> Seen:
        """Return the best design that a descent from a start comes to."""
        x, rows = self._begin(start), np.empty(0, dtype=int)
        try:
            for _ in range(_ROUNDS):
                before, more = self._best[0], self._worst_rows(x[: len(start)], rows)
                if len(more) == len(rows) > 0 and not (self._stalled or self._twice):
                    break
                x = self._minimised(x, more)
                gained = self._best[0] < (before[0], before[1] - _GAIN * abs(before[1]))
                if len(more) == len(rows) and not gained:
                    break
                rows = more
        except _NoValue:
            pass
        best = start if np.isinf(self._best[0][1]) else self._best[1]
        return self._landscape(best[None], finer=_FINER)

    def _begin(self, start: Vector) -> Vector:
        """Return the unknowns at a start."""
        return start

    def _minimised(self, x: Vector, rows: np.ndarray) -> Vector:
        """Return the unknowns to which SLSQP leads, subject to some rows of the requirements."""
        from scipy.optimize import minimize  # slow to import

        found = minimize(
            self._objective,
            x,
            jac=self._gradient,
            bounds=[(low, high if np.isfinite(high) else None) for low, high in zip(*self._box, strict=True)],
            constraints=self._constraints(rows),
            method="SLSQP",
            options={"maxiter": _ITERATIONS, "ftol": 1e-11},
        )
        self._stalled = not found.success or found.nit > _LONG
        clipped: Vector = np.clip(found.x, *self._box)
        return clipped

    def _objective(self, x: Vector) -> float:
        """Return what SLSQP minimises."""
        return self._derivatives(x)[0]

    def _gradient(self, x: Vector) -> Vector:
        """Return its gradient."""
        return self._derivatives(x)[1]

    def _constraints(self, rows: np.ndarray) -> list[dict[str, Any]]:
        """Return rows of the requirements as SLSQP takes them; what they give way follows the variables."""
        program, n = self._landscape.program, self._landscape.dimensions
        constraints = []
        for limit, sign in ((program.low[rows], 1.0), (program.high[rows], -1.0)):
            some = rows[np.isfinite(limit)]
            if not len(some):
                continue
            at, give = limit[np.isfinite(limit)], self._give[some]

            def fun(x: Vector, some: Any = some, at: Any = at, give: Any = give, sign: float = sign) -> Vector:
                margins: Vector = sign * (self._derivatives(x)[2][some] - at) + give @ x[n:]
                return margins

            def jac(x: Vector, some: Any = some, give: Any = give, sign: float = sign) -> Vector:
                slopes: Vector = np.hstack([sign * self._derivatives(x)[3][some], give])
                return slopes

            constraints.append({"type": "ineq", "fun": fun, "jac": jac})
        return constraints

    def _merit(self, _y: Vector, f: float, violations: Vector) -> tuple[bool, float]:
        """Return what the best design of a descent has least of: first of all, it meets the requirements."""
        total = float(violations.sum())
        met = total <= FEASIBLE
        return not met, f + (_WITHIN if met else _PENALTY) * total

    def _derivatives(self, x: Vector) -> tuple[float, Vector, Vector, Vector]:
        """Return objective, gradient, requirements and their Jacobian, by differences of runs of equal steps."""
        n = self._landscape.dimensions
        # SLSQP asks for each of them one by one.
        asked = x[:n].tobytes()
        if self._known is None or self._known[0] != asked:
            lower, upper = (side[:n] for side in self._box)
            y = np.clip(x[:n], lower, upper)
            step = np.where(y + _STEP > upper, -_STEP, _STEP)
            with np.errstate(all="ignore"):
                f, g = self._landscape.rows(np.vstack([y, y + np.diag(step)]), finer=_FINER, together=n + 1)
            if not (np.all(np.isfinite(f)) and np.all(np.isfinite(g))):
                raise _NoValue
            merit = self._merit(y, float(f[0]), self._landscape.violations(g[:1])[0])
            if merit < self._best[0]:
                self._best = merit, y
            self._known = asked, (float(f[0]), (f[1:] - f[0]) / step, g[0], ((g[1:] - g[0]) / step[:, None]).T)
        return self._known[1]

    def _worst_rows(self, y: Vector, known: np.ndarray) -> np.ndarray:
        """Return the rows nearest to their limits, some of each requirement, beside those known already."""
        program, first = self._landscape.program, self._landscape.first_rows
        g = self._derivatives(y)[2]
        margin = np.minimum(g - program.low, program.high - g)
        chosen = set(known.tolist())
        for begin, end in zip(first, [*first, len(g)][1:], strict=True):
            own = margin[begin:end]
            # Of a curve over time the dips, each of which is a row of its own.
            dips = np.flatnonzero((own <= np.r_[np.inf, own[:-1]]) & (own <= np.r_[own[1:], np.inf]))
            which = (
                dips[np.argsort(own[dips], kind="stable")[:_MOST_ROWS]] if len(own) > _MOST_ROWS else range(len(own))
            )
            chosen |= {begin + int(k) for k in which}
        return np.array(sorted(chosen), dtype=int)


class _Nearest(_Descent):
    """The same for the distance from a design in the place of the objective."""

    def __init__(self, landscape: Landscape, design: Vector) -> None:
        n = landscape.dimensions
        super().__init__(landscape, (np.zeros(n), np.ones(n)))
        self._design = design

    def _objective(self, x: Vector) -> float:
        return float(np.sum((x - self._design) ** 2))

    def _gradient(self, x: Vector) -> Vector:
        return 2.0 * (x - self._design)

    def _merit(self, y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return super()._merit(y, self._objective(y), violations)

    def _minimised(self, x: Vector, rows: np.ndarray) -> Vector:
        """Return where projections on the linearised limits lead, or else SLSQP."""
        y, (low, high), program = x, self._box, self._landscape.program
        for _ in range(_PROJECTIONS):
            _, _, g, jacobian = self._derivatives(y)
            limits = (
                np.concatenate([program.low[rows] - g[rows], low - y]),
                np.concatenate([program.high[rows] - g[rows], high - y]),
            )
            unit = np.eye(len(y))
            found = least(unit, y - self._design, np.vstack([jacobian[rows], unit]), limits)
            if found is None:
                break
            before, y = y, np.clip(y + found[0], low, high)
            if np.max(np.abs(y - before)) < _SETTLED:
                self._derivatives(y)
                return y
        return super()._minimised(x, rows)


class _LeastViolation(_Descent):
    """The same for the sum of what the requirements give way, each a further unknown."""

    _twice = True

    def __init__(self, landscape: Landscape, ignored: frozenset[int], box: tuple[Vector, Vector]) -> None:
        n, count = landscape.dimensions, len(landscape.program.declared.requirements)
        super().__init__(landscape, (np.r_[box[0], np.zeros(count)], np.r_[box[1], np.full(count, np.inf)]))
        self._n, self._count = n, count
        self._weights = np.array([float(k not in ignored) for k in range(count)])
        self._give = np.eye(count)[landscape.program.owner]

    def _begin(self, start: Vector) -> Vector:
        try:
            g = self._derivatives(start)[2]
        except _NoValue:
            return np.concatenate([start, np.zeros(self._count)])
        return np.concatenate([start, self._landscape.violations(g[None])[0]])

    def _merit(self, _y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return False, float(violations @ self._weights)

    def _objective(self, x: Vector) -> float:
        return float(self._weights @ x[self._n :])

    def _gradient(self, _: Vector) -> Vector:
        return np.concatenate([np.zeros(self._n), self._weights])
