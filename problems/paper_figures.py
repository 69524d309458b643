"""Figures 1 to 7 of the source, computed again, and its Discussion compared with the results of equation (27).

    python problems/paper_figures.py --folder out

The source publishes stiffnesses and density ratios, but no mass, height, speed or soil: the trend of its figures
can be compared, not the numbers. The values chosen here (`Choice`) make the stiffnesses mean something: the static
resistance F0 is of the order of k0 V0 t within the first oscillation, so the share is driven back at the start by no
more than a seventh of the tow speed (k0 = 50 N/m, b1 = 0.95; the script prints how fast). Two things in the
source's figures cannot be had at all: b1 = 1 is a singularity of the theory (a = 1/(1 - b1)), 0.95 stands for it;
and soil of 1300 kg/m^3 with b1 below 0.49 would be locked denser than its own grains, 2650 kg/m^3, so the curves for
0.2 and 0.4 are arithmetic and not soil.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import plough_opt as po
from plough_opt import plots
from plough_opt.expressions import Expression

DENSITY_RATIOS = (0.2, 0.4, 0.6, 0.8, 0.95)
CHISEL_ANGLES = (5.0, 10.0, 15.0, 20.0)
DURATION, OUTPUTS = 3.0, 1500


@dataclass(frozen=True)
class Choice:
    """Values that the source does not give, in SI.

    Attributes:
        wedge_angle: 20 degrees: with the chisel angle a half angle of 7 degrees, well within plane sections.
        chisel_angle: 15 degrees, the third of figure 3.
        height: a share for the laboratory; one of 0.25 m would meet 2.8 times the resistance.
        mass: the share as a solid cone of steel (0.43 kg) and a light carrier.
        tow_speed: 7.2 km/h.
        density: loose topsoil.
        friction_angle: of a sandy loam.
        cohesion: a fifth of the named "loose sandy loam": with 5 kPa F0 would be 68 N, beside V0 sqrt(k0 M) = 25 N.
        tool_friction: of the named "loose sandy loam".
        ambient_pressure: none: open pores near the surface. The atmosphere would raise F0 sixtyfold.
    """

    wedge_angle: float = math.radians(20.0)
    chisel_angle: float = math.radians(15.0)
    height: float = 0.15
    mass: float = 3.0
    tow_speed: float = 2.0
    density: float = 1300.0
    friction_angle: float = math.radians(30.0)
    cohesion: float = 1e3
    tool_friction: float = 0.4
    ambient_pressure: float = 0.0


CHOICE = Choice()


def scene(density_ratio: float, stiffness: float, **effects: Any) -> po.Scene:
    """Return the share of the figures, at rest at the start; effects as in `plough_opt.Effects`."""
    c = CHOICE
    soil = po.Soil(
        c.density, density_ratio, c.cohesion, c.friction_angle, c.tool_friction, c.ambient_pressure, name="loose soil"
    )
    share = po.Wedge(c.wedge_angle, c.chisel_angle, c.height)
    # Mounts as soft as the source's are not found in practice: with its unit the number is meant as it is.
    return po.Scene(soil, share, f"{stiffness} N/m", c.mass, c.tow_speed, po.Effects(start="rest", **effects))


@lru_cache(maxsize=64)
def run(density_ratio: float, stiffness: float) -> po.Run:
    """Return equation (27) as derived, drag and added mass included."""
    return po.simulate(scene(density_ratio, stiffness), DURATION, outputs=OUTPUTS)


# --- what a curve shows, in numbers ---


@dataclass(frozen=True)
class Swing:
    """The first oscillation of a run, and the amplitude of the last one.

    Attributes:
        period: from its first crest to the next [s].
        displacement: half the way of the deflection from the first crest to the trough after it [m].
        force: the same of the elastic force [N].
        last: half the way of the deflection between the last two turning points [m].
        compressed: part of the first period in which the spring is compressed [-].
        peak_force: elastic force at the first crest [N].
        retreat: fastest speed backwards [m/s], 0 for a share that never retreats.
    """

    period: float
    displacement: float
    force: float
    last: float
    compressed: float
    peak_force: float
    retreat: float


def swing(found: po.Run) -> Swing:
    """Return the first oscillation of a run, with turning points interpolated between output times."""
    t, z, stiffness = found.time, found.deflection, found.scene.stiffness
    rate = found.scene.tow_speed - found.speed
    turns = np.flatnonzero(rate[:-1] * rate[1:] < 0.0)
    part = rate[turns] / (rate[turns] - rate[turns + 1])
    step = part * (t[1] - t[0])
    times, heights = t[turns] + step, z[turns] + rate[turns] * step / 2.0
    period = float(times[2] - times[0])
    half = float(heights[0] - heights[1]) / 2.0
    return Swing(
        period=period,
        displacement=half,
        force=stiffness * half,
        last=abs(float(heights[-1] - heights[-2])) / 2.0,
        compressed=part_above_zero(t, z, period),
        peak_force=stiffness * float(heights[0]),
        retreat=max(0.0, -float(np.min(found.speed))),
    )


def part_above_zero(t: NDArray[np.float64], z: NDArray[np.float64], end: float) -> float:
    """Return the fraction of the time up to ``end`` during which z, linear between samples, is above zero."""
    inside = t < end
    x, y = np.append(t[inside], end), np.append(z[inside], np.interp(end, t, z))
    low, high = np.minimum(y[:-1], y[1:]), np.maximum(y[:-1], y[1:])
    above = np.clip(high / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    return float(np.sum(np.diff(x) * above) / end)


# --- figures ---


def figure_1() -> Figure:
    """Draw the stresses around a curved thin wedge in the linear elastic medium, equations (1) and (2)."""
    length = CHOICE.height
    profile = po.elastic.knots(lambda x: 0.2 * x * (1.0 - x / (2.0 * length)), length, 12)
    figure = plots.plot_wedge_field(profile, po.named_soil("loose sandy loam"), CHOICE.tow_speed)
    figure.suptitle("Fig. 1. A curved thin wedge moves through a linear elastic soil")
    return figure


def figure_2() -> Figure:
    """Draw the share's faces and its equivalent cone at the same scale, with the compacted soil of b1 = 0.8."""
    shown = scene(0.8, 50.0)
    figure = plots.plot_share(shown)
    figure.suptitle("Fig. 2. Share and equivalent cone")
    return figure


