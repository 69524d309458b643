"""Path following: quadratic programs, warm starts, solves from afar, and programs that are reused."""

import time

import numpy as np
import pytest
from helpers.small_designs import design

import plough_opt as po
from plough_opt.design.model import program as program_module
from plough_opt.design.model.optimality import quadratic_program
from plough_opt.design.search.local import point_as_found
from plough_opt.studies.tradeoff import program as programs
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
