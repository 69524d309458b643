"""What can go wrong, each with a sentence that says what to do; all of them are `PloughError`."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class PloughError(Exception):
    """Base class of every error that the toolkit raises on purpose."""


class DomainError(PloughError, ValueError):
    """A value lies outside the domain in which the model's equations hold."""


class InputError(PloughError, ValueError):
    """An option, a name or a file is not what was expected."""


class IntegrationError(PloughError, RuntimeError):
    """The equation of motion could not be integrated; the message names scene, time and likely cause."""


class InfeasibleDesign(PloughError, RuntimeError):
    """No design meets all requirements; ``conflicts`` maps each requirement that fails to the shortfall.

    Attributes:
        conflicts: name of the requirement -> least violation, in the requirement's own unit.
        blockers: names of the requirements and bounds that stand against them.
    """

    def __init__(self, message: str, conflicts: dict[str, float], blockers: list[str]) -> None:
        # Exceptions are pickled by these arguments, for instance on their way back from a process of a pool.
        super().__init__(message, conflicts, blockers)
        self.conflicts = conflicts
        self.blockers = blockers

    def __str__(self) -> str:
        return str(self.args[0])


class NotConverged(PloughError, RuntimeError):
    """The optimiser stopped without an optimum; ``status`` is IPOPT's own word for why."""

    def __init__(self, message: str, status: str) -> None:
        super().__init__(message, status)
        self.status = status

    def __str__(self) -> str:
        return str(self.args[0])


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return a clause that suggests the nearest valid names, or lists them all when none is near."""
    names = sorted(valid)
    close = difflib.get_close_matches(str(name), names, n=2, cutoff=0.55)
    return f"did you mean {' or '.join(map(repr, close))}?" if close else f"valid names: {', '.join(names)}"
