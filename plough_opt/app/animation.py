"""The motion of a run as an animation: a GIF, or a page with controls."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from plough_opt.app.page import motion, rendered
from plough_opt.app.panels import LIMIT, SHARE, SOIL, STRUT, changing, deflection_of, draw_panel, subject, triangle
from plough_opt.core.checks import check_domain, path_of
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, sin
from plough_opt.core.files import check_file, figure_of_size, write_file
from plough_opt.motion import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Frames per second, frames and colours: more make a GIF larger than 2 MB.
_RATE: Final = 15.0
_MAX_FRAMES: Final = 120
_COLOURS: Final = 48


def write_animation(run: Run, target: str | Path, slower: float) -> Path:
    """Write the motion of a numeric run: see `Run.animate`."""
    path = path_of("the animation", target)
    check_domain("slower", slower, "times", above=0.0)
    if not changing(run):
        raise InputError("nothing changes over time in this run, so there is no motion to animate")
    if path.suffix.lower() == ".html":
        text = rendered("motion.html", title=subject(run).replace("\n", ": "), data={"motion": motion(run)})
        return write_file(path, "animation", text)
    check_file(path, "animation", ".html", ".gif")
    return write_file(path, "animation", _gif(run, slower))


def _gif(run: Run, slower: float) -> bytes:
    """Return the motion as a GIF, played ``slower`` times slower than it happens."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image  # a dependency of matplotlib

    seconds = float(run.time[-1]) * slower
    figure, frames = figure_of_size(8.0, 5.0), []
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(80)
    figure.suptitle(f"{subject(run)}, {slower:g} times slower", fontsize="medium")
    upper, lower = figure.subplots(2, 1, height_ratios=(1.3, 1.0))
    panel = deflection_of(run)
    draw_panel(lower, run, panel)
    (dot,) = lower.plot([], [], "o", color=LIMIT, markersize=8)
    move = _scene(upper, run)
    for time in np.linspace(0.0, float(run.time[-1]), max(2, min(_MAX_FRAMES, math.ceil(seconds * _RATE)))):
        deflection = float(np.interp(time, run.time, run.deflection))
        dot.set_data([time], [deflection / panel.unit.factor])
        move(time, deflection)
        canvas.draw()  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # so that all frames keep the layout of the first
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        frames.append(Image.fromarray(pixels).convert("RGB").quantize(_COLOURS, Image.Quantize.FASTOCTREE))
    file, (first, *rest) = io.BytesIO(), frames
    first.save(file, "GIF", save_all=True, append_images=rest, duration=1e3 * seconds / len(frames), loop=0)
    return file.getvalue()


def _scene(axes: Axes, run: Run) -> Callable[[float, float], None]:
    """Draw the share behind its strut, which stays in place; return what moves share and soil to a time."""
    from matplotlib.colors import LinearSegmentedColormap

    scene = run.scene
    height, radius = float(scene.cone.height), float(scene.cone.height * scene.cone.slope)
    front = float(scene.loosened_radius) if scene.medium == "plastic" else radius
    magnification = max(1.0, 1.4 * height / max(float(np.max(np.abs(run.deflection))), 1e-9))
    path, x = np.asarray(run.travel) + np.asarray(run.deflection), np.linspace(-3.0 * height, 1.5 * height, 400)
    half = 1.25 * max(front, radius)  # height of the soil above the axis
    colours = LinearSegmentedColormap.from_list("soil", ("#F7E7CE", "#B59468"))
    soil = axes.imshow(x[None], extent=(x[0], x[-1], -half, half), aspect="auto", cmap=colours, vmin=0.0, vmax=2.0)
    bodies = [triangle(axes, height, *shape) for shape in ((front, SOIL, 0.45), (radius, SHARE, 1.0))]
    (shank,) = axes.plot([], [], color=STRUT, linewidth=5)
    axes.axvline(0.0, color="black", linestyle="--", linewidth=1.0)
    axes.plot([-1.3 * height, 0.1 * height], [1.6 * half] * 2, color="black", linewidth=7)
    axes.set(xlim=(x[0], x[-1]), ylim=(-half, 1.8 * half), xticks=[], yticks=[])

    def move(time: float, deflection: float) -> None:
        place, strength = x + float(np.interp(time, run.time, path)), np.ones_like(x)
        for wave in scene.effects.waves:
            strength += as_number(wave.amplitude * sin(2.0 * math.pi * place / wave.wavelength + wave.phase))
        soil.set_data(strength[None])
        tip = -magnification * deflection
        for body, end in zip(bodies, (front, radius), strict=True):
            body.set_xy([(tip, 0.0), (tip - height, end), (tip - height, -end)])
        shank.set_data([tip - 0.6 * height, -0.6 * height], [0.3 * radius, 1.6 * half])
        words = f"deflection magnified {magnification:.2g} times; dashed: tip without load; darker: stronger soil"
        axes.set_title(f"{time:.3f} s; {words}", fontsize="small")

    return move
