"""Surfaces of three objectives by brute force: a large sample, and more designs around its best ones."""

from bisect import bisect_right
from dataclasses import replace
from itertools import combinations

import numpy as np

from independent import study
from independent.fronts import objectives_of
from independent.generate import draw_moving
from independent.problem import box_sample, measure, sign_of
from independent.truth import optima, sample

_FIRST_SEED = 700_000
_FEWEST_VARIABLES, _MOST_VARIABLES = 2, 4
_NAMES = ("mean_draft", "force_rms", "displacement_rms", "mean_deflection", "tow_power", "loosened radius")
# By number of the surface: the number of a front of the study, and the third objective added to it.
_OF_FRONTS = {8: (2, "mean_draft"), 9: (1, "displacement_rms")}
_POWER = 17
# Standard deviations of the designs drawn around the best ones, one for each round.
_NEAR = (0.1, 0.03, 0.01, 0.003, 0.001, 0.1, 0.03, 0.01, 0.003, 0.001)
_IN_A_ROUND = 2**15
_ROUGH, _FINE = 1.6, 0.5
# A design that is better than another by a smaller fraction of the range is left out: such designs would extend the
# surface into regions without any gain.
_BETTER = 5e-3
# A design is also left out if it gives up this fraction of one objective to gain less than _BETTER in the others. This
# is checked against all undominated designs, because the remaining ones are sparse.
_GIVEN_AWAY = 0.1
# Largest distance of any best design from the nearest stored one, as a fraction of the range.
_COVERED = 0.03
# An objective that changes by a smaller fraction counts as constant.
_LEAST_RANGE = 1e-2
# Fewest feasible designs in a sample, and fewest designs of a surface.
_FEWEST = 30
_NEEDLE = 0.05
# Best designs of each single objective that are added.
_ENDS = 5


def undominated(objectives):
    """Return the numbers of the undominated rows of three objectives, equal rows once."""
    kept, second, third = [], [], []
    # The rows so far are at least as good in the first objective; in the other two they form a staircase.
    for k in np.lexsort(objectives.T[::-1]):
        _, b, c = objectives[k]
        at = bisect_right(second, b)
        if not np.isfinite(c) or (at and third[at - 1] <= c):
            continue
        kept.append(k)
        last = at
        while last < len(third) and third[last] >= c:
            last += 1
        second[at:last], third[at:last] = [b], [c]
    return np.array(kept, dtype=int)


def best_of(objectives, tolerance):
    """Return the numbers of undominated designs, thinned out: each beats the others somewhere by a tolerance."""
    left = undominated(objectives)
    left = left[np.argsort(objectives[left].sum(axis=1), kind="stable")]
    kept = []
    while len(left):
        kept.append(left[0])
        left = left[np.any(objectives[left] < objectives[left[0]] - tolerance, axis=1)]
    return np.array(kept, dtype=int)


def surface(number):
    """Return a problem, three conflicting objectives, and designs on their surface, without needles."""
    if number in _OF_FRONTS:
        of, third = _OF_FRONTS[number]
        problem, truth = study.problems("front")[of]
        return _described(number, problem, [*truth["names"], third], np.random.default_rng([number, 5]))
    triples = list(combinations(_NAMES, 3))

    def describe(problem, random):
        return _described(number, problem, triples[int(random.integers(len(triples)))], random)

    return draw_moving(number, _FIRST_SEED, (_FEWEST_VARIABLES, _MOST_VARIABLES), 5, describe)


def _described(number, problem, names, random):
    """Return a problem and its surface as JSON data, or None if there is no surface."""
    found = _surface(problem, names, random)
    # `Problem` needs an objective, which is not used.
    plain = replace(problem, name=f"surface {number}", objective={names[0]: 1.0}).plain()
    return found and {"problem": plain, "truth": {"names": names, **found}}


