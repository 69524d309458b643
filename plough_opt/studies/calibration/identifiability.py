"""Identifiability: which combinations of unknowns the data determine, from the Jacobian's singular values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from plough_opt.core.units import in_words
from plough_opt.studies.calibration.model import Unknown

Vector = NDArray[np.float64]

UNIFORM: Final = 12.0**-0.5
"""Standard deviation of a number that is known only to lie between 0 and 1: a uniform distribution."""

# Singular values below this part of the largest are rounding: the predictions do not depend on such directions.
_STRUCTURAL: Final = 1e-9
# Smaller components of a direction without effect (a unit vector) are rounding.
_ROUNDING: Final = 1e-6
# Smaller components of a combination with little effect, relative to its largest, are left out.
_MINOR: Final = 0.02


@dataclass(frozen=True)
class Undetermined:
    """A combination of unknowns along which predictions change by less than the scatter of the data, or not at all.

    Attributes:
        changes: unknown -> its change along the direction, SI, at the fit; the first is one per cent of its bounds.
        structural: whether the predictions do not change at all; otherwise the data are not accurate enough.
        words: a sentence about it.
    """

    changes: Mapping[str, float]
    structural: bool
    words: str


@dataclass(frozen=True)
class Spread:
    """How far the data determine the scaled unknowns.

    Attributes:
        covariance: covariance of the scaled unknowns (p, p); rows of undetermined ones are 0.
        determined: whether an unknown's variance is smaller than that from its bounds alone (p).
        free: undetermined directions of the scaled unknowns, as columns (p, d).
        structural: for each of these, whether the predictions do not depend on it at all (d).
        rank: number of directions that the predictions depend on.
    """

    covariance: Vector
    determined: NDArray[np.bool_]
    free: Vector
    structural: NDArray[np.bool_]
    rank: int


def spread_of(slope: Vector, noise: float) -> Spread:
    """Return how far data determine scaled unknowns.

    Args:
        slope: Jacobian of the weighted residuals by the unknowns (n, p).
        noise: standard deviation of a weighted residual.
    """
    count = slope.shape[1]
    _, sizes, right = np.linalg.svd(slope, full_matrices=True)
    sizes = np.concatenate([sizes, np.zeros(max(0, count - len(sizes)))])
    directions = right.T
    structural = sizes <= _STRUCTURAL * max(float(sizes[0]), np.finfo(float).tiny)
    deviation = np.full(count, np.inf)
    deviation[~structural] = noise / sizes[~structural]
    undetermined_directions = deviation >= UNIFORM
    parts = np.where(np.abs(directions) > np.where(structural, _ROUNDING, 0.0), directions, 0.0)
    with np.errstate(invalid="ignore"):
        variance = np.where(parts != 0.0, parts**2 * deviation**2, 0.0).sum(axis=1)
    determined = variance < UNIFORM**2
    finite = np.where(np.isfinite(deviation), deviation, 0.0)
    covariance = (directions * finite**2) @ directions.T
    known = determined.astype(float)
    return Spread(
        covariance=covariance * np.outer(known, known),
        determined=determined,
        free=directions[:, undetermined_directions],
        structural=structural[undetermined_directions],
        rank=int(np.sum(~structural)),
    )


def undetermined(unknowns: Sequence[Unknown], y: Vector, spread: Spread) -> tuple[Undetermined, ...]:
    """Return the undetermined combinations, each of as few unknowns as possible."""
    without_effect, pivots = _sparse(spread.free[:, spread.structural], _ROUNDING)
    # Directions without effect may be subtracted from those with little effect, which leaves fewer unknowns in these.
    weak = spread.free[:, ~spread.structural]
    weak, _ = _sparse(weak - without_effect @ weak[pivots, :], _MINOR)
    combinations = [_combination(unknowns, y, direction, structural=True) for direction in without_effect.T]
    combinations += [_combination(unknowns, y, direction, structural=False) for direction in weak.T]
    # An unknown may be undetermined by a component that was left out: name it alone.
    named = {name for item in combinations for name in item.changes}
    for k, unknown in enumerate(unknowns):
        if not spread.determined[k] and unknown.name not in named:
            alone = np.zeros(len(unknowns))
            alone[k] = 1.0
            combinations.append(_combination(unknowns, y, alone, structural=False))
    return tuple(combinations)


def _sparse(free: Vector, least: float) -> tuple[Vector, NDArray[np.intp]]:
    """Return a basis of the same space, and its pivots: each basis vector is the only one with its pivot unknown.

    Components of a basis vector below ``least``, relative to its largest, are set to 0.
    """
    if free.shape[1] == 0:
        return free, np.zeros(0, dtype=np.intp)
    _, _, order = linalg.qr(free.T, pivoting=True, mode="economic")
    pivots = order[: free.shape[1]]
    basis = np.linalg.solve(free[pivots, :].T, free.T).T
    return np.where(np.abs(basis) > least * np.max(np.abs(basis), axis=0), basis, 0.0), pivots


def _combination(unknowns: Sequence[Unknown], y: Vector, direction: Vector, structural: bool) -> Undetermined:
    """Return a direction as a combination: changes of the unknowns in SI units, and a sentence."""
    order = np.argsort(-np.abs(direction), kind="stable")
    members = [k for k in order if direction[k] != 0.0]
    size = 0.01 / direction[members[0]]
    changes = {unknowns[k].name: float(size * direction[k] * unknowns[k].slope(float(y[k]))) for k in members}
    return Undetermined(changes, structural, _words([unknowns[k] for k in members], changes, structural))


def _words(members: Sequence[Unknown], changes: Mapping[str, float], structural: bool) -> str:
    """Return the sentence about a combination."""
    names = [unknown.name for unknown in members]
    if len(names) == 1:
        if structural:
            return f"{names[0]} has no effect on the measured results: the data do not determine it"
        return f"{names[0]} is hardly determined: the data do not narrow it further than its bounds"
    first = changes[names[0]]
    moves = ", ".join(f"{_size(u, changes)} {'less' if changes[u.name] * first < 0.0 else 'more'} {u.name}"
                      for u in members[1:])  # fmt: skip
    apart = "cannot be told apart" if structural else "can hardly be told apart, with this scatter"
    sentence = f"{_list(names)} {apart}: {_size(members[0], changes)} more {names[0]} can be offset by {moves}"
    if len(names) == 2:
        ratio = -first / changes[names[1]]
        units = [f" [{u.unit}]" if u.unit else "" for u in members]
        sign = "+" if ratio > 0.0 else "-"
        held = f"{names[0]}{units[0]} {sign} {abs(ratio):.4g} x {names[1]}{units[1]}"
        sentence += f"; near the fit the data determine {held}, and neither alone"
    return sentence


def _size(unknown: Unknown, changes: Mapping[str, float]) -> str:
    return in_words(abs(changes[unknown.name]), unknown.unit, 3)


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
