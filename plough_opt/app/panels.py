"""A run over time: its panels for pictures and pages, and its animation."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.expressions import as_number, sin
from plough_opt.core.files import COLOURS, CONSTANT, figure_of_size
from plough_opt.core.units import Display
from plough_opt.motion import Run
from plough_opt.motion.equation import GAP, STICK, Structure, parameters
from plough_opt.motion.vocabulary import called

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from plough_opt.design import Limit

SHARE, LIMIT, SOIL, STRUT = COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[6]
"""Colours in every picture: the share's motion and force, limits, the soil, and the strut."""
# Frames per second.
_RATE: Final = 15.0
# Frames in a GIF, which keep it at about 2 MB.
_MAX_FRAMES: Final = 120
# Colours in each frame.
_COLOURS: Final = 48
# Largest deflection as drawn, as a fraction of the width of the scene.
_SWING: Final = 0.35
# Horizontal resolution of the soil's strength.
_SOIL_COLUMNS: Final = 400
# Colours from loose to strong soil.
_SOIL_COLOURS: Final = ("#F7E7CE", "#B59468")


# Distance of a limit from the curves, in parts of their range, beyond which it is named but not drawn.
_FAR = 2.0


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
    """Draw a panel: lines, mean with a band of ± RMS, limits, and above all lines a legend in columns that fit.

    Example:
        >>> from matplotlib.figure import Figure
        >>> from plough_opt.app.panels import force_of
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> effects = po.Effects(strength_wave=po.StrengthWave(0.3, "0.2 m"))
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s", effects)
        >>> run = po.simulate(scene, "0.5 s")
        >>> axes = Figure().subplots()
        >>> po.plots.draw_panel(axes, run, force_of(run))
        >>> axes.get_ylabel()
        'force [kN]'
    """
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
        if low - _FAR * (high - low) < at < high + _FAR * (high - low):
            axes.axhline(at, color=LIMIT, linewidth=1.6, label=label)
        else:  # it would flatten the curves
            side = "above" if at > high else "below"
            axes.plot([], [], color=LIMIT, linewidth=1.6, label=f"{label}, {side} this picture")
    axes.set(xlabel="time [s]", ylabel=unit.heading(panel.name), xlim=(float(run.time[0]), float(run.time[-1])))
    low, high = axes.get_ylim()
    # Widen the range around an almost constant result, so that its rounding is not magnified.
    least = CONSTANT * max(abs(low), abs(high))
    if high - low < 0.1 * max(abs(low), abs(high)):
        low, high = low - 0.05 * abs(low) - least, high + 0.05 * abs(high) + least
    rows = -(-len(axes.get_legend_handles_labels()[0]) // columns)
    axes.set_ylim(low, high + (0.14 + 0.12 * rows) * (high - low))
    axes.legend(loc="upper right", ncols=columns, fontsize="x-small")


def _shade_modes(axes: Axes, run: Run) -> None:
    """Shade the times when a share under stick and slip sticks, or has a gap ahead of it."""
    for mode, label, color in ((STICK, "sticks", STRUT), (GAP, "gap", LIMIT)):
        inside = np.asarray(run.mode) == mode
        if np.any(inside):
            axes.fill_between(run.time, 0, 1, where=inside.tolist(), transform=axes.get_xaxis_transform(),
                              color=color, alpha=0.18, linewidth=0.0, label=label)  # fmt: skip


def gif(run: Run, slower: float) -> bytes:
    """Return the motion as a GIF, played ``slower`` times slower than it happens."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image  # a dependency of matplotlib

    seconds = float(run.time[-1]) * slower
    count = max(2, min(_MAX_FRAMES, math.ceil(seconds * _RATE)))
    figure = figure_of_size(8.0, 5.0)
    figure.set_dpi(80)
    canvas = FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.3, 1.0))
    figure.suptitle(f"{subject(run)}, {slower:g} times slower", fontsize="medium")
    panel = deflection_of(run)
    draw_panel(lower, run, panel)
    (dot,) = lower.plot([], [], "o", color=LIMIT, markersize=8)
    _draw_scene(upper, run, 0.0, 0.0)
    canvas.draw()  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")  # so that all frames keep the layout of the first
    frames = []
    for time in np.linspace(0.0, float(run.time[-1]), count):
        deflection = float(np.interp(time, run.time, run.deflection))
        dot.set_data([time], [deflection / panel.unit.factor])
        _draw_scene(upper, run, time, deflection)
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        frames.append(Image.fromarray(pixels).convert("RGB").quantize(_COLOURS, Image.Quantize.FASTOCTREE))
    file = io.BytesIO()
    first, *rest = frames
    first.save(file, "GIF", save_all=True, append_images=rest, duration=1e3 * seconds / count, loop=0)
    return file.getvalue()


def _draw_scene(axes: Axes, run: Run, time: float, deflection: float) -> None:
    """Draw the share behind its strut at a time; the strut stays in place while the soil moves past."""
    from matplotlib.colors import LinearSegmentedColormap

    scene = run.scene
    height, radius = float(scene.cone.height), float(scene.cone.height * scene.cone.slope)
    front = float(scene.loosened_radius) if scene.medium == "plastic" else radius
    magnification = max(1.0, _SWING * 4.0 * height / max(float(np.max(np.abs(run.deflection))), 1e-9))
    strut = float(np.interp(time, run.time, np.asarray(run.travel) + np.asarray(run.deflection)))
    axes.clear()
    x = np.linspace(-3.0 * height, 1.5 * height, _SOIL_COLUMNS)
    strength = np.ones_like(x)
    for wave in scene.effects.waves:
        strength += as_number(wave.amplitude * sin(2.0 * math.pi * (x + strut) / wave.wavelength + wave.phase))
    soil = 1.25 * max(front, radius)  # half height of the soil
    extent = x[0], x[-1], -soil, soil
    axes.imshow(
        strength[None],
        extent=extent,
        aspect="auto",
        cmap=LinearSegmentedColormap.from_list("soil", _SOIL_COLOURS),
        vmin=0.0,
        vmax=2.0,
    )
    tip = -magnification * deflection
    for half, colour, opacity in ((front, SOIL, 0.45), (radius, SHARE, 1.0)):
        axes.fill([tip, tip - height, tip - height], [0.0, half, -half], color=colour, alpha=opacity)
    axes.axvline(0.0, color="black", linestyle="--", linewidth=1.0)
    axes.plot([tip - 0.6 * height, -0.6 * height], [0.3 * radius, 1.6 * soil], color=STRUT, linewidth=5)
    axes.plot([-1.3 * height, 0.1 * height], [1.6 * soil] * 2, color="black", linewidth=7)
    axes.set(xlim=(x[0], x[-1]), ylim=(-soil, 1.8 * soil), xticks=[], yticks=[])
    key = "dashed: tip without load; darker: stronger soil"
    axes.set_title(f"{time:.3f} s; deflection magnified {magnification:.2g} times; {key}", fontsize="small")
