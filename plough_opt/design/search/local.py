"""Local searches: sequential quadratic programming on a landscape, and from a basin's bottom to full accuracy."""

from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.optimality import (
    Zero,
    curvature_of,
    difference_quotients,
    free_directions,
    independent,
    lagrangian,
    lowest_dips,
    made_convex,
    optimum_step,
    reduced_curvatures,
    relaxed_step,
    residual,
    symmetric,
    without_rounding,
)
from plough_opt.design.model.program import Program, cached
from plough_opt.design.search.effort import TimeLimit
from plough_opt.design.search.landscape import FINER, Evaluations, Landscape, Violation, concatenated

Box = tuple[Vector | float, Vector | float]
"""Lower and upper bounds of scaled variables."""

# The first step of quadratic programs needs several rounds, because the curvature depends on the multipliers that the
# step yields.
_FIRST_ROUNDS: Final = 3


class _DescentSteps:
    """Bounds of a descent's steps: how many, how long, and which are tried side by side."""

    most: Final = 25
    longest: Final = 0.3  # as far as the quadratic programs of a multimodal landscape mean anything
    # A descent ends when a step is shorter than this, or lowers the merit by less than this fraction: along a flat
    # valley IPOPT goes on.
    shortest: Final = 1e-7
    least_gain: Final = 1e-7
    # Fractions of a step that are tried side by side. Steps where curvatures are negative are too short; therefore
    # these parts of the longest step are tried, too, along the direction of the most negative curvature. From a place
    # between two ripples quadratic programs lead to the wide one, and a search of eight variables misses the narrow
    # one.
    fractions: Final = np.array([0.0, 1.0, 4.0, 2.0, 0.7, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01, 0.003, 0.0005])
    whole: Final = 1  # position of the whole step among them
    lengths: Final = 0.5 ** np.arange(12.0)
    # A direction counts as one of negative curvature below this, relative to the largest: quotients are not more
    # accurate.
    concave: Final = -1e-4
    # A slope below this part of what the curvature adds over the longest step does not show the lower side: try both.
    level: Final = 1e-3
    # If even the whole step leads up and no fraction down, there is a kink nearby, across which quotients show no
    # slope: they are formed over this part of the distance, and so is the longest step, until it is this part of the
    # first. Over much less a run's rounding (about 1e-13) would drown the slopes.
    shorter: Final = 0.03
    shortest_reach: Final = 1e-4


class _Limits:
    """What the limits of the requirements weigh in a descent, and how many of their rows take part."""

    # Of a violation within the feasibility tolerance, so high that the objective cannot exploit the tolerance.
    weight_if_feasible: Final = 1e4
    # A violation weighs this many times the largest multiplier; above 1 no optimum breaks a limit.
    over_multipliers: Final = 2.0
    # A requirement with many rows, such as a deflection at every output, enters with its worst rows only.
    most_rows: Final = 6


def descend(landscape: Landscape, start: Vector, box: Box = (0.0, 1.0)) -> Evaluations:
    """Return the end of a descent from a scaled start within bounds, by default 0 and 1; never worse than the start.

    If runs are integrated one by one, a descent takes too long and the start is returned.
    """
    if not landscape.vectorised:
        return landscape(start[None])
    start = np.clip(start, *box)
    if landscape.eliminated:
        start = np.clip(landscape(start[None]).points[0], *box)
    return _Descent(landscape, box).end_from(start)


def nearest_feasible(landscape: Landscape, design: Vector, start: Vector | None = None) -> Evaluations:
    """Return the feasible design nearest to a given one, as a local search finds it from a start or from the design."""
    descent = _Descent(landscape, (0.0, 1.0), lambda points, _: np.sum((points - design) ** 2, axis=1))
    return descent.end_from(design if start is None else start)


def least_violation(landscape: Landscape, start: Vector, box: Box = (0.0, 1.0)) -> Evaluations:
    """Return the local minimum near a start of the summed violations."""
    return _Descent(landscape, box, lambda _, f: np.zeros_like(f)).end_from(start)


