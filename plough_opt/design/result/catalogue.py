"""Optima in catalogue values: all combinations screened, and the best ones with the other variables optimised again."""

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from plough_opt.design.search.descent import descend
from plough_opt.design.search.effort import Effort, TimeLimit
from plough_opt.design.search.explore import explore
from plough_opt.design.search.feasible import failures, from_least_violation
from plough_opt.design.search.landscape import (
    SEED,
    Evaluations,
    Landscape,
    concatenated,
    even_points,
    with_variables,
)
from plough_opt.design.search.polish import AS_FOUND, point_as_found

# Combinations from which descents start.
_SCREENED: Final = 30


def _promising(
    landscape: Landscape,
    optimum: Vector,
    fixed: list[int],
    combinations: Vector,
    kept: list[int],
    seed: int,
    limit: TimeLimit,
) -> dict[int, Vector]:
    """Return the combinations that can be best, lowest first: the number of each, with a start from which to optimise.

    All are evaluated with the free variables at the optimum and at a sample. From the lowest designs of the lowest
    combinations descents start, and those that can still win are searched.

    Args:
        landscape: of the design; vectorised.
        optimum: the scaled optimum.
        fixed: numbers of the variables with a catalogue.
        combinations: scaled values of these variables, a row for each combination.
        kept: rows that are never dropped, such as the optimum's neighbours.
        seed: of the samples.
        limit: of the processor time; once it is over, the other combinations keep their lowest designs so far.
    """
    count, free = len(combinations), [k for k in range(len(optimum)) if k not in fixed]
    designs = with_variables(optimum, fixed, combinations)
    # As many designs of all combinations together, but neither hardly any nor very many of each.
    each = int(np.clip(2**16 // count, *(2, 128))) if free else 0
    whole = np.repeat(designs, 1 + each, axis=0)
    sampled = np.arange(len(whole)) % (1 + each) > 0
    if free:
        rng = np.random.default_rng([SEED + seed, count])
        whole[np.ix_(np.flatnonzero(sampled), np.array(free))] = even_points(len(free), count * each, rng)
    every = landscape(whole)
    with np.errstate(invalid="ignore"):
        # A second ranking keeps slightly infeasible combinations.
        loose = np.where(np.isfinite(every.f), every.f + 1.0 * every.violation, np.inf)
    key = every.key.reshape(count, -1)
    strict, slack = (np.argsort(own.reshape(count, -1).min(axis=1), kind="stable").tolist() for own in (key, loose))
    half = _SCREENED // 2
    chosen = list(dict.fromkeys([*kept, *strict[:half], *slack[:half], *strict]))
    chosen = chosen[: max(_SCREENED, len(kept))]
    found: dict[int, Evaluations] = {}
    for number in chosen:
        rows = number * (1 + each) + np.argsort(key[number], kind="stable")[:2]
        late = bool(found) and limit.passed("descents in some combinations")
        own = every.select(rows[:1] if late or not free else rows)
        found[number] = own if late or not free else _descended(landscape, own, fixed)
    order = sorted(found, key=lambda k: (found[k].key[0], k))
    lowest = found[order[0]].key[0]
    for number in order[:8] if len(free) > 1 else ():
        own = found[number]
        if own.key[0] > lowest + 0.15 * abs(lowest) or limit.passed("searches in some combinations"):
            break
        ends = explore(landscape, own.points[0], free, Effort(1024, looks=2), seed=seed, held=fixed, limit=limit).ends
        found[number] = concatenated([ends, own]).distinct(0.0, 1)
    return {k: found[k].points[0] for k in sorted(found, key=lambda k: (found[k].key[0], k))}


def _descended(landscape: Landscape, starts: Evaluations, fixed: list[int]) -> Evaluations:
    """Return the best end of descents with some variables held, from starts or from where they are less infeasible."""
    ends = [starts]
    for start in starts.select(np.isfinite(starts.f)).points:
        box = np.zeros(len(start)), np.ones(len(start))
        box[0][fixed] = box[1][fixed] = start[fixed]
        end = descend(landscape, start, box)
        if not end.feasible[0]:
            nearer = descend(landscape.without_objective(), end.points[0], box)
            end = descend(landscape, nearer.points[0], box) if nearer.feasible[0] else landscape(nearer.points)
        ends.append(end)
    best = concatenated(ends)
    return best.select([int(np.argmin(best.key))])


Catalogue = float | str | Sequence[float | str]
"""The values that a variable may take, or a step whose multiples it may take: numbers in SI, or texts with units."""


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
        # A value within this fraction of the range from the optimum is taken for it: the optimiser stops this far from
        # a bound.
        if abs(nearest_value - optimum) <= 1e-6 * (v.upper - v.lower):
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
    # A value beyond a bound by this fraction of the range counts as the bound.
    reserve = 1e-12 * (v.upper - v.lower)
    if np.ndim(catalogue) == 0:
        step = plain_number(f"the step of '{v.name}'", values[0], v.unit, above=0.0)
        # Floating point cannot distinguish larger multiples of a step.
        if max(abs(v.lower), abs(v.upper)) / 1e15 > step:
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


_MOST_OPTIMISED: Final = 20


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
    landscape = Landscape(solved.program, p)
    count = math.prod(len(own.offered) for own in offered)
    # This many take some seconds; from here on, only the optimum's neighbours are tried.
    # The same for the runs of their designs, of which a design over samples of a soil has many.
    few = count < 100_000 and count * solved.program.population.runs < 2_000_000
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
    if limit is None and near > 4096:
        raise InputError(f"{len(neighbours)} variables have too many combinations of neighbours: round fewer at a time")
    combinations = list(itertools.product(*([own.values() for own in offered] if limit else neighbours)))
    scaled = [[own.variable.scaled(x) for own, x in zip(offered, values, strict=True)] for values in combinations]
    fixed = [own.number for own in offered]
    if limit:
        always = set(itertools.product(*neighbours)) if near <= _MOST_OPTIMISED else set()
        kept = [k for k, values in enumerate(combinations) if values in always]
        screened = _promising(landscape, solved.point.y, fixed, np.array(scaled), kept, seed, limit)
        found = [*screened.items()][:_MOST_OPTIMISED]
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
        for choice in least[:5]
    ]
    none = f"none of {screened} combinations of values meets" if screened > 1 else "the only combination does not meet"
    rest = f"; and {len(tried) - len(texts)} more that were optimised" if len(tried) > len(texts) else ""
    return InfeasibleDesign(
        f"{none} all requirements: {'; '.join(texts)}{rest}. Loosen one of these, or offer more values",
        least[0].conflicts,
        [f"catalogue of '{name}'" for name in least[0].values],
    )
