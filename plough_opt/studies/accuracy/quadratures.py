"""Contestants that integrate over space or path: density profiles, quasi-static averages, the elastic contact."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import InputError
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
from plough_opt.studies.accuracy.wide import EPS, PI, WIDE, Wide, gauss

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

Found = tuple[list[Entry], float]
"""Entries of one kind of quadrature, and the relative error of their reference [-]."""


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
    return task.ranked([contestant], "reaction"), max(errors(check)["reaction"], float(EPS))


def quasi_static_course(task: Task) -> Found:
    """Return the entries of quadratures for quasi-static averages; the reference has more points and panels."""
    scene, usual = task.scene, usual_panels(task)

    def average(setting: tuple[int, int]) -> Callable[[], Run]:
        points, panels = setting
        timeline = timeline_of(scene, task.duration, task.outputs, panels)
        return partial(quasi_static, scene, task.duration, timeline, Accuracy(), points)

    def label(setting: tuple[int, int]) -> str:
        points, panels = setting
        return f"{points} point{'s' * (points > 1)} in each of {panels} panels"

    exact, check = (average((points, finer * usual))() for points, finer in FINER)
    settings = [(points, panels) for points in POINTS for panels in dict.fromkeys((task.outputs, usual))]
    contestant = Contestant(
        "quadrature", "quasi-static", average, lambda run: errors_of(run, exact), settings, label=label
    )
    floor = max(float(np.finfo(float).eps), *errors_of(check, exact).values())
    return task.ranked([contestant], "averages"), floor


def usual_panels(task: Task) -> int:
    """Return the number of panels that `simulate` takes for a quasi-static run."""
    return max(task.outputs, steps_for(forced_rate(numbers_of(task.scene)) * task.duration))


def elastic_contact(task: Task) -> Found:
    """Return the entries of quadratures for the elastic contact force: graded, and plain over the whole face."""
    scene = task.scene
    soil = scene.soil if scene.effects.ambient_pressure else replace(scene.soil, ambient_pressure=0.0)
    height, slope, friction, ambient = (
        float(as_number(value))
        for value in (scene.cone.height, scene.cone.slope, soil.tool_friction, soil.ambient_pressure)
    )
    face = 2.0 * math.pi * (slope + friction) * slope

    def pressure(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(elastic.cone_pressure(x, scene.cone, scene.soil, scene.tow_speed))

    def integrand(x: NDArray[np.float64]) -> NDArray[np.float64]:
        held: NDArray[np.float64] = face * x * np.maximum(pressure(x), -ambient)
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
    return task.ranked(contestants, "contact force"), floor


def _edges(total: Callable[[NDArray[np.float64]], NDArray[np.float64]], height: float) -> list[float]:
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
    """Return the soil's reaction with a density profile in the widest floats, from equations (14) to (24) as printed.

    This shares nothing with the nested Gauss rules of `soil.plastic` and `laws.forces`, which have transformed
    variables. Here psi is integrated separately for each radius, Newton's method finds the front, and the integrals
    over particles s and over the cone's face x remain, all by Gauss's rule in several panels.

    Args:
        cone: cone with numbers.
        soil: soil with numbers and a density profile.
        panels: number of panels of every integral.
        count: number of points in each panel.

    Raises:
        InputError: the profile cannot compute in wide floats.
    """
    height, slope, friction, density = (
        WIDE(float(as_number(value))) for value in (cone.height, cone.slope, soil.tool_friction, soil.density)
    )
    profile = soil.density_profile
    assert profile is not None

    def ratio(r: Wide) -> Wide:
        try:
            found = np.asarray(profile.at(r), WIDE)
        except (TypeError, NotImplementedError, AttributeError) as error:
            raise InputError(f"the density profile cannot compute in wide floats: {error}") from None
        return density / (found.reshape(r.shape) if found.size == r.size else found + 0 * r)

    parts, weights = _panels(WIDE(1), panels, count)

    def psi(r: Wide) -> Wide:
        s = r[..., None] * parts
        return r * ((ratio(s) * s) @ weights)

    points, shares = height * parts, height * weights
    radius = points * slope
    # Start from the front in doubles; Newton's method adds the digits of wide floats.
    cavities = (plastic.Cavity(float(r), 0.0, 0.0) for r in radius)
    front = np.array([float(as_number(plastic.front_radius(cavity, soil))) for cavity in cavities], WIDE)
    for _ in range(_NEWTON):
        front = front - (front**2 - 2 * psi(front) - radius**2) / (2 * front * (1 - ratio(front)))
    s = front[:, None] * parts
    y = np.sqrt(radius[:, None] ** 2 + 2 * psi(s))
    strength, rate, inertia = _wall(soil, radius, front, 1 - ratio(front), (s, y, weights))
    face = 2 * PI * slope * (slope + friction)
    return SoilReaction(
        static=face * (shares @ (points * strength)),
        drag=face * slope**2 * density * (shares @ (points * rate)),
        added_mass=face * slope**2 * density * (shares @ (points**2 * inertia)),
    )


def _panels(end: Wide, panels: int, count: int) -> tuple[Wide, Wide]:
    """Return Gauss points in panels from 0 to an end, and their weights."""
    nodes, weights = gauss(count)
    half = end / panels / 2
    return ((2 * np.arange(panels)[:, None] + nodes + 1) * half).ravel(), np.tile(weights * half, panels)


def _wall(
    soil: Soil, radius: Wide, front: Wide, jump: Wide, particles: tuple[Wide, Wide, Wide]
) -> tuple[Wide, Wide, Wide]:
    """Return the wall's gauge pressure at rest [Pa], and its coefficients of rho0 R'^2 and rho0 R R''.

    Args:
        soil: soil with numbers.
        radius: radius R of the wall at each point of the face [m].
        front: radius of the front there [m].
        jump: 1 - b at the front.
        particles: initial radii s and present radii y, a row for each point of the face [m]; weights of their integral.
    """
    angle, cohesion, ambient = (
        WIDE(float(as_number(value))) for value in (soil.friction_angle, soil.cohesion, soil.ambient_pressure)
    )
    mu = np.sin(angle)
    nu, tau = 2 * mu / (1 + mu), 2 * cohesion * np.cos(angle)
    log = np.log(front / radius)
    growth = np.expm1(nu * log) / nu if nu > 0 else log
    s, y, weights = particles
    share = (y / radius[:, None]) ** nu * s / y**2 * front[:, None]
    inertia = share @ weights
    slowing = (share * (radius[:, None] / y) ** 2) @ weights
    driven = np.exp(nu * log) * (radius / front) ** 2 / jump
    return growth * (nu * ambient + tau / (1 + mu)), driven + inertia - slowing, inertia
