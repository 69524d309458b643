"""A local optimum, and the record of the search that found it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from plough_opt.core.equality import ByValue
from plough_opt.core.errors import printable
from plough_opt.core.files import drawn
from plough_opt.core.plain_data import Array, MaybeInfinite
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import Display, customary
from plough_opt.design.tolerance import Spread

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


def expected_unseen(followed: int, reached: int) -> float | None:
    """Return the expected number of basins not found, by the rule in `Search`; None if too few designs were followed.

    Args:
        followed: number of random designs that were followed to their basins.
        reached: number of basins to which they led.
    """
    return reached * (reached + 1) / (followed - reached - 2) if followed > reached + 2 else None


@dataclass(frozen=True, eq=False)
class Search(ByValue):
    """A record of a search.

    It estimates how many basins were missed, with the Bayesian rule of Boender and Rinnooy Kan, "Bayesian stopping
    rules for multistart global optimization methods", Mathematical Programming 37 (1987): if N uniformly random
    designs lead to w different basins, w (w + 1)/(N - w - 2) further basins are expected, with a share
    w (w + 1)/(N (N - 1)) of the volume of all designs. Descents are rough, so both numbers are approximate.

    Attributes:
        asked: extent of the search, as given to `Design.solve`.
        variables: names of the variables that were searched.
        designs: number of designs tried; 0 if only the basin of the guess was solved.
        one_by_one: whether runs were integrated one by one, which leaves time for few designs.
        basins: number of basins found.
        polished: number of basins that were optimised.
        followed: number of random designs that were followed to their basins, N.
        reached: number of basins to which they led, w.
        seed: seed of the sample.
        seconds: time that the search took [s].
        values: sample: a row for each design, a column for each variable, in SI units.
        objective: sample: objective of each design, NaN if it has no value.
        violation: sample: sum of the largest violation of each requirement, in parts of its limit's size; infinite if a
            design has no value.
        slow: why the sampled runs were not compiled, or "".
    """

    asked: str
    variables: tuple[str, ...]
    designs: int
    one_by_one: bool
    basins: int
    polished: int
    followed: int
    reached: int
    seed: int
    seconds: float
    values: Array
    objective: Array
    violation: Array
    slow: str = ""

    @property
    def unseen_basins(self) -> float | None:
        """Expected number of basins not found; None if too few designs were followed for an estimate."""
        return expected_unseen(self.followed, self.reached)

    @property
    def unseen_volume(self) -> float | None:
        """Expected share of designs that lead to basins not found; None if too few were followed for an estimate."""
        n, w = self.followed, self.reached
        return w * (w + 1) / (n * (n - 1)) if n > w + 2 else None

    def __str__(self) -> str:
        """Return in a few sentences what was searched and what may have been missed."""
        if not self.designs:
            return "Only the basin of the guess was searched."
        over = printable(", ".join(self.variables))
        text = f"{self.designs} designs tried over {over}: {self.basins} basin{'s' if self.basins != 1 else ''} found"
        if self.polished < self.basins:
            text += f", of which the {self.polished} that could be best were optimised"
        if self.slow:
            text += f" ({self.slow}: with a compiler the search would take a fraction of the time)"
        if self.unseen_basins is None:
            why = (
                f"{self.followed} random designs, which led to {self.reached} of them, are too few"
                if self.followed
                else "no random design was followed to its basin"
            )
            return f"{text}. The number of further basins cannot be estimated: {why}."
        return (
            f"{text}. {self.followed} random designs led to {self.reached} of them, so about"
            f" {self.unseen_basins:.2g} more are expected, in {100.0 * (self.unseen_volume or 0.0):.2g} % of the volume"
            " (approximate, by the rule of Boender and Rinnooy Kan)."
        )


# A margin below this part of the limit's size is the optimiser's rounding.
_NO_MARGIN = 1e-9


@dataclass(frozen=True)
class Limit:
    """A requirement or bound at a design.

    Attributes:
        name: as declared.
        kind: "requirement" or "bound".
        value: worst value of the limited expression, in ``unit``.
        limits: the limits in words.
        margin: distance of the worst value from its limit, positive inside, in ``unit``.
        multiplier: decrease of the objective per unit by which the limit is loosened.
        active: whether the limit decides the design: it has a multiplier and no appreciable margin.
        unit: SI unit.
        display: unit in reports.
        low: lower limit, in ``unit``, or None.
        high: upper limit, in ``unit``, or None.
    """

    name: str
    kind: str
    value: float
    limits: str
    margin: float
    multiplier: float
    active: bool
    unit: str
    display: Display | None = None
    low: float | None = None
    high: float | None = None

    @property
    def shown(self) -> Display:
        """The unit of value, limits and margin in reports."""
        return self.display or customary(self.unit, self.value)

    @property
    def rounded(self) -> float:
        """The value, in ``unit``; if the limit is active, the limit itself, without the optimiser's rounding."""
        ends = [end for end in (self.low, self.high) if end is not None]
        return min(ends, key=lambda end: abs(end - self.value)) if self.active and ends else self.value

    def margin_text(self) -> str:
        """Return the margin with its unit; 0 if it is only the optimiser's rounding."""
        rounding = self.active or abs(self.margin) < _NO_MARGIN * max(1.0, abs(self.value))
        return self.shown.text(0.0 if rounding else self.margin)


