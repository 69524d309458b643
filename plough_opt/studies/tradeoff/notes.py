"""Sentences on a front as a whole: how much its objectives conflict, and what it was held against."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from plough_opt.design.ipopt import Vector
from plough_opt.motion.judgement import remarks
from plough_opt.studies.tradeoff.certificate import FrontPoint
from plough_opt.studies.tradeoff.goal import Goal
from plough_opt.studies.tradeoff.program import FrontProgram
from plough_opt.studies.tradeoff.tracer import Tracer

# Relative ranges of all objectives below this are hardly a conflict, of one of them below the second too small to act
# on; below the third they are rounding.
_HARDLY, _SMALL, _ROUNDING = 0.02, 1e-3, 1e-8
_NUMBER = re.compile(r"[-+]?[0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?")


def notes_on(tracer: Tracer, goals: Sequence[Goal], points: Sequence[FrontPoint]) -> tuple[str, ...]:
    """Return sentences on objectives that hardly conflict, needles, points that are not optima, and the error."""
    front = tracer.front
    notes = []
    names = [f"'{goal.name}'" for goal in goals]
    listed = _listed(names)
    values = np.array([point.objectives for point in points])
    ranges = np.ptp(values, axis=0) / np.maximum(np.max(np.abs(values), axis=0), np.finfo(float).tiny)
    small = [k for k, change in enumerate(ranges) if change < _SMALL]
    if len(points) == 1:
        best = "both" if len(goals) == 2 else "all three"
        given_up = front.rounded_off
        within = f", to within {100.0 * given_up:.2g} %" if given_up > _ROUNDING else ""
        where = "" if tracer.searcher.vary else " in the basin of the guess"
        notes.append(f"{listed} do not conflict{where}: one design is best in {best}{within}")
    elif np.max(ranges) < _HARDLY:
        how = _listed([f"{100 * change:.2g} %" for change in ranges])
        notes.append(f"{listed} hardly conflict: along the whole front they change by {how}")
    elif small:
        for k in small:
            notes.append(
                f"{names[k]} hardly conflicts with the rest: along the whole front it changes by"
                f" {100 * ranges[k]:.2g} % of its value"
            )
    if tracer.needles_beyond:
        notes.append(
            f"{tracer.needles_beyond} designs beyond the front were seen that are needles: within their tolerances no"
            " workshop can hit them"
        )
    if any(point.needle for point in points):
        count = sum(point.needle for point in points)
        notes.append(f"{count} of {len(points)} designs are needles: within their tolerances no workshop can hit them")
    if unconfirmed := sum(not point.confirmed for point in points):
        notes.append(
            f"{unconfirmed} of {len(points)} designs are unconfirmed: simulated, and better than every optimum that"
            " was found and can be made, but not optima themselves"
        )
    wanted, gap = front.wanted_error, max((point.gap for point in points if point.confirmed), default=0.0)
    if wanted is not None and gap > wanted:
        notes.append(f"the wanted relative error {wanted:.1e} was not reached everywhere: the largest is {gap:.1e}")
    return tuple(notes)


def looked_at(tracer: Tracer) -> str:
    """Return what was looked at."""
    archive, vary = tracer.archive, tracer.searcher.vary
    if not vary:
        return "Only the basin of the guess was looked at: other branches, and better ends, may be missing."
    over = ", ".join(archive.front.program.declared.variables[k].name for k in vary)
    slow = "" if archive.vectorised else ", few because their runs are integrated one by one"
    return f"{archive.tried} designs tried over {over}{slow}."


def caveats(front: FrontProgram, designs: Sequence[Vector]) -> tuple[str, ...]:
    """Return the warnings that designs' scenes and runs carry, each kind once with the first design's numbers.

    Args:
        front: the program.
        designs: the efficient ones, in order, as scaled variables.
    """
    first, often = dict[str, str](), Counter[str]()
    for y in designs:
        texts = [text for run in front.runs(y) for text in (*run.scene.warnings(), *remarks(run))]
        texts += [text for scene in front.still_scenes(y) for text in scene.warnings()]
        kinds = {_NUMBER.sub("", text): text for text in texts}
        first = kinds | first
        often.update(kinds.keys())
    return tuple(f"at {often[kind]} of {len(designs)} designs: {text}" for kind, text in first.items())


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}"
