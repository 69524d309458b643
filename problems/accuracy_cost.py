"""Error and time of every suitable method on five scenes, in one picture.

    python problems/accuracy_cost.py --folder out

Each scene is hard in its own way: a smooth transient, a mount so stiff that it rings thousands of times, a mount in
resonance with the soil's waves, a share that sticks and slips, and one that enters the soil. Errors are those of mean
draft and RMS force against a run that is tighter than all settings compared. A JSON file of each scene holds every
figure.
"""

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console

import plough_opt as po
from plough_opt import plots

WANTED = 1e-6
SHARE = po.Wedge(po.deg(30.0), po.deg(15.0), 0.25)
SEROZEM = po.named_soil("serozem")
MOIST = dataclasses.replace(po.named_soil("firm sandy loam"), ambient_pressure=5e3)
WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.2)


def resonant_stiffness(mass: float, speed: float, wavelength: float) -> float:
    """Return the stiffness [N/m] of a mount whose natural frequency equals that of the soil's waves."""
    return (mass + float(po.added_mass(SHARE.equivalent_cone(), SEROZEM))) * (2.0 * math.pi * speed / wavelength) ** 2


def scenes() -> dict[str, tuple[po.Scene, float]]:
    """Return name -> (scene, duration [s])."""

    def scene(soil: po.Soil, stiffness: float, speed: float, **effects: Any) -> po.Scene:
        return po.Scene(soil, SHARE, stiffness, 25.0, speed, po.Effects(**effects))

    tuned = resonant_stiffness(25.0, 2.0, 0.6)
    longer = po.StrengthWave(amplitude=0.3, wavelength=0.6)
    sticks = po.StickSlip(breakaway=1.2)
    return {
        "smooth: damped, strength wave": (scene(SEROZEM, 5e4, 2.0, strength_wave=WAVE, damping=400.0), 2.0),
        "stiff: the mount rings 1400 times": (scene(SEROZEM, 5e8, 2.0, strength_wave=WAVE, damping=400.0), 2.0),
        "resonant: in step with the wave": (scene(SEROZEM, tuned, 2.0, strength_wave=longer), 2.0),
        "stick and slip": (scene(MOIST, 2e4, 0.1, start="rest", damping=30.0, contact=sticks), 3.0),
        "entry from first contact": (
            scene(SEROZEM, 5e4, 2.0, start="towed", entry=True, strength_wave=WAVE, damping=200.0), 0.5
        ),
    }  # fmt: skip


def studies(console: Console, allowance: float) -> dict[str, po.AccuracyStudy]:
    """Measure the scenes, and print table, failures and advice of each."""
    found = {}
    for name, (scene, duration) in scenes().items():
        study = po.study_accuracy(scene, duration, wanted=WANTED, title=name, allowance=allowance)
        found[name] = study
        console.rule(name)
        console.print(str(study.page()), markup=False, soft_wrap=True)
    return found


def figure_of(found: dict[str, po.AccuracyStudy]) -> Figure:
    """Return a figure with a panel for each scene, and one that explains them."""
    figure = Figure(figsize=(12.0, 7.8), layout="constrained")
    places = list(figure.subplots(2, 3).ravel())
    for axes, (name, study) in zip(places, found.items(), strict=False):
        study.draw(axes)
        axes.set_title(name[0].upper() + name[1:])
        # The same scales everywhere, so that scenes can be compared.
        axes.set(xlim=(1e-4, 2.0), ylim=(3e-16, 3.0))
    for axes in places[len(found) :]:
        axes.set_axis_off()
    shown = {
        label: handle
        for axes in places[: len(found)]
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    places[-1].legend([*shown.values()], [*shown], fontsize="small", loc="center", frameon=False)
    figure.suptitle("What accuracy costs: error of mean draft and RMS force against the time of one run", fontsize=14)
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description="Error against time of every method on five scenes.")
    parser.add_argument("--folder", type=Path, default=Path("out"), help="where picture and JSON go (default: out)")
    parser.add_argument("--seconds", type=float, default=0.5, help="time that one run may take (default: 0.5)")
    options = parser.parse_args(arguments)
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=130)
    found = studies(console, options.seconds)
    path = plots.save(figure_of(found), options.folder / "accuracy_cost.png")
    files = [study.save(path.with_name(f"accuracy_cost_{name.split()[0].strip(':')}.json"))
             for name, study in found.items()]  # fmt: skip
    for written in (path, *files):
        console.print(f"wrote {written}", soft_wrap=True)


if __name__ == "__main__":
    main()
