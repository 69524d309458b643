"""Measures of samples: values, derivatives, and the bias of smoothing."""

import casadi as ca
import mpmath
import numpy as np
import pytest
from helpers.differences import WEIGHTS
from scipy import optimize, stats

import plough_opt as po
from plough_opt.studies.uncertainty import measures

SAMPLES = stats.lognorm(0.3, scale=4.0).ppf((np.arange(64) + 0.5) / 64)[np.random.default_rng(3).permutation(64)]

SMOOTHED = {
    "expected": lambda v: measures.expected(v),
    "standard deviation": lambda v: measures.standard_deviation(v),
    "mean + 2 std": lambda v: measures.mean_plus(v, 2.0),
    "cvar": lambda v: measures.cvar(v, 0.9, width=0.8),
    "cvar at a whole number of samples": lambda v: measures.cvar(v, 0.75, width=0.5),
    "worst": lambda v: measures.worst(v, width=3.0),
    "probability": lambda v: measures.probability(v, at_least=3.0, at_most=5.0, width=0.7),
    "quantile": lambda v: measures.quantile(v, 0.9, width=0.9),
}


# --- step and ramp ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("u", [-1.5, -1.0, -0.99, -0.3, 0.0, 0.45, 1.0, 1.7])
def test_step_and_ramp_are_integrals_of_the_kernel(u):
    with mpmath.workdps(30):
        kernel = lambda x: mpmath.mpf(35) / 32 * (1 - x * x) ** 3  # noqa: E731
        end = min(max(mpmath.mpf(u), -1), 1)
        step = mpmath.quad(kernel, [-1, end])
        ramp = mpmath.quad(lambda x: kernel(x) * max(mpmath.mpf(u) - x, 0), [-1, end])
    # Sums of terms of order one.
    assert measures.step(u) == pytest.approx(float(step), abs=1e-15)
    assert measures.ramp(u) == pytest.approx(float(ramp), abs=1e-15)


# --- values ----------------------------------------------------------------------------------------------


def test_exact_values():
    values = np.array([3.0, 1.0, 4.0, 1.5, 9.0, 2.0, 6.0, 5.0, 3.5, 8.0])
    assert measures.expected(values) == pytest.approx(values.mean(), rel=1e-15)
    assert measures.standard_deviation(values) == pytest.approx(values.std(), rel=1e-15)
    assert measures.mean_plus(values, -1.5) == pytest.approx(values.mean() - 1.5 * values.std(), rel=1e-14)
    assert measures.worst(values) == 9.0
    assert measures.cvar(values, 0.8) == pytest.approx((9.0 + 8.0) / 2, rel=1e-15)
    assert measures.cvar(values, 0.75) == pytest.approx((9.0 + 8.0 + 0.5 * 6.0) / 2.5, rel=1e-15)
    assert measures.cvar(values, 0.0) == pytest.approx(values.mean(), rel=1e-15)
    assert measures.probability(values, at_least=2.0, at_most=6.0) == 0.6
    assert measures.quantile(values, 0.8) == 6.0


@pytest.mark.parametrize("level", [0.5, 0.75, 0.9, 0.97])
@pytest.mark.parametrize("width", [0.01, 0.5, 3.0])
def test_cvar_is_the_minimum_over_the_threshold(level, width):
    def at(t):
        return t + width * np.mean(measures.ramp((SAMPLES - t) / width)) / (1.0 - level)

    # Golden section on a convex function; beside its flat bottom the value has all its digits.
    found = optimize.minimize_scalar(at, bracket=(SAMPLES.min(), SAMPLES.max()), tol=1e-10)
    assert measures.cvar(SAMPLES, level, width=width) == pytest.approx(found.fun, rel=1e-13)


def test_worst_is_exact_if_the_next_is_two_widths_below():
    values = np.r_[SAMPLES, SAMPLES.max() + 1.0]
    assert measures.worst(values, width=0.4) == pytest.approx(values.max(), rel=1e-14)
    assert measures.worst(values, width=2.0) > values.max()


