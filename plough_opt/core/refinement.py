"""Convergence studies: error and time of a result over quadrature order, number of knots or any other size."""

import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import NOT_NUMBERS, check_callable, check_kind, plain_number, shown
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, is_count

# Evaluations of which the median time is taken.
_REPEATS = 5
# Relative error that is due to rounding, so that further refinement gains nothing.
_ROUNDING = 1e-14


@dataclass(frozen=True)
class Refinement:
    """Error and time of a result at several sizes; prints as a table.

    Attributes:
        sizes: orders, or numbers of knots, ascending.
        errors: largest difference from the result at twice the largest size, relative to that result's largest value.
        seconds: median time of one evaluation, after a warm-up [s].

    Example:
        >>> import plough_opt as po
        >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32])
        >>> found.sizes
        (8, 16, 32)
    """

    sizes: tuple[int, ...]
    errors: NDArray[np.float64]
    seconds: NDArray[np.float64]

    @property
    def cost(self) -> NDArray[np.float64]:
        """Times as multiples of the shortest."""
        ratios: NDArray[np.float64] = self.seconds / np.min(self.seconds)
        return ratios

    def size_for(self, error: float) -> int:
        """Return the smallest size whose relative error does not exceed the given one.

        Raises:
            InputError: the error is invalid, or not reached at any size.

        Example:
            >>> import plough_opt as po
            >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32, 64])
            >>> found.size_for(0.005)
            16
        """
        error = plain_number("error", error)
        if error < 0.0:
            raise InputError(f"error = {error:g} must be at least 0")
        for size, own in zip(self.sizes, self.errors, strict=True):
            if own <= error:
                return size
        raise InputError(f"no size up to {self.sizes[-1]} reaches a relative error of {error:g}: try larger sizes")

    def __str__(self) -> str:
        """Return the table, and the size beyond which refinement gains nothing."""
        rows = [f"{'size':>6} {'relative error':>16} {'time, fastest = 1':>18}"]
        for size, error, cost in zip(self.sizes, self.errors, self.cost, strict=True):
            rows.append(f"{size:>6} {error:>16.1e} {cost:>18.1f}")
        enough = [size for size, error in zip(self.sizes, self.errors, strict=True) if error <= _ROUNDING]
        if enough:
            rows.append(f"At {enough[0]} only rounding errors remain; larger sizes gain nothing.")
        return "\n".join(rows)


def refine(quantity: Callable[[int], Expression], sizes: Sequence[int]) -> Refinement:
    """Evaluate a result at several sizes, and compare with the result at twice the largest size.

    The size may be, for instance, the order of a density profile's quadrature or the number of knots of a profile::

        refine(lambda order: resistance(cone, soil.with_density_profile(rho, order=order), 2.0, 0.0), [4, 8, 16])
        refine(lambda n: elastic.wedge_stress(0.1, 0.1, elastic.knots(h, 0.5, n), soil, 2.0).yy, [8, 16, 32])

    Args:
        quantity: function of the size that returns a number or an array.
        sizes: sizes to try, at least one, each at least 1.

    Raises:
        InputError: there are no sizes, a size is below 1, or a result is not finite.

    Example:
        >>> import plough_opt as po
        >>> found = po.refine(lambda n: 1.0 + 1.0 / n**2, [8, 16, 32])
        >>> bool(found.errors[0] > found.errors[2])
        True
    """
    check_callable("the quantity", quantity, "of the size")
    check_kind("sizes", sizes, Sequence | np.ndarray, "a list of positive integers")
    tried = tuple(sizes)
    if not tried or not all(map(is_count, tried)):
        raise InputError(f"sizes = {shown(list(sizes))} must be one or more positive integers")
    tried = tuple(sorted(set(map(int, tried))))
    reference = _value(quantity, 2 * tried[-1])
    largest = float(np.max(np.abs(reference)))
    errors, seconds = [], []
    for size in tried:
        errors.append(float(np.max(np.abs(_value(quantity, size) - reference))) / (largest or 1.0))
        seconds.append(float(np.median(timeit.repeat(partial(quantity, size), number=1, repeat=_REPEATS))))
    return Refinement(tried, np.array(errors), np.array(seconds))


def _value(quantity: Callable[[int], Expression], size: int) -> NDArray[np.float64]:
    result = quantity(size)
    try:
        value = as_number(result)
    except InputError:
        raise
    except NOT_NUMBERS:
        raise InputError(f"the quantity returned {shown(result)} at size {size}, but must return numbers") from None
    if not np.all(np.isfinite(value)):
        raise InputError(f"the result at size {size} is not finite: refine a quantity that is finite at every size")
    return value
