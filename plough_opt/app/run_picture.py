"""A run over time: forces, deflection and speed, in the units of its question, with the limits that it must keep."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind
from plough_opt.core.files import COLOURS
from plough_opt.core.units import Display
from plough_opt.design import Limit
from plough_opt.motion import Run
from plough_opt.motion.equation import GAP, STICK
from plough_opt.motion.terms import Structure, parameters, start_speed, strut
from plough_opt.motion.vocabulary import called

OWN, LIMIT, SOIL, STRUT = COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[6]
"""Colours of the share's own motion and force, of limits, of the soil, and of the strut, in every picture."""

# Part of its size by which a value that stays the same changes through rounding.
_CONSTANT = 1e-6


def subject(run: Run) -> str:
    """Return what stands above a picture: the question's title, the soil and the speed."""
    speed = run.origin.display("scene.tow_speed", "m/s").text(float(run.scene.tow_speed), 4)
    return "\n".join(part for part in (run.origin.title, f"{run.scene.soil.name}, {speed}") if part)


def plot_run(run: Run, limits: Sequence[Limit] = ()) -> Figure:
    """Draw forces, deflection and speed of a numeric run over time, those that change.

    Args:
        run: numeric.
        limits: requirements beside those of the run's question; those on what is drawn are shown.

    Raises:
        InputError: no run.
    """
    check_kind("the run", run, Run, "a numeric Run, as po.simulate returns one")
    panels = changing(run)
    figure = Figure(figsize=(9, 1.0 + 2.3 * max(1, len(panels))), layout="constrained")
    figure.suptitle(subject(run))
    if not panels:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.text(0.5, 0.5, f"Nothing changes over time.\n\n{run.response()}", ha="center", va="center",
                  family="monospace", transform=axes.transAxes)  # fmt: skip
        return figure
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, draw in zip(rows, panels, strict=True):
        draw(axes, run, limits)
        axes.set_xlabel("")
    rows[-1].set_xlabel("time [s]")
    return figure


def changing(run: Run) -> list[Callable[[Axes, Run, Sequence[Limit]], None]]:
    """Return what draws force, deflection and speed of a run, without those that stay the same."""
    forces = (run.mount_force, run.soil_resistance)
    every = ((draw_force, forces), (draw_deflection, (run.deflection,)), (draw_speed, (run.speed, _strut_speed(run))))
    return [draw for draw, values in every if any(map(_changes, values))]


def draw_force(axes: Axes, run: Run, limits: Sequence[Limit] = ()) -> None:
    """Draw mount force and soil resistance, with mean draft and RMS."""
    unit = run.origin.common("N", {"mount_force": run.peak_force, "mean_draft": run.mean_draft})
    axes.plot(run.time, run.soil_resistance / unit.factor, color=SOIL, linewidth=1.0, label="soil resistance")
    axes.plot(run.time, run.mount_force / unit.factor, color=OWN, linewidth=1.4, label="mount force")
    _draw_mean(axes, "mean draft", run.mean_draft, run.force_rms, unit)
    _shade_modes(axes, run)
    _finish(axes, run, "force", unit, limits_of(run, limits, "mount_force", "mean_draft"))


def draw_deflection(axes: Axes, run: Run, limits: Sequence[Limit] = ()) -> None:
    """Draw the spring's deflection, with its mean and RMS."""
    unit = run.origin.common("m", {"deflection": run.peak_deflection, "mean_deflection": run.mean_deflection})
    axes.plot(run.time, run.deflection / unit.factor, color=OWN, linewidth=1.2, label="deflection")
    _draw_mean(axes, "mean", run.mean_deflection, run.displacement_rms, unit)
    _finish(axes, run, "deflection", unit, limits_of(run, limits, "deflection", "mean_deflection"))


def draw_speed(axes: Axes, run: Run, limits: Sequence[Limit] = ()) -> None:
    """Draw the share's speed beside the strut's."""
    unit = run.origin.display("scene.tow_speed", "m/s")
    axes.plot(run.time, _strut_speed(run) / unit.factor, color=STRUT, linewidth=1.0, linestyle="--", label="strut")
    axes.plot(run.time, run.speed / unit.factor, color=OWN, linewidth=1.2, label="share")
    _finish(axes, run, "speed", unit, limits_of(run, limits, "speed"))


def _strut_speed(run: Run) -> NDArray[np.float64]:
    structure, p = Structure.of(run.scene), parameters(run.scene)
    found: NDArray[np.float64] = start_speed(structure, p) + strut(structure, p, run.time).gain + 0.0 * run.time
    return found


def _draw_mean(axes: Axes, name: str, mean: float, rms: float, unit: Display) -> None:
    """Draw a mean with a band of its RMS, where there is one."""
    axes.axhline(mean / unit.factor, color="black", linewidth=1.0, linestyle="--", label=f"{name} {unit.text(mean, 3)}")
    if rms > _CONSTANT * abs(mean):
        axes.axhspan((mean - rms) / unit.factor, (mean + rms) / unit.factor, color="black", alpha=0.08,
                     label=f"± RMS {unit.text(rms, 3)}")  # fmt: skip


def _finish(axes: Axes, run: Run, name: str, unit: Display, limits: Iterable[tuple[str, float]]) -> None:
    """Draw limits, name the axes, and give the legend room above all lines."""
    for words, value in limits:
        label = f"limit of the {words} {unit.text(value, 4)}"
        axes.axhline(value / unit.factor, color=LIMIT, linewidth=1.6, label=label)
    axes.set(xlabel="time [s]", ylabel=unit.heading(name), xlim=(float(run.time[0]), float(run.time[-1])))
    low, high = axes.get_ylim()
    # What stays the same would have its rounding magnified.
    least = _CONSTANT * max(abs(low), abs(high))
    if high - low < 0.1 * max(abs(low), abs(high)):
        low, high = low - 0.05 * abs(low) - least, high + 0.05 * abs(high) + least
    axes.set_ylim(low, high + 0.26 * (high - low))
    axes.legend(loc="upper right", ncols=5, fontsize="x-small")


def limits_of(run: Run, limits: Sequence[Limit], *names: str) -> list[tuple[str, float]]:
    """Return the limits of some results, by the question or as they are given, each with its name in words."""
    given = {limit.name: (limit.low, limit.high) for limit in limits if limit.kind == "requirement"}
    every = {**run.origin.limits, **given}
    return [(called(name), end) for name in names for end in every.get(name, ()) if end is not None]


def _changes(values: NDArray[np.float64]) -> bool:
    return bool(np.ptp(values) > _CONSTANT * np.max(np.abs(values)))


def _shade_modes(axes: Axes, run: Run) -> None:
    """Shade the times in which a share under stick and slip sticks or has a gap ahead."""
    for mode, label, color in ((STICK, "sticks", STRUT), (GAP, "gap", LIMIT)):
        inside = np.asarray(run.mode) == mode
        if np.any(inside):
            axes.fill_between(run.time, 0, 1, where=inside.tolist(), transform=axes.get_xaxis_transform(),
                              color=color, alpha=0.18, linewidth=0.0, label=label)  # fmt: skip
