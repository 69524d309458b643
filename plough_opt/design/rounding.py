"""Optima in catalogue values: the best combination of them, with the other variables optimised again."""

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plough_opt.core.checks import array_of, shown
from plough_opt.core.errors import InfeasibleDesign, InputError, nearest
from plough_opt.core.units import has_unit, in_si, in_words
from plough_opt.design.declarations import Variable
from plough_opt.design.infeasible import failures, from_least_violation
from plough_opt.design.ipopt import Point, SolveOptions, Vector
from plough_opt.design.landscape import Landscape
from plough_opt.design.optimum import Choice, Rounded, values_in_words
from plough_opt.design.polishing import AS_FOUND, point_as_found
from plough_opt.design.program import Program
from plough_opt.design.reporting import reports
from plough_opt.design.screening import promising
from plough_opt.design.sensitivity import Solved
from plough_opt.design.tolerance import Judge, ranking_criterion, spread

Catalogue = float | str | Sequence[float | str]
"""The values that a variable may take, or a step whose multiples it may take: numbers in SI, or texts with units."""

# A catalogue value within this fraction of the range from the optimum is taken for it: the optimiser stops this far
# from a bound.
_SAME_VALUE = 1e-6
# A value beyond a bound by this fraction of the range counts as the bound.
_ROUNDING = 1e-12
# Floating point cannot distinguish larger multiples of a step.
_MOST_MULTIPLES = 1e15


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

    @property
    def count(self) -> int:
        """Number of values."""
        return len(self.offered)

    def values(self) -> list[float]:
        """Return all values in ascending order."""
        return self._in_unit(self.offered)

    def neighbours(self, optimum: float) -> list[float]:
        """Return the nearest values below and above an optimum's, or just the one that equals it."""
        v, near = self.variable, self.offered
        if self.step:
            below = math.floor(optimum / self.step) - 1 - self.offered[0]
            near = self.offered[max(0, min(int(below), self.count - 1)) :][:5]
        values = self._in_unit(near)
        nearest_value = min(values, key=lambda x: abs(x - optimum))
        if abs(nearest_value - optimum) <= _SAME_VALUE * (v.upper - v.lower):
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
    names = [v.name for v in variables if not v.auxiliary]
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
    values = array_of(catalogue, wrong).ravel()
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(wrong)
    reserve = _ROUNDING * (v.upper - v.lower)
    if np.ndim(catalogue) == 0:
        step = float(values[0])
        if step <= 0.0:
            raise InputError(f"the step of '{v.name}' must be above 0, not {step:g}")
        if max(abs(v.lower), abs(v.upper)) / _MOST_MULTIPLES > step:
            raise InputError(f"the step {step:g} of '{v.name}' is too small for its bounds: use a larger one")
        first, last = math.ceil((v.lower - reserve) / step), math.floor((v.upper + reserve) / step)
        found = Allowed(number, v, range(first, last + 1), step)
    else:
        inside = values[(values >= v.lower - reserve) & (values <= v.upper + reserve)]
        found = Allowed(number, v, tuple(np.unique(np.clip(inside, v.lower, v.upper)).tolist()))
    if not found.count:
        raise InputError(
            f"no catalogue value of '{v.name}' lies between its bounds {in_words(v.lower, v.unit)} and"
            f" {in_words(v.upper, v.unit)}: add one that does, or widen the bounds"
        )
    return found


# Screening this many combinations takes some seconds; from here on, only the optimum's neighbours are tried.
_MOST_SCREENED = 100_000
# Most combinations that are optimised.
_MOST_OPTIMISED = 20
# Most combinations of neighbours that are accepted.
_MOST_NEIGHBOURS = 4096
# An optimised design may lie above its start by this fraction of the objective: the error of a search's rough runs.
_NOT_WORSE = 1e-5
# Most failing combinations that an error message names.
_MOST_NAMED = 5


