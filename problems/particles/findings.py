"""Ratios of drafts among particles beside the model's, whose soil comes from triaxial tests of the same packings.

`python problems/validation.py` prints the tables and draws the picture.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from particles.run_plan import BAND_LENGTH, END_GAP, HERE, PACKINGS, PLAN, UNIT, Array, Case, key_of, read_rows, series

import plough_opt as po

REFERENCE = Case()
SPRUNG = replace(REFERENCE, half_angle=20.0, height=0.07, length=0.56, bands=1)
TRIAXIAL = replace(REFERENCE, kind="triaxial")
SIZES = (0.028, 0.02, 0.015, 0.013, 0.01)
STIFFNESSES = (20e3, 50e3, 100e3, 200e3, 500e3, 2e6)
ZONES = (2, 5, 10)
"""Displacements in per cent of the base radius."""
Rows = list[list[str]]


@functools.cache
def table() -> dict[tuple[str, ...], dict[str, str]]:
    """Return the rows of both files by their parameters."""
    return {key_of(row): row for name in ("particles", "triaxial") for row in read_rows(HERE / f"{name}.csv")}


def numbers(case: Case, column: str = "draft") -> Array:
    """Return a column of a case's rows, packing by packing; empty if the case was not run in all of them."""
    rows = [table().get(replace(case, seed=seed).key) for seed in PACKINGS]
    return np.array([float(row[column]) for row in rows] if all(rows) else [])


def text(values: Array, digits: int = 2) -> str:
    """Return mean and standard error."""
    return f"{np.mean(values):.{digits}f} ± {error_of(values):.{digits}f}"


def error_of(values: Array) -> float:
    """Return the standard error of a mean."""
    return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def named(case: Case) -> str:
    """Return in words what distinguishes a case from the reference."""
    changed = {one.name: getattr(case, one.name) for one in fields(Case)[2:] if getattr(case, one.name) != one.default}
    words = [value if name == "kind" else f"{name} {value:g} {UNIT.get(name, '')}" for name, value in changed.items()]
    return ", ".join(word.replace("_", " ").strip() for word in words)


# --- the model, predicted ---


@functools.cache
def tested_soil(cohesion: float, pressure: float) -> po.Soil:
    """Return the soil that triaxial tests of the packings give at a pressure [Pa].

    Cohesion and angle of friction follow from the line through the largest stresses, b1 from the compaction before
    dilation at this pressure. The argument is the cohesion of contacts; the tool's friction is not yet set.
    """
    tests = [replace(TRIAXIAL, cohesion=cohesion, pressure=at) for at in (25e3, 50e3, 100e3, 200e3)]
    stresses = [(one.pressure, stress) for one in tests for stress in numbers(one, "axial_stress")]
    here = replace(TRIAXIAL, cohesion=cohesion, pressure=pressure)
    slope, start = np.polyfit(*zip(*stresses, strict=True), 1)
    angle, ratio = math.asin((slope - 1.0) / (slope + 1.0)), math.exp(-np.mean(numbers(here, "compaction")))
    density = PLAN["common"]["density"] * (1.0 - np.mean(numbers(here, "porosity")))
    return po.Soil(density, ratio, max(start, 0.0) / (2.0 * math.sqrt(slope)), angle, 0.0, pressure)


def predicted(case: Case) -> float:
    """Return the model's draft [N] of a case, for a share that of its equivalent cone."""
    soil = replace(tested_soil(case.cohesion, case.pressure), tool_friction=case.tool_friction)
    cone = po.Cone(math.radians(case.half_angle), case.height)
    return float(po.Scene(soil, cone, 1e6, 1.0, case.speed, po.Effects(motion=False)).steady_resistance)


