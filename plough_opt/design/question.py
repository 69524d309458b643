"""Design: variables, parameters, an objective and named requirements, and their solve."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from plough_opt.core.checks import (
    array_of,
    check_kind,
    check_switch,
    check_text,
    mapping_of,
    pair_of,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, is_casadi
from plough_opt.core.process import without_notices
from plough_opt.core.quantities import warn_of_slips
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display, has_unit, in_si, unit_of
from plough_opt.design.declarations import EVERYWHERE, Declarations, Parameter, Requirement, Variable
from plough_opt.design.model.ipopt import Vector
from plough_opt.design.model.program import Program
from plough_opt.design.result.optimum import Optimum
from plough_opt.design.search.effort import Search, TimeLimit
from plough_opt.design.search.explore import Progress, notifier
from plough_opt.design.solving import Request, solve_program

Written: TypeAlias = Any
"""A number, a text such as "50 kN/m", or a pint quantity."""


class Design:
    """A design question: choose variables to minimise an objective subject to requirements.

    Declare variables and parameters, build share, scene and run from them just as from numbers, state the objective and
    the requirements, and solve::

        d = Design()
        height = d.variable("height", guess=0.25, lower=0.10, upper=0.50, unit="m")
        ...
        d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
        d.require("loosened radius", loosened_radius(cone, soil), at_least=0.12, unit="m")
        best = d.solve()

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> round(best.variables["height"], 9)
        0.12
    """

    def __init__(self) -> None:
        self._variables: list[Variable] = []
        self._parameters: list[Parameter] = []
        self._requirements: list[Requirement] = []
        self._objective: ca.MX | None = None
        self._program: Program | None = None

    def variable(
        self,
        name: str,
        *,
        guess: Written,
        lower: Written,
        upper: Written,
        unit: str = "",
        log: bool = False,
        tolerance: float | str | None = None,
        domain: tuple[float, float] = EVERYWHERE,
        display: Display | None = None,
    ) -> ca.MX:
        """Declare a quantity to choose, and return its CasADi symbol.

        Args:
            name: name in reports.
            guess: start value, between the bounds: a number in ``unit``, a text such as "50 kN/m", or a pint quantity.
            lower: lower bound, likewise.
            upper: upper bound, likewise.
            unit: SI unit of the symbol, for reports; not needed if the numbers have units.
            log: scale the variable by its logarithm, for bounds that are decades apart.
            tolerance: half width, in ``unit``, of the band that a workshop keeps, or a percentage of the value such as
                "0.5 %", for the ``spread`` of optima. Default: 0.3 % of the range between the bounds, or of the range
                of the logarithm with ``log``.
            domain: ends of the model's domain, in ``unit``; sensitivities are valid only within it.
            display: unit in reports, if not the customary one.

        Raises:
            InputError: the name is missing or was declared before, a value is not a number, ``unit`` is not an SI unit
                although numbers are plain, the bounds contradict each other, the guess or ``log``, or tolerance or
                domain is not valid.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> stiffness = design.variable("stiffness", guess="50 kN/m", lower="5 kN/m", upper="500 kN/m", log=True)
            >>> stiffness.shape
            (1, 1)
        """
        self._refuse_again(name)
        what = f"variable '{name}'"
        (at, low, high), unit, display = _read(what, name, unit, (guess, lower, upper), display, _ENDS)
        warn_of_slips(what, unit, (upper,))
        symbol = ca.MX.sym(name)
        if has_unit(tolerance) and not str(tolerance).rstrip().endswith("%"):
            tolerance = plain_number(what, in_si(what, tolerance, unit))
        ends = pair_of(f"domain of '{name}'", domain)
        self._variables.append(Variable(name, symbol, at, low, high, unit, log, tolerance, ends, display))
        self._program = None
        return symbol

    def parameter(
        self, name: str, value: Written, *, unit: str = "", domain: tuple[float, float] = EVERYWHERE
    ) -> ca.MX:
        """Declare a quantity with a fixed value in each solve, and return its CasADi symbol.

        Args:
            name: name in reports.
            value: value by default: a number in ``unit``, a text such as "50 kN/m", or a pint quantity.
            unit: SI unit, for reports.
            domain: ends of the model's domain, in ``unit``; sensitivities are valid only within it.

        Raises:
            InputError: the value is not finite or lies outside the domain, ``unit`` is not an SI unit although the
                value is a plain number, or the name was declared before.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> least = design.parameter("least", "60 mm", unit="m")
            >>> design.require("half of it above the least", height / 2.0 - least, at_least="0 mm")
            >>> design.minimise(height**2)
            >>> [round(design.solve(parameters={"least": size}).variables["height"], 6) for size in ("60 mm", "80 mm")]
            [0.12, 0.16]
        """
        self._refuse_again(name)
        (at,), unit, _ = _read(f"parameter '{name}'", name, unit, (value,), None)
        warn_of_slips(f"parameter '{name}'", unit, (value,))
        symbol = ca.MX.sym(name)
        self._parameters.append(Parameter(name, symbol, at, unit, pair_of(f"domain of '{name}'", domain)))
        self._program = None
        return symbol

    def minimise(self, objective: Expression) -> None:
        """Set the objective to minimise.

        Args:
            objective: scalar expression of the variables. In a sum of parts each should be of order 1.

        Raises:
            InputError: the objective is not a scalar CasADi expression or number.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise(height**2)
            >>> round(design.solve(search="near").objective, 6)
            0.01
        """
        expression = _expression("the objective", objective)
        if expression.numel() != 1:
            raise InputError(f"the objective must be one number, not {expression.numel()}: sum or average it")
        self._objective, self._program = expression, None

    def require(
        self,
        name: str,
        expression: Expression,
        *,
        at_least: Written | None = None,
        at_most: Written | None = None,
        unit: str = "",
        display: Display | None = None,
    ) -> None:
        """Require an expression to stay within limits; a column, such as a run's deflection, in every entry.

        Args:
            name: name in reports.
            expression: scalar or column of the variables.
            at_least: lower limit: a number in ``unit``, a text such as "120 mm", a pint quantity, or None.
            at_most: upper limit, likewise.
            unit: SI unit of expression and limits, for reports; not needed if the limits have units.
            display: unit in reports, if not the customary one.

        Raises:
            InputError: there is no limit, a limit is not a number, ``unit`` is not an SI unit although limits are plain
                numbers, the limits contradict each other, or the name is missing or was declared before.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.require("half of it", height / 2.0, at_least="60 mm")
            >>> design.minimise(height**2)
            >>> design.solve(search="near").active
            ('half of it',)
        """
        self._refuse_again(name)
        (least, most), unit, display = _read(f"requirement '{name}'", name, unit, (at_least, at_most), display, _SIDES)
        self._requirements.append(Requirement(name, _expression(f"'{name}'", expression), least, most, unit, display))
        self._program = None

    def solve(
        self,
        *,
        parameters: Mapping[str, Written] | None = None,
        search: Search = "auto",
        seed: int = 0,
        compiled: bool = False,
        progress: Progress | None = None,
        ipopt: Mapping[str, Any] | None = None,
    ) -> Optimum:
        """Find the best design; the model is built once and kept for further solves.

        Args:
            parameters: name -> value of the parameters that differ from their declaration, as given to `parameter`.
            search: extent of the search.

                * ``"auto"``: all variables, by a sample, evolution and descents; IPOPT then optimises the basins that
                  can be best. After 20 s of processor time no further part of the search begins, nor a refinement of
                  its integration steps or a catalogue value: the best design so far is checked, and one of its warnings
                  names what was left out.
                * ``"thorough"``: the same with four times the effort.
                * ``"near"`` or ``"local"``: the optimum in the basin of the guess, never worse than a guess that meets
                  the requirements. From any other guess it starts at the nearest design that meets them.
                * names of variables: these alone, with the others starting at the guess.
                * a number of designs, or a time such as ``"20 s"`` or ``"5 min"``, after which no further round of the
                  search begins. The first round is always completed: it samples at most this number of designs, a power
                  of two from 8 on, and the descents from the best of them try more; the search's record counts all.

                The same search gives the same answer, bit for bit, on any number of threads of a machine, except for a
                search limited by time.
            seed: seed of the samples.
            compiled: translate the model into machine code first, with the system's C compiler. That takes some seconds
                once (the code is kept in the user's cache folder), and each solve then takes a fraction of its time, so
                it pays for repeated solves. Without a compiler the model is interpreted, with a warning.
            progress: called with what is being done and the fraction done.
            ipopt: name -> value of options of IPOPT, such as ``{"linear_solver": "ma57", "print_level": 5}``, for every
                solve by IPOPT. Tolerances, scaling, the treatment of bounds and the choice of derivatives cannot be
                changed. Other options than in the last solve build the model anew.

        Returns:
            The best optimum found, with its objective by a tight integration, and all local optima.

        Raises:
            InputError: there is nothing to minimise or to vary, a name is unknown, a parameter's value or an option is
                not valid, or the model has no value at the start.
            DomainError: the bounds exceed the model's domain, or a motion is too fast to integrate.
            InfeasibleDesign: no design meets the requirements; the error names the conflicting ones and their
                violations.
            NotConverged: the optimiser stopped without an optimum; the error says why and what to do.

        Example:
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise((height - 0.3) ** 2)
            >>> round(design.solve().variables["height"], 6)
            0.3
        """
        started, limit = time.perf_counter(), TimeLimit(search)
        check_switch("compiled", compiled)
        progress, seed = notifier(progress), whole_number("seed", seed)
        declared, options = self.declared, ipopt_options(ipopt)
        values = declared.parameter_values(mapping_of("parameters", parameters, "name -> value"))
        if self._program is None or (self._program.compiled, self._program.ipopt) != (compiled, options):
            self._program = Program.of(declared, compiled=compiled, ipopt=options)
        request = Request(values, search, seed, progress, started, limit)
        with without_notices():
            best = solve_program(self._program, request)
        return replace(best, origin=Origin(declarations=declared.plain(values), seed=seed).now())

    def nlp(self, *, parameters: Mapping[str, Written] | None = None) -> NonlinearProgram:
        """Return the design as a program of CasADi, for another solver or as a part of a larger program.

        Its runs take as many integration steps as the guess and the bounds need. No search, check of the steps or
        certificate comes with it.

        Args:
            parameters: name -> value of the parameters that differ from their declaration, as given to `parameter`.

        Returns:
            The problem ``{x, f, g, p}`` in scaled variables, with guess, bounds, limits and scales.

        Raises:
            InputError: there is nothing to minimise or to vary, a name is unknown, a parameter's value is not
                valid, or the model has no value at the guess.
            DomainError: the bounds exceed the model's domain, or a motion is too fast to integrate.

        Example:
            >>> import casadi as ca
            >>> import plough_opt as po
            >>> design = po.Design()
            >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
            >>> design.minimise((height - 0.3) ** 2)
            >>> nlp = design.nlp()
            >>> silent = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
            >>> solver = ca.nlpsol("solver", "ipopt", nlp.problem, silent)
            >>> round(nlp.variables(solver(**nlp.arguments)["x"])["height"], 6)
            0.3
        """
        declared = self.declared
        p = declared.parameter_values(mapping_of("parameters", parameters, "name -> value"))
        return NonlinearProgram.of(self._program or Program.of(declared), p)

    @property
    def declared(self) -> Declarations:
        """All declarations.

        Raises:
            InputError: there is nothing to minimise or to vary.
        """
        if self._objective is None:
            raise InputError("nothing to minimise: call design.minimise(...) before design.solve()")
        if not self._variables:
            raise InputError("nothing to choose: declare at least one design.variable(...)")
        return Declarations(tuple(self._variables), tuple(self._parameters), self._objective, tuple(self._requirements))

    def _refuse_again(self, name: str) -> None:
        check_text("name", name, blank=False)
        taken = [*(v.name for v in self._variables), *(p.name for p in self._parameters)]
        if name in [*taken, *(r.name for r in self._requirements)]:
            raise InputError(f"'{name}' is declared already: variables, parameters and requirements need unique names")


_SIDES = (": at_least", ": at_most")
_ENDS = (": guess", ": lower", ": upper")


def _read(
    what: str,
    name: str,
    unit: str,
    values: Sequence[Written | None],
    display: Display | None,
    sides: Sequence[str] = ("",),
) -> tuple[list[Any], str, Display | None]:
    """Return values as numbers in SI, their unit, and the unit in reports.

    Args:
        what: what is declared, for messages.
        name: its name.
        unit: SI unit of plain numbers.
        values: numbers or quantities; None is allowed for the sides of a requirement.
        display: unit in reports, or None for the unit of the values.
        sides: for each value, its argument, for messages.
    """
    check_text(f"unit of '{name}'", unit)
    check_kind(f"display of '{name}'", display, Display | None, "None or a Display such as Display('cm', 0.01)")
    unit, written = unit_of(what, unit, *values)
    numbers = [
        None if value is None and sides is _SIDES else plain_number(what + side, in_si(what + side, value, unit))
        for value, side in zip(values, sides, strict=False)
    ]
    return numbers, unit, display or written


def _expression(what: str, value: Column) -> ca.MX:
    """Return an expression, a number or an array as one column of type MX."""
    if isinstance(value, ca.SX):
        raise InputError(f"{what} is an SX expression: build it from this design's own variables, which are MX")
    if is_casadi(value):
        column: Column = ca.vec(ca.MX(value))
        return ca.MX(column)
    return ca.MX(ca.DM(array_of(value, f"{what}: {{}} is neither an expression nor a number").ravel()))


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
        declared, n = program.declared, len(program.declared.variables)
        x, symbols = ca.MX.sym("x", n), ca.MX.sym("p", len(p))
        f, g = program.built.nlp.values(x, symbols)
        return cls(
            {"x": x, "p": symbols, "f": f, "g": g},
            program.start(),
            np.zeros(n),
            np.ones(n),
            program.low,
            program.high,
            p,
            program.objective_scale,
            program.row_scales,
            tuple(declared.requirements[k].name for k in program.owner),
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
        count = len(self.x0)
        numbers = array_of(x, f"x = {{}} must hold {count} scaled variables", lambda array: array.size == count).ravel()
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
