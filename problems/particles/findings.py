"""Ratios of drafts among particles beside the model's, whose soil comes from triaxial tests of the same packings.

`python problems/validation.py` prints the tables and draws the picture.
"""

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from particles.run_plan import BAND_LENGTH, HERE, MATERIAL, MOUNT, PACKINGS, UNIT, Case, key_of, read_rows, series

import plough_opt as po

REFERENCE = Case(case="", question="")
SPRUNG = replace(REFERENCE, half_angle=20.0, height=0.07, length=0.56, bands=1)
TRIAXIAL = replace(REFERENCE, kind="triaxial")
SIZES = (0.028, 0.02, 0.015, 0.013, 0.01)
ZONES = (2, 5, 10)
"""Displacements in per cent of the base radius."""
Row = Mapping[str, str]
Array = NDArray[np.float64]
Rows = list[list[str]]


@functools.cache
def table() -> dict[tuple[str, ...], dict[int, Row]]:
    """Return the rows of both files: parameters but the seed -> seed -> row."""
    found: dict[tuple[str, ...], dict[int, Row]] = {}
    for row in (*read_rows(HERE / "particles.csv"), *read_rows(HERE / "triaxial.csv")):
        found.setdefault(key_of(row)[:-1], {})[int(row["seed"])] = row
    return found


def numbers(case: Case, column: str = "draft") -> Array:
    """Return a column of a case's rows, packing by packing; empty if the case was not run in all of them."""
    rows = table().get(case.key[:-1], {})
    return np.array([float(rows[seed][column]) for seed in PACKINGS] if {*PACKINGS} <= {*rows} else [])


def text(values: Array, digits: int = 2) -> str:
    """Return mean and standard error."""
    return f"{np.mean(values):.{digits}f} ± {error_of(values):.{digits}f}"


def error_of(values: Array) -> float:
    """Return the standard error of a mean."""
    return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def named(case: Case) -> str:
    """Return in words what distinguishes a case from the reference."""
    changed = {one.name: getattr(case, one.name) for one in fields(Case)[2:]}
    changed = {
        k: v for k, v in changed.items() if v != getattr(REFERENCE, k) or (k == "half_angle" and case.kind != "cone")
    }
    words = [value.replace("_", " ") if name == "kind" else f"{name.replace('_', ' ')} {value:g} {UNIT.get(name, '')}"
             for name, value in changed.items()]  # fmt: skip
    return ", ".join(words).replace(" ,", ",").rstrip()


# --- the model, predicted ---


@functools.cache
def tested_soil(cohesion: float, pressure: float) -> po.Soil | None:
    """Return the soil that triaxial tests of the packings give at a pressure [Pa]; None if they have not been run.

    Cohesion and angle of friction follow from the line through the largest stresses, b1 from the compaction before
    dilation at this pressure. The argument is the cohesion of contacts; the tool's friction is not yet set.
    """
    tests = [replace(TRIAXIAL, cohesion=cohesion, pressure=at) for at in (25e3, 50e3, 100e3, 200e3)]
    stresses = [(one.pressure, stress) for one in tests for stress in numbers(one, "axial_stress")]
    here = replace(TRIAXIAL, cohesion=cohesion, pressure=pressure)
    compaction = numbers(here, "compaction")
    if not len(compaction) or len({at for at, _ in stresses}) < 2:
        return None
    slope, start = np.polyfit(*zip(*stresses, strict=True), 1)
    angle, ratio = math.asin((slope - 1.0) / (slope + 1.0)), math.exp(-np.mean(compaction))
    density = MATERIAL["density"] * (1.0 - np.mean(numbers(here, "porosity")))
    return po.Soil(density, ratio, max(start, 0.0) / (2.0 * math.sqrt(slope)), angle, 0.0, pressure)


def predicted(case: Case) -> float:
    """Return the model's draft [N] of a case, for a share that of its equivalent cone; NaN without triaxial tests."""
    soil = tested_soil(case.cohesion, case.pressure)
    if soil is None:
        return math.nan
    soil = replace(soil, tool_friction=case.tool_friction)
    cone = po.Cone(math.radians(case.half_angle), case.height)
    return float(po.Scene(soil, cone, 1e6, 1.0, case.speed, po.Effects(motion=False)).steady_resistance)


def sprung_model(stiffness: float) -> po.Run:
    """Return the model's periodic motion with the mean and the RMS of force [N] that the rigid pull had."""
    mean, rms = (float(np.mean(numbers(SPRUNG, name))) for name in ("draft", "scatter"))
    soil = tested_soil(REFERENCE.cohesion, REFERENCE.pressure)
    wave = po.StrengthWave(math.sqrt(2.0) * rms / mean, BAND_LENGTH)
    effects = po.Effects(damping=MOUNT["damping"], strength_wave=wave, orbit="periodic", inertial_drag=False)
    cone = po.Cone(math.radians(SPRUNG.half_angle), SPRUNG.height)
    scene = po.Scene(soil, cone, stiffness, MOUNT["mass"], SPRUNG.speed, effects)
    level = mean / float(scene.steady_resistance)
    return po.simulate(replace(scene, soil=replace(soil, strength_factor=level)))


