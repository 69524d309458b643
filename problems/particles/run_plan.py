"""Run the plan of experiments among particles and write a row per run to particles.csv and triaxial.csv.

    python problems/particles/run_plan.py [--list]

A run whose row is in the file is skipped, so that the same command continues after an interruption. Packings and
series of forces are kept in out/particles. README.md describes the experiment and the columns.
"""

import csv
import dataclasses
import io
import json
import math
import resource
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import plough_opt as po
from plough_opt.core.files import write_file

HERE = Path(__file__).parent
OUT = HERE.parents[1] / "out" / "particles"
# Packings are compressed at one pressure, whatever that of a test; sizes are uniform within the spread. The stiffness
# is 400 times the pressure: overlaps of 0.25 % of a diameter.
MATERIAL = {"packing_pressure": 50e3, "spread": 0.3, "young": 20e6, "poisson": 0.3, "density": 2600.0}
CONE_SIDES = 12  # shear history is lost from facet to facet, so facets are few and large
CHISEL_ANGLE = math.radians(15.0)  # of the shares, as in the cotton problem
SHAFT = 0.783  # shaft over base diameter of the standard penetrometer: 15.88 mm over 20.27 mm
SHAFT_LENGTH = 0.3  # longer than any travel behind a penetrometer [m]
ENTRY = 0.015  # travel beyond the tool's length after which entry no longer shows in the force [m]
END_GAP = 0.125  # box less travel [m]: up to there, six diameters from the far wall, the force does not drift
BANDS, BAND_LENGTH = {"strong": 1.4, "weak": 0.6}, 0.11  # strength and period [m] of the bands of a sprung pull
# Mount [kg], [N s/m]: damping ratio 0.18 at resonance with the bands, 130 kN/m.
MOUNT = {"mass": 10.0, "damping": 400.0}
ZONE_SHARES = (0.01, 0.02, 0.05, 0.1)  # displacement over base radius whose radii are reported
GROUPS = ("working", "underside", "flanks", "base", "shaft")  # of faces; the draft is that of the first two
PACKINGS = (1, 2, 3)  # seeds; a case counts when it was run in all of them
LONGEST_RUN = 3 * 3600.0  # after which YADE is stopped [s]
Array = NDArray[np.float64]
Faces = dict[str, list[list[tuple[float, float, float]]]]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A run: its name and question, and every parameter that distinguishes it.

    Attributes:
        case: name, shared by all packings.
        question: what it is to show.
        kind: cone, wedge, open_share, closed_share, penetrometer or triaxial.
        half_angle: of the cone or of the equivalent cone [deg].
        height: of the tool [m].
        pressure: around the packing [Pa].
        cohesion: adhesion of a contact over the square of its smaller radius [Pa].
        friction: angle of friction between particles [deg].
        heals: 1 if contacts that are made during the test are cohesive too.
        bands: 1 if bands of strong and weak soil alternate along the path.
        tool_friction: coefficient [-].
        speed: [m/s].
        stiffness: of the mount [N/m]; 0 is rigid.
        diameter: mean diameter of the spheres [m].
        width: of the square box [m].
        length: of the box [m].
        side_friction: coefficient of the box's walls [-].
        damping: local damping of YADE [-].
        dt_factor: time step over that in which a P wave crosses the smallest radius [-].
        seed: of the packing.
    """

    case: str
    question: str
    kind: str = "cone"
    half_angle: float = 15.0
    height: float = 0.1
    pressure: float = 50e3
    cohesion: float = 100e3
    friction: float = 30.0
    heals: int = 0
    bands: int = 0
    tool_friction: float = 0.4
    speed: float = 2.0
    stiffness: float = 0.0
    diameter: float = 0.02
    width: float = 0.28
    length: float = 0.36
    side_friction: float = 0.5
    damping: float = 0.2
    dt_factor: float = 0.8
    seed: int = 1

    @property
    def key(self) -> tuple[str, ...]:
        """The parameters as text, by which a row of the file is recognised."""
        return tuple(shown(value) for value in dataclasses.astuple(self)[2:])

    @property
    def base_radius(self) -> float:
        """Base radius of the cone, or of the cone that is equivalent to the tool [m]."""
        return self.height * math.tan(math.radians(self.half_angle))


UNITS = {
    "deg": "half_angle friction",
    "Pa": "pressure cohesion axial_stress residual_stress stiffness_50",
    "m": "height base_radius diameter width length path deflection deflection_rms zone_1 zone_2 zone_5 zone_10",
    "N": "draft scatter standard_error working underside flanks base shaft",
    "m/s": "speed",
    "N/m": "stiffness",
    "s": "time_step cpu",
}
UNIT = {name: unit for unit, names in UNITS.items() for name in names.split()}
"""Unit of each column that has one."""


def shown(value: object) -> str:
    """Return a value as it stands in the file, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# --- tools: their triangles by group [m]; the tip is at the origin and points along +x ---


