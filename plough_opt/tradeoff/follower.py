"""IPOPT from a neighbouring optimum, with its multipliers."""

from __future__ import annotations

from typing import Any, Final

import casadi as ca

from plough_opt.design.ipopt import OPTIONS, Point, Solver, Vector

_WARM: Final[dict[str, Any]] = {
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-9,
    "ipopt.warm_start_bound_frac": 1e-9,
    "ipopt.warm_start_slack_bound_push": 1e-9,
    "ipopt.warm_start_slack_bound_frac": 1e-9,
    "ipopt.warm_start_mult_bound_push": 1e-9,
    "ipopt.mu_init": 1e-6,
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.max_iter": 40,
}


class Follower(Solver):
    """A solver that starts from an optimum of a program whose parameters were slightly different."""

    _warm: ca.Function | None = None

    def follow(self, at: Point, start: Vector, p: Vector) -> Point:
        """Return the optimum near a start, from the multipliers of a neighbour.

        Args:
            at: the neighbour.
            start: scaled variables.
            p: parameters.
        """
        if self._warm is None:
            self._warm = ca.nlpsol("follow", "ipopt", self._problem, OPTIONS | self._derivatives | _WARM)
        result = self._warm(
            x0=start, p=p, lbx=0.0, ubx=1.0, lbg=self._low, ubg=self._high, lam_x0=at.lam_y, lam_g0=at.lam_g
        )
        return Point.of(result, self._warm.stats())
