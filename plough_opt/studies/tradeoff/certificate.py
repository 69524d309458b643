"""Certificates: what a front's points are, and how far each can be trusted."""

from dataclasses import dataclass

import numpy as np

from plough_opt.design.optimality import PULLS, decides
from plough_opt.studies.tradeoff.candidates import Candidate
from plough_opt.studies.tradeoff.program import FrontProgram

# Scaled by objective and limits: with larger residuals a point is not an optimum, with larger violations not a design.
_RESIDUAL = 1e-6
_VIOLATED = 1e-6
# Relative curvatures above are none, or the rounding of none.
_BENDS_DOWN = -1e-6


@dataclass(frozen=True)
class FrontPoint:
    """A design on the front, or one that others dominate: a local optimum of the one objective beside the other.

    Attributes:
        objectives: all, by the tightly integrated model, in their units.
        variables: name -> value, SI units.
        margins: name of each requirement -> distance of its worst value from its limit, positive inside, in its unit.
        active: names of the requirements and variables whose limits decide the design.
        rate: of two objectives, change of the second per change of the first along the front, in their units; None of
            a design that stands alone or is not on the front.
        branch: of a design on the front, under a strength wave, "soft" or "stiff", by the natural frequency beside the
            wave's; else "".
        residual: of the first-order conditions, scaled.
        violation: largest violation of a requirement by the tightly integrated model, relative to its limit.
        gap: largest relative difference of the optimiser's objectives from the tightly integrated ones.
        curvature: least one of the Lagrangian where limits leave a direction, relative to the largest and roughly
            integrated; None where they leave none, and of a design that others dominate.
        weights: of the objectives per their units, by the multipliers: along the front changes so weighted add up to
            nothing. None of a design that stands alone.
        medians: of each objective over the design's tolerances, as a search integrates; None where runs are integrated
            one by one, which takes too long.
        needle: whether the median of some objective is worse than its own by more than 5 % of it and of its range over
            the front: no workshop can hit such a design.
        confirmed: whether it is certified as a local optimum; False of a design that is simulated and meets all
            requirements, and beside which the optimiser found no optimum that can be made.
    """

    objectives: tuple[float, ...]
    variables: dict[str, float]
    margins: dict[str, float]
    active: tuple[str, ...]
    rate: float | None
    branch: str
    residual: float
    violation: float
    gap: float
    curvature: float | None = None
    weights: tuple[float, ...] | None = None
    medians: tuple[float, ...] | None = None
    needle: bool = False
    confirmed: bool = True

    @property
    def doubt(self) -> str:
        """Why this does not belong to a front; empty where it does."""
        if self.confirmed and not self.residual <= _RESIDUAL:
            return f"the first-order conditions are met to {self.residual:.1e} only"
        if self.confirmed and self.curvature is not None and not self.curvature >= _BENDS_DOWN:
            return f"it is not a minimum: in a direction that no limit holds the curvature is {self.curvature:.1e}"
        if not self.violation <= _VIOLATED:
            return f"integrated tightly it violates a requirement by a relative {self.violation:.1e}"
        return ""


def certify(front: FrontProgram, one: Candidate, *, beaten: bool = False) -> FrontPoint:
    """Return a candidate's report from the tightly integrated model.

    Args:
        front: the program.
        one: the candidate.
        beaten: whether it is not on the front, so that its curvature and branch are not asked for.
    """
    program, point, level = front.program, one.point, front.level(one.exact)
    scaled, found = front.tight(point.y)
    margins, violation, active = {}, 0.0, []
    own_requirements = program.declared.requirements[:-1]  # the last one is the position on the front
    for k, (r, value) in enumerate(zip(own_requirements, found[:-1], strict=True)):
        margin = r.margin(value.ravel())
        pull = float(np.max(np.abs(point.lam_g[np.array(program.owner) == k])))
        margins[r.name] = margin
        violation = max(violation, -margin / program.scales[k])
        if decides(margin / program.scales[k], pull):
            active.append(r.name)
    for v, y, multiplier in zip(program.declared.variables, point.y, point.lam_y, strict=True):
        if decides(float(min(y, 1.0 - y)), float(abs(multiplier))):
            active.append(v.name)
    weights = _weights(front, one)
    waved = [] if beaten else [run.scene.branch for run in front.runs(point.y) if run.scene.effects.strength_wave]
    return FrontPoint(
        objectives=tuple((scaled * front.units).tolist()),
        variables={v.name: float(x) for v, x in zip(program.declared.variables, program.values(point.y), strict=True)},
        margins=margins,
        active=tuple(active),
        rate=-weights[0] / weights[1] if weights is not None and front.count == 2 else None,
        branch=next(filter(None, waved), ""),
        residual=level.residual(point, one.p),
        violation=violation,
        gap=front.gap(point.y, exact=one.exact),
        curvature=None if beaten or not one.confirmed else level.least_curvature(point, one.p),
        weights=weights,
        confirmed=one.confirmed,
    )


def _weights(front: FrontProgram, one: Candidate) -> tuple[float, ...] | None:
    """Return how much each objective weighs per its unit, those on a range of the front together 1."""
    point, p = one.inward or (one.point, one.p)
    own = front.slopes(point, p) * front.span
    # Where positions do not decide, the weights are those of the question.
    if not front.holds(point) or np.any(own < -PULLS) or not own[-1] > PULLS:
        return None
    return tuple((own / np.sum(own) / (front.span * front.units)).tolist())
