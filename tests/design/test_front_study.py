"""Fronts of two objectives, against brute force by independent code: no end, branch or basin is missing."""

from itertools import pairwise

import numpy as np
import pytest
from independent import study
from independent.build import as_trade_off

import plough_opt as po

POINTS = 40
# Between neighbours of so many points lie 2.6 % of the range, if they are evenly spread.
SPACING = 0.04
# Of a range: by so much no returned design may be beaten. The brute force lags behind the true front by as much.
DOMINATED = 1e-3
# Of a range: straight lines between the points lie so little beside what is curved between them.
BESIDE = 2e-3
# Two that take little time, one of them with a dip of the force that is a part of the front by itself.
DEFAULT = (5, 6)
KNOWN = study.problems("front")


def drawn(front):
    """Return points of a front, and of the straight lines between neighbours."""
    rows = [front.objectives]
    for part in front.parts:
        for a, b in pairwise(front.objectives[list(part)]):
            rows.append(a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a))
    return np.vstack(rows)


@pytest.mark.parametrize(
    "number", [pytest.param(k, marks=() if k in DEFAULT else pytest.mark.slow, id=str(k)) for k in sorted(KNOWN)]
)
def test_the_whole_front_is_found(number):
    problem, truth = KNOWN[number]
    design, goals = as_trade_off(problem, truth["names"])
    front = po.trade_off(design, *goals, points=POINTS)
    verdict = study.judge_front(
        problem, truth, [[p.variables[v.name] for v in problem.variables] for p in front.points]
    )
    assert verdict.violation <= study.RELATIVE, verdict
    assert verdict.dominated <= DOMINATED, verdict
    assert verdict.missing <= SPACING, verdict
    wanted = np.array(truth["objectives"])
    behind = (drawn(front)[:, None, :] - wanted[None, :, :]) / np.ptp(wanted, axis=0)
    assert np.max(np.min(np.max(behind, axis=2), axis=0)) <= BESIDE
    assert not any("search more thoroughly" in note for note in front.notes)
