"""Run an experiment among particles in YADE: pack spheres, test a packing in a triaxial cell, or pull a tool.

    yade -n -x -j1 experiment.py case.json

run_plan.py writes such files; README.md describes the experiment. SI units; the tool travels along x.
"""

import itertools
import json
import math
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from yade import Omega, config, pack, utils
from yade import wrapper as yd
from yade.minieigenHP import Vector3

O = Omega()  # noqa: E741 - YADE's name of the simulation, which its scripts and its documentation share
WALLS = range(6)  # ids of the six walls, which are made first: -x, +x, -y, +y, -z, +z
DRAFT = ("working", "underside")  # groups of faces whose force is the draft, which the mount carries


def add_materials(case: dict[str, Any]) -> None:
    """Add soil, walls and tool; of two angles of friction a contact has the smaller; only soil is cohesive.

    With bands, the soil's cohesion and tangent of friction are scaled in "strong" and "weak".
    """
    elastic = {name: case[name] for name in ("young", "poisson", "density")}
    rolling, limit = case["rolling_stiffness"], case["rolling_limit"]
    moment = {"alphaKr": rolling, "alphaKtw": rolling, "etaRoll": limit, "etaTwist": limit, "momentRotationLaw": True}
    for name, scale in {"soil": 1.0, **case["bands"]}.items():
        cohesion = scale * case["cohesion"]  # adhesion of a contact is this times the square of the smaller radius
        angle = math.atan(scale * math.tan(math.radians(case["friction"])))
        bond = {"isCohesive": True, "normalCohesion": cohesion, "shearCohesion": cohesion, "fragile": False}
        O.materials.append(yd.CohFrictMat(frictionAngle=angle, label=name, **elastic, **moment, **bond))
    for name in ("side", "tool"):
        angle = math.atan(case[f"{name}_friction"])
        O.materials.append(yd.CohFrictMat(frictionAngle=angle, label=name, isCohesive=False, **elastic))


def engines(case: dict[str, Any], smallest: float) -> tuple[Any, Any, Any]:
    """Set YADE's loop and time step; return the walls' servo, the integrator and the contacts' physics.

    Args:
        case: with the pressure that the servo keeps on all six walls.
        smallest: smallest radius of a sphere [m].
    """
    goal = -case["pressure"]
    servo = yd.TriaxialStressController(
        thickness=0, stressMask=7, internalCompaction=False, goal1=goal, goal2=goal, goal3=goal,
        max_vel=case["wall_speed"], stiffnessUpdateInterval=10, computeStressStrainInterval=10,
    )  # fmt: skip
    newton = yd.NewtonIntegrator(damping=case["settling_damping"], gravity=(0, 0, 0))
    physics = yd.Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionOnNewContacts=False, setCohesionNow=False)
    boxes = [yd.Bo1_Sphere_Aabb(), yd.Bo1_Box_Aabb(), yd.Bo1_Facet_Aabb()]
    contacts = [yd.Ig2_Sphere_Sphere_ScGeom6D(), yd.Ig2_Box_Sphere_ScGeom6D(), yd.Ig2_Facet_Sphere_ScGeom6D()]
    law = yd.Law2_ScGeom6D_CohFrictPhys_CohesionMoment(always_use_moment_law=True, useIncrementalForm=True)
    search = yd.InsertionSortCollider(boxes, verletDist=case["verlet"] * smallest)
    O.engines = [yd.ForceResetter(), search, yd.InteractionLoop(contacts, [physics], [law]), servo, newton]
    O.dt = case["dt_factor"] * smallest * math.sqrt(case["density"] / case["young"])
    return servo, newton, physics


