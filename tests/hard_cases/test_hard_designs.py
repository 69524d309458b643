"""Designs that are hard to solve: against closed forms, brute force and SciPy, and the conditions of an optimum."""

import math

import numpy as np
import pytest
from helpers.shares_by_hand import (
    CHISEL,
    NAMES,
    SOIL,
    SPEED,
    UPPER,
    USUAL,
    Question,
    angle_for,
    assert_is_balanced,
    assert_is_the_optimum,
    draft,
    forces,
    half_angle,
    radius,
)
from scipy.optimize import minimize_scalar

import plough_opt as po

# --- starts ------------------------------------------------------------------------------------

# Guesses (deg, m, N/m), by the requirements that they break.
STARTS = {
    "radius": (6.0, 0.3, 4e5),
    "none": (35.0, 0.25, 3e5),
    "angle": (55.0, 0.3, 4e5),
    "radius and angle": (50.0, 0.11, 4e5),
    "deflection": (35.0, 0.25, 5.1e3),
    "at the lower bounds": (5.0, 0.1, 5e3),
    "all": (50.0, 0.12, 5.1e3),
    "at the upper bounds": (60.0, 0.5, 5e5),
}


@pytest.mark.parametrize("guess", STARTS.values(), ids=STARTS)
def test_any_start_leads_to_the_optimum(guess):
    question = Question(guess=(po.deg(guess[0]), *guess[1:]))
    best = question.design().solve()
    assert_is_the_optimum(question, best)
    assert set(best.active) == set(USUAL)


def test_a_start_at_the_end_of_the_domain_is_refused():
    question = Question(guess=(0.0, 0.25, 5e4), lower=np.array([0.0, 0.1, 5e3]))
    with pytest.raises(po.DomainError, match="at the guess: wedge angle = 0 rad must be above 0 rad"):
        question.design().solve()


# --- optima at bounds ---------------------------------------------------------------------------------------

WIDE = USUAL["loosened radius"]
# A share of the least wedge angle and height that loosens just as much as is required.
CORNER = {"loosened radius": (radius((po.deg(20.0), 0.2)), math.inf)}
AT_BOUNDS = {
    "one bound": (Question("a draft and a height wanted", {}), {"stiffness"}),
    "two bounds": (Question("a height wanted", {}), {"wedge angle", "stiffness"}),
    "all bounds": (Question("drafts", {}), set(NAMES)),
    "all bounds but one, and a requirement": (
        Question(limits={"loosened radius": WIDE}, upper=np.array([po.deg(60.0), 0.16, 5e5])),
        {"loosened radius", "wedge angle", "stiffness"},
    ),
    "a bound and two requirements": (
        Question(upper=np.array([po.deg(36.0), 0.5, 5e5])), {"loosened radius", "mean deflection", "wedge angle"}
    ),
    "a requirement that is no more than the bounds": (
        Question(limits=CORNER, lower=np.array([po.deg(20.0), 0.2, 5e3])), {*NAMES, *CORNER}
    ),
}  # fmt: skip


@pytest.mark.parametrize(("question", "active"), AT_BOUNDS.values(), ids=AT_BOUNDS)
def test_optima_at_bounds(question, active):
    best = question.design().solve()
    assert_is_the_optimum(question, best)
    assert set(best.active) == active
    for k, name in enumerate(NAMES):
        if name in active:
            assert min(abs(best.variables[name] - end[k]) for end in (question.lower, question.upper)) < 1e-8 * UPPER[k]


# --- redundant, nearly infeasible and infeasible requirements -----------------------------------------------


@pytest.mark.parametrize("times", [2, 5, 10])
def test_a_repeated_requirement_counts_once_and_one_that_another_implies_not_at_all(times):
    limits = USUAL | {f"loosened radius again {k}": USUAL["loosened radius"] for k in range(times - 1)}
    once, often = Question(), Question(limits=limits | {"loosened radius again": (0.1, math.inf)})
    best = often.design().solve()
    assert_is_the_optimum(often, best)
    *pulls, weaker = (limit for limit in best.limits if limit.name.startswith("loosened"))
    (alone,) = (limit.multiplier for limit in once.design().solve().limits if limit.name.startswith("loosened"))
    assert sum(pull.multiplier for pull in pulls) == pytest.approx(alone, rel=1e-6)
    assert weaker.margin == pytest.approx(0.02, rel=1e-7)
    assert weaker.multiplier < 1e-7
    assert not weaker.active


# Height at which the largest half angle allowed loosens just as much as is required.
JUST = 0.12 * math.sqrt(0.2) / math.tan(po.deg(15.0))


def up_to(height):
    return Question(guess=(po.deg(25.0), 0.15, 5e4), upper=np.array([po.deg(60.0), height, 5e5]))


@pytest.mark.parametrize("width", [1e-6, 1e-3, 1e-9, 0.0, 1e-12])
def test_a_feasible_set_of_almost_no_width(width):
    question = up_to(JUST * (1.0 + width))
    best = question.design().solve()
    x = np.array([best.variables[name] for name in NAMES])
    assert max(question.violations(x).values()) < 1e-9
    # Nearly one point is left, and the least stiffness there.
    assert x[1] == pytest.approx(JUST, rel=1e-8)
    assert half_angle(x[0]) == pytest.approx(po.deg(15.0), rel=1e-8)
    assert x[2] == pytest.approx(draft(x)[0] / 0.02, rel=1e-8)
    assert best.objective == pytest.approx(question.value(x), rel=1e-11)
    # Where several limits meet in a point their multipliers are not unique, but together they balance the gradient.
    assert_is_balanced(question, best, x)


