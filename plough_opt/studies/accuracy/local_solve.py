"""One local solve of a design's program by IPOPT, with a choice of derivatives and of compiled functions."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np

from plough_opt.core.compiler import compile_library, find_compiler
from plough_opt.core.errors import NotConverged
from plough_opt.design.ipopt import FAR, NEAR, OPTIONS, REMEDIES, Vector
from plough_opt.design.nlp import Nlp, as_ipopt_wants
from plough_opt.studies.accuracy.transcription import Question, Transcribed

Derivatives = Literal["exact", "gradient", "central", "forward"]
"""Exact Hessian; exact gradient with limited-memory BFGS; gradient by differences with limited-memory BFGS."""

_MOST_ITERATIONS = 300


@dataclass(frozen=True)
class Start:
    """Where and how every contestant begins.

    Attributes:
        y: scaled variables.
        near: whether they are nearly optimal already: IPOPT then stays in the basin.
        limit: time [s] after which IPOPT gives up.
    """

    y: Vector
    near: bool
    limit: float


@dataclass(frozen=True)
class Found:
    """Where IPOPT stopped: scaled variables, the scaled objective as reported, and the number of iterations."""

    y: Vector
    f: float
    iterations: int


Solve = Callable[[], Found]
Functions = Mapping[str, ca.Function]


def functions_of(nlp: Nlp, derivatives: Derivatives) -> Functions:
    """Return those Functions of a program, by IPOPT's names, that a choice of derivatives takes."""
    own = as_ipopt_wants(nlp.values, nlp.slopes)
    return own | ({"hess_lag": nlp.hess_lag} if derivatives == "exact" else {})


def solve_nlp(
    own: Functions, question: Question, start: Start, derivatives: Derivatives = "exact", tolerance: float = 1e-10
) -> Solve:
    """Return the local solve of a program that has its own derivatives.

    Args:
        own: the program's Functions; they may be compiled.
        question: the design's question, for the limits.
        start: where to begin.
        derivatives: which of the program's derivatives to use.
        tolerance: of IPOPT.
    """
    y, none = ca.MX.sym("y", len(start.y)), ca.MX.sym("p", 0)
    problem = {"x": y, "p": none, "f": ca.densify(own["f"](y, none)), "g": ca.densify(own["g"](y, none))}
    given = {name: function for name, function in own.items() if name not in problem}
    options = given | {"ipopt.tol": tolerance} | _limited_memory(derivatives)
    program = question.program
    bounds = {"lbx": 0.0, "ubx": 1.0, "lbg": program.low, "ubg": program.high}
    return _ipopt(problem, options, bounds, start, start.y)


def solve_transcribed(
    own: Transcribed, start: Start, derivatives: Derivatives = "exact", tolerance: float = 1e-10, *, scalar: bool
) -> Solve:
    """Return the local solve of a transcribed program, differentiated by CasADi.

    Args:
        own: the program.
        start: how to begin; the program holds where.
        derivatives: ``"exact"`` or ``"gradient"``.
        tolerance: of IPOPT.
        scalar: whether to expand the graph into scalar operations: slower to build, faster to evaluate.
    """
    whole = ca.Function("whole", [own.x], [own.f, *own.g])
    x: Any = ca.MX.sym("x", own.x.numel())
    if scalar:
        whole, x = whole.expand(), ca.SX.sym("x", own.x.numel())
    f, *blocks = whole.call([x])
    g = ca.vertcat(*blocks)
    problem = {"x": x, "f": f, "g": g}
    options = {"ipopt.tol": tolerance} | _limited_memory(derivatives)
    if len(blocks) > 1:
        # Block by block, CasADi takes the cheaper mode for each; together, rows and columns without zeros spoil both.
        jacobian = ca.vertcat(*(ca.jacobian(block, x) for block in blocks))
        none: Any = ca.SX.sym("p", 0) if scalar else ca.MX.sym("p", 0)
        options["jac_g"] = ca.Function("jac_g", [x, none], [ca.densify(g), jacobian], ["x", "p"], ["g", "jac_g_x"])
    bounds = {"lbx": own.lower, "ubx": own.upper, "lbg": own.low, "ubg": own.high}
    return _ipopt(problem, options, bounds, start, own.start)


