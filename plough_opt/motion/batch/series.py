"""Taylor series in time of a differential equation's solution, order by order from its graph.

Jorba, Zou: A software package for the numerical integration of ODEs by means of high-order Taylor methods, Experimental
Mathematics 14 (2005); Griewank, Walther: Evaluating Derivatives, 2nd ed., 2008, chapter 13. Each kind of operation is a
class with the recurrence for the coefficients of its result. A coefficient that is zero for every design (those of a
constant, or of the time beyond the first) adds nothing to the compiled code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

_ZERO, _ONE = ca.SX(0), ca.SX(1)


class Series:
    """Taylor coefficients of one quantity. This class itself takes them from outside; `following` computes them.

    Attributes:
        coefficients: those known so far, from order 0.
        fixed: whether the quantity is independent of time.
        timed: whether it is a multiple of the time.
        affine: (another series, factor, summand) of which it is made, the latter two independent of time. A series that
            is not made of another one has itself, 1 and 0.
    """

    fixed = False
    timed = False

    def __init__(self, *coefficients: ca.SX) -> None:
        """Take the coefficients known at first."""
        self.coefficients = list(coefficients)
        self.affine: tuple[Series, ca.SX, ca.SX] = (self, _ONE, _ZERO)

    def __getitem__(self, order: int) -> ca.SX:
        return self.coefficients[order]

    def following(self, _: int, /) -> ca.SX | None:
        """Return the coefficient of an order, all lower ones being known; None if it comes from outside."""
        return None

    def slope(self, order: int) -> ca.SX:
        """Return the coefficient of an order of the time derivative."""
        return (order + 1) * self[order + 1]


class _WithRate(Series):
    """A series from outside whose time derivative is a series too."""

    def __init__(self, rate: Series, *coefficients: ca.SX) -> None:
        super().__init__(*coefficients)
        self._rate = rate

    def slope(self, order: int) -> ca.SX:
        return self._rate[order]


class _Constant(Series):
    fixed = True

    def following(self, _: int, /) -> ca.SX:
        return _ZERO


class _Clock(Series):
    """The time itself: the time at the start of the step, 1, 0, 0 ..."""

    timed = True

    def following(self, order: int, /) -> ca.SX:
        return _ONE if order == 1 else _ZERO

    def slope(self, order: int) -> ca.SX:
        return _ONE if order == 0 else _ZERO


class _Scaled(Series):
    """A fixed multiple of a series."""

    def __init__(self, x: Series, factor: ca.SX | float) -> None:
        super().__init__()
        base, by, plus = x.affine
        self._x, self._factor, self.timed = x, factor, x.timed
        self.affine = base, factor * by, factor * plus

    def following(self, order: int, /) -> ca.SX:
        return self._factor * self._x[order]

    def slope(self, order: int) -> ca.SX:
        return self._factor * self._x.slope(order)


class _Sum(Series):
    """The sum of two series, or with the sign -1 their difference."""

    def __init__(self, a: Series, b: Series, sign: float) -> None:
        super().__init__()
        self._a, self._b, self._sign = a, b, sign
        if a.fixed:
            base, by, plus = b.affine
            self.affine = base, sign * by, self._added(a[0], plus)
        elif b.fixed:
            base, by, plus = a.affine
            self.affine = base, by, self._added(plus, b[0])

    def _added(self, x: ca.SX, y: ca.SX) -> ca.SX:
        return x + y if self._sign > 0.0 else x - y

    def following(self, order: int, /) -> ca.SX:
        return self._added(self._a[order], self._b[order])

    def slope(self, order: int) -> ca.SX:
        if self._a.fixed:
            return self._sign * self._b.slope(order)
        if self._b.fixed:
            return self._a.slope(order)
        return self._added(self._a.slope(order), self._b.slope(order))


class _Product(Series):
    def __init__(self, a: Series, b: Series) -> None:
        super().__init__()
        self._a, self._b = a, b

    def following(self, order: int, /) -> ca.SX:
        return _convolved(self._a.coefficients, self._b.coefficients, order, 0)


class _AlikeProduct(Series):
    """The product of p x + q and r x + s, from the square of x."""

    def __init__(self, a: Series, b: Series, square: Series) -> None:
        super().__init__()
        self._a, self._b, self._square = a, b, square

    def following(self, order: int, /) -> ca.SX:
        (x, p, q), (_, r, s) = self._a.affine, self._b.affine
        if order == 0:
            return self._a[0] * self._b[0]
        return p * r * self._square[order] + (p * s + q * r) * x[order]


class _Square(Series):
    def __init__(self, x: Series) -> None:
        super().__init__()
        self._x = x

    def following(self, order: int, /) -> ca.SX:
        return _self_convolved(self._x.coefficients, order, 0)


class _Quotient(Series):
    """q = a/b, from a = b q."""

    def __init__(self, a: Series, b: Series) -> None:
        super().__init__()
        self._a, self._b = a, b

    def following(self, order: int, /) -> ca.SX:
        if order == 0:
            self._inverse = 1.0 / self._b[0]
        return (self._a[order] - _convolved(self._b.coefficients, self.coefficients, order, 1)) * self._inverse


class _Root(Series):
    """r = sqrt(x), from x = r^2."""

    def __init__(self, x: Series) -> None:
        super().__init__()
        self._x = x

    def following(self, order: int, /) -> ca.SX:
        if order == 0:
            return ca.sqrt(self._x[0])
        return (self._x[order] - _self_convolved(self.coefficients, order, 1)) / (2.0 * self[0])


class Integral(Series):
    """y = f(x), from y' = g x', where g may be made of y.

    Attributes:
        derivative: the series of g; it is set once y can be used to make it.
    """

    derivative: Series

    def __init__(self, function: Callable[[ca.SX], ca.SX], x: Series) -> None:
        """Take f and x."""
        super().__init__()
        self._function, self._x = function, x

    def following(self, order: int, /) -> ca.SX:
        """Return the coefficient of an order: of y' at first, which over the order is that of y."""
        if order == 0:
            return self._function(self._x[0])
        slopes = [self._x.slope(k) for k in range(order)]
        return _convolved(slopes, self.derivative.coefficients, order - 1, 0) / order