@pytest.mark.parametrize("lack", [1e-2, 1e-4, 1e-6])
def test_a_small_conflict_is_reported_with_its_size(lack):
    with pytest.raises(po.InfeasibleDesign) as caught:
        up_to(JUST * (1.0 - lack)).design().solve()
    needed = math.atan(0.12 * math.sqrt(0.2) / (JUST * (1.0 - lack))) - po.deg(15.0)
    # Relative to its limit the angle must give way by 0.955 of the lack, the radius by all of it. Both are met to 1e-8.
    assert caught.value.conflicts == {"largest half angle": pytest.approx(needed, abs=1e-8)}
    assert set(caught.value.blockers) == {
        "requirement 'loosened radius' at least 0.12", f"upper bound {JUST * (1.0 - lack):.6g} m of 'height'"
    }  # fmt: skip


@pytest.mark.parametrize("lack", [1e-10, 1e-8, 1e-9, 1e-7])
def test_a_conflict_at_the_edge_of_the_tolerance_is_refused_or_within_it(lack):
    try:
        best = up_to(JUST * (1.0 - lack)).design().solve()
    except (po.InfeasibleDesign, po.NotConverged) as refusal:
        best, sentence = None, str(refusal)
    # Requirements are kept to 5e-10 of their limit.
    assert min(best.margins.values()) > -5e-10 if best else "wedge angle = 39.1" in sentence


# --- bounds and scales --------------------------------------------------------------------------------------


@pytest.mark.parametrize("log", [False, True], ids=["linear", "log"])
@pytest.mark.parametrize("width", [1e-6, 1e-10, 2.3e-16])
def test_a_variable_between_bounds_that_nearly_touch(width, log):
    d = po.Design()
    angle = d.variable("wedge angle", guess=0.4, lower=0.1, upper=1.0)
    height = d.variable("height", guess=0.25, lower=0.25, upper=0.25 * (1.0 + width), log=log)
    share = po.Wedge(angle, CHISEL, height)
    run = po.simulate(po.Scene(SOIL, share, 5e4, 24.0, SPEED, po.Effects(motion=False)), 1.0)
    d.minimise(run.mean_draft / 1e3)
    d.require("radius", po.loosened_radius(share.equivalent_cone(), SOIL), at_least=0.12)
    best = d.solve()
    assert 0.25 <= best.variables["height"] <= 0.25 * (1.0 + width)
    # The angle is what the radius needs at that height.
    assert best.variables["wedge angle"] == pytest.approx(angle_for(0.12, best.variables["height"]), rel=1e-9)
    static, drag = forces(best.variables["wedge angle"], best.variables["height"])
    assert best.objective == pytest.approx((static + drag * SPEED**2) / 1e3, rel=1e-12)

    def least(h):
        static, drag = forces(angle_for(0.12, h), h)
        return (static + drag * SPEED**2) / 1e3

    # A taller share pulls more, so the objective falls as the lower bound is loosened: the bound's multiplier.
    (bound,) = (limit for limit in best.limits if limit.name == "height")
    wide = width > 1e-8
    assert (best.status == "solved") == wide
    if wide:
        # Between closer bounds the scaled multiplier is below IPOPT's tolerance.
        assert bound.multiplier == pytest.approx((least(0.251) - least(0.249)) / 0.002, rel=1e-4)
    for direction in best.flat_directions:
        # Nothing else changes along bounds that near.
        assert abs(direction["height"]) <= 0.25 * max(width, 2.3e-16)
        assert abs(direction["wedge angle"]) < 1e-8


@pytest.mark.parametrize("log", [False, True], ids=["linear", "log"])
def test_variables_eighteen_orders_of_magnitude_apart(log):
    d = po.Design()
    k0 = d.variable("stiffness", guess=5e11, lower=1e10, upper=1e12, unit="N/m", log=log)
    play = d.variable("play", guess=5e-7, lower=1e-8, upper=1e-6, unit="m", log=log)
    height = d.variable("height", guess=0.3, lower=0.1, upper=0.5, unit="m")
    share = po.Wedge(0.4, CHISEL, height)
    run = po.simulate(po.Scene(SOIL, share, k0, 24.0, SPEED, po.Effects(motion=False)), 1.0)
    d.minimise(run.mean_draft / 1e3 + k0 / 1e12 + 1e-7 / play)
    d.require("radius", po.loosened_radius(share.equivalent_cone(), SOIL), at_least=0.1)
    d.require("travel", play + 100.0 * run.mean_deflection, at_most=5e-7)
    best = d.solve()
    # The height is what the radius needs, and the stiffness what the play leaves: one number is free.
    h = 0.1 / radius((0.4, 1.0))
    static, drag = forces(0.4, h)
    pull = static + drag * SPEED**2

    def stiffness(gap):
        return 100.0 * pull / (5e-7 - gap)

    cost = minimize_scalar(
        lambda y: pull / 1e3 + stiffness(1e-7 * y) / 1e12 + 1.0 / y, bounds=(0.1, 4.9), options={"xatol": 1e-12}
    )
    assert best.objective == pytest.approx(cost.fun, rel=1e-9)
    found = [best.variables[name] for name in ("play", "stiffness", "height")]
    # SciPy's search ends where the objective is flat to rounding, some 1e-8 off.
    assert found == pytest.approx([1e-7 * cost.x, stiffness(1e-7 * cost.x), h], rel=1e-7)
    assert set(best.active) == {"radius", "travel"}
