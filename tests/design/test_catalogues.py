"""Catalogue choices against every combination of the catalogue, optimised by an independent simulator and SLSQP."""

import numpy as np
import pytest
from independent import catalogues, study
from independent.build import as_design
from independent.problem import evaluate

PROBLEMS = catalogues.problems()
# One that takes a second; the rest take half a minute.
QUICK = (6,)


@pytest.mark.parametrize(
    "number", [number if number in QUICK else pytest.param(number, marks=pytest.mark.slow) for number in PROBLEMS]
)
def test_no_combination_of_the_catalogue_is_better(number):
    problem, offered, truth = PROBLEMS[number]
    best = as_design(problem)[0].solve(search="near", judge="bare")
    found = best.rounded(offered)
    y = problem.positions([[found.variables[v.name] for v in problem.variables]])
    seen = evaluate(problem, y)
    assert seen.worst[0] <= study.RELATIVE
    assert (seen.objective[0] - truth["objective"]) / abs(truth["objective"]) <= study.RELATIVE
    assert found.screened == np.prod([len(values) for values in offered.values()])
