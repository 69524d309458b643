"""Cost of a thorough search: how often it finds the best optimum of a design, against its time."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from plough_opt.core.errors import InfeasibleDesign, NotConverged
from plough_opt.design import Design, Optimum
from plough_opt.design.effort import Search

# From the basin of the guess to four times the default search.
_EFFORTS: Final[tuple[Search, ...]] = ("near", 250, 1000, "auto", "thorough")
# Seeds of the samples; a thin study takes fewer.
_SEEDS, _THIN_SEEDS = 8, 3
# Judged values that differ by less are of the same optimum: they are medians of rough runs.
_SAME = 1e-5


@dataclass(frozen=True)
class Thoroughness:
    """One effort.

    Attributes:
        search: as `plough_opt.Design.solve` takes it.
        designs: tried, the median over the seeds.
        asked: how many searches with seeds of their own were made.
        right: how many of them came to the best that any search of the study found.
        seconds: median time of one [s].
    """

    search: str
    designs: int
    asked: int
    right: int
    seconds: float


def thoroughness(
    design: Design, *, limit: float, thin: bool, progress: Callable[[str, float], None] | None = None
) -> tuple[Thoroughness, ...]:
    """Return what each effort finds of a design, and in what time.

    "Right" is the best that any of the searches found: there is no other truth of a design of one's own.

    Args:
        design: with something to minimise.
        limit: time of one search [s] above which an effort is tried with one seed only, and a larger one not at all.
        thin: take fewer seeds.
        progress: called with the present step in words, and the part done.

    Raises:
        InfeasibleDesign: no search found a design that meets the requirements.
    """
    design.solve(search="near")  # builds what all searches share
    found: list[tuple[Search, list[tuple[Optimum | None, float]]]] = []
    for number, search in enumerate(_EFFORTS):
        if progress is not None:
            progress(f"searching: {search}", number / len(_EFFORTS))
        seeds = range(1 if search == "near" else _THIN_SEEDS if thin else _SEEDS)
        runs = [_solved(design, search, 0)]
        if runs[0][1] <= limit:
            runs += [_solved(design, search, seed) for seed in seeds[1:]]
        found.append((search, runs))
        if runs[0][1] > limit:
            break
    best = min(_judged(one) for _, runs in found for one, _ in runs if one is not None)
    return tuple(_row(search, runs, best) for search, runs in found)


def _solved(design: Design, search: Search, seed: int) -> tuple[Optimum | None, float]:
    """Return what a search finds, or None, and its time [s]."""
    began = time.perf_counter()
    try:
        best = design.solve(search=search, seed=seed)
    except (InfeasibleDesign, NotConverged):
        return None, time.perf_counter() - began
    return best, time.perf_counter() - began


def _judged(best: Optimum) -> float:
    return best.objective if best.spread is None else best.spread.median


def _row(search: Search, runs: Sequence[tuple[Optimum | None, float]], best: float) -> Thoroughness:
    right = [one is not None and _judged(one) <= best + _SAME * abs(best) for one, _ in runs]
    tried = [one.search.designs for one, _ in runs if one is not None and one.search is not None]
    return Thoroughness(
        search=f"{search} designs" if isinstance(search, int) else str(search),
        designs=int(median(tried)) if tried else 0,
        asked=len(runs),
        right=sum(right),
        seconds=median(seconds for _, seconds in runs),
    )
