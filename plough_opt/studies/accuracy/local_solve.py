"""Local solves of a design's program by IPOPT, with a choice of derivatives."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from plough_opt.core.compiler import compiler_problem
from plough_opt.core.errors import NotConverged
from plough_opt.design.forms import as_machine_code
from plough_opt.design.ipopt import FAR, NEAR, OPTIONS, REMEDIES, Point, Vector
from plough_opt.design.nlp import Nlp, ipopt_functions
from plough_opt.studies.accuracy.transcription import Question, Transcribed

Derivatives = Literal["exact", "gradient", "central", "forward"]
"""Exact Hessian; or limited-memory BFGS with an exact gradient, or one by central or forward differences."""

# Most iterations of IPOPT; a contestant that needs more has failed.
_MOST_ITERATIONS = 300


@dataclass(frozen=True)
class Start:
    """Start of every contestant.

    Attributes:
        y: scaled variables.
        near: whether they are nearly optimal, so that IPOPT must stay in the basin.
        limit: time after which IPOPT gives up [s].
    """

    y: Vector
    near: bool
    limit: float


Solve = Callable[[], Point]
"""Returns the point where IPOPT stopped, with the scaled variables of the design alone."""


def solve_nlp(nlp: Nlp, question: Question, start: Start, derivatives: Derivatives, tolerance: float) -> Solve:
    """Return the local solve of a program with its own derivatives, or with differences.

    Args:
        nlp: the program.
        question: the design's program, for the limits of requirements.
        start: where to begin.
        derivatives: derivatives to use. The step of differences is the cube root of the rounding for central ones, and
            the square root for forward ones.
        tolerance: IPOPT's tolerance.
    """
    slopes, count = nlp.slopes, len(start.y)
    if derivatives in ("central", "forward"):
        slopes = _differences(nlp.values, count, central=derivatives == "central")
    own = ipopt_functions(nlp.values, slopes)
    given = {"grad_f": own["grad_f"], "jac_g": own["jac_g"]}
    if derivatives == "exact":
        given["hess_lag"] = nlp.hess_lag
    y, none = ca.MX.sym("y", count), ca.MX.sym("p", 0)
    f, g = (ca.densify(own[name](y, none)) for name in ("f", "g"))
    form = Transcribed.of(question, y, f, (g,), start.y)
    return _ipopt({"x": y, "p": none, "f": f, "g": g}, given, form, start, exact=derivatives == "exact", tol=tolerance)


def _differences(values: ca.Function, variables: int, *, central: bool) -> ca.Function:
    """Return a function like `Nlp.slopes` by differences in the scaled variables."""
    y, p = ca.MX.sym("y", variables), ca.MX.sym("p", 0)
    step = np.finfo(float).eps ** (1.0 / 3.0 if central else 0.5)
    f, g = values(y, p)
    here, moves = ca.vertcat(f, g), ca.vertsplit(step * ca.DM.eye(variables))
    ahead = ca.horzcat(*(ca.vertcat(*values(y + move.T, p)) for move in moves))
    behind = ca.horzcat(*(ca.vertcat(*values(y - move.T, p)) if central else here for move in moves))
    slopes = (ahead - behind) / (2.0 * step if central else step)
    return ca.Function("slopes", [y, p], [f, g, slopes[0, :].T, slopes[1:, :]])


def solve_transcribed(
    form: Transcribed, start: Start, *, exact: bool = True, tolerance: float = 1e-10, scalar: bool
) -> Solve:
    """Return the local solve of a transcribed program, differentiated by CasADi.

    Args:
        form: the program, with its start.
        start: options of the start.
        exact: whether to use second derivatives.
        tolerance: IPOPT's tolerance.
        scalar: whether to expand the graph into scalar operations, which is slower to build and faster to evaluate.
    """
    whole = ca.Function("whole", [form.x], [form.f, *form.g])
    kind: Any = ca.SX if scalar else ca.MX
    x, none = kind.sym("x", form.x.numel()), kind.sym("p", 0)
    f, *blocks = (whole.expand() if scalar else whole).call([x])
    g = ca.vertcat(*blocks)
    # Differentiate block by block, so that CasADi takes the cheaper mode for each. In one block the dense rows and
    # dense columns would spoil both modes.
    jacobian = ca.vertcat(*(ca.jacobian(block, x) for block in blocks))
    given = {"jac_g": ca.Function("jac_g", [x, none], [ca.densify(g), jacobian], ["x", "p"], ["g", "jac_g_x"])}
    return _ipopt({"x": x, "f": f, "g": g}, given, form, start, exact=exact, tol=tolerance)


def _ipopt(
    problem: dict[str, Any], given: dict[str, ca.Function], form: Transcribed, start: Start, *, exact: bool, tol: float
) -> Solve:
    """Return a solve with the IPOPT settings of `Design.solve`, except those given."""
    # Without "no_nlp_grad" CasADi would build a gradient beside the given one, which compiled code cannot provide.
    options = OPTIONS | {"no_nlp_grad": True, "ipopt.max_wall_time": start.limit} | (NEAR if start.near else FAR)
    options |= {"ipopt.max_iter": _MOST_ITERATIONS, "ipopt.tol": tol, **given}
    if not exact:
        options["ipopt.hessian_approximation"] = "limited-memory"
    solver = ca.nlpsol("contestant", "ipopt", problem, options)

    def solve() -> Point:
        result = solver(**form.given)
        point = Point.of(result, solver.stats())
        if point.solved:
            return replace(point, y=np.clip(point.y[: len(start.y)], 0.0, 1.0))
        if "WallTime" in point.status:
            reason = f"no optimum after {start.limit:g} s and {point.iterations} iterations"
        else:
            # The text after the colon is a remedy for users of a design, which does not apply here.
            reason = f"{REMEDIES.get(point.status, point.status).split(':')[0]}, after {point.iterations} iterations"
        raise NotConverged(reason, point.status)

    return solve


def compiled(nlp: Nlp) -> Nlp:
    """Return a program with values and first derivatives in machine code, as in ``solve(compiled=True)``.

    Raises:
        NotConverged: there is no compiler, or it fails.
    """
    translated = as_machine_code(nlp)
    if translated is None:
        raise NotConverged(compiler_problem(), "Not_Compiled")
    return translated
