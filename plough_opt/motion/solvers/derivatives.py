"""First and second derivatives of runs by their parameters, and the error of such derivatives.

A run enters a design through a handful of parameters (inertia, stiffness, static resistance, drag). Its jet is the
column of its results with their first and second derivatives by these. Carrying the jet of the state along, step by
step, costs a small multiple of the run itself and needs the graph of one step only. Differentiating the whole run
inside the optimiser's graph gives the same numbers for several times the time and memory.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import in_machine_code
from plough_opt.motion.equation import Equation
from plough_opt.motion.methods import DOP853
from plough_opt.motion.solvers.integrators import Integration, integration
from plough_opt.motion.solvers.orbit import orbit_start
from plough_opt.motion.solvers.plan import finer
from plough_opt.motion.solvers.steps import (
    Timeline,
    at_outputs,
    pairs,
    pooled,
    product,
    ramp_of,
    run_from,
    spans_of,
    step_symbols,
)

Vector = NDArray[np.float64]
_Symbols = TypeVar("_Symbols", ca.SX, ca.MX)
# Runs whose derivatives are checked, out of all that were given: as many as take this number of steps together, which
# is a second, but within these limits. If all runs take more, their steps are compiled, which takes a second, too.
_MOST_CHECKED_STEPS = 10_000


def weighted_curvature(integration: Integration, varying: tuple[int, ...]) -> ca.Function:
    """Return (parameters, weights) -> second derivatives of the weighted sum of the results by the varying parameters.

    The derivatives are forward over adjoint, the only order that CasADi supports through events.
    """
    p, shift, results = _shifted(integration, varying)
    weights = ca.MX.sym("weights", results.numel())
    hessian, _ = ca.hessian(ca.dot(weights, results), shift)
    whole = ca.Function("whole", [p, shift, weights], [ca.densify(hessian)])
    return ca.Function("curvature", [p, weights], [whole(p, ca.DM.zeros(len(varying)), weights)])


def _shifted(integration: Integration, varying: tuple[int, ...]) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return symbols of the parameters, symbols of shifts of the varying ones, and the stacked results with both."""
    p = ca.MX.sym("p", integration.function.numel_in(0))
    shift = ca.MX.sym("shift", len(varying))
    chosen = ca.DM(p.numel(), len(varying))
    for column, position in enumerate(varying):
        chosen[position, column] = 1.0
    results = integration.function.call([p + ca.mtimes(chosen, shift)])
    return p, shift, ca.vertcat(*map(ca.vec, results))


def jets_of(integration: Integration, varying: tuple[int, ...], order: int, *, compiled: bool = False) -> ca.Function:
    """Return the jet of any integration: carried along by steps of order 8, otherwise by differentiating the run."""
    if integration.structure.orbit != "transient":
        return _orbit_jets(integration.equation, integration.timeline, varying, order)
    if integration.accuracy.order_8:
        return jets(integration.equation, integration.timeline, varying, order, compiled=compiled)
    p, shift, results = _shifted(integration, varying)
    whole = ca.Function("whole", [p, shift], [ca.densify(_taylor(results, shift, order))])
    return ca.Function("jets", [p], [whole(p, ca.DM.zeros(len(varying)))])


def _taylor(y: _Symbols, e: _Symbols, order: int) -> _Symbols:
    """Return a column and its derivatives by e, as columns: its jet where e is 0."""
    slopes = ca.jacobian(y, e)
    bends = [ca.jacobian(slopes[:, a], e)[:, a:] for a in range(e.numel())] if order == 2 else []
    columns: _Symbols = ca.horzcat(y, slopes, *bends)
    return columns


