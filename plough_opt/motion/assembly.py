"""Assembly of a `Run` from an integrated motion, or from the quasi-static limit."""

from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.expressions import Column, Expression, column, holds_casadi, is_casadi, rms, where
from plough_opt.core.labels import unlabelled
from plough_opt.motion import terms
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.averages import Averages
from plough_opt.motion.effects import ramp_time
from plough_opt.motion.effects.term import Parameters
from plough_opt.motion.embedding import labelled
from plough_opt.motion.equation import GAP, SLIP, STICK
from plough_opt.motion.run import Run
from plough_opt.motion.runge_kutta import ends
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure
from plough_opt.motion.timeline import Timeline

GAUSS_POINTS = 10
"""Gauss-Legendre nodes in each panel, for the averages of a numeric quasi-static run."""

MORE_POINTS = 6
"""Additional nodes in each panel of the checking run."""

SYMBOLIC_GAUSS_POINTS = 4
"""Gauss-Legendre nodes in each panel of a symbolic run, whose graph grows with them."""

# Exact for the square of a ramp's force, a polynomial of degree 20, even if the ramp lies within one panel.
_RAMP_GAUSS_POINTS = 11


def assemble(
    scene: Scene,
    duration: Expression,
    fractions: NDArray[np.float64],
    states: Column,
    means: Column,
    variances: Column,
    accuracy: Accuracy,
    known: tuple[Structure, Parameters] | None = None,
) -> Run:
    """Return the run that belongs to integrated changes since the start.

    Args:
        scene: the scene, numeric or symbolic.
        duration: simulated time [s].
        fractions: output times as fractions of the duration.
        states: states (w, w', ...) in columns, a row for each output.
        means: means of the signals of `plough_opt.motion.equation`.
        variances: mean squares about the mean of those signals that have an RMS.
        accuracy: method and setting used.
        known: structure and parameters of the scene, if they have been computed before.
    """
    structure, p = known or (Structure.of(scene), terms.parameters(scene))
    if structure.entry:
        p = {**p, "behind": states[:, 2], "entered": states[:, 4]}
    time = column(fractions, is_casadi(states)) * duration
    w, rate = states[:, 0], states[:, 1]
    strut, initial_speed = terms.strut(structure, p, time), terms.start_speed(structure, p)
    gain = strut.gain - rate
    first = terms.start_force(structure, p)
    deflection = first / p["stiffness"] + w
    travel = strut.path - deflection
    force = first + terms.pull(structure, p, w, rate)
    soil = terms.resistance(structure, p, travel, initial_speed + gain)
    acceleration = (force - soil) / terms.inertia_at(structure, p, travel)
    carried = terms.carried_mass(structure, p, travel) if structure.events else _added_mass(scene)
    soil = soil + carried * acceleration
    speed, opening = initial_speed + gain, 0.0 * w + 0.0
    mode = opening
    if structure.sticks:
        opening, mode = states[:, 2], states[:, 3]
        if not is_casadi(mode):
            # An implicit method solves for the mode too, which leaves rounding errors in it.
            mode = np.round(mode)
        speed = where((mode - STICK) ** 2 < (SLIP - STICK) ** 2 / 4.0, 0.0, speed)
        soil = where(mode < (SLIP + STICK) / 2.0, soil, where(mode < (STICK + GAP) / 2.0, force, 0.0))
    averages = averages_of(scene, structure, p, first, means, variances)
    return Run(scene, duration, time, travel, speed, deflection, force, soil, opening, mode, averages, accuracy)


def _added_mass(scene: Scene) -> Expression:
    """Return the added mass [kg] without a label, for the run is checked together with its scene."""
    with unlabelled():
        return scene.reaction.added_mass


