"""References that take no part in a contest: a motion in the widest floats, and the gradient of its averages."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.motion import Run
from plough_opt.motion.plan import fastest_rate, numbers_of
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.following import Followed, Motion, beside_orbit, follow, orbit
from plough_opt.studies.accuracy.wide import EPS, WIDE, Wide

DEGREE: Final = 24
CHECK_DEGREE: Final = 18
"""Degrees of the polynomials of the reference, and of the solution that estimates its error."""

QUANTITIES: Final = ("stiffness", "mass", "tow_speed")
"""Quantities of a scene by which gradients are taken."""

AVERAGES: Final = ("mean_draft", "force_rms")
"""Averages whose gradients are taken."""

# Weights of f(k) - f(-k), k = 1 to 4, in the derivative at 0, of order 8.
_WEIGHTS: Final = (WIDE(4) / 5, -WIDE(1) / 5, WIDE(4) / 105, -WIDE(1) / 280)


def errors_of(found: Any, reference: Any) -> dict[str, float]:
    """Return the relative errors [-] of averages and mount force.

    Mean draft and RMS count relative to the larger of the two, mount forces relative to the largest of them.
    ``"averages"`` is the larger of the first two.

    Args:
        found: a run, or what else has ``mean_draft``, ``force_rms`` and ``mount_force`` [N], the last at the outputs.
        reference: the like, at the same outputs.
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
    """The motion of a scene in the widest floats.

    Attributes:
        run: its results, as of any run.
        events: time [s] and name of every event.
        errors: its own estimated relative errors [-], by the names of `errors_of`: the differences from the same by
            polynomials of another degree, and so with other steps; at least the rounding of its floats.
    """

    run: Run
    events: tuple[tuple[Wide, str], ...]
    errors: Mapping[str, float]

    @property
    def error(self) -> float:
        """The largest of its errors [-]."""
        return max(self.errors.values())


def reference_run(scene: Scene, duration: float | None = None, *, outputs: int = 400) -> Reference:
    """Follow the motion of a numeric scene in the widest floats; a lasting orbit has its own duration.

    Args:
        scene: with a motion; ``orbit`` is ``"transient"`` or ``"periodic"``.
        duration: simulated time [s].
        outputs: number of equal intervals between output times.

    Raises:
        InputError: a scene that has no reference; the message says why.
        IntegrationError: the motion could not be followed.
    """
    followed = _way(scene, duration)
    found, check = (followed(scene, outputs, degree) for degree in (DEGREE, CHECK_DEGREE))
    run = found.run()
    errors = {name: max(float(EPS), error) for name, error in errors_of(check.run(), run).items()}
    return Reference(run, found.events, errors)


def _way(scene: Scene, duration: float | None) -> Callable[[Scene, int, int], Followed]:
    """Return (a scene, outputs, degree) -> its motion, or for scenes that ask for it the lasting orbit."""
    if scene.effects.motion and scene.effects.orbit == "periodic":
        guess = beside_orbit(scene)
        return lambda own, outputs, degree: orbit(Motion(own), guess, outputs, degree)
    if scene.effects.orbit == "transient" and duration is None:
        raise InputError("the duration is missing: how long shall the reference be, in seconds?")
    return lambda own, outputs, degree: follow(Motion(own), WIDE(duration), outputs, degree)


@dataclass(frozen=True)
class ReferenceGradient:
    """Logarithmic derivatives x d/dx of `AVERAGES`, a row each [N], by `QUANTITIES`, a column each.

    Attributes:
        values: the derivatives.
        error: their estimated error relative to the largest of them [-].
    """

    values: Wide
    error: float


def reference_gradient(scene: Scene, duration: float | None) -> ReferenceGradient:
    """Return the gradient of mean draft and RMS by central differences of order 8 of the reference motion.

    Differences over two lengths of steps are compared, which gives their error.

    Args:
        scene: numeric.
        duration: simulated time [s]; None for a lasting orbit.

    Raises:
        InputError: as `reference_run`.
        IntegrationError: as `reference_run`, or no steps over which the events stay the same ones.
    """
    followed = _way(scene, duration)

    def averages(name: str, factor: Wide) -> tuple[Wide, list[str]]:
        varied = replace(scene, **{name: WIDE(getattr(scene, name)) * factor})
        found = followed(varied, 1, DEGREE)
        run = found.run()
        return np.array([getattr(run, average) for average in AVERAGES]), [event for _, event in found.events]

    def differences(h: Wide) -> Wide:
        columns = []
        for name in QUANTITIES:
            column = np.zeros(len(AVERAGES), WIDE)
            for k, weight in enumerate(_WEIGHTS, start=1):
                (up, one), (down, other) = (averages(name, 1 + sign * k * h) for sign in (1, -1))
                if one != other:
                    raise IntegrationError("the events of the reference change with its quantities: no gradient")
                column = column + weight * (up - down)
            columns.append(column / h)
        return np.array(columns).T

    # Quantities shift the phase of oscillation and wave; that of an orbit is one turn.
    phase = 2.0 * math.pi if duration is None else fastest_rate(numbers_of(scene)) * duration
    h = WIDE(2.0 ** -(7 + math.ceil(math.log2(1.0 + phase / 8.0))))
    coarse, fine = differences(h), differences(h / 4)
    size = np.max(np.abs(fine))
    # Of order 8 the error of the longer steps is 4^8 times that of these.
    wrong = np.max(np.abs(fine - coarse)) / (size if size > 0 else 1) / 4.0**4
    return ReferenceGradient(fine, float(max(wrong, 100 * EPS / h)))
