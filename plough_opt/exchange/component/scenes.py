"""Scenes made from a component's inputs, and CasADi Functions of their results.

Each Function consists of small scalar graphs around one loop over the integration steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.checks import Limit
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, stacked
from plough_opt.core.labels import limits_of_laws
from plough_opt.core.quantities import BESIDE
from plough_opt.exchange.component.ports import Port
from plough_opt.motion import Run
from plough_opt.motion.equation import Structure, parameters
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.plan import timeline_of
from plough_opt.motion.run import assemble
from plough_opt.motion.scene import Scene
from plough_opt.motion.simulation import quasi_static
from plough_opt.motion.steps import Timeline

MakeScene = Callable[[Mapping[str, Expression]], tuple[Scene, Expression | None]]
"""Values of the inputs by name, numbers or symbols -> scene and duration [s] or None."""

Results = Mapping[str, Callable[[Run], Expression]]
"""Name of each result -> its value in a symbolic run, a scalar or a column."""

GAUSS_POINTS = 10
"""Quadrature nodes in each panel of a quasi-static average."""

_MORE_POINTS = 6
"""Further nodes for a finer quadrature, whose result checks the coarser one."""


@dataclass(frozen=True)
class Resolution:
    """How finely a run is resolved.

    Attributes:
        steps: number of steps of order 8, or of panels of a quasi-static average.
        outputs: number of equal intervals between output times.
        points: number of quadrature nodes in a panel.
    """

    steps: int
    outputs: int
    points: int = GAUSS_POINTS

    def finer(self, motion: bool) -> Resolution:
        """Return a finer resolution, whose results check those of this one."""
        return replace(self, steps=2 * self.steps) if motion else replace(self, points=self.points + _MORE_POINTS)


@dataclass(frozen=True)
class Scenes:
    """The scenes that a component's inputs describe.

    Attributes:
        name: name of every Function made here.
        inputs: names, units, bounds and values.
        make: values of the inputs -> scene and duration.

    Raises:
        InputError: a scene that fixed steps cannot integrate, or one without a duration.
    """

    name: str
    inputs: tuple[Port, ...]
    make: MakeScene

    def __post_init__(self) -> None:
        effects = self.scene.effects
        if effects.events:
            what = "a share that enters the soil" if effects.entry else "stick and slip"
            raise InputError(
                f"{what} cannot be a component: its events need an adaptive integrator, and a component's steps are"
                " fixed; use contact = Smooth(width) and no entry, or simulate the scene itself"
            )

    @cached_property
    def scene(self) -> Scene:
        """The scene at the inputs' values."""
        return self.at([port.value for port in self.inputs])[0]

    def at(self, x: Sequence[Expression]) -> tuple[Scene, Expression]:
        """Return scene and duration at values of the inputs, given in order.

        Raises:
            InputError: the duration is missing, or it is given for a periodic orbit.
        """
        scene, duration = self.make({port.name: value for port, value in zip(self.inputs, x, strict=True)})
        if scene.effects.orbit == "transient":
            if duration is None:
                raise InputError("the duration is missing: give the time to simulate, in seconds")
            BESIDE["scene.duration"].check(duration)
            return scene, duration
        if duration is not None:
            raise InputError("a periodic orbit lasts one wavelength of the soil strength: leave the duration out")
        return scene, scene.wave_period

    def at_numbers(self, x: Iterable[float]) -> tuple[Scene, float]:
        """Return the numeric scene and duration at numeric values of the inputs, given in order."""
        scene, duration = self.at([float(value) for value in x])
        return scene, float(as_number(duration))

    @cached_property
    def _symbolic(self) -> tuple[Any, list[Any], Scene, Expression]:
        """Return the CasADi type, a symbol of it for each input, and the scene and duration of these symbols."""
        # In MX a law with large sums or loops stays one node; SX would unroll it.
        kind: Any = ca.SX if self.scene.law.scalar else ca.MX
        x = [kind.sym(port.argument) for port in self.inputs]
        return kind, x, *self.at(x)

    def function(self, results: Results, resolution: Resolution) -> ca.Function:
        """Return results of a run, each a dense column, as a Function of the inputs.

        Inputs that a caller omits have their values.

        Args:
            results: the results by name.
            resolution: steps and outputs.
        """
        kind, x, scene, duration = self._symbolic
        arguments, names = [port.argument for port in self.inputs], list(results)
        options = {"default_in": [port.value for port in self.inputs]}

        def columns(run: Run) -> list[Any]:
            return [ca.densify(ca.vec(kind(result(run)))) for result in results.values()]

        if not scene.effects.motion:
            run = quasi_static(scene, duration, self._timeline(resolution), Accuracy(), resolution.points)
            return ca.Function(self.name, x, columns(run), arguments, names, options)
        # Three Functions are chained: inputs -> parameters -> motion (the loop over the steps) -> results.
        solver, parameters_of = self.motion(resolution)
        integrate = solver.function
        motion = [kind.sym(f"o{k}", *integrate.size_out(k)) for k in range(integrate.n_out())]
        states, means, variances = motion
        fractions = solver.timeline.output_fractions
        run = assemble(scene, duration, fractions, states.T, means, variances, solver.accuracy)
        results_of = ca.Function("results", [*x, *motion], columns(run))
        symbols = [ca.MX.sym(argument) for argument in arguments]
        values = results_of.call([*symbols, *integrate.call(parameters_of.call(symbols))])
        return ca.Function(self.name, symbols, values, arguments, names, options)

    def domain(self) -> tuple[tuple[Limit, ...], ca.Function]:
        """Return the limits of the law of resistance, and a Function from the inputs to the limited values."""
        kind, x, _, _ = self._symbolic
        with limits_of_laws() as found:
            self.at(x)[0].check_reaction()
        column = ca.vertcat(kind(), *(value for _, value in found))
        return tuple(limit for limit, _ in found), ca.Function("domain", x, [column])

    def gives_columns(self, results: Results) -> bool:
        """Return whether any result is a column over the output times."""
        # The shortest run has two output times, at start and end: a result with a value at each has two rows.
        function = self.function(results, Resolution(1, 1))
        return any(function.numel_out(k) > 1 for k in range(function.n_out()))

    def motion(self, resolution: Resolution) -> tuple[Integration, ca.Function]:
        """Return the integration of a run, and a Function from the inputs to its parameters, the duration last."""
        _, x, scene, duration = self._symbolic
        timeline = self._timeline(resolution)
        solver = integration(Structure.of(scene), Accuracy("dop853", steps=timeline.steps), timeline)
        p = parameters(scene)
        return solver, ca.Function("parameters", x, [stacked(*(p[key] for key in solver.names), duration)])

    def _timeline(self, resolution: Resolution) -> Timeline:
        """Return the times of a run of symbols."""
        _, _, scene, duration = self._symbolic
        # Outputs at start and end alone need no interpolation between steps.
        method: str | None = "dop853" if scene.effects.motion and resolution.outputs > 1 else None
        return timeline_of(scene, duration, resolution.outputs, resolution.steps, method, symbolic=True)
