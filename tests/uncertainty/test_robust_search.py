"""Robust designs are searched over all their variables, and smoothed according to the spread of their results."""

import casadi as ca
import numpy as np
import pytest
from scipy import stats

import plough_opt as po
from plough_opt.studies.uncertainty import measures
from plough_opt.studies.uncertainty.robust import best_robust

MEAN, STD = 20e3, 4e3
FIELD = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.norm(MEAN, STD), within={"cohesion": (1.0, 1e6)})


def _valleys(x, number):
    """Two valleys that a normal number moves to and fro: the narrow one is deeper, the broad one forgives more."""
    moved = x - 0.03 * number
    exp = ca.exp if isinstance(x, ca.MX) else np.exp
    return 2.0 - 1.2 * exp(-(((moved - 0.25) / 0.01) ** 2)) - exp(-(((moved - 0.75) / 0.15) ** 2))


def _numbers(samples):
    return (samples.property("cohesion") - MEAN) / STD


@pytest.mark.parametrize("guess", [0.25, 0.5, 0.99])
def test_the_best_over_samples_is_found_from_the_other_valley(guess):
    d = po.Design()
    x = d.variable("x", guess=guess, lower=0.0, upper=1.0)
    robust = po.Robust(FIELD, lambda soil: {"loss": _valleys(x, (soil.cohesion - MEAN) / STD)}, samples=32, seed=2)
    d.minimise(robust.expected("loss"))
    best = d.solve()
    grid = np.linspace(0.0, 1.0, 20_001)
    by_hand = _valleys(grid[:, None], _numbers(robust.samples)).mean(axis=1)
    # Beside a minimum the grid is off by half its curvature times half a position's square, some 1e-8.
    assert best.objective == pytest.approx(by_hand.min(), abs=1e-7)
    assert best.variables["x"] == pytest.approx(grid[by_hand.argmin()], abs=1e-4)


def test_the_sharp_worst_case_is_searched_without_its_bound():
    d = po.Design()
    x = d.variable("x", guess=0.25, lower=0.0, upper=1.0)
    robust = po.Robust(FIELD, lambda soil: {"loss": _valleys(x, (soil.cohesion - MEAN) / STD)}, samples=16, seed=2)
    d.minimise(robust.bound_from_above(d, "loss", lower=-50.0, upper=50.0))
    best = d.solve()
    assert best.search.variables == ("x",)
    grid = np.linspace(0.0, 1.0, 20_001)
    by_hand = _valleys(grid[:, None], _numbers(robust.samples)).max(axis=1)
    # At the corner of a maximum the grid is off by its slope times half a position.
    assert best.objective == pytest.approx(by_hand.min(), abs=1e-3)
    assert best.objective <= by_hand.min() + 1e-9


def test_widths_follow_from_the_design_that_is_found():
    """The loss is x^2/2 + 4/x times a number whose spread the design scales: far from the start, far from its width."""
    made = []

    def build(start, spreads):
        d = po.Design()
        x = d.variable("x", guess=start["x"], lower=0.1, upper=50.0)
        robust = _robust(x)
        made.append(spreads["loss"])
        d.minimise(robust.cvar("loss", 0.9, width=0.5 * spreads["loss"]))
        return d, robust, frozenset({"loss"})

    def _robust(x):
        return po.Robust(FIELD, lambda soil: {"loss": (x**2 / 2 + 4.0 / x) * soil.cohesion / MEAN}, samples=16, seed=2)

    d = po.Design()
    known = _robust(d.variable("x", guess=1.0, lower=0.1, upper=50.0))

    def spreads(at):
        return {name: float(np.std(values)) for name, values in known.values(at).items()}

    best, robust, failures = best_robust({"x": 40.0}, build, spreads, lambda *_: None)
    assert failures == ()
    assert len(made) > 1
    own = robust.values(best)["loss"]
    (requested,) = robust.requested
    assert requested.width == pytest.approx(0.5 * np.std(own), rel=0.02)
    assert best.objective == pytest.approx(measures.cvar(own, 0.9, width=requested.width), rel=1e-9)
    # Whatever its width, the CVaR goes with x^2/2 + 4/x, which is least at x = 4^(1/3): that with the nominal width of
    # 40^2/2 does not.
    assert best.variables["x"] == pytest.approx(4.0 ** (1.0 / 3.0), rel=1e-3)
