"""Compare the drafts among particles with the model, whose soil comes from triaxial tests of the same packings.

python problems/particles/findings.py [--plot FILE]
"""

import argparse
import dataclasses
import functools
import math
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from run_plan import BAND_LENGTH, DENSITY, HERE, MOUNT_DAMPING, MOUNT_MASS, Case, base_radius, read_rows

import plough_opt as po

FIELDS = typing.get_type_hints(Case)
Row = Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class Question:
    """Cases that are compared with a reference case as ratios of draft, packing by packing.

    Attributes:
        words: what is asked.
        questions: the cases' `question` in the plan.
        varied: the parameters that differ, with their values in the reference.
        fixed: parameters that select the cases.
        label: format of a case's name in tables.
    """

    words: str
    questions: tuple[str, ...]
    varied: Mapping[str, object]
    label: str
    fixed: Mapping[str, object] = dataclasses.field(default_factory=dict)


EXPERIMENT = "error of the experiment"
WIDER = "half angle, wider box"
CONE = {"kind": "cone"}
QUESTIONS = (
    Question(
        "half angle, equal height, box of 28 cm", ("half angle, equal height",), {"half_angle": 15.0}, "{half_angle:g}°"
    ),
    Question(
        "half angle, equal height, box of 38 cm", (WIDER,), {"half_angle": 15.0}, "{half_angle:g}°", {"width": 0.38}
    ),
    Question(
        "half angle, equal base",
        ("half angle, equal base",),
        {"half_angle": 15.0, "height": 0.1, "length": 0.36},
        "{half_angle:g}°",
    ),
    *(
        Question(f"{words} over its cone", ("wedge against cone",), CONE, "{half_angle:g}°", {"kind": kind})
        for words, kind in (
            ("plane wedge", "wedge"),
            ("share with closed underside", "closed_share"),
            ("share with open underside", "open_share"),
        )
    ),
    Question("height", ("height",), {"height": 0.1}, "{height:g} m"),
    Question("speed", ("speed",), {"speed": 2.0}, "{speed:g} m/s"),
    Question("pressure", ("pressure",), {"pressure": 50e3}, "{pressure:g} Pa"),
    Question("cohesion of contacts", ("cohesion",), {"cohesion": 100e3}, "{cohesion:g} Pa"),
    Question("tool friction", ("tool friction",), {"tool_friction": 0.4}, "{tool_friction:g}"),
    Question("error: size of the spheres", (EXPERIMENT,), {"diameter": 0.02}, "{diameter:g} m at {half_angle:g}°"),
    Question("error: width of the box", (EXPERIMENT, WIDER), {"width": 0.28}, "{width:g} m at {half_angle:g}°"),
    Question("error: length of the box", (EXPERIMENT,), {"length": 0.36}, "{length:g} m"),
    Question("error: damping", (EXPERIMENT,), {"damping": 0.2}, "{damping:g}"),
    Question("error: friction of the sides", (EXPERIMENT,), {"side_friction": 0.5}, "{side_friction:g}"),
    Question("error: cohesion of new contacts", (EXPERIMENT,), {"heals": 0}, "{heals:g}"),
    Question("error: time step", (EXPERIMENT,), {"dt_factor": 0.8}, "{dt_factor:g}"),
)
REFERENCE = Case(case="", question="")
BASE = base_radius(REFERENCE)


@functools.cache
def table(name: str) -> list[Row]:
    """Return the rows of a table of this folder."""
    return read_rows(HERE / f"{name}.csv")


def case_of(row: Row) -> Case:
    """Return the parameters of a row."""
    return Case(**{name: kind(row[name]) for name, kind in FIELDS.items()})


def drafts(case: Case) -> dict[int, float]:
    """Return the drafts [N] of a case in all its packings: seed -> mean force."""
    wanted = dataclasses.replace(case, seed=0).key
    pairs = ((case_of(row), float(row["draft"])) for row in table("particles"))
    return {one.seed: draft for one, draft in pairs if dataclasses.replace(one, seed=0).key == wanted}


