"""The least-squares problem: Gauss-Newton in IPOPT between bounds, built once and solved for many sets of values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design.ipopt import NEAR, OPTIONS
from plough_opt.studies.calibration.identifiability import UNIFORM
from plough_opt.studies.calibration.loss import Loss
from plough_opt.studies.calibration.prediction import Predictor

Vector = NDArray[np.float64]

_TIGHT: dict[str, Any] = OPTIONS | {
    "ipopt.tol": 1e-9,
    "ipopt.max_iter": 200,
    # A larger barrier drives the unknowns far along directions that the data do not determine.
    "ipopt.mu_init": 1e-6,
    "calc_lam_p": False,
    "calc_lam_x": False,
    "no_nlp_grad": True,
}
_PATIENT: dict[str, Any] = {"ipopt.max_iter": 200, "ipopt.mu_init": 1e-7}
RIDGE = 0.01 / UNIFORM**2
"""Weight of a term that draws the unknowns to a centre if they are not all determined.

It is a hundredth of the information in the bounds themselves. It selects a point along an undetermined direction, and
moves determined unknowns by less than a hundredth of their standard errors.
"""

# Least curvature of a loss, relative to its weight: the loss itself is concave for large residuals.
_LEAST_BEND = 0.1
# A fit has converged if a Gauss-Newton step would lower the sum of squares by less than this, with 1 for one standard
# deviation: the unknowns are then within 1e-4 of a standard deviation.
_DECREMENT = 1e-8
# Distance to a bound within which a scaled unknown is on it.
_AT_BOUND = 1e-6


@dataclass(frozen=True)
class Stop:
    """Where the solver stopped.

    Attributes:
        solved: whether it is a local optimum: no step between the bounds lowers the loss.
        status: IPOPT's return status.
        y: scaled unknowns.
        loss: sum of the losses.
        iterations: number of iterations.
    """

    solved: bool
    status: str
    y: Vector
    loss: float
    iterations: int


class LeastSquares:
    """Sum of losses over scaled unknowns between 0 and 1, for observed values and weights that are parameters."""

    def __init__(self, predictor: Predictor, loss: Loss) -> None:
        """Take the predictions and the loss of a weighted residual."""
        self.predictor, self.loss = predictor, loss
        self.rows, self.unknowns = predictor.both.size_out(1)
        y = ca.MX.sym("y", self.unknowns)
        observed, weights = ca.MX.sym("observed", self.rows), ca.MX.sym("weights", self.rows)
        ridge, centre = ca.MX.sym("ridge"), ca.MX.sym("centre", self.unknowns)
        q = ca.vertcat(observed, weights, ridge, centre)
        predicted, slope = predictor.both(y)
        r = weights * (predicted - observed)
        slope = ca.repmat(weights, 1, self.unknowns) * slope
        pull = loss.weight(r)
        # The loss's own second derivative if it is positive: the weight, which is larger, makes the steps too short.
        bend = ca.fmax(loss.curvature(r), _LEAST_BEND * pull)
        away = y - centre
        alone = ca.sum1(loss.value(weights * (predictor.value(y) - observed))) + 0.5 * ridge * ca.sumsqr(away)
        again = ca.sum1(loss.value(r)) + 0.5 * ridge * ca.sumsqr(away)
        gradient = slope.T @ (pull * r) + ridge * away
        curvature = slope.T @ (ca.repmat(bend, 1, self.unknowns) * slope) + ridge * ca.DM.eye(self.unknowns)
        parts = [y, observed, weights, ridge, centre]
        value, first, second = (
            ca.Function(name, parts, results)
            for name, results in (("value", [alone]), ("first", [again, gradient]), ("second", [curvature]))
        )
        if predictor.closed:
            value, first, second = (function.expand() for function in (value, first, second))
        p = ca.MX.sym("p", q.numel())
        sizes = np.cumsum([0, *(part.numel() for part in parts[1:])]).tolist()
        self._y, self._p = y, p
        given = ca.vertsplit(p, sizes)
        self._total, self._curvature = value(y, *given), second(y, *given)
        self._again, self._gradient = first(y, *given)
        self._fit = self._build_fit()
        self._profile: ca.Function | None = None
        self._value = ca.Function("total", [y, p], [self._total])
        self._local = ca.Function("local", [y, p], [self._gradient, self._curvature])

    def _packed(self, observed: Vector, weights: Vector, centre: Vector | None) -> Vector:
        """Return the problem's parameters; a centre adds the weak term described at `RIDGE`."""
        ridge, at = (0.0, np.zeros(self.unknowns)) if centre is None else (RIDGE, centre)
        return np.concatenate([observed, weights, [ridge], at])

    def total(self, y: Vector, observed: Vector, weights: Vector) -> float:
        """Return the sum of losses."""
        return float(self._value(y, self._packed(observed, weights, None)))

    def _build_fit(self) -> ca.Function:
        y, q, names = self._y, self._p, ["x", "p"]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
        own = {
            "grad_f": ca.Function("grad_f", [y, q], [self._again, self._gradient], names, ["f", "grad_f_x"]),
            "hess_lag": ca.Function("hess_lag", [y, q, lam_f, lam_g], [ca.triu(lam_f * self._curvature)],
                                    [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
        }  # fmt: skip
        return ca.nlpsol("fit", "ipopt", {"x": y, "p": q, "f": self._total}, _TIGHT | own)

    def solve(self, start: Vector, observed: Vector, weights: Vector, centre: Vector | None = None) -> Stop:
        """Return the local optimum that a start leads to; of many along a direction, the nearest to a centre."""
        q = self._packed(observed, weights, centre)
        solution = self._fit(x0=start, p=q, lbx=0.0, ubx=1.0)
        stats = self._fit.stats()
        y = np.clip(np.asarray(solution["x"]).ravel(), 0.0, 1.0)
        total = self.total(y, observed, weights) if np.all(np.isfinite(y)) else np.inf
        solved = bool(np.isfinite(total)) and self._decrement(y, q) <= _DECREMENT * max(1.0, 2.0 * total)
        return Stop(solved, str(stats["return_status"]), y, total, int(stats["iter_count"]))

    def _decrement(self, y: Vector, q: Vector) -> float:
        """Return twice the decrease of the loss by a Gauss-Newton step between the bounds."""
        gradient, curvature = (np.asarray(part) for part in self._local(y, q))
        gradient = gradient.ravel()
        outward = ((y < _AT_BOUND) & (gradient >= 0.0)) | ((y > 1.0 - _AT_BOUND) & (gradient <= 0.0))
        free = ~outward
        if not np.any(free):
            return 0.0
        step = np.linalg.lstsq(curvature[np.ix_(free, free)], gradient[free], rcond=1e-12)[0]
        return float(gradient[free] @ step)

    def predict(self, y: Vector) -> Vector:
        """Return the predictions (n)."""
        return np.asarray(self.predictor.value(y), dtype=float).ravel()

    def slope(self, y: Vector) -> Vector:
        """Return the Jacobian of the predictions (n, p)."""
        return np.asarray(self.predictor.both(y)[1], dtype=float).reshape(self.rows, self.unknowns)

    def extreme(
        self,
        direction: Vector,
        start: Vector,
        observed: Vector,
        weights: Vector,
        limit: float,
        centre: Vector | None,
    ) -> Stop:
        """Return the unknowns furthest in a direction of those whose sum of losses does not exceed a limit."""
        if self._profile is None:
            self._profile = self._build_profile()
        q = np.concatenate([self._packed(observed, weights, centre), direction, [limit]])
        solution = self._profile(x0=start, p=q, lbx=0.0, ubx=1.0, lbg=-np.inf, ubg=0.0)
        stats = self._profile.stats()
        y = np.clip(np.asarray(solution["x"]).ravel(), 0.0, 1.0)
        status = str(stats["return_status"])
        return Stop(status == "Solve_Succeeded", status, y, float("nan"), int(stats["iter_count"]))

    def _build_profile(self) -> ca.Function:
        y, p, names = self._y, self._p, ["x", "p"]
        sizes = np.cumsum([0, p.numel(), self.unknowns, 1]).tolist()
        q = ca.MX.sym("q", sizes[-1])
        value, first, second = (
            ca.Function(name, [y, p], results)
            for name, results in (("value", [self._total]), ("first", [self._again, self._gradient.T]),
                                  ("second", [self._curvature]))
        )  # fmt: skip
        at, direction, limit = ca.vertsplit(q, sizes)
        f, g, curvature = -ca.dot(direction, y), value(y, at) - limit, second(y, at)
        again, jacobian = first(y, at)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g")
        own = {
            "grad_f": ca.Function("grad_f", [y, q], [f, -direction], names, ["f", "grad_f_x"]),
            "jac_g": ca.Function("jac_g", [y, q], [again - limit, jacobian], names, ["g", "jac_g_x"]),
            "hess_lag": ca.Function("hess_lag", [y, q, lam_f, lam_g], [ca.triu(lam_g * curvature)],
                                    [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]),
        }  # fmt: skip
        return ca.nlpsol("profile", "ipopt", {"x": y, "p": q, "f": f, "g": g}, _TIGHT | NEAR | _PATIENT | own)