def ring(x: float, radius: float) -> list[tuple[float, float, float]]:
    """Return the corners of a polygon at x whose area is that of the circle [m]."""
    step = 2.0 * math.pi / CONE_SIDES
    corner = radius * math.sqrt(step / math.sin(step))
    angles = [(i + 0.5) * step for i in range(CONE_SIDES)]
    return [(x, corner * math.cos(a), corner * math.sin(a)) for a in angles]


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
    if correlation[0] <= 0.0:
        return 0.0
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


def description(case: Case, output: Path) -> dict[str, Any]:
    """Return the content of the file that experiment.py reads: the case, the tool, and what all runs have in common."""
    size = "_".join(f"{x:g}" for x in (case.diameter, case.width, case.length, case.seed))
    task = {**dataclasses.asdict(case), **MATERIAL, "output": str(output), "travel": case.length - END_GAP}
    task |= {
        "packing": str(output.parent / f"packing_{size}.txt"),
        "bands": BANDS if case.bands else {},
        "band_length": BAND_LENGTH,
    }
    if case.kind == "triaxial":
        return task
    task["mount"] = {**MOUNT, "stiffness": case.stiffness, "release": case.height + ENTRY} if case.stiffness else {}
    return {**task, "kind": "pull", "faces": faces_of(case)}


def yade(case: dict[str, Any]) -> None:
    """Run experiment.py; raise RuntimeError with the end of its messages if there is no result."""
    output = Path(case["output"])
    file = output.with_suffix(".json")
    file.write_text(json.dumps(case), encoding="utf-8")
    command = ["yade", "-n", "-x", "-j1", str(HERE / "experiment.py"), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LONGEST_RUN)
    if done.returncode != 0 or not output.exists():
        raise RuntimeError((done.stdout + done.stderr)[-2000:])


def run(case: Case, folder: Path = OUT) -> dict[str, object]:
    """Run a case in YADE, its packing first if there is none, and return its row."""
    folder.mkdir(parents=True, exist_ok=True)
    output = folder / f"{case.case}_{case.seed}.npz"
    output.unlink(missing_ok=True)
    task = description(case, output)
    packing = Path(task["packing"])
    if not packing.exists():
        made = packing.with_suffix(".part")
        yade({**task, "kind": "packing", "output": str(made), "dt_factor": Case.dt_factor})
        made.replace(packing)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    yade(task)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    with np.load(output) as result:
        found = triaxial_numbers(result) if case.kind == "triaxial" else pull_numbers(case, result)
        found |= {name: result[name].item() for name in ("spheres", "porosity", "steps", "time_step", "yade")}
    return {**dataclasses.asdict(case), **found, "cpu": round(spent, 1)}


# --- plan and files ---


def series() -> list[tuple[dict[str, str], list[Case]]]:
    """Return the series of plan.toml: question -> fields that differ in the case with which one is compared."""
    found = []
    for one in tomllib.loads((HERE / "plan.toml").read_text(encoding="utf-8"))["series"]:
        name, over = one.pop("name"), one.pop("over", None)
        varied = {key: values for key, values in one.items() if isinstance(values, list)}
        every = [{**one, **dict(zip(varied, values, strict=True))} for values in zip(*varied.values(), strict=True)]
        cases = [Case(case=f"{name}-{fields[next(iter(varied))]:g}", **fields) for fields in every]
        found.append(({one["question"]: " ".join(varied)} if over is None else over, cases))
    return found


def plan() -> list[Case]:
    """Return the runs of plan.toml in order, each case in all packings before the next."""
    return [dataclasses.replace(case, seed=seed) for _, cases in series() for case in cases for seed in PACKINGS]


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file, by column name without its unit; none if the file does not exist."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(line for line in file if not line.startswith("#"))
    return [dict(zip((column.split(" [")[0] for column in header), row, strict=True)) for row in rows]


def key_of(row: dict[str, str]) -> tuple[str, ...]:
    """Return the parameters of a row, as in `Case.key`."""
    return tuple(row[field.name] for field in dataclasses.fields(Case)[2:])


def append_row(path: Path, row: dict[str, object]) -> None:
    """Write the file anew with another row, whole or not at all."""
    rows = [*read_rows(path), {name: shown(value) for name, value in row.items()}]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([f"{name} [{UNIT[name]}]" if name in UNIT else name for name in row])
    table.writerows([one[name] for name in row] for one in rows)
    write_file(
        path, "a table of runs", f"# Written by run_plan.py; README.md describes the columns.\n{text.getvalue()}"
    )


def main(arguments: list[str], folder: Path = HERE) -> None:
    """Run what the files in the folder do not hold yet; a run that fails is reported and left out."""
    files = {kind: folder / f"{kind}.csv" for kind in ("particles", "triaxial")}
    present = {key_of(row) for path in files.values() for row in read_rows(path)}
    for case in plan():
        if case.key in present:
            continue
        label, row = f"{time.strftime('%H:%M:%S')} {case.case} packing {case.seed}", {}
        try:
            row = {} if "--list" in arguments else run(case)
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            label += f" FAILED: {error}"
        if row:
            append_row(files["triaxial" if case.kind == "triaxial" else "particles"], row)
        figures = {key: shown(row[key]) for key in ("draft", "axial_stress", "cpu") if key in row}
        print(label, figures or "", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