def mean_and_error(values: Sequence[float]) -> tuple[float, float]:
    """Return mean and standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / math.sqrt(len(values)))


# --- the model, predicted ---


@functools.cache
def tested_soil(friction: float, cohesion: float, pressure: float) -> po.Soil | None:
    """Return the soil that triaxial tests of the packings give at a pressure [Pa]; None if they have not been run.

    Cohesion and angle of friction follow from the line through the largest stresses, b1 from the compaction before
    dilation at this pressure. Contacts have the friction and cohesion of a case; the tool's friction is not yet set.
    """
    rows = [(case_of(row), row) for row in table("triaxial")]
    tests = [(case.pressure, row) for case, row in rows if (case.friction, case.cohesion) == (friction, cohesion)]
    compaction = [float(row["compaction"]) for at, row in tests if at == pressure]
    lateral = np.array([at for at, _ in tests])
    if not compaction or len(np.unique(lateral)) < 2:
        return None
    slope, start = np.polyfit(lateral, [float(row["axial_stress"]) for _, row in tests], 1)
    angle, porosity = math.asin((slope - 1.0) / (slope + 1.0)), float(tests[0][1]["porosity"])
    ratio = math.exp(-np.mean(compaction))
    return po.Soil(DENSITY * (1.0 - porosity), ratio, max(start, 0.0) / (2.0 * math.sqrt(slope)), angle, 0.0, pressure)


def predicted(case: Case) -> float | None:
    """Return the model's draft [N] of a case; for every tool that of its equivalent cone."""
    soil = tested_soil(case.friction, case.cohesion, case.pressure)
    if soil is None:
        return None
    soil = dataclasses.replace(soil, tool_friction=case.tool_friction)
    cone = po.Cone(math.radians(case.half_angle), case.height)
    return float(po.Scene(soil, cone, 1e6, 1.0, case.speed, po.Effects(motion=False)).steady_resistance)


# --- ratios ---


@dataclasses.dataclass(frozen=True)
class Ratio:
    """A case's draft over that of its reference.

    Attributes:
        label: the case in words.
        case: its parameters.
        mean: mean ratio over the packings.
        error: its standard error, from the packings' scatter.
        model: the model's ratio, or None without a triaxial test.
    """

    label: str
    case: Case
    mean: float
    error: float
    model: float | None


def ratios(question: Question) -> list[Ratio]:
    """Return the ratios of the cases that were run in at least two packings, in the order of what varies."""
    pairs = {}
    for row in table("particles"):
        case = dataclasses.replace(case_of(row), case="", question="", seed=0)
        chosen = all(getattr(case, name) == value for name, value in question.fixed.items())
        reference = dataclasses.replace(case, **question.varied)
        if row["question"] in question.questions and chosen and case != reference:
            pairs[case.key] = (case, reference)
    result = []
    for case, reference in pairs.values():
        changed, unchanged = drafts(case), drafts(reference)
        values = [changed[seed] / unchanged[seed] for seed in changed if seed in unchanged]
        if len(values) > 1:
            model, base = predicted(case), predicted(reference)
            ratio = None if model is None or base is None else model / base
            label = question.label.format(**dataclasses.asdict(case))
            result.append(Ratio(label, case, *mean_and_error(values), ratio))
    order = [name for name in (*question.varied, "half_angle") if name != "kind"]
    return sorted(result, key=lambda one: [getattr(one.case, name) for name in order])


def ratio_table() -> list[list[str]]:
    """Return a row for each case: question, case, ratio among particles, the model's, and how far that is off."""
    rows = []
    for question in QUESTIONS:
        for one in ratios(question):
            cells = ["", ""]
            if one.model is not None and not question.words.startswith("error"):
                cells = [f"{one.model:.2f}", f"{100 * (one.model / one.mean - 1.0):+.0f} %"]
            rows.append([question.words, one.label, f"{one.mean:.2f} ± {one.error:.2f}", *cells])
    return rows


