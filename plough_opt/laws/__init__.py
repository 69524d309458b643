"""Resistance laws: the plastic gas and others, all implementations of one Protocol; `LAWS` lists them by name."""

from plough_opt.laws.asabe import AsabeD497
from plough_opt.laws.cones import ElasticMedium, SphericalCavity
from plough_opt.laws.forces import PlasticGas
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.laws.registry import LAWS
from plough_opt.laws.tines import McKyesAli, SwickPerumpral, UniversalEarthmoving
from plough_opt.laws.wedge import Tine

__all__ = [
    "LAWS",
    "AsabeD497",
    "ElasticMedium",
    "McKyesAli",
    "PlasticGas",
    "ResistanceLaw",
    "ShareInSoil",
    "SoilReaction",
    "SphericalCavity",
    "SwickPerumpral",
    "Tine",
    "UniversalEarthmoving",
]
