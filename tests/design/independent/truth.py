"""A stored truth found anew, by SciPy's differential evolution and SLSQP.

The stored problems were drawn at random, and their truths found in this way with more islands and starts.
"""

import itertools
import warnings
from dataclasses import replace

import numpy as np
from scipy.optimize import Bounds, differential_evolution, minimize

from independent.problem import Limit, evaluate, gaps_of, sample, sign_of

# Phase per step [rad] in sample and evolution (error about 1e-5), in polishing (1e-7) and the last polishing (1e-10).
_ROUGH, _GOOD, _FINE = 1.6, 0.9, 0.5
# Values above every objective, for designs that violate a requirement and for those that cannot be evaluated.
_BEYOND, _NO_VALUE = 1e6, 1e12
# Violation that rounding may leave, as a fraction of the limit.
_MET = 1e-9
_DIFFERENCE = 1e-5
_ROUNDS = 3
_ROWS = 40
_STRATEGIES = "best1bin", "rand1bin", "randtobest1bin", "currenttobest1bin"


def worth(problem, y, giving=False, phase=_ROUGH):
    """Return what is minimised: the objective, above all others if a requirement is violated, or the shortfall."""
    found = evaluate(problem, y, phase)
    short = np.sum(np.maximum(found.violations, 0.0), axis=0)
    with np.errstate(invalid="ignore"):
        values = np.where(short <= _MET * len(problem.limits), found.objective, _BEYOND * (1.0 + short / (1.0 + short)))
    return np.nan_to_num(short if giving else values, nan=_NO_VALUE, posinf=_NO_VALUE)


def optima(problem, giving=False):
    """Return distinct good designs, as positions, and their values, best first.

    Args:
        problem: the problem.
        giving: whether the sum of the requirements' shortfalls is minimised instead of the objective.
    """
    n, random = len(problem.variables), np.random.default_rng(7)
    y = sample(problem, 14, random)
    order = np.argsort(worth(problem, y, giving), kind="stable")
    members, looked = 20 + 10 * n, [y]
    for k, strategy in enumerate(_STRATEGIES):
        # Each island starts from its own part of the sample: half its best designs, half others.
        own = order[k :: len(_STRATEGIES)]
        done = differential_evolution(
            lambda x: worth(problem, np.clip(x.T, 0.0, 1.0), giving), [(0.0, 1.0)] * n, strategy=strategy,
            init=y[np.r_[own[: members // 2], random.choice(own, members - members // 2, replace=False)]],
            maxiter=25 * n, mutation=(0.4, 0.9), recombination=0.9, tol=1e-10, atol=0.0, polish=False, vectorized=True,
            updating="deferred", rng=random,
        )  # fmt: skip
        looked.append(np.clip(done.population, 0.0, 1.0))
    y, looked = np.empty((0, n)), np.vstack(looked)
    for _ in range(_ROUNDS):
        starts = [x for apart in (0.1, 0.04, 0.004) for x in distinct(problem, looked, giving, apart, 20, _ROUGH)[0]]
        ends = [_descended(problem, x, giving, 1.0, _GOOD) for x in starts]
        y, _ = distinct(problem, np.vstack([y, starts, ends]), giving, 1e-4, 8, _GOOD)
        # Then from designs that share all but one or two of their variables with one of the best.
        near, other = y[random.integers(min(3, len(y)), size=2**13)], sample(problem, 13, random)
        looked = np.where(random.random(near.shape) < 1.5 / n, other, near)
    ends = [_descended(problem, _descended(problem, x, giving, 0.1, _FINE), giving, 0.01, _FINE) for x in y]
    return distinct(problem, np.vstack([y, ends]), giving, 1e-4, 8, _FINE)


def distinct(problem, y, giving, apart, count, phase):
    """Return the best designs that are at least this far apart from each other, and their values."""
    values, chosen = worth(problem, y, giving, phase), []
    for k in np.argsort(values, kind="stable"):
        if len(chosen) < count and values[k] < _NO_VALUE and all(np.max(np.abs(y[k] - y[j])) > apart for j in chosen):
            chosen.append(k)
    return y[chosen], values[chosen]


def _descended(problem, y, giving, reach, phase):
    """Return SLSQP's solution at most this far from a position, in the design's variables and requirements' slacks."""
    n, m = len(y), len(problem.limits)
    objective, gaps = gaps_of(problem, y, phase)
    if not np.isfinite(objective[0]):
        return y
    # The outputs of a path that are nearest to its limit.
    rows = [np.argsort(-own[:, 0], kind="stable")[:_ROWS] for own in gaps]
    owner = np.repeat(np.arange(m), [len(own) for own in rows])
    scale, known = max(abs(objective[0]), 1e-12), {}

    def at(x):
        """Return objective and violations, each with its slope by central differences."""
        key = x[:n].tobytes()
        if key not in known:
            known.clear()
            points = np.vstack([np.zeros((1, n)), np.eye(n), -np.eye(n)]) * _DIFFERENCE + x[:n]
            objective, gaps = gaps_of(problem, points, phase)
            kept = [own[chosen] for own, chosen in zip(gaps, rows, strict=True)]
            found = np.nan_to_num(np.vstack([objective / scale, *kept]), posinf=1e6)
            known[key] = found[:, 0], (found[:, 1 : n + 1] - found[:, n + 1 :]) / (2.0 * _DIFFERENCE)
        return known[key]

    slack = np.array([max(np.max(own), 0.0) for own in gaps]) if giving else np.zeros(m)
    low, high = np.maximum(y - reach, 0.0), np.minimum(y + reach, 1.0)
    keep = {
        "type": "ineq",
        "fun": lambda x: x[n:][owner] - at(x)[0][1:] - 0.5 * _MET * (not giving),
        "jac": lambda x: np.hstack([-at(x)[1][1:], np.eye(m)[owner]]),
    }
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        done = minimize(
            lambda x: np.sum(x[n:]) if giving else at(x)[0][0],
            np.r_[y, slack],
            jac=lambda x: np.r_[np.zeros(n), np.ones(m)] if giving else np.r_[at(x)[1][0], np.zeros(m)],
            bounds=Bounds(np.r_[low, np.zeros(m)], np.r_[high, np.full(m, np.inf if giving else 0.0)]),
            constraints=keep if m else (),
            method="SLSQP",
            options={"ftol": 1e-13, "maxiter": 100},
        )
    return np.clip(np.where(np.isfinite(done.x[:n]), done.x[:n], y), low, high)


def best_of_catalogue(problem, offered):
    """Return the best objective and its offered values; the combinations that a sample ranks first are solved."""
    ranked = []
    for values in itertools.product(*offered.values()):
        fixed = dict(zip(offered, values, strict=True))
        left = tuple(v for v in problem.variables if v.name not in fixed)
        held = replace(problem, variables=left, fixed=problem.fixed | fixed)
        ranked.append((np.min(worth(held, sample(held, 12, np.random.default_rng(3)))), values, held))
    ranked.sort(key=lambda one: one[0])
    return min((float(optima(held)[1][0]), values) for _, values, held in ranked[:5])


def least_of(problem, name, others):
    """Return the least value of an objective over the designs that have the given or better values of others."""
    limits = [Limit(name, "at_most" if value > 0.0 else "at_least", abs(value)) for name, value in others.items()]
    # A negative weight maximises the radius.
    held = replace(problem, objective={name: sign_of(name)}, limits=(*problem.limits, *limits))
    return optima(held)[1][0]
