"""`Robust`: a design's results over common samples of its soil, the search by their measures, and fresh samples.

An optimum is fitted to the optimiser's samples, and looks better on them than it is. Samples that are drawn
independently, and that the optimiser did not use, show by how much: `verify`.
"""

import copy
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from scipy import stats

from plough_opt.core.checks import check_choice, check_kind, check_named, plain_number, whole_number
from plough_opt.core.errors import InfeasibleDesign, InputError, NotConverged, printable
from plough_opt.core.expressions import ByValue, Column, Expression, as_number, is_casadi
from plough_opt.core.plain_data import Array
from plough_opt.core.process import without_notices
from plough_opt.core.saving import Origin
from plough_opt.core.tables import Grid, Page, Readable
from plough_opt.design import Design, LocalOptimum, Optimum, Progress
from plough_opt.design.model.program import Program
from plough_opt.design.search.effort import AUTO_SECONDS, TimeLimit
from plough_opt.design.solving import Known, Request, solve_program
from plough_opt.studies.uncertainty import measures
from plough_opt.studies.uncertainty.distribution import Response, Responses, SoilDistribution, SoilSamples

Kind = Literal["mean", "largest", "smallest", "probability"]
Tail = Literal["upper", "lower"]

# Widths follow spreads of results. They have settled when no spread changes by more than this part.
_SETTLED = 0.02
# Limit on the number of times that the widths of one optimum are set anew.
_MOST_ROUNDS = 6
# Local optima within this part of the best objective are solved with their own widths: they may then become the best.
_CAN_WIN = 0.02
# Two designs count as the same if no variable differs by more than this part of its value.
_SAME_VARIABLES = 1e-3
# Tail of a distribution -> its worst value.
_WORST: Mapping[Tail, Kind] = {"upper": "largest", "lower": "smallest"}


@dataclass(frozen=True)
class RequestedMeasure:
    """A measure that a design uses, and `verify` checks.

    Attributes:
        result: name of its result.
        text: the measure in words.
        kind: how it is verified on fresh samples.
        exact: values of the samples -> measure, exact unless ``width`` is given.
        width: width over which it is smoothed, in the unit of the values; 0 if it is not.
    """

    result: str
    text: str
    kind: Kind
    exact: Callable[..., Column]
    width: Expression = 0.0

    def __post_init__(self) -> None:
        if not is_casadi(self.width):
            plain_number("width", self.width)

    def smoothed(self, values: Column) -> Expression:
        """Return the measure of the values of samples, smoothed as in the optimisation."""
        smooth = is_casadi(self.width) or bool(self.width)
        value: Expression = self.exact(values, width=self.width) if smooth else self.exact(values)
        return value


