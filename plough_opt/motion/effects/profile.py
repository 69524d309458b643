"""A strut whose speed varies over time: its profile, read from a table or a function, and its term in the equation.

The deviations of the equation of motion are counted from a strut that keeps its initial speed. The mount feels how far
the true strut is ahead of that, so its acceleration, which jumps at the knots of a table, does not occur.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

from plough_opt.core.checks import NOT_NUMBERS, array_of, check_domain, check_kind, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import COUNT, Expression, where
from plough_opt.core.units import has_unit, in_si
from plough_opt.motion.effects.terms import Parameters, Term, Towed

# Each piece adds steps to a run, and operations to each of them: a run with so many takes some seconds.
_MOST_PIECES = 200
# A function of the time is approximated piece by piece by polynomials of this degree. It is a little above the order of
# the steps, so a smooth function takes few pieces.
_DEGREE = 9
# Both ends of a piece are among the nodes of its polynomial, so that the speed does not jump between two pieces.
_NODES = (1.0 - np.cos(np.linspace(0.0, np.pi, _DEGREE + 1))) / 2.0
# Error of the approximation relative to the largest speed, near the rounding of the polynomials.
_APPROXIMATION = 1e-13
# Around a kink the pieces shrink until it shifts the strut by no more than this part of its path.
_SHIFT = 1e-13
# A piece shorter than this part of the duration holds a jump.
_SHORTEST = 2.0**-30
# Places in a piece, besides the nodes of the polynomial, at which the approximation and the sign are checked.
_PLACES = np.linspace(0.0, 1.0, 23)
# A function is evaluated at the ends of so many equal intervals of the duration, which takes some milliseconds: a
# change that lasts longer than one of them cannot hide. A power of 2, so that pieces, which are halved, end there.
_INTERVALS_OF_TIME = 4096
# Relative difference of the speeds at the ends of two pieces from which on the speed jumps.
_JUMP = 1e-9
_TABLE = "a tuple of times [s] and speeds [m/s], such as ([0, 5, 10], [2.0, 1.5, 2.5])"


@dataclass(frozen=True)
class SpeedProfile:
    """Speed of the strut over time relative to the scene's tow speed, in pieces that are polynomials of the time.

    `po.simulate(scene, duration, tow_speed=...)` makes it of a table or a function.

    Args:
        times: ends of the pieces [s], rising from 0. After the last one the speed stays as it is.
        pieces: for each piece the coefficients a, b, c, ... of its speed over the tow speed, a + b u + c u^2 ... [-],
            where u rises from 0 to 1 within the piece. The speed must not jump or fall below 0.

    Raises:
        InputError: the times do not rise from 0, there are more than 200 pieces or not one for each interval, or the
            speed jumps, is below 0 or is not finite.

    Example:
        >>> import plough_opt as po
        >>> po.Effects(tow_profile=po.SpeedProfile((0.0, 2.0), ((0.5, 0.5),))).tow_profile.times  # from half to full
        (0.0, 2.0)
    """

    times: tuple[float, ...] = field(metadata=COUNT)
    pieces: tuple[tuple[float, ...], ...] = field(metadata=COUNT)

    def __post_init__(self) -> None:
        for name in ("times", "pieces"):
            check_kind(f"{name} of a speed profile", getattr(self, name), Sequence | np.ndarray, "a list")
        vars(self).update(times=tuple(self.times), pieces=tuple(map(_numbers, self.pieces)))
        times = array_of(self.times, "the times of a speed profile, {}, must be numbers [s]")
        if not (times.ndim == 1 and len(times) > 1 and times[0] == 0.0 and np.all(np.diff(times) > 0.0)):
            raise InputError(f"the times of a speed profile, {shown(self.times)}, must rise from 0: at least two")
        if not math.isfinite(times[-1]) or len(self.pieces) != len(times) - 1 or len(self.pieces) > _MOST_PIECES:
            raise InputError(
                f"a speed profile of {len(times)} times has {len(self.pieces)} pieces: it needs one for each interval"
                f" and at most {_MOST_PIECES}; for more integrate scene.equation(controls=('tow_speed',)) yourself"
            )
        rows = [np.polyval(piece[::-1], _PLACES) for piece in self.pieces]
        for time, before, after in zip(times[1:], rows, rows[1:], strict=False):
            if abs(before[-1] - after[0]) > _JUMP * max(1.0, abs(before[-1])):
                raise InputError(f"the tow speed jumps at {time:g} s: let it rise or fall over a short time")
        _check_sign(np.concatenate([a + (b - a) * _PLACES for a, b in pairwise(times)]), np.concatenate(rows))


def _check_sign(times: NDArray[np.float64], speeds: NDArray[np.float64]) -> None:
    """Raise InputError if the speed at one of the times [s], which rise, is below 0 or not finite."""
    finite = np.isfinite(speeds)
    size = np.max(np.abs(speeds), initial=0.0, where=finite)
    wrong = ~finite | (speeds < -_APPROXIMATION * size)
    if not wrong.any():
        return
    at = int(np.argmax(wrong))
    if not finite[at]:
        raise InputError(f"the tow speed is not finite at {times[at]:g} s")
    before = max(at - 1, 0)
    since = np.interp(0.0, (speeds[at], max(speeds[before], 0.0)), (times[at], times[before]))
    raise InputError(f"the tow speed must be at least 0 everywhere; from {since:.4g} s on it is negative")


def _numbers(piece: Any) -> tuple[float, ...]:
    """Return the coefficients of a piece; raise InputError if they are not numbers."""
    wrong = "a piece of a speed profile, {}, must be a list of numbers"
    return tuple(array_of(piece, wrong, lambda row: row.ndim == 1 and row.size).tolist())


def profile_of(speed: Any, duration: float) -> tuple[float, SpeedProfile]:
    """Return the largest tow speed [m/s] and the profile of a table or a function.

    Args:
        speed: a tuple of times [s] from 0 on and of speeds [m/s], linear between them; a function of the time [s] that
            returns the speed [m/s], whose changes last longer than duration / 4096; or a `scipy.interpolate.PPoly`,
            such as a cubic spline.
        duration: of the run [s].

    Raises:
        InputError: the argument is none of these, or as for `SpeedProfile`.
        DomainError: the speed is nowhere above 0.
    """
    interpolate: Any = sys.modules.get("scipy.interpolate")  # slow to import, and loaded if the speed is a spline
    if interpolate is not None and isinstance(speed, interpolate.PPoly):
        if speed.c.ndim != 2:
            raise InputError(f"tow_speed is a spline of values with the shape {speed.c.shape[2:]}: give one of numbers")
        sizes = np.diff(speed.x)
        rows = [(c[::-1] * size ** np.arange(len(c))).tolist() for c, size in zip(speed.c.T, sizes, strict=True)]
        times = speed.x.tolist()
    elif callable(speed):
        times, rows = _approximated(speed, duration)
    else:
        times, speeds = _table(speed)
        rows = [[a, b - a] for a, b in pairwise(speeds)]
    largest = max(float(np.max(np.polyval(row[::-1], _PLACES))) for row in rows)
    check_domain("largest tow speed", largest, "m/s", above=0.0, why="the strut must move at some time")
    return largest, SpeedProfile(tuple(times), tuple(tuple(c / largest for c in row) for row in rows))


def _table(given: Any) -> tuple[list[float], list[float]]:
    """Return the times [s] and the speeds [m/s] of a table; raise InputError if there are none."""
    if has_unit(given) or isinstance(given, Real):
        raise InputError(
            f"tow_speed = {shown(given)} is not a course over time: give a constant speed to the scene, such as"
            f' Scene(..., tow_speed="9 km/h"), or here {_TABLE}'
        )
    wrong = f"tow_speed = {shown(given)} must be {_TABLE}, a function of the time or a spline"
    try:
        rows = [list(row) for row in (given if isinstance(given, Sequence) else array_of(given, wrong).tolist())]
    except NOT_NUMBERS:
        raise InputError(wrong) from None
    sizes = [len(row) for row in rows]
    if set(sizes) == {2} and len(rows) != 2:
        raise InputError(
            f"tow_speed has the shape ({len(rows)}, 2), so each row seems to be a time and a speed: transpose it with"
            f" tuple(zip(*table)), since it must be {_TABLE}"
        )
    if sizes == [2, 2] and not isinstance(given, tuple):
        raise InputError(
            f"tow_speed = {shown(given)} may be two pairs or two columns: give a tuple of times [s] and speeds [m/s],"
            " such as ([0, 4], [1, 2]) for 1 m/s at 0 s and 2 m/s at 4 s"
        )
    if len(rows) != 2 or sizes[0] != sizes[1] or sizes[0] < 2:
        raise InputError(f"tow_speed has rows of {sizes} values: it must be {_TABLE}, at least two of each")

    def numbers(name: str, unit: str, column: list[Any]) -> list[float]:
        whats = [f"the {name} in row {row} of tow_speed" for row in range(1, len(column) + 1)]
        return [plain_number(what, in_si(what, value, unit)) for what, value in zip(whats, column, strict=True)]

    return numbers("time", "s", rows[0]), numbers("speed", "m/s", rows[1])


def _approximated(speed: Callable[[float], Any], duration: float) -> tuple[list[float], list[list[float]]]:
    """Return the ends of pieces, and the coefficients of the polynomials that approximate a function of the time."""

    def values(times: Any) -> Any:
        wrong = "tow_speed(t) returned {}: it must return a number [m/s]"
        return array_of([speed(float(t)) for t in times], wrong, lambda found: found.ndim == 1)

    grid = np.linspace(0.0, 1.0, _INTERVALS_OF_TIME + 1)
    speeds = values(duration * grid)
    _check_sign(duration * grid, speeds)
    size = float(np.max(np.abs(speeds))) or 1.0
    times, rows, waiting = [0.0], [], [(0.0, 1.0)]
    while waiting:
        begin, end = waiting.pop()
        width = end - begin
        fit = Chebyshev.fit(_NODES, values(duration * (begin + width * _NODES)), _DEGREE, (0.0, 1.0))
        inside = (begin <= grid) & (grid <= end)
        places = np.concatenate([_PLACES, (grid[inside] - begin) / width])
        wanted = np.concatenate([values(duration * (begin + width * _PLACES)), speeds[inside]])
        error = float(np.max(np.abs(fit(places) - wanted))) / size
        if not math.isfinite(error):
            raise InputError(f"tow_speed(t) is not finite between {duration * begin:g} s and {duration * end:g} s")
        if error > _APPROXIMATION and error * width > _SHIFT:
            if width < _SHORTEST:
                raise InputError(f"the tow speed jumps at {duration * begin:g} s: let it change over a short time")
            middle = begin + width / 2.0
            waiting += [(middle, end), (begin, middle)]
            if len(times) + len(waiting) > _MOST_PIECES:
                raise InputError(
                    f"tow_speed(t) needs more than {_MOST_PIECES} polynomials: it must be smooth but for a few kinks;"
                    " give a table, or integrate scene.equation(controls=('tow_speed',)) yourself"
                )
            continue
        times.append(duration * end)
        rows.append(fit.convert(kind=np.polynomial.Polynomial, domain=(-1.0, 1.0)).coef.tolist())
    return times, rows


@dataclass(frozen=True)
class TowProfile(Term):
    """Strut whose speed follows a profile."""

    profile: SpeedProfile

    field = "tow_profile"
    names = ("speed_pieces",)

    @classmethod
    def of(cls, scene: Towed) -> tuple[TowProfile, ...]:
        profile = scene.effects.tow_profile
        return () if profile is None else (cls(profile),)

    def values(self, scene: Towed) -> dict[str, Expression]:
        return {"speed_pieces": float(len(self.profile.pieces))}

    def start_speed(self, p: Parameters) -> Expression:
        """Return the speed at time 0 [m/s]."""
        return p["tow_speed"] * self.profile.pieces[0][0]

    def lead(self, p: Parameters, time: Expression) -> tuple[Expression, Expression]:
        """Return how far the strut is ahead [m], and how much faster it is [m/s], than at its initial speed."""
        first, covered, found = self.profile.pieces[0][0], 0.0, []
        for (begin, end), piece in zip(pairwise(self.profile.times), self.profile.pieces, strict=True):
            gains = (piece[0] - first, *piece[1:])
            means = [gain / (k + 1) for k, gain in enumerate(gains)]
            since = time - begin
            u = since / (end - begin)
            found.append((end, covered + since * _polynomial(means, u), _polynomial(gains, u)))
            covered += (end - begin) * sum(means)
        kept = sum(self.profile.pieces[-1]) - first
        ahead: Expression = covered + kept * (time - self.profile.times[-1])
        faster: Expression = kept + 0.0 * time
        for end, path, gain in reversed(found):
            ahead, faster = where(time <= end, path, ahead), where(time <= end, gain, faster)
        return p["tow_speed"] * ahead, p["tow_speed"] * faster


def _polynomial(coefficients: Sequence[float], u: Expression) -> Expression:
    """Return the value of a polynomial, whose coefficients begin with the constant."""
    value: Expression = 0.0 * u + coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * u + coefficient
    return value
