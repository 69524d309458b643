"""The values that variables may take in a catalogue or in steps, and how many combinations of them there are."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plough_opt.core.checks import NOT_NUMBERS, shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.units import in_words
from plough_opt.design.declarations import Variable

Catalogue = float | Sequence[float]
"""Values that a variable may take, or the step of which it may take multiples."""

# The optimiser stops this near a bound; a value of the catalogue this near is the optimum's own.
_ITSELF = 1e-6
_ROUNDING = 1e-12
# Multiples of a step beyond which they are not told apart in floating point.
_MOST_MULTIPLES = 1e15


@dataclass(frozen=True)
class Allowed:
    """The values that a variable may take between its bounds.

    Attributes:
        number: of the variable.
        variable: the variable.
        offered: the catalogue's values between the bounds, rising; or multiples of ``step`` by number.
        step: of which multiples are allowed; 0 of a catalogue.
    """

    number: int
    variable: Variable
    offered: Sequence[float] | range
    step: float = 0.0

    @property
    def count(self) -> int:
        """Number of values."""
        return len(self.offered)

    def values(self) -> list[float]:
        """Return all values, rising."""
        return self._at(self.offered)

    def beside(self, optimum: float) -> list[float]:
        """Return the nearest values at or below and at or above an optimum's."""
        v, near = self.variable, self.offered
        if self.step:
            below = math.floor(optimum / self.step) - 1 - self.offered[0]
            near = self.offered[max(0, min(int(below), self.count - 1)) :][:5]
        inside = self._at(near)
        itself = min(inside, key=lambda x: abs(x - optimum))
        if abs(itself - optimum) <= _ITSELF * (v.upper - v.lower):
            return [itself]
        lower, higher = [x for x in inside if x < optimum], [x for x in inside if x > optimum]
        return [*lower[-1:], *higher[:1]]

    def _at(self, offered: Sequence[float] | range) -> list[float]:
        v = self.variable
        return [min(max(self.step * k, v.lower), v.upper) for k in offered] if self.step else list(offered)


def allowed(variables: Sequence[Variable], catalogues: Mapping[str, Catalogue]) -> list[Allowed]:
    """Return the values that variables may take.

    Args:
        variables: of the design.
        catalogues: for each variable to round, by name, its values or step.

    Raises:
        InputError: no catalogue, no such variable, no numbers, or none between the variable's bounds.
    """
    if not catalogues:
        raise InputError("nothing to round: give a catalogue or a step, like best.rounded(stiffness=[4e4, 5e4])")
    found: dict[int, Allowed] = {}
    for name, catalogue in catalogues.items():
        number = _number_of(variables, name)
        if number in found:
            raise InputError(f"'{variables[number].name}' is given two catalogues: give one")
        found[number] = _allowed(number, variables[number], catalogue)
    return list(found.values())


def _number_of(variables: Sequence[Variable], name: str) -> int:
    """Return the number of a variable by its name, or by that as a keyword: ``wedge_angle`` for "wedge angle"."""
    names = [v.name for v in variables if not v.auxiliary]
    if name in names:
        return names.index(name)
    short = ["".join(c if c.isalnum() else "_" for c in own.rpartition(".")[2]) for own in names]
    if short.count(name) != 1:
        raise InputError(f"'{name}' is not a variable of this design: {nearest(name, names)}")
    return short.index(name)


def _allowed(number: int, v: Variable, catalogue: Catalogue) -> Allowed:
    try:
        values = np.atleast_1d(np.asarray(catalogue, dtype=float)).ravel()
    except NOT_NUMBERS:
        values = np.array([])
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(f"the catalogue of '{v.name}' must hold finite numbers, not {shown(catalogue)}")
    # By how much a value may be beyond a bound and still be the bound.
    reserve = _ROUNDING * (v.upper - v.lower)
    if np.ndim(catalogue) == 0:
        step = float(values[0])
        if step <= 0.0:
            raise InputError(f"the step of '{v.name}' must be above 0, not {step:g}")
        if max(abs(v.lower), abs(v.upper)) / _MOST_MULTIPLES > step:
            raise InputError(f"the step {step:g} of '{v.name}' is too small to count to its bounds: take a larger one")
        first, last = math.ceil((v.lower - reserve) / step), math.floor((v.upper + reserve) / step)
        found = Allowed(number, v, range(first, last + 1), step)
    else:
        inside = values[(values >= v.lower - reserve) & (values <= v.upper + reserve)]
        found = Allowed(number, v, tuple(np.unique(np.clip(inside, v.lower, v.upper)).tolist()))
    if not found.count:
        raise InputError(
            f"no value that '{v.name}' may take lies between its bounds {in_words(v.lower, v.unit)} and"
            f" {in_words(v.upper, v.unit)}: offer one that does, or widen the bounds"
        )
    return found