def reference_table() -> list[list[str]]:
    """Return what the reference cone gives in absolute numbers: quantity, among particles, in the model."""
    rows = [row for row in table("particles") if case_of(row).key[:-1] == REFERENCE.key[:-1]]
    soil = tested_soil(REFERENCE.friction, REFERENCE.cohesion, REFERENCE.pressure)
    model, radius = predicted(REFERENCE), float(rows[0]["base_radius"])
    if soil is None or model is None:
        raise SystemExit("triaxial.csv has no tests of the reference's soil: run run_plan.py first")
    pressure = mean_and_error([float(row["draft"]) / (math.pi * radius**2) for row in rows])
    zones = [np.mean([float(row[name]) for row in rows]) for name in ("zone_5", "zone_10")]
    front = po.loosened_radius(po.Cone(math.radians(REFERENCE.half_angle), REFERENCE.height), soil)
    return [
        ["angle of friction", "", f"{math.degrees(soil.friction_angle):.1f}°"],
        ["cohesion", "", f"{soil.cohesion / 1e3:.1f} kPa"],
        ["b1 from compaction", "", f"{soil.density_ratio:.3f}"],
        [
            "draft over the area of the base",
            f"{pressure[0] / 1e3:.0f} ± {pressure[1] / 1e3:.0f} kPa",
            f"{model / (math.pi * radius**2) / 1e3:.0f} kPa",
        ],
        [
            "radius where displacement passes 5 and 10 % of the base radius",
            f"{1e3 * zones[0]:.0f} and {1e3 * zones[1]:.0f} mm",
            f"front at {1e3 * front:.0f} mm",
        ],
    ]


# --- what is no ratio of drafts ---


def packings(question: str, **parameters: object) -> list[Row]:
    """Return the rows of all packings of a question's cases with these parameters."""
    rows = [row for row in table("particles") if row["question"] == question]
    return [row for row in rows if all(getattr(case_of(row), name) == x for name, x in parameters.items())]


def mean_of(rows: Sequence[Row], of: Callable[[Row], float], digits: int = 2) -> str:
    """Return the mean of a quantity over packings with its standard error as text."""
    mean, error = mean_and_error([of(row) for row in rows])
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def face_table() -> list[list[str]]:
    """Return for closed shares which part of the draft acts on the working faces, the rest on the underside."""
    rows = []
    for angle in (10.0, 15.0, 20.0, 25.0):
        found = packings("wedge against cone", kind="closed_share", half_angle=angle)
        if len(found) > 1:
            rows.append([f"{angle:g}°", mean_of(found, lambda row: float(row["working"]) / float(row["draft"]))])
    return rows


def zone_table() -> list[list[str]]:
    """Return how far soil is displaced beside cones, over their base radius, and where the model has its front."""
    soil = tested_soil(REFERENCE.friction, REFERENCE.cohesion, REFERENCE.pressure)
    front = "" if soil is None else f"{(1.0 - float(soil.density_ratio)) ** -0.5:.1f}"
    rows = []
    for angle in (8.0, 10.0, 15.0, 20.0, 25.0):
        found = packings(WIDER, half_angle=angle)
        if len(found) > 1:
            radii = [mean_of(found, functools.partial(over_base, name), 1) for name in ("zone_2", "zone_5", "zone_10")]
            rows.append([f"{angle:g}°", *radii, front])
    return rows


def over_base(name: str, row: Row) -> float:
    """Return a length of a row over the base radius."""
    return float(row[name]) / float(row["base_radius"])


def size_table() -> list[list[str]]:
    """Return the draft over the size of the spheres, and over the area of a base that is wider by half a sphere."""
    rows = []
    for angle in (15.0, 25.0):
        radius = 0.1 * math.tan(math.radians(angle))
        for diameter in (0.028, 0.02, 0.015, 0.01):
            found = [*drafts(dataclasses.replace(REFERENCE, half_angle=angle, diameter=diameter)).values()]
            if found:
                over = [np.array(found) / (math.pi * (radius + wider) ** 2) / 1e3 for wider in (0.0, diameter / 2.0)]
                texts = (f"{mean_and_error(x)[0]:.0f} ± {mean_and_error(x)[1]:.0f}" if len(found) > 1 else f"{x[0]:.0f}"
                         for x in over)  # fmt: skip
                rows.append([f"{angle:g}°", f"{1e3 * diameter:g} mm", f"{2.0 * radius / diameter:.1f}", *texts])
    return rows