class Shortfall:
    """A landscape's violations without its objective; it collects the feasible designs that a search comes across.

    Attributes:
        feasible_seen: number of feasible designs evaluated so far, repetitions included.
    """

    def __init__(self, landscape: Landscape) -> None:
        """Take the landscape."""
        self._landscape = landscape
        self._feasible: list[Evaluations] = []
        self.feasible_seen = 0

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


class _Descent:
    """Sequential quadratic programs, whose limits give way by a slack where they contradict each other.

    Values and derivatives come from designs that are integrated side by side. So do the fractions of each step, of
    which the one with the lowest merit is taken.
    """

    def __init__(
        self, landscape: Landscape, box: Box, objective: Callable[[Vector, Vector], Vector] = lambda _, f: f
    ) -> None:
        """Prepare a descent.

        Args:
            landscape: the landscape.
            box: bounds of the scaled variables.
            objective: scaled designs and their scaled objectives -> what to minimise.
        """
        self._landscape, self._program, self._objective, self._box = landscape, landscape.program, objective, box
        # The best design so far: whether it is infeasible, its merit, and its variables.
        self._best: tuple[bool, float, list[float]] | None = None

    def end_from(self, start: Vector) -> Evaluations:
        """Return the best design on the way of a descent from a start."""
        y, lam_g, rows, weight, reach = start, np.zeros(len(self._program.low)), np.empty(0, dtype=int), 1.0, 1.0
        for number in range(_DescentSteps.most):
            derivatives = difference_quotients(self._neighbours, y, reach)
            if derivatives is None:
                break
            rows = np.union1d(rows, self._worst_rows(derivatives[0][1:]))
            moves, lam_g[rows] = self._moves(y, derivatives, rows, lam_g[rows], 1 if number else _FIRST_ROUNDS, reach)
            if np.max(np.abs(moves[_DescentSteps.whole])) < reach * _DescentSteps.shortest:
                break
            weight = max(0.5 * weight, _Limits.over_multipliers * float(np.max(np.abs(lam_g), initial=0.0)))
            line = np.clip(y + moves, *self._box)
            merit = self._merits(line, weight)
            lowest, least_gain = int(np.nanargmin(merit)), _DescentSteps.least_gain * abs(merit[0])
            if merit[lowest] < merit[0] - least_gain:
                y = line[lowest]
            elif merit[_DescentSteps.whole] <= merit[0] + least_gain or reach < _DescentSteps.shortest_reach:
                break
            else:
                reach *= _DescentSteps.shorter
        return self._landscape(np.array([start if self._best is None else self._best[2]]), finer=FINER)

    def _neighbours(self, designs: Vector) -> tuple[Vector, Vector]:
        """Return what to minimise, and the requirements, of designs that are integrated with equal steps."""
        f, g = self._landscape.rows(designs, finer=FINER, together=len(designs))
        # A design whose runs have no value may have requirements that need none.
        return np.where(np.isfinite(f), self._objective(designs, f), np.nan), g

    def _merits(self, designs: Vector, weight: float) -> Vector:
        """Return what to minimise plus weighted violations, of designs with equal steps; the best of them is kept.

        The neighbours that only yield quotients are not kept: the best of them would move a start off a hilltop, to the
        side on which they happen to lie.
        """
        f, g = self._neighbours(designs)
        with np.errstate(all="ignore"):
            violation = self._landscape.violations(g).sum(axis=1)
            feasible = violation <= Violation.allowed
            merit = f + np.where(feasible, _Limits.weight_if_feasible, Violation.weight) * violation
        merit[~np.isfinite(merit)] = np.inf
        k = np.lexsort((merit, ~feasible))[0]
        if np.isfinite(merit[k]):
            key = not feasible[k], float(merit[k]), designs[k].tolist()
            self._best = key if self._best is None else min(self._best, key)
        return np.asarray(f + weight * violation)

    def _moves(
        self,
        y: Vector,
        derivatives: tuple[Vector, Vector, Vector],
        rows: np.ndarray,
        lam_g: Vector,
        rounds: int,
        reach: float,
    ) -> tuple[Vector, Vector]:
        """Return the moves to try, a row each, and the multipliers of some rows of the requirements.

        The moves are fractions of the step of a quadratic program subject to these rows, and any along the direction of
        the most negative curvature.
        """
        chosen = np.r_[0, 1 + rows]
        (_, *g), (gradient, *jacobian), hessians = (part[chosen] for part in derivatives)
        # A steep objective, as one that is scaled by a value near 0, would drown the limits in rounding.
        size = max(1.0, float(np.max(np.abs(gradient))))
        hessians[0] /= size
        at = np.array(g), gradient / size, np.reshape(jacobian, (len(rows), len(y)))
        limits = self._program.low[rows], self._program.high[rows]
        longest = reach * _DescentSteps.longest
        box = np.maximum(self._box[0], y - longest), np.minimum(self._box[1], y + longest)
        step, lam_g, lam_y = np.zeros(len(y)), lam_g / size, np.zeros(len(y))
        for _ in range(rounds):
            curvature = curvature_of(hessians, lam_g)
            found = optimum_step(curvature, y, at, limits, box=box) or relaxed_step(
                curvature, y, at, limits, box, np.array(self._program.owner, dtype=int)[rows], Violation.weight
            )
            if found is None:
                break
            step, lam_g, lam_y = found
        moves = _DescentSteps.fractions[:, None] * step
        held = (np.abs(lam_y) > Zero.multiplier) & (np.abs(step) < longest)
        free = free_directions(np.vstack([at[2][np.abs(lam_g) > Zero.multiplier], np.eye(len(y))[held]]))
        curvatures, directions = reduced_curvatures(lagrangian(hessians, lam_g), free)
        if np.any(curvatures < _DescentSteps.concave):
            aside = directions[:, 0] / np.max(np.abs(directions[:, 0]))
            slope = gradient @ aside
            farther = _DescentSteps.lengths[:, None] * -np.copysign(longest, slope) * aside
            moves = np.vstack([moves, farther])
            if abs(slope) < _DescentSteps.level * abs(curvatures[0]) * longest:
                moves = np.vstack([moves, -farther])
        return moves, lam_g * size

    def _worst_rows(self, g: Vector) -> np.ndarray:
        """Return the rows nearest to their limits, some of each requirement."""
        margin, first = self._program.margins(g), self._program.first_rows
        chosen: list[int] = []
        for begin, end in zip(first, [*first, len(g)][1:], strict=True):
            # The rows of a long requirement are a curve over time: each dip of its margin can become active.
            few = end - begin <= _Limits.most_rows
            which = range(end - begin) if few else lowest_dips(margin[begin:end], _Limits.most_rows)
            chosen += [begin + int(k) for k in which]
        return np.array(chosen, dtype=int)


