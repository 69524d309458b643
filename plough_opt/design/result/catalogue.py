"""Optima in catalogue values: all combinations screened, and the best ones with the other variables optimised again."""

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from plough_opt.core.checks import array_of, plain_number, shown
from plough_opt.core.errors import InfeasibleDesign, InputError, nearest
from plough_opt.core.units import has_unit, in_si, in_words
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
from plough_opt.design.search.landscape import SEED, Evaluations, Landscape, concatenated, even_points, with_variables
from plough_opt.design.search.polish import AS_FOUND, point_as_found

Catalogue = float | str | Sequence[float | str]
"""The values that a variable may take, or a step whose multiples it may take: numbers in SI, or texts with units."""

# Combinations from which descents start, and those that are optimised.
_SCREENED: Final = 30
_MOST_OPTIMISED: Final = 20


def rounded(seed: int, unrounded: float, solved: Solved, catalogues: Mapping[str, Catalogue]) -> Rounded:
    """Return the best design with some variables in catalogue values: see `Optimum.rounded`.

    Args:
        seed: seed of the samples.
        unrounded: the optimum's objective.
        solved: the design's program with its optimum.
        catalogues: for each variable to round, its values or step.
    """
    started, limit = time.perf_counter(), TimeLimit("auto")
    p, variables, landscape = solved.p, solved.program.declared.variables, Landscape(solved.program, solved.p)
    offered = _offered(variables, catalogues)
    fixed, near = list(offered), [_neighbours(variables[k], x, float(solved.values[k])) for k, x in offered.items()]
    count, count_near = (math.prod(map(len, values)) for values in (offered.values(), near))
    # This many take some seconds, as do the runs of their designs, of which a design over samples of a soil has many;
    # from here on, only the optimum's neighbours are tried.
    screening = landscape.vectorised and count < 100_000 and count * solved.program.population.runs < 2_000_000
    if not screening and count_near > 4096:
        raise InputError(f"{len(near)} variables have too many combinations of neighbours: round fewer at a time")
    combinations = [*itertools.product(*(offered.values() if screening else near))]
    scaled = [[variables[k].scaled(x) for k, x in zip(fixed, values, strict=True)] for values in combinations]
    designs = with_variables(solved.point.y, fixed, np.array(scaled))
    starts = dict(enumerate(designs))
    if screening:
        always = set(itertools.product(*near)) if count_near <= _MOST_OPTIMISED else set()
        kept = [k for k, values in enumerate(combinations) if values in always]
        starts = _promising(landscape, designs, fixed, kept, seed, limit)
    program = solved.program.with_steps(p, starts=list(starts.values()))
    names = [variables[k].name for k in fixed]
    tried = {tuple(zip(names, combinations[k], strict=True)): start for k, start in starts.items()}
    reached, failed = _solved_again(program, p, tried, fixed, limit)
    if not reached:
        raise _none_feasible(program, failed, len(combinations))
    choice, point = reached[0]
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
        tried=(*(own for own, _ in reached), *failed),
        combinations=count,
        screened=len(combinations),
    )


def _offered(variables: Sequence[Variable], catalogues: Mapping[str, Catalogue]) -> dict[int, list[float]]:
    """Return number -> ascending values between the bounds of each variable with a catalogue.

    Raises:
        InputError: there is no catalogue, or one has an unknown name, values that are not numbers, or no value between
            the variable's bounds.
    """
    if not catalogues:
        raise InputError("nothing to round: give a catalogue or a step, as in best.rounded(stiffness=[4e4, 5e4])")
    names = [v.name for v in variables]
    # A keyword such as wedge_angle stands for "wedge angle".
    keywords = ["".join(c if c.isalnum() else "_" for c in name.rpartition(".")[2]) for name in names]
    offered: dict[int, list[float]] = {}
    for name, catalogue in catalogues.items():
        if name not in names and keywords.count(name) != 1:
            raise InputError(f"'{name}' is not a variable of this design: {nearest(name, names)}")
        number = names.index(name) if name in names else keywords.index(name)
        if number in offered:
            raise InputError(f"'{names[number]}' has two catalogues: give one")
        offered[number] = _between_bounds(variables[number], catalogue)
    return offered


def _between_bounds(v: Variable, catalogue: Catalogue) -> list[float]:
    what = f"the catalogue of '{v.name}'"
    wrong = f"{what} must hold finite numbers, not {shown(catalogue)}"
    catalogue = in_si(what, catalogue, v.unit) if has_unit(catalogue) else catalogue
    if isinstance(catalogue, list | tuple):
        catalogue = [in_si(what, value, v.unit) for value in catalogue]
    values: Vector = array_of(catalogue, wrong, lambda array: array.size and np.all(np.isfinite(array))).ravel()
    # A value beyond a bound by this fraction of the range counts as the bound.
    low, high = (end + sign * 1e-12 * (v.upper - v.lower) for end, sign in ((v.lower, -1.0), (v.upper, 1.0)))
    if np.ndim(catalogue) == 0:
        step = plain_number(f"the step of '{v.name}'", values[0], v.unit, above=0.0)
        # Closer values cannot be told apart, see `_neighbours`.
        if high - low > 1e6 * step:
            raise InputError(f"the step {step:g} of '{v.name}' is too small for its bounds: use a larger one")
        values = np.array([step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)])
    inside = values[(values >= low) & (values <= high)]
    if not len(inside):
        raise InputError(
            f"no catalogue value of '{v.name}' lies between its bounds {in_words(v.lower, v.unit)} and"
            f" {in_words(v.upper, v.unit)}: add one that does, or widen the bounds"
        )
    return list(np.unique(np.clip(inside, v.lower, v.upper)).tolist())