def index_table() -> list[list[str]]:
    """Return the cone index of a packing beside the draft of the reference cone over its base, whose ratio is 1."""
    rows = []
    soils = [(pressure, 100e3) for pressure in (25e3, 50e3, 100e3, 200e3)] + [(50e3, 0.0), (50e3, 200e3)]
    for pressure, cohesion in soils:
        found = packings("cone index against draft", pressure=pressure, cohesion=cohesion)
        pulled = drafts(dataclasses.replace(REFERENCE, pressure=pressure, cohesion=cohesion))
        index = {int(row["seed"]): float(row["draft"]) / (math.pi * float(row["base_radius"]) ** 2) for row in found}
        ratio = [pulled[seed] / (math.pi * BASE**2) / index[seed] for seed in index if seed in pulled]
        if len(ratio) > 1:
            both = mean_and_error([x / 1e3 for x in index.values()]), mean_and_error(ratio)
            texts = (f"{mean:.{k}f} ± {error:.{k}f}" for k, (mean, error) in zip((0, 2), both, strict=True))
            rows.append([f"{pressure / 1e3:g} kPa", f"{cohesion / 1e3:g} kPa", *texts])
    return rows


def mount_cases() -> dict[float, list[Row]]:
    """Return the sprung pulls through bands by stiffness of the mount [N/m]; 0 is rigid."""
    rows = packings("sprung share in bands", bands=1)
    return {k: [r for r in rows if case_of(r).stiffness == k] for k in sorted({case_of(r).stiffness for r in rows})}


def sprung_model(stiffness: float, mean: float, rms: float) -> po.Run:
    """Return the model's periodic motion with the mean and the RMS of force that the rigid pull had."""
    soil, cone = (
        tested_soil(REFERENCE.friction, REFERENCE.cohesion, REFERENCE.pressure),
        po.Cone(math.radians(20), 0.07),
    )
    assert soil is not None
    wave = po.StrengthWave(math.sqrt(2.0) * rms / mean, BAND_LENGTH)
    effects = po.Effects(damping=MOUNT_DAMPING, strength_wave=wave, orbit="periodic", inertial_drag=False)
    scene = po.Scene(soil, cone, stiffness, MOUNT_MASS, REFERENCE.speed, effects)
    level = mean / float(scene.steady_resistance)
    return po.simulate(dataclasses.replace(scene, soil=dataclasses.replace(soil, strength_factor=level)))


def mount_table() -> list[list[str]]:
    """Return mean draft and RMS of a sprung share over those of a rigid one, among particles and in the model."""
    cases, rows = mount_cases(), []
    rigid = {row["seed"]: (float(row["draft"]), float(row["scatter"])) for row in cases.get(0.0, [])}
    for stiffness, found in cases.items():
        pairs = [
            (float(row["draft"]), float(row["scatter"]), *rigid[row["seed"]]) for row in found if row["seed"] in rigid
        ]
        if stiffness and len(pairs) > 1:
            draft, rms = (mean_and_error([one[k] / one[k + 2] for one in pairs]) for k in (0, 1))
            mean, scatter = np.mean([one[2:] for one in pairs], axis=0)
            run = sprung_model(stiffness, float(mean), float(scatter))
            model = float(run.mean_draft) / mean, float(run.force_rms) / scatter
            rows.append([f"{stiffness / 1e3:g} kN/m", f"{draft[0]:.2f} ± {draft[1]:.2f}", f"{model[0]:.2f}",
                         f"{rms[0]:.2f} ± {rms[1]:.2f}", f"{model[1]:.2f}"])  # fmt: skip
    return rows


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (headings, ["---"] * len(headings), *rows))


