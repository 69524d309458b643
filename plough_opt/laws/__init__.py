"""Resistance laws: the plastic gas and others, all instances of one Protocol, by name in `LAWS`."""

from plough_opt.laws.asabe import AsabeD497
from plough_opt.laws.elastic_medium import ElasticMedium
from plough_opt.laws.godwin import UniversalEarthmoving
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.laws.mckyes_ali import McKyesAli
from plough_opt.laws.plastic_gas import PlasticGas
from plough_opt.laws.registry import LAWS
from plough_opt.laws.spherical_cavity import SphericalCavity
from plough_opt.laws.swick_perumpral import SwickPerumpral
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
