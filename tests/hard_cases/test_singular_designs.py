"""Designs with singularities: vanishing oscillation, flat objectives, and trials outside the domain of a theory."""

import math

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import R1_SOIL, SHARP
from helpers.small_designs import design
from scipy.optimize import minimize_scalar

import plough_opt as po
from plough_opt.soil import elastic

# Whole waves for a share that moves with the strut: RMS is amplitude F0/sqrt(2).
MOTIONS = {"quasi-static": (False, 2.0), "moving": (True, 0.5)}
motions = pytest.mark.parametrize(("motion", "duration"), MOTIONS.values(), ids=MOTIONS)


def scene_of(amplitude=None, share=SHARP, stiffness=5e4, mass=24.0, **effects):
    wave = None if amplitude is None else po.StrengthWave(amplitude, 0.5)
    return po.Scene(R1_SOIL, share, stiffness, mass, 2.0, po.Effects(strength_wave=wave, **effects))


def rms(amplitude, motion, duration):
    return po.simulate(scene_of(amplitude, motion=motion), duration, outputs=10).force_rms


def by_scipy(function, lower, upper):
    """Return the least value of a function on an interval: a grid with both ends, its best place polished."""
    grid = np.linspace(lower, upper, 41)
    values = [function(float(x)) for x in grid]
    k = int(np.argmin(values))
    around = grid[max(k - 1, 0)], grid[min(k + 1, 40)]
    return min(values[k], minimize_scalar(function, bounds=around, method="bounded", options={"xatol": 1e-10}).fun)


# --- RMS where nothing oscillates ---------------------------------------------------------------------------


@motions
def test_derivatives_where_the_amplitude_vanishes(motion, duration):
    x = ca.MX.sym("amplitude")
    run = po.simulate(scene_of(x, motion=motion), duration, outputs=10 if motion else 400)
    hessian, gradient = ca.hessian(run.force_rms, x)
    of = ca.Function("of", [x], [run.force_rms, gradient, hessian])
    value, slope, bend = map(float, of(0.0))
    limit = rms(1e-7, motion, duration) / 1e-7
    if not motion:
        assert limit == pytest.approx(scene_of().reaction.static / math.sqrt(2.0), rel=1e-9)
    # The root is rounded off within 1e-12 of the force: there its slope is that of an even function. What a
    # quadrature's weights lack of one is below that.
    force = scene_of().steady_resistance
    assert 0.0 <= value <= 1e-15 * force
    assert abs(slope) <= 1e-15 * force
    assert math.isfinite(bend)
    assert bend > 0.0
    for amplitude in (1e-10, 1e-8, 1e-6, 1e-4):
        value, slope, bend = map(float, of(amplitude))
        # By closed form sqrt((slope x)^2 + r^2) - r with r = 1e-12 of the force, and what the wave's square adds.
        rounded = 1e-12 * force / (limit * amplitude)
        allowed = 2.0 * rounded + 10.0 * amplitude + 1e-6
        assert value == pytest.approx(limit * amplitude, rel=allowed)
        assert slope == pytest.approx(limit, rel=allowed)
        assert math.isfinite(bend)


@pytest.mark.parametrize(
    ("gain", "guess"), [(0.0, 0.3), (0.9, 0.0), (1.1, 1.0), pytest.param(2.0, 0.0, marks=pytest.mark.slow)]
)
@motions
def test_an_amplitude_is_driven_to_zero_or_away_from_it(motion, duration, gain, guess):
    slope = rms(1e-7, motion, duration) / 1e-7 / 1e3
    d, amplitude = design(amplitude=(guess, 0.0, 1.0))
    run = po.simulate(scene_of(amplitude, motion=motion), duration)
    d.minimise(1.0 + run.force_rms / 1e3 - gain * slope * amplitude)
    best = d.solve(search="local")
    x = best.variables["amplitude"]
    (limit,) = best.limits
    truth = by_scipy(lambda e: 1.0 + rms(e, motion, duration) / 1e3 - gain * slope * e, 0.0, 1.0)
    assert best.objective == pytest.approx(truth, abs=1e-9)
    if gain < 1.0:
        assert x < 1e-9
        # The barrier stops at some 3e-11, where rounding the root off still takes a thousandth of its slope.
        assert limit.multiplier == pytest.approx((1.0 - gain) * slope, abs=2e-3 * slope)
    else:
        assert x > 0.4
        assert limit.active == (min(x, 1.0 - x) < 1e-6)


