"""A reference that is not a contestant: the motion followed in the widest floats, to all their digits.

Every smooth piece of the motion (`plough_opt.studies.accuracy.laws`) is a chain of Chebyshev polynomials
(`plough_opt.studies.accuracy.picard`); events end a piece where a polynomial has its root. Averages are Gauss-Legendre
quadratures of the polynomials, and the RMS is one of the deviation from the mean, found in a second pass.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Protocol

import numpy as np

from plough_opt.core.errors import InputError, IntegrationError
from plough_opt.core.expressions import as_number
from plough_opt.motion import simulate
from plough_opt.motion.scene import Scene
from plough_opt.studies.accuracy.laws import STICK, Laws, Piece
from plough_opt.studies.accuracy.picard import EPS, PI, WIDE, Step, Wide, first_end, gauss, step

DEGREE: Final = 24
CHECK_DEGREE: Final = 18
"""Degrees of the polynomials of the reference, and of the solution that estimates its error."""

WIDER: Final = bool(np.finfo(WIDE).eps < np.finfo(np.float64).eps)
"""Whether the machine has floats wider than a double."""

_MOST_EVENTS = 200_000
# Steps of a whole motion, which take minutes, and after how many it is seen whether they will do.
_MOST_STEPS = 400_000
_WATCHED = 2000
# Events at one time after which the motion is taken to hang there.
_MOST_AT_ONCE = 12
_SHORTEST = 1e-16
_SHOOTINGS = 20
# Part of the last miss above which the slope of a shot is found anew.
_SLOW = 0.1


class Response(Protocol):
    """Results that method and reference have in common: averages, and the mount force at the outputs."""

    @property
    def mean_draft(self) -> Any:
        """Mean of the mount force [N]."""

    @property
    def force_rms(self) -> Any:
        """RMS of the mount force about its mean [N]."""

    @property
    def mount_force(self) -> Any:
        """Mount force at the output times [N]."""


@dataclass(frozen=True)
class Reference:
    """The motion of a scene in the widest floats: arrays over the output times, and averages.

    Attributes:
        time: output times [s].
        travel: L [m].
        speed: L' [m/s].
        deflection: z [m].
        mount_force: P [N].
        soil_resistance: F, the added mass's part included [N].
        mode: 0 slips, 1 sticks, 2 behind a gap.
        mean_draft: mean of P [N].
        force_rms: RMS of P about its mean [N].
        mean_deflection: mean of z [m].
        displacement_rms: RMS of z about its mean [m].
        tow_power: mean of P s' [W].
        events: time [s] and name of every event.
        error: its own estimated relative error [-]: the largest difference, in the measures of `errors_of`, from the
            same by polynomials of another degree, and so with other steps; at least the rounding of its floats.
        errors: the same apart, by the names of `errors_of`.
        seconds: time taken [s].
    """

    time: Wide
    travel: Wide
    speed: Wide
    deflection: Wide
    mount_force: Wide
    soil_resistance: Wide
    mode: Wide
    mean_draft: Wide
    force_rms: Wide
    mean_deflection: Wide
    displacement_rms: Wide
    tow_power: Wide
    events: tuple[tuple[Wide, str], ...]
    error: float = math.nan
    errors: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0


def errors_of(found: Response, reference: Response) -> dict[str, float]:
    """Return the relative errors [-] of averages and mount force.

    Mean draft and RMS count relative to the larger of the two, mount forces relative to the largest of them.
    ``"averages"`` is the larger of the first two.
    """
    size = max(abs(reference.mean_draft), reference.force_rms)
    peak = np.max(np.abs(reference.mount_force))
    averages = {
        "mean draft": _over(abs(found.mean_draft - reference.mean_draft), size),
        "RMS": _over(abs(found.force_rms - reference.force_rms), size),
    }
    wrong = np.abs(np.asarray(found.mount_force) - reference.mount_force)
    return {
        "averages": max(averages.values()),
        **averages,
        "last force": _over(wrong[-1], peak),
        "trajectory": _over(np.max(wrong), peak),
    }


def _over(difference: Any, size: Any) -> float:
    return float(difference / size) if size > 0 else float(difference)


def reference_run(scene: Scene, duration: float | None = None, *, outputs: int = 400) -> Reference:
    """Follow the motion of a numeric scene in the widest floats; a lasting orbit has its own duration.

    Args:
        scene: with a motion; ``orbit`` is ``"transient"`` or ``"periodic"``.
        duration: simulated time [s].
        outputs: number of equal intervals between output times.

    Raises:
        InputError: a scene of which there is no reference; the message says why.
        IntegrationError: the motion could not be followed.
    """
    started = time.perf_counter()
    laws = Laws.of(scene)
    if scene.effects.orbit == "transient":
        if duration is None:
            raise InputError("the duration is missing: how long shall the reference be, in seconds?")
        both = [follow(laws, WIDE(duration), outputs, degree) for degree in (DEGREE, CHECK_DEGREE)]
    elif scene.effects.orbit == "periodic":
        guess = beside_orbit(scene)
        both = [orbit(laws, guess, outputs, degree) for degree in (DEGREE, CHECK_DEGREE)]
    else:
        raise InputError("a stand-in for the lasting orbit is not a motion: the reference of all of them is the orbit")
    errors = {name: max(float(EPS), error) for name, error in errors_of(both[1], both[0]).items()}
    return replace(both[0], error=max(errors.values()), errors=errors, seconds=time.perf_counter() - started)


def beside_orbit(scene: Scene) -> tuple[Wide, Wide]:
    """Return z and z' beside the lasting orbit; they decide which orbit is found, and none of its digits."""
    run = simulate(scene, outputs=1)
    return WIDE(run.deflection[0]), WIDE(float(as_number(scene.tow_speed)) - run.speed[0])


