"""IPOPT on a design's nonlinear program, with the settings that a design needs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.design.nlp import PARTS, Nlp

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

_MOST_ITERATIONS = 300
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
    "ipopt.max_iter": _MOST_ITERATIONS,
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
_BEGINNINGS = {"far": FAR, "near": NEAR, "bottom": FROM_BOTTOM}
# Where the objective no longer falls, as along a valley, the last digits of the derivatives are not waited for.
_ENOUGH: dict[str, Any] = {
    "ipopt.acceptable_iter": 3,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_obj_change_tol": 1e-10,
    "ipopt.acceptable_constr_viol_tol": 1e-9,
    "ipopt.acceptable_compl_inf_tol": 1e-6,
}


# Scaled multipliers below this pull at nothing.
PULLS = 1e-7


def decides(margin: float, pull: float) -> bool:
    """Return whether a limit decides a design, by scaled margin and multiplier: at an optimum one of both vanishes."""
    return pull > PULLS and pull > margin


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

    @property
    def outcome(self) -> tuple[str, int, float]:
        """Status, number of iterations and scaled objective."""
        return self.status, self.iterations, self.f

    @classmethod
    def of(cls, result: dict[str, ca.DM], stats: dict[str, Any], enough: bool = False) -> Point:
        """Take what CasADi's interface to IPOPT returned; ``enough`` as in `Solver.solve`."""
        y, lam_g, lam_y = (np.asarray(result[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        status = stats["return_status"]
        ends = ("Solve_Succeeded", "Solved_To_Acceptable_Level") if enough else ("Solve_Succeeded",)
        solved = status in ends and bool(np.all(np.isfinite(y)))
        return cls(solved, status, y, float(result["f"]), lam_g, lam_y, int(stats["iter_count"]))


class _AtOnce:
    """Values, and slopes, which hold the values too, that IPOPT asks for one by one at the same point.

    They are computed once: the values with the slopes, unless at the point before no slopes were asked for.
    """

    def __init__(self, nlp: Nlp) -> None:
        self.values, self.slopes = nlp.values, nlp.slopes
        self._at: list[list[float]] = []
        self._found: list[ca.DM] = []
        self._wanted = True
        self.interrupted = False

    def __call__(self, at: Sequence[ca.DM], result: int) -> ca.DM:
        """Return a result of the slopes at a point; the first ones are those of the values."""
        point, sloping = [part.nonzeros() for part in at], result >= self.values.n_out()
        fresh = point != self._at
        if fresh or result >= len(self._found):
            everything = sloping or (fresh and self._wanted)
            self._found = (self.slopes if everything else self.values).call(at)
            self._at, self._wanted = point, False
        self._wanted |= sloping
        return self._found[result]


class _Part(ca.Callback):
    """One result of a shared evaluation."""

    def __init__(self, shared: _AtOnce, result: int) -> None:
        ca.Callback.__init__(self)
        self._shared, self._function, self._result = shared, shared.slopes, result
        self.construct(f"part_{result}", {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return int(self._function.n_in())

    def get_n_out(self) -> int:
        """Return the number of results."""
        return 1

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return self._function.sparsity_in(k)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        """Return the shape of the result."""
        return self._function.sparsity_out(self._result)

    def eval(self, at: Sequence[ca.DM]) -> list[ca.DM]:
        """Return the result."""
        try:
            return [self._shared(at, self._result)]
        except KeyboardInterrupt:
            # CasADi takes any exception for an evaluation that failed, from which IPOPT goes on.
            self._shared.interrupted = True
            raise


class Solver:
    """IPOPT on one program; built once for starts far and near."""

    def __init__(
        self, nlp: Nlp, variables: int, parameters: int, low: Vector, high: Vector, *, most: int = _MOST_ITERATIONS
    ) -> None:
        """Take the program, its sizes, the limits of its requirements, and after how many iterations to give up."""
        self._nlp, self._most = nlp, most
        self._shared: _AtOnce | None = None
        y, p = ca.MX.sym("y", variables), ca.MX.sym("p", parameters)
        parts = nlp.parts or self._interpreted(nlp, y, p)
        self._problem = {"x": y, "p": p, "f": parts["f"](y, p), "g": parts["g"](y, p)}
        self._jac_g = parts["jac_g"]
        self._derivatives = {
            "grad_f": parts["grad_f"],
            "jac_g": self._jac_g,
            # Multipliers of bounds come from IPOPT itself, and of parameters none are asked for.
            "no_nlp_grad": True,
            "calc_lam_p": False,
        }
        self._low, self._high = ca.DM(low), ca.DM(high)
        self._solvers: dict[tuple[str, bool, bool], ca.Function] = {}

    def _interpreted(self, nlp: Nlp, y: ca.MX, p: ca.MX) -> dict[str, ca.Function]:
        """Return what IPOPT asks for of a program that does not remember its last point."""
        self._shared = shared = _AtOnce(nlp)
        # CasADi does not keep a Callback alive.
        self._callbacks = [_Part(shared, k) for k in range(nlp.slopes.n_out())]
        found = [part(y, p) for part in self._callbacks]
        return {
            name: ca.Function(name, [y, p], [found[k] for k in results.values()], ["x", "p"], list(results))
            for name, results in PARTS.items()
        }

    def solve(
        self,
        start: Vector,
        p: Vector,
        lower: Vector | None = None,
        upper: Vector | None = None,
        limits: tuple[Vector, Vector] | None = None,
        *,
        near: bool = False,
        exact: bool | None = None,
        enough: bool = False,
    ) -> Point:
        """Return the local optimum that IPOPT reaches from a start.

        Args:
            start: scaled variables.
            p: parameters.
            lower: lower bounds of the scaled variables; default 0.
            upper: upper bounds; default 1.
            limits: of the requirements, where they are not those that it was built with.
            near: whether the start is nearly optimal.
            exact: whether to take exact second derivatives; by default only where it fails without them.
            enough: whether to stop where the objective no longer falls, in the place of waiting for the last digits.
        """
        bounds = {"lbx": 0.0 if lower is None else lower, "ubx": 1.0 if upper is None else upper}
        low, high = (self._low, self._high) if limits is None else limits
        asked = {"x0": start, "p": p, "lbg": low, "ubg": high, **bounds}
        if not exact:
            point = self._attempt(asked, ("bottom" if near else "far", False, enough))
            if near and enough and point.status == "Maximum_Iterations_Exceeded":
                # Along what is flat, steps from a low barrier are short.
                point = self._attempt(asked, ("near", False, enough))
            if point.solved or exact is False:
                return point
        return self._attempt(asked, ("bottom" if near else "far", True, enough))

    def requirements(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return the scaled requirements and their Jacobian; where IPOPT just stopped they are known."""
        try:
            g, jacobian = self._jac_g(y, p)
        except RuntimeError:
            self._stop_if_interrupted()
            raise
        return g.full().ravel(), jacobian.full()

    def _stop_if_interrupted(self) -> None:
        """Raise KeyboardInterrupt if an evaluation was interrupted, which CasADi takes for one that failed."""
        if self._shared is not None and self._shared.interrupted:
            self._shared.interrupted = False
            raise KeyboardInterrupt

    def _solver(self, begin: str, exact: bool, enough: bool) -> ca.Function:
        kind = begin, exact, enough
        if kind not in self._solvers:
            options = OPTIONS | self._derivatives | _BEGINNINGS[begin] | (_ENOUGH if enough else {})
            options |= {"hess_lag": self._nlp.hess_lag} if exact else _QUASI_NEWTON
            most = self._most if exact else min(self._most, _MOST_WITHOUT_CURVATURE)
            options["ipopt.max_iter"] = min(options["ipopt.max_iter"], most)
            self._solvers[kind] = ca.nlpsol("design", "ipopt", self._problem, options)
        return self._solvers[kind]

    def _attempt(self, asked: dict[str, Any], kind: tuple[str, bool, bool]) -> Point:
        solver = self._solver(*kind)
        result = solver(**asked)
        self._stop_if_interrupted()
        point = Point.of(result, solver.stats(), kind[2])
        _LOG.debug("IPOPT from %s: %s in %d iterations, scaled objective %.9g", kind[0], *point.outcome)
        return point
