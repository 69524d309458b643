"""Pictures of designs and of runs side by side."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plough_opt.app.run_picture import limits_of
from plough_opt.core.files import COLOURS
from plough_opt.core.kept import Origin
from plough_opt.design import Limit, LocalOptimum
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import called

# Part of a limit's size that is shown on either side of it: less would magnify rounding.
_LEAST_ROOM = 0.02
SIDE_BY_SIDE = {"mount_force": "N", "deflection": "m"}
"""Results over time that are drawn of several runs, with their units."""


def plot_designs(designs: Mapping[str, LocalOptimum]) -> Figure:
    """Draw designs side by side: every variable between its bounds, every requirement beside its limits.

    Args:
        designs: name -> a design; the first has the variables and requirements that are drawn.
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
    """Draw what designs have of one limited quantity on a line, its limits as bars across."""
    factor = limit.shown.factor
    ends = [end / factor for end in (limit.low, limit.high) if end is not None]
    values = [None if one is None else one.value / factor for one in found]
    for k, value in enumerate(values):
        if value is not None:
            # One below the other, so that designs that are alike do not hide each other.
            height = 0.0 if len(values) == 1 else 0.5 - k / (len(values) - 1)
            axes.plot(value, height, "o", color=COLOURS[k % len(COLOURS)], markersize=7, zorder=3, clip_on=False)
    axes.set_ylim(-1.0, 1.0)
    for end in ends:
        axes.axvline(end, color="black", linewidth=2.0)
    every = [*ends, *(value for value in values if value is not None)]
    room = max(0.08 * (max(every) - min(every)), _LEAST_ROOM * max(map(abs, every))) or 1.0
    axes.set_xlim(min(every) - room, max(every) + room)
    if limit.low is not None and limit.high is not None and 0.0 < 20.0 * limit.low < limit.high:
        axes.set_xscale("log")
        axes.set_xlim(0.8 * min(every), 1.25 * max(every))
    axes.set_yticks([])
    axes.set_ylabel(limit.shown.heading(called(limit.name)), rotation=0, ha="right", va="center")
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)


def draw_side_by_side(axes: Axes, runs: Mapping[str, Run], name: str, origin: Origin) -> None:
    """Draw a result of several runs over time, each in a colour.

    Args:
        axes: where.
        runs: name -> numeric run.
        name: of the result, one of `SIDE_BY_SIDE`.
        origin: of the runs, which has the unit.
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
        runs: name -> run.
    """
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    draw_side_by_side(figure.subplots(), runs, "mount_force", next(iter(runs.values())).origin)
    return figure
