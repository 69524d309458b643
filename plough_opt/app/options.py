"""Options that several commands share, and options that are quantities with units."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit

_SHARED: Final[dict[str, dict[str, Any]]] = {
    "json": {"action": "store_true", "help": "print JSON (SI units) instead of a table"},
    "plot": {"metavar": "FILE", "help": "write a picture: .png, .svg or .pdf"},
    "csv": {"metavar": "FILE", "help": "write a table of all points"},
    "output": {"metavar": "FILE", "help": "write everything as JSON"},
    "seed": {"type": int, "default": 0, "metavar": "N", "help": "of the search's samples (default: 0)"},
}


def add_shared(verb: argparse.ArgumentParser, *names: str, **helps: str) -> None:
    """Add options that several commands have.

    Args:
        verb: the command.
        names: of the options.
        helps: option -> its help on this command, where it is another than elsewhere.
    """
    for name in (*names, *helps):
        own = {"help": helps[name]} if name in helps else {}
        verb.add_argument(f"--{name}", **(_SHARED[name] | own))


@dataclass(frozen=True)
class QuantityOption:
    """An option that is a quantity.

    Attributes:
        unit: its SI unit; None for a text.
        example: as the help shows it: a quantity with a unit, or what a text is.
        help: what it is.
        several: whether it may be given several times.
        argument: what the value is called in Python, if not like the option.
    """

    unit: str | None
    example: str
    help: str
    several: bool = False
    argument: str = ""


def add_quantities(verb: argparse.ArgumentParser, known: Mapping[str, QuantityOption]) -> None:
    """Add options that are quantities, by name."""
    for name, own in known.items():
        example = own.example if own.unit is None else f'"{own.example}"'
        verb.add_argument(f"--{name}", action="append" if own.several else "store", metavar=example, help=own.help)


def given_quantities(options: argparse.Namespace, known: Mapping[str, QuantityOption]) -> dict[str, Any]:
    """Return the options that are given, by argument, in SI units.

    Raises:
        InputError: an option that is not such a quantity.
    """
    found: dict[str, Any] = {}
    for name, own in known.items():
        written = getattr(options, name.replace("-", "_"))
        if written is None:
            continue
        try:
            value = written if own.unit is None else _parsed(Unit(own.unit), written)
        except InputError as error:
            raise InputError(f"--{name} {error}") from None
        found[own.argument or name.replace("-", "_")] = value
    return found


def _parsed(unit: Unit, written: str | list[str]) -> float | list[float]:
    return [unit.parse(text) for text in written] if isinstance(written, list) else unit.parse(written)
