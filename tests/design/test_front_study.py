"""Fronts of two objectives, against brute force by independent code: no end, branch or basin is missing."""

import pytest
from independent import study
from independent.build import as_design

import plough_opt as po

POINTS = 40
# Between neighbours of so many points lie 2.6 % of the range, if they are evenly spread.
SPACING = 0.04
# Of a returned design that the sample beats.
DOMINATED = 1e-3
DEFAULT = 1
KNOWN = study.problems("front")


@pytest.mark.parametrize(
    "number", [pytest.param(k, marks=() if k < DEFAULT else pytest.mark.slow, id=str(k)) for k in sorted(KNOWN)]
)
def test_the_whole_front_is_found(number):
    problem, truth = KNOWN[number]
    design, run = as_design(problem)
    goals = [po.Goal(name.replace("_", " "), getattr(run, name)) for name in truth["names"]]
    front = po.trade_off(design, *goals, points=POINTS)
    verdict = study.judge_front(
        problem, truth, [[p.variables[v.name] for v in problem.variables] for p in front.points]
    )
    assert verdict.violation <= study.RELATIVE, verdict
    assert verdict.dominated <= DOMINATED, verdict
    assert verdict.missing <= SPACING, verdict