@functools.cache
def sprung_model(stiffness: float) -> tuple[float, float]:
    """Return draft and RMS of force of the model's periodic motion, over those of the rigid pull, which it takes on."""
    mean, rms = (float(np.mean(numbers(SPRUNG, name))) for name in ("draft", "scatter"))
    soil = tested_soil(REFERENCE.cohesion, REFERENCE.pressure)
    wave = po.StrengthWave(math.sqrt(2.0) * rms / mean, BAND_LENGTH)
    effects = po.Effects(damping=PLAN["mount"]["damping"], strength_wave=wave, orbit="periodic", inertial_drag=False)
    cone = po.Cone(math.radians(SPRUNG.half_angle), SPRUNG.height)
    scene = po.Scene(soil, cone, stiffness, PLAN["mount"]["mass"], SPRUNG.speed, effects)
    run = po.simulate(replace(scene, soil=replace(soil, strength_factor=mean / float(scene.steady_resistance))))
    return float(run.mean_draft) / mean, float(run.force_rms) / rms


def displaced(density_ratio: float, part: float) -> float:
    """Return where the model displaces soil by a part of the base radius, over that radius.

    Behind the front soil of b1 times its volume surrounds the cone: a ring of radius y goes to sqrt(R^2 + b1 y^2).
    """
    lost = 1.0 - density_ratio
    return (math.sqrt(part**2 + lost * (1.0 - part**2)) - part) / lost


# --- ratios ---


class Ratio(NamedTuple):
    """A case's draft over that of another: packing by packing, in the model, and of the areas of the bases."""

    case: Case
    other: Case
    values: Array
    model: float
    area: float


@functools.cache
def questions() -> dict[str, list[Ratio]]:
    """Return the ratios of the cases that were run in all packings, by question."""
    found: dict[str, list[Ratio]] = {}
    for over, cases in series():
        for (question, names), case in itertools.product(over.items(), cases):
            other = replace(case, **{name: getattr(REFERENCE, name) for name in names.split()})
            drafts, others = numbers(case), numbers(other)
            if case != other and len(drafts) and len(others):
                area = (case.base_radius / other.base_radius) ** 2
                ratio = Ratio(case, other, drafts / others, predicted(case) / predicted(other), area)
                found.setdefault(question, []).append(ratio)
    order = sorted(found, key=lambda question: question.startswith("error"))
    return {question: sorted(found[question], key=lambda one: astuple(one.case)[2:]) for question in order}


def ratio_table() -> Rows:
    """Return a row for each case: among particles, in the model, how far that is off, and the ratio of the bases."""
    rows = [["question", "case", "ratio of draft among particles", "model", "model's error", "base area"]]
    for question, ratios in questions().items():
        for one in ratios:
            model = [f"{one.model:.2f}", f"{100 * (one.model / np.mean(one.values) - 1.0):+.0f} %", f"{one.area:.2f}"]
            known = [""] * 3 if question.startswith("error") else model
            rows.append([question, named(one.case), text(one.values), *known])
    return rows


def pooled_error() -> float:
    """Return the relative standard error of a ratio, from the scatter of the packings over all ratios."""
    every = [error_of(one.values) / np.mean(one.values) for ratios in questions().values() for one in ratios]
    return float(np.sqrt(np.mean(np.square(every))))


# --- what is no ratio ---


def pressures(case: Case, wider: float = 0.0) -> Array:
    """Return the draft over the area of a base that is wider by a length [m] on each side [kPa], packing by packing."""
    return numbers(case) / (math.pi * (case.base_radius + wider) ** 2) / 1e3


def model_pressure(case: Case) -> float:
    """Return the model's draft over the area of the base [kPa]."""
    return predicted(case) / (math.pi * case.base_radius**2) / 1e3


def angles(*values: float, **changes: object) -> list[Case]:
    """Return the reference with these half angles [deg] and changes."""
    return [replace(REFERENCE, half_angle=value, **changes) for value in values]


def reference_table() -> Rows:
    """Return what the reference cone gives in absolute numbers: quantity, among particles, in the model."""
    soil = tested_soil(REFERENCE.cohesion, REFERENCE.pressure)
    model = f"{model_pressure(REFERENCE):.0f} kPa"
    return [
        ["quantity", "particles", "model"], ["porosity", f"{np.mean(numbers(REFERENCE, 'porosity')):.3f}", ""],
        ["angle of friction", "", f"{math.degrees(soil.friction_angle):.1f}°"],
        ["cohesion", "", f"{soil.cohesion / 1e3:.1f} kPa"], ["b1 from compaction", "", f"{soil.density_ratio:.3f}"],
        *([f"draft over base area, box of {100 * one.width:g} cm", f"{text(pressures(one), 0)} kPa", model]
          for one in [replace(REFERENCE, width=width) for width in (0.22, 0.28, 0.38, 0.5)]),
    ]  # fmt: skip


