"""Local searches: SciPy's SLSQP over a landscape, and from the bottom of a basin to an optimum of full accuracy."""

import itertools
from dataclasses import replace
from typing import Any, Final

import numpy as np

from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.optimality import (
    lowest_dips,
    made_convex,
    optimum_step,
    residual,
    without_rounding,
)
from plough_opt.design.model.program import Program
from plough_opt.design.search.landscape import (
    FEASIBLE,
    FEASIBLE_ANSWER,
    FINER,
    PENALTY,
    Evaluations,
    Landscape,
    concatenated,
)

Box = tuple[Vector, Vector]
"""Lower and upper bounds of scaled variables."""

# Weight of a violation within the feasibility tolerance, so high that the objective cannot exploit the tolerance.
_WEIGHT_IF_FEASIBLE = 1e4
# Scaled step of the difference quotients: well above a run's rounding (about 1e-13), small against its curvature.
_STEP = 1e-6
_MOST_ITERATIONS = 25
# More iterations than this indicate a bent valley, in which the descent may have stalled.
_MANY_ITERATIONS = 20
# A requirement with many rows, such as a deflection at every output, enters a descent with its worst rows only.
_MOST_ROWS = 6
# Most runs of SLSQP in a descent, each with the rows that the last one violated.
_MOST_RESTARTS = 6
# A restart must lower the merit by this fraction to justify another one.
_RESTART_GAIN = 1e-7


def descend(landscape: Landscape, start: Vector, box: Box | None = None) -> Evaluations:
    """Return the end of a descent from a scaled start within bounds, by default 0 and 1; never worse than the start.

    If runs are integrated one by one, a descent takes too long and the start is returned.
    """
    if not landscape.vectorised:
        return landscape(start[None])
    box = _whole_range(landscape) if box is None else box
    start = np.clip(start, *box)
    if landscape.eliminated:
        start = np.clip(landscape(start[None]).points[0], *box)
    return _Descent(landscape, box).end_from(start)


def nearest_feasible(landscape: Landscape, design: Vector, start: Vector | None = None) -> Evaluations:
    """Return the feasible design nearest to a given one, as a local search finds it from a start or from the design."""
    return _Nearest(landscape, design).end_from(design if start is None else start)


def least_violation(landscape: Landscape, start: Vector, box: Box | None = None) -> Evaluations:
    """Return the local minimum near a start of the summed violations."""
    return _LeastViolation(landscape, _whole_range(landscape) if box is None else box).end_from(start)


class Shortfall:
    """A landscape's violations without its objective; it collects the feasible designs that a search comes across.

    Attributes:
        vectorised: whether all runs of many designs are integrated together.
        feasible_seen: number of feasible designs evaluated so far, repetitions included.
    """

    def __init__(self, landscape: Landscape) -> None:
        """Take the landscape."""
        self._landscape = landscape
        self._feasible: list[Evaluations] = []
        self.vectorised, self.feasible_seen = landscape.vectorised, 0

    def __call__(self, points: Vector) -> Evaluations:
        """Evaluate the violations of designs, a row each."""
        return self._recorded(self._landscape(points))

    def descend(self, start: Vector) -> Evaluations:
        """Return the local minimum of the summed violations near a start."""
        return self._recorded(least_violation(self._landscape, start))

    def _recorded(self, designs: Evaluations) -> Evaluations:
        if np.any(designs.feasible):
            self._feasible.append(designs.select(designs.feasible))
            self.feasible_seen += len(self._feasible[-1].f)
        return designs.without_objective()

    def feasible_designs(self) -> Evaluations | None:
        """Return the feasible designs without repetitions, with their objectives; None if there are none."""
        if not self._feasible:
            return None
        found = concatenated(self._feasible)
        _, first = np.unique(found.points, axis=0, return_index=True)
        return found.select(np.sort(first))


def _whole_range(landscape: Landscape) -> Box:
    return np.zeros(landscape.dimensions), np.ones(landscape.dimensions)


