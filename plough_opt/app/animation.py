"""The motion of a run as a picture that moves: GIF for slides, HTML to play and step."""

import io
import math
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from plough_opt.app.run_picture import LIMIT, OWN, SOIL, STRUT, changing, deflection_of, draw_panel, subject
from plough_opt.core.checks import check_domain, path_of
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, sin
from plough_opt.core.files import check_file, write_file
from plough_opt.motion import Run

# Pictures in a second, and at most in a file, which then takes some 2 MB; and colours of each.
_RATE: Final = 15.0
_MOST: Final = 120
_COLOURS: Final = 48
# Of the scene's width: how far the largest deflection is drawn.
_SWING: Final = 0.35
_SHADES: Final = 400
# Soil from loose to strong.
_GROUND: Final = LinearSegmentedColormap.from_list("ground", ["#F7E7CE", "#B59468"])


def write_animation(run: Run, target: str | Path, slower: float) -> Path:
    """Write the motion of a numeric run: see `Run.animate`."""
    path = path_of("the animation", target)
    check_domain("slower", slower, "times", above=0.0)
    if not changing(run):
        raise InputError("nothing changes over time in this run: there is no motion to show")
    if path.suffix.lower() == ".html":
        from plough_opt.app.page.writing import motion_page

        return write_file(path, "animation", motion_page(run, subject(run).replace("\n", ": ")))
    check_file(path, ".gif", "animation, which is .html or .gif")
    return write_file(path, "animation", _gif(run, slower))


def _gif(run: Run, slower: float) -> bytes:
    from PIL import Image  # which matplotlib brings

    lasts = float(run.time[-1]) * slower
    count = max(2, min(_MOST, math.ceil(lasts * _RATE)))
    figure = Figure(figsize=(8.0, 5.0), dpi=80, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.3, 1.0))
    figure.suptitle(f"{subject(run)}, {slower:g} times slower", fontsize="medium")
    draw_panel(lower, run, deflection_of(run))
    (dot,) = lower.plot([], [], "o", color=LIMIT, markersize=8)
    mean = float(run.mean_deflection)
    factor = run.origin.common("m", {"deflection": run.peak_deflection, "mean_deflection": mean}).factor
    _draw_scene(upper, run, 0.0, 0.0)
    canvas.draw()  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")  # which would lay out every picture anew
    pictures = []
    for time in np.linspace(0.0, float(run.time[-1]), count):
        deflection = float(np.interp(time, run.time, run.deflection))
        dot.set_data([time], [deflection / factor])
        _draw_scene(upper, run, time, deflection)
        canvas.draw()  # type: ignore[no-untyped-call]
        seen = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        pictures.append(Image.fromarray(seen).convert("RGB").quantize(_COLOURS, Image.Quantize.FASTOCTREE))
    file = io.BytesIO()
    first, *rest = pictures
    first.save(file, "GIF", save_all=True, append_images=rest, duration=1e3 * lasts / count, loop=0)
    return file.getvalue()


def _draw_scene(axes: Axes, run: Run, time: float, deflection: float) -> None:
    """Draw the share behind its strut, which stands still in the picture while the soil passes."""
    scene = run.scene
    height, radius = float(scene.cone.height), float(scene.cone.height * scene.cone.slope)
    front = float(scene.loosened_radius) if scene.medium == "plastic" else radius
    larger = max(1.0, _SWING * 4.0 * height / max(float(np.max(np.abs(run.deflection))), 1e-9))
    strut = float(np.interp(time, run.time, np.asarray(run.travel) + np.asarray(run.deflection)))
    axes.clear()
    x = np.linspace(-3.0 * height, 1.5 * height, _SHADES)
    strength = np.ones_like(x)
    for wave in scene.effects.waves:
        strength += as_number(wave.amplitude * sin(2.0 * math.pi * (x + strut) / wave.wavelength + wave.phase))
    deep = 1.25 * max(front, radius)
    axes.imshow(strength[None], extent=(x[0], x[-1], -deep, deep), aspect="auto", cmap=_GROUND, vmin=0.0, vmax=2.0)
    tip = -larger * deflection
    for half, colour, shade in ((front, SOIL, 0.45), (radius, OWN, 1.0)):
        axes.fill([tip, tip - height, tip - height], [0.0, half, -half], color=colour, alpha=shade)
    axes.axvline(0.0, color="black", linestyle="--", linewidth=1.0)
    axes.plot([tip - 0.6 * height, -0.6 * height], [0.3 * radius, 1.6 * deep], color=STRUT, linewidth=5)
    axes.plot([-1.3 * height, 0.1 * height], [1.6 * deep] * 2, color="black", linewidth=7)
    axes.set(xlim=(x[0], x[-1]), ylim=(-deep, 1.8 * deep), xticks=[], yticks=[])
    said = "dashed: the tip without load; darker: stronger soil"
    axes.set_title(f"{time:.3f} s; deflection drawn {larger:.2g} times larger; {said}", fontsize="small")
