"""Local searches in a landscape by SciPy's SLSQP: downhill, to the nearest feasible design, to the least violation."""

from collections.abc import Collection
from typing import Any

import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.design.landscape import FEASIBLE, FINER, PENALTY, Landscape, Seen, joined
from plough_opt.design.optimality import least, lowest_dips

Box = tuple[Vector, Vector]
"""Lower and upper bounds of scaled variables."""

# Weight of a violation within the tolerance of what meets the requirements, of which an objective may make no use.
_WITHIN = 1e4
# Scaled step of differences, between the rounding of a run (some 1e-13) and its curvature.
_STEP = 1e-6
# Iterations, and those of a descent without a bend, of which others stall when they have taken more.
_ITERATIONS, _LONG = 25, 20
# Of a column of a requirement, as a deflection at every output, only the worst values enter a descent.
_MOST_ROWS = 6
# Part of the merit by which a design is lower than another, and not just differently rounded.
_LOWER = 1e-6
# Projections on what is linear of the limits, by which the nearest design that meets them is looked for, and the step
# after which they have settled: what they then miss is of its square.
_PROJECTIONS, _SETTLED = 8, 1e-4
# Times that a descent is begun anew, with further rows that it has broken, while it gains a part of its merit.
_ROUNDS, _GAIN = 6, 1e-7


def descend(landscape: Landscape, start: Vector, box: Box | None = None) -> Seen:
    """Return where a descent leads from a scaled start within bounds, by default 0 and 1; never worse than the start.

    Runs that are integrated one by one take too long for it: then it is the start.
    """
    if not landscape.vectorised:
        return landscape(start[None])
    box = _whole(landscape) if box is None else box
    start = np.clip(start, *box)
    if landscape.settled:
        start = np.clip(landscape(start[None]).points[0], *box)
    return _Descent(landscape, box).from_(start)


def lower_from(landscape: Landscape, design: Vector, start: Vector) -> Vector | None:
    """Return where a descent from a start beside a design leads, if that is lower than the design, or None."""
    end, own = descend(landscape, start), landscape(design[None], finer=FINER)
    return end.points[0] if end.merit[0] < own.merit[0] - _LOWER * abs(own.merit[0]) else None


def nearest_feasible(landscape: Landscape, design: Vector, start: Vector | None = None) -> Seen:
    """Return the feasible design nearest to another, as far as a local search from it or a start finds it."""
    return _Nearest(landscape, design).from_(design if start is None else start)


def least_violation(
    landscape: Landscape, start: Vector, box: Box | None = None, *, ignored: Collection[int] = ()
) -> Seen:
    """Return where the sum of all violations is least beside a start, requirements numbered ``ignored`` apart."""
    return _LeastViolation(landscape, ignored, _whole(landscape) if box is None else box).from_(start)


class Shortfall:
    """The violations of a landscape without its objective, and the designs that were seen to meet all requirements.

    A search of it looks for designs that meet all requirements.

    Attributes:
        vectorised: whether all runs are followed side by side.
        met: number of designs that met all requirements, some of them several times.
    """

    def __init__(self, landscape: Landscape) -> None:
        """Take the landscape."""
        self._landscape = landscape
        self._kept: list[Seen] = []
        self.vectorised, self.met = landscape.vectorised, 0

    @property
    def tried(self) -> int:
        """Number of designs that were looked at in the landscape."""
        return self._landscape.tried

    def __call__(self, points: Vector) -> Seen:
        """Look at designs, a row each: their objective is none."""
        return self._noted(self._landscape(points))

    def descend(self, start: Vector) -> Seen:
        """Return where the sum of all violations is least beside a start."""
        return self._noted(least_violation(self._landscape, start))

    def _noted(self, seen: Seen) -> Seen:
        if np.any(seen.feasible):
            self._kept.append(seen.of(seen.feasible))
            self.met += len(self._kept[-1].f)
        return seen.without_objective()

    def designs(self) -> Seen | None:
        """Return the different designs that met all requirements, with their objectives, or None if none did."""
        if not self._kept:
            return None
        every = joined(self._kept)
        _, first = np.unique(every.points, axis=0, return_index=True)
        return every.of(np.sort(first))


def _whole(landscape: Landscape) -> Box:
    return np.zeros(landscape.dimensions), np.ones(landscape.dimensions)


class _NoValue(Exception):
    """A design without a value, on which a descent ends."""