@lru_cache(maxsize=64)
def jets(
    equation: Equation, timeline: Timeline, varying: tuple[int, ...], order: int, *, compiled: bool = False
) -> ca.Function:
    """Return the Function of a run's jet, by steps of order 8.

    Args:
        equation: the equation of motion.
        timeline: steps and outputs.
        varying: positions of the parameters to differentiate by; the duration is the last parameter.
        order: 1 for first derivatives, 2 for second derivatives too.
        compiled: whether to translate a step into machine code if there is a compiler.

    Returns:
        Function of the parameters. Its result has a row for each number of the run (the results of `run_map`, stacked:
        states output by output, means, variances). Its columns are the values, the first derivatives and, with order 2,
        the second derivatives of `pairs`.
    """
    p = ca.MX.sym("p", len(equation.names) + 1)
    first, ramp_part = _at_start(equation, varying, order)(p)
    whole = _jets_from(equation, timeline, varying, order, compiled)(first, ramp_part, p)
    return ca.Function("jets", [p], [whole])


@lru_cache(maxsize=64)
def _jets_from(
    equation: Equation, timeline: Timeline, varying: tuple[int, ...], order: int, compiled: bool
) -> ca.Function:
    """Return (jets of the state at time 0 and of the ramp's part of the duration, parameters) -> result of `jets`."""
    (p, _), count = equation.symbols(ca.MX), len(varying)
    ramp = ramp_of(timeline, equation, p)
    spans = spans_of(timeline, p[-1], ramp)
    steps, width = spans.shape[1], _width(count, order)
    first, ramp_part = ca.MX.sym("first", 2, width), ca.MX.sym("ramp_part", 1, width)
    one = _jet_step(equation, varying, order, spans.shape[0], compiled)
    states, moments = one.mapaccum(steps)(first, spans, ca.repmat(p, 1, steps))
    averages = pooled(moments, spans, equation.count, count, ramp_part if timeline.moving else None)
    # Rows of w and below them of w', each with a row for each column of the jet.
    places = [*range(0, 2 * width, 2), *range(1, 2 * width, 2)]
    paths = ca.horzcat(ca.vec(first), ca.reshape(states, 2 * width, steps))[places, :]
    is_duration = [position == p.numel() - 1 for position in varying]
    read = _read(timeline, paths, (p[-1], ramp), is_duration)
    return ca.Function("jets_from", [first, ramp_part, p], [ca.vertcat(read, *averages)])


@lru_cache(maxsize=64)
def _orbit_jets(equation: Equation, timeline: Timeline, varying: tuple[int, ...], order: int) -> ca.Function:
    """Return the same as `jets` for a periodic orbit, whose start moves with the parameters.

    A period maps the start x0 to itself: by the implicit function theorem its derivatives of each order are those of
    the state after the period with this order of x0 left out, times (1 - M)^-1 with the monodromy matrix M. What was
    left out then enters every result by the slopes of the results by x0.
    """
    p, first, count = ca.MX.sym("p", len(equation.names) + 1), ca.MX.sym("first", 2), len(varying)
    results = ca.vertcat(*map(ca.vec, run_from(equation, timeline)(first, p)))
    by_first = ca.Function("by_first", [first, p], [ca.densify(ca.jacobian(results, first))])
    start = orbit_start(equation, timeline)(p)
    slopes, end = by_first(start, p), slice(2 * timeline.outputs, 2 * timeline.outputs + 2)
    jet, width = start, 1
    for each in range(1, order + 1):
        unfinished = ca.horzcat(jet, ca.MX.zeros(2, _width(count, each) - width))
        whole = _jets_from(equation, timeline, varying, each, False)(unfinished, 0.0, p)
        added = ca.solve(ca.MX.eye(2) - slopes[end, :], whole[end, width:])
        jet, width, before = ca.horzcat(jet, added), unfinished.shape[1], width
    result = ca.horzcat(whole[:, :before], whole[:, before:] + slopes @ added)
    return ca.Function("orbit_jets", [p], [result])