def figure_3() -> Figure:
    """Draw the half angle of the equivalent cone over the wedge angle, equation (7)."""
    figure, axes = _axes("wedge angle λ [deg]", "half angle β of the equivalent cone [rad]")
    angles = np.linspace(0.01, 89.99, 1000)
    for chisel, color in zip(CHISEL_ANGLES, _colors(len(CHISEL_ANGLES)), strict=True):
        axes.plot(angles, half_angle(angles, chisel), color=color, label=rf"$\beta_{{pl}}$ = {chisel:.0f}°")
    limit = math.radians(20.0)
    axes.axhline(limit, color="0.5", linestyle="--", linewidth=1.0)
    axes.text(1.5, limit + 0.02, "above 20° the hypothesis of plane sections fails", color="0.35", fontsize="small")
    axes.set(xlim=(0, 90), ylim=(0, math.pi / 2), xticks=range(0, 91, 15))
    axes.legend(title="chisel angle", loc="upper left", bbox_to_anchor=(0.02, 0.98))
    axes.set_title("Fig. 3. Half angle of the cone of equal height and surface")
    return figure


def half_angle(wedge_angle: Expression, chisel_angle: float) -> Expression:
    """Return the equivalent cone's half angle [rad] for wedge angles in degrees."""
    return po.Wedge(po.deg(wedge_angle), po.deg(chisel_angle), 1.0).equivalent_cone().half_angle


def figure_travel(number: int, stiffness: float) -> Figure:
    """Draw figure 4 or 5: travel of the share over time."""
    figure, axes = _axes("time t [s]", "travel L of the share [m]")
    for found, color in zip(_runs(stiffness), _colors(len(DENSITY_RATIOS)), strict=True):
        axes.plot(found.time, found.travel, color=color, label=_named(found))
    strut = CHOICE.tow_speed * np.array([0.0, DURATION])
    axes.plot([0.0, DURATION], strut, color="black", linestyle=":", linewidth=1.2, label="strut, V₀ t")
    axes.legend(loc="upper left", fontsize="small")
    axes.set(xlim=(0, DURATION), title=f"Fig. {number}. Travel from rest, k₀ = {stiffness:.0f} N/m")
    return figure


def figure_force(number: int, stiffness: float) -> Figure:
    """Draw figure 6 or 7: elastic force k0 (V0 t - L) over time."""
    figure, axes = _axes("time t [s]", "elastic force P = k₀ (V₀ t − L) [N]")
    for found, color in zip(_runs(stiffness), _colors(len(DENSITY_RATIOS)), strict=True):
        axes.plot(found.time, found.mount_force, color=color, label=_named(found))
    axes.axhline(0.0, color="black", linewidth=0.8)
    low, high = axes.get_ylim()
    top = high + 0.18 * (high - low)
    axes.axhspan(low, 0.0, color="0.5", alpha=0.1, linewidth=0.0)
    axes.set_ylim(low, top)
    for text, level, side in (("compression", 0.975, "top"), ("tension", 0.02, "bottom")):
        axes.text(0.008, level, text, va=side, fontsize="small", color="0.35", transform=axes.transAxes)
    axes.legend(loc="upper center", fontsize="small", ncols=3)
    axes.set(xlim=(0, DURATION), title=f"Fig. {number}. Elastic force from rest, k₀ = {stiffness:.0f} N/m")
    return figure


