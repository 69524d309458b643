"""Optima in catalogue values: all combinations screened, and the best one with the other variables optimised again."""

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from plough_opt.core.checks import array_of, plain_number, shown
from plough_opt.core.errors import InfeasibleDesign, InputError, nearest
from plough_opt.core.units import has_unit, in_si, in_words
from plough_opt.design.confirmation import spread
from plough_opt.design.declarations import Variable, values_in_words
from plough_opt.design.model.ipopt import Point, SolveOptions, Vector
from plough_opt.design.model.program import Program
from plough_opt.design.result.optimum import Choice, Rounded
from plough_opt.design.result.reporting import reports
from plough_opt.design.result.sensitivity import Solved
from plough_opt.design.search.effort import CAN_WIN, TimeLimit
from plough_opt.design.search.landscape import (
    LEAST_GAIN,
    MANY_VARIABLES,
    SEED,
    Evaluations,
    Landscape,
    concatenated,
    dips_along,
    evolved,
    lines_through,
    local_minima,
    sobol_points,
    with_variables,
)
from plough_opt.design.search.local import AS_FOUND, descend, least_violation, point_as_found
from plough_opt.design.search.near import failures, from_least_violation


class _FreeSample:
    """Extent of the first sample of the free variables."""

    designs: Final = 2**16  # of all combinations together
    fewest_each: Final = 2
    most_each: Final = 128
    # Weight of a violation in the second ranking, which keeps slightly infeasible combinations in the competition.
    low_penalty: Final = 1.0


class _ShrinkingBoxes:
    """Boxes around the best designs of the lowest combinations."""

    combinations: Final = 256  # in the first round; their number is halved from round to round
    designs: Final = 16  # in a box
    radii: Final = (0.25, 0.12, 0.06, 0.03, 0.015)  # half widths by round, as fractions of the range


class _Descents:
    """Number of descents from the lowest combinations."""

    combinations: Final = 30
    together: Final = 60  # of all combinations
    most_each: Final = 8


class _Evolution:
    """Extent of the evolution of the combinations that can still win, and of the looks around its ends."""

    combinations: Final = 8  # at most
    designs_per_variable: Final = 12
    generations: Final = 50
    converged: Final = 1e-6  # It ends when the merits scatter by less than this fraction.
    looks: Final = 4  # along the lines through the lowest design


