"""Run an experiment among particles in YADE: pack spheres, test a packing in a triaxial cell, or pull a tool.

    yade -n -x -j1 experiment.py case.json

run_plan.py writes such files; README.md describes the experiment. SI units; the tool travels along x.
"""

import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from yade import Omega, config, pack, utils
from yade import wrapper as yd
from yade.minieigenHP import Vector3

O = Omega()  # noqa: E741 - YADE's name of the simulation, which its scripts and its documentation share
WALLS = range(6)  # ids of the six walls, which are made first: -x, +x, -y, +y, -z, +z
LOOSE = 0.36  # volume fraction of the cloud of spheres from which a packing is compressed
DENSE = 0.585  # volume fraction from which the number of spheres in a box is estimated
PACKING_FRICTION = math.radians(15.0)  # between spheres during compression: it sets the porosity
SETTLING_DAMPING = 0.4  # share of the unbalanced force that YADE's local damping removes before a test
REST = 0.004  # mean unbalanced force over mean contact force below which a packing is at rest
PRESSURE_ERROR = 0.02  # relative difference from the servo's pressure that is accepted at rest
ROLLING_STIFFNESS = 2.0  # rolling stiffness over k_s R^2
ROLLING_LIMIT = 0.15  # largest rolling moment over normal force times radius: angular grains
SIDE_FRICTION = 0.5  # of the box's walls during a pull, whose soil is part of a wider field
WALL_SPEED = 0.5  # largest speed of a servo-controlled wall [m/s]
PACKING_SPEED = 1.0  # the same while the cloud is compressed [m/s]
VERLET = 0.15  # margin of the collision search over the smallest radius: fastest in trials
STRAIN_RATE = 1.0  # of the triaxial test [1/s]: inertial number 0.005 at 50 kPa, nearly static
LARGEST_STRAIN = 0.25  # axial strain at which it ends; at 200 kPa packings compact and harden beyond 0.12
PRELOAD_PATH = 0.02  # travel before the release over which the mount's preload is averaged [m]
DRAFT = ("working", "underside")  # groups of faces whose force is the draft, which the mount carries
SAMPLE = 5e-4  # travel between samples of the force [m]


def add_materials(case: dict[str, Any], friction: float, side_friction: float) -> None:
    """Add soil, walls and tool; of two angles of friction [rad] a contact has the smaller; only soil is cohesive.

    With bands, the soil's cohesion and tangent of friction are scaled in "strong" and "weak".
    """
    elastic = {name: case[name] for name in ("young", "poisson", "density")}
    for name, scale in {"soil": 1.0, **case["bands"]}.items():
        cohesion = scale * case["cohesion"]  # adhesion of a contact is this times the square of the smaller radius
        angle = math.atan(scale * math.tan(friction))
        moment = {"momentRotationLaw": True, "alphaKr": ROLLING_STIFFNESS, "alphaKtw": ROLLING_STIFFNESS}
        moment |= {"etaRoll": ROLLING_LIMIT, "etaTwist": ROLLING_LIMIT}
        bond = {"isCohesive": True, "normalCohesion": cohesion, "shearCohesion": cohesion, "fragile": False}
        O.materials.append(yd.CohFrictMat(frictionAngle=angle, label=name, **elastic, **moment, **bond))
    smooth = {"isCohesive": False, "momentRotationLaw": False}
    O.materials.append(yd.CohFrictMat(frictionAngle=math.atan(side_friction), label="wall", **elastic, **smooth))
    tool_angle = math.atan(case["tool_friction"])
    O.materials.append(yd.CohFrictMat(frictionAngle=tool_angle, label="tool", **elastic, **smooth))


def add_walls(low: Any, high: Any) -> None:
    """Add the box between two corners [m]."""
    O.bodies.append(
        utils.aabbWalls([Vector3(*low), Vector3(*high)], thickness=0.0, oversizeFactor=2.0, material="wall")
    )


def engines(pressure: float, wall_speed: float, smallest: float, dt_factor: float) -> tuple[Any, Any, Any]:
    """Set YADE's loop and time step; return the walls' servo, the integrator and the contacts' physics.

    Args:
        pressure: which the servo keeps on all six walls [Pa].
        wall_speed: the largest speed of a wall [m/s].
        smallest: smallest radius of a sphere [m].
        dt_factor: time step over that in which a P wave crosses the smallest radius.
    """
    servo = yd.TriaxialStressController(
        thickness=0, stressMask=7, internalCompaction=False, goal1=-pressure, goal2=-pressure, goal3=-pressure,
        max_vel=wall_speed, stiffnessUpdateInterval=10, computeStressStrainInterval=10,
    )  # fmt: skip
    newton = yd.NewtonIntegrator(damping=SETTLING_DAMPING, gravity=(0, 0, 0))
    physics = yd.Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionOnNewContacts=False, setCohesionNow=False)
    boxes = [yd.Bo1_Sphere_Aabb(), yd.Bo1_Box_Aabb(), yd.Bo1_Facet_Aabb()]
    contacts = [yd.Ig2_Sphere_Sphere_ScGeom6D(), yd.Ig2_Box_Sphere_ScGeom6D(), yd.Ig2_Facet_Sphere_ScGeom6D()]
    law = yd.Law2_ScGeom6D_CohFrictPhys_CohesionMoment(always_use_moment_law=True, useIncrementalForm=True)
    O.engines = [
        yd.ForceResetter(),
        yd.InsertionSortCollider(boxes, verletDist=VERLET * smallest),
        yd.InteractionLoop(contacts, [physics], [law]),
        servo,
        newton,
    ]
    material = O.materials["soil"]
    O.dt = dt_factor * smallest * math.sqrt(material.density / material.young)
    return servo, newton, physics


