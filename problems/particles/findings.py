"""Compare the drafts among particles with the model, whose soil comes from triaxial tests of the same packings.

python problems/particles/findings.py [--plot FILE]
"""

import argparse
import dataclasses
import functools
import math
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from run_plan import DENSITY, HERE, Case, read_rows

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


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (headings, ["---"] * len(headings), *rows))


def plot(path: Path) -> None:
    """Draw the ratios of draft over half angle, and over pressure, with the model's."""
    figure, (angle, pressure) = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
    panels = (
        (angle, QUESTIONS[0], "half_angle", 1.0, "box of 28 cm"),
        (angle, QUESTIONS[1], "half_angle", 1.0, "box of 38 cm"),
        (pressure, next(q for q in QUESTIONS if q.words == "pressure"), "pressure", 1e-3, "particles"),
    )
    for axes, question, name, scale, label in panels:
        found = ratios(question)
        at = [scale * getattr(one.case, name) for one in found]
        means, errors = [one.mean for one in found], [2.0 * one.error for one in found]
        axes.errorbar(at, means, errors, fmt="o", label=f"{label}, ±2 standard errors")
        if question is not QUESTIONS[0]:
            axes.plot(at, [one.model or math.nan for one in found], "k-", label="model, soil from triaxial tests")
    angle.set(xlabel="half angle [°]", ylabel="draft over that at 15°")
    pressure.set(xlabel="pressure [kPa]", ylabel="draft over that at 50 kPa")
    for axes in (angle, pressure):
        axes.set_ylim(0.0, None)
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)


TABLES = {
    "the reference": (("quantity", "particles", "model"), reference_table),
    "ratios": (("question", "case", "ratio of draft among particles", "model", "model's error"), ratio_table),
}


def main() -> None:
    """Print the tables of docs/validation.md and, on demand, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="picture of the ratios")
    chosen = parser.parse_args()
    for headings, rows in TABLES.values():
        print(markdown(headings, rows()), end="\n\n")
    if chosen.plot:
        plot(chosen.plot)


if __name__ == "__main__":
    main()
