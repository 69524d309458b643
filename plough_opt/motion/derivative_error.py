"""How far the derivatives of runs are off: those by their own steps against those by finer ones."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.jets import jets_of
from plough_opt.motion.plan import finer
from plough_opt.motion.signals import signals
from plough_opt.motion.terms import start_deflection

Vector = NDArray[np.float64]

# Runs of one structure that are compared, of however many there are, and steps of theirs, which take a second.
_MOST_RUNS, _FEWEST_RUNS, _MOST_STEPS = 8, 2, 10_000
# Of order 8 so many more steps leave a twenty-fifth of the error, and across kinks a fifth.
_FINER = 1.5
# An RMS below this part of the mean counts as that part: what swings less is rounding.
_LEAST_SWING = 1e-3


def derivative_error(solver: Integration, first: int, varying: tuple[int, ...], given: Vector) -> float:
    """Return the largest error of first and second derivatives of runs, those of an orbit excepted, which is 0.

    Derivatives are by relative changes of the parameters, the second ones by all pairs. They are compared with those of
    half as many steps again, or of a tenth of the tolerance; through events the first ones only, for the second ones
    take as long as a solve.

    Args:
        solver: integrates the runs.
        first: number of the first result that matters.
        varying: positions of the parameters to differentiate by.
        given: the parameters, the duration last, a column for each run.

    Returns:
        Relative to the largest of result, first and second derivatives, for each kind of result: deflection and speed
        at the outputs (the largest of all outputs), means and mean squares.
    """
    if solver.structure.orbit != "transient" or not varying:
        return 0.0
    order = 2 if solver.accuracy.order_8 else 1
    ours, finer_ones = (_by_each(one, varying, order) for one in (solver, finer_than(solver)))
    most = max(_FEWEST_RUNS, min(_MOST_RUNS, _MOST_STEPS // solver.timeline.steps))
    chosen = np.unique(np.linspace(0, given.shape[1] - 1, most).round().astype(int))
    worst = 0.0
    for p in given.T[chosen]:
        try:
            found = difference_of_jets(solver, p, ours(p), finer_ones(p), first)
        except RuntimeError:  # no end of the finer integration
            return math.inf
        if not math.isfinite(found):
            return math.inf
        worst = max(worst, found)
    return worst


def _by_each(solver: Integration, varying: tuple[int, ...], order: int) -> Callable[[Vector], Vector]:
    """Return parameters -> results with derivatives by relative changes of each parameter, and of each pair."""
    jet = jets_of(solver, varying, order)

    def found(p: Vector) -> Vector:
        scales = [p[position] for position in varying]
        both = [a * b for k, a in enumerate(scales) for b in scales[k:]] if order == 2 else []
        columns: Vector = np.asarray(jet(p)) * np.array([1.0, *scales, *both])
        return columns

    return found


def finer_than(solver: Integration) -> Integration:
    """Return what checks an integration: more steps, or a tighter tolerance."""
    if solver.accuracy.order_8:
        # Outputs at which steps end may call for more than were asked for.
        timeline = replace(solver.timeline, steps=math.ceil(_FINER * (len(solver.timeline.nodes) - 1)))
        return integration(solver.structure, solver.accuracy, timeline)
    if solver.accuracy.tolerance is not None:
        return integration(solver.structure, finer(solver.accuracy), solver.timeline)
    # CasADi's fixed-step methods take as many whole steps in each output interval.
    outputs = solver.timeline.outputs
    steps = outputs * math.ceil(_FINER * solver.timeline.steps / outputs)
    timeline = replace(solver.timeline, steps=steps)
    return integration(solver.structure, replace(solver.accuracy, steps=steps), timeline)


def difference_of_jets(solver: Integration, p: Vector, used: Vector, better: Vector, asked: int) -> float:
    """Return the largest relative difference of two jets with a row for each result, from the first asked for on.

    Args:
        solver: what the jets are of.
        p: the parameters, the duration last.
        used: results, with their derivatives by relative changes of the parameters as columns.
        better: the same, closer to the truth.
        asked: number of the first result that matters.
    """
    observed = signals(solver.structure)
    # A parameter that nothing in the equation needs moves nothing, and counts as zero here.
    known = dict.fromkeys(solver.structure.names, 0.0) | dict(zip(solver.names, map(float, p), strict=False))
    averages = len(better) - observed.count - observed.squared
    states = solver.function.size1_out(0)
    first = abs(float(start_deflection(solver.structure, known)))
    size = np.max(np.abs(better), axis=1)
    sizes = np.zeros(len(size))
    # Deflections are counted from the start's.
    for k, least in enumerate((first, known["tow_speed"])):
        sizes[k:averages:states] = max(least, float(np.max(size[k:averages:states])))
    means = [first, known["stiffness"] * first][: observed.squared]
    mean, square = averages, averages + observed.count
    sizes[mean:square] = size[mean:square]
    for k, least in enumerate(means):
        sizes[mean + k] = max(least, sizes[mean + k])
        sizes[square + k] = max((_LEAST_SWING * sizes[mean + k]) ** 2, size[square + k])
    # Modes and what only counts have no derivatives.
    compared = np.r_[np.arange(averages) % states < 2, np.ones(observed.count + observed.squared, dtype=bool)]
    compared &= (sizes > 0.0) & (np.arange(len(sizes)) >= asked)
    wrong = np.max(np.abs(used - better), axis=1)[compared] / sizes[compared]
    return float(np.max(wrong, initial=0.0))
