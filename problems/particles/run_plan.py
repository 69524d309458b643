"""Run the plan of experiments among particles and write a row per run to particles.csv and triaxial.csv.

    python problems/particles/run_plan.py [--list]

A run whose row is in the file is skipped, so that the same command continues after an interruption. Packings and
series of forces are kept in out/particles. README.md describes the experiment and the columns.
"""

import csv
import dataclasses
import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import plough_opt as po

HERE = Path(__file__).parent
PLAN = tomllib.loads((HERE / "plan.toml").read_text(encoding="utf-8"))
BAND_LENGTH = PLAN["common"]["band_length"]
CONE_SIDES = 12  # shear history is lost from facet to facet, so facets are few and large
CHISEL_ANGLE = math.radians(15.0)  # of the shares, as in the cotton problem
SHAFT = 0.783  # shaft over base diameter of the standard penetrometer: 15.88 mm over 20.27 mm
SHAFT_LENGTH = 0.3  # longer than any travel behind a penetrometer [m]
ENTRY = 0.015  # travel beyond the tool's length after which entry no longer shows in the force [m]
END_GAP = 0.125  # box less travel [m]: up to there, six diameters from the far wall, the force does not drift
ZONE_SHARES = (0.01, 0.02, 0.05, 0.1)  # displacement over base radius whose radii are reported
GROUPS = ("working", "underside", "flanks", "base", "shaft")  # of faces; the draft is that of the first two
PACKINGS = (1, 2, 3)  # seeds; a case counts when it was run in all of them
Array = NDArray[np.float64]
Faces = dict[str, list[list[tuple[float, float, float]]]]
Reference = dataclasses.make_dataclass(
    "Reference", [(k, type(v), dataclasses.field(default=v)) for k, v in PLAN["reference"].items()], frozen=True
)
UNIT = {name: unit for unit, names in PLAN["units"].items() for name in names.split()}
"""Unit of each column that has one."""


class Case(Reference):
    """A run: its name, its question, and every parameter that distinguishes it, by default the plan's reference."""

    @property
    def key(self) -> tuple[str, ...]:
        """The parameters as text, by which a row of the file is recognised."""
        return tuple(shown(value) for value in dataclasses.astuple(self)[2:])

    @property
    def base_radius(self) -> float:
        """Base radius of the cone, or of the cone that is equivalent to the tool [m]."""
        return self.height * math.tan(math.radians(self.half_angle))


