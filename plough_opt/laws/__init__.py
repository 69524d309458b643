"""Resistance laws: the plastic gas and others, all implementations of one Protocol.

`LAWS` lists them by name, for problem files and ``Scene(medium=...)``.
"""

import dataclasses
from typing import Final

from plough_opt.core.checks import check_named, shown
from plough_opt.core.errors import InputError
from plough_opt.laws.cones import ElasticMedium, SphericalCavity
from plough_opt.laws.forces import PlasticGas
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.laws.tines import AsabeD497, McKyesAli, SwickPerumpral, UniversalEarthmoving

__all__ = [
    "LAWS", "AsabeD497", "ElasticMedium", "McKyesAli", "PlasticGas", "ResistanceLaw", "ShareInSoil", "SoilReaction",
    "SphericalCavity", "SwickPerumpral", "UniversalEarthmoving", "law_of",
]  # fmt: skip

LAWS: Final[dict[str, type[ResistanceLaw]]] = {
    "plastic": PlasticGas,
    "elastic": ElasticMedium,
    "asabe_d497": AsabeD497,
    "mckyes_ali": McKyesAli,
    "universal_earthmoving": UniversalEarthmoving,
    "swick_perumpral": SwickPerumpral,
    "spherical_cavity": SphericalCavity,
}
"""Name -> class of the law; if only the name is given, the law is created without arguments."""


def law_of(medium: str | ResistanceLaw) -> ResistanceLaw:
    """Return the law with a name, or a law itself.

    Raises:
        InputError: the name is unknown, or the argument is neither a name nor a law.

    Example:
        >>> import plough_opt as po
        >>> type(po.laws.law_of("mckyes_ali")).__name__
        'McKyesAli'
    """
    if isinstance(medium, str):
        check_named("no resistance law is named {}", medium, LAWS)
        return LAWS[medium]()
    if isinstance(medium, type) or not (dataclasses.is_dataclass(medium) and isinstance(medium, ResistanceLaw)):
        names = ", ".join(map(repr, LAWS))
        raise InputError(f"medium = {shown(medium)} must be a ResistanceLaw, such as McKyesAli(), or one of {names}")
    return medium