def _limited_memory(derivatives: Derivatives) -> dict[str, Any]:
    return {} if derivatives == "exact" else {"ipopt.hessian_approximation": "limited-memory"}


def _ipopt(problem: dict[str, Any], options: dict[str, Any], bounds: dict[str, Any], start: Start, x0: Vector) -> Solve:
    """Return a solve with the toolkit's own settings of IPOPT, but for those given."""
    # CasADi builds a gradient of its own beside the given one, which compiled code cannot serve.
    plain = OPTIONS | {"no_nlp_grad": True, "ipopt.max_wall_time": start.limit}
    own = plain | (NEAR if start.near else FAR) | {"ipopt.max_iter": _MOST_ITERATIONS} | options
    solver = ca.nlpsol("contestant", "ipopt", problem, own)
    count = len(start.y)

    def solve() -> Found:
        result = solver(x0=x0, **bounds)
        stats = solver.stats()
        status = stats["return_status"]
        x = np.asarray(result["x"]).ravel()
        if status != "Solve_Succeeded" or not np.all(np.isfinite(x)):
            raise NotConverged(_reason(status, int(stats["iter_count"]), start.limit), status)
        return Found(np.clip(x[:count], 0.0, 1.0), float(result["f"]), int(stats["iter_count"]))

    return solve


def _reason(status: str, iterations: int, limit: float) -> str:
    if "WallTime" in status:
        return f"no optimum after {limit:g} s and {iterations} iterations"
    # The toolkit's remedies follow the reason, behind a colon; here they are no use.
    return f"{REMEDIES.get(status, status).split(':')[0]}, after {iterations} iterations"


def without_derivatives(own: Functions, variables: int, method: Literal["central", "forward"]) -> Functions:
    """Return a program whose gradient and Jacobian are differences in the scaled variables.

    Args:
        own: the program's Functions.
        variables: number of scaled variables.
        method: central differences with the cube root of the rounding as their step, or forward ones with its root.
    """
    y, p = ca.MX.sym("y", variables), ca.MX.sym("p", 0)
    central = method == "central"
    step = np.finfo(float).eps ** (1.0 / 3.0 if central else 0.5)
    both = ca.Function("both", [y], [ca.vertcat(own["f"](y, p), own["g"](y, p))])
    here = both(y)
    moves = ca.vertsplit(step * ca.DM.eye(variables))
    ahead = [both(y + move.T) for move in moves]
    behind = [both(y - move.T) if central else here for move in moves]
    slopes = (ca.horzcat(*ahead) - ca.horzcat(*behind)) / (2.0 * step if central else step)
    names = ["x", "p"]
    return {
        "f": own["f"],
        "g": own["g"],
        "grad_f": ca.Function("grad_f", [y, p], [here[0], slopes[0, :].T], names, ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [y, p], [here[1:], slopes[1:, :]], names, ["g", "jac_g_x"]),
    }


def compiled(own: Functions, flags: Sequence[str]) -> Functions:
    """Return a program whose Functions are machine code, by the system's C compiler.

    Args:
        own: the program's Functions, interpreted by CasADi; a Hessian takes most of a compiler's time.
        flags: of the compiler.

    Raises:
        NotConverged: there is no compiler, or it refuses the code.
    """
    compiler = find_compiler()
    if compiler is None:
        raise NotConverged("no C compiler was found ($CC, cc, gcc, clang)", "No_Compiler")
    generator = ca.CodeGenerator("program.c")
    for name, function in own.items():
        generator.add(_renamed(function, f"own_{name}"))
    # The loader keeps the library; its file is needed no longer.
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "program.so"
        refusal = compile_library(generator.dump(), (*compiler, *flags), library, ("-lm",))
        if refusal is not None:
            raise NotConverged(f"the C compiler refused the program: {refusal}", "Not_Compiled")
        return {name: ca.external(f"own_{name}", str(library)) for name in own}


def _renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a Function by another name; CasADi takes a library's ``jac_g`` for the Jacobian of its ``g``."""
    inputs = function.mx_in()
    return ca.Function(name, inputs, function.call(inputs), function.name_in(), function.name_out())
