"""Designs with fronts in closed form. Each front is traced once for all tests."""

import casadi as ca
import pytest
from helpers.small_designs import design

import plough_opt as po


@pytest.fixture
def plane():
    """Return a design of x in [-2, 2] and y in [-1, 1], and both symbols."""
    return design(x=(0.3, -2.0, 2.0), y=(0.5, -1.0, 1.0, "m"))


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


@pytest.fixture(scope="session", params=[["x"], "near"], ids=str)
def broken(request):
    """Front (x, (x - 0.3)^2 (0.8 - x)) for 0 <= x <= 1, interrupted from its minimum at 0.3 to 0.8.

    Some designs inside the interruption have no value. A guess behind it leads to both ends.
    """
    d, x, y = design(x=(0.95, 0.0, 1.0), y=(0.5, -1.0, 1.0))
    second = (x - 0.3) ** 2 * (0.8 - x) + y**2 + 1e-10 * ca.sqrt((x - 0.55) ** 2 - 1e-3)
    return po.trade_off(d, po.Goal("a", x + y**2, unit="N"), po.Goal("b", second), points=41, search=request.param)
