"""Points of fronts by brute force and closed forms; path following from quadratic programs to reused programs."""

import time

import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model import program as program_module
from plough_opt.design.model.optimality import quadratic_program
from plough_opt.design.search.local import point_as_found
from plough_opt.studies.tradeoff import program as programs
from plough_opt.studies.tradeoff.front import (
    lead_over_front,
    lead_over_points,
    parts_of,
    strongest_dominators,
    thinned,
    uncrowded_on_curve,
    uncrowded_on_surface,
    undominated,
    undominated_in_order,
    volume,
)
from plough_opt.studies.tradeoff.program import BatchCorrector, FrontProgram, declarations

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


def test_a_front_is_followed_from_point_to_point_in_few_steps(plane, monkeypatch):
    found, real = [], programs.Corrector.correct

    def correct(*given):
        found.append(real(*given))
        return found[-1]

    monkeypatch.setattr(programs.Corrector, "correct", correct)
    d, x, y = plane
    goals = (x**2 + y**2) ** 2, ((x - 1.0) ** 2 + y**2) ** 2
    assert len(po.trade_off(d, *goals, points=41, search="near").points) == 41
    # Starts are predicted from the last two designs; from the last one alone it takes 2.2 steps. IPOPT is never needed.
    assert np.mean([point.iterations if point.solved else np.inf for point in found]) < 2.0


@pytest.mark.parametrize("batched", [True, False])
def test_a_solve_from_afar_finds_the_optimum_or_says_that_there_is_none(batched):
    d, height, speed = design(height=(0.25, 0.1, 0.5, "m"), speed=(1.2, 1.0, 3.0, "m/s"))
    share = po.Wedge(po.deg(30), po.deg(15), height)
    scene = po.Scene(po.named_soil("serozem"), share, 5e4, 25.0, speed, po.Effects(damping=400.0))
    # Least at a height of 0.3 m, and at a speed of 2 m/s.
    goals = [po.Goal("height", (height - 0.3) ** 2), po.Goal("speed", (speed - 2.0) ** 2)]
    d.require("draft", po.simulate(scene, 0.1).mean_draft, at_most=1e6, unit="N")
    front = FrontProgram(declarations(d, goals), goals)
    front.prepare(np.empty(0))
    start = front.program.start()
    front.build([start])
    corrector = front.correctors[not batched]
    assert isinstance(corrector, BatchCorrector) is batched
    p = front.weighted(np.ones(2))
    found = corrector.solve_from_afar(point_as_found(front.program, p, start), start, p)
    assert found.solved
    # Slopes of 5e-7 that differences leave are errors of as much in a scaled variable, for curvatures are about 1.
    assert front.program.values(found.y) == pytest.approx([0.3, 2.0], rel=1e-5)
    # The second objective is never negative.
    p = front.limited(0, {1: -1.0})
    none = corrector.solve_from_afar(found, found.y, p)
    assert not none.solved
    assert none.status == "Infeasible_Problem_Detected"


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

LINE = np.column_stack([np.linspace(0.0, 1.0, 11), np.linspace(1.0, 0.0, 11)])


# --- domination ---------------------------------------------------------------------------------------------


def test_efficient_rows_are_those_that_brute_force_finds():
    rng = np.random.default_rng(1)
    points = rng.random((300, 2))
    beaten = [any(np.all(other < point) for other in points) for point in points]
    found = undominated_in_order(points)
    assert sorted(found) == np.flatnonzero(~np.array(beaten)).tolist()
    assert np.all(np.diff(points[found, 0]) > 0.0)
    assert np.all(np.diff(points[found, 1]) < 0.0)


def test_crowded_rows_go_and_ends_of_parts_stay():
    front = np.array([[0.0, 1.0], [0.001, 0.999], [0.1, 0.9], [0.2, 0.8], [0.201, 0.799], [0.9, 0.1], [1.0, 0.0]])
    assert uncrowded_on_curve(front, 0.2).tolist() == [0, 2, 4, 5, 6]


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


def test_designs_beyond_a_line():
    designs = np.array([[0.33, 0.67], [0.33, 0.57], [0.33, 0.77], [-0.1, 1.5], [1.2, 0.3]])
    # On the line, below it by 0.05 in both objectives, above it, beyond an end by 0.1, and dominated by an end.
    assert lead_over_front(LINE, designs, 0.2)[:4] == pytest.approx([0.0, 0.05, -0.05, 0.1], abs=1e-12)
    assert lead_over_front(LINE, designs, 0.2)[4] < 0.0


def test_in_a_gap_only_points_count():
    broken = np.delete(LINE, [4, 5, 6], axis=0)
    middle = np.array([[0.5, 0.5]])
    assert lead_over_front(broken, middle, 0.2) == pytest.approx([0.2])
    assert lead_over_points(broken, middle) == pytest.approx([0.2])
    # A front of one point has no line.
    assert lead_over_front(LINE[:1], middle, 0.2) == pytest.approx([0.5])
    # With steps four times as long the same neighbours are not far apart.
    assert lead_over_front(broken, middle, 0.8) == pytest.approx([0.0], abs=1e-12)


def test_designs_beyond_a_plane():
    plane = np.array([[i, j, 6 - i - j] for i in range(7) for j in range(7 - i)]) / 6.0
    designs = np.array([[0.3, 0.3, 0.4], [0.3, 0.3, 0.37], [0.3, 0.3, 0.43]])
    assert lead_over_front(plane, designs, 1.0 / 6.0) == pytest.approx([0.0, 0.01, -0.01], abs=1e-12)
    # Points on a line have no triangle, and a lead of half a step does not count.
    assert lead_over_front(plane[:7], designs, 1 / 6) == pytest.approx(lead_over_points(plane[:7], designs) - 1 / 12)
    # Beyond the edge a lead of half a step does not count.
    outside = np.array([[-0.05, 0.5, 0.55]])
    assert lead_over_front(plane, outside, 1.0 / 6.0)[0] < 0.0 < lead_over_points(plane, outside)[0]


def test_by_how_much_designs_beat_a_point():
    designs = np.array([[0.4, 0.5], [0.1, 0.95], [0.5, 0.6]])
    most, by = strongest_dominators(LINE, designs)
    assert by == pytest.approx([max(min(a - c, b - d) for c, d in designs) for a, b in LINE], abs=1e-15)
    assert [most[0], most[10]] == [1, 0]
    assert np.all(strongest_dominators(LINE, np.empty((0, 2)))[1] == -np.inf)


# In a cell the row of least sum may be behind another one by the cell's size, and is then thinned out itself.
@pytest.mark.parametrize(("thin", "most"), [(undominated, 0.01), (thinned, 0.02)])
def test_thinned_designs_beat_all_others_to_a_tolerance(thin, most):
    designs = np.random.default_rng(1).random((2000, 3)) - 0.5
    kept = designs[thin(designs, 0.01)]
    behind = np.max(kept[None] - designs[:, None], axis=2).min(axis=1)
    assert np.max(behind) <= most
    assert len(thin(designs[:0], 0.01)) == 0
    assert not any(np.any(np.all(designs < own, axis=1)) for own in kept)


def test_parts_and_crowds():
    row = np.array([[k * 0.1, 1.0 - k * 0.1, 0.0] for k in (0, 1, 2, 6, 7)])
    parts, holes = parts_of(row, 0.1)
    assert parts == [[0, 1, 2], [3, 4]]
    assert [sorted(pair) for pair in holes] == [[2, 3]]
    assert uncrowded_on_surface(row, np.array([0, 1, 2, 2, 1]), 0.15).tolist() == [0, 2, 4]
