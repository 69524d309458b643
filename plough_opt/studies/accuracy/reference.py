"""References for the contests, which do not compete: a motion in the widest floats, and gradients of its averages."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.motion import Run
from plough_opt.motion.plan import fastest_rate, numbers_of
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.following import IntegratedMotion, Motion, follow, orbit, state_near_orbit
from plough_opt.studies.accuracy.wide import EPS, WIDE, Wide

DEGREE: Final = 24
"""Degree of the polynomials of a reference."""

CHECK_DEGREE: Final = 18
"""Degree of the polynomials of the solution whose difference estimates the error of a reference."""

QUANTITIES: Final = ("stiffness", "mass", "tow_speed")
"""Quantities of a scene that gradients are taken with respect to."""

AVERAGES: Final = ("mean_draft", "force_rms")
"""Averages whose gradients are taken."""

# Weights of f(k) for k = -4 to -1 and 1 to 4 in the derivative at 0: central differences of order 8.
_HALF: Final = (WIDE(4) / 5, -WIDE(1) / 5, WIDE(4) / 105, -WIDE(1) / 280)
_PLACES: Final = (-4, -3, -2, -1, 1, 2, 3, 4)
_WEIGHTS: Final = np.sign(_PLACES) * np.array([*_HALF[::-1], *_HALF])


def errors_of(found: Any, reference: Any) -> dict[str, float]:
    """Return the relative errors of averages and mount forces by name [-].

    Errors of mean draft and RMS are relative to the larger of the two, and ``"averages"`` is the larger of both errors.
    Errors of mount forces are relative to the largest of the forces.

    Args:
        found: a run, or another object with ``mean_draft``, ``force_rms`` and, at the outputs, ``mount_force`` [N].
        reference: the same kind of object with the same output times.
    """
    size = max(abs(reference.mean_draft), reference.force_rms)
    averages = {
        "mean draft": _over(abs(found.mean_draft - reference.mean_draft), size),
        "RMS": _over(abs(found.force_rms - reference.force_rms), size),
    }
    peak = np.max(np.abs(reference.mount_force))
    wrong = np.abs(np.asarray(found.mount_force) - reference.mount_force)
    forces = {"last force": _over(wrong[-1], peak), "trajectory": _over(np.max(wrong), peak)}
    return {"averages": max(averages.values()), **averages, **forces}


def _over(difference: Any, size: Any) -> float:
    return float(difference / size) if size > 0 else float(difference)


@dataclass(frozen=True)
class Reference:
    """Motion of a scene in the widest floats.

    Attributes:
        run: its results, like those of any run.
        events: time [s] and name of each event.
        errors: estimates of its own relative errors, by the names of `errors_of` [-]. They are the differences from a
            solution by polynomials of another degree, and so with other steps; at least the rounding of the floats.
    """

    run: Run
    events: tuple[tuple[Wide, str], ...]
    errors: Mapping[str, float]

    @property
    def error(self) -> float:
        """Largest of its errors [-]."""
        return max(self.errors.values())


def reference_run(scene: Scene, duration: float | None = None, *, outputs: int = 400) -> Reference:
    """Return the motion of a scene in the widest floats.

    Args:
        scene: scene with numbers and a motion; ``orbit`` is ``"transient"`` or ``"periodic"``.
        duration: simulated time [s]; ignored for a periodic orbit, which has its own.
        outputs: number of equal intervals between output times.

    Raises:
        InputError: the scene has no reference; the message says why.
        IntegrationError: the motion could not be integrated.
    """
    integrate = _integrator(scene, duration)
    found, check = (integrate(scene, outputs, degree) for degree in (DEGREE, CHECK_DEGREE))
    run = found.run()
    errors = {name: max(float(EPS), error) for name, error in errors_of(check.run(), run).items()}
    return Reference(run, found.events, errors)


def _integrator(scene: Scene, duration: float | None) -> Callable[[Scene, int, int], IntegratedMotion]:
    """Return (scene like this one, outputs, degree) -> its motion or, if the scene asks for it, its periodic orbit."""
    if scene.effects.motion and scene.effects.orbit == "periodic":
        guess = state_near_orbit(scene)
        return lambda own, outputs, degree: orbit(Motion(own), guess, outputs, degree)
    if scene.effects.orbit == "transient" and duration is None:
        raise InputError("the duration is missing: give the simulated time of the reference in seconds")
    return lambda own, outputs, degree: follow(Motion(own), WIDE(duration), outputs, degree)


@dataclass(frozen=True)
class ReferenceGradient:
    """Logarithmic derivatives x d/dx of averages.

    Attributes:
        values: derivatives of `AVERAGES`, a row each, by `QUANTITIES`, a column each [N].
        error: their estimated error, relative to the largest of them [-].
    """

    values: Wide
    error: float


def reference_gradient(scene: Scene, duration: float | None) -> ReferenceGradient:
    """Return the gradient of mean draft and RMS by central differences of order 8 of the reference motion.

    The error is estimated from differences with two lengths of steps.

    Args:
        scene: scene with numbers.
        duration: simulated time [s]; None for a periodic orbit.

    Raises:
        InputError: as for `reference_run`.
        IntegrationError: as for `reference_run`, or the events change within the steps of the differences.
    """
    integrate = _integrator(scene, duration)

    def difference(name: str, h: Wide) -> Wide:
        factors = [1 + k * h for k in _PLACES]
        found = [integrate(replace(scene, **{name: WIDE(getattr(scene, name)) * f}), 1, DEGREE) for f in factors]
        if len({tuple(event for _, event in motion.events) for motion in found}) > 1:
            raise IntegrationError("the events change with the quantities of the scene, so there is no gradient")
        runs = [motion.run() for motion in found]
        return _WEIGHTS @ np.array([[getattr(run, average) for average in AVERAGES] for run in runs]) / h

    def differences(h: Wide) -> Wide:
        return np.array([difference(name, h) for name in QUANTITIES]).T

    # The quantities shift the phase of oscillation and wave, so the step shrinks with the whole phase. An orbit has one
    # turn.
    phase = 2.0 * math.pi if duration is None else fastest_rate(numbers_of(scene)) * duration
    h = WIDE(2.0 ** -(7 + math.ceil(math.log2(1.0 + phase / 8.0))))
    coarse, fine = differences(h), differences(h / 4)
    size = np.max(np.abs(fine))
    # The error with the longer steps is 4^8 times as large. Dividing by only 4^4 leaves a margin of 4^4.
    wrong = np.max(np.abs(fine - coarse)) / (size if size > 0 else 1) / 4.0**4
    return ReferenceGradient(fine, float(max(wrong, 100 * EPS / h)))