def test_a_start_that_stays_steady_leaves_the_rest_of_the_objective_alone():
    found = []
    for weight in (0.0, 1.0):
        d = po.Design()
        k0 = d.variable("stiffness", guess=4e4, lower=5e3, upper=5e5, unit="N/m", log=True)
        height = d.variable("height", guess=0.2, lower=0.1, upper=0.5, unit="m")
        mass = d.variable("mass", guess=30.0, lower=10.0, upper=50.0, unit="kg")
        share = po.Wedge(po.deg(25.0), po.deg(15.0), height)
        run = po.simulate(scene_of(share=share, stiffness=k0, mass=mass), 0.5)
        sway = run.force_rms / 1e3 + 1e2 * run.displacement_rms
        wanted = (run.mean_draft / 600.0 - 1.0) ** 2 + (run.mean_deflection / 0.02 - 1.0) ** 2
        d.minimise(1.0 + wanted + (mass / 20.0 - 1.0) ** 2 + weight * sway)
        x = ca.vertcat(k0, height, mass)
        hessian, gradient = ca.hessian(sway, x)
        numbers = ca.Function("numbers", [x], [sway, gradient, hessian])([3e4, 0.25, 20.0])
        assert all(np.all(np.asarray(part) == 0.0) for part in numbers)
        found.append(d.solve())
    # Nothing oscillates: RMS is 0 for every design, and the three wishes come true.
    for best in found:
        assert best.objective == pytest.approx(1.0, abs=1e-12)
        assert best.variables["mass"] == pytest.approx(20.0, rel=1e-7)
        assert best.variables["stiffness"] == pytest.approx(600.0 / 0.02, rel=1e-7)
        share = po.Wedge(po.deg(25.0), po.deg(15.0), best.variables["height"])
        assert scene_of(share=share).steady_resistance == pytest.approx(600.0, rel=1e-7)


@pytest.mark.parametrize("most", [0.0, pytest.param(1e-9, marks=pytest.mark.slow), 1e-3, 1.0])
def test_almost_no_oscillation_may_be_required(most):
    d, amplitude = design(amplitude=(0.3, 0.0, 1.0))
    run = po.simulate(scene_of(amplitude, motion=False), 2.0)
    d.minimise(1.0 - amplitude)
    d.require("calm", run.force_rms, at_most=most, unit="N")
    if most < 1e-6:
        # Feasible designs have an amplitude below 3e-12, where the root has almost no slope.
        try:
            assert d.solve().variables["amplitude"] < 1e-10
        except po.NotConverged as refusal:
            sentence = str(refusal)
            assert "at amplitude = " in sentence
        return
    best = d.solve()
    allowed = most * math.sqrt(2.0) / scene_of().reaction.static
    assert best.variables["amplitude"] == pytest.approx(allowed, rel=1e-5)
    # Its pull is a millionth of the objective: the optimiser leaves next to no margin.
    assert 0.0 <= best.margins["calm"] < 1e-5 * most


# --- flat objectives ----------------------------------------------------------------------------------------


def of_angle_and_height(objective):
    d, angle, height = design(**{"wedge angle": (0.5, 0.1, 1.0, "rad"), "height": (0.25, 0.1, 0.5, "m")})
    run = po.simulate(scene_of(share=po.Wedge(angle, po.deg(15.0), height), motion=False), 1.0)
    d.minimise(objective(run.mean_draft / 1e3))
    return d.solve()


def draft(variables):
    share = po.Wedge(variables["wedge angle"], po.deg(15.0), variables["height"])
    return scene_of(share=share).steady_resistance / 1e3


def test_a_plain_has_two_flat_directions():
    # Below 1 kN the objective is constant; at the edge it has two derivatives.
    best = of_angle_and_height(lambda force: 1.0 + ca.fmax(force - 1.0, 0.0) ** 3)
    assert best.objective == pytest.approx(1.0, abs=1e-9)
    assert draft(best.variables) < 1.0 + 1e-3
    assert best.status == "not unique"
    assert len(best.flat_directions) == 2


