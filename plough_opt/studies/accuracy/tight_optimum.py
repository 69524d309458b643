"""The optimum by which contestants are judged: Newton's method on the optimality conditions, by derivatives of its own.

IPOPT, which every contestant uses, stops a little inside the limits that decide. From there Newton's method leads onto
them; its gradients are those of an adaptive integrator with a tolerance that no contestant has.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from plough_opt.design.ipopt import Point, Vector
from plough_opt.design.optimality import decides, newton_step, symmetric
from plough_opt.design.program import Program
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.plan import steps_for
from plough_opt.studies.accuracy.transcription import Question, transcribe

# Tolerance of the adaptive method; and phase [rad] in a step of order 8, which takes its place where a lasting orbit is
# to be found.
_TOLERANCE = 1e-12
_PHASE = 0.1
_MOST_STEPS = 6
# Scaled variables further than this from where IPOPT stopped are those of another point.
_NEAR = 1e-4
# Singular values below this part of the largest: directions in which the optimum is not unique.
_FLAT = 1e-10


@dataclass(frozen=True)
class TightOptimum:
    """A local optimum found and checked much more tightly than any contestant's.

    Attributes:
        variables: name -> value, SI units.
        objective: tightly re-integrated.
        check: relative difference of two tight integrations of the objective, of which one checks the other [-].
        residual: largest component of the scaled optimality conditions, by the derivatives of another integrator [-].
        y: scaled variables.
        off: by how much the last of Newton's steps, which is rounding, would move them [-].
    """

    variables: dict[str, float]
    objective: float
    check: float
    residual: float
    y: Vector
    off: float

    @property
    def floor(self) -> float:
        """Relative error of the objective below which contestants cannot be told apart [-]."""
        # At an optimum on its limits the objective is off by the residual times the error of the variables.
        return max(self.check, self.residual * max(self.off, self.residual), float(np.finfo(float).eps))


class Certificate:
    """Derivatives of a design's program through an integrator that shares nothing with those of contestants."""

    def __init__(self, question: Question) -> None:
        """Take a design's program."""
        self._question, self._program, self._p = question, question.program, question.p
        self._built: ca.Function | None = None

    def _derivatives(self, y: Vector) -> tuple[Vector, ...]:
        """Return the objective's gradient, the requirements and their Jacobian, by steps that suit the first point."""
        if self._built is None:
            steps = self._question.intervals(steps_for(self._question.phase(y), _PHASE))
            accuracy = (
                Accuracy("dop853", steps=steps) if self._question.orbits else Accuracy("erk", tolerance=_TOLERANCE)
            )
            own = transcribe(self._question, accuracy)
            results = [ca.gradient(own.f, own.x), own.g[0], ca.jacobian(own.g[0], own.x)]
            self._built = ca.Function("certificate", [own.x], results)
        return tuple(np.asarray(result) for result in self._built(y))

    def tight(self, point: Point) -> TightOptimum:
        """Return the optimum beside where IPOPT stopped on the tight program."""
        program = self._program
        y, residual, off = self._polished(point)
        found, check = (float(values[0].item()) for values in program.exact_values(y, self._p))
        return TightOptimum(
            variables={v.name: float(x) for v, x in zip(program.declared.variables, program.values(y), strict=True)},
            objective=found,
            check=abs(found - check) / max(abs(found), program.objective_scale * 1e-12),
            residual=residual,
            y=y,
            off=off,
        )

    def _polished(self, point: Point) -> tuple[Vector, float, float]:
        """Return scaled variables on the limits that decide, what is left of the conditions, and the next step."""
        program, y, n = self._program, point.y, len(point.y)
        deciding, limits = _deciding(program, point, np.asarray(program.nlp.values(y, self._p)[1]).ravel())
        hessian = symmetric(np.asarray(program.nlp.hess_lag(y, self._p, 1.0, point.lam_g)))
        best = (y, np.inf, np.inf)
        for _ in range(_MOST_STEPS):
            gradient, g, jacobian = self._derivatives(y)
            rows = np.vstack([jacobian, np.eye(n)])[deciding]
            margins = np.r_[g.ravel(), y][deciding] - limits
            move, pulls = newton_step(hessian, gradient.ravel(), rows, margins, _FLAT)
            left = np.r_[gradient.ravel() - rows.T @ pulls, margins]
            residual, step = float(np.max(np.abs(left))), float(np.max(np.abs(move)))
            if step < best[2]:
                best = (y, residual, step)
            y = y + move
            if not step < best[2] * 1e3 or np.max(np.abs(y - point.y)) > _NEAR:
                break
        return best


def _deciding(program: Program, point: Point, g: Vector) -> tuple[Vector, Vector]:
    """Return rows of requirements and, after them, variables that are on a limit that decides; and these limits.

    They are read off where IPOPT stopped: a multiplier is negative at a lower limit.
    """
    low = np.r_[program.low, np.zeros(len(point.y))]
    high = np.r_[program.high, np.ones(len(point.y))]
    values, pulls = np.r_[g, point.y], np.r_[point.lam_g, point.lam_y]
    limits = np.asarray(np.where(pulls < 0.0, low, high))
    rows = [
        row
        for row, margin in enumerate(np.abs(values - limits))
        if decides(margin, abs(pulls[row])) or low[row] == high[row]
    ]
    chosen = np.array(rows, int)
    return chosen, limits[chosen]
