"""Drafts of a known soil, with and without errors, and the fits of its parameters."""

import numpy as np
import pytest
from helpers.known_soil import BOUNDS, drafts, steady_scene

import plough_opt as po


@pytest.fixture(scope="session")
def plane():
    """Conditions and true drafts over speed and wedge angle, and drafts with errors of 3 %."""
    conditions, exact = drafts(np.linspace(0.8, 3.0, 6), np.radians([25.0, 35.0, 45.0, 55.0]))
    noisy = exact * (1.0 + 0.03 * np.random.default_rng(11).standard_normal(len(exact)))
    return conditions, exact, noisy


@pytest.fixture(scope="session")
def three():
    """Three unknowns that drafts over speed and wedge angle determine, with a guess away from the truth."""
    guesses = {"soil.cohesion": 40e3, "soil.tool_friction": 0.9, "effects.rate_term": 0.1}
    return {name: (*BOUNDS[name], guess) for name, guess in guesses.items()}


@pytest.fixture(scope="session")
def measured(plane):
    """The noisy drafts with their stated sigma."""
    conditions, exact, noisy = plane
    return po.Measurements("mean_draft", noisy, conditions, sigma=0.03 * exact, name="plane")


@pytest.fixture(scope="session")
def fitted(measured, three):
    """The fit of the three unknowns."""
    return po.calibrate(steady_scene(), measured, three, title="plane")