def shown(value: object) -> str:
    """Return a value as it stands in the file, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# --- tools: their triangles by group [m]; the tip is at the origin and points along +x ---


def ring(x: float, radius: float) -> list[tuple[float, float, float]]:
    """Return the corners of a polygon at x whose area is that of the circle [m]."""
    step = 2.0 * math.pi / CONE_SIDES
    corner = radius * math.sqrt(step / math.sin(step))
    return [(x, corner * math.cos(a), corner * math.sin(a)) for a in ((i + 0.5) * step for i in range(CONE_SIDES))]


def cone_faces(case: Case) -> Faces:
    """Return a cone's faces, and those of a penetrometer's shaft."""
    h = case.height
    rim = ring(-h, case.base_radius)
    sides = list(zip(rim, rim[1:] + rim[:1], strict=True))
    faces: Faces = {"working": [[(0.0, 0.0, 0.0), a, b] for a, b in sides]}
    faces["base"] = [[(-h, 0.0, 0.0), a, b] for a, b in sides]
    if case.kind == "penetrometer":
        front, back = (ring(x, SHAFT * case.base_radius) for x in (-h, -h - SHAFT_LENGTH))
        strips = zip(front, front[1:] + front[:1], back, back[1:] + back[:1], strict=True)
        faces["shaft"] = [t for a, b, c, d in strips for t in ([a, b, c], [b, d, c])]
    return faces


def wedge_faces(case: Case) -> Faces:
    """Return a plane wedge of the cone's half angle, as wide as makes its surface and frontal area the cone's."""
    r, h = case.base_radius, case.height
    b = math.pi * r / 4.0
    edge, top, bottom = ([(x, -b, z), (x, b, z)] for x, z in ((0.0, 0.0), (-h, r), (-h, -r)))
    upper, lower = ([[*edge, back[0]], [edge[1], *back[::-1]]] for back in (top, bottom))
    rear, flanks = [[*top, bottom[0]], [top[1], *bottom[::-1]]], [[edge[i], top[i], bottom[i]] for i in (0, 1)]
    return {"working": upper + lower, "base": rear, "flanks": flanks}


def share_faces(case: Case) -> Faces:
    """Return the faces of the share whose equivalent cone has the case's half angle, by equations (5)-(7).

    They are two working faces and, if the underside is closed, that and the rear.
    """
    beta = math.radians(case.half_angle)
    angle = math.atan(math.pi * math.cos(CHISEL_ANGLE) ** 2 * math.tan(beta) / math.cos(beta))
    solid = po.Wedge(angle=angle, chisel_angle=CHISEL_ANGLE, height=case.height).mesh()
    centre = (solid.vertices[:, 2].max() + solid.vertices[:, 2].min()) / 2.0
    corners = [(-float(x), float(y), float(z - centre)) for x, y, z in solid.vertices]
    first, second, rear, underside = ([corners[i] for i in triangle] for triangle in solid.triangles)
    closed = {"underside": [underside], "base": [rear]} if case.kind == "closed_share" else {}
    return {"working": [first, second], **closed}


def faces_of(case: Case) -> Faces:
    """Return the faces of a tool."""
    shapes = {"wedge": wedge_faces, "open_share": share_faces, "closed_share": share_faces}
    return shapes.get(case.kind, cone_faces)(case)


# --- numbers from series ---


def standard_error(series: Array) -> float:
    """Return the standard error of the mean of a correlated series.

    The sum of the autocorrelations ends at the first lag above five times its result (Sokal 1997). A short series
    underestimates both its variance and its correlation time; the first is corrected.
    """
    x = series - series.mean()
    n = len(x)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[:n]
    sums = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    enough = np.arange(n) >= 5.0 * sums
    samples = max(1.0, float(sums[int(np.argmax(enough)) if enough.any() else n // 5]))
    share = min(samples / n, 0.5)
    return float(series.std() * math.sqrt(share / (1.0 - share)))


def zone_radii(before: Array, moved: Array, section: float, base: float, depth: float, end: float) -> list[float]:
    """Return the radii up to which soil was displaced by the shares ZONE_SHARES of the base radius [m].

    Args:
        before: positions of the spheres about the axis before the pull [m], shape (n, 3).
        moved: their displacements [m].
        section: x of the slab's centre, the base of the cone at the end [m].
        base: base radius [m]: the result if no soil is displaced so far.
        depth: diameter of the spheres: half the thickness of the slab and the width of the rings [m].
        end: half width of the box: the result if soil is displaced so far up to there [m].
    """
    slab = np.abs(before[:, 0] - section) < depth
    radius = np.hypot(before[slab, 1], before[slab, 2])
    outward = np.sum(moved[slab, 1:] * before[slab, 1:], axis=1) / radius
    centres = np.arange(base, end, depth / 2.0)
    rings = [outward[np.abs(radius - r) < depth / 2.0] for r in centres]
    profile = np.array([values.mean() if len(values) else 0.0 for values in rings]) / base

    def outermost(share: float) -> float:
        above = np.flatnonzero(profile >= share)
        last = int(above[-1]) if len(above) else -1
        if last in (-1, len(centres) - 1):
            return end if len(above) else base
        return float(np.interp(-share, -profile[last : last + 2], centres[last : last + 2]))

    return [outermost(share) for share in ZONE_SHARES]


def pull_numbers(case: Case, result: Any) -> dict[str, object]:
    """Return what a pull gives after the entry, over whole periods of the bands if there are any."""
    columns = dict(zip(result["columns"].tolist(), result["series"].T, strict=True))
    body = -min(x for name, group in faces_of(case).items() if name != "shaft" for t in group for x, _, _ in t)
    start, last = body + ENTRY, float(columns["travel"][-1])
    end = start + BAND_LENGTH * math.floor((last - start) / BAND_LENGTH) if case.bands else last
    steady = (columns["travel"] >= start) & (columns["travel"] <= end)
    draft, stretch = columns["mount"][steady], (columns["carriage"] - columns["travel"])[steady]
    place = (last - case.height, case.base_radius, case.diameter, result["half_width"].item())
    radii = zone_radii(result["before"], result["moved"], *place)
    return {
        "base_radius": case.base_radius, "path": end - start,
        "draft": draft.mean(), "scatter": draft.std(), "standard_error": standard_error(draft),
        **{group: columns[group][steady].mean() if group in columns else 0.0 for group in GROUPS},
        "deflection": stretch.mean(), "deflection_rms": stretch.std(),
        **{f"zone_{100 * s:g}": r for s, r in zip(ZONE_SHARES, radii, strict=True)},
        "carried": result["moved"][:, 0].max(),
    }  # fmt: skip


def triaxial_numbers(result: Any) -> dict[str, object]:
    """Return strength, compaction before dilation and stiffness; stresses are means of 5 samples, 0.8 % of strain."""
    axial, volumetric, stress, lateral = result["series"].T
    smooth = np.convolve(stress, np.ones(5) / 5.0, mode="valid")
    peak = int(smooth.argmax())
    half = int(np.argmax(stress - lateral >= (smooth[peak] - lateral.mean()) / 2.0))
    return {
        "axial_stress": smooth[peak], "peak_strain": axial[peak + 2], "residual_stress": stress[-5:].mean(),
        "compaction": volumetric.max(), "compaction_strain": axial[volumetric.argmax()],
        "final_volumetric": volumetric[-1], "stiffness_50": (stress - lateral)[half] / axial[half],
    }  # fmt: skip


# --- a run ---


def yade(task: dict[str, Any], output: Path) -> None:
    """Let experiment.py write its result; raise RuntimeError with the end of its messages if there is none."""
    file = output.with_suffix(".json")
    file.write_text(json.dumps({**task, "output": str(output)}), encoding="utf-8")
    command = ["yade", "-n", "-x", "-j1", str(HERE / "experiment.py"), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not output.exists():
        raise RuntimeError((done.stdout + done.stderr)[-2000:])


def run(case: Case, folder: Path = HERE.parents[1] / "out" / "particles") -> dict[str, object]:
    """Run a case in YADE, its packing first if there is none, and return its row."""
    folder.mkdir(parents=True, exist_ok=True)
    output = folder / f"{case.case}_{case.seed}.npz"
    output.unlink(missing_ok=True)
    size = "_".join(f"{x:g}" for x in (case.diameter, case.width, case.length, case.seed))
    packing = folder / f"packing_{size}.txt"
    task = {**dataclasses.asdict(case), **PLAN["common"], "packing": str(packing), "travel": case.length - END_GAP}
    mount = {**PLAN["mount"], "release": case.height + ENTRY, "stiffness": case.stiffness}
    task |= {"mount": mount if case.stiffness else {}, "bands": PLAN["bands"] if case.bands else {}}
    if not packing.exists():
        made = packing.with_suffix(".part")
        yade({**task, **PLAN["packing"], "kind": "packing"}, made)
        made.replace(packing)
    task |= PLAN["triaxial"] if case.kind == "triaxial" else {"kind": "pull", "faces": faces_of(case)}
    yade(task, output)
    with np.load(output) as result:
        found = triaxial_numbers(result) if case.kind == "triaxial" else pull_numbers(case, result)
        found |= {name: result[name].item() for name in ("spheres", "porosity", "steps", "time_step", "yade", "cpu")}
    return {**dataclasses.asdict(case), **found}


# --- plan and files ---


def series() -> list[tuple[dict[str, str], list[Case]]]:
    """Return the series of plan.toml: question -> fields that differ in the case with which one is compared."""
    found = []
    for one in PLAN["series"]:
        given = {key: value for key, value in one.items() if key not in ("name", "over")}
        varied = {key: values for key, values in given.items() if isinstance(values, list)}
        every = [{**given, **dict(zip(varied, values, strict=True))} for values in zip(*varied.values(), strict=True)]
        cases = [Case(case=f"{one['name']}-{fields[next(iter(varied))]:g}", **fields) for fields in every]
        found.append((one.get("over", {one["question"]: " ".join(varied)}), cases))
    return found


def plan() -> list[Case]:
    """Return the runs of plan.toml in order, each case in all packings before the next."""
    return [dataclasses.replace(case, seed=seed) for _, cases in series() for case in cases for seed in PACKINGS]


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file, by column name without its unit; none if the file does not exist."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    header, *rows = csv.reader([line for line in lines if not line.startswith("#")] or [""])
    return [dict(zip((column.split(" [")[0] for column in header), row, strict=True)) for row in rows]


def key_of(row: dict[str, str]) -> tuple[str, ...]:
    """Return the parameters of a row, as in `Case.key`."""
    return tuple(row[field.name] for field in dataclasses.fields(Case)[2:])


def append_row(path: Path, row: dict[str, object]) -> None:
    """Append a row to a file, which begins with the headings."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        if new:
            file.write("# Written by run_plan.py; README.md describes the columns.\n")
            table.writerow(f"{name} [{UNIT[name]}]" if name in UNIT else name for name in row)
        table.writerow(map(shown, row.values()))


def main(arguments: list[str], folder: Path = HERE) -> None:
    """Run what the files in the folder do not hold yet; a run that fails is reported and left out."""
    present = {key_of(row) for name in ("particles", "triaxial") for row in read_rows(folder / f"{name}.csv")}
    for case in [one for one in plan() if one.key not in present]:
        print(case.case, "packing", case.seed, flush=True)
        try:
            if "--list" not in arguments:
                append_row(folder / f"{'triaxial' if case.kind == 'triaxial' else 'particles'}.csv", run(case))
        except RuntimeError as error:
            print("FAILED:", error, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
