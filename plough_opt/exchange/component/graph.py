"""A scene of symbols as one Function of its inputs: small scalar graphs around one loop over steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from plough_opt.core.expressions import Expression
from plough_opt.motion import Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.plan import timeline_of
from plough_opt.motion.quasi_static import quasi_static
from plough_opt.motion.run import assemble
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters
from plough_opt.motion.timeline import Timeline

OfColumn = Callable[[Sequence[Expression]], tuple[Scene, Expression]]
"""Inputs in order, numbers or symbols -> scene and duration [s]."""

Results = Sequence[Callable[[Run], Expression]]

GAUSS_POINTS = 10
"""Nodes in each panel of a quasi-static average."""


@dataclass(frozen=True)
class Resolution:
    """How finely a run is resolved.

    Attributes:
        steps: of order 8, or panels of a quasi-static average.
        outputs: equal intervals between output times.
        points: nodes in a panel.
    """

    steps: int
    outputs: int
    points: int = GAUSS_POINTS

    def finer(self, motion: bool) -> Resolution:
        """Return a finer resolution, whose results check those of this one."""
        return replace(self, steps=2 * self.steps) if motion else replace(self, points=self.points + 6)


def graph(name: str, arguments: Sequence[str], make: OfColumn, results: Results, resolution: Resolution) -> ca.Function:
    """Return results of a run as a Function of the inputs, each a dense column.

    Args:
        name: the Function's name.
        arguments: names of the inputs.
        make: the scene of inputs.
        results: of a symbolic run, a scalar or a column each.
        resolution: steps and outputs.
    """
    scene, duration = make([ca.SX.sym(argument) for argument in arguments])
    # A law with large sums or loops is one node of MX.
    kind: Any = ca.SX if scene.law.scalar else ca.MX
    x = [kind.sym(argument) for argument in arguments]
    scene, duration = make(x)
    timeline = _timeline(scene, duration, resolution)
    if not scene.effects.motion:
        run = quasi_static(scene, duration, timeline, Accuracy(), resolution.points)
        return ca.Function(name, x, _columns(run, results, kind))
    solver, given = _integrated(scene, duration, x, timeline)
    accuracy, moved = solver.accuracy, solver.function
    states, means, variances = of_run = [kind.sym(f"o{k}", *moved.size_out(k)) for k in range(moved.n_out())]
    run = assemble(scene, duration, timeline.output_fractions, states.T, means, variances, accuracy)
    around = ca.Function("results", [*x, *of_run], _columns(run, results, kind))
    symbols = [ca.MX.sym(argument) for argument in arguments]
    return ca.Function(name, symbols, around.call([*symbols, *moved.call([given(*symbols)])]))


def motion(arguments: Sequence[str], make: OfColumn, resolution: Resolution) -> tuple[Integration, ca.Function]:
    """Return the integration of a run, and its parameters, the duration last, as a Function of a column of inputs."""
    inputs: Any = ca.SX.sym("inputs", len(arguments))
    scene, duration = make(ca.vertsplit(inputs))
    if not scene.law.scalar:
        inputs = ca.MX.sym("inputs", len(arguments))
        scene, duration = make(ca.vertsplit(inputs))
    return _integrated(scene, duration, [inputs], _timeline(scene, duration, resolution))


def _timeline(scene: Scene, duration: Expression, resolution: Resolution) -> Timeline:
    """Return the times of a run of symbols."""
    # With outputs at its two ends alone none lies between steps.
    method: str | None = "dop853" if scene.effects.motion and resolution.outputs > 1 else None
    return timeline_of(scene, duration, resolution.outputs, resolution.steps, method, symbolic=True)


def _integrated(
    scene: Scene, duration: Expression, inputs: Sequence[Any], timeline: Timeline
) -> tuple[Integration, ca.Function]:
    """Return the integration of a run of symbols, and its parameters as a Function of these."""
    solver = integration(Structure.of(scene), Accuracy("dop853", steps=timeline.steps), timeline)
    p = parameters(scene)
    given = ca.vertcat(*(p[key] for key in solver.names), duration)
    return solver, ca.Function("parameters", list(inputs), [given])


def _columns(run: Run, results: Results, kind: Any) -> list[Any]:
    return [ca.densify(ca.vec(kind(result(run)))) for result in results]
