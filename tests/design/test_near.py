"""`search="near"` on random problems, compared with walks downhill and samples by independent code."""

from dataclasses import replace

import numpy as np
import pytest
from independent import study
from independent.build import as_design
from independent.problem import evaluate

KNOWN = {number: problem for number, (problem, _) in study.problems("search").items()}
OF_ONE = [number for number, problem in KNOWN.items() if len(problem.variables) == 1]
OF_SEVERAL = [number for number, problem in KNOWN.items() if 2 <= len(problem.variables) <= 5]
# Solved by default; the slow tests solve all.
FEW_OF_ONE, FEW_OF_SEVERAL = OF_ONE[:6], OF_SEVERAL[:4]
GRID = np.linspace(0.0, 1.0, 4001)
# A rise of less than a thousandth on the way down is a ripple within a basin. A grid needs half as much again.
RIPPLE = 1.5e-3
# No sampled design within this fraction of the range is better than the answer by more than a millionth.
RADIUS = 1e-3
BETTER = 1e-6
SAMPLE = 256


def _at(problem, y):
    """Return the objective at positions, and whether each meets the requirements."""
    found = evaluate(problem, y)
    return found.objective, found.worst <= study.RELATIVE


def _near(problem, y):
    """Return the position that a near search finds from a guess at a position."""
    values = problem.values(y)[0]
    variables = tuple(replace(v, guess=x) for v, x in zip(problem.variables, values, strict=True))
    best = as_design(replace(problem, variables=variables))[0].solve(search="near")
    return problem.positions([[best.variables[v.name] for v in problem.variables]])[0]


def _guesses(number, count, dimensions):
    return np.random.default_rng([number, 11]).random((count, dimensions))


def _selected(every, few):
    return [pytest.param(k, id=str(k), marks=() if k in few else pytest.mark.slow) for k in every]


# --- one variable: a walk downhill on a grid ---------------------------------------------------------------


def _walked(f, feasible, start):
    """Return the index at which a walk downhill over feasible neighbours ends."""
    k = start
    while True:
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(f) and feasible[j] and f[j] < f[k]]
        if not beside:
            return k
        k = min(beside, key=lambda j: f[j])


@pytest.mark.parametrize("number", _selected(OF_ONE, FEW_OF_ONE))
def test_the_basin_of_the_guess_or_of_the_nearest_feasible_design_is_kept(number):
    problem = KNOWN[number]
    f, feasible = _at(problem, GRID[:, None])
    for guess in _guesses(number, 3, 1):
        own, met = _at(problem, guess[None])
        start = int(np.flatnonzero(feasible)[np.argmin(np.abs(GRID[feasible] - guess[0]))])
        answer = _near(problem, guess)
        reached, kept = _at(problem, answer[None])
        assert kept[0]
        if met[0]:
            assert reached[0] <= own[0] * (1.0 + study.RELATIVE)
        walked = f[_walked(f, feasible, start)]
        assert reached[0] <= walked + study.RELATIVE * abs(walked)
        # Neither a barrier nor an infeasible design lies between.
        way = np.arange(start, int(np.rint(answer[0] * (len(GRID) - 1))), 1 if answer[0] > GRID[start] else -1)
        assert np.all(feasible[way[1:-1]])
        if len(way):
            rise = np.max(f[way] - np.minimum.accumulate(f[way]))
            assert rise <= RIPPLE * abs(f[start])


# --- several variables: never worse than a feasible guess -----------------------------------------------------


@pytest.mark.parametrize("number", _selected(OF_SEVERAL, FEW_OF_SEVERAL))
def test_a_local_optimum_no_worse_than_the_guess(number):
    problem = KNOWN[number]
    guesses = _guesses(number, 4096, len(problem.variables))
    guess = guesses[np.argmax(_at(problem, guesses)[1])]
    answer = _near(problem, guess)
    (own, reached), (_, kept) = _at(problem, np.array([guess, answer]))
    assert kept
    assert reached <= own * (1.0 + study.RELATIVE)
    around = np.clip(answer + RADIUS * (2.0 * np.random.default_rng(3).random((SAMPLE, len(answer))) - 1.0), 0.0, 1.0)
    f, _ = _at(problem, around)
    strictly = evaluate(problem, around).worst <= 0.0
    assert np.min(f[strictly], initial=np.inf) >= reached - BETTER * abs(reached)
