"""Pictures of shares, runs, batches and optima, in the units of the problem file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.app.panels import LIMIT, SHARE, SOIL, changing, draw_panel, limits_of, subject
from plough_opt.core.checks import check_kind
from plough_opt.core.expressions import absolute, as_number
from plough_opt.core.files import COLOURS, figure_of_size, figure_with_panels, save_figure, scale_of
from plough_opt.core.saving import Origin
from plough_opt.core.units import customary
from plough_opt.design import Limit, LocalOptimum, Optimum
from plough_opt.design.search.landscape import Violation
from plough_opt.motion import Run
from plough_opt.motion.batch import BatchResult
from plough_opt.motion.run import Machine
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import called
from plough_opt.soil.elastic import wedge_stress
from plough_opt.soil.elastic.medium import Profile, body
from plough_opt.soil.geometry import Wedge
from plough_opt.soil.soil import Soil

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "plot_batch", "plot_designs", "plot_machine", "plot_optimum", "plot_run", "plot_runs", "plot_share",
    "plot_wedge_field", "save",
]  # fmt: skip

save = save_figure

# Colours of designs that fail a requirement, and of the share.
_FAILED, _STEEL = "#cfd4d8", "#4a5a68"
# Points in one panel: more would hide each other.
_MOST_POINTS: Final = 20_000
# Panels of the search in one row.
_PANELS: Final = 3


# --- a run over time ------------------------------------------------------------------------------------------


def plot_run(run: Run, limits: Sequence[Limit] = ()) -> Figure:
    """Draw force, deflection and speed of a numeric run over time, except those that are constant.

    Args:
        run: a numeric run.
        limits: limits to show in addition to those of the run's problem file.

    Raises:
        InputError: ``run`` is not a run, or ``limits`` holds something else than limits.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> effects = po.Effects(strength_wave=po.StrengthWave(0.3, "0.2 m"))
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", effects)
        >>> run = po.simulate(scene, "0.5 s")
        >>> figure = po.plots.plot_run(run)
        >>> [axes.get_ylabel() for axes in figure.axes]
        ['force [kN]', 'deflection [m]', 'speed [m/s]']
    """
    check_kind("the run", run, Run, "a numeric Run, as returned by po.simulate")
    check_kind("limits", limits, list | tuple, "a list of limits, such as those of an optimum")
    for limit in limits:
        check_kind("a limit", limit, Limit, "one of an optimum's limits")
    panels = changing(run, limits)
    figure = figure_of_size(9, 1.0 + 2.3 * max(1, len(panels)))
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


# --- several runs, and many designs ----------------------------------------------------------------------


def plot_runs(runs: Mapping[str, Run], origin: Origin | None = None) -> Figure:
    """Draw mount force and deflection over time of several numeric runs, each in its own colour.

    Args:
        runs: name -> numeric run.
        origin: decides title and units (default: the first run's).

    Example:
        >>> import plough_opt as po
        >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
        >>> [axes.get_ylabel() for axes in po.plots.plot_runs({"front": run, "rear": run}).axes]
        ['mount force [kN]', 'deflection [m]']
    """
    check_kind("the runs", runs, Mapping, "name -> numeric Run")
    origin = next(iter(runs.values())).origin if origin is None else origin
    figure = figure_of_size(9.0, 6.0)
    figure.suptitle(origin.title)
    _draw_side_by_side(figure.subplots(2, 1, sharex=True), runs, origin)
    return figure


def plot_machine(machine: Machine) -> Figure:
    """Draw mount force and deflection over time of several shares in one frame: see `plot_runs`.

    Example:
        >>> import plough_opt as po
        >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
        >>> machine = po.Machine({"front": run, "rear": run})
        >>> len(po.plots.plot_machine(machine).axes)
        2
    """
    check_kind("the machine", machine, Machine, "a Machine of numeric runs")
    return plot_runs(machine.runs, machine.origin)


def _draw_side_by_side(rows: Sequence[Axes], runs: Mapping[str, Run], origin: Origin) -> None:
    for axes, (name, unit) in zip(rows, {"mount_force": "N", "deflection": "m"}.items(), strict=True):
        size = max(float(np.max(np.abs(getattr(run, name)))) for run in runs.values())
        shown = origin.common(unit, {name: size})
        for (label, run), colour in zip(runs.items(), itertools.cycle(COLOURS), strict=False):
            axes.plot(run.time, getattr(run, name) / shown.factor, color=colour, linewidth=1.2, label=label)
            for _, end in limits_of(run, (), name):
                limit = end / shown.factor
                axes.axhline(limit, color=colour, linewidth=1.6, linestyle=":", label=f"limit of {label}")
        axes.set(xlabel="time [s]", ylabel=shown.heading(called(name)))
        axes.legend(fontsize="small")


def plot_batch(found: BatchResult) -> Figure:
    """Draw RMS force over mean draft for every design of a batch.

    Example:
        >>> import casadi as ca
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> effects = po.Effects(strength_wave=po.StrengthWave(0.3, "0.2 m"))
        >>> k = ca.MX.sym("k")
        >>> scene = po.Scene(soil, share, k, "30 kg", "2 m/s", effects)
        >>> found = po.Batch(scene, 0.2, [k])([[4e4], [5e4], [6e4]])
        >>> po.plots.plot_batch(found).axes[0].get_xlabel()
        'mean draft [kN]'
    """
    check_kind("the batch", found, BatchResult, "a BatchResult, as returned by po.Batch")
    figure, (axes,) = figure_with_panels(1, 1, (6.5, 4.5))
    step = max(1, len(found) // _MOST_POINTS)
    axes.plot(found.mean_draft[::step] / 1e3, found.force_rms[::step] / 1e3, ".", color=SHARE, markersize=4)
    axes.set(xlabel="mean draft [kN]", ylabel="RMS of the mount force [kN]")
    return figure


# --- designs ---------------------------------------------------------------------------------------------


def plot_designs(designs: Mapping[str, LocalOptimum]) -> Figure:
    """Draw designs side by side: each variable between its bounds, each requirement beside its limits.

    Args:
        designs: name -> design; the first decides which variables and requirements are drawn.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search=64)
        >>> len(po.plots.plot_designs({"best": best}).axes)
        2
    """
    first = next(iter(designs.values()))
    figure = figure_of_size(8, 0.9 + 0.75 * len(first.limits))
    rows = figure.subplots(len(first.limits), 1, squeeze=False)[:, 0]
    for axes, limit in zip(rows, first.limits, strict=True):
        found = (next((x for x in one.limits if x.name == limit.name), None) for one in designs.values())
        _draw_limit(axes, limit, [*found])
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
    room = max(0.08 * (max(every) - min(every)), 0.02 * max(map(abs, every))) or 1.0
    axes.set(ylim=(-1.0, 1.0), yticks=[], xlim=(min(every) - room, max(every) + room))
    if len(ends) == 2 and scale_of(ends) == "log":
        axes.set(xscale="log", xlim=(0.8 * min(every), 1.25 * max(every)))
    axes.set_ylabel(limit.shown.heading(called(limit.name)), rotation=0, ha="right", va="center")
    axes.spines[["left", "right", "top"]].set_visible(False)


def plot_optimum(best: Optimum, run: Run) -> Figure:
    """Draw an optimum: the share, its equivalent cone, the response, the margins, and the designs of the search.

    Args:
        best: the optimum.
        run: its numeric run.

    Example:
        >>> import plough_opt as po
        >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
        >>> best, run = problem.optimise(search="near")
        >>> len(po.plots.plot_optimum(best, run).axes)
        5
    """
    check_kind("the optimum", best, Optimum, "an Optimum, as returned by Design.solve")
    check_kind("the run", run, Run, "a numeric Run, as returned by po.simulate")
    panels = list(best.variables) if best.search is not None and len(best.search.objective) > 0 else []
    required = [limit for limit in best.limits if limit.kind == "requirement" and not limit.trivial]
    rows = -(-len(panels) // _PANELS)
    response = [p for p in changing(run, best.limits) if p.name != "speed"]
    heights = [3.2] * (2 if response else 1) + [3.0] * rows
    figure = figure_of_size(12.5, 0.8 + sum(heights))
    figure.suptitle(subject(run))
    top, *below = np.ravel(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False))
    left = [top.add_subplot(1, 3 if required else 2, k) for k in (1, 2)]
    _draw_wedge(left[0], run.scene)
    _draw_cone(left[1], run.scene)
    for k, panel in enumerate(response, start=1):
        draw_panel(below[0].add_subplot(1, len(response), k), run, panel, columns=3)
    if required:
        _draw_margins(top.add_subplot(1, 3, 3), required)
    for row, part in enumerate(below[len(heights) - 1 - rows :]):
        for k in range(len(panels[_PANELS * row : _PANELS * (row + 1)])):
            axes = part.add_subplot(1, min(_PANELS, len(panels)), k + 1)
            _draw_search(axes, best, _PANELS * row + k)
        if row == rows - 1:
            part.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize="small")
    return figure


def _draw_margins(axes: Axes, required: Sequence[Limit]) -> None:
    """Draw the margin of each requirement in per cent of its limit."""
    for k, limit in enumerate(required):
        size = max(abs(limit.value), abs(limit.value + limit.margin)) or 1.0
        percent = 0.0 if limit.active else 100.0 * limit.margin / size
        axes.barh(k, min(percent, 100.0), height=0.32, color=SHARE)
        if limit.active:
            axes.plot(0.0, k, "D", color=LIMIT, markersize=7, clip_on=False)
        words = "decides" if limit.active else f"margin {limit.margin_text()}"
        sides = ((" ≥ ", limit.low), (" ≤ ", limit.high))
        ends = "".join(f"{sign}{limit.shown.text(end, 4)}" for sign, end in sides if end is not None)
        text = f"{called(limit.name)} {limit.shown.text(limit.rounded, 4)}{ends}: {words}"
        # A long text may leave the axes; it must not shrink them.
        axes.text(0.01, k - 0.26, text, fontsize="small", transform=axes.get_yaxis_transform(), in_layout=False)
    axes.set(ylim=(len(required) - 0.5, -0.7), xlim=(0.0, max(10.0, 1.1 * axes.get_xlim()[1])), yticks=[])
    axes.set(xlabel="margin [% of the limit]", title="Requirements")


def _draw_search(axes: Axes, best: Optimum, variable: int) -> None:
    """Draw the objective over one variable: the designs of the search, and the local optima with their spread.

    Args:
        axes: the axes to draw on.
        best: an optimum with a search.
        variable: index of the variable.
    """
    search, name = best.search, list(best.variables)[variable]
    assert search is not None  # a precondition
    display = best.display(name)
    values, feasible = search.values[:, variable] / display.factor, search.violation <= Violation.allowed
    for which, color, label in (
        (np.isfinite(search.objective) & ~feasible, _FAILED, "tried, fails a requirement"),
        (feasible, SHARE, "tried, meets all requirements"),
    ):
        if np.any(which):
            axes.plot(values[which], search.objective[which], ".", markersize=2, color=color, label=label, zorder=1)
    for k, optimum in enumerate(best.local_optima):
        at = optimum.variables[name] / display.factor
        if optimum.spread is not None:
            axes.plot([at, at], [optimum.objective, optimum.spread.worst], color=LIMIT, linewidth=1.2, zorder=2,
                      label=None if k else "within the tolerances, up to the worst")  # fmt: skip
        named = None if k > 1 else ("best" if k == 0 else "other local optima")
        axes.plot(at, optimum.objective, "o" if k else "*", markersize=6 if k else 13, color=LIMIT, zorder=3,
                  markeredgecolor="white", label=named)  # fmt: skip
    axes.set_xscale(scale_of(values))
    _show_low_objectives(axes, search.objective[feasible if np.any(feasible) else np.isfinite(search.objective)], best)
    axes.set_xlabel(display.heading(called(name)))
    if variable % _PANELS == 0:
        axes.set_ylabel("objective")


def _show_low_objectives(axes: Axes, tried: NDArray[np.float64], best: Optimum) -> None:
    """Limit the axis to the lower three quarters of the objectives, so that the optima can be told apart."""
    lows = [optimum.objective for optimum in best.local_optima]
    low = min([*lows, *tried.tolist()])
    high = max([*lows, float(np.quantile(tried, 0.75)) if len(tried) else low])
    room = 0.08 * (high - low) or 0.1 * abs(low) or 1.0
    axes.set_ylim(low - room, high + room)


# --- a share in its soil ---------------------------------------------------------------------------------


def plot_share(scene: Scene) -> Figure:
    """Draw the share's faces, unfolded, beside its equivalent cone in the soil, to the same scale.

    Raises:
        InputError: ``scene`` is not a numeric scene.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> [axes.get_title() for axes in po.plots.plot_share(scene).axes]
        ['Faces of the share, unfolded', 'Equivalent cone (equal height and surface)']
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    figure = figure_of_size(13, 4.4)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 1.24))
    _draw_cone(right, scene)
    right.set_ylabel("")
    half_width = right.get_ylim()[1]
    _draw_wedge(left, scene)
    half_width = max(half_width, left.get_ylim()[1])
    left.set_ylim(-half_width, half_width)
    return figure