# Parameter, its label, its scale, and the questions whose ratios a panel shows.
PANELS = (
    ("half_angle", "half angle [°], equal height", 1.0, ("box of 28 cm", "box of 38 cm")),
    ("half_angle", "half angle [°], equal base", 1.0, ("equal base",)),
    ("half_angle", "half angle [°] of the equivalent cone", 1.0, ("plane wedge", "closed", "open")),
    ("pressure", "pressure [kPa]", 1e-3, ("pressure",)),
    ("tool_friction", "coefficient of tool friction", 1.0, ("tool friction",)),
    ("height", "height [m]", 1.0, ("height",)),
    ("speed", "speed [m/s]", 1.0, ("speed",)),
)


def plot_mount(axes: Axes) -> None:
    """Draw the RMS of the force of a sprung share over the stiffness of its mount, with the model's curve."""
    table, rigid = mount_table(), mount_cases().get(0.0, [])
    axes.set(xlabel="stiffness of the mount [kN/m]", ylabel="RMS of force over that of a rigid mount", xscale="log")
    if not table:
        return
    at = [float(row[0].split()[0]) for row in table]
    means, errors = zip(*((float(row[3].split()[0]), 2.0 * float(row[3].split()[2])) for row in table), strict=True)
    axes.errorbar(at, means, errors, fmt="o", markersize=4, label="share in bands of strength")
    mean, scatter = (float(np.mean([float(row[name]) for row in rigid])) for name in ("draft", "scatter"))
    fine = np.geomspace(min(at), max(at), 60)
    runs = [sprung_model(1e3 * k, mean, scatter) for k in fine.tolist()]
    axes.plot(fine, [float(run.force_rms) / scatter for run in runs], "k-", label="model")
    axes.set_xticks(at, [f"{k:g}" for k in at])
    axes.minorticks_off()


def plot(path: Path) -> None:
    """Draw the ratios of draft among particles and in the model, and the RMS of force over the mount's stiffness."""
    figure, every = plt.subplots(2, 4, figsize=(14.0, 6.4), layout="constrained")
    for axes, (name, label, scale, wanted) in zip(every.flat, PANELS, strict=False):
        for words in wanted:
            question = next(q for q in QUESTIONS if q.words == words or (words != name and words in q.words))
            found = ratios(question)
            at = [scale * getattr(one.case, name) for one in found]
            errors = [2.0 * one.error for one in found]
            axes.errorbar(at, [one.mean for one in found], errors, fmt="o", markersize=4, label=question.words)
        known = [(x, one.model) for x, one in zip(at, found, strict=True) if one.model is not None]
        if name in question.varied:
            known.append((scale * getattr(REFERENCE, name), 1.0))
        axes.plot(*zip(*sorted(known), strict=True), "k-", label="model")
        axes.set(xlabel=label, ylabel="draft over that of the reference")
    plot_mount(every[1, 3])
    for axes in every.flat:
        axes.set_ylim(0.0, None)
        if axes.has_data():
            axes.legend(fontsize="x-small")
    figure.savefig(path, dpi=110)


TABLES = {
    "the reference": (("quantity", "particles", "model"), reference_table),
    "ratios": (("question", "case", "ratio of draft among particles", "model", "model's error"), ratio_table),
    "faces": (("half angle of its cone", "part of the draft on the working faces"), face_table),
    "zone": (("half angle", "radius of 2 % over base radius", "of 5 %", "of 10 %", "model's front"), zone_table),
    "size": (
        ("half angle", "spheres", "base over sphere", "draft over base [kPa]", "over base wider by a sphere [kPa]"),
        size_table,
    ),
    "index": (("pressure", "cohesion of contacts", "cone index [kPa]", "draft over base and cone index"), index_table),
    "mount": (("stiffness", "draft over rigid", "model", "RMS of force over rigid", "model"), mount_table),
}


def main() -> None:
    """Print the tables of docs/explanation/validation.md and, on demand, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="picture of the ratios")
    chosen = parser.parse_args()
    for headings, rows in TABLES.values():
        if found := rows():
            print(markdown(headings, found), end="\n\n")
    if chosen.plot:
        plot(chosen.plot)


if __name__ == "__main__":
    main()
