"""Contestants that integrate over space or path: density profiles, the quasi-static course, the elastic contact."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import PloughError
from plough_opt.core.expressions import as_number
from plough_opt.laws.forces import soil_reaction
from plough_opt.laws.law import SoilReaction
from plough_opt.motion import Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.plan import forced_rate, numbers_of, steps_for, timeline_of
from plough_opt.motion.quasi_static import quasi_static
from plough_opt.motion.scene import Scene
from plough_opt.soil import elastic
from plough_opt.studies.accuracy.contest import Entry, median_time
from plough_opt.studies.accuracy.laws import Laws, Piece
from plough_opt.studies.accuracy.methods import Task, failure
from plough_opt.studies.accuracy.picard import EPS, WIDE, Wide, gauss
from plough_opt.studies.accuracy.profile_reference import WideReaction, profile_reaction
from plough_opt.studies.accuracy.reference import errors_of

ORDERS: Final = (2, 4, 8, 16, 32, 64)
"""Orders of a density profile's quadrature that are tried."""

PANELS: Final = ((64, 24), (48, 20))
"""Panels and degree of the reference for them, and of the solution that estimates its error."""

POINTS: Final = (1, 2, 4, 10)
"""Gauss-Legendre points in each panel of a quasi-static course that are tried."""

NODES: Final = (4, 16, 64, 256)
"""Gauss-Legendre points on the whole face of an elastic contact that are tried."""


@dataclass(frozen=True)
class Quadratures:
    """Entries of one kind of quadrature, and the relative error [-] of their reference."""

    entries: tuple[Entry, ...]
    reference: float


def _entry(
    task: Task, method: str, setting: str, find: Callable[[], Any], errors: Callable[[Any], dict[str, float]]
) -> Entry:
    started = time.process_time()
    try:
        found = find()
    except PloughError as error:
        return failure("quadrature", method, setting, error)
    first = time.process_time() - started
    seconds = median_time(find, budget=task.timing, warm=True)
    return Entry("quadrature", method, setting, seconds, max(0.0, first - seconds), errors(found))


# --- density profile ---


def density_profile(task: Task) -> Quadratures:
    """Return orders of a density profile's quadratures, by their errors in F0, Fd and the added mass."""
    scene, profile = task.scene, task.scene.soil.density_profile
    assert profile is not None  # else there is nothing to integrate

    def reaction(order: int) -> SoilReaction:
        return soil_reaction(scene.cone, replace(scene.soil, density_profile=replace(profile, order=order)))

    exact, check = (profile_reaction(scene.cone, scene.soil, *panels) for panels in PANELS)

    def errors(found: SoilReaction | WideReaction) -> dict[str, float]:
        names = {"static resistance": "static", "drag": "drag", "added mass": "added_mass"}
        apart = {
            name: float(abs(getattr(found, key) - getattr(exact, key)) / abs(getattr(exact, key)))
            for name, key in names.items()
        }
        return {"reaction": max(apart.values()), **apart}

    orders = dict.fromkeys(sorted((*task.some(ORDERS), profile.order)))
    entries = tuple(
        _entry(task, "density profile", f"order {order}", partial(reaction, order), errors) for order in orders
    )
    return Quadratures(entries, max(errors(check)["reaction"], float(EPS)))


# --- quasi-static course ---


@dataclass(frozen=True)
class _Course:
    """A quasi-static course in the widest floats."""

    mean_draft: Wide
    force_rms: Wide
    mount_force: Wide


def quasi_static_course(task: Task) -> Quadratures:
    """Return points in each panel of a quasi-static course's averages; the reference has other points and panels."""
    scene = task.scene
    exact, check = _course(task, 40, 1.0), _course(task, 30, 1.7)

    def average(points: int, panels: int) -> Run:
        return quasi_static(scene, task.duration, timeline_of(scene, task.duration, task.outputs, panels),
                            Accuracy(), points)  # fmt: skip

    usual = steps_for(forced_rate(numbers_of(scene)) * task.duration)
    entries = [
        _entry(task, "quasi-static", f"{points} point{'s' * (points > 1)} in each of {panels} panels",
               partial(average, points, panels), lambda run: errors_of(run, exact))
        for points in POINTS for panels in dict.fromkeys((task.outputs, max(usual, task.outputs)))
    ]  # fmt: skip
    return Quadratures(tuple(entries), max(float(np.finfo(WIDE).eps), *errors_of(check, exact).values()))