def _surface(problem, names, random):
    y = sample(problem, _POWER, random)
    values = objectives_of(problem, names, y)
    sound = np.flatnonzero(np.all(np.isfinite(values), axis=1))
    if len(sound) < _FEWEST or np.any(np.ptp(values[sound], axis=0) == 0.0):
        return None
    size = np.ptp(values[sound[best_of(values[sound] / np.ptp(values[sound], axis=0), _BETTER)]], axis=0)
    if np.any(size < _LEAST_RANGE * np.abs(values[sound]).min(axis=0)):
        return None
    # A negative weight maximises the radius.
    ends = [b.y for name in names for b in optima(replace(problem, objective={name: sign_of(name)}))[:_ENDS]]
    y, values = np.vstack([y, ends]), np.vstack([values, objectives_of(problem, names, np.array(ends))])
    for spread in _NEAR:
        best = undominated(values)
        # One from each small cube, so that all parts of the surface are equally dense.
        _, one = np.unique(np.floor(values[best] / (0.2 * _BETTER * size)), axis=0, return_index=True)
        best = y[best[one]]
        more = best[random.integers(len(best), size=_IN_A_ROUND)]
        more = np.clip(more + spread * random.standard_normal(more.shape), 0.0, 1.0)
        y, values = np.vstack([y, more]), np.vstack([values, objectives_of(problem, names, more)])
    broad = _broad(problem, names, y, values, size)
    if broad is None:
        return None
    y, values = y[broad], objectives_of(problem, names, y[broad], _FINE)
    kept = np.all(np.isfinite(values), axis=1)
    y, values = y[kept], values[kept]
    size = np.ptp(values, axis=0)
    if len(y) < _FEWEST or np.any(size < _LEAST_RANGE * np.abs(values).max(axis=0)):
        return None
    chosen = _covering(values / size)
    return {
        "range": [float(f"{x:.7g}") for x in size],
        "objectives": [[float(f"{x:.7g}") for x in row] for row in values[chosen]],
    }


def _broad(problem, names, y, values, size):
    """Return the numbers of the best designs, without needles."""
    left = np.flatnonzero(np.all(np.isfinite(values), axis=1))
    known = {}
    while len(left):
        best = left[best_of(values[left] / size, _BETTER)]
        new = np.array([k for k in best if k not in known], dtype=int)
        if not len(new):
            return best[~_gains_little(problem, names, y, values, size, left, best)]
        known |= dict.fromkeys(new)
        left = np.setdiff1d(left, new[_needles(problem, names, y[new], values[new], size)])
    return None


def _gains_little(problem, names, y, values, size, left, best):
    """Return which best designs gain little over another, not a needle, that is much better in some objective."""
    found = np.zeros(len(best), dtype=bool)
    others = left[undominated(values[left])]
    for j, k in enumerate(best):
        behind = (values[others] - values[k]) / size
        losses = np.where(behind.min(axis=1) < -_GIVEN_AWAY, behind.max(axis=1), np.inf)
        other = others[[np.argmin(losses)]]
        if np.min(losses) < _BETTER:
            found[j] = not _needles(problem, names, y[other], values[other], size)[0]
    return found


def _needles(problem, names, y, values, size):
    """Return whether each design is a needle."""
    boxes = np.vstack([box_sample(problem, own, 64) for own in y])
    measures = measure(problem, boxes, _ROUGH)
    medians = [np.median(sign_of(name) * measures[name].reshape(len(y), 64), axis=1) for name in names]
    spread = np.nan_to_num(np.array(medians).T - values, nan=np.inf)
    return np.any(spread > _NEEDLE * np.maximum(np.abs(values), size), axis=1)


def _covering(places):
    """Return the numbers of rows that cover all others, with the minimum of each objective."""
    chosen = [int(k) for k in np.argmin(places, axis=0)]
    apart = np.max(np.abs(places[:, None] - places[chosen][None]), axis=2).min(axis=1)
    while np.max(apart) > _COVERED:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(places - places[chosen[-1]]), axis=1))
    return sorted(set(chosen))
