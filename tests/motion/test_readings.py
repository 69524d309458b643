"""Outputs between steps: polynomials that the readings must reproduce, and motions that are known between them."""

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.timeline import Timeline, at_outputs

EPS = np.finfo(float).eps


def read(timeline, states, duration=1.0):
    """Return the states at the outputs from an array of those at the steps' ends."""
    return ca.Function("read", [], [at_outputs(timeline, ca.MX(ca.DM(states)), ca.MX(duration))])()["o0"].full()


@pytest.mark.parametrize("steps", [7, 8, 20, 33])
@pytest.mark.parametrize("power", [0, 1, 2, 7, 14, 15])
def test_polynomials_up_to_degree_15_are_read_exactly(steps, power):
    timeline, duration = Timeline(outputs=50, steps=steps, aligned=False), 3.0
    ends, at = timeline.nodes * duration, timeline.output_fractions * duration
    slope = (lambda t: power * t ** (power - 1)) if power else np.zeros_like
    found = read(timeline, [ends**power, slope(ends)], duration)
    # Weights of up to 8 at the ends of the run; of slopes the spacing of the steps divides the rounding.
    size = duration**power
    assert found[0] == pytest.approx(at**power, rel=0, abs=64 * EPS * size)
    assert found[1] == pytest.approx(slope(at), rel=0, abs=64 * EPS * size * steps)


def test_degree_16_is_beyond_them():
    timeline = Timeline(outputs=50, steps=5, aligned=False)
    assert len(timeline.nodes) == 8
    found = read(timeline, [timeline.nodes**16, 16 * timeline.nodes**15])
    # (t - t_0)^2 ... (t - t_7)^2, the error of Hermite interpolation of t^16.
    error = np.prod((timeline.output_fractions[:, None] - timeline.nodes) ** 2, axis=1)
    assert timeline.output_fractions**16 - found[0] == pytest.approx(error, rel=0, abs=128 * EPS)
    assert np.max(error) > 1e4 * 64 * EPS


@pytest.mark.parametrize(("steps", "degree"), [(1, 5), (2, 9), (3, 11)])
def test_few_steps_make_polynomials_of_lower_degree(steps, degree):
    timeline = Timeline(outputs=9, steps=steps, aligned=False)
    ends, at = timeline.nodes, timeline.output_fractions
    found = read(timeline, [ends**degree, degree * ends ** (degree - 1)])
    assert found == pytest.approx(np.array([at**degree, degree * at ** (degree - 1)]), rel=0, abs=32 * EPS * steps)


@pytest.mark.parametrize("kink", [0.2, 0.37, 0.5, 1e-12, 0.03, 0.99])
def test_no_polynomial_reaches_across_a_kink(kink):
    timeline = Timeline(outputs=40, steps=30, kink=kink, aligned=False)
    ends, at = timeline.nodes, timeline.output_fractions
    found = read(timeline, [np.maximum(ends - kink, 0.0) ** 3, 3.0 * np.maximum(ends - kink, 0.0) ** 2])
    assert found[0] == pytest.approx(np.maximum(at - kink, 0.0) ** 3, rel=0, abs=128 * EPS)
    assert found[1] == pytest.approx(3.0 * np.maximum(at - kink, 0.0) ** 2, rel=0, abs=64 * EPS * 30)


@pytest.mark.parametrize("kink", [3e-9, 1e-6, 0.013, 0.02, 0.07, 0.13, 0.27, 0.513, 0.5 + 2e-9, 0.987, 1.0 - 1e-6])
def test_wherever_the_kink_lies_an_oscillation_is_read_on_both_sides(kink):
    # Half a radian a step, which makes the order's error some 1e-10.
    timeline, rate = Timeline(outputs=400, steps=20, kink=kink, aligned=False), 10.0
    ends, at = timeline.nodes, timeline.output_fractions
    found = read(timeline, [np.cos(rate * ends), -rate * np.sin(rate * ends)])
    # Of slopes the spacing of the outputs divides the rounding.
    assert found[0] == pytest.approx(np.cos(rate * at), rel=0, abs=128 * EPS)
    assert found[1] == pytest.approx(-rate * np.sin(rate * at), rel=0, abs=2000 * EPS * rate)


def test_outputs_at_the_ends_of_steps_are_the_states_there():
    # Thirty equal steps, and the first and the last in two.
    timeline, random = Timeline(outputs=10, steps=30, aligned=False), np.random.default_rng(3)
    states = random.normal(size=(2, 33))
    at = [0, *range(4, 31, 3), 32]
    assert timeline.nodes[at] == pytest.approx(timeline.output_fractions, rel=0, abs=EPS)
    assert np.all(read(timeline, states) == states[:, at])


def test_a_run_between_few_steps_is_that_of_many(r1_scene, r1_wave):
    scene = r1_scene(strength_wave=r1_wave, tow_ramp=0.33, damping=100.0, start="rest")
    fine = po.simulate(scene, 1.0, accuracy=po.Accuracy("dop853", steps=4000), outputs=1000)
    few = po.simulate(scene, 1.0, accuracy=po.Accuracy("dop853", steps=90), outputs=1000)
    # What 90 steps leave; between them no more than at their ends.
    for name in ("deflection", "mount_force", "speed", "soil_resistance"):
        there, here = getattr(fine, name), getattr(few, name)
        assert np.max(np.abs(there - here)) < 2e-7 * np.max(np.abs(there)), name