class Robust(Readable):
    """The results of a design over common samples of its soil.

    For example::

        def response(soil):
            scene = po.Scene(soil, share, k0, mass, 2.0, effects)
            return {"draft": po.simulate(scene, 2.0).mean_draft, "radius": scene.loosened_radius}

        robust = po.Robust(field, response, samples=64, seed=1)
        d.minimise(robust.cvar("draft", 0.9, width=200.0) / 1e3)
        d.require("radius", robust.probability("radius", at_least=0.15, width=0.004), at_least=0.95)
        best = d.solve()
        print(po.uncertainty.verify(robust, best))

    All samples are in one program: their runs share one integrator, which is mapped over them. Each measure is an
    expression for the design to use, and is recorded for `verify`.

    Args:
        field: the distribution of the soil.
        response: soil -> results by name, each a scalar expression of the design.
        samples: number of samples, drawn by `SoilDistribution.sample`; or samples, such as the distribution's corners.
        seed: seed of the samples.

    Raises:
        InputError: the response does not return scalars by name, or the number of samples is invalid.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> cone = po.Cone("10 deg", "25 cm")
        >>> robust = po.Robust(field, lambda soil: {"radius": po.loosened_radius(cone, soil)}, samples=8)
        >>> len(robust.samples)
        8
    """

    def __init__(
        self, field: SoilDistribution, response: Response, *, samples: int | SoilSamples = 64, seed: int = 1
    ) -> None:
        check_kind("the field", field, SoilDistribution, "a SoilDistribution")
        self.field = field
        self.samples = samples if isinstance(samples, SoilSamples) else field.sample(samples, seed=seed)
        if self.samples.names != field.names:
            raise InputError(f"the samples have the properties {self.samples.names}, the distribution {field.names}")
        self.response = response
        self.seed = seed
        self.columns: Mapping[str, Expression] = self.samples.each(response)
        self.requested: list[RequestedMeasure] = []

    def page(self) -> Page:
        """Return the results, the uncertain soil, and the requested measures.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> robust.page().heading
            'draft over 8 samples of cohesion 1.5e+04 +- 2.9e+03'
        """
        table = Grid.of("", "result", "measure", left=("measure",))
        for measure in self.requested:
            table.row(measure.result, measure.text)
        heading = f"{', '.join(self.columns)} over {len(self.samples)} samples of {self.field.in_words()}"
        return Page(heading, (table,) if table.rows else ("No measure has been requested yet.",))

    def __getitem__(self, name: str) -> Expression:
        """Return a result as a column over the samples; a requirement on it must hold for every sample."""
        check_named("{} is not a result of the response", name, self.columns)
        return self.columns[name]

    def expected(self, name: str) -> Expression:
        """Return the mean of a result.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> round(float(robust.expected("draft")), -2)
            2000.0
        """
        return self._request(name, "mean", "mean", measures.expected)

    def mean_plus(self, name: str, kappa: float) -> Expression:
        """Return mean + kappa * standard deviation of a result.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> bool(robust.mean_plus("draft", 2.0) > robust.expected("draft"))
            True
        """
        kappa = plain_number("kappa", kappa)
        sign = "+" if kappa >= 0.0 else "-"
        text = f"mean {sign} {abs(kappa):g} standard deviations"
        return self._request(name, text, "mean", partial(measures.mean_plus, kappa=kappa))

    def cvar(self, name: str, level: float, *, width: Expression, tail: Tail = "upper") -> Expression:
        """Return the mean of a result over its worst samples, a fraction 1 - level of all: see `measures.cvar`.

        The worst are the largest, or with ``tail="lower"`` the smallest. A width may be a parameter of the design.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> bool(robust.cvar("draft", 0.75, width=10.0) > robust.expected("draft"))
            True
        """
        check_choice("tail", tail, tuple(_WORST))
        level = plain_number("the level of a CVaR", level)
        text = f"mean of the {_WORST[tail]} {100.0 * (1.0 - level):.4g} %"
        return self._request(name, text, "mean", _in_tail(partial(measures.cvar, level=level), tail), width)

    def worst(self, name: str, *, width: Expression, tail: Tail = "upper") -> Expression:
        """Return the largest value of a result over the samples, or the smallest: see `measures.worst`.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> bool(robust.worst("draft", width=10.0) > robust.expected("draft"))
            True
        """
        check_choice("tail", tail, tuple(_WORST))
        text = f"{_WORST[tail]} of the samples"
        return self._request(name, text, _WORST[tail], _in_tail(measures.worst, tail), width)

    def every(self, name: str, *, at_least: float | None = None, at_most: float | None = None) -> Expression:
        """Return a result as a column, to be required within limits; `verify` then estimates their probability.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> design.require("every draft", robust.every("draft", at_most=3e3), at_most=3e3, unit="N")
            >>> design.minimise(-height)
            >>> round(design.solve(search="near").variables["height"], 2)
            0.3
        """
        values = self[name]
        self.requested.append(_within(name, at_least, at_most, 0.0))
        return values

    def probability(
        self, name: str, *, at_least: float | None = None, at_most: float | None = None, width: Expression
    ) -> Expression:
        """Return the probability that a result is within limits: see `measures.probability`.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> cone = po.Cone("10 deg", "25 cm")
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> 0.0 < float(robust.probability("draft", at_most=float(robust.expected("draft")), width=10.0)) < 1.0
            True
        """
        return self._requested(_within(name, at_least, at_most, width))

    def require_probability(
        self,
        design: Design,
        requirement: str,
        name: str,
        probability: float,
        *,
        at_least: float | None = None,
        at_most: float | None = None,
        width: Expression,
        unit: str = "",
    ) -> None:
        """Require a result to keep one limit with a probability, by a requirement on its quantile.

        Args:
            design: the design that gets the requirement.
            requirement: name of the requirement in reports.
            name: name of the result.
            probability: the least probability, between 0 and 1.
            at_least: lower limit, or None.
            at_most: upper limit, or None.
            width: width of the smooth step: see `measures.probability`.
            unit: unit of the result, for reports.

        Raises:
            InputError: no limit, two limits, or an invalid probability.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> robust.require_probability(design, "draft", "draft", 0.9, at_most=3e3, width=20.0, unit="N")
            >>> design.minimise(-height)
            >>> round(design.solve(search="near").variables["height"], 2)
            0.3
        """
        check_kind("the design", design, Design, "a Design")
        if (at_least is None) == (at_most is None):
            raise InputError(f"'{requirement}': give one limit, at_least or at_most; two limits are two requirements")
        self.probability(name, at_least=at_least, at_most=at_most, width=width)
        measure = _in_tail(measures.quantile, "lower" if at_most is None else "upper")
        quantile = measure(self[name], level=probability, width=width)
        design.require(requirement, quantile, at_least=at_least, at_most=at_most, unit=unit)

    def bound_from_above(
        self, design: Design, name: str, *, lower: float, upper: float, guess: float | None = None, unit: str = ""
    ) -> Expression:
        """Return a new variable of the design that no value of a result exceeds; minimised, it is the largest value.

        The variable is named "worst NAME", and the requirement that bounds the values "NAME below its worst".

        Args:
            design: the design that gets the variable.
            name: name of the result.
            lower: lower bound of the variable.
            upper: upper bound of the variable.
            guess: guess of the variable; default: its upper bound.
            unit: unit of the result, for reports.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> worst = robust.bound_from_above(design, "draft", lower=0.0, upper=2e4, unit="N")
            >>> design.minimise(worst / 1e3)
            >>> round(design.solve(search="near").variables["height"], 6)
            0.1
        """
        check_kind("the design", design, Design, "a Design")
        values, start = self[name], upper if guess is None else guess
        bound = design.variable(f"worst {name}", guess=start, lower=lower, upper=upper, unit=unit)
        design.require(f"{name} below its worst", values - bound, at_most=0.0, unit=unit)
        self.requested.append(RequestedMeasure(name, "largest of the samples", "largest", measures.worst))
        return bound

    @cached_property
    def responses(self) -> Responses:
        """The response, compiled for numeric designs and samples."""
        return Responses(self.response, self.samples.soil, self.samples.names)

    def values(self, at: Optimum | Mapping[str, float], samples: SoilSamples | None = None) -> dict[str, Array]:
        """Return name -> values of each result over samples, by default the common ones.

        Args:
            at: an optimum, or a design by the names of its variables and parameters.
            samples: other samples.

        Raises:
            InputError: a soil has no result.

        Example:
            >>> from scipy import stats
            >>> import plough_opt as po
            >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
            >>> design = po.Design()
            >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
            >>> cone = po.Cone("10 deg", height)
            >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=8)
            >>> robust.values({"height": 0.3})["draft"].shape
            (8,)
        """
        if samples is not None:
            check_kind("samples", samples, SoilSamples, "SoilSamples, which a SoilDistribution makes")
        results = self.responses(at, self.samples if samples is None else samples)
        for number, reason in results.failures.items():
            raise InputError(f"sample {number} of the soil has no result: {reason}")
        return results.values

    def _request(
        self, name: str, text: str, kind: Kind, measure: Callable[..., Column], width: Expression = 0.0
    ) -> Expression:
        """Return a measure of a result as an expression, and record it for `verify`."""
        return self._requested(RequestedMeasure(name, text, kind, measure, width))

    def _requested(self, measure: RequestedMeasure) -> Expression:
        value = measure.smoothed(self[measure.result])
        self.requested.append(measure)
        return value