class _Screen:
    """Evaluates combinations over the variables that have no catalogue."""

    def __init__(
        self, landscape: Landscape, optimum: Vector, fixed: list[int], combinations: Vector, seed: int
    ) -> None:
        """Prepare to find the combinations that can be best.

        Args:
            landscape: of the design; vectorised.
            optimum: the scaled optimum.
            fixed: numbers of the variables with a catalogue.
            combinations: scaled values of these variables, a row for each combination.
            seed: of the samples.
        """
        self._landscape, self._optimum, self._fixed, self._combinations = landscape, optimum, fixed, combinations
        self._free = [k for k in range(len(optimum)) if k not in fixed]
        self._rng = np.random.default_rng([SEED + seed, len(combinations)])

    def promising(self, kept: list[int], limit: TimeLimit) -> dict[int, Vector]:
        """Return the combinations that can be best, each by its row with a start from which to optimise.

        The lowest merit is first and infeasible ones are last. All are evaluated with the free variables at the optimum
        and at a sample. The lowest are sampled again in shrinking boxes around their best design, and from the lowest
        designs of the remaining ones descents start.

        Args:
            kept: rows that are never dropped, such as the optimum's neighbours.
            limit: of the processor time; once it is over, the other combinations keep their lowest designs so far.
        """
        every = np.arange(len(self._combinations))
        at_optimum = self._landscape(self._designs(every, self._optimum[self._free]))
        if not self._free:
            best = _lowest(at_optimum, _Descents.combinations, kept)
            return _in_order({k: at_optimum.select([k]) for k in best.tolist()})
        samples = self._sampled(at_optimum, kept)
        descents = max(2, min(_Descents.most_each, _Descents.together // len(samples)))
        found: dict[int, Evaluations] = {}
        for number, own in samples.items():
            late = found and limit.passed("descents in some combinations")
            found[number] = own.select([int(np.argmin(own.merit))]) if late else self._descended(own, descents)
        order = [*_in_order(found)]
        # With several free variables a sample may miss the best basin of a combination that can win.
        lowest = _rank(found[order[0]])
        highest = lowest + CAN_WIN * abs(lowest)
        for number in order[: _Evolution.combinations] if len(self._free) > 1 else ():
            if _rank(found[number]) > highest or limit.passed("evolution of some combinations"):
                break
            found[number] = self._evolved(found[number], samples[number])
        return _in_order(found)

    def _designs(self, numbers: np.ndarray, free: Vector) -> Vector:
        """Return the designs that join combinations, by number, with a row each of the free variables, or the same."""
        found = with_variables(self._optimum, self._fixed, self._combinations[numbers])
        found[:, self._free] = free
        return found

    def _sampled(self, at_optimum: Evaluations, kept: list[int]) -> dict[int, Evaluations]:
        """Return the lowest combinations, by number, with evaluated designs of each.

        These are the one at the optimum, the best one found, and its part of the sample.
        """
        count, n = len(self._combinations), len(self._free)
        numbers = np.arange(count)
        each = int(np.clip(_FreeSample.designs // count, _FreeSample.fewest_each, _FreeSample.most_each))
        points = sobol_points(n, count * each, self._rng)
        # Consecutive points of the sequence fill the space evenly, so each combination takes a block of them.
        sample = self._landscape(self._designs(np.repeat(numbers, each), points))
        best = _best_of_each(at_optimum, sample, each)
        numbers = _lowest(best, _ShrinkingBoxes.combinations, kept)
        best = best.select(numbers)
        for k, radius in enumerate(_ShrinkingBoxes.radii):
            best = self._zoomed(numbers, best, radius)
            remaining = max(_Descents.combinations, _ShrinkingBoxes.combinations >> (k + 1))
            left = _lowest(best, remaining, np.flatnonzero(np.isin(numbers, kept)).tolist())
            numbers, best = numbers[left], best.select(left)
        return {
            k: concatenated([at_optimum.select([k]), best.select([j]), sample.select(slice(k * each, (k + 1) * each))])
            for j, k in enumerate(numbers.tolist())
        }

    def _zoomed(self, numbers: np.ndarray, best: Evaluations, radius: float) -> Evaluations:
        """Return the lowest design of each combination after sampling a box around its lowest so far."""
        each = _ShrinkingBoxes.designs
        offsets = self._rng.uniform(-radius, radius, (len(numbers) * each, len(self._free)))
        points = np.clip(np.repeat(best.points[:, self._free], each, axis=0) + offsets, 0.0, 1.0)
        return _best_of_each(best, self._landscape(self._designs(np.repeat(numbers, each), points)), each)

    def _descended(self, designs: Evaluations, count: int) -> Evaluations:
        """Return the best end of descents from a combination's lowest designs, with the combination's values held."""
        # The designs at the optimum and the best one found; then the local minima of the sample.
        starts = [0, 1]
        if len(designs.f) > 4 * _ShrinkingBoxes.designs:
            lowest, _ = local_minima(designs.points[:, self._free], designs.merit)
            starts += [int(k) for k in lowest if k > 1]
        # A design that cannot be evaluated has no slope to follow.
        starts = [k for k in starts if np.isfinite(designs.merit[k])][:count]
        ends = [self._end(designs.points[k]) for k in starts] or [designs.select([0])]
        return min(ends, key=_rank)

    def _evolved(self, known: Evaluations, designs: Evaluations) -> Evaluations:
        """Return the end of an evolution from a combination's lowest designs if it is lower than the known start.

        Without it two of the random catalogue problems miss the basin of their best combination.
        """
        n = len(self._free)
        size = _Evolution.designs_per_variable * n
        lowest = np.argsort(designs.merit, kind="stable")[:size]
        start = np.vstack([known.points[:, self._free], designs.points[lowest][:, self._free]])
        if len(start) < size:
            start = np.vstack([start, self._rng.random((size - len(start), n))])

        whole = partial(with_variables, known.points[0], self._free)
        most, alike = _Evolution.generations, _Evolution.converged
        best = evolved(
            lambda x: self._landscape(whole(x)).merit, start, most, self._rng, from_best=n < MANY_VARIABLES, alike=alike
        )
        return self._along_each_variable(min(known, self._end(whole(best[None])[0]), key=_rank))

    def _along_each_variable(self, one: Evaluations) -> Evaluations:
        """Return the lowest end of descents from dips along each free variable, which a sparse sample misses.

        One of the random catalogue problems needs it with some seeds.
        """
        for _ in range(_Evolution.looks):
            lines = lines_through(one.points[0], self._free)
            dips = dips_along(self._landscape(lines).merit)
            best = min([one, *(self._end(lines[k]) for k in dips)], key=_rank)
            if not _rank(best) < _rank(one) - LEAST_GAIN * abs(_rank(one)):
                break
            one = best
        return one

    def _end(self, start: Vector) -> Evaluations:
        """Return the end of a descent in the free variables, feasible if a least-violation search leads there."""
        box = np.zeros(len(start)), np.ones(len(start))
        for side in box:
            side[self._fixed] = start[self._fixed]
        end = descend(self._landscape, start, box)
        if end.feasible[0]:
            return end
        nearer = least_violation(self._landscape, end.points[0], box)
        if nearer.feasible[0]:
            return descend(self._landscape, nearer.points[0], box)
        return min((end, nearer), key=lambda one: float(one.merit[0]))


def _best_of_each(first: Evaluations, others: Evaluations, each: int) -> Evaluations:
    """Return the lowest design of each combination, out of its first design and ``each`` others."""
    count = len(first.f)
    merit = np.column_stack([first.merit, others.merit.reshape(count, each)])
    which = np.argmin(merit, axis=1)
    every = concatenated([first, others])
    return every.select(np.where(which == 0, np.arange(count), count + np.arange(count) * each + which - 1))


def _lowest(best: Evaluations, count: int, kept: list[int]) -> np.ndarray:
    """Return the numbers of the lowest combinations: half by merit, half with a low penalty, and those to keep."""
    if len(best.f) <= count:
        return np.arange(len(best.f))
    with np.errstate(invalid="ignore"):
        low_penalty = np.where(np.isfinite(best.f), best.f + _FreeSample.low_penalty * best.violation, np.inf)
    strict, loose = (np.argsort(value, kind="stable").tolist() for value in (best.merit, low_penalty))
    half = count // 2
    chosen = list(dict.fromkeys([*kept, *strict[:half], *loose[: count - half]]))
    # The two halves often overlap: fill up by merit.
    return np.array(list(dict.fromkeys([*chosen, *strict[: count + len(kept)]]))[: max(count, len(chosen))])


def _rank(design: Evaluations) -> float:
    """Return the merit by which combinations are ranked: every feasible one is below any that is not."""
    return float(design.strict_merit[0])


def _in_order(found: dict[int, Evaluations]) -> dict[int, Vector]:
    """Return the design of each combination, lowest first."""
    return {k: found[k].points[0] for k in sorted(found, key=lambda k: (_rank(found[k]), k))}


Catalogue = float | str | Sequence[float | str]
"""The values that a variable may take, or a step whose multiples it may take: numbers in SI, or texts with units."""


class _Values:
    """Which catalogue values are the optimum's or a bound's, and which multiples of a step exist."""

    # A value within this fraction of the range from the optimum is taken for it: the optimiser stops this far from a
    # bound.
    same: Final = 1e-6
    beyond_bound: Final = 1e-12  # A value beyond a bound by this fraction of the range counts as the bound.
    most_multiples: Final = 1e15  # Floating point cannot distinguish larger multiples of a step.


@dataclass(frozen=True)
class Allowed:
    """The values that a variable may take between its bounds.

    Attributes:
        number: of the variable among the design's variables.
        variable: the variable.
        offered: the catalogue's values between the bounds, ascending; or, with a step, its whole multiples by number.
        step: whose multiples are allowed; 0 for a catalogue.
    """

    number: int
    variable: Variable
    offered: Sequence[float] | range
    step: float = 0.0

    def values(self) -> list[float]:
        """Return all values in ascending order."""
        return self._in_unit(self.offered)

    def neighbours(self, optimum: float) -> list[float]:
        """Return the nearest values below and above an optimum's, or just the one that equals it."""
        v, near = self.variable, self.offered
        if self.step:
            below = math.floor(optimum / self.step) - 1 - self.offered[0]
            near = self.offered[max(0, min(int(below), len(self.offered) - 1)) :][:5]
        values = self._in_unit(near)
        nearest_value = min(values, key=lambda x: abs(x - optimum))
        if abs(nearest_value - optimum) <= _Values.same * (v.upper - v.lower):
            return [nearest_value]
        lower, higher = [x for x in values if x < optimum], [x for x in values if x > optimum]
        return [*lower[-1:], *higher[:1]]

    def _in_unit(self, offered: Sequence[float] | range) -> list[float]:
        v = self.variable
        return [min(max(self.step * k, v.lower), v.upper) for k in offered] if self.step else list(offered)


def allowed(variables: Sequence[Variable], catalogues: Mapping[str, Catalogue]) -> list[Allowed]:
    """Return the values that variables may take.

    Args:
        variables: of the design.
        catalogues: for each variable to round, by name, its values or step.

    Raises:
        InputError: there is no catalogue, or one has an unknown name, values that are not numbers, or no value between
            the variable's bounds.
    """
    if not catalogues:
        raise InputError("nothing to round: give a catalogue or a step, as in best.rounded(stiffness=[4e4, 5e4])")
    found: dict[int, Allowed] = {}
    for name, catalogue in catalogues.items():
        number = _number_of(variables, name)
        if number in found:
            raise InputError(f"'{variables[number].name}' has two catalogues: give one")
        found[number] = _allowed(number, variables[number], catalogue)
    return list(found.values())


def _number_of(variables: Sequence[Variable], name: str) -> int:
    """Return the number of a variable by its name or by its keyword, such as ``wedge_angle`` for "wedge angle"."""
    names = [v.name for v in variables]
    if name in names:
        return names.index(name)
    short = ["".join(c if c.isalnum() else "_" for c in own.rpartition(".")[2]) for own in names]
    if short.count(name) != 1:
        raise InputError(f"'{name}' is not a variable of this design: {nearest(name, names)}")
    return short.index(name)


def _allowed(number: int, v: Variable, catalogue: Catalogue) -> Allowed:
    wrong = f"the catalogue of '{v.name}' must hold finite numbers, not {shown(catalogue)}"
    what = f"the catalogue of '{v.name}'"
    catalogue = in_si(what, catalogue, v.unit) if has_unit(catalogue) else catalogue
    if isinstance(catalogue, list | tuple):
        catalogue = [in_si(what, value, v.unit) for value in catalogue]
    values = array_of(catalogue, wrong, lambda array: array.size and np.all(np.isfinite(array))).ravel()
    reserve = _Values.beyond_bound * (v.upper - v.lower)
    if np.ndim(catalogue) == 0:
        step = plain_number(f"the step of '{v.name}'", values[0], v.unit, above=0.0)
        if max(abs(v.lower), abs(v.upper)) / _Values.most_multiples > step:
            raise InputError(f"the step {step:g} of '{v.name}' is too small for its bounds: use a larger one")
        first, last = math.ceil((v.lower - reserve) / step), math.floor((v.upper + reserve) / step)
        found = Allowed(number, v, range(first, last + 1), step)
    else:
        inside = values[(values >= v.lower - reserve) & (values <= v.upper + reserve)]
        found = Allowed(number, v, tuple(np.unique(np.clip(inside, v.lower, v.upper)).tolist()))
    if not found.offered:
        raise InputError(
            f"no catalogue value of '{v.name}' lies between its bounds {in_words(v.lower, v.unit)} and"
            f" {in_words(v.upper, v.unit)}: add one that does, or widen the bounds"
        )
    return found


class _Combinations:
    """Most combinations that are screened, optimised and named."""

    screened: Final = 100_000  # This many take some seconds; from here on, only the optimum's neighbours are tried.
    # The same for the runs of their designs, of which a design over its tolerances has some seventy.
    runs_screened: Final = 2_000_000
    optimised: Final = 20
    neighbours: Final = 4096  # that are accepted
    named: Final = 5  # of those that fail, in an error message


# An optimised design may lie above its start by this fraction of the objective: the error of a search's rough runs.
_NOT_WORSE_THAN_ROUGH = 1e-5


def rounded(seed: int, unrounded: float, solved: Solved, catalogues: Mapping[str, Catalogue]) -> Rounded:
    """Return the best design with some variables in catalogue values: see `Optimum.rounded`.

    Args:
        seed: seed of the samples.
        unrounded: the optimum's objective.
        solved: the design's program with its optimum.
        catalogues: for each variable to round, its values or step.
    """
    started = time.perf_counter()
    p = solved.p
    offered = allowed(solved.program.declared.variables, catalogues)
    fixed = [own.number for own in offered]
    landscape = Landscape(solved.program, p, fixed)
    count = math.prod(len(own.offered) for own in offered)
    few = count < _Combinations.screened and count * solved.program.population.runs < _Combinations.runs_screened
    every = landscape.vectorised and few
    limit = TimeLimit("auto")
    starts = _starts(landscape, solved, offered, seed, limit if every else None)
    program = solved.program.with_steps(p, starts=[start for start, _ in starts])
    reached: list[tuple[Choice, Point]] = []
    failed: list[Choice] = []
    for number, (start, values) in enumerate(starts):
        if reached and limit.passed(f"optima of {len(starts) - number} of the {len(starts)} most promising ones"):
            break
        names = {own.variable.name: value for own, value in zip(offered, values, strict=True)}
        point, conflicts = _solved(program, p, start, fixed)
        if point is None:
            failed.append(Choice(names, None, conflicts))
        else:
            objective = point.f * program.objective_scale
            reached.append((Choice(names, objective, {}, spread(landscape, point.y, objective)), point))
    screened = count if every else len(starts)
    if not reached:
        raise _none_feasible(program, failed, screened)
    order = sorted(range(len(reached)), key=lambda k: reached[k][1].f)
    choice, point = reached[order[0]]
    # A rounded variable is held by its catalogue, not by a bound, so its bound must not count as active.
    multipliers = point.lam_y.copy()
    multipliers[fixed] = 0.0
    (local,), warnings = reports(program, landscape, [replace(point, lam_y=multipliers)])
    local = replace(local, variables={**local.variables, **choice.values})
    return Rounded(
        **local.__dict__,
        local_optima=(local,),
        status="unconfirmed" if point.status == AS_FOUND else "solved",
        seconds=time.perf_counter() - started,
        warnings=(
            *limit.warnings("{} were left out: there may be a better combination; offer fewer values"),
            *warnings,
        ),
        solved=Solved(program, p, point, dict(zip(fixed, choice.values.values(), strict=True))),
        fixed=tuple(choice.values),
        unrounded=unrounded,
        tried=(*(reached[k][0] for k in order), *failed),
        combinations=count,
        screened=screened,
    )


Combination = tuple[float, ...]
"""One value from each catalogue."""


def _starts(
    landscape: Landscape, solved: Solved, offered: Sequence[Allowed], seed: int, limit: TimeLimit | None
) -> list[tuple[Vector, Combination]]:
    """Return the designs to optimise with their combinations: those that can be best, or the optimum's neighbours.

    Args:
        landscape: of the design.
        solved: the optimum.
        offered: the values that the rounded variables may take.
        seed: seed of the samples.
        limit: of the processor time to screen all combinations; None to return only the optimum's neighbours.
    """
    neighbours = [own.neighbours(float(solved.values[own.number])) for own in offered]
    near = math.prod(map(len, neighbours))
    if limit is None and near > _Combinations.neighbours:
        raise InputError(f"{len(neighbours)} variables have too many combinations of neighbours: round fewer at a time")
    combinations = list(itertools.product(*([own.values() for own in offered] if limit else neighbours)))
    scaled = [[own.variable.scaled(x) for own, x in zip(offered, values, strict=True)] for values in combinations]
    fixed = [own.number for own in offered]
    if limit:
        always = set(itertools.product(*neighbours)) if near <= _Combinations.optimised else set()
        kept = [k for k, values in enumerate(combinations) if values in always]
        screen = _Screen(landscape, solved.point.y, fixed, np.array(scaled), seed)
        found = [*screen.promising(kept, limit).items()][: _Combinations.optimised]
        return [(start, combinations[number]) for number, start in found]
    return list(zip(with_variables(solved.point.y, fixed, scaled), combinations, strict=True))


def _solved(program: Program, p: Vector, start: Vector, fixed: list[int]) -> tuple[Point | None, dict[str, float]]:
    """Return the optimum with some variables held, or None and the shortfall of each requirement that fails."""
    as_found = point_as_found(program, p, start)
    if len(fixed) == len(start) and as_found.solved:
        return replace(as_found, status="nothing left to choose"), {}
    if len(fixed) < len(start):
        point = program.solve(start, p, SolveOptions(near=True), fixed=fixed)
        if point.solved and (not as_found.solved or point.f <= as_found.f + _NOT_WORSE_THAN_ROUGH * abs(as_found.f)):
            return point, {}
        if as_found.solved:
            return as_found, {}
    if not program.declared.requirements:
        return None, {}
    try:
        point = from_least_violation(program, p, start, fixed)
    except InfeasibleDesign as error:
        named = {r.name for r in program.declared.requirements}
        return None, {name: short for name, short in error.conflicts.items() if name in named}
    return (point if point.solved else None), {}


def _none_feasible(program: Program, tried: Sequence[Choice], screened: int) -> InfeasibleDesign:
    """Return the error that states for the least infeasible combinations which requirements fail."""
    least = sorted(tried, key=lambda choice: sum(choice.conflicts.values()) or math.inf)
    units = {v.name: v.unit for v in program.declared.variables}
    texts = [
        f"{values_in_words(choice.values, units)}: {failures(program, choice.conflicts) or 'not solved'}"
        for choice in least[: _Combinations.named]
    ]
    none = f"none of {screened} combinations of values meets" if screened > 1 else "the only combination does not meet"
    rest = f"; and {len(tried) - len(texts)} more that were optimised" if len(tried) > len(texts) else ""
    return InfeasibleDesign(
        f"{none} all requirements: {'; '.join(texts)}{rest}. Loosen one of these, or offer more values",
        least[0].conflicts,
        [f"catalogue of '{name}'" for name in least[0].values],
    )
