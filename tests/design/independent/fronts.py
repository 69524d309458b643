"""Fronts of two objectives by brute force: a large sample, and more designs around its best ones."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from independent.generate import draw_moving
from independent.problem import box_sample, evaluate, measure, sign_of
from independent.truth import MET, optima, sample

_FIRST_SEED = 90_000
_MOST_VARIABLES = 4
_POWER = 18
# Standard deviations of the designs drawn around the undominated ones, one for each round.
_NEAR = (0.1, 0.03, 0.01, 0.003, 0.001)
_IN_A_ROUND = 2**14
_ROUGH = 1.6
_KEPT = 40
# A front on which an objective changes by a smaller fraction is a point.
_LEAST_RANGE = 1e-2
_NEEDLE = 0.05


def undominated(objectives):
    """Return the numbers of the undominated rows of two objectives, sorted by the first objective."""
    order = np.lexsort((objectives[:, 1], objectives[:, 0]))
    second = objectives[order, 1]
    best = np.concatenate([[np.inf], np.minimum.accumulate(second)[:-1]])
    return order[(second < best) & np.isfinite(second)]


def objectives_of(problem, names, y, phase=_ROUGH):
    """Return the objectives of designs, a row each, all to be minimised; infinite if a requirement is violated."""
    measures = measure(problem, y, phase)
    found = evaluate(problem, y, phase=phase)
    values = np.array([sign_of(name) * measures[name] for name in names]).T
    values[~(found.worst <= MET) | ~np.all(np.isfinite(values), axis=1)] = np.inf
    return values


def front(number):
    """Return a problem, two conflicting objectives, and designs on their front, without needles."""
    pairs = list(combinations(("mean_draft", "force_rms", "displacement_rms", "mean_deflection"), 2))

    def describe(problem, random):
        names = pairs[int(random.integers(len(pairs)))]
        found = _front(problem, names, random)
        plain = replace(problem, name=f"front {number}", objective=dict.fromkeys(names, 1.0)).plain()
        return found and {"problem": plain, "truth": {"names": names, **found}}

    return draw_moving(number, _FIRST_SEED, (2, _MOST_VARIABLES), 4, describe)


def _front(problem, names, random):
    ends = [b.y for name in names for b in optima(replace(problem, objective={name: 1.0}))[:10]]
    y = np.vstack([sample(problem, _POWER, random), ends])
    values = objectives_of(problem, names, y)
    for spread in _NEAR:
        best = y[undominated(values)]
        more = best[random.integers(len(best), size=_IN_A_ROUND)]
        more = np.clip(more + spread * random.standard_normal(more.shape), 0.0, 1.0)
        y, values = np.vstack([y, more]), np.vstack([values, objectives_of(problem, names, more)])
    broad = _broad(problem, names, y, values)
    if broad is None:
        return None
    y, values = y[broad], values[broad]
    values = objectives_of(problem, names, y, 0.5)
    kept = np.isfinite(values[:, 0])
    y, values = y[kept], values[kept]
    low, high = values.min(axis=0), values.max(axis=0)
    if len(y) < 5 or np.any(high - low < _LEAST_RANGE * np.abs(high)):
        return None
    chosen = _thinned((values - low) / (high - low))
    return {
        "objectives": [[float(f"{x:.10g}") for x in row] for row in values[chosen]],
        "designs": [[float(f"{x:.8g}") for x in row] for row in problem.values(y[chosen])],
    }


def _broad(problem, names, y, values):
    """Return the numbers of the designs that only needles dominate."""
    left = np.isfinite(values[:, 0])
    known = {}
    for _ in range(30):
        numbers = np.flatnonzero(left)
        if not len(numbers):
            return None
        best = numbers[undominated(values[numbers])]
        new = [k for k in best if k not in known]
        if not new:
            return best
        boxes = np.vstack([box_sample(problem, y[k], 64) for k in new])
        measures = measure(problem, boxes, _ROUGH)
        medians = np.array([np.median(measures[name].reshape(len(new), 64), axis=1) for name in names]).T
        needles = np.any(medians > (1.0 + _NEEDLE) * values[new], axis=1)
        known |= dict.fromkeys(new)
        left[np.array(new)[needles]] = False
    return None


def _thinned(places):
    """Return the numbers of at most _KEPT points, evenly spaced along the front, with both ends."""
    along = np.concatenate([[0.0], np.cumsum(np.max(np.abs(np.diff(places, axis=0)), axis=1))])
    wanted = np.linspace(0.0, along[-1], _KEPT)
    return np.unique([int(np.argmin(np.abs(along - x))) for x in wanted])
