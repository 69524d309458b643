"""Differences of logarithms and angles over a small number, without cancellation, and the limit to quadrature."""

from plough_opt.core.expressions import Expression, absolute, arctan2, arctan_ratio, arctanh_ratio, log, where

FAR = 1.6
"""Sum of the distances from both ends of a piece, in its lengths, beyond which a Gauss rule is the more accurate."""

FAR_NODES = 24
"""Nodes of that rule."""

_SERIES_BELOW = 0.5


def log_difference(a: Expression, b: Expression, change: Expression, m: Expression = 1.0) -> Expression:
    """Return ln(a/b)/m for positive a and b whose difference a - b = m change is known to rounding."""
    w = change / (a + b)
    near = absolute(m * w) < _SERIES_BELOW
    close = 2.0 * w * arctanh_ratio(where(near, m * w, 0.0))
    return where(near, close, log(a / b) / where(near, 1.0, m))


def angle_difference(rise: Expression, run: Expression, m: Expression) -> Expression:
    """Return the angle of the point (run, m rise), divided by m, without cancellation for small m."""
    near = absolute(m * rise) < _SERIES_BELOW * run
    safe_run = where(near, run, 1.0)
    close = rise / safe_run * arctan_ratio(where(near, m * rise / safe_run, 0.0))
    return where(near, close, arctan2(m * rise, where(near, 1.0, run)) / where(near, 1.0, m))
