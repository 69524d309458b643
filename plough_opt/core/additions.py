"""Additions from outside the package: modules that installed packages name, for the command line and for sweeps."""

from importlib.metadata import entry_points
from typing import Final

from plough_opt.core.errors import InputError

GROUP: Final = "plough_opt"
"""Group of entry points, as ``[project.entry-points.plough_opt]`` in a package's pyproject.toml names it."""


def load_additions() -> None:
    """Import every module that an installed package names as an addition: it adds itself to a registry.

    Raises:
        InputError: one cannot be imported; the message names it, its package and the reason.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist is not None else "an installed package"
            raise InputError(
                f"the addition '{entry.name}' = {entry.value} of {package} cannot be imported"
                f" ({type(error).__name__}: {error}): mend it, or uninstall {package}"
            ) from error