def orbit(laws: Laws, guess: tuple[Wide, Wide], outputs: int, degree: int) -> Reference:
    """Return the lasting orbit beside a state, by Newton's method on the motion over one wavelength.

    Raises:
        IntegrationError: none was found.
    """
    period = 2 * PI / (laws.wavenumber * laws.tow_speed)
    state = np.array(guess, WIDE)
    unit = np.array([abs(guess[0]) + laws.tow_speed / (laws.wavenumber * laws.tow_speed), laws.tow_speed], WIDE)

    def after(first: Wide) -> Wide:
        found = follow(laws, period, 1, degree, (first[0], first[1]))
        return np.array([found.deflection[-1], laws.tow_speed - found.speed[-1]])

    least, slope = np.inf, None
    for _ in range(_SHOOTINGS):
        miss = after(state) - state
        size = float(np.max(np.abs(miss) / unit))
        if size <= 2 * EPS or (size < 1e4 * EPS and size >= least):
            return follow(laws, period, outputs, degree, (state[0], state[1]))
        if slope is None or size > _SLOW * least:
            nudges = np.diag(WIDE(math.sqrt(EPS)) * unit)
            slope = [(after(state + nudge) - after(state - nudge)) / (2 * np.max(nudge)) for nudge in nudges]
        least = size
        # (slope - 1) step = - miss, for two unknowns.
        (a, c), (b, d) = slope
        a, d = a - 1, d - 1
        state = state - np.array([d * miss[0] - b * miss[1], a * miss[1] - c * miss[0]]) / (a * d - b * c)
    raise IntegrationError("no lasting orbit was found beside that of the run")


class _Course:
    """Record of a motion while it is followed."""

    def __init__(self, laws: Laws, times: Wide) -> None:
        self.laws, self.times = laws, times
        self.noted: list[tuple[Any, ...]] = []
        self.weights: list[Wide] = []
        self.sums: list[tuple[Wide, Wide, Wide]] = []
        self.events: list[tuple[Wide, str]] = []

    def note(self, piece: Piece, done: Step, end: Wide) -> None:
        """Note outputs and quadrature nodes of a step up to its end, or to an event."""
        nodes, weights = gauss(len(done.z) + 1)
        half = (end - done.start) / 2
        inner = done.start + half * (nodes + 1)
        z, rate = done.at(inner)
        self.weights.append(half * weights)
        self.sums.append((self.laws.pull(z, rate), z, self.laws.strut(inner, piece)[1]))
        at = self.times[len(self.noted) :]
        at = at[: int(np.searchsorted(at, end, "right"))]
        if at.size:
            z, rate = done.at(at)
            path, tow, _ = self.laws.strut(at, piece)
            soil = self.laws.felt(z, rate, (path - z, tow - rate), piece)
            self.noted += zip(z, rate, path - z, tow - rate, soil, [piece.mode] * at.size, strict=True)

    def result(self) -> Reference:
        """Return what was noted, averaged."""
        weights = np.concatenate(self.weights)
        pull, z, tow = (np.concatenate(values) for values in zip(*self.sums, strict=True))
        whole = np.sum(weights)
        mean, mean_z = weights @ pull / whole, weights @ z / whole
        deflection, rate, travel, speed, soil, mode = (np.array(column) for column in zip(*self.noted, strict=True))
        return Reference(
            time=self.times,
            travel=travel,
            speed=np.where(mode == STICK, WIDE(0), speed),
            deflection=deflection,
            mount_force=self.laws.pull(deflection, rate),
            soil_resistance=soil,
            mode=mode,
            mean_draft=mean,
            force_rms=np.sqrt(weights @ (pull - mean) ** 2 / whole),
            mean_deflection=mean_z,
            displacement_rms=np.sqrt(weights @ (z - mean_z) ** 2 / whole),
            tow_power=weights @ (pull * tow) / whole,
            events=tuple(self.events),
        )


