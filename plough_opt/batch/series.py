"""Taylor series in time of a differential equation's solution, order by order from its graph.

Jorba, Zou: A software package for the numerical integration of ODEs by means of high-order Taylor methods, Experimental
Mathematics 14 (2005); Griewank, Walther: Evaluating Derivatives, 2nd ed., 2008, chapter 13. Every operation of the
right-hand side has a recurrence for the coefficients of its result. A coefficient that is zero for every design (those
of a constant, or of the time beyond the first) costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca

_ZERO = ca.SX(0)


@dataclass(eq=False)
class Series:
    """Coefficients of one quantity, as far as they are known.

    Attributes:
        next: returns the coefficient of the next order; None of a series that is given from outside.
        coefficients: what is known, from order 0.
    """

    next: Callable[[int], ca.SX] | None
    coefficients: list[ca.SX] = field(default_factory=list)

    def __getitem__(self, order: int) -> ca.SX:
        return self.coefficients[order]


class Graph:
    """Series that depend on each other, in an order in which each coefficient needs only what is known by then."""

    def __init__(self) -> None:
        """Begin without any."""
        self._all: list[Series] = []
        self._slopes: dict[int, list[ca.SX]] = {}
        self._circles: dict[int, tuple[Series, Series]] = {}
        self._fixed: set[int] = set()
        self._timed: set[int] = set()
        self.switches: list[Series] = []
        """Series that change their sign where the right-hand side changes its formula."""

    def extend(self, order: int) -> None:
        """Find the coefficients of an order of all series, the orders below being known."""
        for series in self._all:
            if series.next is not None and len(series.coefficients) == order:
                series.coefficients.append(series.next(order))

    def given(self, *coefficients: ca.SX) -> Series:
        """Return a series whose coefficients come from outside; those of a constant are all there."""
        return self._add(Series(None, list(coefficients)))

    def constant(self, value: ca.SX) -> Series:
        """Return the series of what does not depend on time."""
        series = self._add(Series(lambda _: _ZERO, [value]))
        self._fixed.add(id(series))
        return series

    def clock(self, now: ca.SX) -> Series:
        """Return the series of the time itself."""
        return self.keep_time(self.polynomial(now, ca.SX(1)))

    def keep_time(self, series: Series) -> Series:
        """Note a series that is a multiple of the time, and return it."""
        self._timed.add(id(series))
        return series

    def polynomial(self, *coefficients: ca.SX) -> Series:
        """Return the series of a polynomial in time."""
        return self._add(Series(lambda k: coefficients[k] if k < len(coefficients) else _ZERO))

    def is_clock(self, a: Series, b: Series) -> bool:
        """Tell whether one of them is a multiple of the time, and the other does not depend on it."""
        return sorted((id(a) in self._timed) + 2 * (id(b) in self._fixed) for a, b in ((a, a), (b, b))) == [1, 2]

    def is_fixed(self, *series: Series) -> bool:
        """Tell whether none of them depends on time."""
        return all(id(one) in self._fixed for one in series)

    def _add(self, series: Series) -> Series:
        self._all.append(series)
        return series

    def linear(self, function: Callable[..., ca.SX], *of: Series) -> Series:
        """Return a linear function of series, coefficient by coefficient."""
        return self._add(Series(lambda k: function(*(series[k] for series in of))))

    def product(self, a: Series, b: Series) -> Series:
        """Return a b."""
        if a is b:
            return self.square(a)
        return self._add(Series(lambda k: _convolved(a.coefficients, b.coefficients, k, 0, k)))

    def square(self, a: Series) -> Series:
        """Return a^2."""
        return self._add(Series(lambda k: _halves(a.coefficients, k, 0)))

    def quotient(self, a: Series, b: Series) -> Series:
        """Return a / b."""
        inverse = self._add(Series(lambda k: 1.0 / b[0] if k == 0 else _ZERO))
        result = self._add(Series(None))
        result.next = lambda k: (a[k] - _convolved(b.coefficients, result.coefficients, k, 1, k)) * inverse[0]
        return result

    def root(self, a: Series) -> Series:
        """Return the square root of a series."""
        result = self._add(Series(None))
        result.next = lambda k: (
            ca.sqrt(a[0]) if k == 0 else (a[k] - _halves(result.coefficients, k, 1)) / (2.0 * result[0])
        )
        return result

    def integral(self, first: Callable[[ca.SX], ca.SX], x: Series, slope: Callable[[Series], Series]) -> Series:
        """Return y = first(x), of which y' = slope(y) x'."""
        result = self._add(Series(None))
        inner = slope(result)

        def following(k: int) -> ca.SX:
            if k == 0:
                return first(x[0])
            rates = self._slopes.setdefault(id(x), [_ZERO])
            while len(rates) <= k:
                rates.append(len(rates) * x[len(rates)])
            return _convolved(rates, inner.coefficients, k, 1, k) / k

        result.next = following
        return result

    def cosine(self, x: Series) -> Series:
        """Return cos(x)."""
        return self._circular(x)[1]

    def sine(self, x: Series) -> Series:
        """Return sin(x)."""
        return self._circular(x)[0]

    def _circular(self, x: Series) -> tuple[Series, Series]:
        if id(x) not in self._circles:

            def minus_sine(cosine: Series) -> Series:
                sine.append(self.integral(ca.sin, x, lambda _: cosine))
                return self.linear(lambda s: -s, sine[0])

            sine: list[Series] = []
            cosine = self.integral(ca.cos, x, minus_sine)
            self._circles[id(x)] = sine[0], cosine
        return self._circles[id(x)]

    def chosen(self, condition: Callable[[], ca.SX], yes: Series, no: Series) -> Series:
        """Return one of two series, by a condition on their coefficients of order 0."""
        return self._add(Series(lambda k: ca.if_else(condition(), yes[k], no[k])))

    def switch(self, series: Series) -> Series:
        """Note a series whose sign decides on the right-hand side's formula, and return it."""
        self.switches.append(series)
        return series

    def shifted(self, x: Series, by: float) -> Series:
        """Return x + by."""
        return self._add(Series(lambda k: x[k] + by if k == 0 else x[k]))

    def step(self, function: Callable[..., ca.SX], *of: Series) -> Series:
        """Return what is constant between switches."""
        return self._add(Series(lambda k: function(*(series[0] for series in of)) if k == 0 else _ZERO))


def _convolved(a: Sequence[ca.SX], b: Sequence[ca.SX], k: int, low: int, high: int) -> ca.SX:
    """Return the sum of a_j b_(k-j) for j from low to high."""
    total = _ZERO
    for j in range(low, high + 1):
        if not (a[j].is_zero() or b[k - j].is_zero()):
            total = total + a[j] * b[k - j]
    return total


def _halves(a: Sequence[ca.SX], k: int, low: int) -> ca.SX:
    """Return the sum of a_j a_(k-j) for j from low to k - low; equal products are taken once."""
    total = _ZERO
    for j in range(low, (k + 1) // 2):
        if not (a[j].is_zero() or a[k - j].is_zero()):
            total = total + a[j] * a[k - j]
    total = 2.0 * total
    if k % 2 == 0 and k // 2 >= low:
        total = total + a[k // 2] ** 2
    return total