def _course(task: Task, points: int, finer: float) -> _Course:
    """Return a quasi-static course by panels that are short beside every period, and end with the ramp."""
    still = replace(task.scene, effects=replace(task.scene.effects, motion=True))
    laws = Laws.of(still)
    duration = WIDE(task.duration)
    piece = Piece(bool(laws.ramp > 0), 0, 1, False, laws.height, WIDE(0))
    after = replace(piece, ramping=False)
    turns = float(laws.wavenumber * laws.tow_speed * duration) / math.pi
    panels = math.ceil(finer * (4 + 2 * turns))
    ends = np.linspace(WIDE(0), duration, panels + 1)
    if 0 < laws.ramp < duration:
        ends = np.sort(np.append(ends, laws.ramp))
    nodes, weights = gauss(points)
    half = np.diff(ends)[:, None] / 2
    inner, shares = (ends[:-1, None] + half * (nodes + 1)).ravel(), (half * weights).ravel() / duration

    def force(times: Wide) -> Wide:
        rising = times < laws.ramp
        path, speed = (np.where(rising, a, b) for a, b in zip(
            laws.strut(times, piece)[:2], laws.strut(times, after)[:2], strict=True))  # fmt: skip
        found: Wide = laws.resistance(path, speed, piece) + 0 * times
        return found

    forces = force(inner)
    mean = shares @ forces
    times = duration * np.arange(task.outputs + 1) / WIDE(task.outputs)
    return _Course(mean, np.sqrt(shares @ (forces - mean) ** 2), force(times))


# --- elastic contact ---


def elastic_contact(task: Task) -> Quadratures:
    """Return the contact force of the elastic medium by its graded quadrature and by plain ones over the whole face."""
    scene = task.scene
    pressure = _pressure(scene)
    height, slope = float(as_number(scene.cone.height)), float(as_number(scene.cone.slope))
    face = 2.0 * math.pi * (slope + float(as_number(scene.soil.tool_friction))) * slope
    ambient = float(as_number(scene.soil.ambient_pressure)) if scene.effects.ambient_pressure else 0.0

    def integrand(x: NDArray[np.float64]) -> NDArray[np.float64]:
        held: NDArray[np.float64] = face * x * np.maximum(pressure(x), -ambient)
        return held

    exact, check = (_double_exponential(integrand, _edges(pressure, ambient, height), level) for level in (7, 6))

    def plain(count: int) -> float:
        nodes, weights = np.polynomial.legendre.leggauss(count)
        return float(weights @ integrand(height * (nodes + 1.0) / 2.0)) * height / 2.0

    def graded() -> float:
        soil = scene.soil if scene.effects.ambient_pressure else replace(scene.soil, ambient_pressure=0.0)
        return float(elastic.cone_force(scene.cone, soil, scene.tow_speed))

    def errors(found: float) -> dict[str, float]:
        return {"contact force": abs(found - exact) / abs(exact)}

    entries = [_entry(task, "whole face", f"{n} points", partial(plain, n), errors)
               for n in task.some(NODES)]  # fmt: skip
    entries.append(_entry(task, "graded cells", "", graded, errors))
    return Quadratures(tuple(entries), max(errors(check)["contact force"], float(np.finfo(float).eps)))


def _pressure(scene: Scene) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    def pressure(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(elastic.cone_pressure(x, scene.cone, scene.soil, scene.tow_speed))

    return pressure


def _edges(
    pressure: Callable[[NDArray[np.float64]], NDArray[np.float64]], ambient: float, height: float
) -> list[float]:
    """Return the ends of the face, and the places between at which contact is lost or taken up again."""
    from scipy.optimize import brentq  # slow to import

    x = height * (1.0 - np.cos(np.linspace(1e-5, math.pi - 1e-5, 2001))) / 2.0
    total = pressure(x) + ambient
    places = [
        float(brentq(lambda place: float(pressure(np.array([place]))[0]) + ambient, x[k], x[k + 1], xtol=1e-17))
        for k in np.flatnonzero(total[:-1] * total[1:] < 0.0)
    ]
    return [0.0, *places, height]


def _double_exponential(
    integrand: Callable[[NDArray[np.float64]], NDArray[np.float64]], edges: list[float], level: int
) -> float:
    """Return an integral, singular at the edges, by the rule of Takahasi and Mori (1974), step 2^-level."""
    step = 2.0**-level
    t = step * np.arange(-math.floor(3.0 / step), math.floor(3.0 / step) + 1)
    part = 1.0 / (1.0 + np.exp(-math.pi * np.sinh(t)))
    weight = step * math.pi * np.cosh(t) * part * (1.0 - part)
    total = 0.0
    for low, high in itertools.pairwise(edges):
        total += (high - low) * float(weight @ integrand(low + (high - low) * part))
    return total
