"""Scenes for other tools: C, a serialised CasADi Function, OpenMDAO, and an FMU; and shares as parts.

Each is imported when it is used.
"""

from typing import TYPE_CHECKING, Any

from plough_opt.exchange import export

if TYPE_CHECKING:
    from plough_opt.exchange.export import (
        PloughComponent,
        write_c,
        write_casadi,
        write_fmu,
        write_openmdao,
        write_part,
    )


def __getattr__(name: str) -> Any:
    """Import a format on first use."""
    return getattr(export, name)


__all__ = ["PloughComponent", "write_c", "write_casadi", "write_fmu", "write_openmdao", "write_part"]
