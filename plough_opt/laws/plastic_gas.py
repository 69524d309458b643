"""The plastic gas as a law of resistance: equations (24)-(26) around the share's equivalent cone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from plough_opt.core.expressions import Expression
from plough_opt.laws.forces import loosened_radius, soil_reaction
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction


@dataclass(frozen=True)
class PlasticGas(ResistanceLaw):
    """Soil that is compacted behind a front and yields: F0, Fd, added mass and loosened radius, for any motion.

    Holds for a slender cone (half angle up to some 20 degrees, hypothesis of plane sections) wholly in the soil; no
    working depth, free surface or shank enters.
    """

    label = "the plastic gas"
    lacking: ClassVar[Mapping[str, str]] = {}
    slender = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return `soil_reaction` of the equivalent cone."""
        return soil_reaction(at.cone, at.soil)

    def loosened_radius(self, at: ShareInSoil) -> Expression:
        """Return the radius of the compaction front at the base [m]."""
        return loosened_radius(at.cone, at.soil)

    def warnings(self, at: ShareInSoil) -> tuple[str, ...]:
        """Return what is to be said of the soil's numbers and of a blunt share."""
        return (*at.soil.warnings(), *super().warnings(at))
