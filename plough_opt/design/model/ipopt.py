"""IPOPT for the nonlinear program of a design, with its settings."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design.model.nlp import Nlp, ipopt_functions

Vector = NDArray[np.float64]
_LOG = logging.getLogger(__name__)

OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    # Keep bounds exactly: by default IPOPT widens them by 1e-8 and reports an objective below the truth.
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.compl_inf_tol": 1e-10,
    "ipopt.acceptable_iter": 0,
    # The quasi-Newton method no longer converges after that, and Newton's would take long.
    "ipopt.max_iter": 100,
    # The linear systems of a design are small, dense and of order 1: scaling them only takes time.
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
}
# Approximates the Hessian by differences of exact gradients. With few variables that takes fewer iterations than the
# exact Hessian, which is indefinite over most of a multimodal design, and a fraction of the time of each.
_QUASI_NEWTON: dict[str, Any] = {
    "ipopt.hessian_approximation": "limited-memory",
    # Put the remembered gradients into the linear system; by default IPOPT solves that system once for each of them.
    "ipopt.limited_memory_aug_solver": "extended",
    # Skip checking the residual of each step: systems this small are solved to rounding.
    "ipopt.fast_step_computation": "yes",
}
# From any start: the adaptive barrier takes about half the iterations of the monotone one here.
FAR: dict[str, Any] = {"ipopt.mu_strategy": "adaptive"}
# From a nearly optimal start: stay in its basin instead of first moving to the middle.
NEAR: dict[str, Any] = {
    "ipopt.max_iter": 30,
    "ipopt.mu_init": 1e-4,
    "ipopt.bound_push": 1e-6,
    "ipopt.bound_frac": 1e-6,
    "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6,
}
# From the bottom of a basin that a search found, right to some 1e-6: a barrier this low pushes the design no further
# than that from its limits. A higher one first drives it along flat valleys, and the way back takes five times as many
# iterations.
FROM_BOTTOM: dict[str, Any] = NEAR | {"ipopt.mu_init": 1e-8, "ipopt.bound_mult_init_method": "mu-based"}
_SETTINGS_BY_START = {"far": FAR, "near": NEAR, "bottom": FROM_BOTTOM}
# Stops where the objective no longer falls, as along a valley, without waiting for the last digits of the slopes.
_STOP_EARLY: dict[str, Any] = {
    "ipopt.acceptable_iter": 3,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_obj_change_tol": 1e-10,
    "ipopt.acceptable_constr_viol_tol": 1e-9,
    "ipopt.acceptable_compl_inf_tol": 1e-6,
}


@dataclass(frozen=True)
class SolveOptions:
    """Options of a solve by IPOPT.

    Attributes:
        near: whether the start is nearly optimal.
        exact: whether to use exact second derivatives; None: only if the solve fails without them.
        enough: whether to stop where the objective no longer falls, without waiting for the last digits.
    """

    near: bool = False
    exact: bool | None = None
    enough: bool = False


FROM_AFAR = SolveOptions()


@dataclass(frozen=True)
class Point:
    """The point where IPOPT stopped, in scaled variables.

    Attributes:
        solved: whether it is a local optimum to tolerance.
        status: IPOPT's name of the reason why it stopped.
        y: scaled variables.
        f: scaled objective.
        lam_g: multipliers of the requirements.
        lam_y: multipliers of the bounds.
        iterations: number of iterations.
        curvatures: if known, the curvatures of the objective along the directions that the active limits leave free,
            and these directions as columns.
    """

    solved: bool
    status: str
    y: Vector
    f: float
    lam_g: Vector
    lam_y: Vector
    iterations: int
    curvatures: tuple[Vector, Vector] | None = None


class LastPoint:
    """A cache of the values and slopes at the last point that IPOPT evaluated.

    IPOPT evaluates objective, requirements and their derivatives one by one. They share one integration: values are
    computed together with slopes, unless IPOPT rejected the point before without evaluating its slopes.
    """

    def __init__(self, nlp: Nlp) -> None:
        """Start with an empty cache for a program."""
        self._nlp = nlp
        self.interrupted = False
        self.forget()

    def forget(self) -> None:
        """Empty the cache, so that no solve depends on an earlier one: values alone differ from those with slopes."""
        self._at: list[list[float]] = []
        self._results: list[ca.DM] = []
        self._slopes_expected = True

    def __call__(self, at: Sequence[ca.DM], *, sloping: bool) -> list[ca.DM]:
        """Return `Nlp.values` at a point (y, p), or `Nlp.slopes` with ``sloping``."""
        point = [part.nonzeros() for part in at]
        fresh = point != self._at
        if fresh or (sloping and len(self._results) == 2):
            with_slopes = sloping or self._slopes_expected
            self._results = (self._nlp.slopes if with_slopes else self._nlp.values).call(at)
            self._at, self._slopes_expected = point, False
        self._slopes_expected |= sloping
        return self._results if sloping else self._results[:2]


class _Cached(ca.Callback):
    """The values, or the slopes, of a `LastPoint` as a Function that CasADi can call."""

    def __init__(self, last: LastPoint, nlp: Nlp, *, sloping: bool) -> None:
        ca.Callback.__init__(self)
        self._last, self._function, self._sloping = last, nlp.slopes if sloping else nlp.values, sloping
        self.construct("slopes" if sloping else "values", {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return int(self._function.n_in())

    def get_n_out(self) -> int:
        """Return the number of results."""
        return int(self._function.n_out())

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return self._function.sparsity_in(k)

    def get_sparsity_out(self, k: int) -> ca.Sparsity:
        """Return the shape of a result."""
        return self._function.sparsity_out(k)

    def eval(self, at: Sequence[ca.DM]) -> list[ca.DM]:
        """Return the results."""
        try:
            return self._last(at, sloping=self._sloping)
        except KeyboardInterrupt:
            # CasADi treats any exception as a failed evaluation, and IPOPT would continue.
            self._last.interrupted = True
            raise


class Solver:
    """IPOPT for one program, with a solver for each kind of start, built when first needed."""

    def __init__(self, nlp: Nlp, low: Vector, high: Vector, options: dict[str, Any]) -> None:
        """Prepare to solve a program with lower and upper limits of its requirements, and further options of IPOPT."""
        self._nlp, self._last = nlp, LastPoint(nlp)
        # CasADi does not keep a Callback alive.
        self._callbacks = _Cached(self._last, nlp, sloping=False), _Cached(self._last, nlp, sloping=True)
        parts = ipopt_functions(*self._callbacks)
        y, p = nlp.values.mx_in()
        self._problem = {"x": y, "p": p, "f": parts["f"](y, p), "g": parts["g"](y, p)}
        # IPOPT itself gives the multipliers of bounds, and those of parameters are not needed.
        fewer_evaluations = {"no_nlp_grad": True, "calc_lam_p": False}
        self._derivatives = {"grad_f": parts["grad_f"], "jac_g": parts["jac_g"], **fewer_evaluations}
        self._low, self._high, self._options = ca.DM(low), ca.DM(high), options
        self._solvers: dict[tuple[str, bool, bool], ca.Function] = {}

    def solve(self, start: Vector, p: Vector, lower: Vector, upper: Vector, options: SolveOptions) -> Point:
        """Return the local optimum that IPOPT reaches from a start.

        Args:
            start: scaled variables.
            p: parameters.
            lower: lower bounds of the scaled variables.
            upper: upper bounds.
            options: options of the solve.
        """
        given = {"x0": start, "p": p, "lbx": lower, "ubx": upper, "lbg": self._low, "ubg": self._high}
        begin = "bottom" if options.near else "far"
        if not options.exact:
            point = self._attempt(given, begin, False, options.enough)
            if options.near and options.enough and point.status == "Maximum_Iterations_Exceeded":
                # Steps from a low barrier are short along a flat valley.
                point = self._attempt(given, "near", False, options.enough)
            # Exact curvatures lead to the same violation: it is least by exact slopes.
            if point.solved or options.exact is False or point.status == "Infeasible_Problem_Detected":
                return point
        return self._attempt(given, begin, True, options.enough)

    def requirements(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return the scaled requirements and their Jacobian, from the cache if IPOPT just stopped there."""
        _, g, _, jacobian = self._last([ca.DM(y), ca.DM(p)], sloping=True)
        return g.full().ravel(), jacobian.full()

    def _attempt(self, given: dict[str, Any], begin: str, exact: bool, enough: bool) -> Point:
        solver = self._solver(begin, exact, enough)
        self._last.forget()
        result = solver(**given)
        if self._last.interrupted:
            self._last.interrupted = False
            raise KeyboardInterrupt
        y, lam_g, lam_y = (np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        stats, f = solver.stats(), float(result["f"])
        status, iterations = stats["return_status"], int(stats["iter_count"])
        solved = status == "Solve_Succeeded" or (enough and status == "Solved_To_Acceptable_Level")
        solved &= bool(np.all(np.isfinite(y)))
        _LOG.debug("IPOPT from %s: %s in %d iterations, scaled objective %.9g", begin, status, iterations, f)
        return Point(solved, status, y, f, lam_g, lam_y, iterations)

    def _solver(self, begin: str, exact: bool, enough: bool) -> ca.Function:
        kind = begin, exact, enough
        if kind not in self._solvers:
            options = OPTIONS | self._derivatives | _SETTINGS_BY_START[begin] | (_STOP_EARLY if enough else {})
            options |= {"hess_lag": self._nlp.hess_lag} if exact else _QUASI_NEWTON
            options |= self._options
            self._solvers[kind] = ca.nlpsol("design", "ipopt", self._problem, options)
        return self._solvers[kind]
