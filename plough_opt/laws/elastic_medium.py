"""The linear elastic medium as a law of resistance: the contact force of steady sliding on the equivalent cone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from plough_opt.laws.law import STEADY, ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.soil.elastic import cone_force


@dataclass(frozen=True)
class ElasticMedium(ResistanceLaw):
    """Linear elastic soil around the equivalent cone: `po.elastic.cone_force`, an order of magnitude.

    Holds below the shear wave's speed, for soil with Young's modulus and Poisson's ratio.
    """

    label = "the elastic medium"
    lacking: ClassVar[Mapping[str, str]] = STEADY | {
        "strength_wave": "has no strength and is solved for steady sliding only",
        "added_mass": "carries no soil along",
        "loosened_radius": "has no compaction front and loosens nothing",
        "cone_index": "has no strength",
        "entry": "is solved for steady sliding only",
        "uncertain": "has no strength",
        # The force is gauge; the pressure only keeps the contact.
        "ambient_pressure": "is computed in gauge pressure",
    }
    scalar = False
    slender = True

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return the contact force at the tow speed as F0."""
        return SoilReaction(static=cone_force(at.cone, at.soil, at.speed))

    def check(self, at: ShareInSoil) -> None:
        """Leave the domain to designs, which limit the speed by a requirement."""

    def warnings(self, at: ShareInSoil) -> tuple[str, ...]:
        """Return that the force is an order of magnitude."""
        return (
            "the elastic medium's force on a cone is an order of magnitude: strains on its face are of order one,"
            " and its dependence on the speed is not to be trusted",
            *super().warnings(at),
        )
