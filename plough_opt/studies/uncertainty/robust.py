"""Robust: a design's results over common samples of its soil, and what is asked of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.domain import plain_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression
from plough_opt.core.kinds import check_callable, check_choice, check_kind, check_named, shown
from plough_opt.core.tables import Grid, Page, Readable
from plough_opt.design import Design, Optimum
from plough_opt.studies.uncertainty import measures
from plough_opt.studies.uncertainty.distribution import SoilDistribution
from plough_opt.studies.uncertainty.responses import Response, Responses
from plough_opt.studies.uncertainty.samples import SoilSamples

Vector = NDArray[np.float64]
Kind = Literal["mean", "largest", "smallest", "probability"]
Tail = Literal["upper", "lower"]

_WORST = {"upper": "largest", "lower": "smallest"}


@dataclass(frozen=True)
class Asked:
    """A measure that was asked for.

    Attributes:
        result: name of the result that it is of.
        text: the measure in words.
        kind: how it is verified on fresh samples.
        sharp: values of the samples, along the last axis -> measure, as `po.uncertainty.cvar` takes them.
        rounded: values -> the same, rounded off as the optimiser sees it.
        width: over which it is rounded off, in the unit of the values; 0 where it is not.
    """

    result: str
    text: str
    kind: Kind
    sharp: Callable[[Vector], float]
    rounded: Callable[[Vector], float]
    width: float = 0.0


class Robust(Readable):
    """The results of a design for every one of some common samples of its soil.

    For example::

        def response(soil):
            scene = po.Scene(soil, share, k0, mass, 2.0, effects)
            return {"draft": po.simulate(scene, 2.0).mean_draft, "radius": scene.loosened_radius}

        robust = po.Robust(field, response, samples=64, seed=1)
        d.minimise(robust.cvar("draft", 0.9, width=200.0) / 1e3)
        d.require("radius", robust.probability("radius", at_least=0.15, width=0.004), at_least=0.95)
        best = d.solve()
        print(po.uncertainty.verify(robust, best))

    All samples are in one program: their runs share one integrator, that maps over them. Each measure is a function of
    the result's values, an expression that the design may use as any other; it is remembered for `verify`.

    Args:
        field: the distribution.
        response: soil -> results by name, each a scalar expression of the design.
        samples: how many of `SoilDistribution.sample`; or the samples themselves, such as the distribution's corners.
        seed: of the samples.

    Raises:
        InputError: results that are no scalars by name, or a number of samples that cannot be.
    """

    def __init__(
        self, field: SoilDistribution, response: Response, *, samples: int | SoilSamples = 64, seed: int = 1
    ) -> None:
        if not isinstance(field, SoilDistribution):
            raise InputError(f"{shown(field)} is no distribution of soils: po.SoilDistribution(...) makes one")
        check_callable("the response", response, "of a soil that returns results by name")
        self.field = field
        self.samples = samples if isinstance(samples, SoilSamples) else field.sample(samples, seed=seed)
        if self.samples.names != field.names:
            raise InputError(f"the samples are of {self.samples.names}, and the distribution of {field.names}")
        self.response = response
        self.seed = seed
        self.columns: Mapping[str, Expression] = self.samples.each(response)
        self.asked: list[Asked] = []

    def page(self) -> Page:
        """Return the results, their spread's soil, and what is asked of them."""
        table = Grid.of("", "result", "measure", left=("measure",))
        for one in self.asked:
            table.row(one.result, one.text)
        named = ", ".join(self.columns)
        heading = f"{named} over {len(self.samples)} samples of {self.field.in_words()}"
        return Page(heading, (table,) if table.rows else ("Nothing is asked of them yet.",))

    def __getitem__(self, name: str) -> Expression:
        """Return a result's values, a column over the samples: in a requirement it is limited in every one of them."""
        check_named("{} is no result of the response", name, self.columns)
        return self.columns[name]

    def expected(self, name: str) -> Expression:
        """Return the mean of a result."""
        return self._ask(name, "mean", "mean", measures.expected)

    def mean_plus(self, name: str, kappa: float) -> Expression:
        """Return mean + kappa * standard deviation of a result."""
        kappa = plain_number("kappa", kappa)
        sign = "+" if kappa >= 0.0 else "-"
        text = f"mean {sign} {abs(kappa):g} standard deviations"
        return self._ask(name, text, "mean", partial(measures.mean_plus, kappa=kappa))

    def cvar(self, name: str, level: float, *, width: float, tail: Tail = "upper") -> Expression:
        """Return the mean of a result over the worst part 1 - level of the samples: see `measures.cvar`.

        The worst are the largest, or with ``tail="lower"`` the smallest.
        """
        check_choice("tail", tail, tuple(_WORST))
        level = plain_number("the level of a CVaR", level)
        text = f"mean of the {_WORST[tail]} {100.0 * (1.0 - level):.4g} %"
        return self._ask(name, text, "mean", _in_tail(partial(measures.cvar, level=level), tail), width)

    def worst(self, name: str, *, width: float, tail: Tail = "upper") -> Expression:
        """Return the largest value of a result over the samples, or the smallest: see `measures.worst`."""
        check_choice("tail", tail, tuple(_WORST))
        kind: Kind = "largest" if tail == "upper" else "smallest"
        return self._ask(name, f"{kind} of the samples", kind, _in_tail(measures.worst, tail), width)

    def every(self, name: str, *, at_least: float | None = None, at_most: float | None = None) -> Expression:
        """Return a result's values, a column to be required to keep limits: `verify` then says how probably it does."""
        values = self[name]
        self.asked.append(_keeping(name, at_least, at_most, 0.0))
        return values

    def probability(
        self, name: str, *, at_least: float | None = None, at_most: float | None = None, width: float
    ) -> Expression:
        """Return the probability that a result keeps limits: see `measures.probability`."""
        values, asked = self[name], _keeping(name, at_least, at_most, width)
        keeps = measures.probability(values, at_least=at_least, at_most=at_most, width=width)
        self.asked.append(asked)
        return keeps

    def require_probability(
        self,
        design: Design,
        requirement: str,
        name: str,
        probability: float,
        *,
        at_least: float | None = None,
        at_most: float | None = None,
        width: float,
        unit: str = "",
    ) -> None:
        """Require that a result keeps one limit with a probability, by the quantile that then keeps it.

        Args:
            design: the design that gets the requirement.
            requirement: what to call it in reports.
            name: of the result.
            probability: at least so much, between 0 and 1.
            at_least: lower limit, or None.
            at_most: upper limit, or None.
            width: over which a sample comes to count: see `measures.probability`.
            unit: of the result, for reports.

        Raises:
            InputError: not one limit, or a probability that cannot be.
        """
        check_kind("the design", design, Design, "a Design")
        if (at_least is None) == (at_most is None):
            raise InputError(f"'{requirement}': give one limit, at_least or at_most; two limits are two requirements")
        self.probability(name, at_least=at_least, at_most=at_most, width=width)
        if at_most is not None:
            keeps = measures.quantile(self[name], probability, width=width)
        else:
            keeps = -measures.quantile(-self[name], probability, width=width)
        design.require(requirement, keeps, at_least=at_least, at_most=at_most, unit=unit)

    def bound_from_above(
        self, design: Design, name: str, *, lower: float, upper: float, guess: float | None = None, unit: str = ""
    ) -> Expression:
        """Return a variable of the design that no sample's value of a result exceeds: minimised, the sharp worst case.

        It is called "worst NAME", and the requirement on it "NAME below its worst".

        Args:
            design: the design that gets the variable.
            name: of the result.
            lower: lower bound of the variable.
            upper: upper bound.
            guess: where it starts; by default its upper bound, below which all samples are then.
            unit: of the result, for reports.
        """
        check_kind("the design", design, Design, "a Design")
        values, start = self[name], upper if guess is None else guess
        bound = design.variable(f"worst {name}", guess=start, lower=lower, upper=upper, unit=unit)
        design.require(f"{name} below its worst", values - bound, at_most=0.0, unit=unit)
        self.asked.append(Asked(name, "largest of the samples", "largest", measures.worst, measures.worst))
        return bound

    @cached_property
    def responses(self) -> Responses:
        """The response as a function of numbers."""
        return Responses(self.response, self.samples.soil, self.samples.names)

    def values(self, at: Optimum | Mapping[str, float], samples: SoilSamples | None = None) -> dict[str, Vector]:
        """Return the results over samples, by default the common ones, at an optimum or a design by name.

        Raises:
            InputError: a soil has no results.
        """
        if samples is not None:
            check_kind("samples", samples, SoilSamples, "SoilSamples, as a SoilDistribution gives them")
        found = self.responses(at, self.samples if samples is None else samples)
        for number, reason in found.failures.items():
            raise InputError(f"sample {number} of the soil has no result: {reason}")
        return found.values

    def _ask(
        self, name: str, text: str, kind: Kind, measure: Callable[..., Expression], width: float = 0.0
    ) -> Expression:
        width = plain_number("width", width)
        rounded = partial(measure, width=width) if width else measure
        value = rounded(self[name])
        self.asked.append(Asked(name, text, kind, measure, rounded, width))
        return value


def _keeping(name: str, at_least: float | None, at_most: float | None, width: float) -> Asked:
    """Return the probability that a result keeps limits, as a measure."""
    sides = [f"{word} {plain_number(word, limit):.6g}" for word, limit in (("at least", at_least), ("at most", at_most))
             if limit is not None]  # fmt: skip
    keeps = partial(measures.probability, at_least=at_least, at_most=at_most)
    return Asked(
        name, f"probability of {' and '.join(sides)}", "probability", keeps, partial(keeps, width=width), width
    )


def _in_tail(measure: Callable[..., Expression], tail: Tail) -> Callable[..., Expression]:
    """Return a measure of the largest values, or the like of the smallest."""
    if tail == "upper":
        return measure

    def lower(values: Expression, **keywords: float) -> Expression:
        return -measure(-values, **keywords)

    return lower
