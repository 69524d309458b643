"""Sobol indices of results over the soil's distribution, against a closed form, and their intervals against SciPy."""

import math

import numpy as np
import pytest
from scipy import stats

import plough_opt as po
from plough_opt.core.expressions import sin
from plough_opt.studies.uncertainty import sobol_indices

SEROZEM = po.named_soil("serozem")


@pytest.fixture(scope="module")
def ishigami():
    """Ishigami and Homma (1990): sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1 on [-pi, pi]^3, times a design's variable."""
    middles = {"cohesion": (20e3, 5e3), "friction_angle": (0.5, 0.1), "tool_friction": (0.5, 0.2)}
    uniform = {name: stats.uniform(mean - half, 2 * half) for name, (mean, half) in middles.items()}
    d = po.Design()
    factor = d.variable("x", guess=1.0, lower=0.0, upper=2.0)

    def response(soil):
        x = [math.pi * (getattr(soil, name) - mean) / half for name, (mean, half) in middles.items()]
        return {"y": factor * (sin(x[0]) + 7 * sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * sin(x[0])), "none": factor}

    return po.Robust(po.SoilDistribution(SEROZEM, **uniform), response, samples=8)


def test_indices_and_intervals_are_those_of_the_closed_form_and_of_scipy(ishigami):
    def response(uniforms):
        return ishigami.values({"x": 1.7}, ishigami.field.at(uniforms.T))["y"]

    found = sobol_indices(ishigami, {"x": 1.7}, samples=1024, seed=3)
    assert str(found["y"]) == str(sobol_indices(ishigami, {"x": 1.7}, samples=1024, seed=3)["y"])
    assert set(found) == {"y"}  # what does not vary has no indices
    own = found["y"]
    assert str(own).index("friction_angle") < str(own).index("tool_friction")  # by size: 0.44 and 0.24
    # Variances of sin x1 (1 + 0.1 mean of x3^4), 7 sin^2 x2, and sin x1 times the rest of 0.1 x3^4.
    alone = np.array([(1.0 + math.pi**4 / 50.0) ** 2 / 2.0, 49.0 / 8.0, 0.0])
    together = math.pi**8 * (1.0 / 1800.0 - 1.0 / 5000.0)
    variance = np.sum(alone) + together
    # 1024 points have errors of some hundredths; the intervals are those of another implementation, below.
    assert own.first == pytest.approx(alone / variance, abs=0.03)
    assert own.total == pytest.approx((alone + together * np.array([1.0, 0.0, 1.0])) / variance, abs=0.03)
    others = stats.sobol_indices(func=response, n=1024, dists=[stats.uniform()] * 3, rng=np.random.default_rng(3))
    spread = others.bootstrap(confidence_level=0.95, n_resamples=2000)
    for kind in ("first", "total"):
        low, high = (getattr(own, f"{kind}_{end}") for end in ("low", "high"))
        theirs = getattr(spread, f"{kind}_order").confidence_interval
        # SciPy corrects for bias and skew. The 2.5 % points of 200 resamples scatter by some 7 % of the width.
        width = theirs.high - theirs.low
        assert np.all(np.abs(low - theirs.low) < 0.25 * width)
        assert np.all(np.abs(high - theirs.high) < 0.25 * width)
        assert np.mean((high - low) / width) == pytest.approx(1.0, abs=0.15)


def _linear(correlation=None):
    normal = {"cohesion": (20e3, 1e3), "tool_friction": (0.5, 0.02), "density": (1350.0, 10.0)}
    properties = {name: stats.norm(*own) for name, own in normal.items()}
    field = po.SoilDistribution(SEROZEM, correlation=correlation, **properties)

    def response(soil):
        return {"y": 3.0 * (soil.cohesion / 1e3) + 2.0 * (soil.tool_friction / 0.02) + 0.0 * soil.density}

    return po.Robust(field, response, samples=8)


def test_correlated_properties_are_refused_or_taken_in_order():
    rho = -0.5
    robust = _linear({("cohesion", "tool_friction"): rho})
    with pytest.raises(po.InputError, match="correlated=True"):
        sobol_indices(robust, {})
    (own,) = sobol_indices(robust, {}, samples=1024, seed=2, correlated=True).values()
    # y = 3 z1 + 2 (rho z1 + sqrt(1 - rho^2) z2).
    full, rest = (3 + 2 * rho) ** 2, 4 * (1 - rho**2)
    assert own.first == pytest.approx([full / (full + rest), rest / (full + rest), 0.0], abs=0.01)
    assert own.names == ("cohesion", "tool_friction given cohesion", "density")
    assert "before it" in own.note


def test_two_samples_are_the_fewest():
    assert "y" in sobol_indices(_linear(), {}, samples=2)