class _CannotEvaluate(Exception):
    """A design on the way cannot be evaluated, which ends a descent."""


class _Descent:
    """Runs of SLSQP on the worst rows of each requirement, restarted when other rows turn out to be violated.

    SLSQP's unknowns are the variables and, in a subclass, an amount for each requirement by which its limits give way.
    """

    # Whether the descent is always restarted; otherwise only if the last run may have stalled.
    _always_restart = False

    def __init__(self, landscape: Landscape, box: Box) -> None:
        self._landscape, self._program, self._n = landscape, landscape.program, landscape.dimensions
        self._box, self._stalled = box, False
        # The last variables, as bytes, with their derivatives.
        self._cached: tuple[bytes, tuple[float, Vector, Vector, Vector]] | None = None
        # How much each row's margin grows with each further unknown; here there are none.
        self._give = np.zeros((len(self._program.owner), 0))
        # The best design so far: whether it is infeasible, its merit, and its variables.
        self._best: tuple[tuple[bool, float], Vector] = ((True, np.inf), box[0])

    def end_from(self, start: Vector) -> Evaluations:
        """Return the best design on the way of a descent from a start."""
        x, rows = self._first_unknowns(start), np.empty(0, dtype=int)
        try:
            for _ in range(_MOST_RESTARTS):
                before, more = self._best[0], self._worst_rows(x[: self._n], rows)
                if len(more) == len(rows) > 0 and not (self._stalled or self._always_restart):
                    break
                x = self._minimised(x, more)
                gained = self._best[0] < (before[0], before[1] - _RESTART_GAIN * abs(before[1]))
                if len(more) == len(rows) and not gained:
                    break
                rows = more
        except _CannotEvaluate:
            pass
        best = start if np.isinf(self._best[0][1]) else self._best[1]
        return self._landscape(best[None], finer=FINER)

    def _first_unknowns(self, start: Vector) -> Vector:
        """Return SLSQP's unknowns at a start."""
        return start

    def _minimised(self, x: Vector, rows: np.ndarray) -> Vector:
        """Return SLSQP's solution, subject to some rows of the requirements."""
        from scipy.optimize import minimize  # slow to import

        found = minimize(
            self._objective,
            x,
            jac=self._gradient,
            bounds=[(low, high if np.isfinite(high) else None) for low, high in zip(*self._box, strict=True)],
            constraints=self._constraints(rows),
            method="SLSQP",
            options={"maxiter": _MOST_ITERATIONS, "ftol": 1e-11},
        )
        self._stalled = not found.success or found.nit > _MANY_ITERATIONS
        clipped: Vector = np.clip(found.x, *self._box)
        return clipped

    def _objective(self, x: Vector) -> float:
        """Return the value that SLSQP minimises."""
        return self._derivatives(x)[0]

    def _gradient(self, x: Vector) -> Vector:
        """Return the gradient of `_objective`."""
        return self._derivatives(x)[1]

    def _constraints(self, rows: np.ndarray) -> list[dict[str, Any]]:
        """Return SLSQP's constraints: the margins of rows to their lower limits, then those to their upper ones."""
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
        """Return the key by which designs are compared: any feasible design comes before any infeasible one."""
        total = float(violations.sum())
        feasible = total <= FEASIBLE
        return not feasible, f + (_WEIGHT_IF_FEASIBLE if feasible else PENALTY) * total

    def _derivatives(self, x: Vector) -> tuple[float, Vector, Vector, Vector]:
        """Return objective, gradient, requirements and their Jacobian, by differences of runs with equal steps."""
        # SLSQP asks for the four of them one after the other.
        key = x[: self._n].tobytes()
        if self._cached is None or self._cached[0] != key:
            lower, upper = (side[: self._n] for side in self._box)
            y = np.clip(x[: self._n], lower, upper)
            step = np.where(y + _STEP > upper, -_STEP, _STEP)
            with np.errstate(all="ignore"):
                f, g = self._landscape.rows(np.vstack([y, y + np.diag(step)]), finer=FINER, together=self._n + 1)
            if not (np.all(np.isfinite(f)) and np.all(np.isfinite(g))):
                raise _CannotEvaluate
            merit = self._merit(y, float(f[0]), self._landscape.violations(g[:1])[0])
            if merit < self._best[0]:
                self._best = merit, y
            self._cached = key, (float(f[0]), (f[1:] - f[0]) / step, g[0], ((g[1:] - g[0]) / step[:, None]).T)
        return self._cached[1]

    def _worst_rows(self, y: Vector, known: np.ndarray) -> np.ndarray:
        """Return the rows nearest to their limits, some of each requirement, together with the known ones."""
        g, first = self._derivatives(y)[2], self._program.first_rows
        margin = self._program.margins(g)
        chosen = set(known.tolist())
        for begin, end in zip(first, [*first, len(g)][1:], strict=True):
            # The rows of a long requirement are a curve over time: each dip of its margin can become active.
            few = end - begin <= _MOST_ROWS
            which = range(end - begin) if few else lowest_dips(margin[begin:end], _MOST_ROWS)
            chosen |= {begin + int(k) for k in which}
        return np.array(sorted(chosen), dtype=int)