def wall_pressures(servo: Any) -> list[float]:
    """Return the normal pressures on the six walls [Pa]."""
    return [abs(servo.stress(i)[i // 2]) for i in WALLS]


def box() -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box now [m]."""
    ends = np.array([O.bodies[i].state.pos[i // 2] for i in WALLS])
    return ends[::2], ends[1::2]


def settle(servo: Any, pressure: float, chunk: int, most: int) -> None:
    """Run chunks of steps until the packing is at rest under the pressure [Pa]; raise RuntimeError after the most."""
    while O.iter < most:
        O.run(chunk, True)
        error = max(abs(p - pressure) for p in wall_pressures(servo)) / pressure
        if utils.unbalancedForce() < REST and error < PRESSURE_ERROR:
            return
    raise RuntimeError(f"the packing is not at rest after {most} steps")


def make_packing(case: dict[str, Any]) -> dict[str, Any]:
    """Compress a random cloud of spheres, sizes d (1 -+ spread), without cohesion, and write it as text."""
    spread, diameter = case["spread"], case["diameter"]
    size = np.array([case["length"], case["width"], case["width"]])
    mean_volume = math.pi / 6.0 * diameter**3 * (1.0 + spread**2)  # of uniformly distributed radii
    count = int(DENSE * size.prod() / mean_volume)
    loose = size * (DENSE / LOOSE) ** (1.0 / 3.0)
    add_materials(case, PACKING_FRICTION, 0.0)
    add_walls((0, 0, 0), loose)
    cloud = pack.SpherePack()
    cloud.makeCloud((0, 0, 0), tuple(loose), rMean=diameter / 2.0, rRelFuzz=spread, num=count, seed=case["seed"])
    O.bodies.append([utils.sphere(centre, radius, material="soil") for centre, radius in cloud])
    smallest = min(radius for _, radius in cloud)
    servo, _, _ = engines(case["packing_pressure"], PACKING_SPEED, smallest, case["dt_factor"])
    settle(servo, case["packing_pressure"], 500, 30_000)
    spheres = [b for b in O.bodies if isinstance(b.shape, yd.Sphere)]
    rows = [(*b.state.pos, b.shape.radius) for b in spheres]
    corners = " ".join(repr(float(x)) for corner in box() for x in corner)
    np.savetxt(case["output"], rows, fmt="%.12g", header=corners)
    return {}


def load_packing(case: dict[str, Any], side_friction: float) -> tuple[Any, Any, range]:
    """Settle and bond a packing at the case's pressure; return the servo, the integrator and the spheres' ids."""
    with Path(case["packing"]).open(encoding="utf-8") as file:
        corners = [float(x) for x in file.readline().lstrip("#").split()]
        spheres = np.loadtxt(file)
    add_materials(case, math.radians(case["friction"]), side_friction)
    add_walls(corners[:3], corners[3:])
    first = len(O.bodies)
    for x, y, z, radius in spheres:
        material = "soil"
        if case["bands"]:
            material = "strong" if (x / case["band_length"]) % 1.0 < 0.5 else "weak"
        O.bodies.append(utils.sphere((x, y, z), radius, material=material))
    smallest = float(spheres[:, 3].min())
    servo, newton, physics = engines(case["pressure"], WALL_SPEED, smallest, case["dt_factor"])
    settle(servo, case["pressure"], 100, 6_000)
    # YADE bonds the contacts that exist in the next step; contacts made later in loosened soil stay without cohesion
    # unless the soil heals.
    physics.setCohesionNow, physics.setCohesionOnNewContacts = True, bool(case["heals"])
    newton.damping = case["damping"]
    return servo, newton, range(first, len(O.bodies))


def porosity(ids: range) -> float:
    """Return the share of the box that the spheres leave empty [-]."""
    low, high = box()
    solid = sum(4.0 / 3.0 * math.pi * O.bodies[i].shape.radius ** 3 for i in ids)
    return 1.0 - solid / float(np.prod(high - low))


def triaxial(case: dict[str, Any]) -> dict[str, Any]:
    """Compress a packing along x at constant lateral pressure; strains are logarithmic, compression positive."""
    servo, _, ids = load_packing(case, 0.0)
    facts = {"spheres": len(ids), "porosity": porosity(ids)}
    start = np.subtract(*box()[::-1])
    servo.stressMask, servo.goal1, servo.max_vel = 6, -STRAIN_RATE, PACKING_SPEED
    rows: list[tuple[float, ...]] = []
    while not rows or rows[-1][0] < LARGEST_STRAIN:
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
    """

    groups: dict[str, list[int]]
    speed: float
    mount: dict[str, float]
    travel: float = 0.0
    velocity: float = 0.0
    carriage: float = 0.0
    mount_force: float = 0.0
    released: bool = False
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def drag(self, name: str, sync: bool) -> float:
        """Return the force against travel on a group of faces [N]."""
        return -sum(O.forces.f(i, sync)[0] for i in self.groups[name])

    def draft(self, sync: bool) -> float:
        """Return the force against travel on the faces that displace soil [N]."""
        return sum(self.drag(name, sync) for name in self.groups if name in DRAFT)

    def set_velocity(self, velocity: float) -> None:
        """Let all facets travel at this speed [m/s]."""
        self.velocity = velocity
        for ids in self.groups.values():
            for i in ids:
                O.bodies[i].state.vel = (velocity, 0, 0)

    def step(self) -> None:
        """Advance travel and mount by a time step, after the forces of the step are known."""
        if self.mount and not self.released and self.travel > self.mount["release"]:
            force = [row[3] for row in self.rows if row[1] > self.mount["release"] - PRELOAD_PATH]
            self.carriage = self.travel + float(np.mean(force)) / self.mount["stiffness"]
            self.released = True
        if self.released:
            stretch, closing = self.carriage - self.travel, self.speed - self.velocity
            self.mount_force = self.mount["stiffness"] * stretch + self.mount["damping"] * closing
            self.set_velocity(self.velocity + O.dt * (self.mount_force - self.draft(False)) / self.mount["mass"])
        self.travel += self.velocity * O.dt
        self.carriage += self.speed * O.dt

    def record(self) -> None:
        """Store time, travels, mount force and the forces on the groups of faces."""
        draft = self.draft(True)
        mount = self.mount_force if self.released else draft
        self.rows.append((O.time, self.travel, self.carriage, mount, *(self.drag(k, False) for k in self.groups)))


def pull(case: dict[str, Any]) -> dict[str, Any]:
    """Pull the tool through a packing whose side walls keep their pressure and whose end walls stand still."""
    servo, _, ids = load_packing(case, case["side_friction"])
    low, high = box()
    entry = np.array([low[0], (low[1] + high[1]) / 2.0, (low[2] + high[2]) / 2.0])
    global tool  # YADE's PyRunner reaches it by name
    groups = {}
    for name, triangles in case["faces"].items():
        corners = [[Vector3(*(entry + corner)) for corner in triangle] for triangle in triangles]
        groups[name] = O.bodies.append([utils.facet(c, dynamic=False, material="tool") for c in corners])
    facts = {"spheres": len(ids), "porosity": porosity(ids), "half_width": float(high[1] - low[1]) / 2.0}
    before = np.array([O.bodies[i].state.pos for i in ids]) - entry
    servo.wall_left_activated = servo.wall_right_activated = False
    for i in WALLS[:2]:
        O.bodies[i].state.vel = (0, 0, 0)
    tool = Tool(groups, case["speed"], case["mount"])
    tool.set_velocity(case["speed"])
    every = max(1, round(SAMPLE / (case["speed"] * O.dt)))
    O.engines += [yd.PyRunner(command="tool.step()", iterPeriod=1)]
    O.engines += [yd.PyRunner(command="tool.record()", iterPeriod=every)]
    # A soft mount lags behind its carriage: as many steps again are allowed until the tool has covered the travel.
    last = O.iter + 2 * int(case["travel"] / (case["speed"] * O.dt))
    while tool.travel < case["travel"] and O.iter < last:
        O.run(50, True)
    if tool.travel < case["travel"]:
        raise RuntimeError(f"the tool has covered {tool.travel:.3f} m of {case['travel']} m")
    moved = np.array([O.bodies[i].state.pos for i in ids]) - entry - before
    columns = ["time", "travel", "carriage", "mount", *groups]
    return {**facts, "series": np.array(tool.rows), "columns": columns, "before": before, "moved": moved}


if __name__ == "__main__":
    this_case = json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8"))
    result = {"packing": make_packing, "triaxial": triaxial, "pull": pull}[this_case["kind"]](this_case)
    if result:
        np.savez(this_case["output"], **result, steps=O.iter, time_step=O.dt, yade=config.version)