def displaced(density_ratio: float, part: float) -> float:
    """Return where the model displaces soil by a part of the base radius, over that radius.

    Behind the front soil of b1 times its volume surrounds the cone: a ring of radius y goes to sqrt(R^2 + b1 y^2).
    """
    lost = 1.0 - density_ratio
    return (math.sqrt(part**2 + lost * (1.0 - part**2)) - part) / lost


# --- ratios ---


@dataclass(frozen=True)
class Ratio:
    """A case's draft over that of another: packing by packing, in the model, and of the areas of the bases."""

    case: Case
    other: Case
    values: Array
    model: float
    area: float


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
            known = math.isfinite(one.model) and not question.startswith("error")
            rows.append([question, named(one.case), text(one.values), *(model if known else [""] * 3)])
    return rows


def pooled_error() -> float:
    """Return the relative standard error of a ratio, from the scatter of the packings over all ratios."""
    every = [error_of(one.values) / np.mean(one.values) for ratios in questions().values() for one in ratios]
    return float(np.sqrt(np.mean(np.square(every))))


# --- what is no ratio ---


def pressures(case: Case, wider: float = 0.0) -> Array:
    """Return the draft over the area of a base that is wider by a length [m] on each side [kPa], packing by packing."""
    return numbers(case) / (math.pi * (case.base_radius + wider) ** 2) / 1e3


def angles(*values: float, **changes: object) -> list[Case]:
    """Return the reference with these half angles [deg] and changes."""
    return [replace(REFERENCE, half_angle=value, **changes) for value in values]


def reference_table() -> Rows:
    """Return what the reference cone gives in absolute numbers: quantity, among particles, in the model."""
    soil = tested_soil(REFERENCE.cohesion, REFERENCE.pressure)
    model = predicted(REFERENCE) / (math.pi * REFERENCE.base_radius**2) / 1e3
    boxes = [one for width in (0.22, 0.28, 0.38, 0.5) if len(numbers(one := replace(REFERENCE, width=width)))]
    return [
        ["quantity", "particles", "model"], ["porosity", f"{np.mean(numbers(REFERENCE, 'porosity')):.3f}", ""],
        ["angle of friction", "", f"{math.degrees(soil.friction_angle):.1f}°"],
        ["cohesion", "", f"{soil.cohesion / 1e3:.1f} kPa"], ["b1 from compaction", "", f"{soil.density_ratio:.3f}"],
        *([f"draft over base area, box of {100 * one.width:g} cm", f"{text(pressures(one), 0)} kPa", f"{model:.0f} kPa"]
          for one in boxes),
    ]  # fmt: skip


def face_table() -> Rows:
    """Return for closed shares which part of the draft acts on the working faces, the rest on the underside."""
    shares = angles(10.0, 15.0, 20.0, 25.0, kind="closed_share")
    rows = [[f"{one.half_angle:g}°", text(numbers(one, "working") / numbers(one))] for one in shares]
    return [["half angle of its cone", "part of the draft on the working faces"], *rows]


def zone_table() -> Rows:
    """Return how far soil is displaced beside cones, over their base radius, and in the model, which has a front."""
    rows = [["half angle", "radius of 2 % over base radius", "of 5 %", "of 10 %", "front"]]
    for cone in angles(8.0, 10.0, 15.0, 20.0, 25.0, width=0.38):
        radii = [numbers(cone, f"zone_{part}") for part in ZONES]
        over = (text(one / cone.base_radius, 1) if max(one) < 0.48 * cone.width else "beyond the wall" for one in radii)
        rows.append([f"{cone.half_angle:g}°", *over, ""])
    ratio = tested_soil(REFERENCE.cohesion, REFERENCE.pressure).density_ratio
    return [*rows, ["model", *(f"{displaced(ratio, part / 100.0):.1f}" for part in (*ZONES, 0))]]


def size_effect(angle: float) -> tuple[float, float, float]:
    """Return the pressure on the base for spheres of no size and its standard error [kPa].

    The roots of the drafts are linear in the diameter of the spheres if these make the base seem wider; the last number
    is by which part of a diameter on each side.
    """
    cones = [cone for size in SIZES for cone in angles(angle, diameter=size)]
    points = [(one.diameter, root) for one in cones for root in np.sqrt(pressures(one))]
    (slope, start), covariance = np.polyfit(*np.transpose(points), 1, cov=True)
    return start**2, 2.0 * start * math.sqrt(covariance[1, 1]), slope / start * cones[0].base_radius


def size_table() -> Rows:
    """Return the draft over the size of the spheres, and over the area of a base that is wider by half a sphere."""
    rows = [["half angle", "spheres", "base over sphere", "draft over base [kPa]", "over base wider by a sphere [kPa]"]]
    for cone in (cone for angle in (15.0, 25.0) for size in SIZES for cone in angles(angle, diameter=size)):
        if len(numbers(cone)):
            both = (text(pressures(cone, wider), 0) for wider in (0.0, cone.diameter / 2.0))
            width = 2.0 * cone.base_radius / cone.diameter
            rows.append([f"{cone.half_angle:g}°", f"{1e3 * cone.diameter:g} mm", f"{width:.1f}", *both])
    level, error, _ = size_effect(15.0)
    return [*rows, ["15°", "no size", "", f"{level:.0f} ± {error:.0f}", ""]]