class _Nearest(_Descent):
    """A descent that minimises the squared distance from a design instead of the objective."""

    def __init__(self, landscape: Landscape, design: Vector) -> None:
        super().__init__(landscape, _whole_range(landscape))
        self._design = design

    def _objective(self, x: Vector) -> float:
        return float(np.sum((x - self._design) ** 2))

    def _gradient(self, x: Vector) -> Vector:
        return 2.0 * (x - self._design)

    def _merit(self, y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return super()._merit(y, self._objective(y), violations)


class _LeastViolation(_Descent):
    """A descent that minimises the sum of the amounts by which the requirements' limits must give way."""

    _always_restart = True

    def __init__(self, landscape: Landscape, box: Box) -> None:
        count = len(landscape.program.declared.requirements)
        super().__init__(landscape, (np.r_[box[0], np.zeros(count)], np.r_[box[1], np.full(count, np.inf)]))
        self._weights = np.ones(count)
        self._give = np.eye(count)[landscape.program.owner]

    def _first_unknowns(self, start: Vector) -> Vector:
        try:
            g = self._derivatives(start)[2]
        except _CannotEvaluate:
            return np.concatenate([start, np.zeros(len(self._weights))])
        return np.concatenate([start, self._landscape.violations(g[None])[0]])

    def _merit(self, _y: Vector, _f: float, violations: Vector) -> tuple[bool, float]:
        return False, float(violations @ self._weights)

    def _objective(self, x: Vector) -> float:
        return float(self._weights @ x[self._n :])

    def _gradient(self, _: Vector) -> Vector:
        return np.concatenate([np.zeros(self._n), self._weights])


# Largest scaled residual of the first-order conditions at an optimum.
_STATIONARY: Final = 1e-10
# Most steps, and the longest one: a start further from the optimum is not nearly optimal.
_MOST_QUADRATIC_PROGRAMS: Final = 5
_LONGEST_STEP: Final = 0.02
# Each step must reduce the residual by at least this factor; otherwise the steps do not converge.
_REDUCTION: Final = 0.5
# Scaled step of the difference quotients: between a run's rounding (about 1e-13) and the narrowest ripples (1e-2).
_DIFFERENCE: Final = 2e-4
# If difference quotients deviate from the exact slopes by this fraction of the largest, there is a kink in between, as
# in the RMS of an amplitude at 0.
_KINK: Final = 0.05
# The first step needs several rounds, because the curvature depends on the multipliers that the step yields.
_ROUNDS: Final = 3
# Scaled margin kept to each limit, so that rounding does not violate it.
_MARGIN: Final = 1e-11
# A limit is active below this scaled margin.
_ACTIVE_MARGIN: Final = 1e-8
# Slopes of length 1 are dependent if their matrix has a singular value below this.
_DEPENDENT: Final = 1e-7


def polished_by_quadratic_programs(program: Program, p: Vector, start: Vector) -> Point | None:
    """Return the optimum near a design by sequential quadratic programs, or None if a few short steps do not reach it.

    Curvatures need only be rough, so they come from difference quotients of runs that are integrated together. Two or
    three evaluations of exact slopes then suffice. An interior-point method needs as many again to let its barrier
    vanish.

    Args:
        program: the design's program, built.
        p: parameters.
        start: scaled variables, nearly optimal.
    """
    derivatives = _difference_quotients(program, p, start) if program.population.vectorised else None
    if derivatives is None:
        return None
    slopes, hessians = derivatives
    margin = np.where(program.low < program.high, _MARGIN, 0.0)
    y, lam_g, before = start, np.zeros(len(program.low)), np.inf
    for number in range(_MOST_QUADRATIC_PROGRAMS):
        f, g, gradient, jacobian = (np.asarray(result) for result in program.nlp.slopes(y, p))
        g, gradient = g.ravel(), gradient.ravel()
        if not all(np.all(np.isfinite(part)) for part in (f, g, gradient, jacobian)):
            return None
        exact = np.vstack([gradient, jacobian])
        if not number and np.max(np.abs(exact - slopes)) > _KINK * max(1.0, float(np.max(np.abs(exact)))):
            return None
        at, limits = (g, gradient, jacobian), (program.low + margin, program.high - margin)
        for _ in range(1 if number else _ROUNDS):
            curvature = made_convex(hessians[0] + np.tensordot(lam_g, hessians[1:], 1))
            found = optimum_step(curvature, y, at, limits)
            if found is None:
                return None
            step, lam_g, lam_y = found
        point = Point(True, "Solve_Succeeded", y, float(f.item()), lam_g, without_rounding(y, lam_y), number)
        remaining = residual(point, at, (program.low, program.high))
        if remaining <= _STATIONARY:
            if np.all((margin == 0.0) | (program.margins(g) >= 0.0)):
                return point if _multipliers_unique(program, point.y, g, jacobian) else None
        elif remaining > _REDUCTION * before or np.max(np.abs(step)) > _LONGEST_STEP:
            return None
        y, before = np.clip(y + step, 0.0, 1.0), remaining
    return None


def _multipliers_unique(program: Program, y: Vector, g: Vector, jacobian: Vector) -> bool:
    """Return whether the slopes of the active limits are independent; otherwise their multipliers are ambiguous."""
    margins = np.concatenate([program.margins(g), np.minimum(y, 1.0 - y)])
    active = np.vstack([jacobian, np.eye(len(y))])[margins < _ACTIVE_MARGIN]
    lengths = np.maximum(np.linalg.norm(active, axis=1, keepdims=True), np.finfo(float).tiny)
    return not len(active) or int(np.linalg.matrix_rank(active / lengths, _DEPENDENT)) == len(active)


def _difference_quotients(program: Program, p: Vector, y: Vector) -> tuple[Vector, Vector] | None:
    """Return a gradient (a row) and a Hessian for the objective and each requirement row, by difference quotients.

    None if a neighbouring design cannot be evaluated.
    """
    n = len(y)
    steps = np.diag(np.where(y > 0.5, -_DIFFERENCE, _DIFFERENCE))
    pairs = list(itertools.combinations_with_replacement(range(n), 2))
    points = np.vstack([y, y + steps, *(y + steps[i] + steps[j] for i, j in pairs)])
    with np.errstate(all="ignore"):
        f, g = program.population(points, p, finer=FINER, together=len(points))
    scales = np.array(program.scales)[np.array(program.owner, dtype=int)]
    values = np.column_stack([f / program.objective_scale, g / scales])
    if not np.all(np.isfinite(values)):
        return None
    hessians = np.empty((values.shape[1], n, n))
    for (i, j), value in zip(pairs, values[n + 1 :], strict=True):
        second = (value - values[1 + i] - values[1 + j] + values[0]) / (steps[i, i] * steps[j, j])
        hessians[:, i, j] = hessians[:, j, i] = second
    signed = np.diag(steps)
    slopes = (values[1 : n + 1] - values[0]).T / signed - 0.5 * np.einsum("kii->ki", hessians) * signed
    return slopes, hessians


# An optimum this close to a start, as a fraction of the range, belongs to the start's basin.
_SAME_BASIN = 0.05
# The same for the optimum of a ripple.
_SAME_RIPPLE = 0.005
# A polished design may lie above its start by this fraction of the objective, which is IPOPT's tolerance, and higher by
# this weight times the start's violation.
_NOT_WORSE = 1e-8
_VIOLATION_WEIGHT = 100.0
# IPOPT stops with these near an optimum if the objective is rough, as on a needle.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


ACTIVE = 1e-7
"""A limit counts as active below this scaled margin."""

AS_FOUND = "taken as found"
"""Status of a design that IPOPT did not confirm as an optimum."""


def polished(program: Program, p: Vector, start: Vector) -> Point:
    """Return the local optimum near a basin minimum of a search, or the start itself if no better design lies near."""
    highest = highest_accepted(program, p, start)
    near = polished_by_quadratic_programs(program, p, start)
    near_enough = near is not None and np.max(np.abs(near.y - start)) < _SAME_BASIN and near.f <= highest
    if near is not None and near_enough and not program.refuses(near.y, p):
        return near
    as_found = point_as_found(program, p, start)
    for box, exact in ((1.0, False), (_SAME_BASIN, True), (_SAME_RIPPLE, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and _violation(program, p, point.y)[1] <= FEASIBLE_ANSWER:
            point = _stalled(program, p, point)
        if point.solved and point.f <= highest:
            return point
    point = program.solve(start, p)
    if point.solved and point.f <= highest:
        return point
    if as_found.solved or not program.declared.requirements:
        return as_found
    # The search's rough runs may just have met a limit that these runs violate.
    return point_as_found(program, p, program.solve_relaxed(start, p)[0].y)


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved again after its program was rebuilt with other steps; the same basin, updated digits."""
    highest = highest_accepted(program, p, point.y)
    for box, exact in ((_SAME_BASIN, False), (_SAME_RIPPLE, False), (_SAME_RIPPLE, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if again.solved and again.f <= highest:
            return again
    return replace(point, f=_violation(program, p, point.y)[0])


def point_as_found(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as an unconfirmed point without multipliers; it is solved if it is feasible."""
    f, violation = _violation(program, p, y)
    count = len(program.owner)
    return Point(bool(violation <= FEASIBLE_ANSWER), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


def _stalled(program: Program, p: Vector, point: Point) -> Point:
    """Return a feasible point at which IPOPT stalled as an unconfirmed one.

    Its multipliers have not converged: those of limits that the design does not touch are noise.
    """
    g = np.asarray(program.nlp.values(point.y, p)[1]).ravel()
    touches = program.margins(g) <= ACTIVE
    at_bound = np.minimum(point.y, 1.0 - point.y) <= ACTIVE
    lam_g, lam_y = np.where(touches, point.lam_g, 0.0), np.where(at_bound, point.lam_y, 0.0)
    return replace(point, solved=True, status=AS_FOUND, lam_g=lam_g, lam_y=lam_y)


def highest_accepted(program: Program, p: Vector, start: Vector) -> float:
    """Return the largest scaled objective at which an optimum counts as no worse than its start."""
    f, violation = _violation(program, p, start)
    return f + _NOT_WORSE * abs(f) + _VIOLATION_WEIGHT * violation if violation <= FEASIBLE else np.inf


def _violation(program: Program, p: Vector, y: Vector) -> tuple[float, float]:
    """Return the scaled objective, and the largest scaled violation; infinite if the design cannot be evaluated."""
    f, g = (np.asarray(result).ravel() for result in program.nlp.values(y, p))
    valid = np.all(np.isfinite(f)) and np.all(np.isfinite(g)) and not program.refuses(y, p)
    return float(f[0]), program.violation(g) if valid else np.inf
