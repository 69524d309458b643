"""Steps of order 8 in machine code, for a vector register of runs at a time; without a compiler CasADi interprets them.

A single run takes the steps of its timeline, and its outputs are read like those of the interpreted run. A search needs
output states and averages of thousands of designs, but only roughly: `ManyRuns` gives each its own number of steps, and
outputs are read from the polynomial of degree 5 through deflection, rate and acceleration at both ends of a step.
Periodic orbits are found by Newton's method on the map of one period, with three runs side by side for each design.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from string import Template

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import Statements, by_rows, loaded, variants
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import maximum, stacked
from plough_opt.core.files import text_of
from plough_opt.motion.equation import Equation, Structure, equation_of
from plough_opt.motion.solvers.orbit import near_orbit, returning
from plough_opt.motion.solvers.plan import rates
from plough_opt.motion.solvers.steps import READ_FROM, Timeline, readings, run_from, step

Array = NDArray[np.float64]

COARSE_PHASE = 2.6
"""Phase of a step by `Rates.summed` [rad]; averages then have errors of about 1e-5 of the oscillation."""

COARSE_PHASE_READ = 1.6
"""The same if outputs are read within steps, by a polynomial of lower order than the method."""

# Such steps lose a part of the amplitude of a free oscillation, 3e-5 per rad. For a towed share without a damper it is
# 12 % of the RMS force after 4000 rad. If the free oscillation lasts longer than this phase [rad], a run takes shorter
# steps, so that the loss stays below about 5e-3, and below 1e-5 with twice as many steps.
_LASTING_PHASE = 70.0
# The loss per rad grows with this power of the step size.
_LOSS_ORDER = 9.0

# -O3 doubles the time of compilation and does not speed up the runs.
_STEPS_VARIANTS = variants("-O2")
FEWEST_COARSE_STEPS = 16
# A run that needs more than this number, before any refinement, is not integrated.
_MOST_COARSE_STEPS = 20_000
# Doubles in two of the widest vector registers.
_WIDEST = 16
# Runs that one thread integrates at once: enough to fill vector registers many times, with little memory.
_RUNS_AT_ONCE = 1024
# Row of `in` that has the number of steps.
_STEPS = -3

# Results of `Equation.outputs`.
_ROWS = 5


@dataclass(frozen=True)
class CompiledSteps:
    """Integration of an equation by steps of order 8 in machine code."""

    equation: Equation
    library: ctypes.CDLL

    def __call__(self, timeline: Timeline, p: Sequence[float]) -> tuple[Array, Array, Array] | None:
        """Return the states at the outputs (a row each), means and mean squares; None if any is not finite.

        Args:
            timeline: steps and outputs, not aligned.
            p: the equation's parameters with the duration last.
        """
        (found,) = self.integrate(np.array(self._given(p, timeline)), timeline.outputs, (timeline,))
        if not np.isfinite(found).all():
            return None
        states = 2 * timeline.outputs + 2
        averages = states + self.equation.count
        return found[:states].reshape(-1, 2), found[states:averages], found[averages:]

    def both(
        self, timelines: tuple[Timeline, Timeline], p: Sequence[float], known: Sequence[float]
    ) -> tuple[Array, Array, Array] | None:
        """Return the results of a run and of its check; None if any is not finite.

        Args:
            timelines: of the run and of its check, not aligned.
            p: the equation's parameters with the duration last.
            known: the parameters of `Equation.outputs`.

        Returns:
            The run's outputs, a row for each of `Equation.outputs`; the largest magnitudes and the largest differences
            of these, a row each; means and mean squares of the run and of the check, a row each.
        """
        outputs, averages = timelines[0].outputs, self.equation.averages
        given, (tables, _) = [*self._given(p, *timelines), *known], _tables(timelines)
        work = np.empty(len(given) + _room(given[len(p) + 2]) + 4 * (outputs + 1) + 2 * averages)
        work[: len(given)] = given
        count, at = _ROWS * (outputs + 1), work.ctypes.data
        found = np.empty(count + 2 * (averages + _ROWS))
        sound = self.library.pair(at, outputs, *tables, at + work.itemsize * len(given), found.ctypes.data)
        rows, ends = found[:count].reshape(_ROWS, -1), found[count:].reshape(2, -1)
        return (rows, ends[:, averages:], ends[:, :averages]) if sound else None

    def integrate(self, given: Array, outputs: int, timelines: tuple[Timeline, ...] = ()) -> Array:
        """Return the results of runs, a row each.

        Args:
            given: the array `in` of `steps.c`.
            outputs: number of intervals between output times; 0 for averages only.
            timelines: the steps of each run of one scene; if they are missing, the runs are those of ``given``.
        """
        count = len(timelines) or given.shape[1]
        results = np.empty((count, (2 * (outputs + 1) if outputs else 0) + self.equation.averages))
        memory, (tables, _) = np.empty(_room(np.max(given[_STEPS]))), _tables(timelines)
        self.library.steps(count, given.ctypes.data, outputs, *tables, memory.ctypes.data, results.ctypes.data)
        return results

    def _given(self, p: Sequence[float], *timelines: Timeline) -> list[float]:
        """Return the array `in` of `steps.c` for runs of one scene from its start."""
        rate = float(self.equation.structure.start_rate(dict(zip(self.equation.names, p, strict=False))))
        most = max(len(timeline.nodes) for timeline in timelines) - 1.0
        return [0.0, rate, *p, most, 0.0, 0.0]


def _room(most: float) -> int:
    """Return the number of doubles in the array `memory` of `steps.c`, from the largest number of steps."""
    return (5 * int(most) + 2 * READ_FROM) * _WIDEST


@lru_cache(maxsize=64)
def _tables(timelines: tuple[Timeline, ...]) -> tuple[list[int | None], list[Array]]:
    """Return the addresses of `times`, `from` and `weight` of `steps.c`, NULL without timelines, and these arrays."""
    if not timelines:
        return [None] * 3, []
    times = np.ones((max(len(timeline.nodes) for timeline in timelines), len(timelines)))
    for k, timeline in enumerate(timelines):
        times[: len(timeline.nodes), k] = timeline.nodes
    first, weights = zip(*((each.ends[:, 0], each.weights) for each in map(readings, timelines)), strict=True)
    arrays = [times, np.array(first), np.ascontiguousarray(np.array(weights).transpose(0, 1, 3, 4, 2))]
    return [array.ctypes.data for array in arrays], arrays


@lru_cache(maxsize=64)
def compiled_steps(structure: Structure, registers: int = 1) -> CompiledSteps | None:
    """Return a structure's steps in machine code, compiled or from the user's cache, for so many registers at once.

    Without a compiler, or if an own effect has an operation without a vector form, the result is None.
    """
    whole, address = ctypes.c_int64, ctypes.c_void_p
    arguments = {"steps": [whole, address, whole, *[address] * 5], "pair": [address, whole, *[address] * 5]}
    try:
        library = loaded(f"#define REGISTERS {registers}\n" + source_of(structure), _STEPS_VARIANTS, arguments)
    except InputError:
        return None
    return None if library is None else CompiledSteps(equation_of(structure), library)


def source_of(structure: Structure) -> str:
    """Return the C source of a structure's steps.

    Raises:
        InputError: an own effect has an operation without a vector form.
    """
    equation = equation_of(structure)
    (p, _), state, span = equation.symbols(ca.SX), ca.SX.sym("state", 2), ca.SX.sym("span", 2)
    following, moments = step(equation)(state, span, p)
    acceleration = equation.rate(span[0] * p[-1], state, p[:-1])[1]
    result = ca.cse(ca.densify(ca.vertcat(following, acceleration, moments)))
    one = Statements(ca.Function("advance", [state, span, p], [result]), ("x", "s", "p"))
    names, outputs = equation.outputs
    observed = Statements(outputs, ("x", "p"))
    source = Template(text_of("plough_opt.core", "steps.c")).substitute(
        given=p.numel(),
        width=result.numel(),
        count=equation.count,
        squared=equation.squared,
        ends=READ_FROM,
        once="\n".join(one.once),
        each="\n".join(one.each),
        known=len(names),
        rows=_ROWS,
        observed_once="\n".join(observed.once),
        observed_each="\n".join(observed.each),
    )
    return text_of("plough_opt.core", "vectors.c") + source


@lru_cache(maxsize=64)
def _planned(equation: Equation, phase: float) -> Callable[..., list[Array]]:
    """Return what is known of runs before they are integrated, from their parameters, a row for each run.

    Args:
        equation: the equation of motion.
        phase: of a step by `Rates.summed` [rad].

    Returns:
        Function of the parameters. Its results are the states at time 0, or near those of orbits; the units of states;
        and the number of steps by the phase alone beside the number that leaves a lasting oscillation its amplitude.
    """
    p, known = equation.symbols(ca.SX)
    found = rates(known, equation.structure.terms)
    coarse, lasting = found.summed * p[-1] / phase, found.lasting_phase(p[-1])
    shorter = maximum((lasting / _LASTING_PHASE) ** (1.0 / _LOSS_ORDER) * phase / COARSE_PHASE, 1.0)
    if equation.structure.orbit == "periodic":
        first, unit = near_orbit(equation).expand()(p)
    else:
        first, unit = equation.start(p[:-1]), ca.SX.ones(2)
    results = [first, unit, stacked(coarse, shorter * coarse)]
    return by_rows(ca.Function("planned", [p], [ca.densify(result) for result in results]))


class ManyRuns:
    """Runs of one structure, at very many parameters.

    Args:
        structure: of a motion that steps of fixed size can integrate from its start, or of a periodic orbit.
        outputs: number of intervals between output times; 0 if only averages are needed.

    Raises:
        InputError: an own effect has an operation without a vector form.
    """

    def __init__(self, structure: Structure, outputs: int) -> None:
        self._structure, self._outputs = structure, outputs
        self._equation = equation_of(structure)
        self._code = compiled_steps(structure, 2)
        if self._code is None:
            source_of(structure)  # raises the error if an operation is the cause
        self.planned = _planned(self._equation, COARSE_PHASE_READ if outputs else COARSE_PHASE)

    @property
    def size(self) -> int:
        """Number of results of a run: the states, output by output, the means, and the mean squares about them."""
        return (2 * (self._outputs + 1) if self._outputs else 0) + self._equation.averages

    @property
    def compiled(self) -> bool:
        """Whether machine code integrates the runs."""
        return self._code is not None

    def __call__(self, p: Array, *, finer: float = 1.0, together: int = 1, threads: int = 1) -> Array:
        """Return rough results, a row for each run; NaN if parameters are not finite, or too many steps are needed.

        Args:
            p: parameters of `plough_opt.motion.solvers.integrators.Integration`, the duration last; a row for each run.
            finer: factor on the number of steps.
            together: number of consecutive rows that take equally many steps, so that their results differ only because
                of their parameters. It divides the number of rows.
            threads: number of threads of machine code; the results do not depend on it.
        """
        first, unit, (coarse, needed) = (part.T for part in self.planned(p))
        # Whether a run is integrated does not depend on `finer`.
        steps = np.where(coarse <= _MOST_COARSE_STEPS, self.whole(finer * needed), np.nan)
        alike = np.fmax.reduce(steps.reshape(-1, together), axis=1).repeat(together)
        return self.integrate(p, first.T, unit.T, np.where(np.isnan(steps), np.nan, alike), threads)[0]

    def whole(self, steps: Array) -> Array:
        """Return numbers of steps rounded up: to powers of two without machine code, where equal ones run together."""
        least = np.maximum(steps, FEWEST_COARSE_STEPS)
        return np.ceil(least) if self.compiled else 2.0 ** np.ceil(np.log2(least))

    def integrate(self, p: Array, first: Array, unit: Array, steps: Array, threads: int = 1) -> tuple[Array, Array]:
        """Return the results, a row for each run, and the largest multipliers of orbits, NaN for other motions.

        The results are NaN if numbers of a run are not finite, or if no orbit is found.

        Args:
            p: parameters, a row for each run.
            first: states at time 0, or near those of orbits, a row for each run.
            unit: units of these states.
            steps: number of steps of each run.
            threads: number of threads of machine code.
        """
        results, largest = np.full((len(p), self.size), np.nan), np.full(len(p), np.nan)
        sound = np.flatnonzero(np.isfinite(steps) & np.isfinite(p).all(axis=1))
        # Runs in one register wait for the slowest of them.
        order = sound[np.argsort(steps[sound], kind="stable")]
        chunks = [order[k : k + _RUNS_AT_ONCE] for k in range(0, len(order), _RUNS_AT_ONCE)]

        def enter(chunk: NDArray[np.int64]) -> None:
            states, own, count = first[chunk], p[chunk], steps[chunk]
            if self._structure.orbit == "periodic":
                states, slopes = returning(
                    lambda which, tried: self._run(tried, own[which], count[which], 1)[:, 2:4], states, unit[chunk]
                )
                finite = np.where(np.isfinite(slopes), slopes, 0.0)
                largest[chunk] = np.abs(np.linalg.eigvals(finite)).max(axis=1)
            results[chunk] = self._run(states, own, count, self._outputs)

        if threads > 1 and len(chunks) > 1 and self.compiled:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(enter, chunks))
        else:
            list(map(enter, chunks))
        return results, largest

    def _run(self, first: Array, p: Array, steps: Array, outputs: int) -> Array:
        """Return the results of some runs, a row each.

        Args:
            first: states at time 0, a row for each run.
            p: parameters, the duration last; a row for each run.
            steps: number of steps of each run.
            outputs: number of intervals between output times; 0 for averages only.
        """
        if self._code is None:
            return self._interpret(first, p, steps, outputs)
        given = np.zeros((p.shape[1] + 5, len(p)))
        given[:2], given[2:_STEPS], given[_STEPS] = first.T, p.T, steps
        if self._structure.ramp:
            kink = p[:, self._equation.names.index("ramp_time")] / p[:, -1]
            given[_STEPS + 1], given[_STEPS + 2] = _before_kink(kink, steps)
        return self._code.integrate(given, outputs)

    def _interpret(self, first: Array, p: Array, steps: Array, outputs: int) -> Array:
        """Return the same by CasADi: the runs of each number of steps by one loop."""
        results = []
        for count in np.unique(steps):
            alike = np.flatnonzero(steps == count)
            timeline = Timeline(outputs or 1, int(count), moving=self._structure.ramp)
            run = run_from(self._equation, timeline).map(len(alike))
            states, *averages = (np.asarray(part).T for part in run(first[alike].T, p[alike].T))
            read = states.reshape(len(alike), -1) if outputs else np.empty((len(alike), 0))
            results.append(np.hstack([read, *averages]))
        order = np.argsort(steps, kind="stable")
        return np.concatenate(results)[np.argsort(order)]


def _before_kink(kink: Array, steps: Array) -> tuple[Array, Array]:
    """Return the number of steps up to the end of a tow ramp, and that end as a fraction of the duration.

    A ramp that ends within rounding of the end of the run, or later, makes no kink.
    """
    early = np.where(kink < 1.0 - 1e-9, np.minimum(np.ceil(kink * steps), steps - 1.0), 0.0)
    return early, np.where(early > 0.0, kink, 0.0)
