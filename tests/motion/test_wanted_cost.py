"""The price of a wanted error: a looser one takes no more steps, counted and not clocked."""

import contextlib
import itertools
import math

import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion import verified
from plough_opt.motion.estimate import difference

ERRORS = [10.0**-k for k in range(2, 11)]


def sampled(number):
    """Return a scene that steps of order 8 follow, with a wave, a damper and a ramp or without, and a time."""
    random = np.random.default_rng(number)
    effects = {"start": str(random.choice(["equilibrium", "rest", "towed"]))}
    if random.random() < 0.7:
        effects["strength_wave"] = po.StrengthWave(random.uniform(0.05, 0.5), 10.0 ** random.uniform(-1.0, 0.3))
    if random.random() < 0.6:
        effects["damping"] = 10.0 ** random.uniform(1.0, 3.0)
    if random.random() < 0.3:
        effects["tow_ramp"] = random.uniform(0.05, 0.5)
    share = po.Wedge(random.uniform(0.2, 0.8), 0.26, random.uniform(0.15, 0.4))
    stiffness, mass, speed = 10.0 ** random.uniform(4.0, 6.0), random.uniform(10.0, 60.0), random.uniform(0.5, 3.0)
    scene = po.Scene(po.named_soil("serozem"), share, stiffness, mass, speed, po.Effects(**effects))
    return scene, 10.0 ** random.uniform(-0.5, 1.0)


def steps_for_errors(monkeypatch, number):
    """Return the steps, checks and attempts included, that each of the wanted errors takes, and the estimates."""
    scene, duration = sampled(number)
    taken, follow = [], verified.follow

    def counted(case, accuracy, *given, **named):
        taken.append(accuracy.steps or math.inf)
        return follow(case, accuracy, *given, **named)

    monkeypatch.setattr(verified, "follow", counted)
    found = []
    for error in ERRORS:
        taken.clear()
        run = po.simulate(scene, duration, accuracy=po.Accuracy(error=error), outputs=100)
        found.append((sum(taken), run.error_estimate))
    return [list(column) for column in zip(*found, strict=True)]


# Steps below which a run's time is that of what goes with it: its arrays and averages.
FEW = 400


@pytest.mark.parametrize("number", [1, 4, 6, 10, 11])
def test_a_looser_error_takes_no_more_steps(monkeypatch, number):
    steps, estimates = steps_for_errors(monkeypatch, number)
    assert all(estimate <= error for error, estimate in zip(ERRORS, estimates, strict=True))
    assert all(tighter >= looser or looser < FEW for looser, tighter in itertools.pairwise(steps)), steps


def overshoots(monkeypatch, number):
    """Return by how many times each wanted error is more than the true one, where more steps are taken than a few."""
    steps, _ = steps_for_errors(monkeypatch, number)
    scene, duration = sampled(number)
    truth = po.simulate(scene, duration, accuracy=po.Accuracy(error=1e-12), outputs=100)
    found = []
    for taken, error in zip(steps, ERRORS[:-1], strict=False):
        # What the first, long steps leave is had for nothing.
        if taken > max(FEW, 1.5 * steps[0]):
            run = po.simulate(scene, duration, accuracy=po.Accuracy(error=error), outputs=100)
            found.append(error / difference(truth, run))
    return found


@pytest.mark.parametrize("numbers", [(1, 4, 6), pytest.param(range(60), marks=pytest.mark.slow)], ids=len)
def test_where_steps_cost_time_the_error_is_not_far_less_than_wanted(monkeypatch, numbers):
    found = []
    for number in numbers:
        with contextlib.suppress(po.IntegrationError):  # a start from which the share is driven away
            found += overshoots(monkeypatch, number)
    assert len(found) > 1.5 * len(numbers)
    # The check with three quarters of the steps errs by ten times as much, and steps are a tenth more than enough.
    assert 5.0 < np.median(found) < 30.0, found
