"""`refine`: errors and times of quadratures whose errors are known."""

import math
import re

import numpy as np
import pytest

import plough_opt as po
from plough_opt.core.refinement import Refinement


def midpoints(count):
    """Return the integral of exp from 0 to 1 by the midpoint rule."""
    return math.fsum(math.exp((k + 0.5) / count) for k in range(count)) / count


def test_errors_and_order_of_a_method_are_recovered():
    # The reference has twice the largest size.
    found = po.refine(midpoints, [4, 8, 16, 32])
    wanted = [abs(midpoints(size) / midpoints(64) - 1.0) for size in found.sizes]
    np.testing.assert_allclose(found.errors, wanted, rtol=1e-10)
    errors = found.errors + abs(math.e - 1.0 - midpoints(64)) / midpoints(64)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=3e-3)
    assert str(found).count("\n") == len(found.sizes)  # nothing is said of rounding


def test_errors_of_arrays_are_the_largest_relative_to_the_largest_value():
    # The errors of the elements of (2, -20, 2) are 1/size, 4/size and 0.
    found = po.refine(lambda size: np.array([2.0 + 1.0 / size, -20.0 + 4.0 / size, 2.0]), [4, 1, 2, 2])
    assert found.sizes == (1, 2, 4)
    reference = 20.0 - 4.0 / 8
    np.testing.assert_allclose(found.errors, [4.0 * (1.0 / n - 1.0 / 8) / reference for n in (1, 2, 4)], rtol=1e-14)


STUDY = Refinement((2, 4, 8, 16), np.array([0.01, 3e-6, 9.9e-15, 1e-16]), np.array([2e-3, 1e-3, 3e-3, 25e-3]))


@pytest.mark.parametrize(("error", "size"), [(1.0, 2), (0.01, 2), (0.0099, 4), (1e-16, 16)])
def test_size_for_an_error_is_the_smallest_that_reaches_it(error, size):
    assert STUDY.size_for(error) == size


@pytest.mark.parametrize("error", [9e-17, 0.0])
def test_an_error_out_of_reach_is_refused_with_the_largest_size_tried(error):
    with pytest.raises(po.InputError, match=f"no size up to 16 reaches a relative error of {error:g}: try larger"):
        STUDY.size_for(error)


def test_an_error_below_0_is_refused():
    with pytest.raises(po.InputError, match=r"error = -0\.01 must be at least 0"):
        STUDY.size_for(-0.01)


def test_the_table_shows_size_error_and_cost():
    heading, *rows, said = str(STUDY).splitlines()
    assert heading.split("  ")[-1] == "time, fastest = 1"
    assert [row.split()[0::2] for row in rows] == [["2", "2.0"], ["4", "1.0"], ["8", "3.0"], ["16", "25.0"]]
    assert rows[2].split()[1] == "9.9e-15"
    assert said == "At 8 only rounding errors remain; larger sizes gain nothing."


@pytest.mark.parametrize("sizes", [[], [4, 0], [2.5, 4], ["4"]])
def test_invalid_sizes_are_refused(sizes):
    with pytest.raises(po.InputError, match=re.escape(f"sizes = {sizes} must be one or more positive integers")):
        po.refine(float, sizes)


@pytest.mark.parametrize("bad", [math.inf, np.array([1.0, math.nan])])
@pytest.mark.parametrize("where", [2, 8])
def test_a_result_that_is_not_finite_is_refused_with_its_size(bad, where):
    with pytest.raises(po.InputError, match=f"the result at size {where} is not finite"):
        po.refine(lambda size: bad if size == where else np.ones(np.shape(bad)), [2, 4])
