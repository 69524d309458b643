"""The box between a component's bounds: which scenes are valid there, and how many steps they need."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import LEAST
from plough_opt.core.errors import DomainError, PloughError
from plough_opt.exchange.component.ports import corner_points, interior_points, point_text
from plough_opt.exchange.component.scenes import Resolution, Results, Scenes
from plough_opt.motion.checks import refuse_runaway
from plough_opt.motion.derivatives import derivative_error
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.plan import forced_rate, numbers_of, phase, steps_for
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT

Values = dict[str, NDArray[np.float64]]

# The first guess of the number of steps: phase [rad] of the fastest oscillation in one step.
_PHASE_PER_STEP = 0.8
# The same for a quasi-static average: phase [rad] of the fastest oscillation in one panel.
_PHASE_PER_PANEL = 4.0
_MOST_STEPS = 50_000
# Limit on the number of times that the number of steps is raised.
_MOST_ROUNDS = 6
# Errors are relative to a force of at least this part of V0 sqrt(k0 M), which prevents a division by 0.
_LEAST_FORCE = 1e-9
# A share retreats if its speed falls below minus this part of its largest speed; less is rounding.
_RETREAT = 1e-6
# Results that are checked at points of the box. The underscore at the end keeps their names apart from the inputs'.
_CHECKED: Results = {
    "draft_": lambda run: run.mean_draft,
    "rms_": lambda run: run.force_rms,
    "force_": lambda run: run.mount_force,
    "speed_": lambda run: run.speed,
    "scale_": lambda run: run.scene.tow_speed * (run.scene.stiffness * run.scene.inertia) ** 0.5,
    "half_angle_": lambda run: run.scene.cone.half_angle,
}


@dataclass(frozen=True)
class Box:
    """The scenes between the bounds of their inputs.

    Attributes:
        scenes: makes a scene from values of the inputs.
        accuracy: the error to reach, or the number of steps.
        outputs: number of intervals between output times.
    """

    scenes: Scenes
    accuracy: Accuracy
    outputs: int

    @property
    def _moves(self) -> bool:
        return self.scenes.scene.effects.motion

    @cached_property
    def _points(self) -> list[NDArray[np.float64]]:
        """Values of the inputs at which errors are estimated."""
        effects, inputs = self.scenes.scene.effects, self.scenes.inputs
        # A draft that is constant in time has no error of steps or panels, so the corners suffice.
        varies = effects.motion or bool(effects.waves) or effects.tow_ramp is not None or effects.own
        return [*corner_points(inputs), *(interior_points(inputs) if varies else ())]

    def resolved(self) -> tuple[Resolution, float, tuple[str, ...]]:
        """Return the resolution that reaches the wanted error everywhere between the bounds, its error, and warnings.

        A number of steps in the accuracy is used as it is.

        Raises:
            DomainError: bounds outside the model's domain.
        """
        wanted, first_guess = self.accuracy.error or DEFAULT_ERROR, self._first_guess()
        steps, error = self._refined(self.accuracy.steps or first_guess, self._error, wanted)
        notes = []
        if error > wanted:
            notes.append(f"the wanted relative error {wanted:.1e} was not reached: the estimate is {error:.1e}")
        if self._moves:
            wanted = self.accuracy.wanted_derivatives
            steps, derivative_error = self._refined(steps, self._derivative_error, wanted)
            if derivative_error > wanted:
                notes.append(
                    f"the wanted error {wanted:.1e} of derivatives was not reached: it is {derivative_error:.1e}"
                )
        resolution = Resolution(steps, self.outputs)
        return resolution, error, (*self._warnings(resolution), *notes)

    def _refined(self, steps: int, error_of: Callable[[Resolution], float], wanted: float) -> tuple[int, float]:
        """Increase the number of steps until the error is as wanted; return both.

        A number of steps that the accuracy gives is used as it is, and none exceeds the limit.
        """
        error = error_of(Resolution(steps, self.outputs))
        for _ in range(_MOST_ROUNDS):
            if error <= wanted or self.accuracy.steps is not None or 2 * steps > _MOST_STEPS:
                break
            # The error of order 8 falls with the eighth power of the steps. Take a tenth more, at most twice as many.
            steps = math.ceil(steps * min(2.0, 1.1 * (error / wanted) ** 0.125))
            error = error_of(Resolution(steps, self.outputs))
        return steps, error

    def _error(self, resolution: Resolution) -> float:
        """Return the largest relative difference from a finer run, in draft, RMS, and mount force at the outputs."""
        worst = 0.0
        coarse_run, fine_run = self._evaluated(resolution), self._evaluated(resolution.finer(self._moves))
        for coarse, fine in zip(coarse_run, fine_run, strict=True):
            least = _LEAST_FORCE * float(fine["scale_"][0]) or LEAST
            size = max(abs(float(fine["draft_"][0])), float(fine["rms_"][0]), least)
            peak = max(float(np.max(np.abs(fine["force_"]))), least)
            for name, scale in (("draft_", size), ("rms_", size), ("force_", peak)):
                worst = max(worst, float(np.max(np.abs(coarse[name] - fine[name]))) / scale)
        return worst

    def _derivative_error(self, resolution: Resolution) -> float:
        """Return the largest error of the motion's derivatives."""
        solver, parameters_of = self.scenes.motion(resolution)
        varying = {row for k in range(parameters_of.n_in()) for row in parameters_of.jac_sparsity(0, k).row()}
        p = np.hstack([parameters_of.call(list(x))[0].full() for x in self._points])
        # Without output times between the ends only the averages are used: skip the states.
        first = solver.function.numel_out(0) if self.outputs == 1 else 0
        return derivative_error(solver, first, tuple(sorted(varying)), p)

    def _first_guess(self) -> int:
        """Return the number of steps, or panels, for the fastest oscillation at any corner of the bounds.

        Raises:
            DomainError: a scene outside the model's domain, or one that needs more steps than the limit.
        """
        most = 0
        for x in corner_points(self.scenes.inputs):
            where = point_text(self.scenes.inputs, x)
            try:
                scene, duration = self.scenes.at_numbers(x)
                scene.check_reaction()
                refuse_runaway(scene, duration)
            except PloughError as error:
                raise DomainError(f"at {where}: {error}; give the inputs narrower bounds") from None
            p = numbers_of(scene)
            if self._moves:
                most = max(most, steps_for(phase(p, duration), _PHASE_PER_STEP))
            else:
                most = max(most, steps_for(forced_rate(p) * duration, _PHASE_PER_PANEL))
            if self.accuracy.steps is None and most > _MOST_STEPS:
                raise DomainError(
                    f"at {where} the share oscillates so fast that the run would take {most} steps: narrow the bounds"
                    " on stiffness and mass, shorten the duration, or use the quasi-static scene"
                )
        return most

    def _evaluated(self, resolution: Resolution) -> list[Values]:
        """Return the checked results at every point.

        Raises:
            DomainError: a result is not finite.
        """
        function = self.scenes.function(_CHECKED, resolution)
        found = []
        for x in self._points:
            values = {name: value.full().ravel() for name, value in zip(_CHECKED, function.call(list(x)), strict=True)}
            if not all(np.all(np.isfinite(value)) for value in values.values()):
                what, where = "motion" if self._moves else "draft", point_text(self.scenes.inputs, x)
                raise DomainError(f"the {what} has no finite value at {where}: give the inputs narrower bounds")
            found.append(values)
        return found

    def _warnings(self, resolution: Resolution) -> tuple[str, ...]:
        """Return warnings about the scene at the inputs' values, and about those between the bounds."""
        scene, results = self.scenes.scene, self._evaluated(resolution)
        notes = list(scene.warnings())
        bluntest = max(float(values["half_angle_"][0]) for values in results)
        warned = any("plane sections" in note for note in notes)
        if scene.law.slender and bluntest > PLANE_SECTIONS_LIMIT and not warned:
            notes.append(
                f"within the bounds the half angle reaches {math.degrees(bluntest):.1f} deg: above"
                f" {math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg the hypothesis of plane sections does not hold"
            )
        lowest = [float(np.min(values["speed_"])) for values in results]
        slowest = int(np.argmin(lowest))
        if lowest[slowest] < -_RETREAT * float(np.max(np.abs(results[slowest]["speed_"]))):
            where = point_text(self.scenes.inputs, self._points[slowest])
            notes.append(
                f"within the bounds the share retreats, as at {where} at up to {-lowest[slowest]:.3g} m/s, and this"
                " contact law ignores the gap that it leaves"
            )
        if scene.effects.orbit not in ("transient", "periodic"):
            notes.append("an approximation of the periodic orbit, whose own error is not in the error estimate")
        return tuple(notes)
