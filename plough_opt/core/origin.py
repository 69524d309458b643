"""Origin: what made a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from plough_opt.core.units import Display, customary


@dataclass(frozen=True)
class Origin:
    """What made a result; of one that Python made without a title nothing is known.

    Attributes:
        title: of the question.
        displays: key or result -> unit in which the question writes it.
    """

    title: str = ""
    displays: Mapping[str, Display] = field(default_factory=dict)

    def display(self, name: str, unit: str, *values: float) -> Display:
        """Return the unit in which a quantity or a result is shown: the question's, else the customary one.

        Args:
            name: key of the quantity, or the result.
            unit: its SI unit.
            values: all that stand beside each other, SI.
        """
        return self.displays.get(name) or customary(unit, *values)

    def common(self, unit: str, values: Mapping[str, float]) -> Display:
        """Return the one unit of results of a kind, that stand beside each other: the first that the question writes.

        Args:
            unit: SI unit.
            values: result -> value, SI.
        """
        written = (self.displays[name] for name in values if name in self.displays)
        return next(written, None) or customary(unit, *values.values())
