"""Surfaces of three objectives by brute force: a large sample, and more designs about its best ones."""

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
# Fronts of the study with a third objective, by number.
_OF_FRONTS = {8: (2, "mean_draft"), 9: (1, "displacement_rms")}
_POWER = 17
# Rounds of designs about the best ones, and how far from them.
_NEAR = (0.1, 0.03, 0.01, 0.003, 0.001, 0.1, 0.03, 0.01, 0.003, 0.001)
_IN_A_ROUND = 2**15
_ROUGH, _FINE = 1.6, 0.5
# Of a range: what is better than others by less is left out, for it stretches a surface along which nothing happens.
_BETTER = 5e-3
# Of a range: nor does a design stay that gives so much of one objective away to gain less than that in others. Those
# that are kept are sparse, and may all be worse than it by more, though one that was left out is as good.
_GIVEN_AWAY = 0.1
# Of a range: no best design is farther than this from one that is kept.
_COVERED = 0.03
# An objective that changes by less is none.
_LEAST_RANGE = 1e-2
# A sample with fewer designs that meet the requirements, and a surface of fewer, show no shape.
_FEWEST = 30
_NEEDLE = 0.05
# Ends of each objective alone.
_ENDS = 5


def undominated(objectives):
    """Return the numbers of the rows of three objectives that no other row dominates, equal rows once."""
    kept, second, third = [], [], []
    # The other two objectives of the rows before, which are as good in the first, make stairs.
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
    """Return the numbers of designs that no other beats, none better than another kept by less than a tolerance."""
    left = undominated(objectives)
    left = left[np.argsort(objectives[left].sum(axis=1), kind="stable")]
    kept = []
    while len(left):
        kept.append(left[0])
        left = left[np.any(objectives[left] < objectives[left[0]] - tolerance, axis=1)]
    return np.array(kept, dtype=int)


def surface(number):
    """Return a problem, three objectives that conflict in it, and designs of their surface, needles apart."""
    if number in _OF_FRONTS:
        of, third = _OF_FRONTS[number]
        problem, truth = study.problems("front")[of]
        return _described(number, problem, [*truth["names"], third], np.random.default_rng([number, 5]))
    triples = list(combinations(_NAMES, 3))

    def describe(problem, random):
        return _described(number, problem, triples[int(random.integers(len(triples)))], random)

    return draw_moving(number, _FIRST_SEED, (_FEWEST_VARIABLES, _MOST_VARIABLES), 5, describe)


def _described(number, problem, names, random):
    """Return a problem and its surface as plain data, or None where there is none."""
    found = _surface(problem, names, random)
    # A design has an objective of its own, which takes no part.
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
    # A radius is maximised by a negative weight.
    ends = [b.y for name in names for b in optima(replace(problem, objective={name: sign_of(name)}))[:_ENDS]]
    y, values = np.vstack([y, ends]), np.vstack([values, objectives_of(problem, names, np.array(ends))])
    for spread in _NEAR:
        best = undominated(values)
        # One for each small cube, so that no part of the surface has more than others.
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
    """Return the numbers of the best designs, needles apart, which beat none."""
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
    """Return which of the best designs gain little over another, no needle, that is much better in some objective."""
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
    """Return which designs are needles."""
    boxes = np.vstack([box_sample(problem, own, 64) for own in y])
    measures = measure(problem, boxes, _ROUGH)
    medians = [np.median(sign_of(name) * measures[name].reshape(len(y), 64), axis=1) for name in names]
    spread = np.nan_to_num(np.array(medians).T - values, nan=np.inf)
    return np.any(spread > _NEEDLE * np.maximum(np.abs(values), size), axis=1)


def _covering(places):
    """Return the numbers of rows from which no other is far, those of the least objectives among them."""
    chosen = [int(k) for k in np.argmin(places, axis=0)]
    apart = np.max(np.abs(places[:, None] - places[chosen][None]), axis=2).min(axis=1)
    while np.max(apart) > _COVERED:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(places - places[chosen[-1]]), axis=1))
    return sorted(set(chosen))
