"""How thoroughly a design is searched."""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass

from plough_opt.core.checks import shown
from plough_opt.core.errors import InputError, nearest
from plough_opt.design.declarations import Variable

Search = str | int | Sequence[str]
"""Words, names of variables, a number of designs, or a text such as "20 s"."""

WORDS = ("auto", "thorough", "near", "local")
"""Words that `search` takes: the last means the same as the one before it."""

# By number of variables: designs of a sample, a power of two, and islands of the evolution that begins from it. One
# evolution in two to four misses the best basin of a problem of four and more variables, so there are several.
_DESIGNS = {1: 512, 2: 1024, 3: 2048, 4: 4096}
_MOST_DESIGNS = 8192
# Designs that a search may be asked to try: days of them.
_MOST_TRIED = 1_000_000_000
_ISLANDS = {1: 0, 2: 1, 3: 2}
_MOST_ISLANDS = 4
# Runs, of all designs of a round together, where a design has many: some seconds' worth.
_MOST_RUNS = 60_000
# Designs whose runs are integrated one by one, each for milliseconds: fewer where a design has several, but so many.
_ONE_BY_ONE, _FEWEST = 256, 32
_THOROUGH = 4
# Up to so many variables a sample is dense: of more, ripples that it does not show lead descents apart.
_FEW = 3
_SECONDS = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*s\s*")


@dataclass(frozen=True)
class Effort:
    """Rounds of a search, each a sample, an evolution and descents of their own.

    Attributes:
        designs: of each round's sample.
        islands: of each round's evolution.
        population: designs on an island.
        generations: of an evolution.
        descents: from the lowest designs of the sample.
        followed: further descents, from where designs drawn at random lead.
        dense: whether the sample shows the ways between its designs: then none is descended from that falls straight to
            an end of another descent, and there is no evolution where what was followed settles which basins there are.
        rounds: number of them, where neither of the following says.
        most_designs: after how many designs to stop, or None.
        seconds: after what time to stop, or None.
    """

    designs: int
    islands: int
    population: int
    generations: int
    descents: int
    followed: int
    dense: bool = False
    rounds: int = 1
    most_designs: int | None = None
    seconds: float | None = None

    def more(self, rounds: int, designs: int, began: float) -> bool:
        """Return whether another round is due, after so many rounds and designs, since a time."""
        if self.seconds is not None:
            return time.perf_counter() - began < self.seconds
        if self.most_designs is not None:
            return designs < self.most_designs
        return rounds < self.rounds


def effort_of(search: Search, dimensions: int, runs: int, vectorised: bool) -> Effort:
    """Return the effort that words ask for.

    Args:
        search: see `plough_opt.Design.solve`.
        dimensions: number of variables that are searched.
        runs: number of runs in a design.
        vectorised: whether they are followed side by side.
    """
    designs = min(_DESIGNS.get(dimensions, _MOST_DESIGNS), max(_ONE_BY_ONE, _MOST_RUNS // max(runs, 1)))
    designs = 1 << (designs.bit_length() - 1)  # Sobol points are even in numbers that are powers of two
    islands = _ISLANDS.get(dimensions, _MOST_ISLANDS) if designs * runs < _MOST_RUNS else 0
    if isinstance(search, int) and search < designs:
        # Less than a round: a sample alone, of a power of two.
        designs, islands = 1 << max(3, search.bit_length() - 1), 0
    many = dimensions > 3
    return Effort(
        designs=designs if vectorised else 1 << (max(_FEWEST, _ONE_BY_ONE // max(runs, 1)).bit_length() - 1),
        islands=islands if vectorised else 0,
        population=40 if many else 24,
        generations=60 if many else 30,
        descents=4 + 3 * dimensions,
        followed=4 + 2 * dimensions,
        dense=dimensions <= _FEW and search != "thorough",
        rounds=_THOROUGH if search == "thorough" else 1,
        most_designs=search if isinstance(search, int) else None,
        seconds=seconds_of(search),
    )


def seconds_of(search: Search) -> float | None:
    """Return the seconds that a text such as "20 s" asks for, or None for any other."""
    found = _SECONDS.fullmatch(search) if isinstance(search, str) else None
    return float(found[1]) if found else None


def searched(search: Search, variables: Sequence[Variable]) -> tuple[int, ...]:
    """Return the numbers of the variables to search; none where the guess's basin is asked for.

    Raises:
        InputError: a name that is not a variable, or an invalid effort.
    """
    names = [v.name for v in variables]
    every = tuple(range(len(names)))
    if isinstance(search, bool) or not isinstance(search, str | int | Sequence):
        raise InputError(f"search = {shown(search)} must be 'auto', 'thorough', 'near', a number of designs, a text"
                         " such as '20 s', or names of variables")  # fmt: skip
    if isinstance(search, int):
        if not 1 <= search <= _MOST_TRIED:
            raise InputError(f"search = {shown(search)} must be a number of designs, from 1 to {_MOST_TRIED}")
        return every
    if search in ("near", "local"):
        return ()
    if search in ("auto", "thorough") or seconds_of(search) is not None:
        return every
    wanted = [search] if isinstance(search, str) else list(search)
    for name in wanted:
        if name not in names:
            known = nearest(str(name), [*WORDS, *names])
            raise InputError(f"search = {shown(name)} is not a variable of this design: {known}")
    return tuple(names.index(name) for name in dict.fromkeys(wanted))