def _within(name: str, at_least: float | None, at_most: float | None, width: Expression) -> RequestedMeasure:
    """Return the probability that a result is within limits, as a requested measure."""
    limits = (("at least", at_least), ("at most", at_most))
    sides = [f"{word} {plain_number(word, limit):.6g}" for word, limit in limits if limit is not None]
    within = partial(measures.probability, at_least=at_least, at_most=at_most)
    return RequestedMeasure(name, f"probability of {' and '.join(sides)}", "probability", within, width)


def _in_tail(measure: Callable[..., Expression], tail: Tail) -> Callable[..., Expression]:
    """Return a measure of the largest values as it is, or mirrored into one of the smallest."""
    return measure if tail == "upper" else lambda values, **keywords: -measure(-values, **keywords)


# --- the best robust design --------------------------------------------------------------------------------

Spreads = Mapping[str, float]
"""Standard deviations of results over the samples, by name."""

Build = Callable[[Spreads], tuple[Design, Robust, frozenset[str]]]
"""Spreads -> the robust design, its results, and the names of the results whose spreads set widths.

Each of these spreads is a parameter of the design, named by `spread_of`. Which of the spreads are 0 may decide what the
design minimises and requires; otherwise it may depend on them by these parameters alone.
"""


def spread_of(result: str) -> str:
    """Return the name of the parameter that is the spread of a result."""
    return f"spread of {result}"


