"""Expressions of a design at numbers, with every run inside them integrated anew and tightly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import IntegrationError
from plough_opt.core.labels import Call, Limit
from plough_opt.design.split import split
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.embedding import with_numbers
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.plan import checked, kink_of, most_steps, phase, suited
from plough_opt.motion.run import Run, assemble
from plough_opt.motion.scene import Scene
from plough_opt.motion.signals import signals
from plough_opt.motion.timeline import Timeline

Vector = NDArray[np.float64]

TIGHT = 1e-12
"""Relative error that the re-integration aims at."""


_Tight: TypeAlias = Callable[[Integration, tuple[float, ...], bool], Vector]

# Runs at numbers that an evaluation remembers: those of a design over some hundred samples at a few points, and checks.
_MOST_KEPT: Final = 4096


class TightEvaluation:
    """Expressions of symbols as functions of numbers, through runs that are re-integrated tightly.

    Attributes:
        runs: the runs in the expressions.
        limits: the limits of theories that the expressions rest on, with what must stay within them.
    """

    def __init__(
        self,
        expressions: Sequence[ca.MX],
        symbols: Sequence[ca.MX],
        *,
        beside: TightEvaluation | None = None,
    ) -> None:
        """Split expressions around their runs.

        Args:
            expressions: the expressions.
            symbols: that they hold.
            beside: another evaluation, whose runs are not integrated again where this one has the same.
        """
        self._tight: _Tight = lru_cache(maxsize=_MOST_KEPT)(_tight_results) if beside is None else beside._tight
        parts = split(list(expressions), list(symbols))
        self.runs = parts.runs
        self._inputs = [ca.Function("inputs", list(symbols), [run.inputs, run.quantities]) for run in parts.runs]
        limits: dict[Limit, list[ca.MX]] = {}
        # Scenes that are not integrated, and laws, each with what gives its quantities.
        self._scenes: list[tuple[Scene, ca.Function]] = []
        self._calls: list[tuple[Call, ca.Function]] = []
        for label, carried in parts.labels:
            quantities = ca.Function("quantities", list(symbols), [ca.densify(ca.vec(carried))])
            if isinstance(label.meaning, Limit):
                limits.setdefault(label.meaning, []).append(carried)
            elif isinstance(label.meaning, Scene):
                self._scenes.append((label.meaning, quantities))
            elif isinstance(label.meaning, Call):
                self._calls.append((label.meaning, quantities))
        self.limits = {limit: ca.vertcat(*limits[limit]) for limit in sorted(limits, key=lambda limit: limit.name)}
        self._algebra = ca.Function("algebra", [*symbols, *parts.results], list(parts.expressions))

    def inputs(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Scene]:
        """Return a run's parameters, the duration last, and its scene at numbers.

        Raises:
            DomainError: the scene lies outside the model's domain.
        """
        parameters, quantities = self._numbers(run, numbers)
        return parameters, with_numbers(self.runs[run].embedding.template, quantities.tolist())

    def parameters(self, run: int, numbers: Sequence[float]) -> Vector:
        """Return a run's parameters, the duration last, at numbers."""
        return self._numbers(run, numbers)[0]

    def _numbers(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Vector]:
        """Return a run's parameters and its scene's quantities at numbers."""
        parameters, quantities = (result.full().ravel() for result in self._inputs[run](*map(float, numbers)))
        return parameters, quantities

    def quasi_static_scenes(self, numbers: Sequence[float]) -> list[Scene]:
        """Return the scenes at numbers that the expressions hold and that are not integrated.

        Raises:
            DomainError: a scene lies outside the model's domain.
        """
        return [with_numbers(template, quantities(*numbers).nonzeros()) for template, quantities in self._scenes]

    def check_calls(self, numbers: Sequence[float]) -> None:
        """Refuse numbers that lead a law in the expressions beyond its domain.

        Raises:
            DomainError: they do.
        """
        for call, quantities in self._calls:
            call.check(quantities(*numbers).nonzeros())

    def followed(self, run: int, parameters: Vector, scene: Scene) -> Run:
        """Return a run from a start, as it was re-integrated.

        Args:
            run: its number.
            parameters: its parameters, the duration last: see `inputs`.
            scene: its scene.
        """
        own = self.runs[run].integration
        stacked = self._tight(own, tuple(parameters.tolist()), False)
        outputs, observed = own.timeline.outputs + 1, signals(own.structure)
        states, means, variances = np.split(stacked, [-observed.count - observed.squared, -observed.squared])
        states = states.reshape(outputs, -1)
        fractions = own.timeline.output_fractions
        return assemble(scene, float(parameters[-1]), fractions, states, means, variances, Accuracy(error=TIGHT))

    def __call__(self, numbers: Sequence[float]) -> tuple[list[Vector], list[Vector]]:
        """Return the expressions' values, and the same by the method that checks the integration.

        Raises:
            DomainError: a run has no finite result at these numbers, which lie outside the model's domain.
            IntegrationError: the same, within it.
        """
        return self.values(numbers), self.values(numbers, check=True)

    def values(self, numbers: Sequence[float], *, check: bool = False) -> list[Vector]:
        """Return the expressions' values, or the same by the method that checks the integration.

        Raises:
            DomainError: a run has no finite result at these numbers, which lie outside the model's domain.
            IntegrationError: the same, within it.
        """
        results = []
        for k, run in enumerate(self.runs):
            parameters, _ = self._numbers(k, numbers)
            results.append(self._tight(run.integration, tuple(parameters.tolist()), check))
            if not np.all(np.isfinite(results[-1])):
                _, scene = self.inputs(k, numbers)
                raise IntegrationError(f"the motion of a {scene.describe()} has no finite result")
        return [np.asarray(result) for result in self._algebra.call([*map(ca.DM, numbers), *results])]


def _tight_results(own: Integration, inputs: tuple[float, ...], check: bool) -> Vector:
    """Return a run's stacked results at numbers by a tight adaptive method, or by the one that checks it.

    Args:
        own: how the run was written in the design; only its structure and output times are kept.
        inputs: its parameters, the duration last.
        check: whether the method that checks is asked for.
    """
    p, duration = dict(zip(own.names, inputs[:-1], strict=True)), inputs[-1]
    total = phase(p, duration)
    outputs, kink = own.timeline.outputs, kink_of(p.get("ramp_time", 0.0), duration)
    accuracy = checked(suited(own.structure, total)[0], TIGHT, p, duration)[int(check)]
    timeline = Timeline(outputs, accuracy.steps or most_steps(total), kink, aligned=False)
    # Steps of order 8 in machine code, where there is a compiler, give the same numbers.
    by_code = own.structure.stepped and accuracy.order_8
    code = compiled_steps(own.structure) if by_code else None
    parts: Sequence[Vector] | None = None if code is None else code(timeline, list(inputs))
    if parts is None:
        function = integration(own.structure, accuracy, timeline).function
        parts = [np.asarray(part).T for part in function.call([ca.DM(inputs)])]
    return np.concatenate([part.ravel() for part in parts])
