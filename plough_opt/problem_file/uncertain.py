"""The table [uncertain]: distributions of soil properties, measures of results, and designs that allow for them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from plough_opt.core.checks import check_named, whole_number
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, as_number
from plough_opt.core.quantities import quantities
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.problem_file.field_data import lognormal
from plough_opt.problem_file.schema import LimitTable, ProblemTable, at, measures_of
from plough_opt.problem_file.source import Source
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from plough_opt.design import Design, Progress
    from plough_opt.problem_file.problem import Problem
    from plough_opt.studies.uncertainty import Robust, SoilDistribution
    from plough_opt.studies.uncertainty.result import RobustOptimum
    from plough_opt.studies.uncertainty.robust import Spreads

# Distributions and designs need scipy.stats, which is slow to import; a file is read and checked without them.

TABLE = "uncertain"
_COUNTS = {"samples": (8, 1024), "fresh": (100, 100_000), "seed": (0, 2**31 - 1)}
# Kind of distribution -> (keys that it needs, keys that it may have).
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "normal": (("mean", "std"), ("lower", "upper")),
    "lognormal": (("mean", "std"), ("lower", "upper")),
    "uniform": (("lower", "upper"), ()),
    "triangular": (("lower", "mode", "upper"), ()),
    "beta": (("mean", "std", "lower", "upper"), ()),
}
# Properties that do not affect the cone index.
_NOT_IN_CONE_INDEX = ("density", "youngs_modulus", "poisson_ratio")
_UNSIGNED = r"(?:\d+\.?\d*|\.\d+)"
_MEASURE = re.compile(
    rf"(?P<plain>nominal|expected|worst)|cvar\s+(?P<level>{_UNSIGNED})"
    rf"|mean\s*(?P<sign>[+-])\s*(?P<factor>{_UNSIGNED})\s*std"
)
_MEASURE_EXAMPLES = '"expected", "mean + 2 std", "cvar 0.9", "worst" or "nominal"'
# Measures of one tail, which are not smooth.
_TAILS = ("cvar", "worst")
# Smoothing width of nonsmooth measures, in standard deviations of the result over the samples.
_SMOOTHING_WIDTH = 0.5
# Samples for the Sobol indices.
_INDEX_SAMPLES = 1024


@dataclass(frozen=True)
class UncertainTable:
    """The uncertain soil of a file.

    Attributes:
        distributions: property of the soil -> kind and parameters in SI.
        correlation: pair of properties -> correlation of their normal scores.
        samples: number of samples that the optimiser uses.
        fresh: number of samples that verify the optimum.
        seed: seed of both sets of samples.
    """

    distributions: Mapping[str, Mapping[str, Any]]
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    samples: int = 64
    fresh: int = 4096
    seed: int = 1


Measured: TypeAlias = tuple[str, tuple[float, ...]]
"""The measure of a term or requirement: its name, and the level of a cvar or the factor of a mean_plus."""


def measure_of(text: str) -> Measured:
    """Return the measure that a text describes.

    Raises:
        InputError: the measure is unknown, or its level is invalid.
    """
    match = _MEASURE.fullmatch(text.strip())
    if match is None:
        raise InputError(f'"{text}" is not a measure: use {_MEASURE_EXAMPLES}')
    if match["level"] and not 0.0 < float(match["level"]) < 1.0:
        raise InputError(f'"{text}": the level of a cvar must lie between 0 and 1; 0.9 means the worst tenth')
    if match["factor"]:
        return "mean_plus", (float(match["sign"] + match["factor"]),)
    return ("cvar", (float(match["level"]),)) if match["level"] else (match["plain"], ())


def uncertain_of(table: Mapping[str, Any]) -> UncertainTable:
    """Return the table of a file, which must have been checked, in SI."""
    own = {key: value for key, value in table.items() if key not in {*_COUNTS, "correlation"}}
    counts = {key: table[key] for key in _COUNTS if key in table}
    return UncertainTable(
        {key.removeprefix("soil."): _parsed(key, entry) for key, entry in own.items()},
        {(a.removeprefix("soil."), b.removeprefix("soil.")): float(c) for a, b, c in table.get("correlation", [])},
        **counts,
    )


def distribution_of(table: UncertainTable, soil: Soil) -> SoilDistribution:
    """Return the distribution around a nominal soil.

    Raises:
        InputError: parameters are invalid, or correlations are incompatible.
        DomainError: a distribution extends beyond the model's domain.
    """
    from plough_opt.studies.uncertainty import SoilDistribution

    table = _of_strength_factor(table, soil)
    kinds = table.distributions
    made = {name: _made(name, values) for name, values in kinds.items()}
    within = {name: (own.get("lower", -math.inf), own.get("upper", math.inf)) for name, own in kinds.items()}
    return SoilDistribution(soil, within=within, correlation=table.correlation, **made)


def _of_strength_factor(table: UncertainTable, soil: Soil) -> UncertainTable:
    """Return the table with a distribution of the strength factor in place of the proportional cone index."""
    reading = table.distributions.get("cone_index")
    if reading is None:
        return table
    others = [name for name in table.distributions if name not in ("cone_index", *_NOT_IN_CONE_INDEX)]
    if others:
        raise InputError(f"the cone index depends on 'soil.{others[0]}': the two cannot both be uncertain: remove one")
    per = float(as_number(soil.strength_factor / cone_index(soil)))
    scaled = {key: value if key == "distribution" else value * per for key, value in reading.items()}
    new = {"cone_index": "strength_factor"}
    return replace(
        table,
        distributions={new.get(k, k): scaled if k in new else v for k, v in table.distributions.items()},
        correlation={(new.get(a, a), new.get(b, b)): c for (a, b), c in table.correlation.items()},
    )


def join_dotted(data: dict[str, Any]) -> None:
    """Replace unquoted keys such as soil.cohesion = {...} under [uncertain] by "soil.cohesion" = {...}."""
    table = data.get(TABLE)
    if isinstance(table, dict) and isinstance(table.get("soil"), dict):
        for name, entry in table.pop("soil").items():
            own = table.get(f"soil.{name}")
            # An override from the command line may have added keys to a table under the quoted name.
            both = isinstance(own, dict) and isinstance(entry, dict)
            table[f"soil.{name}"] = dict(own or {}, **entry) if both else entry


def check_uncertain(source: Source, table: ProblemTable) -> None:
    """Note every mistake in the table, and in the measures of terms and requirements."""
    _check_measures(source, table)
    if table.uncertain is None:
        return
    properties = [key for key in quantities() if key.startswith("soil.")]
    for key, entry in table.uncertain.items():
        with source.noting((TABLE, key)):
            if key in _COUNTS:
                whole_number(f"'{TABLE}.{key}'", entry, *_COUNTS[key])
            elif key == "correlation":
                _check_correlation(entry, [name for name in table.uncertain if name.startswith("soil.")])
            else:
                check_named("{} cannot be uncertain", key, [*properties, *_COUNTS, "correlation"])
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


def _check_property(table: ProblemTable, key: str) -> None:
    """Raise InputError for a property that is a variable, or that follows from a cone index in every sample."""
    reading = "soil.cone_index"
    if key in table.variables:
        raise InputError(f"'{key}' is a variable, so it cannot be uncertain: remove one")
    read = reading in {*table.variables, *(table.uncertain or ())} or at(table, reading) is not None
    if key == table.soil.adjusted and read:
        raise InputError(f"'{key}' follows from the cone index in every sample: make {reading} uncertain")
    if key == reading and table.soil.adjust != "strength factor":
        raise InputError(f"'{key}' can be uncertain only with adjust = \"strength factor\"")


def check_joint(source: Source, table: ProblemTable, soil: Callable[[], Soil]) -> None:
    """Note every distribution that the model refuses, with its line; the rest of the file must be valid."""
    if table.uncertain is None:
        return
    own = uncertain_of(table.uncertain)
    for name, values in own.distributions.items():
        with source.noting((TABLE, f"soil.{name}")):
            distribution_of(UncertainTable({name: values}), soil())
    source.raise_noted()
    with source.noting((TABLE, "correlation")):
        distribution_of(own, soil())


def _check_correlation(entry: Any, names: Sequence[str]) -> None:
    example = '[["soil.cohesion", "soil.friction_angle", -0.4]]'
    if not isinstance(entry, list):
        raise InputError(f"'{TABLE}.correlation' must be a list of pairs with a number, like {example}")
    for item in entry:
        if not isinstance(item, list) or len(item) != 3 or not isinstance(item[2], int | float):
            raise InputError(f"'{TABLE}.correlation': {item!r} must be two names and a number, like {example[1:-1]}")
        for name in item[:2]:
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
    _made(key, _parsed(key, entry))


def _parsed(key: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    unit = quantities()[key]
    return {name: value if name == "distribution" else unit.parse(value) for name, value in entry.items()}


def _made(name: str, values: Mapping[str, Any]) -> Any:
    """Return a frozen distribution of scipy.stats.

    Raises:
        InputError: the parameters are invalid for this kind of distribution.
    """
    from scipy import stats  # slow to import, and rarely needed

    kind = values["distribution"]
    mean, std, lower, upper = (values.get(key, math.nan) for key in ("mean", "std", "lower", "upper"))
    if std <= 0.0:
        raise InputError(f"'{name}': std must be above 0: give a value without spread in [soil]")
    if lower >= upper:
        raise InputError(f"'{name}': lower must be below upper")
    if kind == "normal":
        return stats.norm(mean, std)
    if kind == "lognormal":
        if mean <= 0.0:
            raise InputError(f"'{name}': the mean of a lognormal distribution must be above 0")
        return lognormal(mean, std)
    if kind == "uniform":
        return stats.uniform(lower, upper - lower)
    if kind == "triangular":
        if not lower <= values["mode"] <= upper:
            raise InputError(f"'{name}': mode must lie between lower and upper")
        return stats.triang((values["mode"] - lower) / (upper - lower), lower, upper - lower)
    middle, relative = (mean - lower) / (upper - lower), (std / (upper - lower)) ** 2
    size = middle * (1.0 - middle) / relative - 1.0
    if not (0.0 < middle < 1.0 and size > 0.0):
        raise InputError(f"'{name}': a beta distribution between these bounds cannot have this mean and std: lower std")
    return stats.beta(middle * size, (1.0 - middle) * size, lower, upper - lower)


def _check_measures(source: Source, table: ProblemTable) -> None:
    """Note invalid measures, and in a file without an uncertain soil the keys that need one."""
    known = measures_of(table)
    for kind in ("minimise", "require"):
        for name, entry in getattr(table, kind).items():
            if table.uncertain is None:
                for key in ("measure", "probability", "width"):
                    if getattr(entry, key, None) is not None:
                        needs = f"belongs to an uncertain soil: add a table [{TABLE}]"
                        source.note((kind, name, key), f"'{kind}.{name}.{key}' {needs}")
                continue
            with source.noting((kind, name)):
                chosen = None if entry.measure is None else measure_of(entry.measure)
                if isinstance(entry, LimitTable):
                    _check_limit(entry, name, chosen, everywhere=name in known and known[name].everywhere)
                if entry.width is not None and name in known:
                    place = (kind, name, "width")
                    if source.parsed(place, known[name].unit, entry.width, f"'{name}' width") <= 0.0:
                        raise source.error(place, f"'{name}' width = {entry.width} must be above 0")


def _check_limit(limit: LimitTable, name: str, chosen: Measured | None, everywhere: bool) -> None:
    if everywhere and limit.measure != "nominal":
        raise InputError(f"'{name}' has a value at every output time: limit its mean, or set measure = \"nominal\"")
    if limit.probability is not None and chosen is not None:
        raise InputError(f"'{name}' has both a measure and a probability: remove one")
    if limit.probability is not None and not 0.0 < limit.probability < 1.0:
        between = "must lie between 0 and 1; remove it to require every sample"
        raise InputError(f"'{name}': the probability {limit.probability:g} {between}")
    one_tail = limit.probability is not None or (chosen is not None and chosen[0] in _TAILS)
    if one_tail and len(limit.sides) == 2:
        raise InputError(f"'{name}': a probability, cvar or worst value applies to one limit: give at_least or at_most")


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
    from plough_opt.studies.uncertainty import sobol_indices, verify
    from plough_opt.studies.uncertainty.result import RobustOptimum
    from plough_opt.studies.uncertainty.robust import best_robust

    assert problem.table.uncertain is not None  # a precondition
    table = uncertain_of(problem.table.uncertain)
    field = distribution_of(table, problem.scene().soil)
    design, _ = problem.design()
    nominal = design.solve(progress=progress)
    progress("sampling the soil", 0.0)
    design_of = _RobustDesign(problem, table, field, nominal.variables)
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

    def __init__(
        self, problem: Problem, table: UncertainTable, field: SoilDistribution, start: Mapping[str, float]
    ) -> None:
        self._problem, self._table, self._field = problem, table, field
        self._samples = field.sample(table.samples, seed=table.seed)
        self._measures = measures_of(problem.table)
        names = {**problem.table.minimise, **problem.table.require}
        self._averages = tuple(name for name in names if not self._measures[name].everywhere)
        self._start = start
        self._declare()
        self._built = False

    def spreads(self, at: Mapping[str, float]) -> dict[str, float]:
        """Return the standard deviation of every result at a design, 0 if it does not depend on the soil."""
        from plough_opt.studies.uncertainty.robust import varies

        values = self._robust.values(at)
        return {name: float(np.std(own)) if varies(own) else 0.0 for name, own in values.items()}

    def build(self, spreads: Spreads) -> tuple[Design, Robust, frozenset[str]]:
        """Return the design, the results over the samples, and the names of results smoothed by their spread.

        Args:
            spreads: result -> its standard deviation, from which smoothing widths follow if the file gives none.
        """
        if self._built:
            self._declare()
        self._built, self._spreads, self._parameters = True, spreads, dict[str, Expression]()
        design, robust, tables = self._design, self._robust, self._problem.table
        objective: Expression = 0.0
        for name, term in tables.minimise.items():
            value = self._measure(name, measure_of(term.measure or "expected"), term.width)
            objective = objective + value / self._measures[name].unit.parse(term.per)
        design.minimise(objective)
        for name, limit in tables.require.items():
            self._require(name, limit)
        return design, robust, frozenset(self._parameters)

    def _declare(self) -> None:
        """Make a design with its variables, the results over the samples, and the run in the nominal soil."""
        from plough_opt.design import Design
        from plough_opt.studies.uncertainty import Robust

        problem, design = self._problem, Design()
        symbols = {
            key: variable.declared(design, key, min(max(self._start[key], variable.lower), variable.upper))
            for key, variable in problem.variables.items()
        }

        def run_in(soil: Soil | None) -> Run:
            properties = {} if soil is None else {f"soil.{name}": getattr(soil, name) for name in self._field.names}
            return problem.run_of(problem.scene({**symbols, **properties}), problem.values(symbols))

        def response(soil: Soil) -> dict[str, Expression]:
            run = run_in(soil)
            return {name: self._measures[name].of(run) for name in self._averages}

        self._design, self._run = design, run_in(None)
        self._robust = Robust(self._field, response, samples=self._samples, seed=self._table.seed)

    def _measure(self, name: str, chosen: Measured, written: object, low_is_bad: bool = False) -> Expression:
        """Return a measure of a result, of its lower tail if small values are bad.

        Args:
            name: name of the result.
            chosen: the measure.
            written: smoothing width as the file writes it, or None.
            low_is_bad: whether small values are bad.
        """
        measure, numbers = chosen
        if measure == "nominal" or not self._spreads.get(name):
            return self._measures[name].of(self._run)
        smoothed: dict[str, Any] = {}
        if measure in _TAILS:
            smoothed = {"width": self._width(name, written), "tail": "lower" if low_is_bad else "upper"}
        value: Expression = getattr(self._robust, measure)(name, *numbers, **smoothed)
        return value

    def _width(self, name: str, written: object) -> Expression:
        """Return the smoothing width of a result in SI: the file's, or one that follows from its spread."""
        if written is not None:
            return self._measures[name].unit.parse(written)
        from plough_opt.studies.uncertainty.robust import spread_of

        if name not in self._parameters:
            unit = self._measures[name].unit.symbol
            self._parameters[name] = self._design.parameter(spread_of(name), self._spreads[name], unit=unit)
        return _SMOOTHING_WIDTH * self._parameters[name]

    def _require(self, name: str, limit: LimitTable) -> None:
        """Add one requirement to the design."""
        design, robust, unit = self._design, self._robust, self._measures[name].unit
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
            value = self._measure(name, chosen, limit.width, low_is_bad=low is not None)
            design.require(name, value, **ends)
