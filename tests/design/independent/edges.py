"""Problems that are just feasible or just infeasible: one limit is moved to the edge of what designs reach."""

from dataclasses import replace

import numpy as np

from independent.generate import draw
from independent.problem import evaluate
from independent.truth import Question, optima, sample, truth_of

# Seeds that the search problems do not use.
_FIRST_SEED = 10_000
_MOST_VARIABLES = 6
# Factor that moves a limit beyond the best value in a sample. If no design reaches that limit, the least shortfall
# gives the edge; otherwise the limit is moved again.
_BEYOND = {"at_most": 0.3, "at_least": 3.0}
SLACKS = (1e-3, 2e-2)


def _draw(number, random, least):
    """Return a random problem with at least this many requirements, and the number of one of them."""
    for attempt in range(1000):
        problem = draw(_FIRST_SEED + 1000 * number + attempt)
        if len(problem.limits) >= least and len(problem.variables) <= _MOST_VARIABLES:
            return problem, int(random.integers(len(problem.limits)))
    raise AssertionError(f"no problem found for number {number}")


def _tightened(problem, k, limit):
    limits = list(problem.limits)
    limits[k] = replace(limits[k], limit=float(f"{limit:.8g}"))
    return replace(problem, limits=tuple(limits))


def _end(problem, k):
    """Return the best value of a requirement's measure among designs that meet the others, and the best designs."""
    r = problem.limits[k]
    y = sample(problem, 12, np.random.default_rng(3))
    found = evaluate(problem, y, phase=1.6)
    best = np.min(found.violations[k, np.isfinite(found.objective)])
    sign = 1.0 if r.side == "at_most" else -1.0
    limit = r.limit * (1.0 + sign * best)
    for _ in range(10):
        beyond = _tightened(problem, k, limit * _BEYOND[r.side])
        limit = beyond.limits[k].limit
        found = optima(beyond, question=Question((k,)), thrifty=True)
        if found[0].value > 1e-6:
            return limit * (1.0 + sign * found[0].value), [b.y for b in found[:40]]
    raise AssertionError(f"{problem.name}: no edge of '{r.measure}' found")


def edge(number):
    """Return a problem whose designs meet a limit with a margin of 0.1 % or 2 % at best, and its truth."""
    random = np.random.default_rng([number, 1])
    problem, k = _draw(number, random, 1)
    best, near = _end(problem, k)
    slack = SLACKS[number % 2]
    sign = 1.0 if problem.limits[k].side == "at_most" else -1.0
    problem = replace(_tightened(problem, k, best * (1.0 + sign * slack)), name=f"edge {number}")
    return {"problem": problem.plain(), "slack": slack, "truth": truth_of(problem, extra=near)}


def infeasible(number):
    """Return an infeasible problem and its least shortfall."""
    random = np.random.default_rng([number, 2])
    problem, k = _draw(50_000 + number, random, 1 + number % 2)
    best, near = _end(problem, k)
    short = float(np.exp(random.uniform(np.log(0.01), np.log(0.5))))
    sign = 1.0 if problem.limits[k].side == "at_most" else -1.0
    problem = replace(_tightened(problem, k, best / (1.0 + sign * short)), name=f"infeasible {number}")
    found = optima(problem, question=Question(tuple(range(len(problem.limits)))), extra=near)
    values = evaluate(problem, found[0].y, phase=0.5)
    shortfalls = {r.measure: float(v) for r, v in zip(problem.limits, values.violations[:, 0], strict=True) if v > 1e-7}
    truth = {
        "shortfall": found[0].value,
        "lacking": shortfalls,
        "design": list(map(float, problem.values(found[0].y)[0])),
    }
    return {"problem": problem.plain(), "truth": truth}
