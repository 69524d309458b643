"""Fronts of three objectives, in closed form: on their surfaces, evenly over all of them, with exact rates."""

import itertools
import math

import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.studies.tradeoff.front import distances, undominated

POINTS, STEPS = 28, 6


# A search over all variables takes a minute longer. By default only the plane is searched so.
@pytest.fixture(scope="module", params=["near", pytest.param("auto", marks=pytest.mark.slow)])
def search(request):
    """Options of the search for a surface."""
    return request.param


@pytest.fixture(scope="module")
def sphere(search):
    """Concave front |f| = 1 outside the unit sphere, of which a weighted sum finds only the corners (DTLZ2)."""
    d, *x = design(**dict.fromkeys("xyz", (0.7, 0.0, 1.5)))
    d.require("outside", sum(own**2 for own in x), at_least=1.0)
    goals = (po.Goal(name, own) for name, own in zip("abc", x, strict=True))
    return po.trade_off(d, *goals, points=POINTS, search=search)


@pytest.fixture(scope="module")
def plane():
    """Front f1 + f2 + f3 = 1 (DTLZ1)."""
    d, *x = design(**dict.fromkeys("xyz", (0.5, 0.0, 1.0)))
    d.require("above", sum(x), at_least=1.0)
    return po.trade_off(d, *x, points=POINTS)


@pytest.fixture(scope="module")
def convex(search):
    """Front of the squared distances from three corners, whose efficient designs are those of the triangle."""
    d, x, y, z = design(x=(0.3, -2.0, 2.0), y=(0.3, -2.0, 2.0), z=(0.3, -2.0, 2.0))
    corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    goals = [po.Goal(f"to {a:g}, {b:g}", (x - a) ** 2 + (y - b) ** 2 + z**2) for a, b in corners]
    return po.trade_off(d, *goals, points=45, search=search)


# --- shapes -------------------------------------------------------------------------------------------------


def test_points_lie_on_the_surfaces(sphere, plane, convex):
    # The optimiser meets first-order conditions and requirements to 1e-10, anchors to that over a weight of 1e-6.
    assert np.linalg.norm(sphere.objectives, axis=1) == pytest.approx(1.0, abs=2e-5)
    assert np.sort(np.abs(np.linalg.norm(sphere.objectives, axis=1) - 1.0))[:-3] == pytest.approx(0.0, abs=1e-8)
    assert np.sum(plane.objectives, axis=1) == pytest.approx(1.0, abs=1e-8)
    x, y, z = convex.designs.T
    assert z == pytest.approx(0.0, abs=1e-5)
    for side in (x, y, 1.0 - x - y):
        assert np.all(side > -1e-4)


def test_anchors_are_on_the_front(sphere, convex):
    for corner in np.eye(3):
        assert np.min(np.max(np.abs(sphere.objectives - corner), axis=1)) < 1e-4
    # The second and third objectives weigh 1e-3 and 1e-6 in an anchor, and move it by about as much.
    for corner in [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]:
        assert np.min(np.max(np.abs(convex.designs - corner), axis=1)) < 3e-3


def test_a_plane_is_the_lattice_itself(plane):
    lattice = [(i, j, STEPS - i - j) for i in range(STEPS + 1) for j in range(STEPS + 1 - i)]
    assert {tuple(row) for row in np.round(plane.objectives * STEPS).astype(int)} == set(lattice)
    assert plane.objectives * STEPS == pytest.approx(np.round(plane.objectives * STEPS), abs=1e-6)


def test_the_whole_surface_is_covered(sphere, convex):
    grid = np.array([p for p in itertools.product(np.linspace(0.0, 1.0, 25), repeat=2) if sum(p) <= 1.0])
    ball = np.column_stack([grid, 1.0 - np.sum(grid, axis=1)])
    triangle = np.column_stack([np.sum((grid - corner) ** 2, axis=1) for corner in ((0, 0), (1, 0), (0, 1))])
    for front, wanted, size, step in (
        (sphere, ball / np.linalg.norm(ball, axis=1, keepdims=True), 1.0, 1.0 / STEPS),
        (convex, triangle, np.array([1.0, 2.0, 2.0]), 1.0 / 8.0),
    ):
        seen, found = (rows / size - np.mean(rows / size, axis=1, keepdims=True) for rows in (wanted, front.objectives))
        apart = np.min(np.max(np.abs(seen[:, None] - found[None]), axis=2), axis=1)
        # Every place in the lattice is within 2/3 of a step of a node; at the edges points are 0.7 steps apart.
        assert np.max(apart) < 1.3 * step
        assert np.mean(apart) < 0.6 * step


