"""Optimum: the best design found, the limits that decide it, the search, and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from plough_opt.core.checks import mapping_of
from plough_opt.core.errors import InfeasibleDesign, InputError, printable, short
from plough_opt.core.expressions import ByValue, is_casadi, map_expressions
from plough_opt.core.files import drawn
from plough_opt.core.plain_data import Array, MaybeInfinite, Unsaved
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, Part, data_frame
from plough_opt.core.units import OBJECTIVE_DIGITS, Display, customary, in_words
from plough_opt.design.confirmation import Spread
from plough_opt.design.declarations import values_in_words
from plough_opt.design.result.sensitivity import NO_PERCENTAGE, Sensitivity, Solved
from plough_opt.motion.run import Run, without_repetition
from plough_opt.motion.simulation import repeat

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


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
        n, w = self.followed, self.reached
        return w * (w + 1) / (n - w - 2) if n > w + 2 else None

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
            why = "no random design was followed to its basin"
            if self.followed:
                why = f"{self.followed} random designs, which led to {self.reached} of them, are too few"
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
        trivial: whether it is a limit of a law that is met by far, so that printed results leave it out.
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
    trivial: bool = False

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
        return self.shown.text(0.0 if rounding else self.margin, 3)


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
        """Return the design as tables: variables with their bounds, and requirements with their margins.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> [part.title for part in best.local_optima[0].page().parts]
            ['', 'Requirements']
        """
        return Page(f"{self.name}: objective {self.objective:.{OBJECTIVE_DIGITS}g}", self.design_tables())

    def design_tables(self) -> tuple[Grid, ...]:
        """Return a table of the variables and, if there are requirements, a table of these.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> best.local_optima[0].design_tables()[0].rows[0]
            ('height', '120 mm', '100 mm to 500 mm', '')
        """
        bounds = Grid.of("", "variable", "best", "bounds", "")
        required = Grid.of("Requirements", "requirement", "limits", "value", "margin", "")
        for one in self.limits:
            if one.kind == "bound":
                bounds.row(one.name, one.shown.result(one.rounded), one.limits, "at its bound" if one.active else "")
            elif not one.trivial:
                value, decides = one.shown.result(one.rounded), "decides" if one.active else ""
                required.row(one.name, one.limits, value, one.margin_text(), decides)
        return (bounds, required) if required.rows else (bounds,)

    def display(self, name: str) -> Display:
        """Return the unit of a variable in reports.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> best.local_optima[0].display("height").text(0.12)
            '120 mm'
        """
        bounds = {limit.name: limit.shown for limit in self.limits if limit.kind == "bound"}
        return bounds.get(name, Display("", 1.0))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a table with a row for each variable and requirement in SI; ``attrs["units"]`` has the units by name.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> best.local_optima[0].to_dataframe()["value"].round(6).tolist()
            [0.06, 0.12]
        """
        names = ("name", "kind", "value", "limits", "margin", "multiplier", "active", "unit")
        columns = {name: [getattr(one, name) for one in self.limits] for name in names}
        return data_frame(columns, {one.name: one.unit for one in self.limits})

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw the variables between their bounds.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the file name has no known ending, or the file cannot be written.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> len(best.local_optima[0].plot().axes)
            1
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


# A smaller fraction of designs as made that meet all requirements is pointed out.
_FEW_KEPT = 0.5
_WITHOUT_DESIGN = "this optimum was saved without its design: evaluate expressions before saving it, or solve again"


