"""The problems of the study with their truth, and whether an answer is right."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from independent.problem import Problem, box_quartiles, evaluate, measure, sign_of

RELATIVE = 1e-6
"""Part of the objective, and of each limit, to which an answer must agree with the truth."""

# Of a needle, whose box spreads widely, the median of 256 designs is known to a part of itself.
_OF_A_MEDIAN = 1e-2
# The package ranks optima by the medians of 64 designs of each box. Two standard errors of the difference between two
# such medians are 2 sqrt(2) 1.25 sigma/8, and sigma is the quartiles' distance over 1.35.
_OF_A_DIFFERENCE = 0.33


def path_of(kind):
    """Return the file of a kind of problems."""
    return Path(__file__).with_name(f"{kind}_problems.json")


def read_lines(path):
    """Return the lines of a file of problems, by number."""
    data = json.loads(path.read_text(encoding="utf-8"))
    return {int(k): json.dumps(v, separators=(",", ":")) for k, v in data.items()}


def problems(kind):
    """Return problems and truths of a kind, by number."""
    data = json.loads(path_of(kind).read_text(encoding="utf-8"))
    return {int(k): (Problem.of_plain(v["problem"]), v["truth"]) for k, v in data.items()}


@dataclass(frozen=True)
class Verdict:
    """Whether an answer is right.

    Attributes:
        right: whether it meets the requirements and is as good as the truth, or over its tolerance box where that is
            what counts.
        excess: its objective's relative excess over the truth.
        median_excess: the excess of its median over the tolerance box, relative to the truth's.
        violation: the largest of its violations, in parts of the limits.
        tied: whether its median over the tolerance box is as good as 64 designs can tell, though it is not right: then
            the package may prefer it, and must find the truth when it judges by the bare objective.
    """

    right: bool
    excess: float
    median_excess: float
    violation: float
    tied: bool = False


def judge(problem, truth, variables):
    """Return the verdict on a design.

    Args:
        problem: the problem.
        truth: what `truth.truth_of` found.
        variables: the answer's variables by name.
    """
    y = problem.positions([[variables[v.name] for v in problem.variables]])
    found = evaluate(problem, y)
    excess = _excess(found.objective[0], truth["objective"])
    violation = float(found.worst[0])
    met = violation <= RELATIVE
    if met and excess <= RELATIVE and not truth["needle"]:
        return Verdict(True, excess, np.nan, violation)
    low, median, high = box_quartiles(problem, y, phase=1.3)
    spread = high - low
    wanted = truth["best_median"] * (1.0 + _OF_A_MEDIAN) if truth["needle"] else truth["median"]
    median_excess = _excess(median, wanted)
    right = met and (excess <= RELATIVE or median_excess <= RELATIVE)
    tied = met and not right and not truth["needle"] and median - wanted <= _OF_A_DIFFERENCE * spread
    return Verdict(right, excess, median_excess, violation, tied)


def _excess(value, wanted):
    return float((value - wanted) / abs(wanted))


# IPOPT stops within some 1e-8 of the least sum.
_OF_A_SHORTFALL = 1e-5


def judge_shortfall(problem, truth, conflicts):
    """Return the verdict on the shortfalls that a refusal states, in the limits' own units: whether they are the least.

    A smaller sum than the truth's is no better answer: the truth is a design, and what is stated is none that can be
    evaluated.

    Args:
        problem: the problem.
        truth: the least sum of shortfalls, each in parts of its limit.
        conflicts: name of a requirement -> its shortfall.
    """
    limits = {name_of(r): abs(r.limit) for r in problem.limits}
    excess = _excess(sum(short / limits[name] for name, short in conflicts.items()), truth["shortfall"])
    return Verdict(abs(excess) <= _OF_A_SHORTFALL, excess, np.nan, np.nan)


def name_of(limit):
    """Return what a requirement is called in a design."""
    return limit.measure.replace("_", " ")


POINTS = {2: 40, 3: 60}
"""Positions that a front is asked for, by number of its objectives."""

SPACING = 0.04
"""Of a range: between neighbours of so many points of a curve lie 2.6 %, if they are evenly spread."""

COVERED = 0.15
"""Of a range: from no part of a surface is the nearest point farther."""

DOMINATED = 1e-3
"""Of a range: by so much no returned design may be beaten. The brute force lags behind the true front by as much."""


@dataclass(frozen=True)
class FrontVerdict:
    """How far a front or a surface is from the one by brute force, in parts of the range of that.

    Attributes:
        missing: by how much the worst-off design of the brute force is better than every returned one.
        uncovered: the largest distance of a design of the brute force from the nearest returned one.
        dominated: by how much the worst returned design is worse, in all objectives, than one of the brute force.
        violation: the largest violation of a returned design, in parts of the limits.
        not_reached: designs that the search saw beyond the front, and that it says it has not reached.
        right: whether all of it is found: of a curve no end is missing by more than the spacing of its points, of a
            surface no part is farther than `COVERED` from a point.
    """

    missing: float
    uncovered: float
    dominated: float
    violation: float
    not_reached: int
    right: bool


def judge_front(problem, truth, front):
    """Return the verdict on a front of two or three objectives."""
    wanted = np.array(truth["objectives"])
    size = np.array(truth["range"]) if "range" in truth else np.ptp(wanted, axis=0)
    y = problem.positions([[point.variables[v.name] for v in problem.variables] for point in front.points])
    measures = measure(problem, y)
    found = np.array([sign_of(name) * measures[name] for name in truth["names"]]).T
    behind = (found[:, None, :] - wanted[None, :, :]) / size
    missing = float(np.max(np.min(np.max(behind, axis=2), axis=0)))
    uncovered = float(np.max(np.min(np.max(np.abs(behind), axis=2), axis=0)))
    dominated = float(np.max(np.min(behind, axis=2)))
    violation = float(np.max(evaluate(problem, y).worst))
    not_reached = sum(failure.reason.startswith("Not_Reached") for failure in front.failures)
    whole = missing <= SPACING if len(size) == 2 else uncovered <= COVERED
    right = whole and dominated <= DOMINATED and violation <= RELATIVE and not not_reached
    return FrontVerdict(missing, uncovered, dominated, violation, not_reached, right)
