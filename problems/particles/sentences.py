"""Parts of the sentences of docs/explanation/validation.md and of README.md that hold numbers.

`python problems/validation.py` prints them below the tables.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from measured import compare
from particles import findings
from particles.findings import REFERENCE, SHARES, SIZES, STIFFNESSES
from particles.run_plan import HERE, Case, read_rows

import plough_opt as po

QUESTIONS = findings.questions()
NUMBERS = {4: "four", 5: "five", 6: "six"}
PRESSURES = [25e3, 50e3, 100e3, 200e3]


def case(**changes: object) -> Case:
    """Return the reference with changes."""
    return replace(REFERENCE, **changes)  # type: ignore[arg-type]


def mean(column: str = "draft", **changes: object) -> float:
    """Return the mean of a case's packings."""
    return float(np.mean(findings.numbers(case(**changes), column)))


def predicted(**changes: object) -> float:
    """Return the model's draft of a case."""
    return findings.predicted(case(**changes))


def powers(name: str, low: float, high: float, **fixed: object) -> list[float]:
    """Return powers of a quantity with which the draft grows, among particles and in the model."""
    ends = [{**fixed, name: low}, {**fixed, name: high}]
    pairs = [[mean(**end) for end in ends], [predicted(**end) for end in ends]]
    return [math.log(last / first) / math.log(high / low) for first, last in pairs]


def ratios(question: str) -> list[float]:
    """Return the mean ratios of a question."""
    return [float(np.mean(one.values)) for one in QUESTIONS[question]]


def errors(question: str, angles: tuple[float, float] = (0.0, 90.0), name: str = "model") -> list[float]:
    """Return errors of the model in per cent, between two half angles."""
    chosen = [one for one in QUESTIONS[question] if angles[0] <= one.case.half_angle <= angles[1]]
    return [100.0 * (getattr(one, name) / float(np.mean(one.values)) - 1.0) for one in chosen]


def pressure(wider: float = 0.0, **changes: object) -> float:
    """Return the mean pressure over the base of a case [kPa]."""
    return float(np.mean(findings.pressures(case(**changes), wider)))


def largest(*errors: Iterable[float]) -> int:
    """Return the whole per cent that no error exceeds."""
    return math.ceil(round(max(abs(error) for one in errors for error in one), 6))


def over_pressure(following: bool) -> list[float]:
    """Return drafts over that at 50 kPa, with b1 from a compression test or that of 50 kPa at all pressures."""
    soils = [replace(findings.tested_soil(100e3, p), tool_friction=0.4) for p in PRESSURES]
    lost = [1.0 - soil.density_ratio for soil in soils]
    fixed = [replace(soil, density_ratio=soils[1].density_ratio) for soil in soils]
    soils = [po.Soil.from_compaction(PRESSURES, lost, soil) for soil in soils] if following else fixed
    cone, still = po.Cone(po.deg(15.0), 0.1), po.Effects(motion=False)
    drafts = [float(po.Scene(soil, cone, 1e6, 1.0, 2.0, still).steady_resistance) for soil in soils]
    return [draft / drafts[1] for draft in drafts]


