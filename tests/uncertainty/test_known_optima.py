"""Robust optima with known closed forms, found by the design's own solver.

The soil's properties stand for the uncertain numbers of textbook problems; no run takes part. They have one optimum
each, which is found from the guess.
"""

import math

import pytest
from scipy import stats

import plough_opt as po
from plough_opt.studies.uncertainty import measures

MEAN, STD = 20e3, 4e3
# A normal distribution in units of 10 kPa, and its cohesion as that number.
FIELD = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.norm(MEAN, STD), within={"cohesion": (1.0, 1e6)})
M, S = MEAN / 1e4, STD / 1e4


def _design(guess=1.0, lower=-10.0, upper=10.0):
    d = po.Design()
    return d, d.variable("x", guess=guess, lower=lower, upper=upper)


def _numbers(samples):
    return samples.property("cohesion") / 1e4


@pytest.mark.parametrize("kappa", [0.0, 1.0, 2.5])
def test_mean_plus_standard_deviations_of_a_linear_loss(kappa):
    """min over x of mean + kappa std of x theta + x^2/2 is x = -(mean - kappa std) where that is below 0."""
    d, x = _design(guess=-1.0)
    robust = po.Robust(FIELD, lambda soil: {"loss": x * soil.cohesion / 1e4 + x**2 / 2}, samples=256, seed=3)
    d.minimise(robust.mean_plus("loss", kappa))
    best = d.solve(search="near")
    own = _numbers(robust.samples)
    # Where the loss falls with theta its spread is -x std.
    assert best.variables["x"] == pytest.approx(-(own.mean() - kappa * own.std()), abs=1e-8)
    # 256 points of a Sobol sequence.
    assert best.variables["x"] == pytest.approx(-(M - kappa * S), abs=5e-3)


def test_conditional_value_at_risk_of_a_linear_loss():
    """min over x > 0 of CVaR of x^2/2 - x theta is x = mean - std pdf(z)/(1 - level)."""
    level = 0.9
    d, x = _design(lower=0.01)
    robust = po.Robust(FIELD, lambda soil: {"loss": x**2 / 2 - x * soil.cohesion / 1e4}, samples=128, seed=3)
    d.minimise(robust.cvar("loss", level, width=0.05))
    found = d.solve(search="near").variables["x"]
    sharp = -measures.cvar(-_numbers(robust.samples), level)
    # The rounding-off over w adds w^2 pdf(z)/(18 (1 - level) x S) to the objective, and to its slope what follows.
    slope = 0.05**2 / 18 * stats.norm.pdf(stats.norm.ppf(level)) / (1 - level) / S / found**2
    assert found == pytest.approx(sharp + slope, abs=2e-4)
    closed = M - S * stats.norm.pdf(stats.norm.ppf(level)) / (1 - level)
    assert found == pytest.approx(closed, abs=2e-2)


@pytest.mark.parametrize("probability", [pytest.param(0.8, marks=pytest.mark.slow), 0.95])
def test_chance_constraint_on_a_normal_variable(probability):
    """The least stock that suffices with a probability is mean + z std."""
    width, found = 0.5 * S, []
    # A probability of 0 has no slope, but its quantile has.
    for guess, by_quantile in ((2.6, False), (0.0, True)):
        d, x = _design(guess)
        robust = po.Robust(FIELD, lambda soil, x=x: {"missing": soil.cohesion / 1e4 - x}, samples=128, seed=3)
        if by_quantile:
            robust.require_probability(d, "enough", "missing", probability, at_most=0.0, width=width)
        else:
            d.require("enough", robust.probability("missing", at_most=0.0, width=width), at_least=probability)
        d.minimise(x)
        best = d.solve(search="near")
        found.append(best.variables["x"])
    assert found[0] == pytest.approx(found[1], abs=1e-9)
    z = stats.norm.ppf(probability)
    # The width acts as a further variance of width^2/9, to second order.
    assert best.variables["x"] == pytest.approx(M + z * math.hypot(S, width / 3.0), abs=2e-2)
    assert best.variables["x"] == pytest.approx(measures.quantile(_numbers(robust.samples), probability, width=width))
    check = po.uncertainty.verify(robust, best, samples=4096, seed=9)["missing", "probability"]
    assert check.seen == pytest.approx(probability, abs=1e-9)
    # What the distribution itself gives at the optimum lies within the interval of the fresh samples.
    assert check.low <= stats.norm.cdf((best.variables["x"] - M) / S) <= check.high


def test_worst_case_by_a_bound_is_the_middle_of_the_range():
    """min over x of the largest (x - theta)^2 is the middle between the extremes."""
    d, x = _design()
    robust = po.Robust(FIELD, lambda soil: {"square": (x - soil.cohesion / 1e4) ** 2}, samples=64, seed=3)
    d.minimise(robust.bound_from_above(d, "square", lower=0.0, upper=200.0))
    best = d.solve(search="near")
    own = _numbers(robust.samples)
    assert best.variables["x"] == pytest.approx((own.min() + own.max()) / 2, abs=1e-7)
    assert best.objective == pytest.approx((own.max() - own.min()) ** 2 / 4, abs=1e-8)


def test_smoothed_worst_case_over_a_set():
    """Over the corners of a box the same optimum, by symmetry whatever the width."""
    d, x = _design()
    corners = FIELD.corners(0.9)
    robust = po.Robust(FIELD, lambda soil: {"square": (x - soil.cohesion / 1e4) ** 2}, samples=corners)
    d.minimise(robust.worst("square", width=0.1))
    best = d.solve(search="near")
    low, high = _numbers(corners)
    assert best.variables["x"] == pytest.approx((low + high) / 2, abs=1e-8)
    rounding = best.objective - (high - low) ** 2 / 4
    assert 0.0 < rounding <= 2 * 35 / 256 * 0.1
    check = po.uncertainty.verify(robust, best, samples=4000, seed=1)["square", "largest"]
    # Nine tenths of the distribution lie within the box, whose worst the rounding lifts a little.
    assert check.worse == pytest.approx(0.1 * 4000, abs=90)
    assert not check.confirmed
