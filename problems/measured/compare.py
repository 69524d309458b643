"""The toolkit's models beside measurements of others. `python problems/validation.py` prints the tables."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
from particles.run_plan import Array, read_rows

import plough_opt as po
from plough_opt.laws import McKyesAli, SwickPerumpral, UniversalEarthmoving
from plough_opt.laws.tines import POINTS

HERE = Path(__file__).parent
TINES = (McKyesAli, UniversalEarthmoving, SwickPerumpral)
FITTED_WIDTH = 0.20
WEDGES = (15.0, 30.0, 45.0, 60.0)
"""Half angles [deg]."""
Rows = list[list[str]]


def rows_of(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of this folder: heading without unit -> cell."""
    return read_rows(HERE / f"{name}.csv")


def column(name: str, heading: str) -> Array:
    """Return a column of numbers; an empty cell is NaN."""
    return np.array([float(row[heading] or "nan") for row in rows_of(name)])


def blade() -> tuple[Array, ...]:
    """Return width and depth [m], draft and its standard deviation [N] of Obermayr's blade."""
    return tuple(column("blade_in_sand", name) for name in ("width", "depth", "mean_draft", "sigma"))


def blade_scene(law: type[po.ResistanceLaw], cohesion: float, width: float, depth: float) -> po.Scene:
    """Return the scene of a blade that slides steadily through the published sand with a cohesion [Pa].

    The tines' laws use no other property of the soil, and the share only serves as a place for the law.
    """
    sand = {"density": 1440.0, "friction_angle": po.deg(35.0), "tool_friction": 0.29, "cohesion": cohesion}
    soil = dataclasses.replace(po.named_soil("loose sandy loam"), **sand)
    tine = law(depth=depth, width=width, rake_angle=po.deg(90.0))
    # Slower than 0.5 m/s, where inertia adds less than 1 % in every law.
    return po.Scene(soil, po.Cone(po.deg(15.0), 0.1), 1e5, 10.0, 0.3, po.Effects(motion=False), medium=tine)


def blade_drafts(law: type[po.ResistanceLaw], cohesion: float) -> Array:
    """Return the law's drafts [N] at the rows of blade_in_sand.csv."""
    widths, depths, _, _ = blade()
    return np.array([blade_scene(law, cohesion, *size).steady_resistance for size in zip(widths, depths, strict=True)])


def fitted_cohesion(law: type[po.ResistanceLaw]) -> float:
    """Return the cohesion [Pa] that is calibrated to the blade of 20 cm."""
    width, *rest = blade()
    depth, draft, sigma = (one[width == FITTED_WIDTH] for one in rest)
    data = po.Measurements("mean_draft", draft, sigma=sigma, conditions={"share.height": depth})

    unknown = {"soil.cohesion": (0.0, 5e3)}
    fit = po.calibrate(lambda x: blade_scene(law, x["soil.cohesion"], FITTED_WIDTH, x["share.height"]), data, unknown)
    return fit.values["soil.cohesion"]


def exponent(depth: Array, draft: Array) -> float:
    """Return the power of the depth with which the draft grows, by least squares of logarithms."""
    return float(np.polyfit(np.log(depth), np.log(draft), 1)[0])


def blade_table() -> Rows:
    """Return a row for each law: predictions with the published soil, and of one width after a fit to the other."""
    width, depth, measured, _ = blade()
    narrow = width == FITTED_WIDTH
    headings = ["law", "cohesion of 1 kPa", "no cohesion", "fitted at 20 cm", "error at 30 cm", "power of depth"]
    table = [headings, ["measured", "", "", "", "", f"{exponent(depth[narrow], measured[narrow]):.2f}"]]
    for law in TINES:
        ratios = [blade_drafts(law, c) / measured for c in (1e3, 0.0)]
        texts = [f"{np.mean(r):.2f} ({r.min():.2f} to {r.max():.2f})" for r in ratios]
        cohesion = fitted_cohesion(law)
        predicted = blade_drafts(law, cohesion)
        errors = predicted[~narrow] / measured[~narrow] - 1.0
        missed = f"{100 * math.sqrt(np.mean(errors**2)):.0f} %, mean {100 * np.mean(errors):+.0f} %"
        power = f"{exponent(depth[narrow], predicted[narrow]):.2f}"
        table.append([law.label, *texts, f"{cohesion:.0f} Pa", missed, power])
    return table


def friction_share() -> str:
    """Return the part of a cone's resistance that is friction on its face, tool friction 0.2 to 0.5."""
    parts = [[mu / (math.tan(po.deg(angle)) + mu) for mu in (0.2, 0.5)] for angle in (5.0, 30.0)]
    return "; ".join(f"{a:.2f} to {b:.2f} at {n}°" for (a, b), n in zip(parts, (5, 30), strict=True))