def follow(laws: Laws, duration: Wide, outputs: int, degree: int, first: tuple[Wide, Wide] | None = None) -> Reference:
    """Follow a motion once, by polynomials of one degree.

    Args:
        laws: of the scene.
        duration: simulated time [s].
        outputs: number of equal intervals between output times.
        degree: of the polynomials.
        first: z [m] and z' [m/s] at the start, in the place of the scene's own start.

    Raises:
        IntegrationError: steps or pauses between events grow too short, or the steps too many.
    """
    piece, z, rate = laws.first()
    if first is not None:
        z, rate = first
    hardness = np.sqrt(abs(laws.stiffness) * laws.mass)
    # What rounds: the forces, and from a start that is not steady the speed that the mount must take up.
    force = abs(laws.stiffness * z) + laws.static + (0 if laws.steady else laws.tow_speed * hardness)
    scales = force / abs(laws.stiffness), force / hardness
    times = duration * np.arange(outputs + 1) / WIDE(outputs)
    # Rounding may put the last output behind the end, where no step reaches it.
    times[-1] = duration
    course = _Course(laws, times)
    now, size, at_once = WIDE(0), hardness / abs(laws.stiffness), 0
    steps, watched = 0, WIDE(0)
    while now < duration:
        stop = laws.ramp if piece.ramping and laws.ramp < duration else duration
        # The last step takes what would else be left for one of no length.
        whole = stop - now <= size * WIDE(1.001)
        done = step(degree, (now, stop - now if whole else size), (z, rate), laws.law(piece), scales)
        if done is None:
            size = min(size, stop - now) / 2
            if size < _SHORTEST * duration:
                raise IntegrationError(
                    f"the reference stops at t = {float(now):.6g} s: the forces are not smooth there"
                )
            continue
        steps += 1
        if steps % _WATCHED == 0:
            if (now - watched) * _MOST_STEPS < _WATCHED * duration:
                raise IntegrationError(
                    f"the reference would take more than {_MOST_STEPS} steps at t = {float(now):.6g} s: the forces"
                    " change too fast there"
                )
            watched = now
        end, name = _next_event(laws, piece, done, stop if whole else now + size)
        course.note(piece, done, end)
        at_once = at_once + 1 if name and end - now <= 4 * EPS * end else 0
        (z,), (rate,) = done.at(np.array([end]))
        now = end
        if name:
            course.events.append((now, name))
            piece, z, rate = laws.after(name, piece, now, z, rate)
        elif now == stop:
            piece = replace(piece, ramping=False)
        if at_once > _MOST_AT_ONCE or len(course.events) > _MOST_EVENTS:
            raise IntegrationError(f"the reference finds events without end at t = {float(now):.6g} s")
        if not whole or done.used > 0.9:
            size = done.size * WIDE(min(2.0, max(0.5, 0.9 / max(done.used, 0.1))))
    return course.result()


def _next_event(laws: Laws, piece: Piece, done: Step, end: Wide) -> tuple[Wide, str]:
    """Return when the piece ends within a step, and by what; the step's end and no name where it does not."""
    name = ""
    for kind, function in laws.ends(piece, done).items():
        found = first_end(function, done.start, end - done.start)
        if found is not None and (not name or found < end):
            end, name = found, kind
    return end, name
