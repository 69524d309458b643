"""Designs with fronts in closed form, and a front of a motion. Each is traced once for all tests."""

from types import SimpleNamespace

import casadi as ca
import pytest

import plough_opt as po


@pytest.fixture
def plane():
    """Return a design of x in [-2, 2] and y in [-1, 1], and both symbols."""
    d = po.Design()
    x = d.variable("x", guess=0.3, lower=-2.0, upper=2.0)
    y = d.variable("y", guess=0.5, lower=-1.0, upper=1.0, unit="m")
    return d, x, y


@pytest.fixture(scope="session")
def convex():
    """Front sqrt(f1) + sqrt(f2) = 1 of the distances from (0, 0) and (1, 0), at 21 positions."""
    d = po.Design()
    x, y = (d.variable(name, guess=0.4, lower=-2.0, upper=2.0) for name in "xy")
    return po.trade_off(d, x**2 + y**2, (x - 1.0) ** 2 + y**2, points=21, title="two squares")


@pytest.fixture(scope="session")
def concave():
    """Front f1^2 + f2^2 = 1 of points outside the unit circle, at 21 positions; a weighted sum finds only its ends."""
    d = po.Design()
    x, y = (d.variable(name, guess=0.9, lower=0.0, upper=2.0) for name in "xy")
    d.require("outside", x**2 + y**2, at_least=1.0)
    return po.trade_off(d, po.Goal("a", x), po.Goal("b", y), points=21)


@pytest.fixture(scope="session")
def broken():
    """Front (x, (x - 0.3)^2 (0.8 - x)) for 0 <= x <= 1, interrupted from its minimum at 0.3 to 0.8."""
    d = po.Design()
    x = d.variable("x", guess=0.5, lower=0.0, upper=1.0)
    y = d.variable("y", guess=0.5, lower=-1.0, upper=1.0)
    first = po.Goal("a", x + y**2, unit="N")
    return po.trade_off(d, first, po.Goal("b", (x - 0.3) ** 2 * (0.8 - x) + y**2), points=41, search=["x"])


@pytest.fixture(scope="session")
def alone():
    """Front of two objectives that are best in the same design."""
    d = po.Design()
    x, y = (d.variable(name, guess=0.4, lower=-2.0, upper=2.0) for name in "xy")
    goals = po.Goal("draft", 1.0 + x**2 + y**2), po.Goal("power", 3.0 + 2.0 * x**2 + y**2)
    return po.trade_off(d, *goals, points=21)


def mount(soil):
    """Return problem R1 with a damper and two objectives, and its expressions."""
    d = po.Design()
    angle = d.variable("wedge angle", guess=po.deg(25.0), lower=po.deg(5.0), upper=po.deg(60.0), unit="rad")
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.50, unit="m")
    k0 = d.variable("stiffness", guess=5e4, lower=3e3, upper=5e5, unit="N/m", log=True)
    share, scene = mounted(soil, angle, height, k0)
    run = po.simulate(scene, 2.0)
    d.require("loosened radius", po.loosened_radius(share.equivalent_cone(), soil), at_least=0.12, unit="m")
    d.require("half angle", share.equivalent_cone().half_angle, at_most=po.deg(15.0), unit="rad")
    return d, run


def mounted(soil, angle, height, k0):
    """Return a share and its scene under a strength wave."""
    share = po.Wedge(angle, po.deg(15.0), height)
    mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.6), damping=400.0)
    return share, po.Scene(soil, share, k0, mass, 2.0, effects)


@pytest.fixture(scope="session")
def soft_or_stiff(r1_soil):
    """Front of the mean deflection against the force's oscillation: soft mounts, and one as stiff as its bound."""
    d, run = mount(r1_soil)
    deflection = po.Goal("deflection", run.mean_deflection, unit="m")
    front = po.trade_off(d, deflection, po.Goal("force oscillation", run.force_rms, unit="N"), points=17)
    angle, height, k0 = symbols = [ca.MX.sym(name) for name in ("angle", "height", "k0")]
    _, scene = mounted(r1_soil, angle, height, k0)
    return SimpleNamespace(front=front, batch=po.Batch(scene, 2.0, inputs=symbols, error=1e-8))