def on_faces() -> dict[float, Array]:
    """Return for closed shares, by the half angle of the cone, which part of the draft the working faces carry."""
    shares = angles(10.0, 15.0, 20.0, 25.0, kind="closed_share")
    return {one.half_angle: numbers(one, "working") / numbers(one) for one in shares}


def face_table() -> Rows:
    """Return for closed shares which part of the draft acts on the working faces, the rest on the underside."""
    rows = [[f"{angle:g}°", text(part)] for angle, part in on_faces().items()]
    return [["half angle of its cone", "part of the draft on the working faces"], *rows]


CONES = angles(8.0, 10.0, 15.0, 20.0, 25.0, width=0.38)
"""Cones beside which displacements are compared."""


def zones(part: int) -> dict[float, Array]:
    """Return how far soil moves by a part [%] of the base radius, over it, by half angle, unless that is the wall."""
    radii = {one: numbers(one, f"zone_{part}") for one in CONES}
    return {one.half_angle: far / one.base_radius for one, far in radii.items() if max(far) < 0.48 * one.width}


def fronts() -> list[float]:
    """Return where the model displaces soil by the parts of ZONES and where its front is, over the base radius."""
    ratio = tested_soil(REFERENCE.cohesion, REFERENCE.pressure).density_ratio
    return [displaced(ratio, part / 100.0) for part in (*ZONES, 0)]


def zone_table() -> Rows:
    """Return how far soil is displaced beside cones, over their base radius, and in the model, which has a front."""
    rows = [["half angle", "radius of 2 % over base radius", "of 5 %", "of 10 %", "front"]]
    for angle in (one.half_angle for one in CONES):
        radii = (zones(part).get(angle) for part in ZONES)
        rows.append([f"{angle:g}°", *("beyond the wall" if one is None else text(one, 1) for one in radii), ""])
    return [*rows, ["model", *(f"{radius:.1f}" for radius in fronts())]]


def carried(case: Case) -> Array:
    """Return the largest displacement of a sphere along the path over the travel of the tool, packing by packing."""
    return numbers(case, "carried") / (case.length - END_GAP)


def size_effect(angle: float, sizes: Sequence[float] = SIZES) -> tuple[float, float, float]:
    """Return the pressure on the base for spheres of no size and its standard error [kPa].

    The roots of the drafts are linear in the diameter of the spheres if these make the base seem wider; the last number
    is by which part of a diameter on each side.
    """
    cones = [cone for size in sizes for cone in angles(angle, diameter=size)]
    points = [(one.diameter, root) for one in cones for root in np.sqrt(pressures(one))]
    (slope, start), covariance = np.polyfit(*np.transpose(points), 1, cov=True)
    return start**2, 2.0 * start * math.sqrt(covariance[1, 1]), slope / start * cones[0].base_radius


def sizes_of(angle: float) -> list[Case]:
    """Return the cones of a half angle that were pulled through spheres of different sizes."""
    return [cone for size in SIZES for cone in angles(angle, diameter=size) if len(numbers(cone))]


def size_table() -> Rows:
    """Return the draft over the size of the spheres, and over the area of a base that is wider by half a sphere."""
    rows = [["half angle", "spheres", "base over sphere", "draft over base [kPa]", "over base wider by a sphere [kPa]"]]
    for cone in (*sizes_of(15.0), *sizes_of(25.0)):
        both = (text(pressures(cone, wider), 0) for wider in (0.0, cone.diameter / 2.0))
        width = 2.0 * cone.base_radius / cone.diameter
        rows.append([f"{cone.half_angle:g}°", f"{1e3 * cone.diameter:g} mm", f"{width:.1f}", *both])
    level, error, _ = size_effect(15.0)
    return [*rows, ["15°", "no size", "", f"{level:.0f} ± {error:.0f}", ""]]