@dataclass(frozen=True, repr=False, eq=False)
class Optimum(LocalOptimum):
    """The best local optimum found. Called with any object of the design, it returns the object with numbers.

    ``best(share)``, ``best(scene)`` and ``best(run.mean_draft)`` replace expressions by their values, with the runs
    inside them integrated tightly; ``best(run)`` simulates the scene at the optimum.

    Attributes:
        status: "solved"; "not unique" if ``flat_directions`` lead to equally good designs; or "unconfirmed" if
            derivatives do not confirm that the best design found is an optimum, as on a kink (see ``warnings``).
        flat_directions: directions, as changes of the variables, along which objective and requirements do not change.
        local_optima: all distinct local optima that were found, best first, including this one.
        search: record of the search.
        seconds: time that the solve took [s].
        warnings: doubts and limits that a reader of the numbers must know.
        sensitivities: sensitivities to parameters and limits, if they were computed before the optimum was saved.
        bought: for a problem file with catalogues, the best design in their values.
        run: for a problem file, the numeric run at this design.
        origin: the question that this optimum answers.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> best.status
        'solved'
    """

    status: str = "solved"
    flat_directions: tuple[dict[str, float], ...] = ()
    local_optima: tuple[LocalOptimum, ...] = ()
    search: Search | None = None
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    solved: Annotated[Solved | None, Unsaved()] = field(repr=False, compare=False, default=None)
    sensitivities: tuple[Sensitivity, ...] = ()
    bought: Rounded | None = None
    run: Run | None = None
    origin: Origin = field(default=Origin())
    kind = "optimum"

    def __call__(self, item: Any) -> Any:
        """Return an expression, or an object with expressions nested in it, with numbers in their place.

        A single value becomes a float, a column an array. A run, alone or nested, is simulated and checked.

        Raises:
            InputError: an expression holds symbols that do not belong to this design.
            DomainError: the numbers lie outside the model's domain.
        """
        return map_expressions(item, self._with_numbers, lambda part: isinstance(part, Run) or is_casadi(part))

    def page(self) -> Page:
        """Return the best design as tables, with its response, the other optima, the search and the warnings.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise(height**2)
            >>> design.solve(search="near").page().heading
            'Best design: objective 0.01 (solved)'
        """
        parts: list[Part] = [*self.design_tables()]
        if self.run is not None:
            parts.insert(1, self.run.response())
        if self.bought is not None:
            parts += self.bought.comparison(self)
        if len(self.local_optima) > 1:
            parts.append(self.optima_table("Local optima found"))
        parts += map(self._free, self.flat_directions)
        parts += [self.spread.in_words()] if self.spread else []
        parts += [str(self.search)] if self.search else []
        trust = (
            f"gap of the objective to a tight integration {self.gap:.0e}, error estimate {self.error_estimate:.0e};"
            f" {self.seconds:.2f} s"
        )
        kept, moving = self.keeping(), () if self.run is None else self.run.warnings
        notes = (*([kept] if kept else []), *without_repetition([*self.warnings, *moving]))
        bought = "" if self.bought is None else f"; from the catalogue {self.bought.in_words()}"
        heading = f"Best design: objective {self.objective:.{OBJECTIVE_DIGITS}g} ({self.status}){bought}"
        return Page(heading, tuple(parts), notes, trust, self.origin.title)

    @property
    def cost_of_keeping(self) -> float | None:
        """Estimated rise of the objective if all designs within the tolerances must meet all requirements.

        It is the difference to the worst objective in the tolerance box, plus the multiplier of each requirement times
        the margin that the requirement loses in the box. None without a spread.
        """
        if self.spread is None:
            return None
        least, required = self.spread.margins, [limit for limit in self.limits if limit.kind == "requirement"]
        price = sum(limit.multiplier * max(0.0, limit.margin - least[limit.name]) for limit in required)
        return self.spread.worst - self.objective + price

    def keeping(self) -> str:
        """Return a sentence on requirements that few designs as made meet, without its full stop, or "".

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise((height - 0.3) ** 2)
            >>> design.solve(search="near").keeping()  # all designs as made meet all requirements
            ''
        """
        cost = self.cost_of_keeping
        if cost is None or self.spread is None or not self.spread.margins or self.spread.kept >= _FEW_KEPT:
            return ""
        # Other requirements may then decide, whose price is unknown.
        more = any(not one.active and self.spread.margins.get(one.name, 0.0) < 0.0 for one in self.limits)
        size = f"{100.0 * cost / abs(self.objective):.2g} %" if self.objective else f"{cost:.2g}"
        return (
            f"only {100.0 * self.spread.kept:.0f} % of the designs within the tolerances meet all requirements; to keep"
            f" them in all designs costs about {size}{' or' * more} more of the objective: tighten these limits"
        )

    def optima_table(self, title: str) -> Grid:
        """Return a table of all local optima, best first.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise(height**2)
            >>> design.solve(search="near").optima_table("Optima").rows
            [('optimum', '0.01', '0.0101208', '100 mm')]
        """
        grid = Grid.of(title, "", "objective", *(["as made"] if self.spread else []), *self.variables)
        for own in self.local_optima:
            made = [f"{own.spread.median:.6g}"] if own.spread else []
            cells = (self.display(name).result(value) for name, value in own.variables.items())
            grid.row(own.name, f"{own.objective:.{OBJECTIVE_DIGITS}g}", *made, *cells)
        return grid

    def _free(self, direction: Mapping[str, float]) -> str:
        """Return a sentence about a flat direction."""
        changed = ((name, "+" if x > 0 else "-", abs(x)) for name, x in direction.items() if x)
        moves = [f"{name} {sign}{self.display(name).text(size, 3)}" for name, sign, size in changed]
        fix = "this variable" if len(moves) == 1 else "one of these variables"
        return f"The optimum is not unique: nothing changes along {', '.join(moves)}. Fix {fix}."

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a table with a row for each local optimum, best first: objective and variables in SI units.

        The best from a catalogue has the last row. The column of a variable named as another column, such as
        "objective", is called "variable objective".

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise((height - 0.3) ** 2)
            >>> design.solve(search="near").to_dataframe().columns.tolist()
            ['optimum', 'objective', 'height']
        """
        rows: list[LocalOptimum] = [*(self.local_optima or (self,))]
        rows += [] if self.bought is None else [replace(self.bought, name="from the catalogue")]
        columns: dict[str, Any] = {"optimum": [own.name for own in rows], "objective": [own.objective for own in rows]}
        column = {name: f"variable {name}" if name in columns else name for name in self.variables}
        columns |= {column[name]: [own.variables[name] for own in rows] for name in self.variables}
        return data_frame(columns, {column[limit.name]: limit.unit for limit in self.limits if limit.kind == "bound"})

    def also_saved(self) -> dict[str, Any]:
        """Return the best design alone, as further content of a saved file."""
        return {"best": self.local_optima[0]} if self.local_optima else {}

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw share, response and search if the optimum has its run; else the variables between their bounds.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the file name has no known ending, or the file cannot be written.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise((height - 0.3) ** 2)
            >>> len(design.solve(search="near").plot().axes)
            1
        """
        if self.run is None:
            return super().plot(target)
        return drawn("plot_optimum", self, self.run, target=target)

    def sensitivity(self, name: str, *, check: bool = False) -> Sensitivity:
        """Return how the best objective and the best variables change with a parameter or a limit.

        These are derivatives of the optimum, as if the design were solved again. The multipliers give that of the
        objective; the linearised optimality conditions with the active limits give those of the variables, from exact
        second derivatives.

        Args:
            name: a parameter, such as "cohesion"; a bound, such as "stiffness lower"; or a requirement's limit, such as
                "loosened radius at_least". The requirement's name will do if it has only one limit.
            check: solve again on both sides of the value and report how much the derivatives differ.

        Raises:
            InputError: there is no such parameter or limit, or the optimum has no derivative: it is not unique, it does
                not curve, or its active limits are not independent.
            NotConverged: the active limits cannot be determined, or the check could not solve the design again.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near")
            >>> round(best.sensitivity("half of it").elasticity, 6)  # of (2 x)^2
            2.0
        """
        if self.solved is None and not check:
            for one in self.sensitivities:
                if one.name == name:
                    return one
        return self._unique().sensitivity(name, check=check)

    def every_sensitivity(self) -> tuple[Sensitivity, ...]:
        """Return the sensitivities to all parameters that matter and all active limits, largest elasticity first.

        Raises:
            InputError, NotConverged: as `sensitivity`.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> [found.name for found in design.solve(search="near").every_sensitivity()]
            ['half of it at_least']
        """
        return self.sensitivities or self._unique().every()

    def rounded(
        self, catalogues: Mapping[str, Any] | None = None, /, **more: float | str | Sequence[float | str]
    ) -> Rounded:
        """Return the best design with some variables restricted to values that can be bought or made.

        Fewer than 100,000 combinations of catalogue values are all evaluated, with the other variables as here and at a
        sample; for the 20 most promising combinations the other variables are optimised. With 100,000 or more,
        and for scenes with events, only the values just below and just above this optimum's are tried, and the other
        variables are optimised from here. `Rounded.combinations`, `Rounded.screened` and the printed text report this.
        The result is the best combination that meets all requirements, compared as optima are, with the cost of the
        rounding and everything that was tried.

        Args:
            catalogues: variable's name -> allowed values, or a step whose multiples are all allowed, as numbers in SI,
                texts such as "5 mm", or pint quantities:
                ``best.rounded({"stiffness": [4e4, 5e4, 6.3e4], "wedge angle": po.deg(1)})``.
            more: the same by keyword, with underscores for spaces: ``wedge_angle=po.deg(1)``.

        Raises:
            InputError: there is no such variable, or a catalogue has no value between the variable's bounds.
            InfeasibleDesign: no combination meets the requirements; the error lists the violations of each.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="62 mm")
            >>> design.minimise(height**2)
            >>> made = design.solve(search="near").rounded(height="10 mm")
            >>> made.variables
            {'height': 0.13}
        """
        if isinstance(self, Rounded):
            raise InputError("this optimum is rounded already")
        offered = {**mapping_of("catalogues", catalogues, "a variable's name -> its values"), **more}
        solved = self._with_design()
        assert solved.rounder is not None, "only rounded optima have none"
        found: Rounded = solved.rounder(solved, offered)
        return found

    def with_catalogues(self, catalogues: Mapping[str, Any]) -> Optimum:
        """Return the optimum with the best design in catalogue values beside it: see `rounded`.

        If none meets the requirements, a warning says so.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="62 mm")
            >>> design.minimise(height**2)
            >>> best = design.solve(search="near").with_catalogues({"height": "10 mm"})
            >>> best.bought.variables
            {'height': 0.13}
        """
        try:
            bought = self.rounded(catalogues)
        except InfeasibleDesign as error:
            return replace(self, warnings=(*self.warnings, f"nothing in the catalogue will do: {error}"))
        own = [f"from the catalogue: {text}" for text in bought.warnings if text not in self.warnings]
        return replace(self, bought=bought, warnings=(*self.warnings, *own))

    def _unique(self) -> Solved:
        if self.flat_directions:
            along = "; ".join(", ".join(name for name, change in d.items() if change) for d in self.flat_directions)
            raise InputError(f"the optimum is not unique and so has no sensitivities: fix one of {along}")
        return self._with_design()

    def _with_design(self) -> Solved:
        if self.solved is None:
            raise InputError(_WITHOUT_DESIGN)
        return self.solved

    def _with_numbers(self, item: Any) -> Any:
        if isinstance(item, Run):
            outputs = item.time.numel() - 1 if is_casadi(item.time) else len(item.time) - 1
            return repeat(self(item.scene), self(item.duration), outputs=outputs)
        value = self._with_design().evaluate(item)
        return float(value) if value.size == 1 else value