PRINTED_RATIO, PRINTED_STIFFNESS, PRINTED_DURATION = 0.6, 50.0, 0.8


@lru_cache(maxsize=8)
def printed_run(**effects: object) -> po.Run:
    """Return the run of a printed figure with other effects than the derived ones."""
    return po.simulate(scene(PRINTED_RATIO, PRINTED_STIFFNESS, **effects), PRINTED_DURATION, outputs=400)


def figure_printed() -> Figure:
    """Draw equation (27) as printed and as derived: as printed the spring repels, and L grows like exp(omega t)."""
    derived, whole = printed_run(), printed_run(formulation="printed")
    alone = printed_run(formulation="printed", inertial_drag=False)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(derived.time, CHOICE.tow_speed * derived.time, "k:", linewidth=1.2, label="strut, V₀ t")
    left.plot(derived.time, derived.travel, color="#1f5f8b", label="derived: k₀ (V₀ t − L)")
    left.plot(whole.time, whole.travel, color="#c0392b", label="as printed: k₀ (L − V₀ t)")
    left.set_ylabel("travel L of the share [m]")
    left.legend(loc="lower left", fontsize="small")
    for found, style, name in ((whole, "-", "as printed"), (alone, "--", "as printed, without drag")):
        right.plot(found.time[1:], found.deflection[1:], style, color="#c0392b", label=name)
    right.plot(derived.time[1:], derived.deflection[1:], color="#1f5f8b", label="derived")
    omega = alone.scene.natural_frequency
    right.plot(alone.time, runaway(alone.scene) * np.exp(omega * alone.time), "k:", linewidth=1.2,
               label=f"exp(ω t), ω = √(k₀/M) = {omega:.2f}/s")  # fmt: skip
    right.set(yscale="log", ylabel="distance behind the strut V₀ t − L [m]")
    right.legend(loc="lower right", fontsize="small")
    for axes in (left, right):
        axes.set(xlim=(0, PRINTED_DURATION), xlabel="time t [s]")
        axes.grid(alpha=0.25)
    figure.suptitle(f"Equation (27) as printed and as derived, k₀ = {PRINTED_STIFFNESS:.0f} N/m, b₁ = {PRINTED_RATIO}")
    return figure


def runaway(printed: po.Scene) -> float:
    """Return the factor of exp(omega t) in the exact solution of M z'' = F0 + k0 z from rest [m]."""
    return 0.5 * float(printed.reaction.static / printed.stiffness + printed.tow_speed / printed.natural_frequency)


FIGURES: dict[str, Callable[[], Figure]] = {
    "figure_1": figure_1,
    "figure_2": figure_2,
    "figure_3": figure_3,
    "figure_4": lambda: figure_travel(4, 50.0),
    "figure_5": lambda: figure_travel(5, 200.0),
    "figure_6": lambda: figure_force(6, 50.0),
    "figure_7": lambda: figure_force(7, 500.0),
    "printed": figure_printed,
}


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    return figure, axes


def _colors(count: int) -> list[tuple[float, ...]]:
    """Return colours whose order is visible, without those that are too pale for paper."""
    return [colormaps["viridis"](x) for x in np.linspace(0.0, 0.85, count)]


def _runs(stiffness: float) -> list[po.Run]:
    return [run(ratio, stiffness) for ratio in DENSITY_RATIOS]


def _named(found: po.Run) -> str:
    return f"b₁ = {found.scene.soil.density_ratio:g} (F₀ = {found.scene.reaction.static:.2g} N)"


# --- claims ---


@dataclass(frozen=True)
class Claim:
    """A statement of the source's Discussion, the result of its own equations, the figure, and whether they agree."""

    says: str
    gives: str
    figure: str
    follows: str


