"""Which variables a front scans for further local optima."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from plough_opt.design.exploring import Progress
from plough_opt.design.program import Program
from plough_opt.errors import InputError, nearest

__all__ = ["NEAR_GUESS", "SCAN_POINTS", "Progress", "scanned_variables"]

SCAN_POINTS = 200
"""Positions between the bounds at which a scanned variable is tried."""

NEAR_GUESS = "near"
"""Asks for no scan, and for the optimum of the basin in which the guess lies."""


def scanned_variables(program: Program, search: str | Sequence[str]) -> list[int]:
    """Return which variables to scan.

    Args:
        program: the design's program.
        search: ``"auto"``: those on which the stiffness of a run with a strength wave depends;
            ``"local"`` or ``"near"``: none; or names of variables.

    Raises:
        InputError: a name that is no variable.
    """
    names = [v.name for v in program.declared.variables]
    if search in ("local", NEAR_GUESS):
        return []
    if search != "auto":
        wanted = [search] if isinstance(search, str) else list(search)
        for name in wanted:
            if name not in names:
                known = nearest(name, ["auto", "local", NEAR_GUESS, *names])
                raise InputError(f"search = '{name}' is no variable of this design: {known}")
        return [names.index(name) for name in dict.fromkeys(wanted)]
    found: set[int] = set()
    for run in program.exact.runs:
        if run.integration.structure.wave:
            stiffness = run.inputs[run.integration.names.index("stiffness")]
            function = ca.Function("stiffness", program.declared.symbols(), [stiffness])
            found |= {k for k in range(len(names)) if function.jac_sparsity(0, k).nnz() > 0}
    return sorted(found)
