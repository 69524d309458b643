"""Pictures of runs over time and of designs side by side, in the units of the problem file."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind
from plough_opt.core.files import COLOURS
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.design import Limit, LocalOptimum
from plough_opt.motion import Run
from plough_opt.motion.equation import GAP, STICK, Structure, parameters
from plough_opt.motion.vocabulary import called

OWN, LIMIT, SOIL, STRUT = COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[6]
"""Colours in every picture: the share's motion and force, limits, the soil, and the strut."""
SIDE_BY_SIDE: Final = {"mount_force": "N", "deflection": "m"}
"""Results over time that are drawn for several runs -> SI unit."""
CONSTANT: Final = 1e-6
"""Relative change below which a result counts as constant: smaller changes are rounding."""

# Smallest margin on either side of a limit, relative to its size: a smaller one would magnify rounding.
_LEAST_ROOM = 0.02


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
    lines = {"mount force": (run.mount_force, OWN, False), "soil resistance": (run.soil_resistance, SOIL, False)}
    mean = ("mean draft", draft, deviation)
    return Panel("force", unit, lines, limits_of(run, limits, "mount_force", "mean_draft"), mean)


def deflection_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the spring's deflection over time, with its mean, RMS, and limits."""
    mean = ("mean", float(run.mean_deflection), float(run.displacement_rms))
    unit = run.origin.common("m", {"deflection": run.peak_deflection, "mean_deflection": mean[1]})
    lines = {"deflection": (run.deflection, OWN, False)}
    return Panel("deflection", unit, lines, limits_of(run, limits, "deflection", "mean_deflection"), mean)


def speed_of(run: Run, limits: Sequence[Limit] = ()) -> Panel:
    """Return the speeds of share and strut over time, with the limits of the share's."""
    structure, p = Structure.of(run.scene), parameters(run.scene)
    strut_speed = structure.start_speed(p) + structure.strut(p, run.time).gain + 0.0 * run.time
    lines = {"share": (run.speed, OWN, False), "strut": (strut_speed, STRUT, True)}
    return Panel("speed", run.origin.display("scene.tow_speed", "m/s"), lines, limits_of(run, limits, "speed"))


def changing(run: Run, limits: Sequence[Limit] = ()) -> list[Panel]:
    """Return the panels of a run (force, deflection, speed) that change over time."""
    return [panel for panel in (of(run, limits) for of in (force_of, deflection_of, speed_of)) if panel.changes]


def subject(run: Run) -> str:
    """Return the heading of a picture: the file's title, the soil and the tow speed."""
    speed = run.origin.display("scene.tow_speed", "m/s").text(float(run.scene.tow_speed), 4)
    return "\n".join(part for part in (run.origin.title, f"{run.scene.soil.name}, {speed}") if part)


def plot_run(run: Run, limits: Sequence[Limit] = ()) -> Figure:
    """Draw force, deflection and speed of a numeric run over time, except those that are constant.

    Args:
        run: a numeric run.
        limits: limits to show in addition to those of the run's problem file.

    Raises:
        InputError: ``run`` is not a run, or ``limits`` holds something else than limits.
    """
    check_kind("the run", run, Run, "a numeric Run, as returned by po.simulate")
    check_kind("limits", limits, list | tuple, "a list of limits, such as those of an optimum")
    for limit in limits:
        check_kind("a limit", limit, Limit, "one of an optimum's limits")
    panels = changing(run, limits)
    figure = Figure(figsize=(9, 1.0 + 2.3 * max(1, len(panels))), layout="constrained")
    figure.suptitle(subject(run))
    if not panels:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.text(0.5, 0.5, f"Nothing changes over time.\n\n{run.response()}", ha="center", va="center",
                  family="monospace", transform=axes.transAxes)  # fmt: skip
        return figure
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        draw_panel(axes, run, panel)
        axes.set_xlabel("")
    rows[-1].set_xlabel("time [s]")
    return figure


