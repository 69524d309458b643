"""Certificates: what a front's points are, and how far each can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plough_opt.design.ipopt import PULLS, Point, Vector, decides
from plough_opt.tradeoff.program import POSITION, FrontProgram
from plough_opt.tradeoff.tracing import Sample

# Scaled by objective and limits: residuals above are no optimum, violations above no design.
_RESIDUAL = 1e-6
_VIOLATED = 1e-6


@dataclass(frozen=True)
class FrontPoint:
    """A design on the front, or one that others dominate: a local optimum of the one objective beside the other.

    Attributes:
        objectives: both, by the tightly integrated model, in their units.
        variables: name -> value, SI units.
        margins: name of each requirement -> distance of its worst value from its limit, positive inside, in its unit.
        active: names of the requirements and variables whose limits decide the design.
        rate: change of the second objective per change of the first along the front, in their units; None of a design
            that stands alone or is not on the front.
        branch: under a strength wave "soft" or "stiff", by the natural frequency beside the wave's; else "".
        residual: of the first-order conditions, scaled.
        violation: largest violation of a requirement by the tightly integrated model, relative to its limit.
        gap: largest relative difference of the optimiser's objectives from the tightly integrated ones.
    """

    objectives: tuple[float, float]
    variables: dict[str, float]
    margins: dict[str, float]
    active: tuple[str, ...]
    rate: float | None
    branch: str
    residual: float
    violation: float
    gap: float

    @property
    def doubt(self) -> str:
        """Why this is no certified optimum; empty for one that is."""
        if not self.residual <= _RESIDUAL:
            return f"the first-order conditions are met to {self.residual:.1e} only"
        if not self.violation <= _VIOLATED:
            return f"integrated tightly it violates a requirement by a relative {self.violation:.1e}"
        return ""


def certify(front: FrontProgram, sample: Sample, signs: Vector) -> FrontPoint:
    """Return a sample's report from the tightly integrated model.

    Args:
        front: the program.
        sample: a local optimum.
        signs: of the objectives, -1 for one that is maximised.
    """
    program, point = front.program, sample.point
    scaled, found = front.exact(point.y)
    margins, violation, active = {}, 0.0, []
    for k, (r, value) in enumerate(zip(program.declared.requirements, found, strict=True)):
        if r.name == POSITION:
            continue
        margin = r.margin(value.ravel())
        pull = float(np.max(np.abs(point.lam_g[np.array(program.owner) == k])))
        margins[r.name] = margin
        violation = max(violation, -margin / program.scales[k])
        if decides(margin / program.scales[k], pull):
            active.append(r.name)
    for v, y, multiplier in zip(program.declared.variables, point.y, point.lam_y, strict=True):
        if decides(float(min(y, 1.0 - y)), float(abs(multiplier))):
            active.append(v.name)
    own = scaled * np.array(front.scales) * signs
    return FrontPoint(
        objectives=(float(own[0]), float(own[1])),
        variables={v.name: float(x) for v, x in zip(program.declared.variables, program.values(point.y), strict=True)},
        margins=margins,
        active=tuple(active),
        rate=_rate(front, sample, signs),
        branch=_branch(front, point.y),
        residual=residual(front, point, sample.p),
        violation=violation,
        gap=front.gap(point.y),
    )


def residual(front: FrontProgram, point: Point, p: Vector) -> float:
    """Return by how much an optimum misses the first-order conditions: slopes, limits, and one of the two at each."""
    program = front.program
    _, g, gradient, jacobian = (np.asarray(result) for result in program.nlp.slopes(point.y, p))
    g = g.ravel()
    size = max(1.0, float(np.max(np.abs(point.lam_g))), float(np.max(np.abs(point.lam_y))))
    slope = gradient.ravel() + jacobian.T @ point.lam_g + point.lam_y
    beyond = np.maximum(0.0, np.maximum(program.low - g, g - program.high))
    rooms = np.r_[
        np.where(point.lam_g > 0.0, program.high - g, g - program.low),
        np.where(point.lam_y > 0.0, 1.0 - point.y, point.y),
    ]
    pulls = np.abs(np.r_[point.lam_g, point.lam_y])
    # A limit that is not there, at infinity, must have no multiplier.
    both = np.max(pulls * np.where(np.isfinite(rooms), np.abs(rooms), 1.0))
    return float(max(np.max(np.abs(slope)), both) / size + np.max(beyond))


def _rate(front: FrontProgram, sample: Sample, signs: Vector) -> float | None:
    point, p = sample.inward or (sample.point, sample.p)
    first, second = front.slopes(point, p)
    if not front.holds(point) or not (first >= -PULLS and second > PULLS):
        return None
    scales = np.array(front.scales) * signs
    return float(-first / second * scales[1] / scales[0])


def _branch(front: FrontProgram, y: Vector) -> str:
    program = front.program
    for k, run in enumerate(program.exact.runs):
        if run.integration.structure.wave and (branch := program.exact.inputs(k, front.numbers(y))[1].branch):
            return branch
    return ""