def claims() -> list[Claim]:
    """Return the statements of the Discussion with the results of equation (27) in the runs of the figures."""
    soft, middle, stiff = ([swing(found) for found in _runs(k)] for k in (50.0, 200.0, 500.0))
    one = DENSITY_RATIOS.index(0.6)
    added = [1e3 * scene(ratio, 50.0).reaction.added_mass for ratio in (0.2, 0.95)]
    chisels = [math.degrees(float(half_angle(30.0, chisel))) for chisel in (5.0, 20.0)]
    return [
        Claim(
            "The cone's angle changes little with the chisel angle",
            f"at λ = 30°: β = {chisels[0]:.1f}° to {chisels[1]:.1f}°, {100 * (chisels[1] / chisels[0] - 1):.0f} % more",
            "3", "roughly",
        ),
        Claim(
            "Stiffer: oscillations of higher frequency",
            f"period {soft[one].period:.3f} s at 50, {middle[one].period:.3f} s at 200 N/m: frequency"
            f" × {soft[one].period / middle[one].period:.3f}, √4 = 2",
            "4, 5", "yes",
        ),
        Claim(
            "... with increasing amplitude",
            f"of the displacement {soft[one].displacement:.3f} m at 50, {middle[one].displacement:.3f} m at 200 N/m;"
            f" of the force {soft[one].force:.1f} N and {middle[one].force:.1f} N",
            "4, 5", "of the force only: that of L falls as 1/√k0",
        ),
        Claim(
            "The period increases with b1",
            f"at 50 N/m {_list(soft, 'period', 4)} s, {_percent(soft, 'period')}: by drag and by the added mass,"
            f" {added[0]:.0f} g for b1 = 0.2, {added[1]:.0f} g for 0.95, of {CHOICE.mass:g} kg",
            "4, 6", "yes, too little to see",
        ),
        Claim(
            "Small k0: the amplitude first decreases (b1 = 0.2), then increases",
            f"at 50 N/m {_list(soft, 'displacement')} m. Drag makes it fall, F0 makes it rise; without drag it only"
            " rises",
            "4", "yes, but it turns near 0.87",
        ),
        Claim(
            "Large k0: amplitudes almost the same for all b1",
            f"from b1 = 0.2 to 0.95 {_percent(middle, 'displacement')} at 200 N/m, {_percent(stiff, 'displacement')} at"
            f" 500 N/m; after {DURATION:g} s of drag {_percent(middle, 'last')} and {_percent(stiff, 'last')}",
            "5, 7", "at first, until drag tells them apart",
        ),
        Claim(
            "... an increase is observed for b1 = 1",
            "b1 = 1 makes a = 1/(1 - b1) infinite, without a motion; beside it, at 200 N/m,"
            f" {middle[-1].displacement:.3f} m for 0.95 and {swing(run(0.995, 200.0)).displacement:.3f} m for 0.995",
            "5", "on the way to 1",
        ),
        Claim(
            "The spring is compressed for the greater part, more with b1",
            f"{_list(soft, 'compressed')} of the first period at 50 N/m, {_list(stiff, 'compressed')} at 500 N/m",
            "6, 7", "yes",
        ),
        Claim(
            "The compression increases with b1",
            f"first crest {_list(soft, 'peak_force', 0)} N at 50 N/m",
            "6", "yes",
        ),
        Claim(
            "Stiffness has practically no effect on the amplitude",
            f"of the force {soft[one].force:.1f} N at 50, {stiff[one].force:.1f} N at 500 N/m,"
            f" × {stiff[one].force / soft[one].force:.2f}; of the displacement"
            f" × {stiff[one].displacement / soft[one].displacement:.2f}",
            "6, 7", "no: the force's grows as √k0, √10 = 3.16",
        ),
    ]  # fmt: skip


def _list(swings: Sequence[Swing], name: str, digits: int = 3) -> str:
    return ", ".join(f"{getattr(s, name):.{digits}f}" for s in swings)


def _percent(swings: Sequence[Swing], name: str) -> str:
    first, last = getattr(swings[0], name), getattr(swings[-1], name)
    return f"{100.0 * (last / first - 1.0):+.1f} %"


def retreat() -> str:
    """Return a sentence on how fast and where a resistance of fixed sign drives the share backwards."""
    speeds = ", ".join(f"{swing(found).retreat:.3f}" for found in _runs(50.0))
    return (
        f"From rest the resistance, whose sign is fixed, drives the share back: at up to {speeds} m/s for k0 = 50 N/m,"
        f" less on a stiffer spring; the tow speed is {CHOICE.tow_speed:g} m/s."
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the figures into a folder, and print the statements with the results of the equations."""
    parser = argparse.ArgumentParser(description="Figures 1 to 7 of the source, and what its Discussion says of them.")
    parser.add_argument("--folder", type=Path, default=Path("out"), help="where the pictures go (default: out)")
    folder = parser.parse_args(arguments).folder
    console = Console()
    title = "What the Discussion says, and what equation (27) gives (b1 = 0.2, 0.4, 0.6, 0.8, 0.95)"
    table = Table("the source says", "equation (27) gives", "figure", "does it follow?", title=title)
    for claim in claims():
        table.add_row(claim.says, claim.gives, claim.figure, claim.follows, end_section=True)
    console.print(table)
    console.print(retreat(), highlight=False)
    for name, draw in FIGURES.items():
        console.print(f"wrote {plots.save(draw(), folder / f'{name}.png')}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    main()