def _draw_wedge(axes: Axes, scene: Scene) -> None:
    """Draw the two triangular faces of a wedge, unfolded along their common edge."""
    share = scene.share
    axes.set_title("Faces of the share, unfolded")
    if not isinstance(share, Wedge):
        axes.text(0.5, 0.5, "the share is given as a cone", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    edge = float(share.height) / math.cos(share.chisel_angle)
    width = edge * math.tan(share.angle)
    for side in (1.0, -1.0):
        axes.fill([0, edge, edge], [0, 0, side * width], facecolor=_STEEL, alpha=0.75 if side > 0 else 0.55,
                  edgecolor="black", linewidth=0.8)  # fmt: skip
    angles = np.linspace(0.0, float(share.angle), 30)
    axes.plot(0.3 * edge * np.cos(angles), 0.3 * edge * np.sin(angles), color="white", linewidth=1.2)
    axes.text(0.34 * edge * math.cos(angles[-1] / 2), 0.34 * edge * math.sin(angles[-1] / 2),
              f"λ = {math.degrees(share.angle):.1f}°", color="white", ha="left", va="center")  # fmt: skip
    angle = f"chisel angle {math.degrees(share.chisel_angle):.0f}°"
    along = f"along the edge, {edge:.3f} m long\nh = {share.height:.3f} m, {angle}"
    _scale(axes, along, edge, width)


def _draw_cone(axes: Axes, scene: Scene) -> None:
    """Draw a longitudinal section of the equivalent cone and of the compacted soil around it."""
    cone = scene.cone
    height, radius = float(cone.height), float(cone.height * cone.slope)
    loosens = not scene.law.lacks("loosened_radius")
    front = float(scene.loosened_radius) if loosens else radius
    if loosens:
        axes.fill([0, height, height], [0, front, -front], facecolor=SOIL, alpha=0.35, edgecolor="none",
                  label=f"compacted soil, r* = {front:.3f} m")  # fmt: skip
        for side in (1.0, -1.0):
            axes.plot([0, height], [0, side * front], color=SOIL, linestyle="--", linewidth=1.2)
        axes.legend(loc="upper left", fontsize="small")
    axes.fill([0, height, height], [0, radius, -radius], facecolor=_STEEL, alpha=0.85, edgecolor="black",
              linewidth=0.8)  # fmt: skip
    axes.annotate("", xy=(-0.28 * height, 0), xytext=(-0.05 * height, 0),
                  arrowprops={"arrowstyle": "->", "color": "black"})  # fmt: skip
    axes.text(-0.165 * height, 0.04 * front, "travel", ha="center", va="bottom")
    axes.text(0.96 * height, 0, f"β = {math.degrees(cone.half_angle):.1f}°", color="white", ha="right", va="center")
    axes.set_title("Equivalent cone (equal height and surface)")
    mount = customary("N/m", float(scene.stiffness)).text(float(scene.stiffness), 4)
    along = f"along the axis [m]\nh = {height:.3f} m, base radius {radius:.3f} m\non a mount of {mount}"
    _scale(axes, along, height, front, ahead=0.35 * height)


def _scale(axes: Axes, along: str, length: float, half_width: float, ahead: float = 0.0) -> None:
    """Set equal scales on both axes, with a margin around the drawing; ``along`` describes the horizontal one."""
    axes.locator_params(nbins=4)
    limits = {"xlim": (-ahead - 0.06 * length, 1.08 * length), "ylim": (-1.2 * half_width, 1.2 * half_width)}
    axes.set(xlabel=along, ylabel="[m]", aspect="equal", **limits)


def plot_wedge_field(profile: Profile, soil: Soil, speed: float) -> Figure:
    """Draw the stresses sigma_yy and sigma_xy around a thin wedge in an elastic soil.

    Args:
        profile: nodes (x, half thickness) [m], or a share, as in `plough_opt.soil.elastic.wedge_stress`.
        soil: a soil with elastic constants.
        speed: speed of the wedge [m/s], at most that of shear waves.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> profile = [(0.0, 0.0), (0.25, 0.05)]
        >>> len(po.plots.plot_wedge_field(profile, soil, 2.0).axes)
        4
    """
    wedge = body(profile)
    length = float(wedge.places[-1] - wedge.places[0])
    x = float(wedge.places[0]) + length * np.linspace(-0.6, 1.6, 221)
    y = length * np.linspace(-0.8, 0.8, 162)  # an even number, so that no row hits the singular nodes on the axis
    along, across = np.meshgrid(x, y)
    field = wedge_stress(along, across, profile, soil, speed)
    figure = figure_of_size(12, 4.8)
    for axes, name, values in zip(figure.subplots(1, 2), ("yy", "xy"), (field.yy, field.xy), strict=True):
        # Stresses are infinite at the nodes, so the colour scale ends at the 99th percentile.
        largest = float(np.quantile(absolute(as_number(values)), 0.99)) / 1e3
        from matplotlib.ticker import MaxNLocator

        levels = MaxNLocator(20, symmetric=True).tick_values(-largest, largest)
        filled = axes.contourf(x, y, values / 1e3, levels, cmap="RdBu", extend="both")
        figure.colorbar(filled, ax=axes, label=f"$\\sigma_{{{name}}}$ [kPa], tension positive")
        heights = np.array(wedge.heights)
        axes.fill_between(wedge.places, -heights, heights, facecolor=_STEEL, edgecolor="black")
        axes.annotate("", xy=(x[0] + 0.06 * length, 0), xytext=(x[0] + 0.3 * length, 0),
                      arrowprops={"arrowstyle": "->", "color": "black"})  # fmt: skip
        axes.set(aspect="equal", xlabel="x behind the tip [m]", ylabel="y across [m]")
    return figure
