"""Compare the toolkit's models with measurements of others, and print the tables of docs/explanation/validation.md.

python problems/measured/compare.py [--plot FILE]
"""

import argparse
import csv
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import plough_opt as po
from plough_opt.laws import McKyesAli, SwickPerumpral, UniversalEarthmoving

HERE = Path(__file__).parent
TINES = {
    "McKyes and Ali": McKyesAli,
    "universal earthmoving": UniversalEarthmoving,
    "Swick and Perumpral": SwickPerumpral,
}
# Slower than 0.5 m/s, where inertia adds less than 1 % in every law.
BLADE_SPEED = 0.3
FITTED_WIDTH = 0.20


def rows_of(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of this folder: heading -> cell."""
    lines = (HERE / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def column(name: str, heading: str) -> np.ndarray:
    """Return a column of numbers; an empty cell is NaN."""
    return np.array([float(row[heading] or "nan") for row in rows_of(name)])


def published_sand(cohesion: float) -> po.Soil:
    """Return the sand of Obermayr's bin with a cohesion [Pa]; the tines' laws use no other property."""
    sand = {"density": 1440.0, "friction_angle": po.deg(35.0), "tool_friction": 0.29, "cohesion": cohesion}
    return dataclasses.replace(po.named_soil("loose sandy loam"), **sand)


def blade_scene(law: type, cohesion: float, width: float, depth: float) -> po.Scene:
    """Return the scene of a blade that slides steadily; the share only serves as a place for the law."""
    tine = law(depth=depth, width=width, rake_angle=po.deg(90.0))
    still = po.Effects(motion=False)
    return po.Scene(published_sand(cohesion), po.Cone(po.deg(15.0), 0.1), 1e5, 10.0, BLADE_SPEED, still, medium=tine)


def blade_drafts(law: type, cohesion: float) -> np.ndarray:
    """Return the law's drafts [N] at the rows of blade_in_sand.csv."""
    sizes = zip(column("blade_in_sand", "width [m]"), column("blade_in_sand", "depth [m]"), strict=True)
    return np.array([blade_scene(law, cohesion, w, d).steady_resistance for w, d in sizes])


def fitted_cohesion(law: type) -> po.Fit:
    """Return the calibration of the cohesion to the blade of 20 cm."""
    fitted = column("blade_in_sand", "width [m]") == FITTED_WIDTH
    data = po.Measurements(
        "mean_draft",
        column("blade_in_sand", "mean_draft [N]")[fitted],
        sigma=column("blade_in_sand", "sigma [N]")[fitted],
        conditions={"share.height": column("blade_in_sand", "depth [m]")[fitted]},
    )

    def scene(values: Mapping[str, float]) -> po.Scene:
        return blade_scene(law, values["soil.cohesion"], FITTED_WIDTH, values["share.height"])

    return po.calibrate(scene, data, {"soil.cohesion": (0.0, 5e3)})


def exponent(depth: np.ndarray, draft: np.ndarray) -> float:
    """Return the power of the depth with which the draft grows, by least squares of logarithms."""
    return float(np.polyfit(np.log(depth), np.log(draft), 1)[0])


def blade_table() -> list[list[str]]:
    """Return a row for each law: predictions with the published soil, and of one width after a fit to the other."""
    measured, depth = column("blade_in_sand", "mean_draft [N]"), column("blade_in_sand", "depth [m]")
    narrow = column("blade_in_sand", "width [m]") == FITTED_WIDTH
    table = [["measured", "", "", "", "", f"{exponent(depth[narrow], measured[narrow]):.2f}"]]
    for name, law in TINES.items():
        published, clean = (blade_drafts(law, c) / measured for c in (1e3, 0.0))
        fit = fitted_cohesion(law)
        cohesion = fit.values["soil.cohesion"]
        predicted = blade_drafts(law, cohesion)
        errors = predicted[~narrow] / measured[~narrow] - 1.0
        table.append(
            [
                name,
                *(f"{np.mean(r):.2f} ({r.min():.2f} to {r.max():.2f})" for r in (published, clean)),
                f"{cohesion:.0f} Pa",
                f"{100 * math.sqrt(np.mean(errors**2)):.0f} %, mean {100 * np.mean(errors):+.0f} %",
                f"{exponent(depth[narrow], predicted[narrow]):.2f}",
            ]
        )
    return table


def friction_share() -> str:
    """Return the part of a cone's resistance that is friction on its face, tool friction 0.2 to 0.5."""
    parts = [[mu / (math.tan(po.deg(angle)) + mu) for mu in (0.2, 0.5)] for angle in (5.0, 30.0)]
    return "; ".join(f"{a:.2f} to {b:.2f} at {n}°" for (a, b), n in zip(parts, (5, 30), strict=True))


def nose_forces() -> str:
    """Return the resistance of noses of one base, relative to the first, tool friction 0.3."""
    forces = [1.0 + 0.3 / math.tan(po.deg(apex / 2.0)) for apex in (37.0, 53.0, 90.0)]
    return (
        "falls with the apex angle: " + " : ".join(f"{force / forces[0]:.2f}" for force in forces) + " at 37, 53, 90°"
    )


def pressure_exponent() -> str:
    """Return the power of the pressure with which the cone index of a soil without cohesion grows."""
    sand = dataclasses.replace(po.named_soil("firm sandy loam"), cohesion=0.0)
    low, high = (po.cone_index(dataclasses.replace(sand, ambient_pressure=p)) for p in (50e3, 400e3))
    return f"power {math.log(high / low) / math.log(8.0):.2f} at a given b1"


def speed_share() -> str:
    """Return what the speed adds to the draft of README's share."""
    share = po.Wedge(angle=po.deg(39.1), chisel_angle=po.deg(15.0), height=0.254)
    slow, fast = (
        po.Scene(po.named_soil("serozem"), share, 5e4, 25.0, speed, po.Effects(motion=False)).steady_resistance
        for speed in (0.25, 2.0)
    )
    return f"square of the speed alone: {100 * (fast / slow - 1.0):+.1f} % from 0.25 to 2 m/s"


def vibration() -> str:
    """Return how much a mount at its resonance changes the mean draft over soil of varying strength."""
    waves = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.2), damping=400.0, orbit="periodic")
    share = po.Cone(po.deg(15.0), 0.25)
    # Mass 25 kg at 2 m/s over 0.2 m: 10 Hz, which 98.7 kN/m meets; the other mount is a hundred times stiffer.
    sprung, rigid = (
        po.simulate(po.Scene(po.named_soil("serozem"), share, k, 25.0, 2.0, waves)).mean_draft for k in (98.7e3, 98.7e5)
    )
    return f"{100 * (sprung / rigid - 1.0):+.0f} % at resonance: dissipation adds to the soil's work"