def rounded(judge: Judge, seed: int, unrounded: float, solved: Solved, catalogues: Mapping[str, Catalogue]) -> Rounded:
    """Return the best design with some variables in catalogue values: see `Optimum.rounded`.

    Args:
        judge: what the combinations are ranked by.
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
    count = math.prod(own.count for own in offered)
    every = landscape.vectorised and count < _MOST_SCREENED
    starts = _starts(landscape, solved, offered, seed, every)
    program = solved.program.with_steps(p, starts=[start for start, _ in starts])
    reached: list[tuple[Choice, Point, Combination]] = []
    failed: list[Choice] = []
    for start, values in starts:
        names = {own.variable.name: value for own, value in zip(offered, values, strict=True)}
        point, conflicts = _solved(program, p, start, fixed)
        if point is None:
            failed.append(Choice(names, None, conflicts))
        else:
            objective = point.f * program.objective_scale
            reached.append((Choice(names, objective, {}, spread(landscape, point.y, objective)), point, values))
    screened = count if every else len(starts)
    if not reached:
        raise _none_feasible(program, failed, screened)
    judged = ranking_criterion(landscape, judge)(np.array([point.y for _, point, _ in reached]))
    order = sorted(range(len(reached)), key=lambda k: (round(float(judged[k]), 9), reached[k][1].f))
    choice, point, values = reached[order[0]]
    # A rounded variable is held by its catalogue, not by a bound, so its bound must not count as active.
    multipliers = point.lam_y.copy()
    multipliers[fixed] = 0.0
    (local,), warnings = reports(program, landscape, [replace(point, lam_y=multipliers)])
    local = replace(local, variables={**local.variables, **choice.values})
    return Rounded(
        **local.__dict__,
        local_optima=(local,),
        over=program.over,
        status="unconfirmed" if point.status == AS_FOUND else "solved",
        seconds=time.perf_counter() - started,
        warnings=warnings,
        solved=Solved(program, p, point, dict(zip(fixed, values, strict=True))),
        fixed=tuple(choice.values),
        unrounded=unrounded,
        tried=(*(reached[k][0] for k in order), *failed),
        combinations=count,
        screened=screened,
    )


Combination = tuple[float, ...]
"""One value from each catalogue."""


def _starts(
    landscape: Landscape, solved: Solved, offered: Sequence[Allowed], seed: int, every: bool
) -> list[tuple[Vector, Combination]]:
    """Return the designs to optimise with their combinations: those that can be best, or the optimum's neighbours.

    Args:
        landscape: of the design.
        solved: the optimum.
        offered: the values that the rounded variables may take.
        seed: seed of the samples.
        every: whether to screen all combinations, or to return only the optimum's neighbours.
    """
    neighbours = [own.neighbours(float(solved.values[own.number])) for own in offered]
    near = math.prod(map(len, neighbours))
    if not every and near > _MOST_NEIGHBOURS:
        raise InputError(f"{len(neighbours)} variables have too many combinations of neighbours: round fewer at a time")
    combinations = list(itertools.product(*([own.values() for own in offered] if every else neighbours)))
    scaled = [[own.variable.scaled(x) for own, x in zip(offered, values, strict=True)] for values in combinations]
    fixed = [own.number for own in offered]
    if every:
        always = set(itertools.product(*neighbours)) if near <= _MOST_OPTIMISED else set()
        kept = [k for k, values in enumerate(combinations) if values in always]
        found = promising(landscape, solved.point.y, fixed, np.array(scaled), kept, seed)[:_MOST_OPTIMISED]
        return [(one.start.points[0], combinations[one.number]) for one in found]
    designs = np.repeat(solved.point.y[None], len(combinations), axis=0)
    designs[:, fixed] = scaled
    return list(zip(designs, combinations, strict=True))


def _solved(program: Program, p: Vector, start: Vector, fixed: list[int]) -> tuple[Point | None, dict[str, float]]:
    """Return the optimum with some variables held, or None and the shortfall of each requirement that fails."""
    as_found = point_as_found(program, p, start)
    if len(fixed) == len(start) and as_found.solved:
        return replace(as_found, status="nothing left to choose"), {}
    if len(fixed) < len(start):
        point = program.solve(start, p, SolveOptions(near=True), fixed=fixed)
        if point.solved and (not as_found.solved or point.f <= as_found.f + _NOT_WORSE * abs(as_found.f)):
            return point, {}
        if as_found.solved:
            return as_found, {}
    if not program.declared.requirements:
        return None, {}
    try:
        point = from_least_violation(program, p, start, fixed)
    except InfeasibleDesign as error:
        return None, error.conflicts
    return (point if point.solved else None), {}


def _none_feasible(program: Program, tried: Sequence[Choice], screened: int) -> InfeasibleDesign:
    """Return the error that states for the least infeasible combinations which requirements fail."""
    least = sorted(tried, key=lambda choice: sum(choice.conflicts.values()) or math.inf)
    units = {v.name: v.unit for v in program.declared.variables}
    texts = [
        f"{values_in_words(choice.values, units)}: {failures(program, choice.conflicts) or 'not solved'}"
        for choice in least[:_MOST_NAMED]
    ]
    none = f"none of {screened} combinations of values meets" if screened > 1 else "the only combination does not meet"
    rest = f"; and {len(tried) - len(texts)} more that were optimised" if len(tried) > len(texts) else ""
    return InfeasibleDesign(
        f"{none} all requirements: {'; '.join(texts)}{rest}. Loosen one of these, or offer more values",
        least[0].conflicts,
        [f"catalogue of '{name}'" for name in least[0].values],
    )
