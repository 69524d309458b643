"""An optimum in values that can be bought or made: its neighbours in a catalogue, the rest solved again."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from plough_opt.design.declarations import Variable, in_words
from plough_opt.design.infeasible import infeasible, is_feasible
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.optimum import Choice, LocalOptimum, Rounded
from plough_opt.design.program import Program
from plough_opt.design.sensitivity import Sensitivities
from plough_opt.errors import InfeasibleDesign, InputError, nearest

Catalogue = float | Sequence[float]
"""Values that a variable may take, or the step of which it may take multiples."""

# The optimiser stops this near a bound; a value of the catalogue this near is the optimum's own.
_ITSELF = 1e-6
_ROUNDING = 1e-12
_MOST_COMBINATIONS = 4096


def rounded(
    program: Program,
    p: Vector,
    point: Point,
    best: LocalOptimum,
    report: Callable[[Point], tuple[LocalOptimum, tuple[str, ...]]],
    evaluate: Callable[..., Vector],
    catalogues: Mapping[str, Catalogue],
) -> Rounded:
    """Return the best design with some variables in catalogue values beside an optimum: see `Optimum.rounded`.

    Args:
        program: the design's program, built.
        p: parameters of the optimum.
        point: the optimum.
        best: its report.
        report: gives the report on a point, and its warnings.
        evaluate: (values of the variables, expression) -> number.
        catalogues: for each variable to round, its values or step.
    """
    started = time.perf_counter()
    neighbours = _neighbours(program, best, catalogues)
    fixed = list(neighbours)
    if math.prod(map(len, neighbours.values())) > _MOST_COMBINATIONS:
        raise InputError(f"{len(fixed)} variables have too many combinations of neighbours: round fewer at a time")
    tried, found = [], []
    for values in itertools.product(*neighbours.values()):
        chosen = dict(zip(fixed, values, strict=True))
        reached, conflicts = _solved(program, p, point.y, chosen)
        names = {program.declared.variables[k].name: value for k, value in chosen.items()}
        tried.append(Choice(names, reached.f * program.objective_scale if reached else None, conflicts))
        if reached:
            found.append((reached, chosen, names))
    if not found:
        raise _nothing(program, tried)
    reached, chosen, names = min(found, key=lambda one: one[0].f)
    # What holds a rounded variable is the catalogue, and no bound.
    pulls = reached.lam_y.copy()
    pulls[fixed] = 0.0
    local, warnings = report(replace(reached, lam_y=pulls))
    numbers = program.values(reached.y)
    numbers[fixed] = list(chosen.values())
    local = replace(local, variables={**local.variables, **names})
    return Rounded(
        **{name: getattr(local, name) for name in LocalOptimum.__dataclass_fields__},
        local_optima=(local,),
        seconds=time.perf_counter() - started,
        warnings=warnings,
        evaluate=partial(evaluate, numbers),
        sensitivities=Sensitivities(program, p, reached, fixed),
        fixed=tuple(names),
        unrounded=best.objective,
        tried=tuple(sorted(tried, key=lambda choice: math.inf if choice.objective is None else choice.objective)),
    )


# --- neighbours -------------------------------------------------------------------------------------------


def _neighbours(program: Program, best: LocalOptimum, catalogues: Mapping[str, Catalogue]) -> dict[int, list[float]]:
    """Return, for each variable to round, its number and the values on either side of the optimum's."""
    if not catalogues:
        raise InputError("nothing to round: give a catalogue or a step, like best.rounded(stiffness=[4e4, 5e4])")
    variables = program.declared.variables
    found: dict[int, list[float]] = {}
    for name, catalogue in catalogues.items():
        number = _number_of(variables, name)
        if number in found:
            raise InputError(f"'{variables[number].name}' is given two catalogues: give one")
        found[number] = _beside(variables[number], best.variables[variables[number].name], catalogue)
    return found


