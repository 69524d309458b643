"""Robust design of a problem file with an uncertain soil, compared with the nominal design and verified."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from plough_opt.core.expressions import Expression
from plough_opt.design import Design, Progress
from plough_opt.motion import Run
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.schema import LimitTable
from plough_opt.problem_file.uncertain import ChosenMeasure, UncertainTable, distribution_of, measure_of, uncertain_of
from plough_opt.soil.soil import Soil
from plough_opt.studies.uncertainty import Robust, SoilDistribution, sobol_indices, verify
from plough_opt.studies.uncertainty.result import RobustOptimum
from plough_opt.studies.uncertainty.robust import Spreads, Tail, best_robust

# Smoothing width of nonsmooth measures, in standard deviations of the result over the samples.
_SMOOTHING_WIDTH = 0.5
# A smaller relative spread is rounding, and the result does not depend on the soil.
_ROUNDING = 1e-9
# Samples for the Sobol indices.
_INDEX_SAMPLES = 1024


def optimise_robust(problem: Problem, progress: Progress) -> RobustOptimum:
    """Return the robust optimum of a file beside the nominal one, both verified on fresh samples.

    Args:
        problem: a file with a table [uncertain].
        progress: called with the present step in words and the fraction done.

    Raises:
        InputError: there are no variables, nothing to minimise, or soils for which the model gives no result.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: no optimum was found.
    """
    assert problem.table.uncertain is not None  # a precondition
    table = uncertain_of(problem.table.uncertain)
    field = distribution_of(table, problem.scene().soil)
    design, _ = problem.design()
    nominal = design.solve(progress=progress)
    design_of = _RobustDesign(problem, table, field)
    progress("sampling the soil", 0.0)
    best, robust, failures = best_robust(nominal.variables, design_of.build, design_of.spreads, progress)
    progress("verifying on fresh samples", 0.0)
    seed = 20_000 + table.seed
    fresh, nominal_fresh = (verify(robust, at, samples=table.fresh, seed=seed) for at in (best, nominal.variables))
    indices = sobol_indices(robust, best, samples=_INDEX_SAMPLES, seed=table.seed, correlated=True)
    run = problem.simulate(best.variables)
    limits = _in_words(problem, {check.result for check in fresh.checks})
    return RobustOptimum(best, run, nominal, robust, fresh, nominal_fresh, indices, failures, limits, problem.origin)


def _in_words(problem: Problem, varying: set[str]) -> dict[str, tuple[str, str]]:
    """Return result -> (its limits as written, the soils in which they must hold).

    Args:
        problem: the file.
        varying: names of the results that vary with the soil.
    """
    found = {}
    for name, own in problem.table.require.items():
        how = f"{100 * own.probability:g} % of the soils" if own.probability is not None else own.measure
        if name not in varying:
            how = "the nominal soil" if own.measure == "nominal" else "every soil equally"
        found[name] = (own.words, how or "every sample")
    return found


class _RobustDesign:
    """Builder of the file's design over samples of its soil, for every start of the solver."""

    def __init__(self, problem: Problem, table: UncertainTable, field: SoilDistribution) -> None:
        self._problem, self._table, self._field = problem, table, field
        self._samples = field.sample(table.samples, seed=table.seed)
        self._measures = measures_of(problem.table)
        names = {**problem.table.minimise, **problem.table.require}
        self._averages = tuple(name for name in names if not self._measures[name].everywhere)
        self._spreads: Spreads = {}

    @cached_property
    def _responses(self) -> Robust:
        """Results over the samples as functions of the variables."""
        return self._declared({key: v.guess for key, v in self._problem.variables.items()})[1]

    def spreads(self, at: Mapping[str, float]) -> dict[str, float]:
        """Return the standard deviation of every result at a design, 0 if it does not depend on the soil."""
        values = self._responses.values(at)
        return {
            name: float(np.std(own)) if np.ptp(own) > _ROUNDING * np.max(np.abs(own)) else 0.0
            for name, own in values.items()
        }

    def build(self, start: Mapping[str, float], spreads: Spreads) -> tuple[Design, Robust, frozenset[str]]:
        """Return the design, the results over the samples, and the names of results smoothed by their spread.

        Args:
            start: guesses of the variables.
            spreads: result -> its standard deviation, from which smoothing widths follow if the file gives none.
        """
        self._spreads = spreads
        self._smoothed_by_spread: set[str] = set()
        design, robust, run = self._declared(start)
        tables = self._problem.table
        objective: Expression = 0.0
        for name, term in tables.minimise.items():
            value = self._measure(robust, run, name, measure_of(term.measure or "expected"), term.width)
            objective = objective + value / self._measures[name].unit.parse(term.per)
        design.minimise(objective)
        for name, limit in tables.require.items():
            self._require(design, robust, run, name, limit)
        return design, robust, frozenset(self._smoothed_by_spread)

    def _declared(self, start: Mapping[str, float]) -> tuple[Design, Robust, Run]:
        """Return a design with its variables, the results over the samples, and the run in the nominal soil."""
        problem, design = self._problem, Design()
        symbols = {
            key: variable.declared(design, key, min(max(start[key], variable.lower), variable.upper))
            for key, variable in problem.variables.items()
        }

        def run_in(soil: Soil | None) -> Run:
            properties = {} if soil is None else {f"soil.{name}": getattr(soil, name) for name in self._field.names}
            return problem.run_of(problem.scene({**symbols, **properties}), problem.values(symbols))

        def response(soil: Soil) -> dict[str, Expression]:
            run = run_in(soil)
            return {name: self._measures[name].of(run) for name in self._averages}

        return design, Robust(self._field, response, samples=self._samples, seed=self._table.seed), run_in(None)

    def _measure(
        self, robust: Robust, run: Run, name: str, chosen: ChosenMeasure, written: object, low_is_bad: bool = False
    ) -> Expression:
        """Return a measure of a result, of its lower tail if small values are bad.

        Args:
            robust: the results over the samples.
            run: the run in the nominal soil.
            name: name of the result.
            chosen: the measure.
            written: smoothing width as the file writes it, or None.
            low_is_bad: whether small values are bad.
        """
        if chosen.kind == "nominal" or not self._spreads.get(name):
            return self._measures[name].of(run)
        if chosen.kind == "expected":
            return robust.expected(name)
        if chosen.kind == "mean_plus":
            return robust.mean_plus(name, chosen.number)
        width = self._width(name, written)
        tail: Tail = "lower" if low_is_bad else "upper"
        if chosen.kind == "cvar":
            return robust.cvar(name, chosen.number, width=width, tail=tail)
        return robust.worst(name, width=width, tail=tail)

    def _width(self, name: str, written: object) -> float:
        """Return the smoothing width of a result in SI: the file's, or one that follows from its spread."""
        if written is not None:
            return self._measures[name].unit.parse(written)
        self._smoothed_by_spread.add(name)
        return _SMOOTHING_WIDTH * self._spreads[name]

    def _require(self, design: Design, robust: Robust, run: Run, name: str, limit: LimitTable) -> None:
        """Add one requirement to the design."""
        unit = self._measures[name].unit
        low, high = limit.ends(unit)
        ends: dict[str, Any] = {"at_least": low, "at_most": high, "unit": unit.symbol}
        varies = bool(self._spreads.get(name))
        if varies and limit.probability is not None:
            width = self._width(name, limit.width)
            robust.require_probability(design, name, name, limit.probability, width=width, **ends)
        elif varies and limit.measure is None:
            design.require(name, robust.every(name, at_least=low, at_most=high), **ends)
        else:
            chosen = measure_of(limit.measure or "nominal")
            value = self._measure(robust, run, name, chosen, limit.width, low_is_bad=low is not None)
            design.require(name, value, **ends)
