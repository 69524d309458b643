"""Results of a run over time as panels, for pictures and for the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.files import COLOURS, CONSTANT
from plough_opt.core.units import Display
from plough_opt.motion import Run
from plough_opt.motion.equation import GAP, STICK, Structure, parameters
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Polygon

    from plough_opt.design import Limit

SHARE, LIMIT, SOIL, STRUT = COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[6]
"""Colours in every picture: the share's motion and force, limits, the soil, and the strut."""


@dataclass(frozen=True)
class Panel:
    """Results of a run over time that share one pair of axes, in a picture or on a page.

    Attributes:
        name: name of the quantity, such as "force".
        unit: the unit in which it is shown.
        lines: label -> (values in SI, colour, whether the line is dashed), the most important first.
        limits: (name, value in SI) of each limit.
        mean: (name, mean in SI, RMS about the mean in SI), or None.
    """

    name: str
    unit: Display
    lines: dict[str, tuple[NDArray[np.float64], str, bool]]
    limits: Sequence[tuple[str, float]]
    mean: tuple[str, float, float] | None = None

    @property
    def changes(self) -> bool:
        """Whether any line changes over time."""
        return any(np.ptp(values) > CONSTANT * np.max(np.abs(values)) for values, _, _ in self.lines.values())


def force_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return mount force and soil resistance over time, with mean draft, its RMS, and limits."""
    draft, deviation = float(run.mean_draft), float(run.force_rms)
    unit = run.origin.common("N", {"mount_force": run.peak_force, "mean_draft": draft})
    lines = {"mount force": (run.mount_force, SHARE, False), "soil resistance": (run.soil_resistance, SOIL, False)}
    mean = ("mean draft", draft, deviation)
    return Panel("force", unit, lines, limits_of(run, limits, "mount_force", "mean_draft"), mean)


def deflection_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the spring's deflection over time, with its mean, RMS, and limits."""
    mean = ("mean", float(run.mean_deflection), float(run.displacement_rms))
    unit = run.origin.common("m", {"deflection": run.peak_deflection, "mean_deflection": mean[1]})
    lines = {"deflection": (run.deflection, SHARE, False)}
    return Panel("deflection", unit, lines, limits_of(run, limits, "deflection", "mean_deflection"), mean)


def speed_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the speeds of share and strut over time, with the limits of the share's."""
    structure, p = Structure.of(run.scene), parameters(run.scene)
    strut_speed = structure.towed(p, run.time)[1] + 0.0 * run.time
    lines = {"share": (run.speed, SHARE, False), "strut": (strut_speed, STRUT, True)}
    return Panel("speed", run.origin.display("scene.tow_speed", "m/s"), lines, limits_of(run, limits, "speed"))


def changing(run: Run, limits: Sequence[Limit] = ()) -> list[Panel]:
    """Return the panels of a run (force, deflection, speed) that change over time."""
    return [panel for panel in (of(run, limits) for of in (force_of, deflection_of, speed_of)) if panel.changes]


def subject(run: Run) -> str:
    """Return the heading of a picture: the file's title, the soil and the tow speed."""
    speed = run.origin.display("scene.tow_speed", "m/s").text(float(run.scene.tow_speed), 4)
    return "\n".join(part for part in (run.origin.title, f"{run.scene.soil.name}, {speed}") if part)


def limits_of(run: Run, limits: Sequence[Limit], *names: str) -> list[tuple[str, float]]:
    """Return (name in words, value in SI) of each limit of some results, from the run's file and from ``limits``."""
    given = {limit.name: (limit.low, limit.high) for limit in limits if limit.kind == "requirement"}
    every = {**run.origin.limits, **given}
    return [(called(name), end) for name in names for end in every.get(name, ()) if end is not None]


def draw_panel(axes: Axes, run: Run, panel: Panel, columns: int = 5) -> None:
    """Draw a panel: lines, mean with a band of ± RMS, and limits, below a legend in columns that fit."""
    unit = panel.unit
    for label, (values, colour, dashed) in reversed(panel.lines.items()):
        style, width = "--" if dashed else "-", 1.4 if colour == SHARE else 1.0
        axes.plot(run.time, values / unit.factor, color=colour, linestyle=style, linewidth=width, label=label)
    if panel.mean is not None:
        name, mean, rms = panel.mean
        label = f"{name} {unit.text(mean, 3)}"
        axes.axhline(mean / unit.factor, color="black", linewidth=1.0, linestyle="--", label=label)
        if rms > CONSTANT * abs(mean):
            axes.axhspan((mean - rms) / unit.factor, (mean + rms) / unit.factor, color="black", alpha=0.08,
                         label=f"± RMS {unit.text(rms, 3)}")  # fmt: skip
    if panel.name == "force":
        _shade_modes(axes, run)
    low, high = axes.get_ylim()
    for words, value in panel.limits:
        label, at = f"limit of the {words} {unit.text(value, 4)}", value / unit.factor
        near = 3.0 * low - 2.0 * high < at < 3.0 * high - 2.0 * low  # others would flatten the curves
        away = "" if near else f", {'above' if at > high else 'below'} this picture"
        axes.plot(run.time[[0, -1]], [at if near else np.nan] * 2, color=LIMIT, linewidth=1.6, label=f"{label}{away}")
    axes.set(xlabel="time [s]", ylabel=unit.heading(panel.name), xlim=(float(run.time[0]), float(run.time[-1])))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, fontsize="x-small", frameon=False)


def triangle(axes: Axes, length: float, half: float, colour: str, opacity: float, tip: float = 0.0) -> Polygon:
    """Draw a section of a cone along the horizontal axis, or of the soil in front of one."""
    corners = [tip, tip + length, tip + length], [0.0, half, -half]
    (body,) = axes.fill(*corners, facecolor=colour, alpha=opacity, edgecolor="none")
    return body


def _shade_modes(axes: Axes, run: Run) -> None:
    """Shade the times when a share under stick and slip sticks, or has a gap ahead of it."""
    for mode, label, color in ((STICK, "sticks", STRUT), (GAP, "gap", LIMIT)):
        inside = np.asarray(run.mode) == mode
        if np.any(inside):
            axes.fill_between(run.time, 0, 1, where=inside.tolist(), transform=axes.get_xaxis_transform(),
                              color=color, alpha=0.18, linewidth=0.0, label=label)  # fmt: skip
