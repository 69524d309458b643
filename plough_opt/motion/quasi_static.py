"""The quasi-static limit: the share follows the strut rigidly, and no equation of motion is solved."""

from functools import partial

import casadi as ca
import numpy as np

from plough_opt.core.expressions import Expression, column, holds_casadi, is_casadi, rms
from plough_opt.core.labels import unlabelled
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.averages import Averages
from plough_opt.motion.breaks import ends
from plough_opt.motion.effects import ramp_time
from plough_opt.motion.embedding import labelled
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters, resistance, start_speed, strut
from plough_opt.motion.timeline import Timeline

GAUSS_POINTS = 10
"""Gauss-Legendre nodes in each panel of the averages of a numeric run."""

MORE_POINTS = 6
"""How many more nodes check them."""

SYMBOLIC_GAUSS_POINTS = 4
"""The same in a symbolic run, whose graph grows with them."""

# Exact for the square of a ramp's force, a polynomial of degree 20, in however few panels the ramp lies.
_RAMP_GAUSS_POINTS = 11


def quasi_static(
    scene: Scene, duration: Expression, timeline: Timeline, accuracy: Accuracy, points: int = GAUSS_POINTS
) -> Run:
    """Return the run of a share that moves with the strut: P = F0 (1 + eps sin(2 pi s/ell)) + Fd s'^2, z = P/k0.

    Averages are composite Gauss-Legendre quadratures over the timeline's steps.
    """
    p = parameters(scene)
    inner, shares = _quadrature(timeline, points, duration, ramp_time(p) if "ramp_time" in p else 0.0)
    p["static"] = labelled(p["static"], scene)
    course = partial(_course, scene, p, duration)
    time, path, speed, force = course(timeline.output_fractions)
    _, _, inner_speed, inner_force = course(inner)
    # From the first value on: where nothing varies the rounding of the weights then makes no variance.
    change = inner_force - inner_force[0]
    mean_change = _average(change, shares)
    mean_draft = inner_force[0] + mean_change
    variance = _average((change - mean_change) ** 2, shares)
    with unlabelled():
        force_rms = rms(variance, scene.steady_resistance)
    stiffness = scene.stiffness
    return Run(
        scene=scene,
        duration=duration,
        time=time,
        travel=path,
        speed=speed,
        deflection=force / stiffness,
        mount_force=force,
        soil_resistance=force,
        opening=0.0 * force + 0.0,
        mode=0.0 * force + 0.0,
        averages=Averages(
            mean_draft=mean_draft,
            force_rms=force_rms,
            mean_deflection=mean_draft / stiffness,
            displacement_rms=force_rms / stiffness,
            tow_power=_average(inner_force * inner_speed, shares),
        ),
        accuracy=accuracy,
    )


def _quadrature(
    timeline: Timeline, points: int, duration: Expression, ramp: Expression
) -> tuple[Expression, Expression]:
    """Return nodes and weights of an average over the timeline's steps, as fractions of the duration."""
    points = max(points, _RAMP_GAUSS_POINTS) if timeline.moving else points
    nodes, weights = np.polynomial.legendre.leggauss(points)
    if timeline.moving:
        a, b = ends(timeline, duration, ramp)
        at = a + b * (ramp / duration)
        starts, sizes = at[:-1], at[1:] - at[:-1]
        rows = [starts + sizes * ((node + 1.0) / 2.0) for node in nodes]
        return ca.vertcat(*rows), ca.vertcat(*(sizes * (weight / 2.0) for weight in weights))
    sizes = np.diff(timeline.nodes)[:, None]
    inner = timeline.nodes[:-1, None] + sizes * (nodes + 1.0) / 2.0
    return inner.ravel(), (sizes * weights / 2.0).ravel()


def _course(
    scene: Scene, p: dict[str, Expression], duration: Expression, fractions: Expression
) -> tuple[Expression, Expression, Expression, Expression]:
    """Return time [s], path [m], speed [m/s] and resistance [N] at fractions of the duration."""
    structure = Structure.of(scene)
    known = not isinstance(fractions, np.ndarray)
    time = (fractions if known else column(fractions, holds_casadi((scene, duration)))) * duration
    mount = strut(structure, p, time)
    force = resistance(structure, p, mount.path, start_speed(structure, p) + mount.gain)
    everywhere = 0.0 * time
    return (
        time,
        mount.path + everywhere,
        start_speed(structure, p) + mount.gain + everywhere,
        force + everywhere,
    )


def _average(values: Expression, shares: Expression) -> Expression:
    if not is_casadi(values):
        return float(shares @ values)
    return ca.dot(ca.DM(shares) if isinstance(shares, np.ndarray) else shares, values)
