"""Warnings about the theory's limits at the designs of a front."""

from __future__ import annotations

import re
from collections.abc import Sequence

from plough_opt.motion.scene import Scene
from plough_opt.motion.simulation import repeat

_NUMBER = re.compile(r"[-+]?[0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?")
# Designs in a row of which both ends must be simulated: where these carry the same warnings, so do those between.
_ROW = 8


def caveats(moving: Sequence[Sequence[tuple[Scene, float]]], still: Sequence[Sequence[Scene]]) -> tuple[str, ...]:
    """Return the warnings that designs' scenes and runs carry, each kind once with the first design's numbers.

    Args:
        moving: of each efficient design, in order, the scenes of its runs and how long each runs [s].
        still: of each, the scenes that are not integrated.
    """
    count = len(moving)
    texts = [dict.fromkeys(text for scene in own for text in scene.warnings()) for own in still]
    first, often = dict[str, str](), dict[str, int]()
    for quiet, of_runs in zip(texts, _of_runs(moving), strict=True):
        for kind, text in {_NUMBER.sub("", text): text for text in (*of_runs, *quiet)}.items():
            first.setdefault(kind, text)
            often[kind] = often.get(kind, 0) + 1
    return tuple(f"at {often[kind]} of {count} designs: {text}" for kind, text in first.items())


def _of_runs(moving: Sequence[Sequence[tuple[Scene, float]]]) -> list[dict[str, None]]:
    """Return the warnings of each design's runs, those between two like neighbours as theirs."""
    found: dict[int, dict[str, None]] = {}

    def kinds(k: int) -> set[str]:
        if k not in found:
            runs = (repeat(scene, duration) for scene, duration in moving[k])
            found[k] = dict.fromkeys(text for run in runs for text in run.warnings)
        return {_NUMBER.sub("", text) for text in found[k]}

    def fill(a: int, b: int) -> None:
        if b - a < 2:
            return
        if b - a <= _ROW and kinds(a) == kinds(b):
            for k in range(a + 1, b):
                found.setdefault(k, found[a])
            return
        middle = (a + b) // 2
        kinds(middle)
        fill(a, middle)
        fill(middle, b)

    last = len(moving) - 1
    kinds(0)
    kinds(last)
    fill(0, last)
    return [found[k] for k in range(len(moving))]