def _number_of(variables: Sequence[Variable], name: str) -> int:
    """Return the number of a variable by its name, or by that as a keyword: ``wedge_angle`` for "wedge angle"."""
    names = [v.name for v in variables]
    if name in names:
        return names.index(name)
    short = ["".join(c if c.isalnum() else "_" for c in own.rpartition(".")[2]) for own in names]
    if short.count(name) != 1:
        raise InputError(f"'{name}' is no variable of this design: {nearest(name, names)}")
    return short.index(name)


def _beside(v: Variable, optimum: float, catalogue: Catalogue) -> list[float]:
    """Return the nearest allowed values at or below and at or above the optimum's, between the variable's bounds."""
    try:
        values = np.atleast_1d(np.asarray(catalogue, dtype=float))
    except (TypeError, ValueError):
        values = np.array([])
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(f"the catalogue of '{v.name}' must hold finite numbers, not {catalogue!r}")
    if np.ndim(catalogue) == 0:
        step = float(values[0])
        if step <= 0.0:
            raise InputError(f"the step of '{v.name}' must be above 0, not {step:g}")
        values = step * (math.floor(optimum / step) + np.array([-1.0, 0.0, 1.0, 2.0]))
    rounding, near = _ROUNDING * (v.upper - v.lower), _ITSELF * (v.upper - v.lower)
    allowed = values[(values >= v.lower - rounding) & (values <= v.upper + rounding)]
    inside = np.clip(allowed, v.lower, v.upper).tolist()
    if not inside:
        raise InputError(
            f"no value that '{v.name}' may take lies between its bounds {in_words(v.lower, v.unit)} and"
            f" {in_words(v.upper, v.unit)}, beside the optimum's {in_words(optimum, v.unit)}"
        )
    itself = min(inside, key=lambda x: abs(x - optimum))
    if abs(itself - optimum) <= near:
        return [itself]
    below, above = [x for x in inside if x < optimum], [x for x in inside if x > optimum]
    return [*([max(below)] if below else []), *([min(above)] if above else [])]


# --- solving ----------------------------------------------------------------------------------------------


def _solved(
    program: Program, p: Vector, y: Vector, chosen: Mapping[int, float]
) -> tuple[Point | None, dict[str, float]]:
    """Return the optimum with some variables held, or None and the requirements that fail, by how much."""
    start, fixed = y.copy(), list(chosen)
    start[fixed] = [program.declared.variables[k].scaled(value) for k, value in chosen.items()]
    if len(fixed) < len(y) and (point := program.solve_with_fixed(start, p, fixed)).solved:
        return point, {}
    if program.declared.requirements:
        loose = program.solve_relaxed(start, p, fixed)
        if not is_feasible(loose):
            return None, infeasible(program, loose).conflicts
        if len(fixed) < len(y):
            point = program.solve_with_fixed(np.clip(loose.y[: len(y)], 0.0, 1.0), p, fixed)
    if len(fixed) < len(y):
        return (point if point.solved else None), {}
    f = float(np.asarray(program.nlp.f(start, p)).item())
    return Point(True, "nothing left to choose", start, f, np.zeros(len(program.owner)), np.zeros(len(y)), 0), {}


def _nothing(program: Program, tried: Sequence[Choice]) -> InfeasibleDesign:
    """Return the error that says of every combination which requirements fail."""
    requirements = {r.name: r for r in program.declared.requirements}
    texts = []
    for choice in tried:
        units = {v.name: v.unit for v in program.declared.variables}
        values = ", ".join(f"{name} = {in_words(x, units[name])}" for name, x in choice.values.items())
        fails = ", ".join(
            f"'{name}' ({requirements[name].limits_text()}) fails by {in_words(x, requirements[name].unit)}"
            for name, x in choice.conflicts.items()
        )
        texts.append(f"{values}: {fails or 'not solved'}")
    least = min(tried, key=lambda choice: sum(choice.conflicts.values()) or math.inf)
    return InfeasibleDesign(
        f"no combination of values beside the optimum meets all requirements: {'; '.join(texts)}. Loosen one of these,"
        " or offer more values",
        least.conflicts,
        [f"catalogue of '{name}'" for name in least.values],
    )