@dataclass(frozen=True)
class Choice:
    """A combination of catalogue values that was tried.

    Attributes:
        values: name of the variable -> value.
        objective: best objective with these values; None if no design with them meets the requirements.
        conflicts: name of the requirement that fails -> least violation, in its unit.
    """

    values: dict[str, float]
    objective: float | None
    conflicts: dict[str, float]


@dataclass(frozen=True, repr=False, eq=False)
class Rounded(Optimum):
    """An optimum some of whose variables are held at catalogue values.

    Attributes:
        fixed: names of these variables.
        unrounded: objective of the optimum that was rounded.
        tried: combinations for which the other variables were optimised, best first and infeasible ones last.
        combinations: number of combinations of catalogue values between the bounds.
        screened: number of combinations that were evaluated: all, or the neighbours of the optimum.
    """

    fixed: tuple[str, ...] = ()
    unrounded: float = 0.0
    tried: tuple[Choice, ...] = ()
    combinations: int = 0
    screened: int = 0
    kind = "rounded optimum"

    @property
    def cost(self) -> float:
        """Increase of the objective by the rounding."""
        return self.objective - self.unrounded

    @property
    def cost_percent(self) -> float:
        """Increase of the objective by the rounding, in per cent of the unrounded one; NaN if that is 0."""
        return 100.0 * self.cost / abs(self.unrounded) if self.unrounded else math.nan

    def in_words(self) -> str:
        """Return the objective with what the rounding costs, and the values from the catalogue."""
        values = (f"{name} {self.display(name).text(self.variables[name])}" for name in self.fixed)
        return f"{self.objective:.{OBJECTIVE_DIGITS}g} ({self.cost_in_words}) with {', '.join(values)}"

    @property
    def cost_in_words(self) -> str:
        """Change of the objective by the rounding: in per cent, if the unrounded one is not 0."""
        return f"{self.cost_percent:+.2g} %" if self.unrounded else f"{self.cost:+.2g}"

    def comparison(self, best: Optimum) -> tuple[Grid, str]:
        """Return a table of the values beside those of the unrounded optimum, and a sentence on the search."""
        grid = Grid.of("The best from the catalogue", "", "best", "from the catalogue", "")
        for name, value in self.variables.items():
            ends = (best.display(name).result(x) for x in (best.variables[name], value))
            grid.row(name, *ends, "catalogue" if name in self.fixed else "")
        objectives = (f"{x:.{OBJECTIVE_DIGITS}g}" for x in (self.unrounded, self.objective))
        grid.row("objective", *objectives, self.cost_in_words)
        infeasible = f"; {len(self.infeasible)} of them cannot meet the requirements" if self.infeasible else ""
        return grid, f"From the catalogue, {self._extent_of_search()}{infeasible}."

    @property
    def infeasible(self) -> tuple[Choice, ...]:
        """The combinations that cannot meet the requirements, whatever the values of the other variables."""
        return tuple(choice for choice in self.tried if choice.objective is None)

    def __str__(self) -> str:
        """Return in words the values chosen, their cost, the number of combinations tried, and infeasible ones."""
        units = {limit.name: limit.unit for limit in self.limits}
        side = "below" if self.cost < 0.0 else "above"
        cost = "as" if abs(self.cost_percent) < NO_PERCENTAGE else f"{abs(self.cost_percent):.3g} % {side}"
        text = (
            f"{values_in_words(self.variables, units)}: objective {self.objective:.{OBJECTIVE_DIGITS}g},"
            f" {cost} that of the optimum; {self._extent_of_search()}"
        )
        for choice in self.infeasible:
            fails = ", ".join(f"'{name}' fails by {in_words(x, units[name])}" for name, x in choice.conflicts.items())
            text += f"; {values_in_words(choice.values, units)} is infeasible: {fails or 'not solved'}"
        return printable(text)

    def check_saved(self) -> None:
        """Raise ValueError if a variable or a shortfall has no limit, which gives its unit."""
        named = {name for choice in self.tried for name in (*choice.values, *choice.conflicts)} | {*self.variables}
        if missing := named - {limit.name for limit in self.limits}:
            raise ValueError(f"at limits: there is none of {short(min(missing))!r}")

    def _extent_of_search(self) -> str:
        """Return in words how many combinations were evaluated and optimised."""
        if self.screened < self.combinations:
            return f"of {self.combinations} combinations only the {self.screened} next to the optimum were tried"
        if len(self.tried) < self.screened:
            return f"all {self.screened} combinations were evaluated and {len(self.tried)} of them optimised"
        return f"all {self.combinations} combinations were optimised" if self.combinations > 1 else "the only one"
