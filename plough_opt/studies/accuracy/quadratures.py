"""Contestants that integrate over space or path: density profiles, quasi-static averages, the elastic contact."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.expressions import as_number
from plough_opt.laws.forces import soil_reaction
from plough_opt.laws.law import SoilReaction
from plough_opt.motion import Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.assembly import quasi_static
from plough_opt.motion.plan import forced_rate, numbers_of, steps_for, timeline_of
from plough_opt.soil import elastic, plastic
from plough_opt.soil.geometry import Cone
from plough_opt.soil.soil import Soil
from plough_opt.studies.accuracy.contest import Contestant, Entry
from plough_opt.studies.accuracy.methods import Task
from plough_opt.studies.accuracy.reference import errors_of

ORDERS: Final = (2, 4, 8, 16, 32, 64)
"""Orders of the quadrature over a density profile."""

PANELS: Final = ((4, 24), (3, 20))
"""Panels, and points in each, of the reference for a density profile; then of the solution that estimates its error."""

POINTS: Final = (1, 2, 4, 10)
"""Gauss-Legendre points in each panel of a quasi-static run."""

FINER: Final = ((17, 3), (13, 2))
"""Points, and factor on the panels, of the reference for a quasi-static run; then of the one to estimate its error."""

NODES: Final = (4, 16, 64, 256)
"""Gauss-Legendre points on the whole face of an elastic contact."""

# Steps of Newton's method to the radius of the compaction front.
_NEWTON: Final = 5
# Places on the face between which a change of contact is located, and tolerance of the location [m].
_CONTACT_PLACES: Final = 2001
_CONTACT_TOLERANCE: Final = 1e-17
# Relative tolerance of the reference for the contact force.
_TIGHT: Final = 1e-14

Vector = NDArray[np.float64]
Found = tuple[list[Entry], float, tuple[str, str]]
"""Entries of one kind of quadrature, the relative error of their reference [-], and the default method and setting."""


def density_profile(task: Task) -> Found:
    """Return the entries of a density profile's quadrature orders, with errors of F0, Fd and the added mass."""
    scene, profile = task.scene, task.scene.soil.density_profile
    assert profile is not None  # else there is nothing to integrate

    def reaction(order: int) -> Callable[[], SoilReaction]:
        return partial(soil_reaction, scene.cone, replace(scene.soil, density_profile=replace(profile, order=order)))

    exact, check = (profile_reaction(scene.cone, scene.soil, *panels) for panels in PANELS)

    def errors(found: SoilReaction) -> dict[str, float]:
        names = {"static resistance": "static", "drag": "drag", "added mass": "added_mass"}
        apart = {
            name: float(abs(getattr(found, key) - getattr(exact, key)) / abs(getattr(exact, key)))
            for name, key in names.items()
        }
        return {"reaction": max(apart.values()), **apart}

    orders = tuple(dict.fromkeys(sorted((*task.some(ORDERS), profile.order))))
    contestant = Contestant("quadrature", "density profile", reaction, errors, orders, label="order {}".format)
    floor = max(errors(check)["reaction"], float(np.finfo(float).eps))
    return task.ranked([contestant], "reaction"), floor, (contestant.method, f"order {profile.order}")


def quasi_static_course(task: Task) -> Found:
    """Return the entries of quadratures for quasi-static averages; the reference has more points and panels."""
    scene = task.scene
    # What `simulate` takes for a quasi-static run.
    usual = max(task.outputs, steps_for(forced_rate(numbers_of(scene)) * task.duration))

    def average(setting: tuple[int, int]) -> Callable[[], Run]:
        points, panels = setting
        timeline = timeline_of(scene, task.duration, task.outputs, panels)
        return partial(quasi_static, scene, task.duration, timeline, Accuracy(), points)

    def label(setting: tuple[int, int]) -> str:
        points, panels = setting
        return f"{points} point{'s' * (points > 1)} in each of {panels} panels"

    exact, check = (average((points, finer * usual))() for points, finer in FINER)
    settings = sorted(((points, panels) for points in POINTS for panels in {task.outputs, usual}), key=math.prod)
    contestant = Contestant(
        "quadrature", "quasi-static", average, lambda run: errors_of(run, exact), settings, label=label
    )
    floor = max(float(np.finfo(float).eps), *errors_of(check, exact).values())
    return task.ranked([contestant], "averages"), floor, (contestant.method, label((POINTS[-1], usual)))