def draw_panel(axes: Axes, run: Run, panel: Panel, columns: int = 5) -> None:
    """Draw a panel: lines, mean with a band of ± RMS, limits, and above all lines a legend in columns that fit."""
    unit = panel.unit
    for label, (values, colour, dashed) in reversed(panel.lines.items()):
        style, width = "--" if dashed else "-", 1.4 if colour == OWN else 1.0
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
    for words, value in panel.limits:
        label = f"limit of the {words} {unit.text(value, 4)}"
        axes.axhline(value / unit.factor, color=LIMIT, linewidth=1.6, label=label)
    axes.set(xlabel="time [s]", ylabel=unit.heading(panel.name), xlim=(float(run.time[0]), float(run.time[-1])))
    low, high = axes.get_ylim()
    # Widen the range around an almost constant result, so that its rounding is not magnified.
    least = CONSTANT * max(abs(low), abs(high))
    if high - low < 0.1 * max(abs(low), abs(high)):
        low, high = low - 0.05 * abs(low) - least, high + 0.05 * abs(high) + least
    rows = -(-len(axes.get_legend_handles_labels()[0]) // columns)
    axes.set_ylim(low, high + (0.14 + 0.12 * rows) * (high - low))
    axes.legend(loc="upper right", ncols=columns, fontsize="x-small")


def limits_of(run: Run, limits: Sequence[Limit], *names: str) -> list[tuple[str, float]]:
    """Return (name in words, value in SI) of each limit of some results, from the run's file and from ``limits``."""
    given = {limit.name: (limit.low, limit.high) for limit in limits if limit.kind == "requirement"}
    every = {**run.origin.limits, **given}
    return [(called(name), end) for name in names for end in every.get(name, ()) if end is not None]


def _shade_modes(axes: Axes, run: Run) -> None:
    """Shade the times when a share under stick and slip sticks, or has a gap ahead of it."""
    for mode, label, color in ((STICK, "sticks", STRUT), (GAP, "gap", LIMIT)):
        inside = np.asarray(run.mode) == mode
        if np.any(inside):
            axes.fill_between(run.time, 0, 1, where=inside.tolist(), transform=axes.get_xaxis_transform(),
                              color=color, alpha=0.18, linewidth=0.0, label=label)  # fmt: skip


def plot_designs(designs: Mapping[str, LocalOptimum]) -> Figure:
    """Draw designs side by side: each variable between its bounds, each requirement beside its limits.

    Args:
        designs: name -> design; the first decides which variables and requirements are drawn.
    """
    first = next(iter(designs.values()))
    figure = Figure(figsize=(8, 0.9 + 0.75 * len(first.limits)), layout="constrained")
    rows = figure.subplots(len(first.limits), 1, squeeze=False)[:, 0]
    for axes, limit in zip(rows, first.limits, strict=True):
        _draw_limit(
            axes, limit, [next((x for x in one.limits if x.name == limit.name), None) for one in designs.values()]
        )
    for name, colour in zip(designs, itertools.cycle(COLOURS), strict=False):
        rows[0].plot([], [], "o", color=colour, label=name)
    figure.legend(loc="outside lower center", ncols=min(4, len(designs)), fontsize="small")
    return figure


def _draw_limit(axes: Axes, limit: Limit, found: Sequence[Limit | None]) -> None:
    """Draw the values of one limited quantity in several designs on a line, with its limits as bars across.

    Args:
        axes: the axes to draw on.
        limit: the quantity and its limits.
        found: the same quantity in each design, or None.
    """
    factor = limit.shown.factor
    ends = [end / factor for end in (limit.low, limit.high) if end is not None]
    values = [None if one is None else one.value / factor for one in found]
    for k, value in enumerate(values):
        if value is not None:
            # At different heights, so that equal designs do not hide each other.
            height = 0.0 if len(values) == 1 else 0.5 - k / (len(values) - 1)
            axes.plot(value, height, "o", color=COLOURS[k % len(COLOURS)], markersize=7, zorder=3, clip_on=False)
    for end in ends:
        axes.axvline(end, color="black", linewidth=2.0)
    every = [*ends, *(value for value in values if value is not None)]
    room = max(0.08 * (max(every) - min(every)), _LEAST_ROOM * max(map(abs, every))) or 1.0
    axes.set(ylim=(-1.0, 1.0), yticks=[], xlim=(min(every) - room, max(every) + room))
    if limit.low is not None and limit.high is not None and 0.0 < 20.0 * limit.low < limit.high:
        axes.set(xscale="log", xlim=(0.8 * min(every), 1.25 * max(every)))
    axes.set_ylabel(limit.shown.heading(called(limit.name)), rotation=0, ha="right", va="center")
    axes.spines[["left", "right", "top"]].set_visible(False)


def draw_side_by_side(axes: Axes, runs: Mapping[str, Run], name: str, origin: Origin) -> None:
    """Draw one result of several runs over time, each in its own colour.

    Args:
        axes: the axes to draw on.
        runs: name -> numeric run.
        name: name of the result, one of `SIDE_BY_SIDE`.
        origin: origin of the runs, which decides the unit.
    """
    size = max(float(np.max(np.abs(getattr(run, name)))) for run in runs.values())
    unit = origin.common(SIDE_BY_SIDE[name], {name: size})
    for (label, run), colour in zip(runs.items(), itertools.cycle(COLOURS), strict=False):
        axes.plot(run.time, getattr(run, name) / unit.factor, color=colour, linewidth=1.2, label=label)
        for _, end in limits_of(run, (), name):
            axes.axhline(end / unit.factor, color=colour, linewidth=1.6, linestyle=":", label=f"limit of {label}")
    axes.set(xlabel="time [s]", ylabel=unit.heading(called(name)))
    axes.legend(fontsize="small")


def plot_forces(runs: Mapping[str, Run]) -> Figure:
    """Draw the mount forces of several numeric runs over time.

    Args:
        runs: name -> numeric run.
    """
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    draw_side_by_side(figure.subplots(), runs, "mount_force", next(iter(runs.values())).origin)
    return figure
