"""Robust optima with known closed forms, or found by hand on a grid.

The soil's properties stand for the uncertain numbers of textbook problems; no run takes part.
Runs of one structure are in one program.
"""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import check_derivatives
from helpers.small_designs import design
from scipy import stats

import plough_opt as po
from plough_opt.design.model.program import Program
from plough_opt.studies.uncertainty import measures
from plough_opt.studies.uncertainty.robust import best_robust

MEAN, STD = 20e3, 4e3
# A normal distribution in units of 10 kPa, and its cohesion as that number.
FIELD = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.norm(MEAN, STD), within={"cohesion": (1.0, 1e6)})
M, S = MEAN / 1e4, STD / 1e4


def _numbers(samples):
    return samples.property("cohesion") / 1e4


@pytest.mark.parametrize("kappa", [0.0, 1.0, 2.5])
def test_mean_plus_standard_deviations_of_a_linear_loss(kappa):
    """min over x of mean + kappa std of x theta + x^2/2 is x = -(mean - kappa std) where that is below 0."""
    d, x = design(x=(-1.0, -10.0, 10.0))
    robust = po.Robust(FIELD, lambda soil: {"loss": x * soil.cohesion / 1e4 + x**2 / 2}, samples=256, seed=3)
    d.minimise(robust.mean_plus("loss", kappa))
    best = d.solve(search="near")
    own = _numbers(robust.samples)
    # Where the loss falls with theta its spread is -x std.
    assert best.variables["x"] == pytest.approx(-(own.mean() - kappa * own.std()), abs=1e-8)
    # 256 points of a Sobol sequence.
    assert best.variables["x"] == pytest.approx(-(M - kappa * S), abs=5e-3)


@pytest.mark.parametrize("probability", [pytest.param(0.8, marks=pytest.mark.slow), 0.95])
def test_chance_constraint_on_a_normal_variable(probability):
    """The least stock that suffices with a probability is mean + z std."""
    width, found = 0.5 * S, []
    # A probability of 0 has no slope, but its quantile has.
    for guess, by_quantile in ((2.6, False), (0.0, True)):
        d, x = design(x=(guess, -10.0, 10.0))
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


def test_smoothed_worst_case_over_a_set():
    """Over the corners of a box the same optimum, by symmetry whatever the width."""
    d, x = design(x=(1.0, -10.0, 10.0))
    corners, unit = FIELD.corners(0.9), d.parameter("unit", 1e4)
    robust = po.Robust(FIELD, lambda soil: {"square": (x - soil.cohesion / unit) ** 2}, samples=corners)
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


# --- searched over all variables, and smoothed by the spread of the results ----------------------------------


GRID = np.linspace(0.0, 1.0, 20_001)


def _valleys(x, theta):
    """Two valleys that the number moves to and fro: the narrow one is deeper, the broad one forgives more."""
    moved = x - 0.03 * (theta - M) / S
    exp = ca.exp if isinstance(x, ca.MX) else np.exp
    return 2.0 - 1.2 * exp(-(((moved - 0.25) / 0.01) ** 2)) - exp(-(((moved - 0.75) / 0.15) ** 2))


def _by_hand(samples):
    """Return the losses on a grid of designs, a row each, over samples."""
    return _valleys(GRID[:, None], _numbers(samples))


@pytest.mark.parametrize("guess", [0.25, 0.5, 0.99])
def test_the_best_over_samples_is_found_from_the_other_valley(guess):
    d, x = design(x=(guess, 0.0, 1.0))
    robust = po.Robust(FIELD, lambda soil: {"loss": _valleys(x, soil.cohesion / 1e4)}, samples=32, seed=2)
    d.minimise(robust.expected("loss"))
    best, means = d.solve(), _by_hand(robust.samples).mean(axis=1)
    # Beside a minimum the grid is off by half its curvature times half a position's square, some 1e-8.
    assert best.objective == pytest.approx(means.min(), abs=1e-7)
    assert best.variables["x"] == pytest.approx(GRID[means.argmin()], abs=1e-4)


def test_the_sharp_worst_case_is_searched_without_its_bound():
    d, x = design(x=(0.25, 0.0, 1.0))
    robust = po.Robust(FIELD, lambda soil: {"loss": _valleys(x, soil.cohesion / 1e4)}, samples=16, seed=2)
    d.minimise(robust.bound_from_above(d, "loss", lower=-50.0, upper=50.0))
    best, least = d.solve(), _by_hand(robust.samples).max(axis=1).min()
    assert best.search.variables == ("x",)
    losses = _valleys(best.variables["x"], _numbers(robust.samples))
    assert best.objective == pytest.approx(losses.max(), rel=1e-8)
    # At the corner of a maximum the grid is off by its slope times half a position.
    assert least - 1e-3 <= best.objective <= least + 1e-9


