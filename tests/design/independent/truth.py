"""The best design of a problem by SciPy: a Sobol sample, islands of differential evolution, many polished starts."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import Bounds, differential_evolution, minimize
from scipy.stats import qmc

from independent.problem import PATHS, box_quartiles, evaluate

# Phase per step [rad] in sample and evolution (error about 1e-5), in polishing (1e-7) and the last polishing (1e-10).
_ROUGH = 1.6
_GOOD = 0.9
_FINE = 0.5
# Values above every objective, for designs that violate a requirement and for those that cannot be evaluated.
_BEYOND = 1e6
_NO_VALUE = 1e12
# Violation that rounding may leave, as a fraction of the limit.
MET = 1e-9
_DIFFERENCE = 1e-6
_ROWS = 80
# Designs closer than this are the same.
_SAME = 1e-4
_ROUNDS = 6


@dataclass(frozen=True)
class Best:
    """A design, as a position between the bounds, and its value."""

    y: np.ndarray
    value: float


def efforts(count, thrifty=False):
    """Return the sample size as a power of 2, islands, population, generations, and polished starts."""
    if count == 1:
        return 13, 1, 20, 20, 60
    if thrifty:
        return 12, 3, 10 + 8 * count, 15 * count, 20
    return 14, 4 if count < 5 else 6, 20 + 10 * count, 25 * count, 40


@dataclass(frozen=True)
class Question:
    """What is minimised: the objective, or the shortfall of some requirements.

    Attributes:
        giving: numbers of the requirements whose shortfall is minimised, subject to the others; None for the objective,
            subject to all of them.
    """

    giving: tuple[int, ...] | None = None

    def worth(self, found):
        """Return the value of designs; it is above all others if a requirement that must be met is violated."""
        kept = np.array([self.giving is None or k not in self.giving for k in range(len(found.violations))], dtype=bool)
        lacking = np.maximum(found.violations, 0.0)
        value = found.objective if self.giving is None else np.sum(lacking[~kept], axis=0)
        short = np.sum(lacking[kept], axis=0)
        with np.errstate(invalid="ignore"):
            values = np.where(short <= MET * len(kept), value, _BEYOND * (1.0 + short / (1.0 + short)))
        return np.nan_to_num(values, nan=_NO_VALUE, posinf=_NO_VALUE)

    def roughly(self, problem, y):
        """Return `worth` with few steps; paths, which take longest, are computed only if all else is met."""
        plain = [k for k, r in enumerate(problem.limits) if r.measure not in PATHS]
        values = np.empty(len(y))
        follow = np.ones(len(y), dtype=bool)
        if len(plain) < len(problem.limits):
            bare = replace(problem, limits=tuple(problem.limits[k] for k in plain))
            found = evaluate(bare, y, phase=_ROUGH)
            kept = np.array([self.giving is None or k not in self.giving for k in plain], dtype=bool)
            short = np.sum(np.maximum(found.violations[kept], 0.0), axis=0)
            follow = short <= MET
            values = np.minimum(np.nan_to_num(_BEYOND * (2.0 + short), nan=_NO_VALUE, posinf=_NO_VALUE), _NO_VALUE)
        values[follow] = self.worth(evaluate(problem, y[follow], phase=_ROUGH))
        return values


_OBJECTIVE = Question()


def sample(problem, power, random):
    """Return a scrambled Sobol sample; half of it is stretched and clipped, to include bounds and corners."""
    y = qmc.Sobol(len(problem.variables), seed=random).random(2**power)
    y[::2] = np.clip(0.5 + 1.15 * (y[::2] - 0.5), 0.0, 1.0)
    return y


def evolved(problem, question, y, values, random, effort):
    """Return the best designs and the final populations of islands of differential evolution."""
    _, islands, members, generations, _ = effort
    order = np.argsort(values, kind="stable")
    found = []
    for k in range(islands):
        # Each island starts from its own part of the sample: half its best designs, half others.
        own = order[k::islands]
        others = random.choice(own, size=members - members // 2, replace=False)
        done = differential_evolution(
            lambda x: question.roughly(problem, np.clip(x.T, 0.0, 1.0)),
            [(0.0, 1.0)] * y.shape[1],
            strategy=("best1bin", "rand1bin", "randtobest1bin", "currenttobest1bin")[k % 4],
            init=y[np.concatenate([own[: members // 2], others])],
            maxiter=generations, mutation=(0.4, 0.9), recombination=0.9, tol=1e-10, atol=0.0, polish=False,
            vectorized=True, updating="deferred", rng=int(random.integers(2**31)),
        )  # fmt: skip
        found += [np.clip(done.x, 0.0, 1.0)[None], done.population]
    return np.vstack(found)


def spread_starts(y, values, count, apart):
    """Return the best designs that are at least this far apart from each other."""
    chosen = []
    for k in np.argsort(values, kind="stable"):
        if values[k] >= _NO_VALUE or len(chosen) == count:
            break
        if all(np.max(np.abs(y[k] - y[j])) > apart for j in chosen):
            chosen.append(k)
    return y[chosen]


def polished(problem, starts, *, question=_OBJECTIVE, reach=1.0, phase=_GOOD):
    """Return SLSQP's solution from each start.

    Args:
        problem: the problem.
        starts: positions, a row each.
        question: what is minimised.
        reach: largest distance of a solution from its start.
        phase: see `fast.simulate`.
    """
    sizes = [401 if r.measure in PATHS else 1 for r in problem.limits]
    owner = np.repeat(np.arange(len(sizes)), sizes)

    def look(y):
        found = evaluate(problem, y, phase=phase, rows=True)
        whole = [found.rows[k] if k in found.rows else found.violations[k : k + 1] for k in range(len(sizes))]
        return found.objective, np.vstack(whole) if whole else np.zeros((0, len(y)))

    return np.array([_polished(look, start, owner, len(sizes), question, reach) for start in starts])


def _polished(look, y, owner, count, question, reach):
    for k in range(_ROUNDS):
        objective, gaps = look(y[None])
        if not np.isfinite(objective[0]):
            return y
        slack = np.zeros(count)
        np.maximum.at(slack, owner, gaps[:, 0])
        # The rows of each requirement that are nearest to its limit.
        own = [np.flatnonzero(owner == r) for r in range(count)]
        rows = [rows[np.argsort(-gaps[rows, 0], kind="stable")[:_ROWS]] for rows in own]
        kept = np.sort(np.concatenate(rows)) if rows else np.zeros(0, dtype=int)
        scale = max(abs(objective[0]), 1e-12)
        new = _once(look, y, kept, owner, slack, scale, question, reach * 0.3**k)
        moved = np.max(np.abs(new - y))
        y = new
        if moved < 1e-8:
            break
    return y


def _once(look, y, kept, owner, slack, scale, question, away):
    """Return SLSQP's solution subject to some rows of the requirements, relaxed by slacks if the question allows."""
    n, own = len(y), owner[kept]
    known = {}

    def at(x):
        key = x.tobytes()
        if key not in known:
            step = np.where(x[:n] > 0.5, -_DIFFERENCE, _DIFFERENCE)
            points = np.vstack([x[:n], x[:n] + np.diag(step), x[:n] + 2.0 * np.diag(step)])
            f, g = look(np.clip(points, 0.0, 1.0))
            f, g = np.nan_to_num(f / scale, posinf=1e6), np.nan_to_num(g[kept], posinf=1e6)
            slopes = [
                (4.0 * v[..., 1 : n + 1] - 3.0 * v[..., :1] - v[..., n + 1 :]) / (2.0 * step) for v in (f[None], g)
            ]
            known.clear()
            known[key] = f[0], g[:, 0], slopes[0][0], slopes[1]
        return known[key]

    low, high = np.maximum(y - away, 0.0), np.minimum(y + away, 1.0)
    options = {"ftol": 1e-13, "maxiter": 60}
    if question.giving is not None:
        # The requirements' slacks are further unknowns after the design's variables.
        spread = np.eye(len(slack))[own]
        ones = np.r_[np.zeros(n), np.ones(len(slack))]
        gives = np.isin(np.arange(len(slack)), question.giving)
        first = np.r_[y, np.where(gives, slack + 1e-9, 0.0)]
        low, high = np.r_[low, np.zeros(len(slack))], np.r_[high, np.where(gives, np.inf, 0.0)]
        objective, slope = (lambda x: ones @ x), (lambda _x: ones)
        gaps, gap_slopes = (
            (lambda x: x[n:][own] - at(x)[1] - 0.5 * MET * ~gives[own]),
            (lambda x: np.hstack([-at(x)[3], spread])),
        )
    else:
        first = y
        objective, slope = (lambda x: at(x)[0]), (lambda x: at(x)[2])
        gaps, gap_slopes = (lambda x: -at(x)[1] - 0.5 * MET), (lambda x: -at(x)[3])
    constraints = [{"type": "ineq", "fun": gaps, "jac": gap_slopes}] if len(kept) else []
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        done = minimize(
            objective, first, jac=slope, bounds=Bounds(low, high), constraints=constraints, method="SLSQP",
            options=options,
        )  # fmt: skip
    return np.clip(np.where(np.isfinite(done.x), done.x, first), low, high)[:n]


