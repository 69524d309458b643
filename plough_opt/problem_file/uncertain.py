"""The table [uncertain]: distributions of soil properties, mean and spread of results, and robust designs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from plough_opt.core.checks import check_named, whole_number
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number
from plough_opt.core.quantities import quantities
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.field_data import lognormal
from plough_opt.problem_file.schema import LimitTable, ProblemTable, at
from plough_opt.problem_file.source import Source
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.design import Design, Progress
    from plough_opt.problem_file.problem import Problem
    from plough_opt.studies.uncertainty import Robust, SoilDistribution
    from plough_opt.studies.uncertainty.result import RobustOptimum

# Distributions and designs need scipy.stats, which is slow to import; a file is read and checked without them.

TABLE = "uncertain"
COUNTS = {"samples": (8, 1024), "fresh": (100, 100_000), "seed": (0, 2**31 - 1)}
"""Whole numbers in the table, with their limits."""
# Kind of distribution -> (keys that it needs, keys that it may have).
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "normal": (("mean", "std"), ("lower", "upper")),
    "lognormal": (("mean", "std"), ("lower", "upper")),
    "uniform": (("lower", "upper"), ()),
    "triangular": (("lower", "mode", "upper"), ()),
    "beta": (("mean", "std", "lower", "upper"), ()),
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
    for key, entry in table.uncertain.items():
        with source.noting((TABLE, key)):
            if key in COUNTS:
                whole_number(f"'{TABLE}.{key}'", entry, *COUNTS[key])
            elif key == "correlation":
                _check_correlation(entry, table.uncertain)
            else:
                check_named("{} cannot be uncertain", key, [*properties, *COUNTS, "correlation"])
                _check_property(table, key)
                _check_distribution(source, key, entry)
    if not {*properties} & {*table.uncertain}:
        source.note(
            (TABLE,),
            "nothing is uncertain: give a property of the soil a distribution, like"
            ' "soil.cohesion" = { distribution = "lognormal", mean = "20 kPa", std = "6 kPa" }',
        )
    elif table.scene.law.lacks("uncertain"):
        source.note((TABLE,), table.scene.law.refusal("uncertain", TABLE))


def _check_measures(source: Source, table: ProblemTable) -> None:
    """Note invalid measures, and in a file without an uncertain soil the keys that need one."""
    results = MEASURES
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
                    _check_limit(entry, name, name in results and results[name].everywhere)


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
    uncertain = table.uncertain or {}
    if key in table.variables:
        raise InputError(f"'{key}' is a variable, so it cannot be uncertain: remove one")
    read = _READING in {*table.variables, *uncertain} or at(table, _READING) is not None
    if key == table.soil.adjusted and read:
        raise InputError(f"'{key}' follows from the cone index in every sample: make {_READING} uncertain")
    if key == _READING and table.soil.adjust != "strength factor":
        raise InputError(f"'{key}' can be uncertain only with adjust = \"strength factor\"")
    if key == _READING:
        for other in uncertain:
            if other.startswith("soil.") and other not in (key, *_NOT_IN_CONE_INDEX):
                raise InputError(f"the cone index depends on '{other}': the two cannot both be uncertain: remove one")


def _check_correlation(entry: Any, uncertain: Mapping[str, Any]) -> None:
    example = '[["soil.cohesion", "soil.friction_angle", -0.4]]'
    if not isinstance(entry, list):
        raise InputError(f"'{TABLE}.correlation' must be a list of pairs with a number, like {example}")
    for item in entry:
        if not isinstance(item, list) or len(item) != 3 or not isinstance(item[2], int | float):
            raise InputError(f"'{TABLE}.correlation': {item!r} must be two names and a number, like {example[1:-1]}")
        for name in item[:2]:
            names = [key for key in uncertain if key.startswith("soil.")]
            check_named(f"'{TABLE}.correlation': {{}} has no distribution", name, names)


def _check_distribution(source: Source, key: str, entry: Any) -> None:
    if not isinstance(entry, dict):
        raise InputError(f"'{key}' must be a table like {{ distribution = \"normal\", mean = ..., std = ... }}")
    kind = entry.get("distribution")
    if not isinstance(kind, str) or kind not in _KINDS:
        known = nearest(str(kind), _KINDS) if "distribution" in entry else f"one of {', '.join(_KINDS)}"
        raise source.error((TABLE, key, "distribution"), f"'{key}' needs a known distribution: {known}")
    needed, more = _KINDS[kind]
    allowed = ("distribution", *needed, *more)
    for name, written in entry.items():
        place = (TABLE, key, name)
        if name not in allowed:
            unknown = f"is not a key of a {kind} distribution: {nearest(name, allowed)}"
            raise source.error(place, f"'{key}.{name}' {unknown}")
        if name != "distribution":
            source.parsed(place, quantities()[key], written, f"'{key}' {name}")
    if missing := [name for name in needed if name not in entry]:
        raise InputError(f"'{key}': a {kind} distribution needs {' and '.join(missing)}")
    _distribution(key, entry)


def _distribution(key: str, entry: Mapping[str, Any]) -> tuple[Any, tuple[float, float]]:
    """Return a frozen distribution of scipy.stats and its bounds, SI.

    Raises:
        InputError: the parameters are invalid for this kind of distribution.
    """
    from scipy import stats  # slow to import, and rarely needed

    kind = entry["distribution"]
    si = {name: quantities()[key].parse(written) for name, written in entry.items() if name != "distribution"}
    mean, std, lower, upper = (si.get(name, math.nan) for name in ("mean", "std", "lower", "upper"))
    bounds = si.get("lower", -math.inf), si.get("upper", math.inf)
    if std <= 0.0:
        raise InputError(f"'{key}': std must be above 0: give a value without spread in [soil]")
    if bounds[0] >= bounds[1]:
        raise InputError(f"'{key}': lower must be below upper")
    if kind == "normal":
        return stats.norm(mean, std), bounds
    if kind == "lognormal":
        if mean <= 0.0:
            raise InputError(f"'{key}': the mean of a lognormal distribution must be above 0")
        return lognormal(mean, std), bounds
    if kind == "uniform":
        return stats.uniform(lower, upper - lower), bounds
    if kind == "triangular":
        if not lower <= si["mode"] <= upper:
            raise InputError(f"'{key}': mode must lie between lower and upper")
        return stats.triang((si["mode"] - lower) / (upper - lower), lower, upper - lower), bounds
    middle, relative = (mean - lower) / (upper - lower), (std / (upper - lower)) ** 2
    size = middle * (1.0 - middle) / relative - 1.0
    if not (0.0 < middle < 1.0 and size > 0.0):
        raise InputError(f"'{key}': a beta distribution between these bounds cannot have this mean and std: lower std")
    return stats.beta(middle * size, (1.0 - middle) * size, lower, upper - lower), bounds


def check_joint(source: Source, table: ProblemTable, soil: Callable[[], Soil]) -> None:
    """Note every distribution that the model refuses, with its line; the rest of the file must be valid."""
    if table.uncertain is None:
        return
    for key, entry in table.uncertain.items():
        if key.startswith("soil."):
            with source.noting((TABLE, key)):
                distribution_of({key: entry}, soil())
    source.raise_noted()
    with source.noting((TABLE, "correlation")):
        distribution_of(table.uncertain, soil())


def distribution_of(table: Mapping[str, Any], soil: Soil) -> SoilDistribution:
    """Return the distribution around a nominal soil; an uncertain cone index becomes an uncertain strength factor.

    Raises:
        InputError: parameters are invalid, or correlations are incompatible.
        DomainError: a distribution extends beyond the model's domain.
    """
    from plough_opt.studies.uncertainty import SoilDistribution

    made, within = dict[str, Any](), dict[str, tuple[float, float]]()
    names = {key: key.removeprefix("soil.") for key in table if key.startswith("soil.")}
    for key, name in names.items():
        made[name], within[name] = _distribution(key, table[key])
    if _READING in names:
        per = float(as_number(soil.strength_factor / cone_index(soil)))
        names[_READING], reading = "strength_factor", made.pop("cone_index")
        low, high = within.pop("cone_index")
        made["strength_factor"], within["strength_factor"] = _Scaled(reading, per), (per * low, per * high)
    pairs = {(names[a], names[b]): float(value) for a, b, value in table.get("correlation", [])}
    return SoilDistribution(soil, within=within, correlation=pairs, **made)


class _Scaled:
    """A distribution of scipy.stats times a factor."""

    def __init__(self, distribution: Any, factor: float) -> None:
        self._own, self._factor = distribution, factor

    def cdf(self, value: Any) -> Any:
        """Return the probability of lying below a value."""
        return self._own.cdf(value / self._factor)

    def ppf(self, probability: Any) -> Any:
        """Return the quantiles."""
        return self._factor * self._own.ppf(probability)


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

    table: Mapping[str, Any] = problem.table.uncertain or {}
    soil, seed = problem.scene().soil, table.get("seed", 1)
    field = distribution_of(table, soil)
    nominal = problem.design()[0].solve(progress=progress)
    progress("sampling the soil", 0.0)
    design, robust = robust_design(problem, field, nominal.variables)
    best = design.solve(progress=progress)
    progress("verifying on fresh soils", 0.0)
    fresh, nominal_fresh = (
        verify(robust, at, samples=table.get("fresh", 4096), seed=20_000 + seed)
        for at in (best.variables, nominal.variables)
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

    table, design, results = problem.table, Design(), MEASURES
    uncertain: Mapping[str, Any] = table.uncertain or {}
    symbols = {
        key: variable.declared(design, key, min(max(start[key], variable.lower), variable.upper))
        for key, variable in problem.variables.items()
    }

    def run_in(changes: Mapping[str, Expression]) -> Run:
        return problem.run_of(problem.scene({**symbols, **changes}), problem.values(symbols))

    def response(soil: Soil) -> dict[str, Expression]:
        run = run_in({f"soil.{name}": getattr(soil, name) for name in field.names})
        names = {**table.minimise, **table.require}
        return {name: results[name].of(run) for name in names if not results[name].everywhere}

    robust = Robust(field, response, samples=uncertain.get("samples", 64), seed=uncertain.get("seed", 1))
    # What does not depend on the soil is limited once, and not once for each soil.
    varying = {name for name, own in robust.values(start).items() if np.ptp(own) > 1e-9 * np.max(np.abs(own))}
    nominal = run_in({})
    objective: Expression = 0.0
    for name, term in table.minimise.items():
        kappa = measure_of(term.measure or "expected")
        value = results[name].of(nominal) if kappa is None else robust.mean_plus(name, kappa)
        objective = objective + value / results[name].unit.parse(term.per)
    design.minimise(objective)
    for name, limit in table.require.items():
        low, high = limit.ends(results[name].unit)
        own: dict[str, Any] = {
            "at_least": low,
            "at_most": high,
            "unit": results[name].unit.symbol,
            "display": problem.displays[name],
        }
        kappa = None if name not in varying or limit.measure is None else measure_of(limit.measure)
        if name in varying and limit.measure is None:
            part = 1.0 if limit.probability is None else limit.probability
            robust.require_probability(design, name, name, part, **own)
        else:
            value = results[name].of(nominal) if kappa is None else robust.mean_plus(name, kappa)
            design.require(name, value, **own)
    return design, robust