@dataclass(frozen=True, repr=False, eq=False)
class LocalOptimum(Saveable):
    """A local optimum.

    Attributes:
        name: distinct name: the branch under a strength wave, and the place in the order.
        objective: objective by tight integration.
        variables: name -> value, SI units.
        limits: every requirement and every variable's bounds.
        gap: relative difference between the optimiser's objective and the tightly integrated one.
        error_estimate: relative difference between two tight integrations of the objective by different methods.
        iterations: number of IPOPT's iterations.
        spread: objective and margins within the tolerances; None for runs with events and orbits, which take too long.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> best.local_optima[0].active
        ('half of it',)
    """

    name: str
    objective: float
    variables: dict[str, float]
    limits: tuple[Limit, ...]
    gap: float
    error_estimate: MaybeInfinite
    iterations: int
    spread: Spread | None = None
    kind = "local optimum"

    def page(self) -> Page:
        """Return the design as tables: variables with their bounds, and requirements with their margins."""
        return Page(f"{self.name}: objective {self.objective:.9g}", self.design_tables())

    def design_tables(self) -> tuple[Grid, ...]:
        """Return a table of the variables and, if there are requirements, a table of these."""
        bounds = Grid.of("", "variable", "best", "bounds", "", mark="")
        required = Grid.of("Requirements", "requirement", "limits", "value", "margin", "", mark="")
        for one in self.limits:
            if one.kind == "bound":
                bounds.row(one.name, one.shown.text(one.rounded, 7), one.limits, "at its bound" if one.active else "")
            else:
                value, decides = one.shown.text(one.value), "decides" if one.active else ""
                required.row(one.name, one.limits, value, one.margin_text(), decides)
        return (bounds, required) if required.rows else (bounds,)

    def display(self, name: str) -> Display:
        """Return the unit of a variable in reports."""
        own = (one.shown for one in self.limits if one.kind == "bound" and one.name == name)
        return next(own, Display("", 1.0))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a table with a row for each variable and requirement in SI; ``attrs["units"]`` has the units by name.

        Raises:
            InputError: pandas is not installed.
        """
        names = ("name", "kind", "value", "limits", "margin", "multiplier", "active", "unit")
        frame = data_frame({name: [getattr(one, name) for one in self.limits] for name in names}, {})
        frame.attrs["units"] = {one.name: one.unit for one in self.limits}
        return frame

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw the variables between their bounds.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the file name has no known ending, or the file cannot be written.
        """
        return drawn("plot_designs", {self.name: self}, target=target)

    @property
    def margins(self) -> dict[str, float]:
        """Margin of each requirement, positive inside, in its unit."""
        return {limit.name: limit.margin for limit in self.limits if limit.kind == "requirement"}

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the requirements and variables with an active limit."""
        return tuple(limit.name for limit in self.limits if limit.active)
