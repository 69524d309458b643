"""Every basin of a robust design: its objective along a variable by `Batch`, and a solve from each of its bottoms.

A strength wave makes designs multimodal in the stiffness, and the soil's strength moves the basins. To follow all
samples at two hundred values of a variable costs a batch a moment and the optimiser's own model a minute.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design import Design, LocalOptimum, Optimum, Progress
from plough_opt.errors import InfeasibleDesign, NotConverged
from plough_opt.uncertainty.robust import Robust

Vector = NDArray[np.float64]
Build = Callable[[Mapping[str, float]], tuple[Design, Robust]]

_POINTS = 200
# A violated requirement must outweigh any gain in the objective, which is set in relation to its own size.
_PENALTY = 100.0
_SAME = 1e-3


def best_from(
    start: Mapping[str, float], build: Build, scanned: Sequence[str], progress: Progress
) -> tuple[Optimum, Robust, tuple[str, ...]]:
    """Return the best robust optimum, with all that were found, and why some basins gave none.

    Args:
        start: variables by name, such as those of the nominal optimum.
        build: variables of a start -> the robust design with these as its guesses.
        scanned: names of the variables along which there may be several basins.
        progress: told what is being done.

    Raises:
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser found no optimum.
    """
    progress("robust design from the nominal optimum", 0.0)
    design, robust = build(start)
    for variable in scanned:
        # What the nominal soil allows there, the samples may not: begin where they come nearest to what is required.
        design, robust = build(next(iter(_bottoms(design, robust, start, variable)), start))
    found = [(design.solve(search="near"), robust)]
    failures = []
    for variable in scanned:
        progress(f"scanning {variable} over all samples", 0.0)
        starts = _bottoms(design, robust, found[0][0].variables, variable)
        for number, bottom in enumerate(starts):
            if any(_same(bottom, own.variables, 0.02) for own, _ in found):
                continue
            progress(f"robust design from basin {number + 1} of {len(starts)}", number / len(starts))
            further, results = build(bottom)
            try:
                found.append((further.solve(search="near"), results))
            except (InfeasibleDesign, NotConverged) as error:
                failures.append(f"from {variable} = {bottom[variable]:.5g}: {error}")
    best, robust = min(found, key=lambda pair: pair[0].objective)
    local: list[LocalOptimum] = []
    for own, _ in sorted(found, key=lambda pair: pair[0].objective):
        if not any(_same(own.variables, other.variables, _SAME) for other in local):
            local.append(own.local_optima[0])
    seconds = sum(own.seconds for own, _ in found)
    return dataclasses.replace(best, local_optima=tuple(local), seconds=seconds), robust, tuple(failures)


def _bottoms(design: Design, robust: Robust, at: Mapping[str, float], variable: str) -> list[dict[str, float]]:
    """Return the bottoms of the basins along a variable, the others held, the lowest first."""
    declared = next(v for v in design.declared.variables if v.name == variable)
    grid = [{**at, variable: declared.value(y)} for y in np.linspace(0.0, 1.0, _POINTS)]
    merit = _merit(design, robust, grid)
    left, right = np.r_[np.inf, merit[:-1]], np.r_[merit[1:], np.inf]
    bottoms = np.flatnonzero((merit < left) & (merit <= right) & np.isfinite(merit))
    return [grid[k] for k in bottoms[np.argsort(merit[bottoms])]]


def _merit(design: Design, robust: Robust, designs: Sequence[Mapping[str, float]]) -> Vector:
    """Return objective and violations of designs in one number, infinity where there is no result."""
    declared = design.declared
    names = list(robust.columns)
    columns = [ca.MX(robust.columns[name]) for name in names]
    symbols = [ca.MX.sym(name, len(robust.samples)) for name in names]
    expressions = [declared.objective, *(r.expression for r in declared.requirements)]
    replaced = ca.graph_substitute(expressions, columns, symbols)
    function = ca.Function("merit", [*declared.symbols(), *symbols], replaced)
    values = robust.responses.of_designs(designs, robust.samples)
    merit = np.full(len(designs), np.inf)
    size = 0.0
    for k, one in enumerate(designs):
        own = [values[name][k] for name in names]
        if not all(np.all(np.isfinite(part)) for part in own):
            continue
        variables = [one[symbol.name()] for symbol in declared.symbols()]
        found = [np.asarray(result).ravel() for result in function.call([*variables, *map(ca.DM, own)])]
        size = size or max(abs(float(found[0][0])), 1e-12)
        violations = [
            max(0.0, -r.margin(value)) / (r.scale or 1.0)
            for r, value in zip(declared.requirements, found[1:], strict=True)
        ]
        merit[k] = float(found[0][0]) / size + _PENALTY * max([0.0, *violations])
    return merit


def _same(one: Mapping[str, float], other: Mapping[str, float], relative: float) -> bool:
    """Return whether two designs are one, to a part of every variable."""
    return all(abs(x - other[name]) <= relative * abs(x) for name, x in one.items())