def _read(timeline: Timeline, paths: ca.MX, times: tuple[ca.MX, Any], is_duration: list[bool]) -> ca.MX:
    """Return the jets of the states at the outputs, output by output, from those at the ends of the steps.

    Args:
        timeline: steps and outputs.
        paths: jets of w and below them of w', a column for each end.
        times: duration of the run [s], and time of a ramp [s] whose end divides a step.
        is_duration: whether each varying parameter is the duration, on which the interpolation depends.
    """
    duration, width = times[0], paths.shape[0] // 2
    found = at_outputs(timeline, paths, *times)
    found = ca.reshape(found, width, 2 * found.shape[1]).T
    if timeline.aligned or not any(is_duration):
        return found
    read, path = ca.horzsplit(found), [paths[[k, width + k], :] for k in range(width)]
    time, one = ca.MX.sym("time"), ca.MX.sym("path", *path[0].shape)
    once = ca.jacobian(ca.vec(at_outputs(timeline, one, time)), time)
    slope, bend = (ca.Function("by_duration", [one, time], [by]) for by in (once, ca.jacobian(once, time)))
    count = len(is_duration)
    for a in range(count):
        if is_duration[a]:
            read[1 + a] += slope(path[0], duration)
    for column, (a, b) in enumerate(pairs(count) if width > 1 + count else [], start=1 + count):
        for this, other in ((a, b), (b, a)):
            if is_duration[this]:
                read[column] += slope(path[1 + other], duration)
        if is_duration[a] and is_duration[b]:
            read[column] += bend(path[0], duration)
    return ca.horzcat(*read)


def _at_start(equation: Equation, varying: tuple[int, ...], order: int) -> ca.Function:
    """Return parameters -> jets of the state at time 0 and of the ramp's part of the duration, 0 without a ramp."""
    p, e = ca.SX.sym("p", len(equation.names) + 1), ca.SX.sym("e", len(varying))
    shifted = ca.SX(p)
    shifted[list(varying)] = p[list(varying)] + e
    known = equation.named(shifted)
    values = equation.structure.start_state(known), known.get("ramp_time", 0.0) / shifted[-1]
    jets = [_taylor(ca.densify(ca.SX(value)), e, order) for value in values]  # type: ignore[arg-type]
    return ca.Function("at_start", [p], [ca.densify(ca.substitute(jet, e, ca.SX.zeros(e.numel()))) for jet in jets])


@lru_cache(maxsize=64)
def _jet_step(equation: Equation, varying: tuple[int, ...], order: int, rows: int, compiled: bool) -> ca.Function:
    """Return one step: (jet of the state, span, parameters) -> (jet of the state after it, jet of the moments).

    The derivatives solve the equation of motion expanded at every stage. Differentiating the whole step by CasADi gives
    the same numbers and mostly takes as many operations; under smooth contact it takes a third more, and its
    graph takes two to five times as long to build.

    Args:
        equation: the equation of motion.
        varying: positions of the parameters to differentiate by.
        order: of the derivatives.
        rows: of the span.
        compiled: whether to translate it into machine code, some ten times as fast, if there is a compiler.
    """
    count, (span, p, start, size) = len(varying), step_symbols(equation, rows)
    jet = ca.SX.sym("jet", 2, _width(count, order))
    # Derivatives of the step's start and size: zero unless duration or ramp vary.
    lateness, lengthening = (ca.jacobian(time, p[list(varying)]) for time in (start, size))

    def moved(weights: Sequence[float], rates: Sequence[ca.SX]) -> ca.SX:
        """Return the jet of the state after a part of the step, from the jets of the rates at the stages."""
        used = [(weight, rate) for weight, rate in zip(weights, rates, strict=False) if weight != 0.0]
        shares = ca.DM([weight for weight, _ in used])
        columns = ca.horzcat(ca.vec(jet), *(rate for _, rate in used))
        following = ca.reshape(ca.mtimes(columns, ca.vertcat(1.0, size * shares)), jet.shape)
        if not lengthening.nnz() or not used:
            return following
        rate = ca.reshape(ca.mtimes(columns[:, 1:], shares), jet.shape)
        following[:, 1 : 1 + count] += ca.mtimes(rate[:, 0], lengthening)
        for column, (a, b) in enumerate(pairs(count) if order == 2 else [], start=1 + count):
            following[:, column] += lengthening[a] * rate[:, 1 + b] + lengthening[b] * rate[:, 1 + a]
        return following

    # With the symbols of the step, so that all stages share what depends on the parameters alone.
    at = _expanded(equation, varying, order, p)
    _, first, _ = at(ca.horzcat(start, lateness), jet, 0.0, p)
    found: list[list[ca.SX]] = []
    for row, node in zip(DOP853.stages, DOP853.nodes, strict=True):
        time = ca.horzcat(start + node * size, lateness + node * lengthening)
        found.append(at.call([time, moved(row, [rate for rate, _, _ in found]), first, p]))
    rates, changes, squares = zip(*found, strict=True)
    mean, square = (
        ca.reshape(ca.mtimes(ca.horzcat(*columns), ca.DM(DOP853.weights)), -1, jet.shape[1])
        for columns in (changes, squares)
    )
    spread = square - _square(mean[: equation.squared, :], count)
    moments = ca.vertcat(ca.reshape(first, mean.shape) + mean, spread)
    step = ca.Function("jet_step", [jet, span, p], [ca.densify(moved(DOP853.weights, rates)), ca.densify(moments)])
    # -O2 takes the compiler 1.6 times as long for a step that is a third faster.
    return ((compiled and in_machine_code([step], ((("-O1",), ("-lm",)),))) or [step])[0]