def trends() -> list[str]:
    """Return what the page says of half angle, pressure, height, speed, cohesion and tool friction."""
    boxes = [f"half angle, box of {width} cm" for width in (28, 38)]
    slender, *_, blunt = QUESTIONS["half angle, equal base"]
    beyond = [100.0 * (x - 1.0) for x in ratios("half angle, equal base")[2:]]
    wider = [mean(half_angle=25.0, diameter=d) / mean(diameter=d) for d in SIZES[:3]]
    farthest = [float(np.mean(findings.carried(case(half_angle=a)))) for a in (8.0, 15.0, 25.0, 35.0)]
    assert farthest == sorted(farthest)
    grows, model = powers("pressure", 25e3, 200e3)
    one, deepest = over_pressure(False)[3], ratios("pressure")[-1]
    b1 = [findings.tested_soil(100e3, p).density_ratio for p in (25e3, 200e3)]
    cohesions = [findings.tested_soil(c, 50e3).cohesion / 1e3 for c in (0.0, 200e3)]
    smooth, *_, rough = QUESTIONS["tool friction"]
    limit = math.tan(math.radians(REFERENCE.friction))
    limited = predicted(tool_friction=limit) / predicted()
    slow = min(one.case.speed for one in QUESTIONS["speed"])
    height, square = powers("height", 0.07, 0.13, width=0.38)
    assert math.isclose(square, 2.0, abs_tol=0.01)
    assert one / deepest > 2.0  # a soil of one b1 at several pressures is named by `check`
    return [
        f"holds up to 20°, within {largest(*(errors(box, (0, 20)) for box in boxes))} %",
        f"within {largest(errors(boxes[1], (0, 20), 'area'))} % in the box of",
        "the draft grows {:.2f} times among spheres of 28 mm, {:.2f} times among 20 mm and {:.2f} times".format(*wider),
        f"the model says {predicted(half_angle=25.0) / predicted():.2f}",
        f"falls by {100 - 100 / np.mean(slender.values):.0f} %, in the model by {100 - 100 / slender.model:.0f} %",
        f"it stays within {largest(beyond)} %",
        f"takes off {100 - 100 * blunt.model:.0f} %",
        "of 15° and 35° carry {:.0f} and {:.0f} kPa".format(*(pressure(half_angle=a, width=0.5) for a in (15.0, 35.0))),
        "farthest went {:.2f} of the travel at 15°, {:.2f} at 25° and {:.2f} at 35°".format(*farthest[1:]),
        f"about 20°, where the error is {largest(errors('half angle, equal base', (20, 20)))} %",
        f"holds within {largest(errors('pressure'))} %, if b1 follows",
        f"the pressure to the power {grows:.2f}, in the model to the power {model:.2f}",
        f"the power is {math.log(one / over_pressure(False)[0]) / math.log(8.0):.2f}, and the draft",
        f"at 200 kPa is {one:.2f} times that at 50 kPa instead of {deepest:.2f} times",
        f"b1 from {b1[0]:.3f} at 25 kPa to {b1[1]:.3f} at 200 kPa",
        f"Height holds within {largest(errors('height'))} %",
        f"with the height to the power {height:.1f}, in the model with its square",
        f"Speed holds within {largest(errors('speed'))} %, from {slow:g} to 6 m/s",
        f"Cohesion holds within {largest(errors('cohesion'))} %",
        "only from {:.1f} to {:.1f} kPa, at 50 kPa of pressure".format(*cohesions),
        f"Tool friction holds within {largest(errors('tool friction'))} %",
        f"{100 * np.mean(smooth.values):.0f} % of the draft is left, in the model {100 * smooth.model:.0f} %",
        f"of 0.6 adds {100 * np.mean(rough.values) - 100:.0f} %",
        f"The model adds {100 * limited - 100:.0f} % for {limit:.2f}",
    ]