# Trend -> the model's number, and whether the trend holds in the model.
MODEL: Mapping[str, tuple[Callable[[], str], str]] = {
    "friction on a cone": (friction_share, "holds"),
    "blunt noses": (nose_forces, "does not hold: it has no minimum"),
    "body of soil ahead": (lambda: "none at any angle", "not in the model"),
    "grain size": (lambda: "a continuum", "not in the model"),
    "pressure at one relative density": (pressure_exponent, "does not hold: b1 falls with pressure"),
    "pressure at one state parameter": (pressure_exponent, "holds"),
    "speed of blades": (speed_share, "does not hold: no linear term"),
    "speed of chisel tines": (speed_share, "does not hold: no linear term"),
    "high speed": (speed_share, "does not hold"),
    "vibrated subsoiler": (vibration, "does not hold"),
    "vibrated four-shank subsoiler": (vibration, "does not hold"),
    "vibrated subsoiler in stubbles": (vibration, "does not hold"),
    "chain subsoiler": (lambda: "not a sprung share", "not in the model"),
    "vibrated probe in grains": (vibration, "does not hold"),
    "bent probe in grains": (lambda: "motion along the path only", "not in the model"),
    "waves of dense grains": (lambda: "waves are given, not computed", "not in the model"),
    "winged point": (lambda: "no wings", "not in the model"),
}


