"""A complete subsoiler: n shares on springs, frame, hitch and tractor, designed for minimum fuel per hectare.

    python problems/subsoiler_frame.py
    python problems/subsoiler_frame_check.py        # certify the optimum and set it beside brute force
    python problems/subsoiler_frame_picture.py out/subsoiler_frame.png

Firm sandy loam at the left end hardens to hardpan at the right: each share has a soil of its own, and the frame is set
off so that the resultant of all drafts runs through the tractor's centre line. Two tubes, one behind the other, carry
the shanks and hang on brackets at the hitch. Values marked * are choices, those marked + cited from memory; neither
were checked against a machine.

What decides: fuel is burnt by the metre (draft) and by the hour (the engine's own losses). Small shares close together
loosen cheapest, as draft grows with the square of the loosened radius; but legs, tractor and hours are then paid for
less width. Speed saves hours until the power ends; the theory's own speed term is 1-3 %, so D497's growth of draft with
speed is added. Ballast saves slip and costs rolling resistance. A stiff mount oscillates less, and loads the tubes more
where a share gives way to a stone.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import casadi as ca

import plough_opt as po
from plough_opt.expressions import Expression, exp, maximum, sqrt

GRAVITY, STEEL, DEPTH = 9.81, 7850.0, 0.45  # m/s^2, kg/m^3, m*
SHANK, HITCH, WHEEL_DRAG = 60.0, 150.0, 0.10  # kg each*, kg*, rolling resistance of the frame over its weight*
MOVING, DAMPING, LEG_LENGTH = 60.0, 800.0, 0.8  # kg on each spring*, N s/m*, m from the share up to the tubes*
GAP, THINNESS, STRENGTH, STONE = 0.6, 25.0, 120e6, 0.15  # m between tubes*, side/wall*, Pa*, m given way to a stone*
TRACTOR, RATED, GEARS, MOBILITY = 6000.0, 95e3, 0.87, 50.0  # kg*, W*, efficiency*, Brixius' number without ballast*
SPEED_TERM = 0.10  # s^2/m^2: C/A of the subsoiler's row in ASABE D497+
WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.8)  # of the soil's strength along the path*

VARIABLES: dict[str, tuple[float, float, float, str]] = {  # guess, lower, upper, unit
    "wedge angle": (po.deg(30), po.deg(10), po.deg(60), "rad"),
    "height": (0.3, 0.1, 0.6, "m"),  # of the shares
    "spacing": (0.5, 0.2, 0.9, "m"),
    "stiffness": (2e5, 2e4, 1e6, "N/m"),  # of each mount
    "speed": (1.2, 0.5, 3.0, "m/s"),
    "tube": (0.16, 0.08, 0.30, "m"),  # side of the square tubes
    "bracket": (0.7, 0.2, 1.5, "m"),  # of the hitch on the tubes, left and right of the centre line
    "ballast": (1000.0, 0.0, 4000.0, "kg"),
    "slip": (0.1, 0.02, 0.4, ""),  # of the wheels
}


@dataclass(frozen=True)
class Leg:
    """Resistance of the shank's part in the soil, which the theory ignores."""

    draft: float = 2500.0  # N*

    def force(self, _travel: Expression, speed: Expression) -> Expression:
        """Return the resistance [N]."""
        return self.draft * (1.0 + SPEED_TERM * speed**2)


EFFECTS = po.Effects(strength_wave=WAVE, damping=DAMPING, rate_term=SPEED_TERM, own=(Leg(),), orbit="periodic")


def soil(right: float) -> po.Soil:
    """Return the soil at a fraction of the width; its pores are open, so the ambient pressure is the overburden."""
    left, end = po.named_soil("firm sandy loam"), po.named_soil("hardpan")
    names = ("density", "density_ratio", "cohesion", "friction_angle", "tool_friction")
    own = {name: (1.0 - right) * getattr(left, name) + right * getattr(end, name) for name in names}
    return po.Soil(**own, ambient_pressure=own["density"] * GRAVITY * DEPTH, name=f"{right:.0%} hardpan")


def traction(slip: Expression, weight: Expression) -> tuple[Expression, Expression]:
    """Return gross pull of the wheels and net pull at the hitch [N]: Brixius (1987), as in D497+."""
    number = MOBILITY * TRACTOR * GRAVITY / weight
    gross = 0.88 * (1.0 - exp(-0.1 * number)) * (1.0 - exp(-7.5 * slip)) + 0.04
    return gross * weight, (gross - 1.0 / number - 0.04 - 0.5 * slip / sqrt(number)) * weight


def moments(places: Sequence[Expression], loads: Sequence[Expression], bracket: Expression) -> list[Expression]:
    """Return the bending moments [N m] at all forces of a beam on two supports, each ``bracket`` off its middle."""
    right = sum(load * (place + bracket) for place, load in zip(places, loads, strict=True)) / (2.0 * bracket)
    forces = [*zip(places, loads, strict=True), (-bracket, right - sum(loads)), (bracket, -right)]
    return [sum(force * maximum(at - place, 0.0) for place, force in forces) for at, _ in forces]