def tools() -> list[str]:
    """Return what the page says of wedges and shares, cone index, and mounts."""
    wedge, closed, opened = (f"{kind} over its cone" for kind in SHARES)
    below = [1.0 - np.mean(part) for part in findings.on_faces().values()]
    index = [float(np.mean(draft / index)) for index, draft in findings.indices().values()]
    drafts = [float(np.mean(draft)) for _, draft in findings.indices().values()]
    point = case(height=0.0746).base_radius
    wider = 0.02 * findings.size_effect(15.0)[2]
    size = ((1.0 + wider / REFERENCE.base_radius) / (1.0 + wider / point)) ** 2
    means = {k: [float(np.mean(one)) for one in findings.on_mount(k)] for k in STIFFNESSES}
    promised = {k: findings.sprung_model(k)[1] for k in means}
    soft, softer, stiff = (f"{means[k][1]:.2f}" for k in (20e3, 50e3, 2e6))
    peak = max(means, key=lambda k: means[k][1])
    resonance = 10.0 * (2.0 * math.pi * REFERENCE.speed / 0.11) ** 2
    assert min(promised, key=promised.get) == 20e3
    return [
        f"for a plane wedge within {largest(errors(wedge))} % and for a share with a closed underside"
        f" within {max(round(100 * x) for x in ratios(closed)) - 100} %",
        f"{100 * min(below):.0f} to {100 * max(below):.0f} % of the force acts on the underside",
        f"draws {100 * min(ratios(opened)):.0f} to {100 * max(ratios(opened)):.0f} % of its cone's",
        f"ratio holds within {largest([100 * (1 - x) for x in index])} %",
        f"is {min(index):.2f} to {max(index):.2f}, in {NUMBERS[len(index)]} soils",
        f"differ by a factor of up to {max(drafts) / min(drafts):.1f}",
        f"only {2.0 * point / 0.02:.1f} spheres wide, and the size of the spheres explains {size:.2f}",
        f"that of the rigid share within {largest([100 * (x - 1) for x, _ in means.values()])} %",
        f"largest at {peak / 1e3:.0f} kN/m, near the model's resonance at {resonance / 1e3:.0f} kN/m",
        f"{100 - 100 * means[peak][1] / promised[peak]:.0f} % less than the model's there",
        f"At 20 and 50 kN/m the RMS is {soft} and {softer} of the rigid",
        "promises {:.2f} and {:.2f}".format(*(promised[k] for k in (20e3, 50e3))),
        f"At 2000 kN/m it is {stiff}, and the model says {promised[2e6]:.2f}",
        f"takes off {100 - 100 * means[50e3][1] / means[2e6][1]:.0f} %,"
        f" in the model {100 - 100 * promised[50e3] / promised[2e6]:.0f} %",
    ]


def levels() -> list[str]:
    """Return what the page says of level, displaced zone, and the experiment itself."""
    model = findings.model_pressure(REFERENCE)
    low, widest = (pressure(**one) / model for one in ({}, {"width": 0.5}))
    at_no_size, error, _ = findings.size_effect(15.0)
    least = widest * at_no_size / model / low
    first, doubt, wider = findings.size_effect(15.0, SIZES[:3])
    expected = first * (1.0 + wider * 0.01 / REFERENCE.base_radius) ** 2
    assert at_no_size < first - doubt
    at_25 = [pressure(half_angle=25.0, diameter=d) / pressure(half_angle=25.0) for d in (0.015, 0.028)]
    radii = findings.fronts()[::-1]
    zones = {
        (angle, width, name): findings.text(findings.numbers(one, f"zone_{name}") / one.base_radius, 1)
        for angle, width in ((8.0, 0.38), (10.0, 0.38), (15.0, 0.38), (15.0, 0.5))
        for one in [case(half_angle=angle, width=width)]
        for name in (2, 5, 10)
    }
    boxes = [case(width=width) for width in (0.38, 0.5)]
    tenths = [findings.numbers(one, "zone_10") / one.base_radius for one in boxes]
    # Student's t at 97.5 % with two degrees of freedom.
    ends = np.array([np.mean(one) + side * 4.303 * findings.error_of(one) for one in tenths for side in (-1, 1)])
    only = {key: text.split()[0] for key, text in zones.items()}
    b1 = [findings.tested_soil(100e3, p).density_ratio for p in (200e3, 25e3)]
    named = [po.named_soil(name).density_ratio for name in po.soil_names()]
    every = [f"half angle, box of {width} cm" for width in (28, 38)]
    simple = ["height", "speed", "pressure", "cohesion", "tool friction"]
    found = [errors(question) for question in simple] + [errors(box, (0, 20)) for box in every]
    found += [errors(f"{kind} over its cone") for kind in SHARES[:2]]
    usual = [error for one in found for error in one if abs(error) < 10.0]
    assert len(usual) > 0.6 * sum(map(len, found))
    return [
        f"agree with particles within {largest(*found)} %, mostly within 10 %",
        f"low by a factor of {low:.1f} in the reference and {widest:.1f} in the widest box",
        "Sides without friction draw {:.2f} of the draft".format(*ratios("error: friction of the sides")),
        "a damping of 0.5 for 0.2 draws {:.2f}".format(*ratios("error: damping")),
        "a box longer by 10 cm {:.2f}".format(*ratios("error: length of the box")),
        "soil whose new contacts bond too {:.2f}".format(*ratios("error: cohesion of new contacts")),
        f"leads to {at_no_size:.0f} ± {error:.0f} kPa for spheres of no size at 15°,"
        f" a factor of {at_no_size / model:.1f}",
        f"holds at once, {least:.1f} is left",
        f"three coarsest sizes it gave {first:.0f} ± {doubt:.0f} kPa, and {expected:.0f} kPa at 10 mm,"
        f" where {pressure(diameter=0.01):.0f} kPa were found",
        "15 mm draw {:.2f} and of 28 mm {:.2f} of the draft".format(*at_25),
        f"between {least:.1f} and {low:.1f} and does not decide it",
        f"low, by a factor of {least:.1f} to {low:.1f} among particles",
        "at {1:.1f}, {2:.1f} and {3:.1f} base radii and end at {0:.1f}".format(*radii),
        f"at {only[15.0, 0.38, 10]} and {only[15.0, 0.38, 5]} base radii at 15°",
        f"2 % at {only[8.0, 0.38, 2]} and {only[10.0, 0.38, 2]} base radii",
        f"that radius is {zones[15.0, 0.38, 10]} times the base radius, {zones[15.0, 0.5, 10]} in the widest box",
        f"of both span {ends.min():.1f} to {ends.max():.1f}, so",
        *(f"{end:.1f} (1 − b1)^½ = {end * (1 - 0.794) ** 0.5:.1f}" for end in (ends.min(), ends.max())),
        f"over all ratios it is {100 * findings.pooled_error():.1f} %",
        f"porosity, {mean('porosity'):.3f}. b1 from {b1[0]:.3f} to {b1[1]:.3f}",
        f"named soils have {min(named):.3f} to {max(named):.3f}",
    ]