def _expanded(equation: Equation, varying: tuple[int, ...], order: int, p: ca.SX) -> ca.Function:
    """Return the equation of motion and the signals, expanded to jets.

    Args:
        equation: the equation of motion.
        varying: positions of the parameters to differentiate by.
        order: of the derivatives.
        p: symbol of the parameters, the duration last.

    Returns:
        Function of the time [s] with its derivatives, the jet of the state, the stacked jet of the signals at the start
        of the step, and the parameters. It returns the stacked jets of the rate of the state, of the changes
        of the signals since the start of the step, and of the squares of these.
    """
    count = len(varying)
    moment, jet = ca.SX.sym("moment", 1, 1 + count), ca.SX.sym("jet", 2, _width(count, order))
    first = ca.SX.sym("first", equation.count, jet.shape[1])
    parameters, e = p[:-1], p[list(varying)]
    time, state = moment[0], jet[:, 0]
    value = ca.vertcat(equation.rate(time, state, parameters), equation.signals(time, state, parameters))
    given = ca.vertcat(time, state, e)
    slopes = ca.vertcat(moment[1:], jet[:, 1 : 1 + count], ca.SX.eye(count))
    columns = [value, ca.mtimes(ca.jacobian(value, given), slopes)]
    if order == 2:
        bends = [ca.mtimes([slopes.T, ca.hessian(row, given)[0], slopes]) for row in ca.vertsplit(value)]
        bent = ca.vertcat(*(ca.horzcat(*(bend[a, b] for a, b in pairs(count))) for bend in bends))
        columns.append(bent + ca.mtimes(ca.jacobian(value, state), jet[:, 1 + count :]))
    rate, now = ca.vertsplit(ca.cse([ca.horzcat(*columns)])[0], [0, 2, 2 + equation.count])
    results = rate, now - first, _square((now - first)[: equation.squared, :], count)
    stacked = [ca.densify(ca.vec(result)) for result in results]
    return ca.Function("expanded", [moment, jet, ca.vec(first), p], stacked)


def _square(jet: ca.SX, count: int) -> ca.SX:
    """Return the jets of squared quantities, whose jets by ``count`` parameters are rows."""
    columns = ca.horzsplit(jet)
    squares: ca.SX = ca.horzcat(*product(columns, columns, count))
    return squares


def _width(count: int, order: int) -> int:
    """Return the number of columns of a jet by ``count`` parameters."""
    return 1 + count + (len(pairs(count)) if order == 2 else 0)


