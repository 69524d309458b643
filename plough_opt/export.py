"""Exports to other tools: scenes as C, JavaScript, CasADi Functions, OpenMDAO components and FMUs; shares as solids.

OpenMDAO is imported on first use.
"""

from typing import TYPE_CHECKING, Any

from plough_opt.core.errors import InputError
from plough_opt.exchange.export.c import write_c, write_casadi
from plough_opt.exchange.export.fmu import write_fmu
from plough_opt.exchange.export.javascript import write_javascript
from plough_opt.exchange.export.part import write_part

if TYPE_CHECKING:
    from plough_opt.exchange.export.openmdao import PloughComponent, write_openmdao

__all__ = [
    "PloughComponent", "write_c", "write_casadi", "write_fmu", "write_javascript", "write_openmdao", "write_part",
]  # fmt: skip


class _NotInstalled(InputError, AttributeError):
    """A name of this module needs a library that is not installed; for `hasattr` there is no such name."""


def __getattr__(name: str) -> Any:
    """Return a name that needs OpenMDAO, imported on first use."""
    if name not in __all__:
        raise AttributeError(f"module 'plough_opt.export' has no attribute '{name}'")
    try:
        from plough_opt.exchange.export import openmdao
    except InputError as missing:
        raise _NotInstalled(str(missing)) from None
    return getattr(openmdao, name)