def indices() -> dict[Case, tuple[Array, Array]]:
    """Return cone index and draft over base [kPa] of the reference cone in different soils."""
    soils = [{"pressure": p} for p in (25e3, 50e3, 100e3, 200e3)] + [{"cohesion": c} for c in (0.0, 200e3)]
    points = {one: replace(one, kind="penetrometer", height=0.0746, speed=0.5)
              for one in (replace(REFERENCE, **soil) for soil in soils)}  # fmt: skip
    return {one: (pressures(point), pressures(one)) for one, point in points.items()}


def index_table() -> Rows:
    """Return the cone index of a packing beside the draft of the reference cone over its base, whose ratio is 1."""
    rows = [[f"{one.pressure / 1e3:g} kPa", f"{one.cohesion / 1e3:g} kPa", text(index, 0), text(draft / index)]
            for one, (index, draft) in indices().items()]  # fmt: skip
    return [["pressure", "cohesion of contacts", "cone index [kPa]", "draft over base and cone index"], *rows]


def on_mount(stiffness: float) -> list[Array]:
    """Return draft and RMS of the force of the share in bands on a mount [N/m], over those on a rigid one."""
    return [
        numbers(replace(SPRUNG, stiffness=stiffness), name) / numbers(SPRUNG, name) for name in ("draft", "scatter")
    ]


def mount_table() -> Rows:
    """Return mean draft and RMS of a sprung share over those of a rigid one, among particles and in the model."""
    rows = [["stiffness", "draft over rigid", "model", "RMS of force over rigid", "model"]]
    for k in STIFFNESSES:
        cells = [(text(one), f"{value:.2f}") for one, value in zip(on_mount(k), sprung_model(k), strict=True)]
        rows.append([f"{k / 1e3:g} kN/m", *itertools.chain(*cells)])
    return rows


# --- pictures ---

SHARES = ("plane wedge", "share with closed underside", "share with open underside")
TRENDS = (
    ("half_angle", [f"half angle, box of {width} cm" for width in (28, 38, 50)]),
    ("half_angle", ["half angle, equal base"]),
    ("half_angle", [f"{kind} over its cone" for kind in SHARES]),
    *((name, [name.replace("_", " ")]) for name in ("pressure", "cohesion", "tool_friction", "height", "speed")),
)
"""What varies along the axis of each panel, and the questions in it."""


def points(axes: Axes, at: Iterable[float], values: Iterable[Array], label: str) -> None:
    """Draw means over the packings with two standard errors to each side."""
    means, errors = zip(*((np.mean(one), 2.0 * error_of(one)) for one in values), strict=True)
    axes.errorbar([*at], means, errors, fmt="o", markersize=4, label=label)


def plot_trend(axes: Axes, name: str, asked: Iterable[str]) -> None:
    """Draw ratios of draft over a quantity, among particles, in the model, and of the areas of the bases."""
    unit, scale = ("kPa", 1e-3) if UNIT.get(name) == "Pa" else (UNIT.get(name, "-"), 1.0)
    lines: dict[float, tuple[float, float]] = {}
    for question in asked:
        ratios = questions()[question]
        at = [scale * getattr(one.case, name) for one in ratios]
        points(axes, at, [one.values for one in ratios], question)
        lines |= {scale * getattr(one.other, name): (1.0, 1.0) for one in ratios}
        lines |= {x: (one.model, one.area) for x, one in zip(at, ratios, strict=True)}
    for k, style, label in ((0, "k-", "model"), (1, "k:", "area of the base")):
        axes.plot(sorted(lines), [lines[x][k] for x in sorted(lines)], style, label=label)
    axes.set(xlabel=f"{name.replace('_', ' ')} [{unit}]", ylabel="draft over that of the reference")
    axes.locator_params(nbins=5)


def plot_faces(axes: Axes) -> None:
    """Draw the split of a closed share's draft over its faces."""
    found = on_faces()
    points(axes, found, found.values(), "two working faces")
    points(axes, found, [1.0 - part for part in found.values()], "underside")
    axes.axhline(1.0, color="k", label="model: all on the working faces")
    axes.set(xlabel="half angle of the equivalent cone [deg]", ylabel="part of a closed share's draft")


