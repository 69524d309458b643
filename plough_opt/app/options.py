"""Options that several commands share, and options whose values are quantities with units."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit

_SHARED: Final[dict[str, dict[str, Any]]] = {
    "json": {"action": "store_true", "help": "print JSON (SI units) instead of a table"},
    "plot": {"metavar": "FILE", "help": "write a picture: .png, .svg or .pdf"},
    "csv": {"metavar": "FILE", "help": "write a table of all points as CSV"},
    "output": {"metavar": "FILE", "help": "write the whole result as JSON"},
    "seed": {"type": int, "default": 0, "metavar": "N", "help": "seed of the search's samples (default: 0)"},
}


def add_shared(verb: argparse.ArgumentParser, *names: str, **helps: str) -> None:
    """Add options that several commands share.

    Args:
        verb: the parser of the command.
        names: names of options with their usual help.
        helps: option -> help text for this command.
    """
    for name in (*names, *helps):
        own = {"help": helps[name]} if name in helps else {}
        verb.add_argument(f"--{name}", **(_SHARED[name] | own))


def add_option(verb: argparse.ArgumentParser, name: str, value: str, text: str, **more: Any) -> None:
    """Add an option with a value.

    Args:
        verb: the parser of the command.
        name: name of the option.
        value: placeholder of its value in the help.
        text: its help text.
        more: further arguments of ``add_argument``.
    """
    verb.add_argument(f"--{name}", metavar=value, help=text, **more)


@dataclass(frozen=True)
class QuantityOption:
    """An option whose value is a quantity with a unit, or a plain text.

    Attributes:
        unit: SI unit; None for a plain text.
        example: placeholder in the help: a quantity with a unit, or the name of a plain text.
        help: its help text.
        several: whether it may be given several times.
        argument: name of the value in Python, if it differs from the option's.
    """

    unit: str | None
    example: str
    help: str
    several: bool = False
    argument: str = ""


def add_quantities(verb: argparse.ArgumentParser, known: Mapping[str, QuantityOption]) -> None:
    """Add options whose values are quantities; ``known`` maps names to options."""
    for name, own in known.items():
        example = own.example if own.unit is None else f'"{own.example}"'
        add_option(verb, name, example, own.help, action="append" if own.several else "store")


def given_quantities(options: argparse.Namespace, known: Mapping[str, QuantityOption]) -> dict[str, Any]:
    """Return name in Python -> value in SI, of the quantity options that are given.

    Raises:
        InputError: the value of an option is not a quantity of its unit.
    """
    found: dict[str, Any] = {}
    for name, own in known.items():
        written = getattr(options, name.replace("-", "_"))
        if written is None:
            continue
        texts = written if own.several else [written]
        try:
            parsed = [text if own.unit is None else Unit(own.unit).parse(text) for text in texts]
        except InputError as error:
            raise InputError(f"--{name} {error}") from None
        found[own.argument or name.replace("-", "_")] = parsed if own.several else parsed[0]
    return found
