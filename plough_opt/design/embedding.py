"""A design's program for another solver, and the options of IPOPT that a solve accepts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.checks import mapping_of, shown
from plough_opt.core.errors import InputError
from plough_opt.design.declarations import Declarations
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.program import Program


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """The scaled program of a design, for `casadi.nlpsol` with any solver, or as a part of a larger program.

    The variables x lie between 0 and 1; objective and requirements are of order 1. All vectors are plain floats.

    Attributes:
        problem: ``x``, shape (n, 1); ``p``, the parameters in SI units, shape (q, 1); ``f``, scalar; ``g``, the rows of
            all requirements, shape (m, 1). They are MX, differentiable twice.
        x0: the guess, shape (n,).
        lbx: lower bounds of x, shape (n,).
        ubx: upper bounds.
        lbg: lower limits of g, shape (m,); -inf where there is none.
        ubg: upper limits.
        p: values of the parameters, shape (q,).
        objective_scale: f times this is the objective.
        scales: g times these are the requirements in their SI units, shape (m,).
        requirements: name of the requirement of each row of g; limits of theories come last.

    Example:
        >>> import casadi as ca, plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> nlp = design.nlp()
        >>> silent = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
        >>> solver = ca.nlpsol("s", "ipopt", nlp.problem, silent)
        >>> found = solver(**nlp.arguments)
        >>> round(nlp.variables(found["x"])["height"], 6)
        0.12
    """

    problem: dict[str, ca.MX]
    x0: Vector
    lbx: Vector
    ubx: Vector
    lbg: Vector
    ubg: Vector
    p: Vector
    objective_scale: float
    scales: Vector
    requirements: tuple[str, ...]
    _declared: Declarations

    @classmethod
    def of(cls, program: Program, p: Vector) -> NonlinearProgram:
        """Return the program of a design, with as many integration steps as its guess and bounds need."""
        program = program.with_steps(p)
        declared, owner = program.declared, np.array(program.owner, dtype=int)
        n = len(declared.variables)
        x, symbols = ca.MX.sym("x", n), ca.MX.sym("p", len(p))
        f, g = program.nlp.values(x, symbols)
        return cls(
            {"x": x, "p": symbols, "f": f, "g": g},
            program.start(),
            np.zeros(n),
            np.ones(n),
            program.low,
            program.high,
            p,
            program.objective_scale,
            np.array(program.scales)[owner],
            tuple(declared.requirements[k].name for k in owner),
            declared,
        )

    @property
    def arguments(self) -> dict[str, Vector]:
        """Arguments of a solver by `casadi.nlpsol`: guess, bounds, limits and parameters."""
        return {name: getattr(self, name) for name in ("x0", "lbx", "ubx", "lbg", "ubg", "p")}

    def variables(self, x: Any) -> dict[str, float]:
        """Return the variables by name, in their SI units, at scaled ones.

        Args:
            x: scaled variables, n numbers: an array, a DM or a sequence.

        Raises:
            InputError: there is another number of them.
        """
        numbers = np.asarray(x, dtype=float).ravel()
        if numbers.shape != self.x0.shape:
            raise InputError(f"x = {shown(x)} must hold {len(self.x0)} scaled variables, not {numbers.size}")
        return {v.name: v.value(y) for v, y in zip(self._declared.variables, numbers.tolist(), strict=True)}


# Beginnings of the names of options that a solve sets itself, and why.
_KEPT = {
    ("tol", "dual_inf_tol", "constr_viol_tol", "compl_inf_tol", "acceptable_"): "optima are certified by them",
    ("bound_relax_factor", "honor_original_bounds"): "bounds and limits are kept exactly",
    ("nlp_scaling_", "obj_scaling_factor", "user_scaling"): "multipliers are in the scales of the design",
    ("hessian_", "limited_memory_", "jacobian_", "gradient_"): "each solve chooses its derivatives",
    ("fixed_variable_treatment",): "some solves hold variables",
}


def ipopt_options(given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return options of IPOPT with the prefix of CasADi, checked.

    Raises:
        InputError: an option would break a promise of `plough_opt.Design.solve`, or IPOPT does not accept it.
    """
    options = {
        f"ipopt.{str(name).removeprefix('ipopt.')}": value
        for name, value in mapping_of("ipopt", given, "name of an option of IPOPT -> value").items()
    }
    for name, value in options.items():
        for beginnings, reason in _KEPT.items():
            if name.removeprefix("ipopt.").startswith(beginnings):
                raise InputError(
                    f"ipopt: '{name}' cannot be changed, because {reason}: leave it out, or use design.nlp()"
                )
        x = ca.MX.sym("x")
        try:
            ca.nlpsol("check", "ipopt", {"x": x, "f": x**2}, {name: value})
        # CasADi's errors: an unknown option or value, a type without a conversion, no overload for it.
        except (RuntimeError, NotImplementedError, TypeError):
            raise InputError(
                f"ipopt: '{name}' = {shown(value)} is no option of IPOPT, or has no valid value: see IPOPT's list"
            ) from None
    return options
