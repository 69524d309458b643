"""A step and a ramp that are smoothed over a given width, with continuous second derivatives.

Both are convolutions with the triweight kernel k(u) = 35/32 (1 - u^2)^3 on [-1, 1], u = x/width (Wand and Jones 1995,
"Kernel smoothing", section 2.2): beyond the width they are exactly the step 1(x > 0) and the ramp max(x, 0). The kernel
has the variance 1/9, so that averages over a density f differ from the sharp ones by f'(0) width^2/18 and
f(0) width^2/18 to first order; the ramp lies above the sharp one by at most 35/256 of the width.
"""

from plough_opt.core.expressions import Expression, maximum, minimum

KERNEL_VARIANCE = 1.0 / 9.0
"""Variance of the kernel for a width of 1."""

MOST_ROUNDING = 35.0 / 256.0
"""Largest difference of the ramp from max(x, 0), in widths."""

_PEAK = 35.0 / 32.0


def density(u: Expression) -> Expression:
    """Return the kernel k(u)."""
    inner = 1.0 - _clipped(u) ** 2
    return _PEAK * inner**3


def step(u: Expression) -> Expression:
    """Return the integral of the kernel up to u: 0 below -1, 1/2 at 0, 1 above 1."""
    u = _clipped(u)
    square = u * u
    return 0.5 + _PEAK * u * (1.0 + square * (-1.0 + square * (0.6 - square / 7.0)))


def ramp(u: Expression) -> Expression:
    """Return the integral of the step up to u: 0 below -1, u above 1."""
    inner = _clipped(u)
    square = inner * inner
    rounded = _PEAK * square * (0.5 + square * (-0.25 + square * (0.1 - square / 56.0)))
    return MOST_ROUNDING + 0.5 * inner + rounded + maximum(u - 1.0, 0.0)


def _clipped(u: Expression) -> Expression:
    return minimum(maximum(u, -1.0), 1.0)