@pytest.mark.parametrize(("power", "within"), [(4, 1e-2), (6, 3e-2), (8, 6e-2)])
def test_a_bottom_of_high_order_is_reached_to_rounding_of_the_objective(power, within):
    d, x = design(x=(0.9, 0.0, 1.0))
    d.minimise(1.0 + (x - 0.4) ** power)
    best = d.solve()
    assert best.objective == pytest.approx(1.0, abs=1e-10)
    assert best.variables["x"] == pytest.approx(0.4, abs=within)


# --- designs without a value -------------------------------------------------------

PARTLY = {
    # the objective, for expressions and numbers: numbers without a value count as infinite
    "root": lambda h, sqrt, _log: 1.0 - sqrt(h - 0.2) + 2.0 * h,
    "steep root": lambda h, sqrt, _log: 1.0 - 0.2 * sqrt(h - 0.2) + 2.0 * h,
    "logarithm": lambda h, _sqrt, log: 3.0 - log(h - 0.2) / 10.0 + 2.0 * h,
    "inverse": lambda h, sqrt, _log: 1.0 + 1e-3 / sqrt(h - 0.2) + h,
}


@pytest.mark.parametrize("lower", [0.1, 0.2], ids=["beyond", "up to it"])
@pytest.mark.parametrize("guess", [0.2001, 0.5])
@pytest.mark.parametrize("objective", PARTLY.values(), ids=PARTLY)
def test_designs_without_a_value_do_not_stop_a_solve(objective, guess, lower):
    d, h = design(h=(guess, lower, 0.5))
    d.minimise(objective(h, ca.sqrt, ca.log))
    best = d.solve()
    truth = by_scipy(lambda x: objective(x, math.sqrt, math.log), 0.2 + 1e-12, 0.5)
    assert best.objective == pytest.approx(truth, rel=1e-9)


def test_an_optimum_at_a_bound_with_an_infinite_slope_is_found():
    d, h = design(h=(0.3, 0.2, 0.5))
    d.minimise(1.0 + ca.sqrt(h - 0.2))
    best = d.solve()
    # The square root of the bound's rounding.
    assert best.objective == pytest.approx(1.0, abs=1e-8)
    assert best.variables["h"] == pytest.approx(0.2, rel=1e-15)
    assert "h" in best.active


@pytest.mark.parametrize("upper", [89.0, 89.99, 90.0 * (1.0 - 1e-12)])
@pytest.mark.parametrize("guess", [10.0, 88.0])
def test_a_share_between_bounds_that_reach_the_end_of_the_angles(upper, guess):
    d, angle = design(**{"wedge angle": (po.deg(guess), 1e-8, po.deg(upper), "rad")})
    run = po.simulate(scene_of(share=po.Wedge(angle, po.deg(15.0), 0.25), motion=False), 1.0)
    d.minimise(1.0 + (run.mean_draft / 2e3 - 1.0) ** 2)
    best = d.solve()
    # The start's objective of up to a thousand scales the tolerance.
    assert draft({"wedge angle": best.variables["wedge angle"], "height": 0.25}) == pytest.approx(2.0, rel=1e-6)
    assert best.objective == pytest.approx(1.0, abs=1e-12)


NODES = [(0.0, 0.0), (0.3, 0.03), (0.5, 0.0)]
LOESS = po.named_soil("serozem")
SHEAR = math.sqrt(LOESS.youngs_modulus / (2.0 * (1.0 + LOESS.poisson_ratio)) / LOESS.density)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["least", "most"])
@pytest.mark.parametrize("guess", [1.0, 20.0, 52.0])
def test_a_pressure_between_bounds_far_beyond_the_shear_wave(sign, guess):
    d, speed = design(speed=(guess, 1.0, 300.0, "m/s"))
    d.minimise(1.0 + sign * elastic.wedge_pressure(0.1, NODES, LOESS, speed) / 1e6)
    best = d.solve()
    truth = by_scipy(lambda v: 1.0 + sign * elastic.wedge_pressure(0.1, NODES, LOESS, v) / 1e6, 1.0, 0.9999 * SHEAR)
    assert best.objective == pytest.approx(truth, rel=1e-8)