def finished(problem, y, question=_OBJECTIVE):
    """Return designs together with their polished versions, with fine steps and ever smaller reach."""
    everything = y
    for reach in (0.1, 0.02, 0.003):
        everything = np.vstack([everything, polished(problem, everything, question=question, reach=reach, phase=_FINE)])
    return everything


def optima(problem, seed=0, *, question=_OBJECTIVE, extra=(), thrifty=False):
    """Return distinct good designs that meet the necessary requirements, best first.

    Args:
        problem: the problem.
        seed: seed of sample and evolution.
        question: what is minimised.
        extra: further starts, positions.
        thrifty: whether to spend only a third of the time.
    """
    random = np.random.default_rng([seed, 7])
    effort = efforts(len(problem.variables), thrifty)
    y = sample(problem, effort[0], random)
    values = question.roughly(problem, y)
    islands = evolved(problem, question, y, values, random, effort)
    everything = np.vstack([y, islands, *[np.atleast_2d(x) for x in extra]])
    values = np.r_[values, question.roughly(problem, everything[len(y) :])]
    starts = spread_starts(everything, values, effort[4], 0.04)
    near = spread_starts(everything, values, effort[4] // 3, 0.004)
    ends = [
        polished(problem, np.vstack([starts, near]), question=question),
        polished(problem, near, question=question, reach=0.01),
    ]
    # The best designs of sample and evolution compete with the polished ones.
    everything = np.vstack([*ends, near, everything[np.argsort(values, kind="stable")[:50]]])
    values = question.worth(evaluate(problem, everything, phase=_GOOD))
    order = np.argsort(values, kind="stable")
    everything = np.vstack([finished(problem, everything[order[:6]], question), everything[order[:200]]])
    values = question.worth(evaluate(problem, everything, phase=_FINE))
    kept = []
    for k in np.argsort(values, kind="stable"):
        if values[k] < _BEYOND and all(np.max(np.abs(everything[k] - other.y)) > _SAME for other in kept):
            kept.append(Best(everything[k], float(values[k])))
    return kept


def truth_of(problem, seed=0, extra=()):
    """Return the truth of a problem as JSON data, or None if it is infeasible."""
    found = optima(problem, seed, extra=extra)
    if not found:
        return None
    best = found[0]
    near = [b for b in found if b.value <= best.value + 0.6 * abs(best.value)][:60]
    medians = [box_quartiles(problem, b.y, phase=_ROUGH)[1] for b in near]
    robust = int(np.argmin(medians))
    return {
        "objective": best.value,
        "design": list(map(float, problem.values(best.y)[0])),
        "median": medians[0],
        "needle": bool(medians[0] > best.value + 0.05 * abs(best.value)),
        "best_median": medians[robust],
        "best_median_design": list(map(float, problem.values(near[robust].y)[0])),
    }
