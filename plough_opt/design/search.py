"""Global search: scan the stiffness where a strength wave makes it multimodal, and polish every basin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from plough_opt.design.curvature import minimum_from
from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.program import Program
from plough_opt.errors import InputError, nearest

SCAN_POINTS = 200
"""Positions between the bounds at which a scanned variable is tried."""

NEAR_GUESS = "near"
"""Asks for no scan, and for the optimum of the basin in which the guess lies."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction done of it."""

# A violated requirement must outweigh any gain in the scaled objective, which is of order 1.
_PENALTY = 100.0
_ROUNDS = 3
# Scaled distance within which the bottom of a basin is beside the tried position that found it.
_BESIDE = 1.5 / (SCAN_POINTS - 1)
_FEASIBLE = 1e-6
# Two scaled points nearer than this are one optimum.
_SAME = 1e-4
_SAME_GEOMETRY = 1e-2


@dataclass(frozen=True)
class Scan:
    """Objective along one variable, the others held at a local optimum, to some 1e-4 of it.

    Attributes:
        variable: its name.
        values: tried values, in the variable's unit.
        objective: objective at them; NaN where a requirement is violated.
    """

    variable: str
    values: Vector
    objective: Vector


def scanned_variables(program: Program, search: str | Sequence[str]) -> list[int]:
    """Return which variables to scan.

    Args:
        program: the design's program.
        search: ``"auto"``: those on which the stiffness of a run with a strength wave depends;
            ``"local"`` or ``"near"``: none; or names of variables.

    Raises:
        InputError: a name that is no variable.
    """
    names = [v.name for v in program.declared.variables]
    if search in ("local", NEAR_GUESS):
        return []
    if search != "auto":
        wanted = [search] if isinstance(search, str) else list(search)
        for name in wanted:
            if name not in names:
                known = nearest(name, ["auto", "local", NEAR_GUESS, *names])
                raise InputError(f"search = '{name}' is no variable of this design: {known}")
        return [names.index(name) for name in dict.fromkeys(wanted)]
    found: set[int] = set()
    for run in program.exact.runs:
        if run.integration.structure.wave:
            stiffness = run.inputs[run.integration.names.index("stiffness")]
            function = ca.Function("stiffness", program.declared.symbols(), [stiffness])
            found |= {k for k in range(len(names)) if function.jac_sparsity(0, k).nnz() > 0}
    return sorted(found)


def global_search(
    program: Program, p: Vector, first: Point, scanned: Sequence[int], progress: Progress
) -> tuple[list[Point], list[Scan]]:
    """Return all distinct local optima found, best first, and the scans that led to them.

    Args:
        program: the design's program.
        p: parameters.
        first: a local optimum, whose geometry the first scan keeps.
        scanned: numbers of the variables to scan.
        progress: told what is being done.
    """
    optima, scans = [first], []
    for variable in scanned:
        visited: list[Vector] = []
        for _ in range(_ROUNDS):
            fresh = [point for point in optima if _new_geometry(point, variable, visited)]
            if not fresh:
                break
            visited.append(np.delete(fresh[0].y, variable))
            scan, starts = _scan(program, p, fresh[0], variable, progress)
            scans.append(scan)
            for number, (start, feasible) in enumerate(starts):
                progress(f"polishing basin {number + 1} of {len(starts)}", number / len(starts))
                if not feasible:
                    # Without curvatures requirements that are broken mislead it; roughly they cost little.
                    point = program.solve_roughly(start, p)
                    start = point.y
                if feasible or point.solved:
                    point = program.solve(start, p, near=True)
                if point.solved and feasible and abs(point.y[variable] - start[variable]) > _BESIDE:
                    # Without curvatures its first steps may be too long for a narrow basin.
                    point = program.solve(start, p, near=True, exact=True)
                # A start that breaks a requirement and cannot mend it nearby leads to basins already known.
                if not point.solved and feasible:
                    point = program.solve(start, p)
                point = minimum_from(program, p, point)
                if point.solved and not any(np.max(np.abs(point.y - other.y)) < _SAME for other in optima):
                    optima.append(point)
    return sorted(optima, key=lambda point: point.f), scans


def _new_geometry(point: Point, variable: int, visited: list[Vector]) -> bool:
    rest = np.delete(point.y, variable)
    return all(np.max(np.abs(rest - other), initial=0.0) > _SAME_GEOMETRY for other in visited)


def _scan(
    program: Program, p: Vector, at: Point, variable: int, progress: Progress
) -> tuple[Scan, list[tuple[Vector, bool]]]:
    """Try positions of one variable; return the record, and a start in each basin and whether it is feasible."""
    declared = program.declared.variables[variable]
    progress(f"scanning {declared.name}", 0.0)
    points = np.repeat(at.y[None, :], SCAN_POINTS, axis=0)
    points[:, variable] = np.linspace(0.0, 1.0, SCAN_POINTS)
    objective, violation = program.merit(points, p)
    merit = objective + _PENALTY * violation
    left, right = np.r_[np.inf, merit[:-1]], np.r_[merit[1:], np.inf]
    basins = np.flatnonzero((merit < left) & (merit <= right) & np.isfinite(merit))
    order = basins[np.argsort(merit[basins])]
    feasible = violation <= _FEASIBLE
    seen = np.where(feasible, objective * program.objective_scale, np.nan)
    values = np.array([declared.value(x) for x in points[:, variable]])
    return Scan(declared.name, values, seen), [(points[k], bool(feasible[k])) for k in order]