def over_first(values: list[float]) -> str:
    """Return values over the first of them."""
    return " : ".join(f"{one / values[0]:.2f}" for one in values)


def nose_forces() -> str:
    """Return the resistance of noses of one base with apex angles of 37, 53, 90 degrees, tool friction 0.3."""
    return over_first([1.0 + 0.3 / math.tan(po.deg(apex / 2.0)) for apex in (37.0, 53.0, 90.0)])


def wedge_forces() -> str:
    """Return the resistance of wedges of one base at the half angles of WEDGES, tool friction 0.3."""
    return over_first([1.0 + 0.3 / math.tan(po.deg(angle)) for angle in WEDGES])


def plate_forces() -> str:
    """Return the draft of a wedge of one base at the half angles of WEDGES, as the sum of its faces' as plates."""
    stress = dict(zip(column("plates_in_grains", "tilt"), column("plates_in_grains", "along"), strict=True))
    return over_first([(stress[angle] + stress[-angle]) / math.sin(po.deg(angle)) for angle in WEDGES])


def pressure_exponent() -> str:
    """Return the power of the pressure with which the cone index of a soil without cohesion grows."""
    sand = dataclasses.replace(po.named_soil("firm sandy loam"), cohesion=0.0)
    low, high = (po.cone_index(dataclasses.replace(sand, ambient_pressure=p)) for p in (50e3, 400e3))
    return f"{math.log(high / low) / math.log(8.0):.2f}"


def speed_share() -> str:
    """Return what the speed adds to the draft of README's share from 0.25 to 2 m/s."""
    share = po.Wedge(angle=po.deg(39.1), chisel_angle=po.deg(15.0), height=0.254)
    scenes = (po.Scene(po.named_soil("serozem"), share, 5e4, 25.0, v, po.Effects(motion=False)) for v in (0.25, 2.0))
    slow, fast = (one.steady_resistance for one in scenes)
    return f"{100 * (fast / slow - 1.0):+.1f} %"


def vibration() -> str:
    """Return how much a mount at its resonance changes the mean draft over soil of varying strength."""
    waves = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.2), damping=400.0, orbit="periodic")
    share = po.Cone(po.deg(15.0), 0.25)
    # Mass 25 kg at 2 m/s over 0.2 m: 10 Hz, which 98.7 kN/m meets; the other mount is a hundred times stiffer.
    scenes = (po.Scene(po.named_soil("serozem"), share, k, 25.0, 2.0, waves) for k in (98.7e3, 98.7e5))
    sprung, rigid = (po.simulate(one).mean_draft for one in scenes)
    return f"{100 * (sprung / rigid - 1.0):+.0f} %"


def passes() -> str:
    """Return the standard deviation of the draft along a pass in untilled soil, over its mean [%].

    The abstract gives the mean of the pass that varies most, and the range of the other means.
    """
    deviations, means = column("draft_along_passes", "deviation"), column("draft_along_passes", "mean")
    least, most = np.nanmin(deviations) / np.nanmax(means), np.nanmax(deviations) / means[np.nanargmax(deviations)]
    return f"{100 * least:.0f} to {100 * most:.0f} %"


def plate_exponent() -> str:
    """Return the power of the depth with which the draft of the plate in simulant grows."""
    drafts = np.concatenate([column("plate_in_simulant", f"draft_{k}") for k in (1, 2, 3)])
    return f"{exponent(np.tile(column('plate_in_simulant', 'depth'), 3), drafts):.1f}"


def specific_drafts() -> str:
    """Return draft over loosened area [kN/m2], less the area of the rut."""
    areas, ruts, draft = (column("draft_and_loosened_area", x) for x in ("loosened_area", "rut_area", "draft"))
    return " : ".join(f"{one:.1f}" for one in draft / (areas - ruts))


def second_source() -> str:
    """Return the coefficients A, B, C of D497's narrow point as another source gives them."""
    return ", ".join(f"{column('d497_second_source', name)[0]:g}" for name in "ABC")


def narrow_point() -> str:
    """Return the same coefficients as they are in the package."""
    return ", ".join(f"{one:g}" for one in POINTS["narrow"])


def filled(name: str) -> Rows:
    """Return a table of this folder in whose cells functions of this module stand in braces."""
    rows = rows_of(name)
    names = re.findall(r"{(\w+)}", (HERE / f"{name}.csv").read_text(encoding="utf-8"))
    values = {one: globals()[one]() for one in set(names)}
    return [[*rows[0]], *([cell.format(**values) for cell in row.values()] for row in rows)]


TABLES = (blade_table, *(lambda name=name: filled(name) for name in ("single_numbers", "trends", "to_obtain")))
