"""What a problem file can minimise or require, by name, with units that read quantities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from plough_opt import vocabulary
from plough_opt.expressions import Expression
from plough_opt.motion import Run
from plough_opt.problem_file.units import Unit


@dataclass(frozen=True)
class Measure:
    """A result of a run that a file can name.

    Attributes:
        unit: SI unit.
        of: run -> value, a column where ``everywhere``.
        everywhere: a value at every output time; it can be limited, and not minimised.
        plastic: belongs to the plastic gas alone.
    """

    unit: Unit
    of: Callable[[Run], Expression]
    everywhere: bool = False
    plastic: bool = False


MEASURES: dict[str, Measure] = {
    name: Measure(Unit(one.unit), one.of, one.everywhere, one.plastic) for name, one in vocabulary.MEASURES.items()
}
