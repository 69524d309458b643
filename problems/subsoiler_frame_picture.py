"""Picture of `subsoiler_frame`: the machine across its width, its forces, its tubes, and its best spacing."""

import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from subsoiler_frame import DEPTH, LEG_LENGTH, STRENGTH, WAVE, design, solved
from subsoiler_frame_check import FREE, evaluate

import plough_opt as po
from plough_opt import plots

SPACINGS = (0.26, 0.30, 0.34, 0.38, 0.42, 0.50, 0.54, 0.58, 0.62, 0.66)


def draw(m: SimpleNamespace, best: po.Optimum, path: str | Path, *, designs: int = 20_000) -> Path:
    """Draw the best machine and a number of random designs to a file, and return its path."""
    figure = Figure(figsize=(13, 9.5), layout="constrained")
    (across, forces), (tube, fuel) = figure.subplots(2, 2)
    draw_machine(across, m, best)
    draw_forces(forces, m, best)
    draw_stress(tube, m, best)
    draw_spacing(fuel, m, best, designs)
    v = best.variables
    figure.suptitle(
        f"{len(m.scenes)} shares {100 * v['spacing']:.0f} cm apart at {v['speed']:.2f} m/s:"
        f" {best(m.fuel):.0f} MJ of fuel per hectare, {best(m.work_rate):.2f} ha/h", fontsize=14,
    )  # fmt: skip
    return plots.save(figure, path)


def colors(n: int) -> list[tuple[float, ...]]:
    """Return a colour for each share, from sandy to hard soil, without colours that are pale on white."""
    return [colormaps["copper_r"](x) for x in np.linspace(0.4, 0.97, n)]


def draw_machine(axes: Axes, m: SimpleNamespace, best: po.Optimum) -> None:
    """Draw the machine from behind: soils, loosened zones, legs, tubes, brackets and the tractor's centre line."""
    places, radii, v = best(m.places), best(m.radii), best.variables
    for place, radius, scene, color in zip(places, radii, m.scenes, colors(len(places)), strict=True):
        left = place - v["spacing"] / 2
        axes.add_patch(Rectangle((left, -0.85), v["spacing"], 0.85, color=color, alpha=0.3, linewidth=0))
        axes.add_patch(Circle((place, -DEPTH), radius, facecolor=color, alpha=0.55, edgecolor="black", linewidth=0.8))
        axes.plot([place, place], [-DEPTH, LEG_LENGTH - DEPTH], color="0.2", linewidth=3, solid_capstyle="butt")
        axes.text(place, -0.83, scene.soil.name, ha="center", va="bottom", fontsize="small")
    side = v["tube"]
    low, high = places[0] - 0.15, places[-1] + 0.15
    axes.add_patch(Rectangle((low, LEG_LENGTH - DEPTH), high - low, side, color="#b03a2e"))
    for sign in (-1, 1):
        axes.plot(
            sign * v["bracket"], LEG_LENGTH - DEPTH + side, marker="v", color="black", markersize=11, clip_on=False
        )
        axes.annotate("bracket", (sign * v["bracket"], LEG_LENGTH - DEPTH + side), (8, 4), ha="left",
                      textcoords="offset points", fontsize="small")  # fmt: skip
    axes.plot([0.0, 0.0], [0.0, 0.78], color="black", linestyle="-.", linewidth=0.9)
    axes.text(0.02, 0.74, "tractor's\ncentre line", va="top", fontsize="small")
    axes.axhline(0.0, color="0.3", linewidth=1.0)
    ends = places[0] - max(radii[0], v["spacing"] / 2), places[-1] + max(radii[-1], v["spacing"] / 2)
    axes.set(xlim=(ends[0] - 0.03, ends[1] + 0.03), ylim=(-0.86, 0.78), aspect="equal", xlabel="across the width [m]",
             ylabel="above the ground [m]", title="Loosened zones just meet where the soil is loosest")  # fmt: skip


def draw_forces(axes: Axes, m: SimpleNamespace, best: po.Optimum) -> None:
    """Draw the mount force of every share over two waves of the soil's strength, with its mean."""
    for k, (scene, color) in enumerate(zip(best(m.scenes), colors(len(m.scenes)), strict=True)):
        run = po.simulate(scene)
        path = np.concatenate([run.time, run.time[1:] + run.time[-1]]) * scene.tow_speed
        force = np.concatenate([run.mount_force, run.mount_force[1:]]) / 1e3
        label = f"share {k + 1}, swings by {1e3 * run.displacement_rms:.1f} mm"
        axes.plot(path, force, color=color, linewidth=2, label=label)
        axes.plot(path[[0, -1]], [run.mean_draft / 1e3] * 2, color=color, linestyle=":", linewidth=1)
    high = 1.35 * axes.get_ylim()[1]  # with room for the legend
    axes.set(xlim=(0, 2 * WAVE.wavelength), ylim=(0, high), xlabel="path [m]", ylabel="force on the mount [kN]",
             title="Force on each mount (dotted: mean), and RMS of its share's swing")  # fmt: skip
    axes.legend(fontsize="small", ncols=2, loc="upper center")
    axes.grid(alpha=0.25)


