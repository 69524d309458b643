"""The options of a comparison with other draft models, read from quantities with units."""

import argparse
from typing import Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit

# Option -> argument of `compare` and its unit; None: text as it is.
_ARGUMENTS: Final[dict[str, tuple[str, str | None]]] = {
    "depth": ("depth", "m"),
    "speed": ("speeds", "m/s"),
    "width": ("width", "m"),
    "rake": ("rake_angle", "rad"),
    "adhesion": ("adhesion", "Pa"),
    "surcharge": ("surcharge", "Pa"),
    "rupture-ratio": ("rupture_ratio", ""),
    "texture": ("texture", None),
    "point": ("point", None),
}


def asked_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of the comparison that the command line asks for.

    Raises:
        InputError: an option that is no such quantity, or one that is given without ``--against``.
    """
    given = {name: getattr(options, name.replace("-", "_")) for name in (*_ARGUMENTS, "plot")}
    given = {name: written for name, written in given.items() if written is not None}
    if given and not options.against:
        raise InputError(f"--{next(iter(given))} belongs to a comparison: add --against")
    given.pop("plot", None)
    return {_ARGUMENTS[name][0]: _value(name, written) for name, written in given.items()}


def _value(name: str, written: str | list[str]) -> Any:
    unit = _ARGUMENTS[name][1]
    if unit is None:
        return written
    try:
        if isinstance(written, list):
            return [Unit(unit).parse(text) for text in written]
        return Unit(unit).parse(written)
    except InputError as error:
        raise InputError(f"--{name} {error}") from None
