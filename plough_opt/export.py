"""Scenes for other tools: C, a serialised CasADi Function, OpenMDAO, and an FMU; and shares as parts.

Each is imported when it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plough_opt.exchange.export.c import write_c
    from plough_opt.exchange.export.fmu import write_fmu
    from plough_opt.exchange.export.openmdao import PloughComponent, write_openmdao
    from plough_opt.exchange.export.part import write_part
    from plough_opt.exchange.export.serialised import write_casadi

_MODULES = {
    "PloughComponent": "openmdao",
    "write_c": "c",
    "write_casadi": "serialised",
    "write_fmu": "fmu",
    "write_openmdao": "openmdao",
    "write_part": "part",
}


def __getattr__(name: str) -> Any:
    """Import a format on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module 'plough_opt.export' has no attribute '{name}'")
    return getattr(import_module(f"plough_opt.exchange.export.{_MODULES[name]}"), name)


__all__ = ["PloughComponent", "write_c", "write_casadi", "write_fmu", "write_openmdao", "write_part"]
