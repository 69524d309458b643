"""Scenes for other tools: C, a serialised CasADi Function, OpenMDAO, an FMU; and shares as parts.

Each is imported when it is used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plough_opt.exchange.export.c import write_c
    from plough_opt.exchange.export.fmu import write_fmu
    from plough_opt.exchange.export.openmdao import PloughComponent, write_openmdao
    from plough_opt.exchange.export.part import write_part
    from plough_opt.exchange.export.serialised import write_casadi

_LATER = {
    "PloughComponent": "plough_opt.exchange.export.openmdao",
    "write_c": "plough_opt.exchange.export.c",
    "write_casadi": "plough_opt.exchange.export.serialised",
    "write_fmu": "plough_opt.exchange.export.fmu",
    "write_openmdao": "plough_opt.exchange.export.openmdao",
    "write_part": "plough_opt.exchange.export.part",
}


def __getattr__(name: str) -> Any:
    """Import a name of ``_LATER`` on first use."""
    import importlib

    if name not in _LATER:
        raise AttributeError(f"module 'plough_opt.exchange.export' has no attribute '{name}'")
    return getattr(importlib.import_module(_LATER[name]), name)


__all__ = ["PloughComponent", "write_c", "write_casadi", "write_fmu", "write_openmdao", "write_part"]
