"""Fronts of two objectives and of three, against brute force by independent code: whole, and beaten nowhere."""

from itertools import pairwise

import numpy as np
import pytest
from independent import study
from independent.build import as_trade_off

import plough_opt as po

# Of a range: straight lines between the points of a curve lie so little beside what is curved between them.
BESIDE = 2e-3
# Some that take little time; of the curves one has a dip of the force that is a part of the front by itself.
DEFAULT = {"front": (5, 6), "surface": ()}
KNOWN = {(kind, number): case for kind in DEFAULT for number, case in study.problems(kind).items()}


def case(kind, number):
    """Return a parameter with its marks."""
    marks = [] if number in DEFAULT[kind] else [pytest.mark.slow]
    return pytest.param(kind, number, marks=marks, id=f"{kind} {number}")


def drawn(front):
    """Return points of a curve, and of the straight lines between neighbours."""
    rows = [front.objectives]
    for part in front.parts:
        for a, b in pairwise(front.objectives[list(part)]):
            rows.append(a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a))
    return np.vstack(rows)


@pytest.mark.parametrize(("kind", "number"), [case(*key) for key in sorted(KNOWN)])
def test_the_whole_front_is_found(kind, number):
    problem, truth = KNOWN[kind, number]
    design, goals = as_trade_off(problem, truth["names"])
    front = po.trade_off(design, *goals, points=study.POINTS[len(goals)])
    verdict = study.judge_front(problem, truth, front)
    assert verdict.right, (verdict, front.failures)
    assert np.all(np.isfinite(front.objectives))
    if len(goals) == 2:
        wanted = np.array(truth["objectives"])
        behind = (drawn(front)[:, None, :] - wanted[None, :, :]) / np.ptp(wanted, axis=0)
        assert np.max(np.min(np.max(behind, axis=2), axis=0)) <= BESIDE