class _QuickPolish:
    """What a design must be like to be polished by a few quadratic programs instead of IPOPT."""

    most_steps: Final = 5  # A start that needs more is not nearly optimal.
    # If difference quotients deviate from the exact slopes by this fraction of the largest, there is a kink in between,
    # as in the RMS of an amplitude at 0.
    kink: Final = 0.05
    margin: Final = 1e-11  # kept to each limit, scaled, so that rounding does not violate it
    active: Final = 1e-8  # A limit is active below this scaled margin.
    dependent: Final = 1e-7  # Slopes of length 1 are dependent if their matrix has a singular value below this.


def polished_by_quadratic_programs(program: Program, p: Vector, start: Vector) -> Point | None:
    """Return the optimum near a design by sequential quadratic programs, or None if a few steps do not reach it.

    Curvatures need only be rough, so they come from difference quotients of runs that are integrated together. Two or
    three evaluations of exact slopes then suffice. An interior-point method needs as many again to let its barrier
    vanish.

    Args:
        program: the design's program, built.
        p: parameters.
        start: scaled variables, nearly optimal.
    """
    if (derivatives := Landscape(program, p).quotients(start)) is None:
        return None
    margin = np.where(program.low < program.high, _QuickPolish.margin, 0.0)
    corrector = Corrector(program, margin)
    f, *at = corrector.slopes(start, p)
    exact = np.vstack(at[1:])
    largest = float(np.max(np.abs(exact)))
    # A slope may be infinite, as that of a square root at a bound; a difference without a value is NaN.
    if not largest < np.inf or not np.max(np.abs(exact - derivatives[1])) <= _QuickPolish.kink * max(1.0, largest):
        return None
    status, limits = "Search_Direction_Becomes_Too_Small", (program.low + margin, program.high - margin)
    point = Point(False, status, start, float(f[0]), np.zeros(len(margin)), np.zeros(len(start)), 0)
    for _ in range(_FIRST_ROUNDS):
        curvature = curvature_of(derivatives[2], point.lam_g)
        found = optimum_step(curvature, start, (at[0], at[1], at[2]), limits)
        if found is None:
            return None
        point = replace(point, lam_g=found[1])
    try:
        point = corrector.iterate(point, curvature, p, _QuickPolish.most_steps)
    except ValueError:  # a slope on the way has no value
        return None
    _, g, _, jacobian = corrector.slopes(point.y, p)
    margins = np.concatenate([program.margins(g), np.minimum(point.y, 1.0 - point.y)])
    active = np.vstack([jacobian, np.eye(len(start))])[margins < _QuickPolish.active]
    met = np.all((margin == 0.0) | (program.margins(g) >= 0.0))
    # Multipliers of dependent limits are ambiguous.
    return point if point.solved and met and independent(active, _QuickPolish.dependent) else None