class _Descent:
    """Runs of SLSQP on the worst rows of each requirement, repeated when others turn out to be broken."""

    # Whether it is always begun anew; else where it may have stalled in a bent valley, from which it then takes steps.
    _twice = False

    def __init__(self, landscape: Landscape, box: Box) -> None:
        self._landscape, self._program, self._n = landscape, landscape.program, landscape.dimensions
        self._box, self._stalled = box, False
        self._known: tuple[bytes, tuple[float, Vector, Vector, Vector]] | None = None
        # What each row gives way for each further unknown, of which a descent has none.
        self._give = np.zeros((len(self._program.owner), 0))
        # Whether it breaks a requirement, its merit, and the design.
        self._best: tuple[tuple[bool, float], Vector] = ((True, np.inf), box[0])

    def from_(self, start: Vector) -> Seen:
        """Return the best design that a descent from a start comes to."""
        x, rows = self._begin(start), np.empty(0, dtype=int)
        try:
            for _ in range(_ROUNDS):
                before, more = self._best[0], self._worst_rows(x[: self._n], rows)
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
        return self._landscape(best[None], finer=FINER)

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
        """Return the margins of rows, at lower limits and then at upper ones; what they give way follows y."""
        low, high = self._program.low, self._program.high
        below, above = rows[np.isfinite(low[rows])], rows[np.isfinite(high[rows])]
        which, limits = np.r_[below, above], np.r_[low[below], high[above]]
        signs, give = np.r_[np.ones(len(below)), -np.ones(len(above))], self._give[which]

        def margins(x: Vector) -> Vector:
            found: Vector = signs * (self._derivatives(x)[2][which] - limits) + give @ x[self._n :]
            return found

        def slopes(x: Vector) -> Vector:
            return np.hstack([signs[:, None] * self._derivatives(x)[3][which], give])

        return [{"type": "ineq", "fun": margins, "jac": slopes}] if len(which) else []

    def _merit(self, _y: Vector, f: float, violations: Vector) -> tuple[bool, float]:
        """Return what the best design of a descent has least of: first of all, it meets the requirements."""
        total = float(violations.sum())
        met = total <= FEASIBLE
        return not met, f + (_WITHIN if met else PENALTY) * total

    def _derivatives(self, x: Vector) -> tuple[float, Vector, Vector, Vector]:
        """Return objective, gradient, requirements and their Jacobian, by differences of runs of equal steps."""
        # SLSQP asks for each of them one by one.
        asked = x[: self._n].tobytes()
        if self._known is None or self._known[0] != asked:
            lower, upper = (side[: self._n] for side in self._box)
            y = np.clip(x[: self._n], lower, upper)
            step = np.where(y + _STEP > upper, -_STEP, _STEP)
            with np.errstate(all="ignore"):
                f, g = self._landscape.rows(np.vstack([y, y + np.diag(step)]), finer=FINER, together=self._n + 1)
            if not (np.all(np.isfinite(f)) and np.all(np.isfinite(g))):
                raise _NoValue
            merit = self._merit(y, float(f[0]), self._landscape.violations(g[:1])[0])
            if merit < self._best[0]:
                self._best = merit, y
            self._known = asked, (float(f[0]), (f[1:] - f[0]) / step, g[0], ((g[1:] - g[0]) / step[:, None]).T)
        return self._known[1]

    def _worst_rows(self, y: Vector, known: np.ndarray) -> np.ndarray:
        """Return the rows nearest to their limits, some of each requirement, beside those known already."""
        g, first = self._derivatives(y)[2], self._landscape.first_rows
        margin = np.minimum(g - self._program.low, self._program.high - g)
        chosen = set(known.tolist())
        for begin, end in zip(first, [*first, len(g)][1:], strict=True):
            # Of a curve over time the dips, each of which is a row of its own.
            few = end - begin <= _MOST_ROWS
            which = range(end - begin) if few else lowest_dips(margin[begin:end], _MOST_ROWS)
            chosen |= {begin + int(k) for k in which}
        return np.array(sorted(chosen), dtype=int)


class _Nearest(_Descent):
    """The same for the distance from a design in the place of the objective."""

    def __init__(self, landscape: Landscape, design: Vector) -> None:
        super().__init__(landscape, _whole(landscape))
        self._design = design

    def _objective(self, x: Vector) -> float:
        return float(np.sum((x - self._design) ** 2))

    def _gradient(self, x: Vector) -> Vector:
        return 2.0 * (x - self._design)

    def _merit(self, y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return super()._merit(y, self._objective(y), violations)

    def _minimised(self, x: Vector, rows: np.ndarray) -> Vector:
        """Return where projections on the linearised limits lead, or else SLSQP."""
        y, (low, high), unit = x, self._box, np.eye(self._n)
        for _ in range(_PROJECTIONS):
            _, _, g, jacobian = self._derivatives(y)
            limits = (
                np.concatenate([self._program.low[rows] - g[rows], low - y]),
                np.concatenate([self._program.high[rows] - g[rows], high - y]),
            )
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

    def __init__(self, landscape: Landscape, ignored: Collection[int], box: Box) -> None:
        count = len(landscape.program.declared.requirements)
        super().__init__(landscape, (np.r_[box[0], np.zeros(count)], np.r_[box[1], np.full(count, np.inf)]))
        self._weights = np.array([float(k not in ignored) for k in range(count)])
        self._give = np.eye(count)[landscape.program.owner]

    def _begin(self, start: Vector) -> Vector:
        try:
            g = self._derivatives(start)[2]
        except _NoValue:
            return np.concatenate([start, np.zeros(len(self._weights))])
        return np.concatenate([start, self._landscape.violations(g[None])[0]])

    def _merit(self, _y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return False, float(violations @ self._weights)

    def _objective(self, x: Vector) -> float:
        return float(self._weights @ x[self._n :])

    def _gradient(self, _: Vector) -> Vector:
        return np.concatenate([np.zeros(self._n), self._weights])
