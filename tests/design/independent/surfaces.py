"""Surfaces of three objectives by brute force: a large sample, and more designs about its best ones."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from independent import fast, study
from independent.fronts import objectives_of
from independent.generate import draw
from independent.problem import PATHS, box_sample, measure, sign_of
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
# Of a range: no best design is farther than this from one that is kept.
_COVERED = 0.03
# An objective that changes by less is none.
_LEAST_RANGE = 1e-2
# A sample with fewer designs that meet the requirements, and a surface of fewer, show no shape.
_FEWEST = 30
_NEEDLE = 0.05
# Ends of each objective alone.
_ENDS = 5


def best_of(objectives, tolerance):
    """Return the numbers of designs that no other beats, none better than another kept by less than a tolerance."""
    left = np.flatnonzero(np.all(np.isfinite(objectives), axis=1))
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
    for attempt in range(1000):
        seed = _FIRST_SEED + 1000 * number + attempt
        problem = draw(seed, fast.simulate)
        still = problem.start == "equilibrium" and problem.wave is None
        count = len(problem.variables)
        if (
            still
            or not _FEWEST_VARIABLES <= count <= _MOST_VARIABLES
            or any(r.measure in PATHS for r in problem.limits)
        ):
            continue
        random = np.random.default_rng([seed, 5])
        triples = list(combinations(_NAMES, 3))
        names = triples[int(random.integers(len(triples)))]
        described = _described(number, problem, names, random)
        if described is not None:
            return described
    raise AssertionError(f"number {number} draws no surface")


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
        best = y[best_of(values / size, 0.2 * _BETTER)]
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
        new = [k for k in best if k not in known]
        if not new:
            return best
        boxes = np.vstack([box_sample(problem, y[k], 64) for k in new])
        measures = measure(problem, boxes, fast.simulate, _ROUGH)
        medians = [np.median(sign_of(name) * measures[name].reshape(len(new), 64), axis=1) for name in names]
        spread = np.nan_to_num(np.array(medians).T - values[new], nan=np.inf)
        needles = np.any(spread > _NEEDLE * np.maximum(np.abs(values[new]), size), axis=1)
        known |= dict.fromkeys(new)
        left = np.setdiff1d(left, np.array(new)[needles])
    return None


def _covering(places):
    """Return the numbers of rows from which no other is far, those of the least objectives among them."""
    chosen = [int(k) for k in np.argmin(places, axis=0)]
    apart = np.max(np.abs(places[:, None] - places[chosen][None]), axis=2).min(axis=1)
    while np.max(apart) > _COVERED:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.max(np.abs(places - places[chosen[-1]]), axis=1))
    return sorted(set(chosen))