def test_no_point_beats_another(sphere, plane, convex):
    for front in (sphere, plane, convex):
        assert len(undominated(front.objectives)) == len(front.points)
        assert front.parts == (tuple(range(len(front.points))),)
        assert front.holes == front.failures == ()


def test_points_are_even(sphere):
    apart = distances(sphere.objectives) + np.eye(len(sphere.points))
    # Where the surface is steep, points between the nodes are shown too, so that no part of it is far from a point.
    assert np.min(apart) > 0.4 / STEPS
    assert np.max(np.min(apart, axis=1)) < 1.3 / STEPS


# --- rates --------------------------------------------------------------------------------------------------


def test_rates_on_a_sphere(sphere):
    inner = [k for k, point in enumerate(sphere.points) if point.weights is not None and min(point.objectives) > 0.05]
    assert len(inner) > 10
    for k in inner:
        f = sphere.points[k].objectives
        for of, by in itertools.permutations(range(3), 2):
            # With the third objective held constant, f_of df_of + f_by df_by = 0.
            assert sphere.rate(k, of, by) == pytest.approx(-f[by] / f[of], rel=1e-6)
            assert sphere.cost(k, of, by) == pytest.approx((f[by] / f[of]) ** 2, rel=1e-6)


def test_words_on_three_objectives(sphere):
    middle = max(sphere.points, key=lambda point: min(point.objectives))
    assert sphere.in_words(sphere.points.index(middle), 2, 0).endswith("1 % less a costs 1 % more c")
    # The point in the middle of the sphere, to within a step of the lattice.
    assert middle.objectives == pytest.approx([1.0 / math.sqrt(3.0)] * 3, abs=0.02)
    with pytest.raises(po.InputError, match="of = 1 and by = 1 must be two different objectives, from 0 to 2"):
        sphere.rate(3, 1, 1)
    with pytest.raises(po.InputError, match="must be 3 objectives, finite numbers"):
        sphere.hypervolume((1.0, 1.0))


def test_the_knee_of_the_triangle(convex, sphere):
    best = np.array(convex.knee.objectives) / [1.0, 2.0, 2.0]
    assert np.sum(best) == pytest.approx(np.min(np.sum(convex.objectives / [1.0, 2.0, 2.0], axis=1)), abs=0.02)
    assert sphere.knee is None


# --- shapes that are not whole ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_hole_between_two_parts():
    d, x, y = design(x=(0.2, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    d.require("outside", (x - 0.5) ** 2, at_least=0.09)
    front = po.trade_off(d, x, y, 2.0 - x - y, points=45, search=["x"])
    assert np.sum(front.objectives, axis=1) == pytest.approx(2.0, abs=1e-8)
    assert len(front.parts) == 2
    (hole,) = front.holes
    ends = sorted([hole.start[0], hole.end[0]])
    # An edge is located to half a step of the first objective's range of 1, and points are 0.7 steps apart.
    assert 0.0 < ends[0] <= 0.2 + 1e-9
    assert 0.8 - 1e-9 <= ends[1] < 1.0
    assert np.all((front.designs[:, 0] < 0.2 + 1e-9) | (front.designs[:, 0] > 0.8 - 1e-9))


def test_a_tail_that_gains_little_is_followed_to_its_end():
    d, s, t = design(s=(0.3, 0.0, 1.0), t=(0.3, 0.0, 1.0))
    # With t = 0 every s is efficient: from 0.6 to 1 the third objective gains 4 % for 40 and 64 % of the others.
    rest = 1.0 - s
    front = po.trade_off(d, s + t**2, s**2 + t**2, rest**4 + 0.03 * rest + t**2, points=45)
    step = 1.0 / 8.0
    # No design is farther from a point than two thirds of a step.
    assert np.max(np.diff(np.sort(np.r_[0.0, front.objectives[:, 0], 1.0]))) < 4.0 / 3.0 * step


def test_an_objective_that_conflicts_with_none_leaves_a_curve():
    d, x, y = design(x=(0.4, -2.0, 2.0), y=(0.4, -2.0, 2.0))
    idle = po.Goal("idle", 3.0 + y**2)
    front = po.trade_off(d, po.Goal("a", x**2 + y**2), idle, po.Goal("b", (x - 1.0) ** 2 + y**2), points=9)
    assert [goal.name for goal in front.goals] == ["a", "b"]
    assert front.notes[0] == "'idle' does not conflict with the others: it is at its best all along their front"
    assert np.sqrt(front.objectives).sum(axis=1) == pytest.approx(1.0, abs=1e-6)
