"""IPOPT on a design's nonlinear program, with the settings that a design needs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design.nlp import Nlp, as_ipopt_wants

Vector = NDArray[np.float64]
_LOG = logging.getLogger(__name__)

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
OPTIONS: dict[str, Any] = {
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
    # A design's linear systems are small, dense and of order 1.
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
}
# By differences of exact gradients: of few variables it takes fewer iterations than the exact Hessian, which is
# indefinite over most of a multimodal design, and a fraction of the time of each.
_QUASI_NEWTON: dict[str, Any] = {
    "ipopt.hessian_approximation": "limited-memory",
    # What it remembers enters the linear system; by default that is solved once for each thing remembered.
    "ipopt.limited_memory_aug_solver": "extended",
    # Systems this small are solved to rounding, and no step is checked for what its solution leaves over.
    "ipopt.fast_step_computation": "yes",
}
# Iterations after which it no longer converges, but wanders.
_MOST_WITHOUT_CURVATURE = 100
# From anywhere: the adaptive barrier takes about half the iterations of the monotone one here.
FAR: dict[str, Any] = {"ipopt.mu_strategy": "adaptive"}
# From a point that is nearly optimal already: stay in its basin instead of first moving to the middle.
NEAR: dict[str, Any] = {
    "ipopt.max_iter": 30,
    "ipopt.mu_init": 1e-4,
    "ipopt.bound_push": 1e-6,
    "ipopt.bound_frac": 1e-6,
    "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6,
}
# From a search's bottom, right to some 1e-6: a barrier that low moves it no further than that from its limits. A higher
# one drives it along flat valleys first, from which it takes five times as many iterations back.
FROM_BOTTOM: dict[str, Any] = NEAR | {"ipopt.mu_init": 1e-8, "ipopt.bound_mult_init_method": "mu-based"}
# From a neighbour's optimum and multipliers, along a front.
_FROM_NEIGHBOUR: dict[str, Any] = {
    "ipopt.max_iter": 40,
    "ipopt.mu_init": 1e-6,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-9,
    "ipopt.warm_start_bound_frac": 1e-9,
    "ipopt.warm_start_slack_bound_push": 1e-9,
    "ipopt.warm_start_slack_bound_frac": 1e-9,
    "ipopt.warm_start_mult_bound_push": 1e-9,
}
_BEGINNINGS = {"neighbour": _FROM_NEIGHBOUR, "far": FAR, "near": NEAR, "bottom": FROM_BOTTOM}
# Where the objective no longer falls, as along a valley, the last digits of the derivatives are not waited for.
_ENOUGH: dict[str, Any] = {
    "ipopt.acceptable_iter": 3,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_obj_change_tol": 1e-10,
    "ipopt.acceptable_constr_viol_tol": 1e-9,
    "ipopt.acceptable_compl_inf_tol": 1e-6,
}


@dataclass(frozen=True)
class SolveOptions:
    """How IPOPT goes about a solve.

    Attributes:
        near: whether the start is nearly optimal.
        exact: whether to take exact second derivatives; None: only where it fails without them.
        enough: whether to stop where the objective no longer falls, and not to wait for the last digits.
    """

    near: bool = False
    exact: bool | None = None
    enough: bool = False


FROM_AFAR = SolveOptions()


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
        curvatures: of the objective in the directions that stay free, and these as columns, where they are known.
    """

    solved: bool
    status: str
    y: Vector
    f: float
    lam_g: Vector
    lam_y: Vector
    iterations: int
    curvatures: tuple[Vector, Vector] | None = None

    @classmethod
    def of(cls, result: dict[str, ca.DM], stats: dict[str, Any], enough: bool = False) -> Point:
        """Take what CasADi's interface to IPOPT returned; ``enough`` as in `SolveOptions`."""
        y, lam_g, lam_y = (np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        status = stats["return_status"]
        ends = ("Solve_Succeeded", "Solved_To_Acceptable_Level") if enough else ("Solve_Succeeded",)
        solved = status in ends and bool(np.all(np.isfinite(y)))
        return cls(solved, status, y, float(result["f"]), lam_g, lam_y, int(stats["iter_count"]))


class LastPoint:
    """Values and slopes at the last point that IPOPT asked about, for which it asks one by one.

    They are computed once: the values with the slopes, unless at the point before no slopes were asked for.
    """

    def __init__(self, nlp: Nlp) -> None:
        """Take the program."""
        self._nlp = nlp
        self._at: list[list[float]] = []
        self._found: list[ca.DM] = []
        self._wanted = True
        self.interrupted = False

    def __call__(self, at: Sequence[ca.DM], *, sloping: bool) -> list[ca.DM]:
        """Return the values at a point, (y, p), or the slopes."""
        point = [part.nonzeros() for part in at]
        fresh = point != self._at
        if fresh or (sloping and len(self._found) == 2):
            everything = sloping or self._wanted
            self._found = (self._nlp.slopes if everything else self._nlp.values).call(at)
            self._at, self._wanted = point, False
        self._wanted |= sloping
        return self._found if sloping else self._found[:2]


class _Remembered(ca.Callback):
    """Values, or slopes, as a Function that CasADi can call."""

    def __init__(self, last: LastPoint, function: ca.Function, *, sloping: bool) -> None:
        ca.Callback.__init__(self)
        self._last, self._function, self._sloping = last, function, sloping
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
            # CasADi takes any exception for an evaluation that failed, from which IPOPT goes on.
            self._last.interrupted = True
            raise


class Solver:
    """IPOPT on one program; built once for starts far and near."""

    def __init__(self, nlp: Nlp, low: Vector, high: Vector) -> None:
        """Take the program and the limits of its requirements."""
        self._nlp, self._last = nlp, LastPoint(nlp)
        # CasADi does not keep a Callback alive.
        self._callbacks = (
            _Remembered(self._last, nlp.values, sloping=False),
            _Remembered(self._last, nlp.slopes, sloping=True),
        )
        parts = as_ipopt_wants(*self._callbacks)
        y, p = nlp.values.mx_in()
        self._problem = {"x": y, "p": p, "f": parts["f"](y, p), "g": parts["g"](y, p)}
        # Multipliers of bounds come from IPOPT itself, and of parameters none are asked for.
        savings = {"no_nlp_grad": True, "calc_lam_p": False}
        self._derivatives = {"grad_f": parts["grad_f"], "jac_g": parts["jac_g"], **savings}
        self._low, self._high = ca.DM(low), ca.DM(high)
        self._solvers: dict[tuple[str, bool, bool], ca.Function] = {}

    def solve(
        self,
        start: Vector,
        p: Vector,
        lower: Vector | float = 0.0,
        upper: Vector | float = 1.0,
        options: SolveOptions = FROM_AFAR,
        limits: tuple[Vector, Vector] | None = None,
        neighbour: Point | None = None,
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a start.

        Args:
            start: scaled variables.
            p: parameters.
            lower: lower bounds of the scaled variables.
            upper: upper bounds.
            options: how to go about it.
            limits: of the requirements, where they are not those that it was built with.
            neighbour: an optimum near the start, from whose multipliers to begin.
        """
        low, high = (self._low, self._high) if limits is None else limits
        given = {"x0": start, "p": p, "lbx": lower, "ubx": upper, "lbg": low, "ubg": high}
        begin = "bottom" if options.near else "far"
        if neighbour is not None:
            begin = "neighbour"
            given |= {"lam_x0": neighbour.lam_y, "lam_g0": neighbour.lam_g}
        if not options.exact:
            point = self._attempt(given, begin, False, options.enough)
            if options.near and options.enough and point.status == "Maximum_Iterations_Exceeded":
                # Along what is flat, steps from a low barrier are short.
                point = self._attempt(given, "near", False, options.enough)
            if point.solved or options.exact is False:
                return point
        return self._attempt(given, begin, True, options.enough)

    def requirements(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return the scaled requirements and their Jacobian; where IPOPT just stopped they are known."""
        _, g, _, jacobian = self._last([ca.DM(y), ca.DM(p)], sloping=True)
        return g.full().ravel(), jacobian.full()

    def _attempt(self, given: dict[str, Any], begin: str, exact: bool, enough: bool) -> Point:
        solver = self._solver(begin, exact, enough)
        result = solver(**given)
        if self._last.interrupted:
            self._last.interrupted = False
            raise KeyboardInterrupt
        point = Point.of(result, solver.stats(), enough)
        outcome = point.status, point.iterations, point.f
        _LOG.debug("IPOPT from %s: %s in %d iterations, scaled objective %.9g", begin, *outcome)
        return point

    def _solver(self, begin: str, exact: bool, enough: bool) -> ca.Function:
        kind = begin, exact, enough
        if kind not in self._solvers:
            options = OPTIONS | self._derivatives | _BEGINNINGS[begin] | (_ENOUGH if enough else {})
            if exact:
                options["hess_lag"] = self._nlp.hess_lag
            else:
                most = min(options["ipopt.max_iter"], _MOST_WITHOUT_CURVATURE)
                options |= _QUASI_NEWTON | {"ipopt.max_iter": most}
            self._solvers[kind] = ca.nlpsol("design", "ipopt", self._problem, options)
        return self._solvers[kind]
