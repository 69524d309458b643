"""The table of results of numeric runs, one or several side by side."""

from collections.abc import Mapping
from typing import Any, Final

from plough_opt.core.kept import Origin
from plough_opt.core.tables import Grid

# Peaks -> the names under which files limit them, and write their units.
_LIMITED: Final = {"peak_force": "mount_force", "peak_deflection": "deflection"}


def response_table(runs: Mapping[str, Any], origin: Origin) -> Grid:
    """Return the table of results of numeric runs side by side, each row in one unit: see `Origin`.

    Args:
        runs: heading of a column -> run; of several the sum stands behind them, of what adds up.
        origin: of the runs.
    """
    every, several = [*runs.values()], len(runs) > 1
    scenes = [run.scene for run in every]
    names = {
        "N": ("mean_draft", "force_rms", "peak_force"),
        "m": ("peak_deflection", "mean_deflection", "displacement_rms"),
        "W": ("tow_power",),
    }
    units = {
        unit: origin.common(unit, {_LIMITED.get(name, name): max((_result(run, name) for run in every), key=abs)
                                   for name in own})
        for unit, own in names.items()
    }  # fmt: skip
    grid = Grid.of("Response", "", *runs, *(["together"] if several else []))

    def row(label: str, name: str, unit: str, adds: bool = False) -> None:
        values = [_result(run, name) for run in every]
        shown = units.get(unit) or origin.common(unit, {name: max(values, key=abs)})
        together = [shown.text(sum(values)) if adds else ""] if several else []
        grid.row(label, *map(shown.text, values), *together)

    row("mean draft", "mean_draft", "N", adds=True)
    row("RMS of the mount force", "force_rms", "N")
    row("mean deflection", "mean_deflection", "m")
    row("RMS of the deflection", "displacement_rms", "m")
    row("tow power", "tow_power", "W", adds=True)
    if all(scene.effects.random_strength is not None for scene in scenes):
        row("stationary RMS of the mount force", "stationary_force_rms", "N")
        row("stationary RMS of the deflection", "stationary_displacement_rms", "m")
    if not any(scene.law.lacks("loosened_radius") for scene in scenes):
        row("draft per loosened section", "specific_draft", "Pa")
        row("loosened radius", "loosened_radius", "m")
    row("peak mount force", "peak_force", "N")
    row("peak deflection", "peak_deflection", "m")
    if all(scene.effects.orbit == "periodic" for scene in scenes):
        comes = {True: "comes to this orbit", False: "comes to another motion", None: "has not settled"}
        rest = [""] if several else []
        grid.row("largest Floquet multiplier", *(f"{max(map(abs, run.floquet)):.4g}" for run in every), *rest)
        grid.row("a share from equilibrium", *(comes[run.settles.orbit] for run in every), *rest)
    return grid


def _result(run: Any, name: str) -> float:
    return float(getattr(run if hasattr(type(run), name) else run.scene, name))