@pytest.mark.parametrize("lost", [False, True])
def test_widths_follow_from_the_designs_that_are_found(lost):
    """A number times a loss with two equal valleys scales the spread: far from the start, far from its width."""
    made = []

    def build(start, spreads):
        made.append(spreads["loss"])
        if lost and len(made) > 1:
            raise po.NotConverged("it was lost", "no optimum")
        d, x = design(x=(start["x"], -6.0, 6.0))
        robust = _robust(x)
        d.minimise(robust.cvar("loss", 0.9, width=0.5 * spreads["loss"]))
        return d, robust, frozenset({"loss"})

    def _robust(x):
        return po.Robust(FIELD, lambda soil: {"loss": ((x**2 - 4.0) ** 2 + 4.0) * soil.cohesion / MEAN}, samples=16)

    known = _robust(design(x=(1.0, -6.0, 6.0))[1])

    def spreads(at):
        return {name: float(np.std(values)) for name, values in known.values(at).items()}

    best, robust, failures = best_robust({"x": 5.0}, build, spreads, lambda *_: None)
    # Both valleys may be lost; the best is then as the search found it, and the reason is given for each.
    assert [text.endswith(": it was lost") for text in failures] == [True] * 2 * lost
    assert len(made) > 1
    own = robust.values(best)["loss"]
    (requested,) = robust.requested
    assert requested.width == pytest.approx(0.5 * (made[0] if lost else np.std(own)), rel=0.02)
    assert best.objective == pytest.approx(measures.cvar(own, 0.9, width=requested.width), rel=1e-9)
    # Whatever its width, the CVaR grows with the loss, which is least at 2 and at -2.
    found = [local.variables["x"] for local in best.local_optima]
    assert np.abs(found) == pytest.approx(2.0, rel=1e-3)
    assert len(set(np.sign(found))) == len(found) == 2 - lost


UNIFORM_FIELD = po.SoilDistribution(
    po.named_soil("serozem"), cohesion=stats.lognorm(0.3, scale=20e3), density_ratio=stats.beta(8, 4, 0.7, 0.14)
)
FIXED = po.Accuracy("dop853", steps=60)


def _program(d):
    return Program.of(d.declared).with_steps(np.zeros(0))


def _path(count):
    """Return the program of averages over soils, of the path in one of them, and of a run of another structure."""
    d = po.Design()
    angle = d.variable("wedge angle", guess=0.5, lower=0.2, upper=0.9)
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.40)
    k0 = d.variable("stiffness", guess=2e4, lower=5e3, upper=1e5, log=True)
    share = po.Wedge(angle, po.deg(15.0), height)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6))
    runs = []

    def response(soil):
        scene = po.Scene(soil, share, k0, 20.0 + share.equivalent_cone().solid_mass(7850.0), 2.0, effects)
        runs.append(po.simulate(scene, 0.8, accuracy=FIXED, outputs=5))
        return {"draft": runs[-1].mean_draft / 1e3, "rms": runs[-1].force_rms / 1e3, "radius": scene.loosened_radius}

    robust = po.Robust(UNIFORM_FIELD, response, samples=count, seed=1)
    other = po.simulate(replace(runs[0].scene, effects=po.Effects(damping=300.0)), 0.5, accuracy=FIXED)
    d.minimise(robust.cvar("draft", 0.7, width=0.3) + robust.mean_plus("rms", 2.0) + other.mean_draft / 1e3)
    robust.require_probability(d, "radius", "radius", 0.9, at_least=0.1, width=0.01)
    d.require("deflection", runs[1].deflection, at_most=0.3)
    return _program(d)


def _events():
    """Return the program of averages over soils of runs that stick and slip."""
    d = po.Design()
    k0 = d.variable("stiffness", guess=5e4, lower=2e4, upper=9e4, log=True)
    share = po.Wedge(po.deg(35.0), po.deg(15.0), 0.2)
    wave = po.StrengthWave(0.9, 0.2)
    effects = po.Effects(contact=po.StickSlip(1.2), strength_wave=wave, damping=200.0)

    def response(soil):
        return {"rms": po.simulate(po.Scene(soil, share, k0, 25.0, 0.8, effects), 0.5, outputs=5).force_rms / 1e3}

    d.minimise(po.Robust(UNIFORM_FIELD, response, samples=3).mean_plus("rms", 1.0))
    return _program(d)


@pytest.mark.parametrize(
    ("make", "point", "first", "second"),
    [
        # The measures' third derivatives jump where a sample enters a width: differences lose digits there.
        pytest.param(lambda: _path(6), [0.61, 0.43, 0.37], 1e-7, 1e-6, id="averages, a path and another run"),
        # Tolerances of integrators with events: 1e-10.
        pytest.param(_events, [0.5], 1e-5, 1e-5, id="events", marks=pytest.mark.slow),
    ],
)
def test_derivatives_against_differences(make, point, first, second):
    check_derivatives(make().nlp, np.array(point), np.zeros(0), first, second)


def test_the_graph_of_the_derivatives_does_not_grow_with_the_samples():
    sizes = [_path(count).nlp.slopes.n_instructions() for count in (4, 12)]
    assert sizes[0] == sizes[1]