class _Choice(Series):
    """One of two series, by the sign of a third at the start of the step."""

    def __init__(self, switch: Series, yes: Series, no: Series) -> None:
        super().__init__()
        self._switch, self._yes, self._no = switch, yes, no

    def following(self, order: int, /) -> ca.SX:
        return ca.if_else(self._switch[0] <= 0.0, self._yes[order], self._no[order])


class _Masked(Series):
    """A series where a condition holds, elsewhere 0."""

    def __init__(self, x: Series, condition: Series) -> None:
        super().__init__()
        self._x, self._condition = x, condition

    def following(self, order: int, /) -> ca.SX:
        return ca.if_else(self._condition[0], self._x[order], 0.0)


class _Step(Series):
    """A function that is constant between switches."""

    def __init__(self, function: Callable[..., ca.SX], of: Sequence[Series]) -> None:
        super().__init__()
        self._function, self._of = function, of

    def following(self, order: int, /) -> ca.SX:
        return self._function(*(series[0] for series in self._of)) if order == 0 else _ZERO


class Graph:
    """Series that depend on each other, in an order in which each coefficient needs only those known by then."""

    def __init__(self) -> None:
        """Begin without any."""
        self._all: list[Series] = []
        self._circles: dict[int, tuple[Series, Series]] = {}
        self._squares: dict[int, Series] = {}
        self.switches: list[Series] = []
        """Series whose sign decides on the right-hand side's formula."""

    def extend(self, order: int) -> None:
        """Compute the coefficients of an order of all series, the orders below being known."""
        for series in self._all:
            if len(series.coefficients) == order and (coefficient := series.following(order)) is not None:
                series.coefficients.append(coefficient)

    def _add(self, series: Series) -> Series:
        self._all.append(series)
        return series

    def given(self, *coefficients: ca.SX, rate: Series | None = None) -> Series:
        """Return a series whose coefficients come from outside; its time derivative may be one of the others."""
        return self._add(Series(*coefficients) if rate is None else _WithRate(rate, *coefficients))

    def constant(self, value: ca.SX) -> Series:
        """Return the series of a value that is independent of time."""
        return self._add(_Constant(value))

    def clock(self, now: ca.SX) -> Series:
        """Return the series of the time itself."""
        return self._add(_Clock(now))

    def scaled(self, x: Series, factor: ca.SX | float) -> Series:
        """Return a fixed multiple of a series."""
        return self._add(_Scaled(x, factor))

    def total(self, a: Series, b: Series, sign: float = 1.0) -> Series:
        """Return a + b, or with the sign -1 a - b."""
        return self._add(_Sum(a, b, sign))

    def product(self, a: Series, b: Series) -> Series:
        """Return a b; if both are made of the same series, from the square of that."""
        if a.fixed or b.fixed:
            return self.scaled(b, a[0]) if a.fixed else self.scaled(a, b[0])
        if a is b:
            return self.square(a)
        base = a.affine[0]
        return self._add(_AlikeProduct(a, b, self.square(base)) if base is b.affine[0] else _Product(a, b))

    def square(self, x: Series) -> Series:
        """Return x^2, which is made once."""
        if id(x) not in self._squares:
            self._squares[id(x)] = self._add(_Square(x))
        return self._squares[id(x)]

    def quotient(self, a: Series, b: Series) -> Series:
        """Return a/b."""
        return self.scaled(a, 1.0 / b[0]) if b.fixed else self._add(_Quotient(a, b))

    def inverse(self, x: Series) -> Series:
        """Return 1/x."""
        return self.quotient(self.constant(_ONE), x)

    def root(self, x: Series) -> Series:
        """Return the square root of a series."""
        return self._add(_Root(x))

    def integral(self, function: Callable[[ca.SX], ca.SX], x: Series) -> Integral:
        """Return y = f(x), whose `Integral.derivative` is still to be set."""
        series = Integral(function, x)
        self._all.append(series)
        return series

    def circular(self, x: Series) -> tuple[Series, Series]:
        """Return sin(x) and cos(x), which are made once, each from the other."""
        if id(x) not in self._circles:
            sine, cosine = self.integral(ca.sin, x), self.integral(ca.cos, x)
            sine.derivative, cosine.derivative = cosine, self.scaled(sine, -1.0)
            self._circles[id(x)] = sine, cosine
        return self._circles[id(x)]

    def chosen(self, switch: Series, yes: Series, no: Series) -> Series:
        """Return one series until another becomes positive, then a third."""
        return self._add(_Choice(switch, yes, no))

    def masked(self, x: Series, condition: Series) -> Series:
        """Return a series where a condition holds, elsewhere 0."""
        return self._add(_Masked(x, condition))

    def switch(self, series: Series) -> Series:
        """Note a series whose sign decides on the right-hand side's formula, and return it."""
        self.switches.append(series)
        return series

    def step(self, function: Callable[..., ca.SX], *of: Series) -> Series:
        """Return a function that is constant between switches."""
        return self._add(_Step(function, of))


def _convolved(a: Sequence[ca.SX], b: Sequence[ca.SX], k: int, low: int) -> ca.SX:
    """Return the sum of a_j b_(k-j) for j from low to k."""
    total = _ZERO
    for j in range(low, k + 1):
        if not (a[j].is_zero() or b[k - j].is_zero()):
            total = total + a[j] * b[k - j]
    return total


def _self_convolved(a: Sequence[ca.SX], k: int, low: int) -> ca.SX:
    """Return the sum of a_j a_(k-j) for j from low to k - low; equal products are taken once."""
    total = _ZERO
    for j in range(low, (k + 1) // 2):
        if not (a[j].is_zero() or a[k - j].is_zero()):
            total = total + a[j] * a[k - j]
    total = 2.0 * total
    if k % 2 == 0 and k // 2 >= low:
        total = total + a[k // 2] ** 2
    return total