class _RobustProgram:
    """The program of a robust design, which is solved again with other spreads."""

    def __init__(self, design: Design, robust: Robust, follow: frozenset[str]) -> None:
        """Take what a `Build` returns."""
        self.robust, self.follow, self._declared = robust, follow, design.declared
        self._program = Program.of(self._declared)

    def solve(
        self, spreads: Spreads, progress: Progress, limit: TimeLimit, near: tuple[LocalOptimum, Optimum] | None = None
    ) -> Optimum:
        """Return the best optimum with certain spreads.

        Args:
            spreads: standard deviations of the results.
            progress: as in `best_robust`.
            limit: of the processor time.
            near: a local optimum near which to optimise, and the result of the search that found it; None to search.
        """
        known = None
        if near is not None and near[1].search is not None:
            y = [v.scaled(near[0].variables[v.name]) for v in self._declared.variables]
            known = Known(np.array([y]), near[1].search)
        values = self._declared.parameter_values({spread_of(name): spreads[name] for name in self.follow})
        request = Request(values, "auto", "tolerance", 0, progress, time.perf_counter(), limit, known)
        with without_notices():
            best = solve_program(self._program, request)
        return replace(best, origin=Origin(declarations=self._declared.plain(values), seed=0).now())


def best_robust(
    start: Mapping[str, float], build: Build, spreads: Callable[[Mapping[str, float]], Spreads], progress: Progress
) -> tuple[Optimum, Robust, tuple[str, ...]]:
    """Return the best robust optimum with all local ones, its results, and why some local optima were not settled.

    Widths of measures follow the spreads of the results, and these depend on the design. The search uses the widths at
    the start. Each of the best local optima is then solved again with the widths that belong to it, until they stay.

    Args:
        start: variables by name, such as those of the nominal optimum.
        build: makes the robust design.
        spreads: variables -> the spreads of the results there.
        progress: called with the present step in words, and the fraction done.

    Raises:
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser did not find an optimum.
    """
    programs: dict[frozenset[str], _RobustProgram] = {}
    limit = TimeLimit("auto")

    def program_for(now: Spreads) -> _RobustProgram:
        varying = frozenset(name for name, spread in now.items() if spread)
        if varying not in programs:
            programs[varying] = _RobustProgram(*build(now))
        return programs[varying]

    def settled(local: LocalOptimum, solution: Optimum | None) -> tuple[Optimum, Robust]:
        """Return a local optimum, solved again until its widths are those that follow from the spreads at it."""
        used, program, at = first, program_for(first), local
        for _ in range(_MOST_ROUNDS):
            now = spreads(at.variables)
            if solution and all(abs(now[name] - used[name]) <= _SETTLED * used[name] for name in program.follow):
                break
            used, program = now, program_for(now)
            solution = program.solve(now, progress, limit, (at, searched))
            at = solution.local_optima[0]
        assert solution is not None  # solved in the first round at the latest
        return solution, program.robust

    first = spreads(start)
    searched = program_for(first).solve(first, progress, limit)
    highest = searched.objective + _CAN_WIN * abs(searched.objective)
    candidates = [local for local in searched.local_optima if local.objective <= highest]
    found: list[tuple[Optimum, Robust]] = []
    failures = []
    for number, candidate in enumerate(candidates):
        progress("setting the widths of the best designs", number / len(candidates))
        if number and limit.passed(
            left := f"solving {len(candidates) - number} local optima again with their own widths"
        ):
            failures.append(f"after {AUTO_SECONDS:g} s of processor time the search left out {left}")
            candidates = candidates[:number]
            break
        try:
            found.append(settled(candidate, None if number else searched))
        except (InfeasibleDesign, NotConverged) as error:
            place = ", ".join(f"{name} = {value:.5g}" for name, value in candidate.variables.items())
            failures.append(f"solved again with its own widths, from {place}: {error}")
    best, robust = min(found, key=lambda pair: pair[0].objective, default=(searched, program_for(first).robust))
    robust = copy.copy(robust)
    robust.requested = [replace(m, width=float(best(m.width))) if is_casadi(m.width) else m for m in robust.requested]
    distinct: list[LocalOptimum] = []
    every = [*(optimum.local_optima[0] for optimum, _ in found), *searched.local_optima[len(found and candidates) :]]
    for local in sorted(every, key=lambda optimum: optimum.objective):
        if not any(_same(local.variables, other.variables) for other in distinct):
            distinct.append(local)
    seconds = searched.seconds + sum(optimum.seconds for optimum, _ in found if optimum is not searched)
    best = replace(best, local_optima=tuple(distinct), search=searched.search, seconds=seconds)
    return best, robust, tuple(failures)


