"""Points of fronts by brute force and closed forms; path following from quadratic programs to reused programs."""

import time

import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model import program as program_module
from plough_opt.design.model.optimality import quadratic_program
from plough_opt.studies.tradeoff.front import thinned, undominated, undominated_in_order, volume

# --- quadratic programs -------------------------------------------------------------------------------------


def test_quadratic_programs_meet_their_first_order_conditions():
    rng = np.random.default_rng(0)
    for _ in range(200):
        n, m = 3, rng.integers(1, 7)
        root = rng.normal(size=(n, n))
        curvature, gradient = root @ root.T + 0.01 * np.eye(n), rng.normal(size=n)
        rows = np.vstack([rng.normal(size=(m, n)), np.eye(n)])
        # Zero is feasible, and some limits are infinite.
        low = np.where(rng.random(m + n) < 0.3, -np.inf, -rng.random(m + n))
        high = np.where(rng.random(m + n) < 0.3, np.inf, rng.random(m + n))
        step, multipliers = quadratic_program(curvature, gradient, rows, (low, high))
        assert curvature @ step + gradient + rows.T @ multipliers == pytest.approx(np.zeros(n), abs=1e-11)
        values = rows @ step
        assert np.all((values > low - 1e-12) & (values < high + 1e-12))
        met = np.where(multipliers > 0.0, high, low)
        pulled = np.abs(multipliers) > 1e-12
        assert values[pulled] == pytest.approx(met[pulled], abs=1e-12)
    equality, contradiction = ((3.0, 3.0), (3.0, 3.0)), ((1.0, -np.inf), (np.inf, 0.5))
    step, multipliers = quadratic_program(np.eye(2), np.zeros(2), np.ones((2, 2)), np.array(equality))
    assert (*step, sum(multipliers)) == pytest.approx((1.5, 1.5, -1.5), rel=1e-13)
    assert quadratic_program(np.eye(2), np.zeros(2), np.ones((2, 2)), np.array(contradiction)) is None


# --- warm starts --------------------------------------------------------------------------------------------


# --- parameters and builds ----------------------------------------------------------------------------------


def shifted():
    """Return a design, and two objectives, the second of which has its optimum at a parameter."""
    d, x, y = design(x=(0.4, -4.0, 4.0), y=(0.4, -4.0, 4.0))
    c = d.parameter("c", 1.0)
    return d, (x**2 + y**2, (x - c) ** 2 + y**2)


def test_fronts_of_several_parameters_share_a_build(monkeypatch):
    built = []
    real = program_module.build_nlp
    monkeypatch.setattr(program_module, "build_nlp", lambda *a: built.append(1) or real(*a))
    d, goals = shifted()
    for c in (1.0, 3.0):
        front = po.trade_off(d, *goals, points=9, parameters={"c": c})
        assert np.sqrt(front.objectives).sum(axis=1) == pytest.approx(c, abs=1e-8)
    # The other objective weighs 1e-4 at the ends, and moves them by about as much.
    assert po.trade_off(d, *goals, points=9).objectives.max() == pytest.approx(1.0, abs=3e-4)
    assert len(built) == 2  # one, and a rough one for scans


def test_another_question_is_built_anew():
    d, (first, second) = shifted()
    local = {"points": 9, "search": "local"}
    began = time.perf_counter()
    front = po.trade_off(d, first, second, **local)
    assert 0.0 < front.seconds <= time.perf_counter() - began
    assert "Only the basin of the guess was searched" in front.search
    most = po.trade_off(d, first, po.Goal("b", -second, maximise=True), **local)
    assert most.objectives * [1.0, -1.0] == pytest.approx(front.objectives, abs=1e-9)
    assert -most.rates == pytest.approx(front.rates, rel=1e-6)
    assert most.hypervolume() == pytest.approx(front.hypervolume(), rel=1e-9)
    assert most.hypervolume((2.0, -3.0)) == pytest.approx(front.hypervolume((2.0, 3.0)), rel=1e-9)
    assert most.in_words(4).endswith("less b")
    d.require("kept", first, at_least=0.25)
    assert po.trade_off(d, first, second, **local).objectives[0, 0] == pytest.approx(0.25, rel=1e-8)


# --- domination, positions, gaps, area, volume and knee of points, against brute force and closed forms ---

# --- domination ---------------------------------------------------------------------------------------------


def test_efficient_rows_are_those_that_brute_force_finds():
    rng = np.random.default_rng(1)
    points = rng.random((300, 2))
    beaten = [any(np.all(other < point) for other in points) for point in points]
    found = undominated_in_order(points)
    assert sorted(found) == np.flatnonzero(~np.array(beaten)).tolist()
    assert np.all(np.diff(points[found, 0]) > 0.0)
    assert np.all(np.diff(points[found, 1]) < 0.0)


def test_of_rows_that_beat_each_other_by_rounding_one_stays():
    # Each row is better than the next by 1.7e-7 in one objective and worse by 0.9e-7 in two, where 1e-7 is rounding.
    turn = np.array([[0.0, 0.8, -0.9], [-0.9, 0.0, 0.8], [0.8, -0.9, 0.0]]) * 1e-7
    assert undominated(np.vstack([turn, turn[0] + 1e-3])).tolist() == [0, 2]
    twice = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    assert undominated(twice).tolist() == [0, 2]


def test_volume_is_that_of_the_boxes():
    rng = np.random.default_rng(2)
    points = rng.random((15, 3))
    # Sum the cells between the points' coordinates that some point dominates.
    cuts = [np.unique(np.r_[points[:, k], 1.1]) for k in range(3)]
    sizes = np.einsum("i,j,k->ijk", *(np.diff(cut) for cut in cuts))
    corners = np.stack(np.meshgrid(*(cut[:-1] for cut in cuts), indexing="ij"), axis=-1)
    covered = np.any(np.all(corners[..., None, :] >= points, axis=-1), axis=-1)
    assert volume(points, np.full(3, 1.1)) == pytest.approx(np.sum(sizes[covered]), rel=1e-13)
    assert volume(points, np.zeros(3)) == 0.0


# --- designs beyond a front ---------------------------------------------------------------------------------


# In a cell the row of least sum may be behind another one by the cell's size, and is then thinned out itself.
@pytest.mark.parametrize(("thin", "most"), [(undominated, 0.01), (thinned, 0.02)])
def test_thinned_designs_beat_all_others_to_a_tolerance(thin, most):
    designs = np.random.default_rng(1).random((2000, 3)) - 0.5
    kept = designs[thin(designs, 0.01)]
    behind = np.max(kept[None] - designs[:, None], axis=2).min(axis=1)
    assert np.max(behind) <= most
    assert len(thin(designs[:0], 0.01)) == 0
    assert not any(np.any(np.all(designs < own, axis=1)) for own in kept)