def _neighbours(v: Variable, values: Sequence[float], optimum: float) -> list[float]:
    """Return the nearest values below and above an optimum's, or just the one that equals it."""
    nearest_value = min(values, key=lambda x: abs(x - optimum))
    # A value within this fraction of the range from the optimum is taken for it: the optimiser stops this far from a
    # bound.
    if abs(nearest_value - optimum) <= 1e-6 * (v.upper - v.lower):
        return [nearest_value]
    return [*[x for x in values if x < optimum][-1:], *[x for x in values if x > optimum][:1]]


def _promising(
    landscape: Landscape, designs: Vector, fixed: list[int], kept: list[int], seed: int, limit: TimeLimit
) -> dict[int, Vector]:
    """Return the combinations that can be best, lowest first: the number of each, with a start from which to optimise.

    All are evaluated with the free variables at the optimum and at a sample. From the lowest designs of the lowest
    combinations descents start, and those that can still win are searched.

    Args:
        landscape: of the design; vectorised.
        designs: for each combination the scaled design with the free variables at the optimum.
        fixed: numbers of the variables with a catalogue.
        kept: rows that are never dropped, such as the optimum's neighbours.
        seed: of the samples.
        limit: of the processor time; once it is over, the other combinations keep their lowest designs so far.
    """
    count, n = designs.shape
    free = [k for k in range(n) if k not in fixed]
    # As many designs of all combinations together, but neither hardly any nor very many of each.
    each = int(np.clip(2**16 // count, 2, 128)) if free else 0
    whole = np.repeat(designs[:, None], 1 + each, axis=1)
    if free:
        sample = even_points(len(free), count * each, np.random.default_rng([SEED + seed, count]))
        whole[:, 1:, free] = sample.reshape(count, each, -1)
    tried = landscape(whole.reshape(-1, n))
    key = tried.key.reshape(count, -1)
    with np.errstate(invalid="ignore"):
        # A second ranking keeps slightly infeasible combinations.
        loose = np.where(np.isfinite(tried.f), tried.f + tried.violation, np.inf).reshape(count, -1)
    strict, slack = (np.argsort(own.min(axis=1), kind="stable").tolist() for own in (key, loose))
    half = _SCREENED // 2
    chosen = list(dict.fromkeys([*kept, *strict[:half], *slack[:half], *strict]))[: max(_SCREENED, len(kept))]
    best: dict[int, Evaluations] = {}
    for number in chosen:
        own = tried.select(number * (1 + each) + np.argsort(key[number], kind="stable")[:2])
        if free and not (best and limit.passed("descents in some combinations")):
            own = concatenated([own, *(_descended(landscape, y, fixed) for y in own.points[np.isfinite(own.f)])])
        best[number] = own.select([int(np.argmin(own.key))])
    order = sorted(best, key=lambda k: (best[k].key[0], k))
    lowest = best[order[0]].key[0]
    for number in order[:8] if len(free) > 1 else ():
        own = best[number]
        if own.key[0] > lowest + 0.15 * abs(lowest) or limit.passed("searches in some combinations"):
            break
        ends = explore(landscape, own.points[0], free, Effort(1024, looks=2), seed=seed, held=fixed, limit=limit).ends
        best[number] = concatenated([ends, own]).distinct(0.0, 1)
    order = sorted(best, key=lambda k: (best[k].key[0], k))
    return {k: best[k].points[0] for k in order[:_MOST_OPTIMISED]}


def _descended(landscape: Landscape, start: Vector, fixed: list[int]) -> Evaluations:
    """Return the end of a descent with some variables held; if it is infeasible, of one from a feasible design."""
    box = np.zeros(len(start)), np.ones(len(start))
    box[0][fixed] = box[1][fixed] = start[fixed]
    end = descend(landscape, start, box)
    if end.feasible[0]:
        return end
    nearer = descend(landscape.without_objective(), end.points[0], box)
    return descend(landscape, nearer.points[0], box) if nearer.feasible[0] else landscape(nearer.points)


# An optimised design may lie above its start by this fraction of the objective: the error of a search's rough runs.
_NOT_WORSE_THAN_ROUGH = 1e-5


def _solved_again(
    program: Program,
    p: Vector,
    tried: Mapping[tuple[tuple[str, float], ...], Vector],
    fixed: list[int],
    limit: TimeLimit,
) -> tuple[list[tuple[Choice, Point]], list[Choice]]:
    """Return the combinations that meet all requirements with their optima, best first, and those that do not.

    Args:
        program: with integration steps.
        p: parameters.
        tried: combination, as pairs of name and value -> the scaled design from which to optimise.
        fixed: numbers of the variables with a catalogue.
        limit: of the processor time.
    """
    reached: list[tuple[Choice, Point]] = []
    failed: list[Choice] = []
    for done, (values, start) in enumerate(tried.items()):
        if reached and limit.passed(f"optima of {len(tried) - done} of the {len(tried)} most promising ones"):
            break
        point, conflicts = _solved(program, p, start, fixed)
        if point is None:
            failed.append(Choice(dict(values), None, conflicts))
        else:
            reached.append((Choice(dict(values), point.f * program.objective_scale, {}), point))
    return sorted(reached, key=lambda own: own[1].f), failed


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