# --- bias of the rounding-off ----------------------------------------------------------------------------

# So many evenly spaced quantiles that sums over them are integrals over the normal distribution to some 1e-8.
NORMAL = stats.norm().ppf((np.arange(200_000) + 0.5) / 200_000)


@pytest.mark.parametrize("limit", [-1.0, 0.5, 1.6])
def test_bias_of_the_probability_is_of_second_order(limit):
    slope = -limit * stats.norm.pdf(limit)  # of the density
    biases = []
    for width in (0.4, 0.2):
        biases.append(measures.probability(NORMAL, at_most=limit, width=width) - stats.norm.cdf(limit))
        # The next term is of the order of width^4.
        assert biases[-1] == pytest.approx(slope * width**2 / 18.0, rel=width**2, abs=2e-7)
    assert np.log2(biases[0] / biases[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_bias_of_cvar_is_of_second_order(level):
    density = stats.norm.pdf(stats.norm.ppf(level))
    sharp = density / (1.0 - level)
    for width in (0.4, 0.2):
        bias = measures.cvar(NORMAL, level, width=width) - sharp
        assert bias == pytest.approx(density * width**2 / 18.0 / (1.0 - level), rel=width**2, abs=1e-5)


# --- derivatives -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMOOTHED)
def test_gradient_and_hessian_against_differences_of_order_8(name):
    x, s = ca.SX.sym("x", 64), ca.SX.sym("s", 64)  # with MX: test_known_optima.py
    value = SMOOTHED[name](x)
    gradient = ca.gradient(value, x)
    function = ca.Function("f", [x], [value])
    slopes = ca.Function("g", [x], [gradient])
    bent = ca.Function("h", [x, s], [ca.jtimes(gradient, x, s)])
    along, step = np.random.default_rng(1).standard_normal(64), 3e-3

    def differences(of):
        moves = [m * step * along for m in (1, 2, 3, 4)]
        pairs = [np.ravel(of(SAMPLES + move)) - np.ravel(of(SAMPLES - move)) for move in moves]
        return sum(w * pair for w, pair in zip(WEIGHTS, pairs, strict=True)) / step

    own = np.asarray(slopes(SAMPLES)).ravel()
    assert float(function(SAMPLES)) == pytest.approx(SMOOTHED[name](SAMPLES), rel=1e-13)
    # The third derivative of the kernel's step jumps at its ends: where a sample is near one, differences lose digits.
    assert own @ along == pytest.approx(differences(lambda v: np.asarray(function(v))).item(), rel=1e-7, abs=1e-9)
    wanted = differences(lambda v: np.asarray(slopes(v)))
    found = np.asarray(bent(SAMPLES, along)).ravel()
    assert np.max(np.abs(found - wanted)) <= 2e-5 * np.max(np.abs(wanted)) + 1e-9


def test_a_standard_deviation_of_zero_has_finite_derivatives():
    x = ca.MX.sym("x", 8)
    gradient = ca.Function("g", [x], [ca.gradient(measures.standard_deviation(x), x)])
    assert np.all(np.isfinite(np.asarray(gradient(np.full(8, 3.0)))))


# --- refusals --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda v: measures.cvar(v, 1.0), "level"),
        (lambda v: measures.cvar(v, 0.9, width=-1.0), "width"),
        (lambda v: measures.quantile(v, 0.0), "between 0 and 1"),
        (lambda v: measures.probability(v), "needs a limit"),
        (lambda v: measures.probability(v, at_least=2.0, at_most=1.0), "contradict"),
        (lambda v: measures.expected(np.r_[v, np.nan]), "1 of 65 samples are not finite"),
        (lambda _: measures.worst([]), "no samples"),
        (lambda _: measures.cvar(ca.MX.sym("v", 4), 0.9), "needs a width"),
        (lambda _: measures.worst(ca.MX(0, 1), width=1.0), "no samples"),
    ],
)
def test_refusals(call, words):
    with pytest.raises(po.InputError, match=words):
        call(SAMPLES)
