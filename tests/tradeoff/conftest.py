"""Designs with fronts in closed form. Each front is traced once for all tests."""

import pytest
from helpers.small_designs import design

import plough_opt as po


@pytest.fixture
def plane():
    """Return a design of x in [-2, 2] and y in [-1, 1], and both symbols."""
    d, x, y = design(x=(0.3, -2.0, 2.0), y=(0.5, -1.0, 1.0, "m"))
    return d, x, y


@pytest.fixture(scope="session")
def convex():
    """Front sqrt(f1) + sqrt(f2) = 1 of the distances from (0, 0) and (1, 0), at 21 positions."""
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    return po.trade_off(d, x**2 + y**2, (x - 1.0) ** 2 + y**2, points=21, title="two squares")


@pytest.fixture(scope="session")
def concave():
    """Front f1^2 + f2^2 = 1 of points outside the unit circle, at 21 positions; a weighted sum finds only its ends."""
    d, x, y = design(x=(0.9, 0.0, 2.0), y=(0.9, 0.0, 2.0))
    d.require("outside", x**2 + y**2, at_least=1.0)
    return po.trade_off(d, po.Goal("a", x), po.Goal("b", y), points=21)


@pytest.fixture(scope="session")
def broken():
    """Front (x, (x - 0.3)^2 (0.8 - x)) for 0 <= x <= 1, interrupted from its minimum at 0.3 to 0.8."""
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, -1.0, 1.0))
    first = po.Goal("a", x + y**2, unit="N")
    return po.trade_off(d, first, po.Goal("b", (x - 0.3) ** 2 * (0.8 - x) + y**2), points=41, search=["x"])
