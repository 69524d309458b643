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
        fixed: whether it does not depend on time.
        timed: whether it is a multiple of the time.
        derivative: returns the coefficient of an order of the time derivative, where that is cheaper than from the
            coefficients.
        affine: (another series, factor, summand) of which it is made, the latter two fixed.
    """

    next: Callable[[int], ca.SX] | None
    coefficients: list[ca.SX] = field(default_factory=list)
    fixed: bool = False
    timed: bool = False
    derivative: Callable[[int], ca.SX] | None = None
    affine: tuple[Series, ca.SX, ca.SX] | None = None

    def __getitem__(self, order: int) -> ca.SX:
        return self.coefficients[order]

    def slope(self, order: int) -> ca.SX:
        """Return the coefficient of an order of the time derivative."""
        return (order + 1) * self[order + 1] if self.derivative is None else self.derivative(order)

    def parts(self) -> tuple[Series, ca.SX, ca.SX]:
        """Return `affine`, or itself with factor 1 and summand 0."""
        return self.affine or (self, ca.SX(1), _ZERO)


class Graph:
    """Series that depend on each other, in an order in which each coefficient needs only what is known by then."""

    def __init__(self) -> None:
        """Begin without any."""
        self._all: list[Series] = []
        self._circles: dict[int, tuple[Series, Series]] = {}
        self._squares: dict[int, Series] = {}
        self.switches: list[Series] = []
        """Series that change their sign where the right-hand side changes its formula."""

    def extend(self, order: int) -> None:
        """Find the coefficients of an order of all series, the orders below being known."""
        for series in self._all:
            if series.next is not None and len(series.coefficients) == order:
                series.coefficients.append(series.next(order))

    def _add(self, series: Series) -> Series:
        self._all.append(series)
        return series

    def given(self, *coefficients: ca.SX, rate: Series | None = None) -> Series:
        """Return a series whose coefficients come from outside, and of which another may be the time derivative."""
        derivative = None if rate is None else rate.__getitem__
        return self._add(Series(None, list(coefficients), derivative=derivative))

    def constant(self, value: ca.SX) -> Series:
        """Return the series of what does not depend on time."""
        return self._add(Series(lambda _: _ZERO, [value], fixed=True))

    def clock(self, now: ca.SX) -> Series:
        """Return the series of the time itself."""
        series = Series(lambda k: ca.SX(1) if k == 1 else _ZERO, [now], timed=True)
        series.derivative = lambda k: ca.SX(1) if k == 0 else _ZERO
        return self._add(series)

    def scaled(self, x: Series, factor: ca.SX | float) -> Series:
        """Return a fixed multiple of a series."""
        base, by, plus = x.parts()
        result = Series(lambda k: factor * x[k], timed=x.timed, affine=(base, factor * by, factor * plus))
        result.derivative = lambda k: factor * x.slope(k)
        return self._add(result)

    def total(self, a: Series, b: Series, sign: float = 1.0) -> Series:
        """Return a + b, or with the sign -1 a - b."""

        def added(x: ca.SX, y: ca.SX) -> ca.SX:
            return x + y if sign > 0.0 else x - y

        result = Series(lambda k: added(a[k], b[k]), derivative=lambda k: added(a.slope(k), b.slope(k)))
        if a.fixed:
            result.derivative = lambda k: sign * b.slope(k)
            base, by, plus = b.parts()
            result.affine = base, sign * by, added(a[0], plus)
        elif b.fixed:
            result.derivative = a.slope
            base, by, plus = a.parts()
            result.affine = base, by, added(plus, b[0])
        return self._add(result)

    def product(self, a: Series, b: Series) -> Series:
        """Return a b; of what differs by fixed numbers only, from the square of what they share."""
        if a.fixed or b.fixed:
            return self.scaled(b, a[0]) if a.fixed else self.scaled(a, b[0])
        if a is b:
            return self.square(a)
        (base, p, q), (other, r, s) = a.parts(), b.parts()
        if base is not other:
            return self._add(Series(lambda k: _convolved(a.coefficients, b.coefficients, k, 0, k)))
        square = self.square(base)
        return self._add(Series(lambda k: p * r * square[k] + (p * s + q * r) * base[k] if k else a[0] * b[0]))

    def square(self, a: Series) -> Series:
        """Return a^2."""
        if id(a) not in self._squares:
            self._squares[id(a)] = self._add(Series(lambda k: _halves(a.coefficients, k, 0)))
        return self._squares[id(a)]

    def quotient(self, a: Series, b: Series) -> Series:
        """Return a / b."""
        if b.fixed:
            return self.scaled(a, 1.0 / b[0])
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
            return _convolved([x.slope(j) for j in range(k)], inner.coefficients, k - 1, 0, k - 1) / k

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
                return self.scaled(sine[0], -1.0)

            sine: list[Series] = []
            cosine = self.integral(ca.cos, x, minus_sine)
            self._circles[id(x)] = sine[0], cosine
        return self._circles[id(x)]

    def chosen(self, condition: Callable[[], ca.SX], yes: Series, no: Series) -> Series:
        """Return one of two series, by a condition on their coefficients of order 0."""
        return self._add(Series(lambda k: ca.if_else(condition(), yes[k], no[k])))

    def masked(self, x: Series, condition: Series) -> Series:
        """Return a series where a condition holds, elsewhere zero."""
        return self._add(Series(lambda k: ca.if_else(condition[0], x[k], 0.0)))

    def switch(self, series: Series) -> Series:
        """Note a series whose sign decides on the right-hand side's formula, and return it."""
        self.switches.append(series)
        return series

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
