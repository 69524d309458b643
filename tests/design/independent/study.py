"""The study's problems with their truths, and the verdict on an answer."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from independent.problem import Problem, box_quartiles, evaluate, measure, sign_of

RELATIVE = 1e-6
"""Fraction of the objective, and of each limit, to which an answer must agree with the truth."""

# Relative uncertainty of a needle's median from 256 designs, which spread widely.
_OF_A_MEDIAN = 1e-2
# The package ranks optima by the medians of 64 designs. Two standard errors of the difference between two such medians
# are 2 sqrt(2) 1.25 sigma/8; sigma is the interquartile range divided by 1.35.
_OF_A_DIFFERENCE = 0.33


def problems(kind):
    """Return problems and truths of a kind, and the catalogues offered if it has any, by number."""
    data = json.loads(Path(__file__).with_name(f"{kind}_problems.json").read_text(encoding="utf-8"))
    others = ("truth", "catalogues") if kind == "catalogue" else ("truth",)
    return {int(k): (Problem.of_plain(v["problem"]), *(v[name] for name in others)) for k, v in data.items()}


@dataclass(frozen=True)
class Verdict:
    """The verdict on an answer.

    Attributes:
        right: whether it meets the requirements, and its objective or its median over the tolerance box is as good as
            the truth's.
        excess: relative excess of its objective over the truth's.
        median_excess: relative excess of its median over the truth's.
        violation: its largest violation as a fraction of the limit.
        tied: whether 64 designs cannot distinguish its median from the truth's, though it is not right. The package may
            then prefer it, but must find the truth if it judges by the bare objective.
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
        truth: as stored, see `problems`.
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


# Relative tolerance on the least sum of shortfalls; IPOPT stops within about 1e-8 of it.
_OF_A_SHORTFALL = 1e-5


def judge_shortfall(problem, truth, conflicts):
    """Return the verdict on whether the shortfalls stated in an error are the least possible.

    A smaller sum than the truth's is wrong, too: a design reaches the truth's, but the error gives no design to check.

    Args:
        problem: the problem.
        truth: the least sum of shortfalls, each as a fraction of its limit.
        conflicts: name of a requirement -> its shortfall, in the unit of its limit.
    """
    limits = {name_of(r): abs(r.limit) for r in problem.limits}
    excess = _excess(sum(short / limits[name] for name, short in conflicts.items()), truth["shortfall"])
    return Verdict(abs(excess) <= _OF_A_SHORTFALL, excess, np.nan, np.nan)


def name_of(limit):
    """Return the name of a requirement in a design."""
    return limit.measure.replace("_", " ")


POINTS = {2: 40, 3: 60}
"""Number of points requested of a front, by number of objectives."""

SPACING = 0.04
"""Largest gap at the end of a curve, as a fraction of the range; 40 evenly spaced points are 2.6 % apart."""

COVERED = 0.15
"""Largest distance of any part of a surface from the nearest point, as a fraction of the range."""

DOMINATED = 1e-3
"""Fraction of the range by which a returned design may be beaten: the error of the brute force itself."""


@dataclass(frozen=True)
class FrontVerdict:
    """Deviation of a front or surface from the one by brute force, as fractions of the latter's range.

    Attributes:
        missing: the largest amount by which a brute-force design is better than every returned one.
        uncovered: the largest distance of a brute-force design from the nearest returned one.
        dominated: the largest amount by which a returned design is worse than a brute-force design in all objectives.
        violation: the largest violation of a returned design as a fraction of the limit.
        not_reached: number of designs that the search saw beyond the front and reports as not reached.
        right: whether all of it is found: no end of a curve is missing by more than `SPACING`, no part of a surface is
            farther than `COVERED` from a point.
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