def trend_table() -> list[list[str]]:
    """Return a row for each statement: what was measured, what the model gives, and whether it holds."""
    numbers = {function: function() for function, _ in MODEL.values()}
    table = []
    for row in rows_of("trends"):
        function, verdict = MODEL[row["trend"]]
        table.append([row["trend"], row["measured"], numbers[function], verdict, row["source"]])
    return table


def other_table() -> list[list[str]]:
    """Return the numbers of the smaller tables."""
    area, draft = (
        column("draft_and_loosened_area", "loosened_area [m2]"),
        column("draft_and_loosened_area", "draft [kN]"),
    )
    specific = draft / (area - column("draft_and_loosened_area", "rut_area [m2]"))
    depth = np.repeat(column("plate_in_simulant", "depth [m]"), 3)
    drafts = np.array([column("plate_in_simulant", f"draft_{k} [N]") for k in (1, 2, 3)]).T.ravel()
    deviations, means = column("draft_along_passes", "deviation [kN]"), column("draft_along_passes", "mean [kN]")
    # The abstract gives the mean of the pass that varies most, and the range of the other means in untilled soil.
    least, most = np.nanmin(deviations) / np.nanmax(means), np.nanmax(deviations) / means[np.nanargmax(deviations)]
    row = rows_of("d497_second_source")[0]
    same = tuple(float(row[k]) for k in "ABC") == po.crosscheck.POINTS["narrow"]
    return [
        [
            "draft over loosened area: untracked, after a track, after a wheel",
            " : ".join(f"{s:.1f}" for s in specific) + " kN/m²",
            "constant in one soil; proportional to its cone index",
        ],
        [
            "power of the depth, plate in simulant",
            f"{exponent(depth, drafts):.1f}",
            "2 to 3 in the tines' laws without cohesion",
        ],
        [
            "standard deviation of the draft along a pass",
            f"{100 * least:.0f} to {100 * most:.0f} % of the mean",
            "an input: `random_strength`, `strength_wave`",
        ],
        ["A, B, C of D497's narrow point", ", ".join(row[k] for k in "ABC"), "equal" if same else "different"],
    ]


def markdown(headings: Sequence[str], table: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [headings, ["---"] * len(headings), *table]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def plot_blade(path: Path) -> None:
    """Draw measured and predicted drafts of the blade over its depth, a panel for each width."""
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 4.0), sharey=True, layout="constrained")
    widths, depths = column("blade_in_sand", "width [m]"), column("blade_in_sand", "depth [m]")
    measured, sigma = column("blade_in_sand", "mean_draft [N]"), column("blade_in_sand", "sigma [N]")
    for axes, width in zip(panels, np.unique(widths), strict=True):
        at = widths == width
        axes.errorbar(
            100 * depths[at], measured[at] / 1e3, 2 * sigma[at] / 1e3, fmt="ko", label="measured, ±2σ of reading"
        )
        for (name, law), mark in zip(TINES.items(), ("C0", "C1", "C2"), strict=True):
            for cohesion, line in ((1e3, "-"), (0.0, "--")):
                label = f"{name}, {cohesion / 1e3:g} kPa"
                axes.plot(100 * depths[at], blade_drafts(law, cohesion)[at] / 1e3, line, color=mark, label=label)
        axes.set(xlabel="depth [cm]", title=f"blade of {100 * width:.0f} cm")
    panels[0].set(ylabel="draft [kN]", ylim=(0.0, None))
    panels[0].legend(fontsize="small")
    figure.savefig(path, dpi=110)


TABLES = {
    "a blade in sand": (
        ("law", "published cohesion, 1 kPa", "no cohesion", "fitted at 20 cm", "error at 30 cm", "power of depth"),
        blade_table,
    ),
    "single numbers": (("quantity", "measured", "model"), other_table),
    "trends": (("trend", "measured", "model", "verdict", "source"), trend_table),
}


def main() -> None:
    """Print all tables and, on demand, draw the blade."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="picture of the blade in sand")
    chosen = parser.parse_args()
    for headings, table in TABLES.values():
        print(markdown(headings, table()), end="\n\n")
    if chosen.plot:
        plot_blade(chosen.plot)


if __name__ == "__main__":
    main()
