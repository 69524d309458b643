"""Distributions of a soil: moments, truncation, correlation, repeatable samples, messages about mistakes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import plough_opt as po
from plough_opt.studies.uncertainty import Marginal

SEROZEM = po.named_soil("serozem")


def _field(**changes):
    given = {
        "soil": SEROZEM,
        "cohesion": stats.lognorm(0.3, scale=20e3),
        "friction_angle": stats.norm(po.deg(28), po.deg(3)),
        "within": {"friction_angle": (po.deg(20), po.deg(34))},
        "correlation": {("cohesion", "friction_angle"): -0.4},
    }
    return po.SoilDistribution(**(given | changes))


MARGINALS = {
    "truncated normal": (Marginal(stats.norm(3.0, 2.0), 1.0, 4.5), stats.truncnorm(-1.0, 0.75, 3.0, 2.0)),
    "new normal of SciPy": (Marginal(stats.Normal(mu=3.0, sigma=2.0), 1.0, 4.5), stats.truncnorm(-1.0, 0.75, 3.0, 2.0)),
    "cut uniform": (Marginal(stats.uniform(2.0, 5.0), 3.0, 6.0), stats.uniform(3.0, 3.0)),
    "lognormal": (Marginal(stats.lognorm(0.3, scale=20.0)), stats.lognorm(0.3, scale=20.0)),
}


@pytest.mark.parametrize("name", MARGINALS)
def test_marginals(name):
    marginal, wanted = MARGINALS[name]
    p = np.linspace(0.01, 0.99, 23)
    assert marginal.quantile(p) == pytest.approx(wanted.ppf(p), rel=1e-12)
    assert marginal.cdf(wanted.ppf(p)) == pytest.approx(p, rel=1e-12)
    # A double exponential rule: rounding of a few hundred terms, and of SciPy's own quantiles.
    assert marginal.moments == pytest.approx((wanted.mean(), wanted.std()), rel=1e-12)


def test_samples_have_the_moments_and_rank_correlations_of_the_distribution():
    field = _field()
    samples = field.sample(4096, seed=1)
    for name, (mean, spread) in field.moments.items():
        own = samples.property(name)
        # A scrambled Sobol sequence of n points: errors of the order of 1/n, times a few standard deviations.
        assert np.mean(own) == pytest.approx(mean, abs=4 * spread / 4096)
        assert np.std(own) == pytest.approx(spread, rel=5e-3)
    ends = np.rad2deg([samples.property("friction_angle").min(), samples.property("friction_angle").max()])
    assert ends == pytest.approx([20.5, 33.5], abs=0.5)
    found = stats.spearmanr(samples.values).statistic
    assert found == pytest.approx(6 / math.pi * math.asin(-0.4 / 2), abs=2e-3)
    found = stats.kendalltau(*samples.values.T).statistic
    assert found == pytest.approx(2 / math.pi * math.asin(-0.4), abs=2e-3)


def test_independent_draws_follow_the_distribution():
    field = _field()
    samples = field.draw(20_000, seed=7)
    mean, spread = field.moments["cohesion"]
    # Four standard errors.
    assert np.mean(samples.property("cohesion")) == pytest.approx(mean, abs=4 * spread / math.sqrt(20_000))
    assert stats.kstest(samples.property("friction_angle"), field.marginals["friction_angle"].cdf).pvalue > 1e-3


def test_samples_repeat_and_grow():
    field = _field()
    first, more = field.sample(32, seed=5), field.sample(64, seed=5)
    assert np.array_equal(first.values, more.values[:32])
    assert not np.array_equal(first.values, field.sample(32, seed=6).values)
    assert len(field.sample(20, seed=5)) == 20
    assert [soil.cohesion for soil in first] == first.property("cohesion").tolist()
    assert first.soils[3].density == SEROZEM.density


def test_corners_are_the_ends_of_each_marginal():
    field = _field()
    found = np.sort(field.corners(0.9).property("cohesion"))
    assert found == pytest.approx(stats.lognorm(0.3, scale=20e3).ppf([0.05, 0.05, 0.95, 0.95]), rel=1e-12)


PAIRS = {("cohesion", "friction_angle"): 0.9, ("cohesion", "density"): 0.9, ("friction_angle", "density"): -0.9}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cohesoin": stats.norm(1, 1)}, "'cohesion'"),
        ({"within": {"tool_friction": (0.1, 0.9)}}, "tool_friction"),
        ({"cohesion": 20e3}, "not a distribution"),
        ({"soil": replace(SEROZEM, cohesion=po.Design().parameter("c", 2e4))}, "is an expression in the soil"),
        ({"cohesion": stats.norm(20e3, 6e3)}, "truncate it"),
        ({"cohesion": stats.norm(20e3, np.nan)}, "cohesion: its distribution has no median"),
        ({"cohesion": stats.norm(20e3, 0.0)}, "such as a scale of 0"),
        ({"within": {"cohesion": 30e3}}, "the bounds of cohesion are 30000.0: give two numbers"),
        ({"within": {"friction_angle": (po.deg(34), po.deg(34))}}, "contradict"),
        ({"correlation": {("cohesion", "friction_angle"): -1.0}}, "between -1 and 1"),
        ({"correlation": {("cohesion", "density"): 0.1}}, "no distribution"),
        ({"correlation": {("cohesion", "cohesion"): 0.1}}, "pair of properties"),
        ({"correlation": {("cohesion", "friction_angle"): 0.1, ("friction_angle", "cohesion"): 0.2}}, "given twice"),
        ({"density": stats.uniform(1300, 100), "correlation": PAIRS}, "not positive definite"),
    ],
)
def test_refusals(changes, words):
    with pytest.raises((po.InputError, po.DomainError), match=words):
        _field(**changes)