def elastic_contact(task: Task) -> Found:
    """Return the entries of quadratures for the elastic contact force: graded, and plain over the whole face."""
    scene = task.scene
    soil = scene.soil if scene.effects.ambient_pressure else replace(scene.soil, ambient_pressure=0.0)
    height, slope, friction, ambient = (
        float(as_number(value))
        for value in (scene.cone.height, scene.cone.slope, soil.tool_friction, soil.ambient_pressure)
    )
    face = 2.0 * math.pi * (slope + friction) * slope

    def pressure(x: Vector) -> Vector:
        return np.asarray(elastic.cone_pressure(x, scene.cone, scene.soil, scene.tow_speed))

    def integrand(x: Vector) -> Vector:
        held: Vector = face * x * np.maximum(pressure(x), -ambient)
        return held

    # The rule of Takahasi and Mori suits integrands that are singular at the edges.
    from scipy.integrate import tanhsinh  # slow to import

    edges = np.array(_edges(lambda x: pressure(x) + ambient, height))
    parts = tanhsinh(integrand, edges[:-1], edges[1:], rtol=_TIGHT)
    exact, off = float(np.sum(parts.integral)), float(np.sum(parts.error))

    def plain(count: int) -> Callable[[], float]:
        nodes, weights = np.polynomial.legendre.leggauss(count)
        return lambda: float(weights @ integrand(height * (nodes + 1.0) / 2.0)) * height / 2.0

    def errors(found: float) -> Mapping[str, float]:
        return {"contact force": abs(found - exact) / abs(exact)}

    contestants = [
        Contestant("quadrature", "whole face", plain, errors, task.some(NODES), label="{} points".format),
        Contestant("quadrature", "graded cells",
              lambda _: lambda: float(elastic.cone_force(scene.cone, soil, scene.tow_speed)), errors),
    ]  # fmt: skip
    floor = max(off / abs(exact), float(np.finfo(float).eps))
    return task.ranked(contestants, "contact force"), floor, (contestants[-1].method, "")


def _edges(total: Callable[[Vector], Vector], height: float) -> list[float]:
    """Return the ends of the face, and the places between them where contact begins or ends."""
    from scipy.optimize import brentq  # slow to import

    x = height * (1.0 - np.cos(np.linspace(1e-5, math.pi - 1e-5, _CONTACT_PLACES))) / 2.0
    values = total(x)
    places = [
        float(brentq(lambda place: float(total(np.array([place]))[0]), x[k], x[k + 1], xtol=_CONTACT_TOLERANCE))
        for k in np.flatnonzero(values[:-1] * values[1:] < 0.0)
    ]
    return [0.0, *places, height]


def profile_reaction(cone: Cone, soil: Soil, panels: int, count: int) -> SoilReaction:
    """Return the soil's reaction with a density profile, from equations (14) to (24) as printed.

    This shares nothing with the nested Gauss rules of `soil.plastic` and `laws.forces`, which have transformed
    variables. Here psi is integrated separately for each radius, Newton's method finds the front, and the integrals
    over particles s and over the cone's face x remain, all by Gauss's rule in several panels.

    Args:
        cone: cone with numbers.
        soil: soil with numbers and a density profile.
        panels: number of panels of every integral.
        count: number of points in each panel.
    """
    height, slope, friction, density, angle, cohesion, ambient = (
        float(as_number(value))
        for value in (cone.height, cone.slope, soil.tool_friction, soil.density, soil.friction_angle, soil.cohesion,
                      soil.ambient_pressure)
    )  # fmt: skip
    profile = soil.density_profile
    assert profile is not None
    nodes, gauss = np.polynomial.legendre.leggauss(count)
    parts = ((2.0 * np.arange(panels)[:, None] + nodes + 1.0) / (2.0 * panels)).ravel()
    weights = np.tile(gauss / (2.0 * panels), panels)

    def ratio(r: Vector) -> Vector:
        return density / (np.asarray(profile.at(r.ravel()), float).ravel() + np.zeros(r.size)).reshape(r.shape)

    def psi(r: Vector) -> Vector:
        s = r[..., None] * parts
        return np.asarray(r * ((ratio(s) * s) @ weights))

    points, shares = height * parts, height * weights
    radius = points * slope
    # Start from the package's front; Newton's method adds its own digits.
    cavities = (plastic.Cavity(float(r), 0.0, 0.0) for r in radius)
    front = np.array([float(as_number(plastic.front_radius(cavity, soil))) for cavity in cavities])
    for _ in range(_NEWTON):
        front = front - (front**2 - 2.0 * psi(front) - radius**2) / (2.0 * front * (1.0 - ratio(front)))
    s = front[:, None] * parts
    y = np.sqrt(radius[:, None] ** 2 + 2.0 * psi(s))
    # The wall's gauge pressure at rest [Pa], and its coefficients of rho0 R'^2 and rho0 R R''.
    mu = math.sin(angle)
    nu, tau = 2.0 * mu / (1.0 + mu), 2.0 * cohesion * math.cos(angle)
    log = np.log(front / radius)
    strength = (np.expm1(nu * log) / nu if nu > 0.0 else log) * (nu * ambient + tau / (1.0 + mu))
    share = (y / radius[:, None]) ** nu * s / y**2 * front[:, None]
    inertia = share @ weights
    slowing = (share * (radius[:, None] / y) ** 2) @ weights
    rate = np.exp(nu * log) * (radius / front) ** 2 / (1.0 - ratio(front)) + inertia - slowing
    face = 2.0 * math.pi * slope * (slope + friction)
    return SoilReaction(
        static=face * (shares @ (points * strength)),
        drag=face * slope**2 * density * (shares @ (points * rate)),
        added_mass=face * slope**2 * density * (shares @ (points**2 * inertia)),
    )
