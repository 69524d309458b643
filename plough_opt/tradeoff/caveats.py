"""What a reader of a front's numbers must know about the theory's limits at its designs."""

from __future__ import annotations

import re
from collections.abc import Sequence

from plough_opt.design.ipopt import Vector
from plough_opt.motion.simulation import repeat
from plough_opt.tradeoff.program import FrontProgram

_NUMBER = re.compile(r"[-+]?[0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?")


def caveats(front: FrontProgram, designs: Sequence[Vector]) -> tuple[str, ...]:
    """Return the warnings that designs' scenes and runs carry, each kind once with the first design's numbers.

    Args:
        front: the program.
        designs: scaled variables of the efficient designs, in order.
    """
    first: dict[str, str] = {}
    count: dict[str, int] = {}
    for y in designs:
        texts = dict.fromkeys(_of_design(front, y))
        kinds = {_NUMBER.sub("", text): text for text in texts}
        for kind, text in kinds.items():
            first.setdefault(kind, text)
            count[kind] = count.get(kind, 0) + 1
    return tuple(f"at {count[kind]} of {len(designs)} designs: {text}" for kind, text in first.items())


def _of_design(front: FrontProgram, y: Vector) -> list[str]:
    exact, numbers = front.program.exact, front.numbers(y)
    found: list[str] = []
    for k in range(len(exact.runs)):
        parameters, scene = exact.inputs(k, numbers)
        found += repeat(scene, float(parameters[-1])).warnings
    return [*found, *(text for scene in exact.quasi_static_scenes(numbers) for text in scene.warnings())]
