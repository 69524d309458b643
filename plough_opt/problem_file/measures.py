"""What a problem file can minimise or require, by name, with units that read quantities."""

from __future__ import annotations

from plough_opt import vocabulary
from plough_opt.units import Unit
from plough_opt.vocabulary import Measure

MEASURES: dict[str, Measure[Unit]] = {
    name: Measure(Unit(one.unit), one.of, one.everywhere, one.plastic) for name, one in vocabulary.MEASURES.items()
}
