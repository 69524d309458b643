"""A problem file with an uncertain soil as a robust design: solved, set beside the nominal one, verified."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression
from plough_opt.design import Design, Progress
from plough_opt.motion import Run
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.schema import LimitTable, TermTable
from plough_opt.problem_file.uncertain import ChosenMeasure, UncertainTable, distribution_of, measure_of, uncertain_of
from plough_opt.soil.soil import Soil
from plough_opt.studies.uncertainty import Robust, SoilDistribution, sobol_indices, verify
from plough_opt.studies.uncertainty.result import RobustOptimum
from plough_opt.studies.uncertainty.robust import Spreads, Tail, best_robust

# Of a result's standard deviation over the samples: the width over which its measures are rounded off.
_WIDTH = 0.5
# Relative spread of a result that the soil does not change.
_NONE = 1e-9
_INDEX_SAMPLES = 1024


def optimise_robust(problem: Problem, progress: Progress) -> RobustOptimum:
    """Solve a file's nominal and robust design questions, and verify both optima on fresh samples.

    Args:
        problem: a file with a table [uncertain].
        progress: called with the present step in words, and the part done.

    Raises:
        InputError: nothing to choose or to minimise, or soils without result.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: no optimum was found.
    """
    assert problem.table.uncertain is not None  # the caller has looked
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
    """Return every requirement's limits as the file writes them, and in which soils it keeps them."""
    found = {}
    for name, own in problem.table.require.items():
        limits = ", ".join(f"{side.replace('_', ' ')} {written}" for side, written in own.sides.items())
        how = f"{100 * own.probability:g} % of the soils" if own.probability is not None else own.measure
        if name not in varying:
            how = "the nominal soil" if own.measure == "nominal" else "every soil alike"
        found[name] = (limits, how or "every sample")
    return found


class _RobustDesign:
    """The file's design over samples of its soil, built again for every start."""

    def __init__(self, problem: Problem, table: UncertainTable, field: SoilDistribution) -> None:
        self._problem, self._table, self._field = problem, table, field
        self._samples = field.sample(table.samples, seed=table.seed)
        self._measures = measures_of(problem.table)
        self._names = tuple({**problem.table.minimise, **problem.table.require})
        self._averages = tuple(name for name in self._names if not self._measures[name].everywhere)
        self._spreads: Spreads = {}

    @cached_property
    def _responses(self) -> Robust:
        """The numeric results over the samples."""
        return self._declared({key: v.guess for key, v in self._problem.variables.items()})[1]

    def spreads(self, at: Mapping[str, float]) -> dict[str, float]:
        """Return the spread of every result at a design, for the widths that the file leaves open."""
        values = self._responses.values(at)
        return {
            name: float(np.std(own)) if np.ptp(own) > _NONE * np.max(np.abs(own)) else 0.0
            for name, own in values.items()
        }

    def build(self, start: Mapping[str, float], spreads: Spreads) -> tuple[Design, Robust, frozenset[str]]:
        """Return the design with its guesses at a start, and the results whose spreads set widths."""
        self._spreads = spreads
        self._following: set[str] = set()
        design, robust, run = self._declared(start)
        tables = self._problem.table
        parts = [self._term(robust, run, name, term) for name, term in tables.minimise.items()]
        design.minimise(sum(parts[1:], parts[0]))
        for name, limit in tables.require.items():
            self._require(design, robust, run, name, limit)
        return design, robust, frozenset(self._following)

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

    def _term(self, robust: Robust, run: Run, name: str, term: TermTable) -> Expression:
        per = self._measures[name].unit.parse(term.per)
        return self._measure(robust, run, name, measure_of(term.measure or "expected"), term.width) / per

    def _measure(
        self, robust: Robust, run: Run, name: str, chosen: ChosenMeasure, written: object, low_is_bad: bool = False
    ) -> Expression:
        """Return a measure of a result; where small values are bad, of its lower tail."""
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
        if written is not None:
            return self._measures[name].unit.parse(written)
        self._following.add(name)
        return _WIDTH * self._spreads[name]

    def _require(self, design: Design, robust: Robust, run: Run, name: str, limit: LimitTable) -> None:
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
            if chosen.kind in ("cvar", "worst") and low is not None and high is not None:
                one = f"a {chosen.kind} is limited from one side: give one limit"
                raise InputError(f"{self._problem.name}: '{name}': {one}")
            value = self._measure(robust, run, name, chosen, limit.width, low_is_bad=low is not None)
            design.require(name, value, **ends)