def plot_carried(axes: Axes) -> None:
    """Draw how far soil was carried along, over the travel of the cone."""
    cones = angles(8.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0)
    points(axes, [one.half_angle for one in cones], map(carried, cones), "soil that was carried farthest")
    axes.axhline(1.0, color="k", label="a body that rides ahead")
    axes.set(xlabel="half angle [deg]", ylabel="soil carried along over travel")


def plot_zones(axes: Axes) -> None:
    """Draw how far beside cones soil is displaced, the model's radii, its front, and the wall of the box."""
    for k, (part, radius) in enumerate(zip(ZONES, fronts(), strict=False)):
        points(axes, found := zones(part), found.values(), f"displaced by {part} % of the base radius")
        axes.axhline(radius, color=f"C{k}", linewidth=1.0)
    axes.axhline(fronts()[-1], color="k", label="model's front; its radii in colour")
    walls = [one.width / 2.0 / one.base_radius for one in CONES]
    axes.plot([one.half_angle for one in CONES], walls, "k:", label="wall of the box")
    axes.set(xlabel="half angle [deg]", ylabel="radius over base radius", ylim=(0.0, 20.0))


def plot_index(axes: Axes) -> None:
    """Draw the draft of the reference cone over the cone index of the same soil, and the model's closed ratio."""
    for cone, pair in indices().items():
        (x, y), (dx, dy) = map(np.mean, pair), (2.0 * error_of(one) for one in pair)
        axes.errorbar(x, y, dy, dx, fmt="o", markersize=4, label=named(cone) or "reference")
    axes.axline((0.0, 0.0), slope=1.0, color="k", label="model")
    axes.set(xlabel="cone index [kPa]", ylabel="draft over base area [kPa]", xlim=(0.0, None))


def plot_sizes(axes: Axes) -> None:
    """Draw the draft over the size of the spheres, and its extrapolation to spheres of no size."""
    for angle in (15.0, 25.0):
        cones = sizes_of(angle)
        points(axes, [1e3 * one.diameter for one in cones], map(pressures, cones), f"half angle {angle:g} deg")
    level, error, wider = size_effect(15.0)
    axes.errorbar([0.0], [level], [2.0 * error], fmt="C0s", label="extrapolation")
    fine = np.linspace(0.0, max(SIZES))
    axes.plot(1e3 * fine, level * (1.0 + wider * fine / REFERENCE.base_radius) ** 2, "C0-")
    axes.axhline(model_pressure(REFERENCE), color="k", label="model, half angle 15 deg")
    axes.set(xlabel="diameter of the spheres [mm]", ylabel="draft over base area [kPa]")


def plot_mount(axes: Axes, which: int, quantity: str) -> None:
    """Draw mean draft (0) or RMS of force (1) of a sprung share over the stiffness, with the model's curve."""
    points(axes, STIFFNESSES, [on_mount(k)[which] for k in STIFFNESSES], "share in bands of strength")
    fine = np.geomspace(min(STIFFNESSES), max(STIFFNESSES), 60).tolist()
    axes.plot(fine, [sprung_model(k)[which] for k in fine], "k-", label="model")
    axes.set(xlabel="stiffness of the mount [kN/m]", ylabel=f"{quantity} over that of a rigid mount", xscale="log")
    axes.set_xticks(STIFFNESSES, [f"{1e-3 * k:g}" for k in STIFFNESSES], minor=False)


PANELS: list[Callable[[Axes], None]] = [
    *(functools.partial(plot_trend, name=name, asked=asked) for name, asked in TRENDS),
    plot_faces, plot_carried, plot_zones, plot_index, plot_sizes,
    *(functools.partial(plot_mount, which=k, quantity=q) for k, q in enumerate(("draft", "RMS of force"))),
]  # fmt: skip


def plot(folder: Path) -> None:
    """Draw the picture into a folder."""
    figure, every = plt.subplots(5, 3, figsize=(11.0, 16.0), layout="constrained")
    for axes, draw in zip(every.flat, PANELS, strict=True):
        draw(axes)
        axes.set_ylim(0.0, None)
        axes.legend(fontsize="x-small")
    figure.savefig(folder / "validation_particles.png", dpi=100)


# On the page, and printed only.
TABLES = (reference_table,)
FURTHER = (ratio_table, face_table, zone_table, size_table, index_table, mount_table)
