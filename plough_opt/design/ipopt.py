"""IPOPT on a design's nonlinear program, with the settings that a design needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design.nlp import Nlp

Vector = NDArray[np.float64]

REMEDIES = {
    "Infeasible_Problem_Detected": "no design near the start meets the requirements",
    "Maximum_Iterations_Exceeded": "the optimiser ran out of iterations: start nearer, or tighten the bounds",
    "Restoration_Failed": "the optimiser could not return to feasible designs: start nearer, or loosen a requirement",
    "Invalid_Number_Detected": "the model gave no finite number somewhere between the bounds: tighten the bounds",
    "Diverging_Iterates": "the objective falls without limit: bound what makes it fall",
    "Error_In_Step_Computation": "the derivatives are too large or too small: check units and bounds",
    "Not_Enough_Degrees_Of_Freedom": "there are more equalities than variables: drop some, or give them some room",
    "Search_Direction_Becomes_Too_Small": "the objective is not smooth enough here: take more integration steps",
}

# Zero keeps bounds exactly: by default IPOPT widens them by 1e-8 and reports an objective below the truth.
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.compl_inf_tol": 1e-10,
    "ipopt.acceptable_iter": 0,
    "ipopt.max_iter": 300,
}
# From anywhere: the adaptive barrier takes about half the iterations of the monotone one here.
_FAR: dict[str, Any] = {"ipopt.mu_strategy": "adaptive"}
# From a point that is nearly optimal already: stay in its basin instead of first moving to the middle.
_NEAR: dict[str, Any] = {
    "ipopt.max_iter": 30,
    "ipopt.mu_init": 1e-4,
    "ipopt.bound_push": 1e-6,
    "ipopt.bound_frac": 1e-6,
    "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6,
}


@dataclass(frozen=True)
class Point:
    """Where IPOPT stopped, in scaled variables.

    Attributes:
        solved: whether it is a local optimum to tolerance.
        status: IPOPT's word for why it stopped.
        y: scaled variables.
        f: scaled objective.
        lam_g: multipliers of the requirements.
        lam_y: multipliers of the bounds.
        iterations: number of iterations.
    """

    solved: bool
    status: str
    y: Vector
    f: float
    lam_g: Vector
    lam_y: Vector
    iterations: int


class Solver:
    """IPOPT on one program; built once for starts far and near."""

    def __init__(self, nlp: Nlp, variables: int, parameters: int, low: Vector, high: Vector) -> None:
        """Take the program, its sizes, and the limits of its requirements."""
        y, p = ca.MX.sym("y", variables), ca.MX.sym("p", parameters)
        self._problem = {"x": y, "p": p, "f": ca.densify(nlp.f(y, p)), "g": ca.densify(nlp.g(y, p))}
        self._derivatives = {"grad_f": nlp.grad_f, "jac_g": nlp.jac_g, "hess_lag": nlp.hess_lag}
        self._low, self._high = low, high
        self._solvers: dict[bool, ca.Function] = {}

    def solve(
        self,
        start: Vector,
        p: Vector,
        lower: Vector | None = None,
        upper: Vector | None = None,
        *,
        near: bool = False,
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a start, ``near`` if it is nearly optimal."""
        if near not in self._solvers:
            options = _OPTIONS | self._derivatives | (_NEAR if near else _FAR)
            self._solvers[near] = ca.nlpsol("design", "ipopt", self._problem, options)
        solver = self._solvers[near]
        result = solver(
            x0=start,
            p=p,
            lbx=0.0 if lower is None else lower,
            ubx=1.0 if upper is None else upper,
            lbg=self._low,
            ubg=self._high,
        )
        stats = solver.stats()
        vectors = {name: np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x")}
        return Point(
            solved=stats["return_status"] == "Solve_Succeeded" and bool(np.all(np.isfinite(vectors["x"]))),
            status=stats["return_status"],
            y=vectors["x"],
            f=float(result["f"]),
            lam_g=vectors["lam_g"],
            lam_y=vectors["lam_x"],
            iterations=int(stats["iter_count"]),
        )