class _Polished:
    """How far a polished design may lie from its start, and how far above it."""

    same_basin: Final = 0.05  # An optimum this close to a start, as a fraction of the range, belongs to its basin.
    same_ripple: Final = 0.005
    higher: Final = 1e-8  # fraction of the objective: IPOPT's tolerance


# IPOPT stops with these near an optimum if the objective is rough, as on a needle.
_STALLED = ("Search_Direction_Becomes_Too_Small", "Maximum_Iterations_Exceeded")


AS_FOUND = "taken as found"
"""Status of a design that IPOPT did not confirm as an optimum."""


def polished(program: Program, p: Vector, start: Vector, limit: TimeLimit | None = None) -> Point:
    """Return the local optimum near a basin minimum of a search, or the start itself if no better design lies near.

    Once the time is over, a start that meets the requirements is not tried again.
    """
    accepted = acceptance(program, p, start)
    near = polished_by_quadratic_programs(program, p, start)
    near_enough = near is not None and np.max(np.abs(near.y - start)) < _Polished.same_basin
    if near is not None and near_enough and accepted(near) and not program.refuses(near.y, p):
        return near
    as_found = point_as_found(program, p, start)
    for box, exact in ((1.0, False), (_Polished.same_basin, True), (_Polished.same_ripple, True)):
        point = program.solve(start, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if point.status in _STALLED and point_as_found(program, p, point.y).solved:
            point = _stalled(program, p, point)
        if accepted(point):
            return point
        if as_found.solved and limit is not None and limit.passed("further attempts to confirm an optimum"):
            return as_found
    point = program.solve(start, p)
    if accepted(point):
        return point
    if as_found.solved or not program.declared.requirements:
        return as_found
    # The search's rough runs may just have met a limit that these runs violate.
    return point_as_found(program, p, program.solve_relaxed(start, p)[0].y)


def solved_again(program: Program, p: Vector, point: Point) -> Point:
    """Return an optimum solved again after its program was rebuilt with other steps; the same basin, updated digits."""
    accepted = acceptance(program, p, point.y)
    for box, exact in ((_Polished.same_basin, False), (_Polished.same_ripple, False), (_Polished.same_ripple, True)):
        again = program.solve(point.y, p, SolveOptions(near=True, exact=exact, enough=True), box)
        if accepted(again):
            return again
    return replace(point, f=_values(program, p, point.y)[0])


def point_as_found(program: Program, p: Vector, y: Vector) -> Point:
    """Return a scaled design as an unconfirmed point without multipliers; it is solved if it is feasible."""
    f, g = _values(program, p, y)
    violation = _violation(program, p, y, f, g)
    count = len(program.owner)
    return Point(bool(violation <= Violation.allowed_in_answer), AS_FOUND, y, f, np.zeros(count), np.zeros(len(y)), 0)


def _stalled(program: Program, p: Vector, point: Point) -> Point:
    """Return a feasible point at which IPOPT stalled as an unconfirmed one.

    Its multipliers have not converged: those of limits that the design does not touch are noise.
    """
    g = np.asarray(program.built.nlp.values(point.y, p)[1]).ravel()
    touches = program.margins(g) <= Zero.margin
    at_bound = np.minimum(point.y, 1.0 - point.y) <= Zero.margin
    lam_g, lam_y = np.where(touches, point.lam_g, 0.0), np.where(at_bound, point.lam_y, 0.0)
    return replace(point, solved=True, status=AS_FOUND, lam_g=lam_g, lam_y=lam_y)


def acceptance(program: Program, p: Vector, start: Vector) -> Callable[[Point], bool]:
    """Return the function that tells whether a point is solved and counts as no worse than its start."""
    f, g = _values(program, p, start)
    highest = f + _Polished.higher * abs(f)

    @cache
    def highest_of_all() -> float:
        violation = _violation(program, p, start, f, g)
        return highest + Violation.weight * violation if violation <= Violation.allowed else np.inf

    # Whether the start is valid need be known only if it is lower than the point.
    return lambda found: found.solved and (found.f <= highest or found.f <= highest_of_all())


def _values(program: Program, p: Vector, y: Vector) -> tuple[float, Vector]:
    """Return the scaled objective and requirements of a design."""
    f, g = program.built.nlp.values(y, p)
    return float(f), np.asarray(g).ravel()


def _violation(program: Program, p: Vector, y: Vector, f: float, g: Vector) -> float:
    """Return the largest scaled violation from a design's values; infinite if the design cannot be evaluated."""
    valid = np.isfinite(f) and np.all(np.isfinite(g)) and not program.refuses(y, p)
    return program.violation(g) if valid else np.inf


class _Correction:
    """Bounds of a correction's steps, and of the updates of its curvature."""

    most_steps: Final = 15
    longest: Final = 0.3  # step of a scaled variable; a design farther away is not a neighbour on the same branch
    shrinking: Final = 0.7  # A step counts as progress if it is shorter than this part of the shortest one before it.
    patience: Final = 4  # steps in a row without progress after which a correction is given up
    # Threshold of Powell's damping: the least curvature along a step, relative to that of the present estimate.
    damped: Final = 0.2
    # Over shorter steps the change of a gradient is mostly rounding, so the curvature is not updated.
    shortest_update: Final = 1e-9


class Slopes(NamedTuple):
    """Scaled values and first derivatives at a design.

    Attributes:
        f: objective, shape (1,).
        g: requirements, shape (m,).
        gradient: of the objective, shape (n,).
        jacobian: of the requirements, shape (m, n).
    """

    f: Vector
    g: Vector
    gradient: Vector
    jacobian: Vector


class Corrector:
    """Corrector with the exact slopes of a program as it was when the corrector was made.

    Attributes:
        largest_residual: scaled residual of the first-order conditions below which a design counts as an optimum.
    """

    largest_residual = 1e-10

    def __init__(self, program: Program, margin: Vector | float = 0.0) -> None:
        """Use a program that is built, with a scaled margin that is kept to each row's limits."""
        self._program, self._built = program, program.built
        self._limits = program.low + margin, program.high - margin
        self._curvature: Vector | None = None
        self._slopes: dict[Hashable, Slopes] = {}
        self._values: dict[Hashable, tuple[Vector, Vector]] = {}

    def values(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return scaled objective and requirements, cached by design and parameters."""
        return cached(self._values, (y.tobytes(), p.tobytes()), lambda: self._evaluate(y, p), np.inf)

    def _evaluate(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        f, g = self._built.nlp.values(y, p)
        return np.array(f.nonzeros()), np.array(g.nonzeros())

    def slopes(self, y: Vector, p: Vector) -> Slopes:
        """Return scaled values and first derivatives, cached by design and parameters."""
        return cached(self._slopes, (y.tobytes(), p.tobytes()), lambda: self._differentiate(y, p), np.inf)

    def _differentiate(self, y: Vector, p: Vector) -> Slopes:
        f, g, gradient, jacobian = (np.asarray(result) for result in self._built.nlp.slopes(y, p))
        return Slopes(f.ravel(), g.ravel(), gradient.ravel(), jacobian)

    def residual(self, point: Point, p: Vector) -> float:
        """Return the scaled residual of the first-order conditions at a point."""
        _, g, gradient, jacobian = self.slopes(point.y, p)
        return residual(point, (g, gradient, jacobian), self._limits)

    def correct(self, neighbour: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start, by quadratic programs from a neighbour's multipliers.

        The estimate of the Lagrangian's curvature is updated from the change of its gradient (Powell 1978) and kept
        for the next solve: along a front it hardly changes, so that a few steps suffice.

        Args:
            neighbour: optimum whose multipliers to begin with.
            start: scaled variables.
            p: parameters.

        Returns:
            The optimum; or a point with ``solved=False`` if the steps lead to none.
        """
        begin = replace(neighbour, solved=False, status="Search_Direction_Becomes_Too_Small", y=start)
        kept, self._curvature = self._curvature, None
        # A kept curvature may belong to another branch; if it fails, begin again with that of the start.
        for curvature in (kept, None) if kept is not None else (None,):
            try:
                initial = self._initial_curvature(start, p, neighbour.lam_g) if curvature is None else curvature
                point = self.iterate(begin, initial, p)
            except (RuntimeError, ValueError):  # a run without an orbit, a finite value or an end
                continue
            if point.solved:
                return point
        return begin

    def iterate(self, point: Point, curvature: Vector, p: Vector, most: int = _Correction.most_steps) -> Point:
        """Return the optimum to which steps lead from a point; it is not ``solved`` if they cease to shrink.

        Args:
            point: with the scaled variables and the multipliers to begin with.
            curvature: of the Lagrangian there, positive definite.
            p: parameters.
            most: number of steps after which to give up.
        """
        stalled, shortest = 0, np.inf
        for number in range(most):
            f, g, gradient, jacobian = self.slopes(point.y, p)
            y = point.y
            solution = optimum_step(curvature, y, (g, gradient, jacobian), self._limits, _Correction.longest)
            if solution is None:
                return point
            step, lam_g, lam_y = solution
            point = replace(point, f=float(f[0]), lam_g=lam_g, lam_y=without_rounding(y, lam_y))
            if self.residual(point, p) <= self.largest_residual:
                self._curvature = curvature
                return replace(point, solved=True, status="Solve_Succeeded", iterations=number)
            size = float(np.max(np.abs(step)))
            stalled = 0 if size < _Correction.shrinking * shortest else stalled + 1
            shortest = min(size, shortest)
            if stalled >= _Correction.patience:
                return point
            point = replace(point, y=np.clip(y + step, 0.0, 1.0), lam_y=lam_y)
            if size > _Correction.shortest_update:
                _, _, next_gradient, next_jacobian = self.slopes(point.y, p)
                change = next_gradient - gradient + (next_jacobian - jacobian).T @ lam_g
                curvature = _updated(curvature, step, change)
        return point

    def _initial_curvature(self, y: Vector, p: Vector, lam_g: Vector) -> Vector:
        """Return the Hessian of the Lagrangian, by a rough integration, made positive definite."""
        return made_convex(symmetric(np.asarray(self._built.rough.hess_lag(y, p, 1.0, lam_g))))

    def solve_from_afar(self, neighbour: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start from which `correct` fails, by IPOPT.

        Args:
            neighbour: unused here; IPOPT finds its own multipliers.
            start: scaled variables.
            p: parameters.
        """
        del neighbour
        # Exact curvatures come last: around periodic orbits they take thirty times as long, and seldom help.
        for options in (SolveOptions(near=True, exact=False), SolveOptions(exact=False), SolveOptions(True, True)):
            point = self._program.solve(start, p, options)
            if point.solved or (not options.near and point.status == "Infeasible_Problem_Detected"):
                break
        return point


def _updated(curvature: Vector, step: Vector, change: Vector) -> Vector:
    """Return the BFGS update of a curvature, with Powell's damping, which keeps it positive definite.

    Args:
        curvature: estimate before the step.
        step: of the scaled variables.
        change: of the Lagrangian's gradient over the step.
    """
    along = curvature @ step
    expected = float(step @ along)
    if expected <= np.finfo(float).tiny:
        return curvature
    measured = float(step @ change)
    if measured < _Correction.damped * expected:
        share = (1.0 - _Correction.damped) * expected / (expected - measured)
        change = share * change + (1.0 - share) * along
        measured = float(step @ change)
    return np.asarray(curvature - np.outer(along, along) / expected + np.outer(change, change) / measured)
