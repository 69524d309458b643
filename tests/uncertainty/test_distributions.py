"""Distributions of a soil, mean and spread over common soils, and their verification on fresh soils."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.small_designs import design
from scipy import stats

import plough_opt as po
from plough_opt.core.expressions import sqrt
from plough_opt.uncertainty import expected, standard_deviation, verify

# --- distributions of a soil: moments, truncation, correlation, repeatable samples, messages about mistakes ---

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
    "truncated normal": (stats.norm(3.0, 2.0), (1.0, 4.5), stats.truncnorm(-1.0, 0.75, 3.0, 2.0)),
    "new normal of SciPy": (stats.Normal(mu=3.0, sigma=2.0), (1.0, 4.5), stats.truncnorm(-1.0, 0.75, 3.0, 2.0)),
    "cut uniform": (stats.uniform(2.0, 5.0), (3.0, 6.0), stats.uniform(3.0, 3.0)),
    "lognormal": (stats.lognorm(0.3, scale=20.0), (-math.inf, math.inf), stats.lognorm(0.3, scale=20.0)),
}


@pytest.mark.parametrize("name", MARGINALS)
def test_truncated_distributions(name):
    distribution, bounds, wanted = MARGINALS[name]
    field = po.SoilDistribution(SEROZEM, cohesion=distribution, within={"cohesion": bounds})
    # A double exponential rule: rounding of a few hundred terms, and of SciPy's own quantiles.
    assert field.moments["cohesion"] == pytest.approx((wanted.mean(), wanted.std()), rel=1e-12)
    assert stats.kstest(field.values(20_000, seed=7, independent=True).ravel(), wanted.cdf).pvalue > 1e-3


def test_samples_have_the_moments_and_rank_correlations_of_the_distribution():
    field = _field()
    samples = field.values(4096, seed=1)
    for (mean, spread), own in zip(field.moments.values(), samples.T, strict=True):
        # A scrambled Sobol sequence of n points: errors of the order of 1/n, times a few standard deviations.
        assert np.mean(own) == pytest.approx(mean, abs=4 * spread / 4096)
        assert np.std(own) == pytest.approx(spread, rel=5e-3)
    assert np.rad2deg([samples[:, 1].min(), samples[:, 1].max()]) == pytest.approx([20.5, 33.5], abs=0.5)
    assert stats.spearmanr(samples).statistic == pytest.approx(6 / math.pi * math.asin(-0.4 / 2), abs=2e-3)
    assert stats.kendalltau(*samples.T).statistic == pytest.approx(2 / math.pi * math.asin(-0.4), abs=2e-3)


def test_samples_repeat_and_grow():
    field = _field()
    first, more = field.values(32, seed=5), field.values(64, seed=5)
    assert np.array_equal(first, more[:32])
    assert not np.array_equal(first, field.values(32, seed=6))
    soils = field.sample(20, seed=5)
    assert [soil.cohesion for soil in soils] == first[:20, 0].tolist()
    assert soils[3].density == SEROZEM.density


PAIRS = {("cohesion", "friction_angle"): 0.9, ("cohesion", "density"): 0.9, ("friction_angle", "density"): -0.9}


WRONG_DISTRIBUTIONS = [
    ({"cohesoin": stats.norm(1, 1)}, "'cohesion'"),
    ({"cohesion": 20e3}, "not a distribution"),
    ({"cohesion": stats.norm(20e3, 6e3)}, "truncate it"),
    ({"within": {"cohesion": (1e9, 2e9)}}, "the probability between its bounds"),
    ({"correlation": {("cohesion", "friction_angle"): -1.0}}, "cohesion and friction_angle = -1 must be above -1"),
    ({"correlation": {("cohesion", "density"): 0.1}}, "no distribution"),
    ({"density": stats.uniform(1300, 100), "correlation": PAIRS}, "not positive definite"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG_DISTRIBUTIONS)
def test_distributions_that_cannot_be(changes, words):
    with pytest.raises((po.InputError, po.DomainError), match=words):
        _field(**changes)


# --- mean and spread ---


def test_moments_and_their_derivatives_against_differences_of_order_8():
    values = stats.lognorm(0.3, scale=4.0).ppf((np.arange(64) + 0.5) / 64)
    assert expected(values) == pytest.approx(values.mean(), rel=1e-15)
    assert standard_deviation(values) == pytest.approx(values.std(), rel=1e-15)
    x, along = ca.MX.sym("x", 64), np.random.default_rng(1).standard_normal(64)
    spread = standard_deviation(x)
    gradient = ca.gradient(spread, x)
    for of, slope in ((spread, ca.dot(gradient, ca.DM(along))), (gradient, ca.jtimes(gradient, x, ca.DM(along)))):
        function, own = ca.Function("f", [x], [of]), ca.Function("s", [x], [slope])
        wanted = differences(lambda t, f=function: np.asarray(f(values + t * along)), np.zeros(1), 3e-3).ravel()
        assert np.asarray(own(values)).ravel() == pytest.approx(wanted, rel=1e-7, abs=1e-9)


def test_a_standard_deviation_of_zero_has_finite_derivatives():
    x = ca.MX.sym("x", 8)
    gradient = ca.Function("g", [x], [ca.gradient(standard_deviation(x), x)])
    assert np.all(np.isfinite(np.asarray(gradient(np.full(8, 3.0)))))


# --- verification on fresh soils ---

FIELD = po.SoilDistribution(
    po.named_soil("serozem"),
    cohesion=stats.lognorm(0.3, scale=20e3),
    friction_angle=stats.uniform(po.deg(22), po.deg(12)),
    correlation={("cohesion", "friction_angle"): -0.5},
)
AT = {"height": 0.25, "stiffness": 4e4}
LIMIT = 3700.0  # N, of the draft that AT has
EFFECTS = {
    "damper, wave": {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0},
    "damper": {"damping": 400.0},
    "rest": {"start": "rest", "damping": 900.0},
    "ramp": {"start": "rest", "tow_ramp": 0.3},
    "no motion": {"motion": False, "strength_wave": po.StrengthWave(0.3, 0.2)},
    "smooth": {"contact": po.Smooth(0.3), "damping": 300.0},
}


def _run(soil, height, k0, effects, accuracy=None):
    share = po.Wedge(po.deg(35), po.deg(15), height)
    mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
    return po.simulate(po.Scene(soil, share, k0, mass, 2.0, po.Effects(**effects)), 0.5, accuracy=accuracy, outputs=10)


def _robust(count=8, accuracy=None, path=False, **effects):
    d, height, k0 = design(height=(0.25, 0.1, 0.4), stiffness=(4e4, 1e4, 1e6, "", True))

    def response(soil):
        run = _run(soil, height, k0, effects, accuracy)
        found = {"draft": run.mean_draft, "rms": run.force_rms, "deflection": run.mean_deflection}
        return found | {"power": run.tow_power, "last": run.deflection[10] if path else 0.0 * k0}

    return d, po.Robust(FIELD, response, samples=count, seed=1)


# Each further structure is translated by the C compiler once.
@pytest.mark.parametrize("name", EFFECTS)
def test_values_over_samples_agree_with_single_simulations(name):
    # One of the scenes along the path too, and one by a named method.
    path, accuracy = name == "damper, wave", po.Accuracy("dop853", steps=200) if name == "damper" else None
    _, robust = _robust(3, accuracy, path, **EFFECTS[name])
    values = robust.values(AT)
    for k, soil in enumerate(FIELD.sample(3, seed=1)):
        run = _run(soil, *AT.values(), EFFECTS[name])
        # By four times a search's steps averages are right to some 1e-10 of the larger of mean and RMS.
        assert values["draft"][k] == pytest.approx(run.mean_draft, rel=1e-9)
        assert values["rms"][k] == pytest.approx(run.force_rms, abs=1e-9 * run.mean_draft)
        assert values["deflection"][k] == pytest.approx(run.mean_deflection, rel=1e-9)
        assert values["power"][k] == pytest.approx(run.tow_power, rel=1e-9)
        assert not path or values["last"][k] == pytest.approx(run.deflection[10], rel=1e-8)


def test_intervals_hold_what_very_many_samples_give_and_agree_with_the_bootstrap():
    d, robust = _robust(32, motion=False)
    for kappa in (0.0, 2.0):
        robust.mean_plus("draft", kappa)
    robust.require_probability(d, "draft", "draft", 0.5, at_most=LIMIT, unit="N")
    found = verify(robust, AT, samples=2000, seed=4)
    draft, fresh = robust.values(AT, FIELD.values(1 << 16, seed=11))["draft"], found.values["draft"]
    wanted = {
        "mean": draft.mean(),
        "mean + 2 standard deviations": draft.mean() + 2 * draft.std(),
        "probability of at most 3.7 kN": np.mean(draft <= LIMIT),
    }
    assert [check.text for check in found.checks] == [*wanted]
    for check, value in zip(found.checks, wanted.values(), strict=True):
        assert check.low <= value <= check.high
        assert check.low < check.fresh < check.high
    for check, kappa in zip(found.checks, (0.0, 2.0), strict=False):
        own = robust.values(AT)["draft"]
        assert check.wanted == pytest.approx(own.mean() + kappa * own.std(), rel=1e-12)
        ends = stats.bootstrap(
            (fresh,), lambda v, axis, k=kappa: np.mean(v, axis) + k * np.std(v, axis), n_resamples=2000,
            rng=np.random.default_rng(1), method="percentile",
        ).confidence_interval  # fmt: skip
        # The ends of 2000 resamples scatter by a few per cent of the width.
        assert [check.low, check.high] == pytest.approx([*ends], abs=0.08 * (ends.high - ends.low))
    assert "draft, rms, deflection, power, last over 32 soils of cohesion" in repr(robust)


def test_a_claim_that_does_not_hold_is_not_confirmed():
    """The largest height for which eight soils keep a limit does not keep it in the field."""
    d, robust = _robust(8, motion=False)
    d.minimise(-d._variables[0].symbol)
    robust.require_probability(d, "draft", "draft", 1.0, at_most=LIMIT, unit="N")
    best = d.solve()
    assert np.max(robust.values(best)["draft"]) == pytest.approx(LIMIT, rel=1e-8)
    found = verify(robust, best, samples=1000, seed=3)
    (check,) = found.checks
    assert (check.wanted, check.verdict, found.confirmed) == (1.0, "smaller than wanted", False)
    assert check.high < 0.99
    assert "smaller than wanted" in str(found)


def test_refusals():
    d, robust = _robust(4, motion=False)
    firm = po.Robust(FIELD, lambda soil: {"a": sqrt(soil.cohesion - 2e4)}, samples=1)
    for call, words in (
        (lambda: po.SoilDistribution(FIELD.soil), "nothing is uncertain"),
        *((lambda n=n: FIELD.sample(n, seed=1), "must be a whole number from 1 to") for n in (0, 1 << 21)),
        (lambda: verify(robust, AT, samples=50), "at least 100"),
        (lambda: robust.values({"height": 0.25, "stifness": 4e4}), "'stiffness'"),
        (lambda: po.Robust(FIELD, lambda _: {"a": np.ones(3)}, samples=4), "one number"),
        (lambda: verify(firm, {}), "of .* soils have no result"),
        (lambda: verify(robust, {"height": 0.25, "stiffness": -1.0}), "4 of 4 of its own soils have no result"),
        (lambda: robust.require_probability(d, "x", "draft", 0.9, at_least=1.0, at_most=2.0), "give one limit"),
    ):
        with pytest.raises(po.InputError, match=words):
            call()
