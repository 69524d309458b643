"""A strut whose speed varies over time: its profile, read from a table or a function, and its term in the equation.

The deviations of the equation of motion are counted from a strut that keeps its initial speed. The mount feels how far
the true strut is ahead of that, so its acceleration, which jumps at the knots of a table, does not occur.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev

from plough_opt.core.checks import array_of, check_domain, check_kind, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import COUNT, Expression, where
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
_INTERVALS = 4096
# Relative difference of the speeds at the ends of two pieces from which on the speed jumps.
_JUMP = 1e-9


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
        object.__setattr__(self, "times", tuple(self.times))
        object.__setattr__(self, "pieces", tuple(map(_numbers, self.pieces)))
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
        for begin, row in zip(times, rows, strict=False):
            if not np.all(row >= -_APPROXIMATION):  # NaN too
                raise InputError(
                    f"the tow speed must be a number and at least 0 everywhere; after {begin:g} s it is not"
                )


def _numbers(piece: Any) -> tuple[float, ...]:
    """Return the coefficients of a piece; raise InputError if they are not numbers."""
    wrong = "a piece of a speed profile, {}, must be a list of numbers"
    row = array_of(piece, wrong)
    if row.ndim != 1 or not row.size:
        raise InputError(wrong.format(shown(piece)))
    return tuple(row.tolist())


def profile_of(speed: Any, duration: float) -> tuple[float, SpeedProfile]:
    """Return the largest tow speed [m/s] and the profile of a table or a function.

    Args:
        speed: times [s] from 0 on and speeds [m/s], linear between them; a function of the time [s] that returns the
            speed [m/s], whose changes last longer than duration / 4096; or a `scipy.interpolate.PPoly`, such as a cubic
            spline.
        duration: of the run [s].

    Raises:
        InputError: the argument is none of these, or as for `SpeedProfile`.
        DomainError: the speed is nowhere above 0.
    """
    if hasattr(speed, "c") and hasattr(speed, "x"):  # SciPy's class itself is slow to import
        sizes = np.diff(speed.x)
        rows = [(c[::-1] * size ** np.arange(len(c))).tolist() for c, size in zip(speed.c.T, sizes, strict=True)]
        times = speed.x.tolist()
    elif callable(speed):
        times, rows = _approximated(speed, duration)
    else:
        table = array_of(speed, "tow_speed = {} must be a table of times [s] and speeds [m/s], or a function of time")
        if table.ndim != 2 or len(table) != 2 or table.shape[1] < 2:
            raise InputError(
                f"tow_speed has the shape {table.shape}: it needs as many times [s] as speeds [m/s], at least two, such"
                " as ([0, 5, 10], [2.0, 1.5, 2.5])"
            )
        times, rows = table[0].tolist(), [[a, b - a] for a, b in pairwise(table[1].tolist())]
    largest = max(float(np.max(np.polyval(row[::-1], _PLACES))) for row in rows)
    check_domain("largest tow speed", largest, "m/s", above=0.0, why="the strut must move at some time")
    return largest, SpeedProfile(tuple(times), tuple(tuple(c / largest for c in row) for row in rows))


def _approximated(speed: Callable[[float], Any], duration: float) -> tuple[list[float], list[list[float]]]:
    """Return the ends of pieces, and the coefficients of the polynomials that approximate a function of the time."""

    def values(times: Any) -> Any:
        wrong = "tow_speed(t) returned {}: it must return a number [m/s]"
        found = array_of([speed(float(t)) for t in times], wrong)
        if found.ndim != 1:
            raise InputError(wrong.format(shown(found[0])))
        return found

    grid = np.linspace(0.0, 1.0, _INTERVALS + 1)
    speeds = values(duration * grid)
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
