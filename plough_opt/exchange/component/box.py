"""The box between a component's bounds: checks the scenes in it, and finds the number of steps that they all need."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError, IntegrationError
from plough_opt.core.expressions import Expression, as_number
from plough_opt.core.quantities import BESIDE
from plough_opt.exchange.component.graph import Resolution, Results, graph, motion
from plough_opt.exchange.component.ports import Port, corners, inside
from plough_opt.motion.accuracy import DEFAULT_ERROR, Accuracy
from plough_opt.motion.causes import refuse_runaway
from plough_opt.motion.derivative_error import derivative_error
from plough_opt.motion.plan import forced_rate, numbers_of, phase, steps_for
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT

Make = Callable[[Mapping[str, Expression]], tuple[Scene, Expression | None]]
"""Values of the inputs by name, numbers or symbols -> scene and duration [s]."""

# Phase [rad] of the fastest oscillation in a step, and in a panel of a quasi-static average; more steps if these fail.
_PHASE_PER_STEP, _PHASE_PER_PANEL = 0.8, 4.0
_MOST_STEPS = 50_000
_ROUNDS = 6
# Least force to which errors are related, as a part of V0 sqrt(k0 M).
_LEAST_FORCE = 1e-9
_RETREAT = 1e-6
# Results that are checked at points of the box; _SCALE is V0 sqrt(k0 M).
_DRAFT, _RMS, _FORCE, _SPEED, _SCALE, _HALF_ANGLE = range(6)
_CHECKED: Results = (
    lambda run: run.mean_draft,
    lambda run: run.force_rms,
    lambda run: run.mount_force,
    lambda run: run.speed,
    lambda run: run.scene.tow_speed * (run.scene.stiffness * run.scene.inertia) ** 0.5,
    lambda run: run.scene.cone.half_angle,
)


@dataclass(frozen=True)
class Resolved:
    """A resolution, the error that it leaves, and warnings."""

    resolution: Resolution
    error: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Box:
    """Inputs with their bounds, and the scenes between these.

    Raises:
        InputError: a scene that fixed steps cannot integrate, or one without a duration.
        DomainError: bounds outside the model's domain.
    """

    inputs: tuple[Port, ...]
    make: Make
    name: str

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
        return self._at(np.array([port.value for port in self.inputs]))[0]

    def make_of_column(self, x: Sequence[Expression]) -> tuple[Scene, Expression]:
        """Return scene and duration of inputs in order.

        Raises:
            InputError: no duration, or one for an orbit.
        """
        scene, duration = self.make({port.name: value for port, value in zip(self.inputs, x, strict=True)})
        if scene.effects.orbit == "transient":
            if duration is None:
                raise InputError("the duration is missing: how long shall the scene be simulated, in seconds?")
            BESIDE["scene.duration"].check(duration)
            return scene, duration
        if duration is not None:
            raise InputError("a lasting orbit has a duration of its own, one wavelength of the soil: leave it out")
        return scene, scene.wave_period

    def _at(self, x: NDArray[np.float64]) -> tuple[Scene, float]:
        scene, duration = self.make_of_column([float(value) for value in x])
        return scene, float(as_number(duration))

    def _place(self, x: NDArray[np.float64]) -> str:
        return ", ".join(
            f"{port.name} = {value:.6g} {port.unit}".rstrip() for port, value in zip(self.inputs, x, strict=True)
        )

    def sizes(self, results: Results) -> list[int]:
        """Return the number of values of each result in a run with two output times."""
        function = self._graph(results, Resolution(1, 1))
        return [function.numel_out(k) for k in range(function.n_out())]

    def _graph(self, results: Results, resolution: Resolution) -> ca.Function:
        return graph(self.name, [port.argument for port in self.inputs], self.make_of_column, results, resolution)

    def resolved(self, accuracy: Accuracy, outputs: int) -> Resolved:
        """Return the number of steps that reaches an error between the bounds, or the one in `accuracy`, and its error.

        Args:
            accuracy: the error to reach, or the number of steps.
            outputs: number of intervals between output times.
        """
        wanted = accuracy.error or DEFAULT_ERROR
        effects = self.scene.effects
        moves = effects.motion
        # A draft that does not vary in time has no error of steps or panels.
        varies = moves or bool(effects.waves) or effects.tow_ramp is not None or effects.own
        points = [*corners(self.inputs), *(inside(self.inputs) if varies else ())]
        needed = self._steps(corners(self.inputs), _MOST_STEPS if accuracy.steps is None else math.inf)
        steps = accuracy.steps or needed
        for _ in range(_ROUNDS):
            resolution = Resolution(steps, outputs)
            coarse, fine = (self._evaluated(points, one, moves) for one in (resolution, resolution.finer(moves)))
            error = max(_difference(*pair) for pair in zip(coarse, fine, strict=True))
            if error <= wanted or accuracy.steps is not None or 2 * steps > _MOST_STEPS:
                break
            steps = _more(steps, error, wanted)
        resolution, doubts = self._resolved_derivatives(points, resolution, accuracy)
        return Resolved(resolution, error, (*self._warnings(points, fine), *_missed(error, wanted), *doubts))

    def _resolved_derivatives(
        self, points: Sequence[NDArray[np.float64]], resolution: Resolution, accuracy: Accuracy
    ) -> tuple[Resolution, tuple[str, ...]]:
        """Return a resolution that derivatives need too, and a warning if they miss the wanted error."""
        if not self.scene.effects.motion:
            return resolution, ()
        wanted = accuracy.wanted_derivatives
        for _ in range(_ROUNDS):
            error = self._derivative_error(points, resolution)
            if error <= wanted:
                return resolution, ()
            steps = _more(resolution.steps, error, wanted)
            if accuracy.steps is not None or 2 * steps > _MOST_STEPS:
                break
            resolution = replace(resolution, steps=steps)
        return resolution, (f"the wanted error {wanted:.1e} of derivatives was not reached: it is {error:.1e}",)

    def _derivative_error(self, points: Sequence[NDArray[np.float64]], resolution: Resolution) -> float:
        """Return the largest error of the motion's derivatives at points."""
        solver, given = motion([port.argument for port in self.inputs], self.make_of_column, resolution)
        varying = tuple(sorted(set(given.jac_sparsity(0, 0).row())))
        p = np.hstack([given(x).full() for x in points])
        # Without output times between the ends only the averages matter.
        first = solver.function.numel_out(0) if resolution.outputs == 1 else 0
        return derivative_error(solver, first, varying, p)

    def _steps(self, points: Sequence[NDArray[np.float64]], limit: float) -> int:
        """Return the number of steps, or panels, that the fastest of some scenes needs.

        Raises:
            DomainError: a scene outside the model's domain, or one that needs more steps than the limit.
        """
        most = 0
        for x in points:
            try:
                scene, duration = self._at(x)
                scene.check_reaction()
                refuse_runaway(scene, duration)
            except (DomainError, IntegrationError) as error:
                raise DomainError(f"at {self._place(x)}: {error}; give the inputs narrower bounds") from None
            p = numbers_of(scene)
            if scene.effects.motion:
                most = max(most, steps_for(phase(p, duration), _PHASE_PER_STEP))
            else:
                most = max(most, steps_for(forced_rate(p) * duration, _PHASE_PER_PANEL))
            if most > limit:
                raise DomainError(
                    f"at {self._place(x)} the share oscillates so fast that the run would take {most} steps: narrow the"
                    " bounds on stiffness and mass, shorten the duration, or use the quasi-static scene"
                )
        return most

    def _evaluated(
        self, points: Sequence[NDArray[np.float64]], resolution: Resolution, moves: bool
    ) -> list[list[NDArray[np.float64]]]:
        """Return the results that are checked, at points."""
        function = self._graph(_CHECKED, resolution)
        results = [[value.full().ravel() for value in function.call(list(x))] for x in points]
        for x, values in zip(points, results, strict=True):
            if not all(np.all(np.isfinite(value)) for value in values):
                raise DomainError(
                    f"the {'motion' if moves else 'draft'} has no finite value at {self._place(x)}: give the inputs"
                    " narrower bounds"
                )
        return results

    def _warnings(
        self, points: Sequence[NDArray[np.float64]], results: Sequence[Sequence[NDArray[np.float64]]]
    ) -> tuple[str, ...]:
        """Return warnings: of the scene at the inputs' values, and of those between the bounds."""
        notes = list(self.scene.warnings())
        bluntest = max(float(values[_HALF_ANGLE][0]) for values in results)
        said = any("plane sections" in note for note in notes)
        if self.scene.law.slender and bluntest > PLANE_SECTIONS_LIMIT and not said:
            notes.append(
                f"within the bounds the half angle reaches {math.degrees(bluntest):.1f} deg: above"
                f" {math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg the hypothesis of plane sections does not hold"
            )
        slowest = min(range(len(points)), key=lambda k: float(np.min(results[k][_SPEED])))
        speed = results[slowest][_SPEED]
        if float(np.min(speed)) < -_RETREAT * float(np.max(np.abs(speed))):
            notes.append(
                f"within the bounds the share retreats, as at {self._place(points[slowest])} at up to"
                f" {-float(np.min(speed)):.3g} m/s, and this contact law ignores the gap that it leaves"
            )
        if self.scene.effects.orbit not in ("transient", "periodic"):
            notes.append("an approximation of the lasting orbit, whose own error is not in the error estimate")
        return tuple(notes)


def _more(steps: int, error: float, wanted: float) -> int:
    """Return the number of steps, at most twice as many, that a method of order 8 needs for a smaller error."""
    factor: float = min(2.0, 1.1 * (error / wanted) ** 0.125)
    return math.ceil(steps * factor)


def _missed(error: float, wanted: float) -> tuple[str, ...]:
    if error <= wanted:
        return ()
    return (f"the wanted relative error {wanted:.1e} was not reached: the estimate is {error:.1e}",)


def _difference(coarse: Sequence[NDArray[np.float64]], fine: Sequence[NDArray[np.float64]]) -> float:
    """Return the largest relative difference of mean draft and RMS, and of the mount force at the outputs."""
    least = _LEAST_FORCE * float(fine[_SCALE][0])
    size = max(abs(float(fine[_DRAFT][0])), float(fine[_RMS][0]), least)
    peak = max(float(np.max(np.abs(fine[_FORCE]))), least)
    pairs = ((_DRAFT, size), (_RMS, size), (_FORCE, peak))
    differences = (float(np.max(np.abs(coarse[k] - fine[k]))) / scale for k, scale in pairs if scale > 0.0)
    return max(differences, default=0.0)