def blades() -> list[str]:
    """Return what the page says of the blade in sand."""
    rows = compare.blade_table()[2:]
    missed = [float(row[4].split()[0]) for row in rows]
    published, clean = ([float(row[k].split()[0]) for row in rows[:2]] for k in (1, 2))
    assert all(abs(one - 2.0) < 0.1 for one in published)
    assert all(abs(one - 1.0) < 0.15 for one in clean)
    return [f"the other within {min(missed):.0f} to {max(missed):.0f} %", "The published cohesion is 1 kPa"]


def experiment() -> list[str]:
    """Return what problems/particles/README.md says of the box, of scatter and of what the experiment took."""
    rows, tests = (read_rows(HERE / f"{name}.csv") for name in ("particles", "triaxial"))
    drafts = {
        name: [float(row["draft"]) for row in rows if row["case"] == name] for name in {row["case"] for row in rows}
    }
    slender, blunt = (np.mean(drafts[f"wide-{angle}"]) / np.mean(drafts[f"cone-{angle}"]) for angle in (15, 35))
    ranges = {name: 100.0 * float(np.ptp(values) / np.mean(values)) for name, values in drafts.items()}
    assert max(ranges, key=ranges.__getitem__) == "wide-8"
    median = np.median([100.0 * float(row["standard_error"]) / float(row["draft"]) for row in rows])
    width = next(float(row["base_radius"]) for row in rows if row["case"] == "wide-8") / 0.01
    hours = sum(float(row["cpu"]) for row in (*rows, *tests)) / 3600.0
    return [
        f"15° draws {slender:.2f} and 35° {blunt:.2f} times the force",
        f"a standard error of {median:.0f} % in the median",
        f"range over {np.median([*ranges.values()]):.0f} % of their mean in the median",
        f"over {max(ranges.values()):.0f} % at worst: the cone of 8° in the box of 38 cm,"
        f" whose base is {width:.1f} spheres",
        f"The {len(rows) + len(tests)} tests and pulls took {hours:.1f} hours",
    ]


def sentences() -> list[str]:
    """Return the parts of all sentences of the page; what it says without a number is asserted on the way."""
    return [*trends(), *tools(), *levels(), *blades()]