def wall_pressures(servo: Any) -> list[float]:
    """Return the normal pressures on the six walls [Pa]."""
    return [abs(servo.stress(i)[i // 2]) for i in WALLS]


def box() -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box now [m]."""
    ends = np.array([O.bodies[i].state.pos[i // 2] for i in WALLS])
    return ends[::2], ends[1::2]


def settle(case: dict[str, Any], spheres: Any, corners: Any) -> tuple[Any, Any, Any]:
    """Fill a box with spheres and run until they are at rest under the case's pressure; return as `engines` does.

    Args:
        case: the case.
        spheres: centres and radii [m], shape (n, 4).
        corners: the lower and the upper corner of the box [m].
    """
    add_materials(case)
    ends = [Vector3(*corners[:3]), Vector3(*corners[3:])]
    O.bodies.append(utils.aabbWalls(ends, thickness=0.0, oversizeFactor=2.0, material="side"))
    for x, y, z, radius in spheres:
        strong = case["bands"] and (x / case["band_length"]) % 1.0 < 0.5
        material = "soil" if not case["bands"] else "strong" if strong else "weak"
        O.bodies.append(utils.sphere((x, y, z), radius, material=material))
    found = engines(case, float(min(radius for *_, radius in spheres)))
    while O.iter < case["most"]:
        O.run(case["chunk"], True)
        error = max(abs(p / case["pressure"] - 1.0) for p in wall_pressures(found[0]))
        if utils.unbalancedForce() < case["rest"] and error < case["pressure_error"]:
            return found
    raise RuntimeError(f"the packing is not at rest after {O.iter} steps")


def make_packing(case: dict[str, Any]) -> dict[str, Any]:
    """Compress a random cloud of spheres, sizes d (1 -+ spread), without cohesion, and write it as text."""
    spread, diameter = case["spread"], case["diameter"]
    size = np.array([case["length"], case["width"], case["width"]])
    # The mean volume of spheres with uniformly distributed radii is pi/6 d^3 (1 + spread^2).
    count = int(case["dense"] * size.prod() / (math.pi / 6.0 * diameter**3 * (1.0 + spread**2)))
    loose = size * (case["dense"] / case["loose"]) ** (1.0 / 3.0)
    cloud = pack.SpherePack()
    cloud.makeCloud((0, 0, 0), tuple(loose), rMean=diameter / 2.0, rRelFuzz=spread, num=count, seed=case["seed"])
    settle(case, [(*centre, radius) for centre, radius in cloud], (0, 0, 0, *loose))
    rows = [(*b.state.pos, b.shape.radius) for b in O.bodies if isinstance(b.shape, yd.Sphere)]
    corners = " ".join(repr(float(x)) for corner in box() for x in corner)
    np.savetxt(case["output"], rows, fmt="%.12g", header=corners)
    return {}


def load_packing(case: dict[str, Any]) -> tuple[Any, range, dict[str, Any]]:
    """Settle and bond a packing at the case's pressure; return the servo, the spheres' ids, number and porosity."""
    with Path(case["packing"]).open(encoding="utf-8") as file:
        corners = [float(x) for x in file.readline().lstrip("#").split()]
        spheres = np.loadtxt(file)
    servo, newton, physics = settle(case, spheres, corners)
    # YADE bonds the contacts that exist in the next step; contacts made later in loosened soil stay without cohesion
    # unless the soil heals.
    physics.setCohesionNow, physics.setCohesionOnNewContacts = True, bool(case["heals"])
    newton.damping = case["damping"]
    empty = 1.0 - 4.0 / 3.0 * math.pi * np.sum(spheres[:, 3] ** 3) / abs(np.prod(np.subtract(*box())))
    return servo, range(len(WALLS), len(O.bodies)), {"spheres": len(spheres), "porosity": empty}


def triaxial(case: dict[str, Any]) -> dict[str, Any]:
    """Compress a packing along x at constant lateral pressure; strains are logarithmic, compression positive."""
    servo, _, facts = load_packing(case)
    start = np.subtract(*box()[::-1])
    servo.stressMask, servo.goal1, servo.max_vel = 6, -case["strain_rate"], case["compression_speed"]
    rows: list[tuple[float, ...]] = []
    while not rows or rows[-1][0] < case["largest_strain"]:
        O.run(25, True)
        strains = np.log(start / np.subtract(*box()[::-1]))
        pressures = wall_pressures(servo)
        rows.append((strains[0], strains.sum(), np.mean(pressures[:2]), np.mean(pressures[2:])))
    return {**facts, "series": np.array(rows), "columns": ["axial", "volumetric", "axial_stress", "lateral_stress"]}


@dataclass
class Tool:
    """The tool during a pull: groups of facets, its travel, and the carriage that draws it through the mount.

    Attributes:
        groups: name of a group of faces -> ids of its facets; the mount carries those of DRAFT.
        speed: of the carriage [m/s].
        mount: stiffness [N/m], damping [N s/m], mass [kg] and the travel [m] at which it is released; empty if rigid.
        mount_force: None before the release [N].
    """

    groups: dict[str, list[int]]
    speed: float
    mount: dict[str, float]
    travel: float = 0.0
    velocity: float = 0.0
    carriage: float = 0.0
    mount_force: float | None = None
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def drag(self, *names: str) -> float:
        """Return the force against travel on groups of faces [N]."""
        return -sum(O.forces.f(i, True)[0] for name in names for i in self.groups.get(name, ()))

    def set_velocity(self, velocity: float) -> None:
        """Let all facets travel at this speed [m/s]."""
        self.velocity = velocity
        for i in itertools.chain(*self.groups.values()):
            O.bodies[i].state.vel = (velocity, 0, 0)

    def step(self) -> None:
        """Advance travel and mount by a time step, after the forces of the step are known."""
        if self.mount and self.mount_force is None and self.travel > self.mount["release"]:
            force = [row[3] for row in self.rows if row[1] > self.mount["release"] - self.mount["preload_path"]]
            self.carriage = self.travel + float(np.mean(force)) / self.mount["stiffness"]
            self.mount_force = 0.0
        if self.mount_force is not None:
            stretch, closing = self.carriage - self.travel, self.speed - self.velocity
            self.mount_force = self.mount["stiffness"] * stretch + self.mount["damping"] * closing
            self.set_velocity(self.velocity + O.dt * (self.mount_force - self.drag(*DRAFT)) / self.mount["mass"])
        self.travel += self.velocity * O.dt
        self.carriage += self.speed * O.dt

    def record(self) -> None:
        """Store time, travels, mount force and the forces on the groups of faces."""
        mount = self.drag(*DRAFT) if self.mount_force is None else self.mount_force
        self.rows.append((O.time, self.travel, self.carriage, mount, *map(self.drag, self.groups)))


def pull(case: dict[str, Any]) -> dict[str, Any]:
    """Pull the tool through a packing whose side walls keep their pressure and whose end walls stand still."""
    servo, ids, facts = load_packing(case)
    low, high = box()
    entry = np.array([low[0], (low[1] + high[1]) / 2.0, (low[2] + high[2]) / 2.0])
    global tool  # YADE's PyRunner reaches it by name
    groups = {}
    for name, triangles in case["faces"].items():
        corners = [[Vector3(*(entry + corner)) for corner in triangle] for triangle in triangles]
        groups[name] = O.bodies.append([utils.facet(c, dynamic=False, material="tool") for c in corners])
    facts["half_width"] = float(high[1] - low[1]) / 2.0
    before = np.array([O.bodies[i].state.pos for i in ids]) - entry
    servo.wall_left_activated = servo.wall_right_activated = False
    for i in WALLS[:2]:
        O.bodies[i].state.vel = (0, 0, 0)
    tool = Tool(groups, case["speed"], case["mount"])
    tool.set_velocity(case["speed"])
    every = max(1, round(case["sample"] / (case["speed"] * O.dt)))
    calls = {"tool.step()": 1, "tool.record()": every}
    O.engines += [yd.PyRunner(command=command, iterPeriod=period) for command, period in calls.items()]
    # A soft mount lags behind its carriage: as many steps again are allowed until the tool has covered the travel.
    last = O.iter + 2 * int(case["travel"] / (case["speed"] * O.dt))
    while tool.travel < case["travel"]:
        if O.iter > last:
            raise RuntimeError(f"the tool has covered {tool.travel:.3f} m of {case['travel']} m")
        O.run(50, True)
    moved = np.array([O.bodies[i].state.pos for i in ids]) - entry - before
    columns = ["time", "travel", "carriage", "mount", *groups]
    return {**facts, "series": np.array(tool.rows), "columns": columns, "before": before, "moved": moved}


if __name__ == "__main__":
    this_case = json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8"))
    result = {"packing": make_packing, "triaxial": triaxial, "pull": pull}[this_case["kind"]](this_case)
    if result:
        result |= {"steps": O.iter, "time_step": O.dt, "yade": config.version, "cpu": time.process_time()}
        np.savez(this_case["output"], **result)