def derivative_error(solver: Integration, first: int, varying: tuple[int, ...], given: Vector) -> float:
    """Return the largest error of the first and second derivatives of runs, by a finer integration of some of them.

    Derivatives are by relative changes of the parameters, second ones by all pairs of these. The finer integration has
    twice the steps, or a tenth of the tolerance. Through events only first derivatives are compared, because
    second ones take as long as a solve.

    Args:
        solver: integrates the runs.
        first: number of the first result that matters.
        varying: positions of the parameters to differentiate by.
        given: the parameters, the duration last; a column for each run.

    Returns:
        The error [-] relative to the largest of value, first and second derivatives of each kind of result: deflection
        and speed (the largest of all outputs), means, and mean squares. It is infinite if the finer integration fails.
    """
    if not varying:
        return 0.0
    order = 2 if solver.accuracy.order_8 else 1
    many = solver.timeline.steps * given.shape[1] > _MOST_CHECKED_STEPS
    both = [jets_of(one, varying, order, compiled=many) for one in (solver, finer_than(solver))]
    most = max(2, min(8, _MOST_CHECKED_STEPS // solver.timeline.steps))
    chosen = np.unique(np.linspace(0, given.shape[1] - 1, most).round().astype(int))
    worst = 0.0
    for p in given.T[chosen]:
        scales = [p[position] for position in varying]
        pairs = [a * b for k, a in enumerate(scales) for b in scales[k:]] if order == 2 else []
        try:
            ours, better = (np.asarray(jet(p)) * np.array([1.0, *scales, *pairs]) for jet in both)
            found = difference_of_jets(solver, p, ours, better, first)
        except RuntimeError:  # the finer integration does not reach the end
            return math.inf
        if not math.isfinite(found):
            return math.inf
        worst = max(worst, found)
    return worst


def finer_than(solver: Integration) -> Integration:
    """Return the same integration with twice the steps or a tenth of the tolerance, which checks it."""
    if solver.accuracy.tolerance is not None:
        return integration(solver.structure, finer(solver.accuracy), solver.timeline)
    accuracy = solver.accuracy if solver.accuracy.order_8 else finer(solver.accuracy)
    # Steps that end at the outputs may be more than were requested.
    steps = 2 * (len(solver.timeline.nodes) - 1 if accuracy.order_8 else solver.timeline.steps)
    return integration(solver.structure, accuracy, replace(solver.timeline, steps=steps))


def difference_of_jets(solver: Integration, p: Vector, used: Vector, better: Vector, wanted: int) -> float:
    """Return the largest relative difference of two jets: see `derivative_error`.

    Args:
        solver: the integration whose results they are.
        p: the parameters, the duration last.
        used: jet by relative changes of the parameters, a row for each result.
        better: a more accurate jet.
        wanted: number of the first result that matters.
    """
    equation = solver.equation
    # A parameter that does not occur in the equation has no influence and may count as 0.
    known = dict.fromkeys(solver.structure.names, 0.0) | dict(zip(solver.names, map(float, p), strict=False))
    averages = len(better) - equation.averages
    states = solver.function.size1_out(0)
    first = abs(float(solver.structure.start_deflection(known)))
    size = np.max(np.abs(better), axis=1)
    sizes = np.zeros(len(size))
    # Deflections are counted from the start's.
    for k, least in enumerate((first, known["tow_speed"])):
        sizes[k:averages:states] = max(least, float(np.max(size[k:averages:states])))
    means = [first, known["stiffness"] * first][: equation.squared]
    mean, square = averages, averages + equation.count
    sizes[mean:square] = size[mean:square]
    for k, least in enumerate(means):
        sizes[mean + k] = max(least, sizes[mean + k])
        # An RMS below this part of the mean counts as that part, because a smaller oscillation is rounding.
        sizes[square + k] = max((1e-3 * sizes[mean + k]) ** 2, size[square + k])
    # The states after the first two, such as the mode, have no derivatives.
    compared = np.r_[np.arange(averages) % states < 2, np.ones(equation.averages, dtype=bool)]
    compared &= (sizes > 0.0) & (np.arange(len(sizes)) >= wanted)
    wrong = np.max(np.abs(used - better), axis=1)[compared] / sizes[compared]
    return float(np.max(wrong, initial=0.0))
