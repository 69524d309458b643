"""The table [uncertain]: distributions of soil properties, mean and spread of results, and robust designs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from plough_opt.core.checks import check_named
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import Expression, as_number
from plough_opt.core.quantities import quantities
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.field_data import lognormal
from plough_opt.problem_file.schema import DistributionTable, LimitTable, ProblemTable, UncertainTable, at
from plough_opt.problem_file.source import Source
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.design import Design, Progress
    from plough_opt.problem_file.problem import Problem
    from plough_opt.studies.uncertainty import Robust, SoilDistribution
    from plough_opt.studies.uncertainty.result import RobustOptimum

# Distributions and designs need scipy.stats, which is slow to import; a file is read and checked without them.

TABLE = "uncertain"
# Kind of distribution -> keys that it needs; those without bounds may have them.
_KINDS = {
    "normal": ("mean", "std"),
    "lognormal": ("mean", "std"),
    "uniform": ("lower", "upper"),
    "triangular": ("lower", "mode", "upper"),
    "beta": ("mean", "std", "lower", "upper"),
}
_READING = "soil.cone_index"
# Properties that do not affect the cone index.
_NOT_IN_CONE_INDEX = ("soil.density", "soil.youngs_modulus", "soil.poisson_ratio")
_MEASURE = re.compile(r"(?P<word>nominal|expected)|mean\s*(?P<sign>[+-])\s*(?P<factor>\d+\.?\d*|\.\d+)\s*std")


def measure_of(text: str) -> float | None:
    """Return the k in mean + k standard deviations that a text describes: 0 for "expected", None for "nominal".

    Raises:
        InputError: the text is no measure.
    """
    match = _MEASURE.fullmatch(text.strip())
    if match is None:
        raise InputError(f'"{text}" is not a measure: use "expected", "mean + 2 std", "mean - 2 std" or "nominal"')
    if match["word"]:
        return None if match["word"] == "nominal" else 0.0
    return float(match["sign"] + match["factor"])


def check_uncertain(source: Source, table: ProblemTable) -> None:
    """Note every mistake in the table, and in the measures of terms and requirements."""
    _check_measures(source, table)
    if table.uncertain is None:
        return
    properties = [key for key in quantities() if key.startswith("soil.")]
    for key in table.uncertain.soil:
        with source.noting((TABLE, key)):
            check_named("{} cannot be uncertain", key, [*properties, *type(table.uncertain).model_fields])
            _check_property(table, key)
    with source.noting((TABLE, "correlation")):
        for *names, _ in table.uncertain.correlation:
            for name in names:
                check_named("'uncertain.correlation': {} has no distribution", name, table.uncertain.soil)
    if not table.uncertain.soil:
        example = '"soil.cohesion" = { distribution = "lognormal", mean = "20 kPa", std = "6 kPa" }'
        source.note((TABLE,), f"nothing is uncertain: give a property of the soil a distribution, like {example}")
    elif table.scene.law.lacks("uncertain"):
        source.note((TABLE,), table.scene.law.refusal("uncertain", TABLE))


def _check_measures(source: Source, table: ProblemTable) -> None:
    """Note invalid measures, and in a file without an uncertain soil the keys that need one."""
    for kind in ("minimise", "require"):
        for name, entry in getattr(table, kind).items():
            if table.uncertain is None:
                for key in ("measure", "probability"):
                    if getattr(entry, key, None) is not None:
                        needs = f"belongs to an uncertain soil: add a table [{TABLE}]"
                        source.note((kind, name, key), f"'{kind}.{name}.{key}' {needs}")
                continue
            with source.noting((kind, name)):
                if entry.measure is not None:
                    measure_of(entry.measure)
                if isinstance(entry, LimitTable):
                    _check_limit(entry, name, name in MEASURES and MEASURES[name].everywhere)


def _check_limit(limit: LimitTable, name: str, everywhere: bool) -> None:
    if everywhere and limit.measure != "nominal":
        raise InputError(f"'{name}' has a value at every output time: limit its mean, or set measure = \"nominal\"")
    if limit.probability is None:
        return
    if limit.measure is not None:
        raise InputError(f"'{name}' has both a measure and a probability: remove one")
    if not 0.0 < limit.probability < 1.0:
        between = "must lie between 0 and 1; remove it to require every sample"
        raise InputError(f"'{name}': the probability {limit.probability:g} {between}")
    if len(limit.sides) == 2:
        raise InputError(f"'{name}': a probability applies to one limit: give at_least or at_most")


def _check_property(table: ProblemTable, key: str) -> None:
    """Raise InputError for a property that is a variable, or that follows from a cone index in every sample."""
    uncertain = table.uncertain.soil if table.uncertain else {}
    if key in table.variables:
        raise InputError(f"'{key}' is a variable, so it cannot be uncertain: remove one")
    read = _READING in {*table.variables, *uncertain} or at(table, _READING) is not None
    if key == table.soil.adjusted and read:
        raise InputError(f"'{key}' follows from the cone index in every sample: make {_READING} uncertain")
    if key == _READING and table.soil.adjust != "strength factor":
        raise InputError(f"'{key}' can be uncertain only with adjust = \"strength factor\"")
    if key == _READING:
        for other in uncertain:
            if other not in (key, *_NOT_IN_CONE_INDEX):
                raise InputError(f"the cone index depends on '{other}': the two cannot both be uncertain: remove one")


def check_joint(source: Source, table: ProblemTable, soil: Callable[[], Soil]) -> None:
    """Note every distribution that the model refuses, with its line; the rest of the file must be valid."""
    if table.uncertain is not None:
        for key, entry in table.uncertain.soil.items():
            with source.noting((TABLE, key)):
                distribution_of(UncertainTable.model_validate({key: entry}), soil())
        source.raise_noted()
        with source.noting((TABLE, "correlation")):
            distribution_of(table.uncertain, soil())


def distribution_of(table: UncertainTable, soil: Soil) -> SoilDistribution:
    """Return the distribution around a nominal soil; an uncertain cone index becomes an uncertain strength factor.

    Raises:
        InputError: parameters are invalid, or correlations are incompatible.
        DomainError: a distribution extends beyond the model's domain.
    """
    from plough_opt.studies.uncertainty import SoilDistribution

    made, within = dict[str, Any](), dict[str, tuple[float, float]]()
    names = {key: key.removeprefix("soil.") for key in table.soil}
    for key, name in names.items():
        made[name], within[name] = _distribution(key, table.soil[key])
    if _READING in names:
        per = float(as_number(soil.strength_factor / cone_index(soil)))
        names[_READING], reading = "strength_factor", made.pop("cone_index")
        low, high = within.pop("cone_index")
        within["strength_factor"] = per * low, per * high
        made["strength_factor"] = SimpleNamespace(
            cdf=lambda x: reading.cdf(x / per), ppf=lambda p: per * reading.ppf(p)
        )
    pairs = {(names[str(a)], names[str(b)]): float(value) for a, b, value in table.correlation}
    return SoilDistribution(soil, within=within, correlation=pairs, **made)


def _distribution(key: str, entry: DistributionTable) -> tuple[Any, tuple[float, float]]:
    """Return a frozen distribution of scipy.stats and its bounds, SI.

    Raises:
        InputError: the parameters are invalid for this kind of distribution.
    """
    from scipy import stats  # slow to import, and rarely needed

    kind, si = entry.distribution, dict[str, float]()
    written = entry.model_dump(exclude_none=True, exclude={"distribution"})
    if missing := [name for name in _KINDS[kind] if name not in written]:
        raise InputError(f"'{key}': a {kind} distribution needs {' and '.join(missing)}")
    if odd := [name for name in written if name not in (*_KINDS[kind], "lower", "upper")]:
        raise InputError(f"'{key}.{odd[0]}' is not a key of a {kind} distribution: remove it")
    for name, text in written.items():
        with about(f"'{key}' {name}"):
            si[name] = quantities()[key].parse(text)
    mean, std = si.get("mean", math.nan), si.get("std", math.nan)
    lower, upper = si.get("lower", -math.inf), si.get("upper", math.inf)
    width, mode = upper - lower, si.get("mode", lower)
    # Mean and variance of a beta distribution between 0 and 1, and the sum of its two shapes.
    middle, variance = ((mean - lower) / width, (std / width) ** 2) if kind == "beta" and width > 0.0 else (0.5, 0.1)
    size = middle * (1.0 - middle) / variance - 1.0
    for wrong, why in (
        (std <= 0.0, "std must be above 0: give a value without spread in [soil]"),
        (width <= 0.0, "lower must be below upper"),
        (kind == "lognormal" and mean <= 0.0, "the mean of a lognormal distribution must be above 0"),
        (not lower <= mode <= upper, "mode must lie between lower and upper"),
        (not size > 0.0, "a beta distribution between these bounds cannot have this mean and std: lower std"),
    ):
        if wrong:
            raise InputError(f"'{key}': {why}")
    made: dict[str, Callable[[], Any]] = {
        "normal": lambda: stats.norm(mean, std),
        "lognormal": lambda: lognormal(mean, std),
        "uniform": lambda: stats.uniform(lower, width),
        "triangular": lambda: stats.triang((mode - lower) / width, lower, width),
        "beta": lambda: stats.beta(middle * size, (1.0 - middle) * size, lower, width),
    }
    return made[kind](), (lower, upper)


def optimise_robust(problem: Problem, progress: Progress) -> RobustOptimum:
    """Return the robust optimum of a file beside the nominal one, both verified on fresh soils.

    Args:
        problem: a file with a table [uncertain].
        progress: called with the present step in words and the fraction done.

    Raises:
        InputError: there are no variables, nothing to minimise, or soils for which the model gives no result.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: no optimum was found.
    """
    from plough_opt.studies.uncertainty import verify
    from plough_opt.studies.uncertainty.result import RobustOptimum

    table = problem.table.uncertain
    assert table is not None
    soil, seed = problem.scene().soil, table.seed
    field = distribution_of(table, soil)
    nominal = problem.design()[0].solve(progress=progress)
    progress("sampling the soil", 0.0)
    design, robust = robust_design(problem, field, nominal.variables)
    best = design.solve(progress=progress)
    progress("verifying on fresh soils", 0.0)
    fresh, nominal_fresh = (
        verify(robust, at, samples=table.fresh, seed=20_000 + seed) for at in (best.variables, nominal.variables)
    )
    best = replace(best, run=problem.simulate(best.variables), origin=problem.made(seed))
    properties = {name: (float(getattr(soil, name)), *own) for name, own in field.moments.items()}
    pairs = {f"{a} and {b}": value for (a, b), value in field.correlation.items()}
    return RobustOptimum(best, nominal, properties, pairs, robust.samples, fresh, nominal_fresh, problem.made(seed))


def robust_design(problem: Problem, field: SoilDistribution, start: Mapping[str, float]) -> tuple[Design, Robust]:
    """Return the design over common soils, and its results in them.

    Args:
        problem: a file with a table [uncertain].
        field: the distribution of its soil.
        start: variables at which the search starts.
    """
    from plough_opt.design import Design
    from plough_opt.studies.uncertainty import Robust

    table, design = problem.table, Design()
    uncertain = table.uncertain
    assert uncertain is not None
    symbols = {
        key: variable.declared(design, key, min(max(start[key], variable.lower), variable.upper))
        for key, variable in problem.variables.items()
    }

    def run_in(changes: Mapping[str, Expression]) -> Run:
        return problem.run_of(problem.scene({**symbols, **changes}), problem.values(symbols))

    def response(soil: Soil) -> dict[str, Expression]:
        run = run_in({f"soil.{name}": getattr(soil, name) for name in field.names})
        names = {**table.minimise, **table.require}
        return {name: MEASURES[name].of(run) for name in names if not MEASURES[name].everywhere}

    def measured(name: str, measure: str) -> Expression:
        kappa = measure_of(measure)
        return MEASURES[name].of(nominal) if kappa is None else robust.mean_plus(name, kappa)

    robust, nominal = Robust(field, response, samples=uncertain.samples, seed=uncertain.seed), run_in({})
    # What does not depend on the soil is limited once, and not once for each soil.
    varying = {name for name, own in robust.values(start).items() if np.ptp(own) > 1e-9 * np.max(np.abs(own))}
    objective: Expression = 0.0
    for name, term in table.minimise.items():
        objective = objective + measured(name, term.measure or "expected") / MEASURES[name].unit.parse(term.per)
    design.minimise(objective)
    for name, limit in table.require.items():
        unit = MEASURES[name].unit
        low, high = limit.ends(unit)
        ends: dict[str, Any] = {
            "at_least": low,
            "at_most": high,
            "unit": unit.symbol,
            "display": problem.displays[name],
        }
        if name in varying and limit.measure is None:
            robust.require_probability(design, name, name, limit.probability or 1.0, **ends)
        else:
            design.require(name, measured(name, (name in varying and limit.measure) or "nominal"), **ends)
    return design, robust
