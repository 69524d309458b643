"""The best robust design: a search over all its variables, with widths of smoothing from its own results' spread."""

import dataclasses
from collections.abc import Callable, Mapping

from plough_opt.core.errors import InfeasibleDesign, NotConverged
from plough_opt.design import Design, LocalOptimum, Optimum, Progress
from plough_opt.studies.uncertainty.robust import Robust

Spreads = Mapping[str, float]
"""Standard deviations of results over the samples, by name."""

Build = Callable[[Mapping[str, float], Spreads], tuple[Design, Robust, frozenset[str]]]
"""Variables and spreads -> the robust design with these guesses, and the results whose spreads set widths."""

# Relative change of every spread below which the widths stay, and limit on the number of times they are set.
_SETTLED, _ROUNDS = 0.02, 6
# Part of the best objective within which other optima may become the best with widths of their own.
_CAN_WIN = 0.02
_SAME = 1e-3


def best_robust(
    start: Mapping[str, float], build: Build, spreads: Callable[[Mapping[str, float]], Spreads], progress: Progress
) -> tuple[Optimum, Robust, tuple[str, ...]]:
    """Return the best robust optimum with all local ones, its results, and the reasons why some have no own widths.

    The search uses the widths at a start. At each optimum they are set anew and it is solved again from there, until
    they stay.

    Args:
        start: variables by name, such as those of the nominal optimum.
        build: makes the robust design.
        spreads: variables -> the spreads of the results there.
        progress: called with the present step in words, and the part done.

    Raises:
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser found no optimum.
    """
    first = spreads(start)
    design, robust, follow = build(start, first)
    seen = design.solve(progress=progress)
    limit = seen.objective + _CAN_WIN * abs(seen.objective)
    candidates = [own for own in seen.local_optima if own.objective <= limit]
    found: list[tuple[Optimum, Robust]] = []
    failures = []
    for number, own in enumerate(candidates):
        progress("setting the widths of the best designs", number / len(candidates))
        try:
            known = (seen, robust) if own is seen.local_optima[0] else None
            found.append(_settled(own, known, build, spreads, {name: first[name] for name in follow}))
        except (InfeasibleDesign, NotConverged) as error:
            place = ", ".join(f"{name} = {value:.5g}" for name, value in own.variables.items())
            failures.append(f"with widths of its own, from {place}: {error}")
    if not found:
        found = [(seen, robust)]
    best, robust = min(found, key=lambda pair: pair[0].objective)
    local: list[LocalOptimum] = []
    every = [*(own.local_optima[0] for own, _ in found), *seen.local_optima[len(candidates) :]]
    for optimum in sorted(every, key=lambda one: one.objective):
        if not any(_same(optimum.variables, other.variables) for other in local):
            local.append(optimum)
    seconds = seen.seconds + sum(own.seconds for own, _ in found if own is not seen)
    best = dataclasses.replace(best, local_optima=tuple(local), search=seen.search, seconds=seconds)
    return best, robust, tuple(failures)


def _settled(
    own: LocalOptimum,
    known: tuple[Optimum, Robust] | None,
    build: Build,
    spreads: Callable[[Mapping[str, float]], Spreads],
    used: Spreads,
) -> tuple[Optimum, Robust]:
    """Return an optimum solved again until the widths that follow from spreads are those of its own.

    Args:
        own: the optimum.
        known: its solution, if there is one; it is kept if its widths are right.
        build: makes the robust design.
        spreads: variables -> the spreads of the results there.
        used: the spreads that set its widths.
    """
    at = own.variables
    for _ in range(_ROUNDS):
        now = spreads(at)
        if known is not None and all(abs(now[name] - used[name]) <= _SETTLED * used[name] for name in used):
            break
        design, robust, follow = build(at, now)
        known, used = (design.solve(search="near"), robust), {name: now[name] for name in follow}
        at = known[0].variables
    assert known is not None  # solved in the first round at the latest
    return known


def _same(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Return whether two designs are equal, to a small part of every variable."""
    return all(abs(x - other[name]) <= _SAME * abs(x) for name, x in one.items())