def _same(variables: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Return whether no variable of two designs differs by more than a small part of its value."""
    return all(abs(x - other[name]) <= _SAME_VARIABLES * abs(x) for name, x in variables.items())


SAMPLES = 4096
"""Default number of fresh samples."""
SEED = 20_000
"""Default seed of the fresh samples."""

CONFIDENCE = 0.95
_REDRAWS = 500
# Number of resamples that are evaluated together, which limits the memory.
_BATCH = 50
# Verification raises an error if a larger part of the fresh samples has no result.
_MOST_FAILURES = 0.01
# Relative range below which values are equal but for rounding: the bootstrap has no interval for them.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Check:
    """One measure of a design, over the optimiser's samples and over fresh ones.

    Attributes:
        result: name of its result.
        text: the measure in words.
        seen: the optimiser's value: smoothed, over its own samples.
        sharp: the exact value over the optimiser's samples.
        fresh: the exact value over the fresh samples.
        low: lower end of the confidence interval for the whole distribution; None for a worst case.
        high: upper end of this interval.
        width: width over which the optimiser's measure is smoothed; 0 if it is not.
        rounding: change of the value by smoothing, over the fresh samples.
        note: method of the interval, or a text instead of one.
        worse: for a worst case, the number of worse fresh samples; otherwise None.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> objective = robust.expected("draft")
        >>> found = po.uncertainty.verify(robust, {"height": 0.3}, samples=256)
        >>> found.checks[0].result
        'draft'
    """

    result: str
    text: str
    seen: float
    sharp: float
    fresh: float
    low: float | None
    high: float | None
    width: float
    rounding: float
    note: str
    worse: int | None = None

    @property
    def optimism(self) -> float:
        """The value over fresh samples minus the optimiser's value."""
        return self.fresh - self.seen

    @property
    def confirmed(self) -> bool:
        """Whether the optimiser's value is in the interval; for a worst case, whether no fresh sample is worse."""
        return self.worse == 0 if self.low is None or self.high is None else self.low <= self.seen <= self.high

    @property
    def verdict(self) -> str:
        """Whether fresh samples confirm the optimiser's value, and otherwise on which side of it they lie."""
        return "confirmed" if self.confirmed else f"{'larger' if self.fresh > self.seen else 'smaller'} than seen"

    @property
    def interval(self) -> str:
        """The confidence interval as text."""
        if self.low is None or self.high is None:
            return self.note
        return f"{100 * CONFIDENCE:.0f} %: {self.low:.6g} to {self.high:.6g}, {self.note}"

    def __str__(self) -> str:
        """Return the check in a sentence."""
        smoothing = f"; smoothed over {self.width:.4g}, which changes it by {self.rounding:+.2g}" if self.width else ""
        return printable(
            f"{self.result}, {self.text}: the optimiser saw {self.seen:.6g}, fresh samples give {self.fresh:.6g}"
            f" ({self.interval}): {self.verdict}{smoothing}"
        )


@dataclass(frozen=True, eq=False)
class Verification(ByValue):
    """The measures of a design over fresh samples.

    Attributes:
        checks: the check of every requested measure.
        samples: number of fresh samples with results.
        failures: number of a fresh sample without results -> the reason.
        values: name of a result -> its values over the fresh samples.
        seed: seed of the fresh samples.
        seconds: time taken [s].

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> objective = robust.expected("draft")
        >>> found = po.uncertainty.verify(robust, {"height": 0.3}, samples=256)
        >>> [check.result for check in found.checks]
        ['draft']
    """

    checks: tuple[Check, ...]
    samples: int
    failures: Mapping[int, str]
    values: Mapping[str, Array]
    seed: int
    seconds: float

    def __getitem__(self, key: tuple[str, str]) -> Check:
        """Return a check by the name of its result and the beginning of its measure's text."""
        for check in self.checks:
            if check.result == key[0] and check.text.startswith(key[1]):
                return check
        listed = ", ".join(f"{check.result}: {check.text}" for check in self.checks)
        raise InputError(f"{key} is not among the checks, which are {listed}")

    @property
    def confirmed(self) -> bool:
        """Whether every measure is confirmed."""
        return all(check.confirmed for check in self.checks)

    def __str__(self) -> str:
        """Return one line for each check."""
        return "\n".join(map(str, self.checks))


def verify(
    robust: Robust, at: Optimum | Mapping[str, float], *, samples: int = SAMPLES, seed: int = SEED
) -> Verification:
    """Evaluate every requested measure of a design over fresh, independently drawn samples.

    Means, standard deviations and CVaR get percentile intervals of the bootstrap (scipy.stats.bootstrap),
    probabilities the exact interval of Clopper and Pearson (scipy.stats.binomtest). The worst sample has no interval,
    because the distribution may extend beyond the samples: its check gives the probability of worse soils instead.

    Args:
        robust: the results in the design.
        at: an optimum, or a design by the names of its variables and parameters.
        samples: number of fresh samples, at least 100.
        seed: seed of the fresh samples; their generator differs from that of the optimiser's samples.

    Raises:
        InputError: too few samples, or too many soils without results.

    Example:
        >>> from scipy import stats
        >>> import plough_opt as po
        >>> field = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.uniform(1e4, 1e4))
        >>> design = po.Design()
        >>> height = design.variable("height", guess="25 cm", lower="10 cm", upper="50 cm")
        >>> cone = po.Cone("10 deg", height)
        >>> robust = po.Robust(field, lambda soil: {"draft": po.resistance(cone, soil, 2.0, 0.0)}, samples=64)
        >>> objective = robust.expected("draft")
        >>> len(po.uncertainty.verify(robust, {"height": 0.3}, samples=256).checks)
        1
    """
    check_kind("the results", robust, Robust, "a Robust")
    started = time.perf_counter()
    whole_number("samples for confidence intervals", samples, 100)
    common = robust.values(at)
    fresh = robust.responses(at, robust.field.draw(samples, seed=seed))
    valid = samples - len(fresh.failures)
    if len(fresh.failures) > _MOST_FAILURES * samples:
        number, reason = next(iter(fresh.failures.items()))
        raise InputError(
            f"{len(fresh.failures)} of {samples} fresh soils have no result, such as number {number}: {reason};"
            " truncate the distribution at the ends of the model's domain"
        )
    requested = {(measure.result, measure.text): measure for measure in robust.requested}
    checks = tuple(_checked(m, common[m.result], fresh.values[m.result], seed) for m in requested.values())
    return Verification(checks, valid, fresh.failures, fresh.values, seed, time.perf_counter() - started)


def _checked(requested: RequestedMeasure, common: Array, fresh: Array, seed: int) -> Check:
    """Return the check of a measure, from the values over the optimiser's own samples and over fresh ones."""
    seen, sharp = (float(as_number(measure(common))) for measure in (requested.smoothed, requested.exact))
    exact, width = float(requested.exact(fresh)), float(requested.width)
    rounding = float(requested.smoothed(fresh)) - exact if width else 0.0
    ends: tuple[float, float] | tuple[None, None] = None, None
    worse = None
    if requested.kind == "probability":
        ends, note = _binomial(round(exact * len(fresh)), len(fresh)), "Clopper and Pearson"
    elif requested.kind == "mean":
        ends, note = _bootstrap(requested, fresh, seed), "bootstrap"
    else:
        worse = int(np.sum(fresh > seen if requested.kind == "largest" else fresh < seen))
        least, most = _binomial(worse, len(fresh))
        note = f"{worse} of {len(fresh)} are worse: {100 * least:.2g} to {100 * most:.2g} % of the whole distribution"
    low, high = ends
    return Check(requested.result, requested.text, seen, sharp, exact, low, high, width, rounding, note, worse)


def varies(values: Array) -> bool:
    """Return whether values differ by more than rounding."""
    return bool(np.ptp(values) > _NEGLIGIBLE * np.max(np.abs(values)))


def _binomial(count: int, total: int) -> tuple[float, float]:
    """Return the exact interval of a probability from the number of cases."""
    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def _bootstrap(requested: RequestedMeasure, values: Array, seed: int) -> tuple[float, float]:
    """Return the percentile interval of a measure; if all values are equal, their range."""
    if not varies(values):
        return float(np.min(values)), float(np.max(values))
    generator = np.random.default_rng([seed, 1])
    interval = stats.bootstrap(
        (values,), requested.exact, n_resamples=_REDRAWS, batch=_BATCH, vectorized=False, confidence_level=CONFIDENCE,
        method="percentile", rng=generator,
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high)


def in_words(checks: Sequence[Check]) -> str:
    """Return a sentence that says whether fresh samples confirm the optimiser's values."""
    doubtful = [f"{check.result} ({check.text}: {check.verdict})" for check in checks if not check.confirmed]
    if not doubtful:
        return "fresh samples confirm every measure"
    return f"fresh samples do not confirm {', '.join(doubtful)}; optimise over more samples for a closer value"
