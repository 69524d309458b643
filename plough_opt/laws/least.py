"""The angle of rupture that makes a force least, as a number or as an expression with exact derivatives."""

import math
from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from plough_opt.core.errors import DomainError
from plough_opt.core.expressions import Expression, is_casadi
from plough_opt.core.labels import Limit, attach

_GRID = 64
_HALVINGS = 40
# The last steps make the derivatives exact: each doubles the order that is right.
_NEWTON_STEPS = 3
# Of the interval's end, where a force may be infinite.
_INSIDE = 1.0 - 1e-9


def least_angle(force: Callable[..., Expression], upper: Expression, *parameters: Expression, what: str) -> Expression:
    """Return the angle [rad] in (0, upper) at which ``force(angle, *parameters)`` is least.

    Args:
        force: written with `plough_opt.core.expressions`; smooth and finite inside the interval.
        upper: end of the interval [rad].
        parameters: floats, arrays of one shape, or CasADi scalars.
        what: name of the model, for the refusal.

    Raises:
        DomainError: the force of numbers is least at the end of the interval, not inside. Of MX symbols that is a
            limit that a `Design` keeps by itself; of SX it is unseen.
    """
    arguments = (upper, *parameters)
    search = _search(force, len(parameters))
    if any(map(is_casadi, arguments)):
        found = search(*arguments)
        over_end = force(found, *parameters) / force(upper * _INSIDE, *parameters)
        limit = Limit(f"{what}: least force of a wedge over that at the end of the possible angles", at_most=1.0)
        return attach(found, over_end, limit, limit)
    values = np.broadcast_arrays(*(np.asarray(argument, dtype=float) for argument in arguments))
    found = np.array([float(search(*row)) for row in zip(*(v.ravel() for v in values), strict=True)])
    ends = values[0].ravel() * _INSIDE
    rest = [v.ravel() for v in values[1:]]
    inside = (found > 0.0) & (found < ends)
    if not np.all(inside) or not np.all(force(found, *rest) < force(ends, *rest)):
        raise DomainError(
            f"the force of {what} is least for a wedge at the end of the possible angles, where its derivation does not"
            " hold: take a steeper rake angle or a wider tool"
        )
    return float(found[0]) if values[0].ndim == 0 else found.reshape(values[0].shape)


@lru_cache(maxsize=8)
def _search(force: Callable[..., Expression], count: int) -> ca.Function:
    """Return (upper, parameters) -> angle: a grid, bisection of the slope's sign, Newton's steps."""
    angle, upper = ca.SX.sym("angle"), ca.SX.sym("upper")
    p = [ca.SX.sym(f"p{k}") for k in range(count)]
    value = force(angle, *p)
    slope = ca.jacobian(value, angle)
    f = ca.Function("force", [angle, *p], [value])
    g = ca.Function("slope", [angle, *p], [slope, ca.jacobian(slope, angle)])
    step = upper / (_GRID + 1)
    # The first valley from the flat planes on: a force may fall again towards the end, where it means nothing.
    best, least, falls = step, ca.SX(math.inf), ca.SX(1.0)
    for k in range(1, _GRID + 1):
        here = f(k * step, *p)
        falls = ca.logic_and(falls, here < least)
        best, least = ca.if_else(falls, k * step, best), here
    low, high = best - step, best + step
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        before = g(middle, *p)[0] < 0.0
        low, high = ca.if_else(before, middle, low), ca.if_else(before, high, middle)
    found = (low + high) / 2.0
    for _ in range(_NEWTON_STEPS):
        first, second = g(found, *p)
        found = found - first / second
    # Without a valley there is no such angle; a solver that meets NaN takes a shorter step.
    return ca.Function("least_angle", [upper, *p], [ca.if_else(falls, math.nan, found)])
