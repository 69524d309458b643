"""Surfaces of three objectives, against brute force by independent code: covered, and beaten nowhere."""

import numpy as np
import pytest
from independent import study
from independent.build import as_trade_off

import plough_opt as po

POINTS = 60
# Of a range: by so much no returned design may be beaten by one that was sampled.
DOMINATED = 1e-3
# Of a range: from no part of a surface of 60 positions is the nearest point farther.
COVERED = 0.15
DEFAULT = (9,)
KNOWN = study.problems("surface")
# A tail of this surface, over half the range of the force, gains at most 2.5 % of the others' ranges.
TAIL = pytest.mark.xfail(reason="a tail that gains little is not followed", strict=True)


def marked(number):
    """Return a case with its marks."""
    marks = [*([] if number in DEFAULT else [pytest.mark.slow]), *([TAIL] if number == 5 else [])]
    return pytest.param(number, marks=marks, id=str(number))


@pytest.mark.parametrize("number", [marked(k) for k in sorted(KNOWN)])
def test_the_whole_surface_is_found(number):
    problem, truth = KNOWN[number]
    design, goals = as_trade_off(problem, truth["names"])
    front = po.trade_off(design, *goals, points=POINTS)
    verdict = study.judge_surface(
        problem, truth, [[p.variables[v.name] for v in problem.variables] for p in front.points]
    )
    assert verdict.violation <= study.RELATIVE, verdict
    assert verdict.dominated <= DOMINATED, verdict
    assert verdict.uncovered <= COVERED, verdict
    assert not any(failure.reason.startswith("Not_Reached") for failure in front.failures), front.failures
    assert np.all(np.isfinite(front.objectives))