def draw_stress(axes: Axes, m: SimpleNamespace, best: po.Optimum) -> None:
    """Draw the bending stress along a tube, for each share when it gives way to a stone."""
    places, bracket = best(m.places), best.variables["bracket"]
    at = np.array([*places, -bracket, bracket])
    order = np.argsort(at)
    for k, (case, color) in enumerate(zip(best(m.stresses), colors(len(places)), strict=True)):
        axes.plot(at[order], np.array(case)[order] / 1e6, "o-", color=color, markersize=4, label=f"share {k + 1}")
    for sign in (-1, 1):
        axes.axhline(sign * STRENGTH / 1e6, color="#b03a2e", linestyle="--", linewidth=1.2)
        axes.axvline(sign * bracket, color="black", linewidth=0.8, linestyle=":")
        axes.annotate(f"strength {sign * STRENGTH / 1e6:+.0f} MPa", (places[0], sign * STRENGTH / 1e6), (0, -4 * sign),
                      textcoords="offset points", va="top" if sign > 0 else "bottom", fontsize="small",
                      color="#b03a2e")  # fmt: skip
    axes.text(bracket - 0.02, -0.95 * STRENGTH / 1e6, "bracket", fontsize="small", ha="right", va="bottom", rotation=90)
    axes.legend(title="stone under", fontsize="small", loc=(0.55, 0.62))
    axes.set(xlabel="across the width [m]", ylabel="bending stress [MPa]",
             title="Brackets stand where overhang and middle are loaded alike")  # fmt: skip
    axes.grid(alpha=0.25)


def draw_spacing(axes: Axes, m: SimpleNamespace, best: po.Optimum, designs: int) -> None:
    """Draw the minimum fuel over the spacing, with all other variables optimal, and random designs above it."""
    n, own, fuel = len(m.scenes), best.variables["spacing"], best(m.fuel)
    curve = sorted([*least_fuel(n, own, SPACINGS), (own, fuel)])
    axes.plot(*zip(*curve, strict=True), color="#1f5f8b", linewidth=2, label="optimised at this spacing")
    found = cloud(n, best, designs)
    good = found.worst <= 1e-9
    axes.plot(found.variables.spacing[good], found.fuel[good], ".", color="0.45", markersize=3, zorder=1,
              label=f"{np.sum(good)} of {good.size} random designs in NumPy\nthat meet all limits")  # fmt: skip
    axes.plot(own, fuel, "*", color="#b03a2e", markersize=15, label=f"optimum, {fuel:.1f} MJ/ha")
    axes.set(xlabel="spacing [m]", ylabel="fuel [MJ/ha]", ylim=(0.985 * fuel, 1.25 * fuel),
             xlim=(SPACINGS[0] - 0.01, SPACINGS[-1] + 0.01), title="Neither narrow nor wide")  # fmt: skip
    axes.legend(fontsize="small", loc="upper center")
    axes.grid(alpha=0.25)


def least_fuel(n: int, own: float, spacings: tuple[float, ...]) -> list[tuple[float, float]]:
    """Return spacings and the minimum fuel for each, with a limit that pushes the spacing away from its optimum."""
    d, c, m = design(n)
    widest, narrowest = d.parameter("widest", 9.0, unit="m"), d.parameter("narrowest", 0.0, unit="m")
    d.require("wide enough", c.spacing - narrowest, at_least=0.0, unit="m")
    d.require("narrow enough", widest - c.spacing, at_least=0.0, unit="m")
    found = []
    for spacing in spacings:
        side = "widest" if spacing < own else "narrowest"
        found.append((spacing, d.solve(parameters={side: spacing}, search="local")(m.fuel)))
    return found


def cloud(n: int, best: po.Optimum, count: int, seed: int = 1) -> SimpleNamespace:
    """Return random designs in a box around the best one, evaluated by NumPy alone."""
    v = best.variables
    low = [0.97, SPACINGS[0] / v["spacing"], 0.6, 0.6, 0.8, 0.3]
    high = [1.0, SPACINGS[-1] / v["spacing"], 2.5, 1.35, 1.2, 1.6]
    rows = np.random.default_rng(seed).uniform(low, high, (count, len(FREE))).T
    parts = np.array_split(rows * np.array([[v[name]] for name in FREE]), math.ceil(count / 4000), axis=1)
    found = [evaluate(part, n) for part in parts]
    spacing = np.concatenate([part.variables.spacing for part in found])
    return SimpleNamespace(
        fuel=np.concatenate([part.fuel for part in found]),
        worst=np.concatenate([part.worst for part in found]),
        variables=SimpleNamespace(spacing=spacing),
    )


if __name__ == "__main__":
    _, results, optimum = solved()
    print(f"wrote {draw(results, optimum, sys.argv[1])}")