def averages_of(
    scene: Scene, structure: Structure, p: Parameters, first: Expression, means: Column, variances: Column
) -> Averages:
    """Return the averages of a run from its first force [N] and those of its changes since then: see `assemble`."""
    with unlabelled():
        scale = scene.steady_resistance
    displacement_rms = rms(variances[0], scale / scene.stiffness)
    if structure.damper:
        mean_draft = first + terms.pull(structure, p, 0.0, terms.start_rate(structure, p)) + means[1]
        force_rms = rms(variances[1], scale)
    else:
        mean_draft = first + p["stiffness"] * means[0]
        force_rms = scene.stiffness * displacement_rms
    mean_deflection = first / p["stiffness"] + means[0]
    tow_power = means[-1] if structure.ramp else mean_draft * p["tow_speed"]
    return Averages(mean_draft, force_rms, mean_deflection, displacement_rms, tow_power)


def quasi_static(
    scene: Scene, duration: Expression, timeline: Timeline, accuracy: Accuracy, points: int = GAUSS_POINTS
) -> Run:
    """Return the run of a share that follows the strut: P = F0 (1 + eps sin(2 pi s/ell)) + Fd s'^2, z = P/k0.

    Averages are composite Gauss-Legendre quadratures with a panel for each step of the timeline.
    """
    p = terms.parameters(scene)
    nodes, weights = _quadrature(timeline, points, duration, ramp_time(p) if "ramp_time" in p else 0.0)
    p["static"] = labelled(p["static"], scene)
    course = partial(_course, scene, p, duration)
    time, path, speed, force = course(timeline.output_fractions)
    _, _, node_speed, node_force = course(nodes)
    # Averages of the change since the first node: a constant force then has no variance by rounding of the weights.
    change = node_force - node_force[0]
    mean_change = _average(change, weights)
    mean_draft = node_force[0] + mean_change
    variance = _average((change - mean_change) ** 2, weights)
    with unlabelled():
        force_rms = rms(variance, scene.steady_resistance)
    stiffness, still = scene.stiffness, 0.0 * force + 0.0
    tow_power = _average(node_force * node_speed, weights)
    averages = Averages(mean_draft, force_rms, mean_draft / stiffness, force_rms / stiffness, tow_power)
    deflection = force / stiffness
    return Run(scene, duration, time, path, speed, deflection, force, force, still, still, averages, accuracy)


def _quadrature(timeline: Timeline, points: int, duration: Expression, ramp: Expression) -> tuple[Column, Column]:
    """Return quadrature nodes and weights of a time average, as fractions of the duration."""
    points = max(points, _RAMP_GAUSS_POINTS) if timeline.moving else points
    nodes, weights = np.polynomial.legendre.leggauss(points)
    if timeline.moving:
        a, b = ends(timeline, duration, ramp)
        panel_ends = a + b * (ramp / duration)
        starts, sizes = panel_ends[:-1], panel_ends[1:] - panel_ends[:-1]
        rows = [starts + sizes * ((node + 1.0) / 2.0) for node in nodes]
        return ca.vertcat(*rows), ca.vertcat(*(sizes * (weight / 2.0) for weight in weights))
    sizes = np.diff(timeline.nodes)[:, None]
    inner = timeline.nodes[:-1, None] + sizes * (nodes + 1.0) / 2.0
    return inner.ravel(), (sizes * weights / 2.0).ravel()


def _course(
    scene: Scene, p: Parameters, duration: Expression, fractions: Column
) -> tuple[Column, Column, Column, Column]:
    """Return time [s], path [m], speed [m/s] and resistance [N] at fractions of the duration."""
    structure = Structure.of(scene)
    if isinstance(fractions, np.ndarray):
        fractions = column(fractions, holds_casadi((scene, duration)))
    time = fractions * duration
    strut = terms.strut(structure, p, time)
    force = terms.resistance(structure, p, strut.path, terms.start_speed(structure, p) + strut.gain)
    everywhere = 0.0 * time
    speed = terms.start_speed(structure, p) + strut.gain
    return time, strut.path + everywhere, speed + everywhere, force + everywhere


def _average(values: Column, weights: Column) -> Expression:
    if not is_casadi(values):
        return float(weights @ values)
    mean: Expression = ca.dot(ca.DM(weights) if isinstance(weights, np.ndarray) else weights, values)
    return mean