def index_table() -> Rows:
    """Return the cone index of a packing beside the draft of the reference cone over its base, whose ratio is 1."""
    rows = [["pressure", "cohesion of contacts", "cone index [kPa]", "draft over base and cone index"]]
    for pressure, cohesion in [*((p, 100e3) for p in (25e3, 50e3, 100e3, 200e3)), (50e3, 0.0), (50e3, 200e3)]:
        cone = replace(REFERENCE, pressure=pressure, cohesion=cohesion)
        index = pressures(replace(cone, kind="penetrometer", height=0.0746, speed=0.5))
        if len(index):
            soil = f"{pressure / 1e3:g} kPa", f"{cohesion / 1e3:g} kPa"
            rows.append([*soil, text(index, 0), text(pressures(cone) / index)])
    return rows


def mounts() -> dict[float, tuple[Array, Array]]:
    """Return draft and RMS of the force of the share in bands by stiffness of its mount [N/m]; 0 is rigid."""
    cases = [replace(SPRUNG, stiffness=k) for k in (0.0, 20e3, 50e3, 100e3, 200e3, 500e3, 2e6)]
    return {one.stiffness: (numbers(one), numbers(one, "scatter")) for one in cases if len(numbers(one))}


def mount_table() -> Rows:
    """Return mean draft and RMS of a sprung share over those of a rigid one, among particles and in the model."""
    rows = [["stiffness", "draft over rigid", "model", "RMS of force over rigid", "model"]]
    found = mounts()
    rigid = found.pop(0.0)
    for stiffness, measured in found.items():
        model = sprung_model(stiffness)
        pairs = zip(measured, rigid, (model.mean_draft, model.force_rms), strict=True)
        cells = [(text(one / of), f"{float(value) / np.mean(of):.2f}") for one, of, value in pairs]
        rows.append([f"{stiffness / 1e3:g} kN/m", *itertools.chain(*cells)])
    return rows


# --- picture ---

SHARES = ("plane wedge", "share with closed underside", "share with open underside")
PANELS = (
    ("half_angle", [f"half angle, box of {width} cm" for width in (28, 38, 50)]),
    ("half_angle", ["half angle, equal base"]),
    ("half_angle", [f"{kind} over its cone" for kind in SHARES]),
    *((name, [name.replace("_", " ")]) for name in ("pressure", "tool_friction", "height", "speed")),
)
"""What varies along the axis of each panel, and the questions in it."""


def plot_mount(axes: Axes) -> None:
    """Draw the RMS of the force of a sprung share over the stiffness of its mount, with the model's curve."""
    found = mounts()
    _, rigid = found.pop(0.0)
    ratios = [rms / rigid for _, rms in found.values()]
    means, errors = [np.mean(one) for one in ratios], [2.0 * error_of(one) for one in ratios]
    axes.errorbar([*found], means, errors, fmt="o", markersize=4, label="share in bands of strength")
    fine = np.geomspace(min(found), max(found), 60).tolist()
    axes.plot(fine, [float(sprung_model(k).force_rms) / np.mean(rigid) for k in fine], "k-", label="model")
    axes.set(xlabel="stiffness of the mount [kN/m]", ylabel="RMS of force over that of a rigid mount", xscale="log")
    axes.set_xticks([*found], [f"{1e-3 * k:g}" for k in found], minor=False)
    axes.minorticks_off()


def plot(path: Path) -> None:
    """Draw the ratios of draft among particles and in the model, and the RMS of force over the mount's stiffness."""
    figure, every = plt.subplots(2, 4, figsize=(14.0, 6.4), layout="constrained")
    found = questions()
    for axes, (name, asked) in zip(every.flat, PANELS, strict=False):
        lines: dict[float, tuple[float, float]] = {}
        for question in asked:
            ratios = found[question]
            at = [getattr(one.case, name) for one in ratios]
            means, errors = [np.mean(one.values) for one in ratios], [2.0 * error_of(one.values) for one in ratios]
            axes.errorbar(at, means, errors, fmt="o", markersize=4, label=question)
            lines |= {getattr(one.other, name): (1.0, 1.0) for one in ratios}
            lines |= {getattr(one.case, name): (one.model, one.area) for one in ratios}
        at = sorted(lines)
        axes.plot(at, [lines[x][0] for x in at], "k-", label="model")
        axes.plot(at, [lines[x][1] for x in at], "k:", label="area of the base")
        axes.set(xlabel=f"{name.replace('_', ' ')} [{UNIT.get(name, '-')}]", ylabel="draft over that of the reference")
        axes.locator_params(nbins=5)
    plot_mount(every[1, 3])
    for axes in every.flat:
        axes.set_ylim(0.0, None)
        axes.legend(fontsize="x-small")
    figure.savefig(path, dpi=110)


TABLES = (reference_table, ratio_table, face_table, zone_table, size_table, index_table, mount_table)
