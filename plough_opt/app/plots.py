"""Pictures of shares, runs, batches and optima, in the units of the problem file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from plough_opt.app.panels import LIMIT, SHARE, SOIL, changing, draw_panel, limits_of, subject, triangle
from plough_opt.core.checks import check_kind
from plough_opt.core.expressions import absolute, as_number
from plough_opt.core.files import COLOURS, figure_of_size, figure_with_panels, save_figure, scale_of
from plough_opt.core.saving import Origin
from plough_opt.core.units import customary
from plough_opt.design import Limit, LocalOptimum, Optimum
from plough_opt.design.search.landscape import Violation
from plough_opt.motion import Run
from plough_opt.motion.batch import BatchResult
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
    "plot_batch", "plot_designs", "plot_optimum", "plot_run", "plot_runs", "plot_share",
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
    rows = figure.subplots(max(1, len(panels)), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, panels, strict=False):
        draw_panel(axes, run, panel)
        axes.label_outer()
    if not panels:
        rows[0].set_axis_off()
        rows[0].text(0.5, 0.5, f"Nothing changes over time.\n\n{run.response()}", ha="center", va="center",
                     family="monospace", transform=rows[0].transAxes)  # fmt: skip
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
    rows = figure.subplots(2, 1, sharex=True)
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
    return figure


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
    limits = next(iter(designs.values())).limits
    figure = figure_of_size(8, 0.9 + 0.75 * len(limits))
    rows = figure.subplots(len(limits), 1, squeeze=False)[:, 0]
    for axes, limit in zip(rows, limits, strict=True):
        _draw_limit(
            axes, limit, [[own.value for own in best.limits if own.name == limit.name] for best in designs.values()]
        )
    for name, colour in zip(designs, itertools.cycle(COLOURS), strict=False):
        rows[0].plot([], [], "o", color=colour, label=name)
    figure.legend(loc="outside lower center", ncols=min(4, len(designs)), fontsize="small")
    return figure


def _draw_limit(axes: Axes, limit: Limit, designs: Sequence[Sequence[float]]) -> None:
    """Draw the value of one limited quantity in each design that has it on a line, with its limits as bars across."""
    factor = limit.shown.factor
    ends = [end / factor for end in (limit.low, limit.high) if end is not None]
    # At different heights, so that equal designs do not hide each other.
    heights = [0.0] if len(designs) == 1 else np.linspace(0.5, -0.5, len(designs))
    for values, height, colour in zip(designs, heights, itertools.cycle(COLOURS), strict=False):
        axes.plot(
            np.divide(values, factor), [height] * len(values), "o", color=colour, markersize=7, zorder=3, clip_on=False
        )
    for end in ends:
        axes.axvline(end, color="black", linewidth=2.0)
    places = [*ends, *(value / factor for values in designs for value in values)]
    room = max(0.08 * (max(places) - min(places)), 0.02 * max(map(abs, places))) or 1.0  # rounding is not magnified
    axes.set(ylim=(-1.0, 1.0), yticks=[], xlim=(min(places) - room, max(places) + room))
    if len(ends) == 2 and scale_of(ends) == "log":
        axes.set(xscale="log", xlim=(0.8 * min(places), 1.25 * max(places)))
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
    names = list(best.variables) if best.search is not None and len(best.search.objective) > 0 else []
    search = [names[k : k + _PANELS] for k in range(0, len(names), _PANELS)]
    required = [limit for limit in best.limits if limit.kind == "requirement" and not limit.trivial]
    response = [panel for panel in changing(run, best.limits) if panel.name != "speed"]
    heights = [3.2] * (2 if response else 1) + [3.0] * len(search)
    figure = figure_of_size(12.5, 0.8 + sum(heights))
    figure.suptitle(subject(run))
    top, *below = np.ravel(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False))
    columns = 3 if required else 2
    _draw_wedge(top.add_subplot(1, columns, 1), run.scene)
    _draw_cone(top.add_subplot(1, columns, 2), run.scene)
    for k, panel in enumerate(response, start=1):
        draw_panel(below[0].add_subplot(1, len(response), k), run, panel, columns=3)
    if required:
        _draw_margins(top.add_subplot(1, columns, 3), required)
    for part, row in zip(below[-len(search) :], search, strict=False):
        for k, name in enumerate(row, start=1):
            axes = part.add_subplot(1, min(_PANELS, len(names)), k)
            _draw_search(axes, best, name)
            axes.set_ylabel("objective" if k == 1 else "")
    if search:
        below[-1].legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize="small")
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


def _draw_search(axes: Axes, best: Optimum, name: str) -> None:
    """Draw the objective over one variable: the designs of the search, and the local optima with their spread."""
    search, display = best.search, best.display(name)
    assert search is not None  # a precondition
    values = search.values[:, list(best.variables).index(name)] / display.factor
    feasible, computed = search.violation <= Violation.allowed, np.isfinite(search.objective)
    for which, color, label in (
        (computed & ~feasible, _FAILED, "tried, fails a requirement"),
        (feasible, SHARE, "tried, meets all requirements"),
    ):
        axes.plot(values[which], search.objective[which], ".", markersize=2, color=color, label=label, zorder=1)
    for k, optimum in enumerate(best.local_optima):
        at = optimum.variables[name] / display.factor
        if optimum.spread is not None:
            axes.plot([at, at], [optimum.objective, optimum.spread.worst], color=LIMIT, linewidth=1.2, zorder=2,
                      label=None if k else "within the tolerances, up to the worst")  # fmt: skip
        axes.plot(at, optimum.objective, "o" if k else "*", markersize=6 if k else 13, color=LIMIT, zorder=3,
                  markeredgecolor="white", label={0: "best", 1: "other local optima"}.get(k))  # fmt: skip
    # The lower three quarters of the objectives, so that the optima can be told apart.
    tried = search.objective[feasible if np.any(feasible) else computed]
    lows = [optimum.objective for optimum in best.local_optima]
    low, high = min([*lows, *tried]), max([*lows, *np.quantile(tried, [0.75] * (len(tried) > 0))])
    room = 0.08 * (high - low) or 0.1 * abs(low) or 1.0
    axes.set(xscale=scale_of(values), xlabel=display.heading(called(name)), ylim=(low - room, high + room))


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
    _draw_wedge(left, scene)
    half_width = left.get_ylim()[1]
    _draw_cone(right, scene)
    right.set(ylabel="", ylim=max((-half_width, half_width), right.get_ylim(), key=lambda ends: ends[1]))
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
    for side, opacity in ((width, 0.75), (-width, 0.55)):
        axes.fill([0, edge, edge], [0, 0, side], facecolor=_STEEL, alpha=opacity, edgecolor="black", linewidth=0.8)
    axes.text(0.97 * edge, 0.08 * width, f"λ = {math.degrees(share.angle):.1f}°", color="white", ha="right")
    angle = f"chisel angle {math.degrees(share.chisel_angle):.0f}°"
    _scale(axes, f"along the edge, {edge:.3f} m long\nh = {share.height:.3f} m, {angle}", edge, width)


def _draw_cone(axes: Axes, scene: Scene) -> None:
    """Draw a longitudinal section of the equivalent cone and of the compacted soil around it."""
    cone = scene.cone
    height, radius = float(cone.height), float(cone.height * cone.slope)
    front = radius
    if not scene.law.lacks("loosened_radius"):
        front = float(scene.loosened_radius)
        triangle(axes, height, front, SOIL, 0.35).set_label(f"compacted soil, r* = {front:.3f} m")
        axes.legend(loc="upper left", fontsize="small")
    triangle(axes, height, radius, _STEEL, 0.85)
    _arrow(axes, -0.28 * height, -0.05 * height)
    axes.text(-0.165 * height, 0.04 * front, "travel", ha="center", va="bottom")
    axes.text(0.96 * height, 0, f"β = {math.degrees(cone.half_angle):.1f}°", color="white", ha="right", va="center")
    axes.set_title("Equivalent cone (equal height and surface)")
    mount = customary("N/m", float(scene.stiffness)).text(float(scene.stiffness), 4)
    along = f"along the axis [m]\nh = {height:.3f} m, base radius {radius:.3f} m\non a mount of {mount}"
    _scale(axes, along, height, front, ahead=0.35 * height)


def _arrow(axes: Axes, head: float, tail: float) -> None:
    """Draw an arrow along the axis, in the direction of travel."""
    axes.annotate("", xy=(head, 0), xytext=(tail, 0), arrowprops={"arrowstyle": "->", "color": "black"})


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
    from matplotlib.ticker import MaxNLocator

    wedge = body(profile)
    length = float(wedge.places[-1] - wedge.places[0])
    x = float(wedge.places[0]) + length * np.linspace(-0.6, 1.6, 221)
    y = length * np.linspace(-0.8, 0.8, 162)  # an even number, so that no row hits the singular nodes on the axis
    field = wedge_stress(*np.meshgrid(x, y), profile, soil, speed)
    figure = figure_of_size(12, 4.8)
    for axes, name, values in zip(figure.subplots(1, 2), ("yy", "xy"), (field.yy, field.xy), strict=True):
        # Stresses are infinite at the nodes, so the colour scale ends at the 99th percentile.
        largest = float(np.quantile(absolute(as_number(values)), 0.99)) / 1e3
        levels = MaxNLocator(20, symmetric=True).tick_values(-largest, largest)
        filled = axes.contourf(x, y, values / 1e3, levels, cmap="RdBu", extend="both")
        figure.colorbar(filled, ax=axes, label=f"σ_{name} [kPa], tension positive")
        heights = np.array(wedge.heights)
        axes.fill_between(wedge.places, -heights, heights, facecolor=_STEEL, edgecolor="black")
        _arrow(axes, x[0] + 0.06 * length, x[0] + 0.3 * length)
        axes.set(aspect="equal", xlabel="x behind the tip [m]", ylabel="y across [m]")
    return figure
