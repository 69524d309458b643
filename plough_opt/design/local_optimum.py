"""A local optimum, and the record of the search that found it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.files import drawn
from plough_opt.core.saving import Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import Display, customary
from plough_opt.design.tolerance import Spread

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """A record of a search.

    How likely further basins are follows from N uniform designs that were followed to their basins, of which there are
    w, by the Bayesian rule of Boender and Rinnooy Kan, "Bayesian stopping rules for multistart global optimization
    methods", Mathematical Programming 37 (1987): w (w + 1)/(N - w - 2) basins are expected unseen, in the part
    w (w + 1)/(N (N - 1)) of the volume of all designs. Following is rough, so both are approximate.

    Attributes:
        asked: what was asked for, as `Design.solve` takes it.
        variables: names of the variables that were searched.
        designs: number of designs tried; 0 where only the basin of the guess was asked for.
        one_by_one: whether runs were integrated one by one, which leaves time for few designs.
        basins: basins found.
        polished: how many of them the optimiser went to the bottom of.
        followed: uniform designs that were followed, N.
        reached: basins that they led to, w.
        seed: of the sample.
        seconds: time that the search took [s].
        values: of the sample: a row for each design, a column for each variable of the design, SI units.
        objective: of the sample: objective, NaN where a design has no value.
        violation: of the sample: sum of what each requirement is violated by at its worst, in its limits' size;
            infinite where a design has no value.
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

    @property
    def unseen_basins(self) -> float | None:
        """Basins that are expected unseen, or None where too few designs were followed to say."""
        n, w = self.followed, self.reached
        return w * (w + 1) / (n - w - 2) if n > w + 2 else None

    @property
    def unseen_volume(self) -> float | None:
        """Part of the designs that are expected to lead to unseen basins, or None where too few were followed."""
        n, w = self.followed, self.reached
        return w * (w + 1) / (n * (n - 1)) if n > w + 2 else None

    def __str__(self) -> str:
        """Return in a few sentences what was done and what was not looked at."""
        if not self.designs:
            return "Only the basin of the guess was looked at."
        over = ", ".join(self.variables)
        text = f"{self.designs} designs tried over {over}: {self.basins} basin{'s' if self.basins != 1 else ''} found"
        if self.polished < self.basins:
            text += f", of which the {self.polished} that could be best were optimised"
        if self.unseen_basins is None:
            why = (
                f"{self.followed} designs drawn at random led to {self.reached} of them"
                if self.followed
                else "no design drawn at random was followed to its basin"
            )
            return f"{text}. How many more there may be is not estimated: {why}."
        return (
            f"{text}. {self.followed} designs drawn at random led to {self.reached} of them, by which about"
            f" {self.unseen_basins:.2g} more are expected, in {100.0 * (self.unseen_volume or 0.0):.2g} % of the volume"
            " (approximate, by the rule of Boender and Rinnooy Kan)."
        )


# Parts of a limit's size below which a margin is the optimiser's last rounding.
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
        multiplier: fall of the objective per unit by which the limit is loosened.
        active: whether the limit decides the design: no margin to speak of, and a multiplier.
        unit: unit.
        display: unit in which value, limits and margin are written.
        low: lower limit, in ``unit``, or None.
        high: upper limit, or None.
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
        """The unit in which value, limits and margin are written."""
        return self.display or customary(self.unit, self.value)

    @property
    def rounded(self) -> float:
        """The value, in ``unit``; of a limit that decides the limit itself, without the optimiser's last rounding."""
        ends = [end for end in (self.low, self.high) if end is not None]
        return min(ends, key=lambda end: abs(end - self.value)) if self.active and ends else self.value

    def margin_text(self) -> str:
        """Return the margin with its unit; 0 of a limit that decides, whose margin is the optimiser's last rounding."""
        none = self.active or abs(self.margin) < _NO_MARGIN * max(1.0, abs(self.value))
        return self.shown.text(0.0 if none else self.margin)


@dataclass(frozen=True, repr=False)
class LocalOptimum(Saveable):
    """One local optimum.

    Attributes:
        name: distinct from the others: its branch under a strength wave, and its place in the order.
        objective: objective of the tightly integrated model.
        variables: name -> value, SI units.
        limits: every requirement and every variable's bounds.
        gap: relative difference of the optimiser's own objective from the tightly integrated one.
        error_estimate: relative difference of two tight integrations of the objective, by different methods.
        iterations: of IPOPT.
        spread: objective and margins within the tolerances; None of runs with events and orbits, which take too long.

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
    error_estimate: float
    iterations: int
    spread: Spread | None = None
    kind = "local optimum"

    def page(self) -> Page:
        """Return the design as tables: variables with their bounds, requirements with their margins."""
        return Page(f"{self.name}: objective {self.objective:.9g}", self.design_tables())

    def design_tables(self) -> tuple[Grid, ...]:
        """Return a table of the variables, and where there are any one of the requirements."""
        bounds = Grid.of("", "variable", "best", "bounds", "", mark="")
        required = Grid.of("Requirements", "requirement", "limits", "value", "margin", "", mark="")
        for one in self.limits:
            if one.kind == "bound":
                bounds.row(one.name, one.shown.text(one.value, 7), one.limits, "at its bound" if one.active else "")
            else:
                value, decides = one.shown.text(one.value), "decides" if one.active else ""
                required.row(one.name, one.limits, value, one.margin_text(), decides)
        return (bounds, required) if required.rows else (bounds,)

    def display(self, name: str) -> Display:
        """Return the unit in which a variable is written."""
        own = (one.shown for one in self.limits if one.kind == "bound" and one.name == name)
        return next(own, Display("", 1.0))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each variable and each requirement, SI; ``attrs["units"]`` has the unit of each by name.

        Raises:
            InputError: pandas is not installed.
        """
        names = ("name", "kind", "value", "limits", "margin", "multiplier", "active", "unit")
        frame = data_frame({name: [getattr(one, name) for one in self.limits] for name in names}, {})
        frame.attrs["units"] = {one.name: one.unit for one in self.limits}
        return frame

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw where the variables lie between their bounds.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a file name without a known ending, or a place that cannot be written.
        """
        return drawn("plot_designs", {self.name: self}, target=target)

    @property
    def margins(self) -> dict[str, float]:
        """Margin of each requirement, positive inside, in its unit."""
        return {limit.name: limit.margin for limit in self.limits if limit.kind == "requirement"}

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the requirements and variables whose limits decide the design."""
        return tuple(limit.name for limit in self.limits if limit.active)
