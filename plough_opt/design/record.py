"""A record of what a search did: designs tried, basins found, and how likely there are more."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