def machine(c: Any, n: int, motion: Callable[[po.Scene], Any] = po.simulate) -> SimpleNamespace:
    """Return all results for chosen variables (expressions, numbers or arrays); ``motion`` simulates a scene."""
    cone = po.Wedge(c.wedge_angle, po.deg(15.0), c.height).equivalent_cone()
    mass = MOVING + cone.solid_mass(STEEL)
    scenes = [po.Scene(soil(k / (n - 1)), cone, c.stiffness, mass, c.speed, EFFECTS) for k in range(n)]
    runs = [motion(scene) for scene in scenes]
    peaks = [run.mean_draft + 2**0.5 * run.force_rms for run in runs]
    draft = sum(run.mean_draft for run in runs)
    offset = sum(k * run.mean_draft for k, run in enumerate(runs)) / draft
    places = [(k - offset) * c.spacing for k in range(n)]

    # Each tube carries half the draft, and one of the two forces that balance its moment about the tubes.
    bore = c.tube * (1.0 - 2.0 / THINNESS)
    modulus = (c.tube**4 - bore**4) / (6.0 * c.tube)
    on_stone = [[peak + (STONE * c.stiffness if i == k else 0.0) for i, peak in enumerate(peaks)] for k in range(n)]
    bending = [moments(places, loads, c.bracket) for loads in on_stone]
    stresses = [[(0.5 + LEG_LENGTH / GAP) * moment / modulus for moment in case] for case in bending]
    frame = 2.0 * STEEL * (c.tube**2 - bore**2) * ((n - 1) * c.spacing + 0.3) + n * SHANK + HITCH

    pull = draft + WHEEL_DRAG * frame * GRAVITY
    gross, grip = traction(c.slip, (TRACTOR + c.ballast) * GRAVITY)
    power = gross * c.speed / (1.0 - c.slip) / GEARS
    work_rate = 0.36 * n * c.spacing * c.speed
    radii = [po.loosened_radius(cone, scene.soil) for scene in scenes]
    fuel = 35.9 * (0.22e-3 * power + 0.096e-3 * RATED) / work_rate  # MJ/l times l/h: Grisso, Kocher, Vaughan (2004)+
    limits = {  # values, least, most, unit
        "half angle": ([cone.half_angle], None, po.deg(15.0), "rad"),
        "loosened overlap": ([a + b - c.spacing for a, b in pairwise(radii)], 0.0, None, "m"),
        "oscillation": ([run.displacement_rms for run in runs], None, 0.006, "m"),
        "spring travel": ([peak / c.stiffness + STONE for peak in peaks], None, 0.25, "m"),
        "stress": ([stress for case in stresses for stress in case], -STRENGTH, STRENGTH, "Pa"),
        "grip": ([grip - pull], 0.0, None, "N"),
        "power": ([power], None, 0.9 * RATED, "W"),
    }
    return SimpleNamespace(scenes=scenes, runs=runs, places=places, radii=radii, stresses=stresses, frame=frame,
                           pull=pull, power=power, work_rate=work_rate, fuel=fuel, limits=limits)  # fmt: skip


def design(n: int = 5) -> tuple[po.Design, SimpleNamespace, SimpleNamespace]:
    """Return the design of a machine of n shares, its variables, and its results."""
    d, c = po.Design(), SimpleNamespace()
    for name, (guess, lower, upper, unit) in VARIABLES.items():
        symbol = d.variable(name, guess=guess, lower=lower, upper=upper, unit=unit, log=name == "stiffness")
        setattr(c, name.replace(" ", "_"), symbol)
    m = machine(c, n)
    d.minimise(m.fuel / 1e3)
    for name, (values, least, most, unit) in m.limits.items():
        d.require(name, ca.vertcat(*values), at_least=least, at_most=most, unit=unit)
    return d, c, m


def solved(n: int = 5) -> tuple[SimpleNamespace, SimpleNamespace, po.Optimum]:
    """Return the variables and results of a machine of n shares, and its optimum, after printing it."""
    d, c, m = design(n)
    best = d.solve()
    for limit in best.limits:
        print(f"{limit.name:16s} {limit.value:11.5g} {limit.unit:8s} {limit.limits}{'  decides' * limit.active}")
    print(f"{best(m.fuel):.2f} MJ/ha at {best(m.work_rate):.3f} ha/h; local optima found: {len(best.local_optima)}")
    return c, m, best


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description="The subsoiler of least fuel per hectare.")
    parser.add_argument("--shares", type=int, default=5, choices=range(2, 10), help="how many (default: 5)")
    solved(parser.parse_args(arguments).shares)


if __name__ == "__main__":
    main()
