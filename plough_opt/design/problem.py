"""Design: variables, parameters, an objective and named requirements, solved by IPOPT."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from plough_opt.core.checks import (
    NOT_NUMBERS,
    check_callable,
    check_choice,
    check_kind,
    check_switch,
    check_text,
    mapping_of,
    plain_number,
    shown,
)
from plough_opt.core.errors import InputError, unprintable
from plough_opt.core.expressions import Column, Expression, is_casadi
from plough_opt.core.quantities import warn_of_slips
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display, has_unit, in_si, unit_of
from plough_opt.design.boxed import Over, ToleranceBoxSolver
from plough_opt.design.declarations import EVERYWHERE, Declarations, Parameter, Requirement, Variable
from plough_opt.design.effort import Search
from plough_opt.design.exploring import Progress, silent
from plough_opt.design.optimum import Optimum
from plough_opt.design.program import Program
from plough_opt.design.solving import Request, solve_program
from plough_opt.design.tolerance import Judge

Written: TypeAlias = Any
"""A number, a text such as "50 kN/m", or a pint quantity."""


class Design:
    """A design question: choose variables to minimise an objective subject to requirements.

    Declare variables and parameters, build share, scene and run from them exactly as from numbers, then say
    what to minimise and to require, and solve::

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
        self._over: Over | None = None
        self._program: Program | None = None
        self._boxed: ToleranceBoxSolver | None = None

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
            name: what to call it in reports.
            guess: where to start, between the bounds: in ``unit``, or with a unit of its own: a text such as "50 kN/m"
                or a pint quantity.
            lower: lower bound, likewise.
            upper: upper bound.
            unit: SI unit of the symbol, for reports; it need not be given where the numbers have units of their own.
            log: scale it by its logarithm: for a quantity whose bounds lie decades apart.
            tolerance: half width, in ``unit``, within which a workshop makes it, or a part of the value as "0.5 %". The
                optimum is judged over it. Default: 0.3 % of the range between the bounds, of the logarithm's with
                ``log``.
            domain: ends of the model's domain, in ``unit``: sensitivities hold no further than that.
            display: unit in which reports give it, if not a customary one.

        Raises:
            InputError: no name, or one declared before, a value that is not a number, plain numbers with a
                unit that is not SI, or bounds that contradict each other or the guess.
        """
        self._refuse_again(name)
        what = f"variable '{name}'"
        (at, low, high), unit, display = _read(what, name, unit, (guess, lower, upper), display, _ENDS)
        warn_of_slips(what, unit, (upper,))
        symbol = ca.MX.sym(name)
        if has_unit(tolerance) and not str(tolerance).rstrip().endswith("%"):
            tolerance = plain_number(what, in_si(what, tolerance, unit))
        ends = _ends(name, domain)
        self._variables.append(Variable(name, symbol, at, low, high, unit, log, tolerance, False, ends, display))
        self._program = None
        return symbol

    def parameter(
        self, name: str, value: Written, *, unit: str = "", domain: tuple[float, float] = EVERYWHERE
    ) -> ca.MX:
        """Declare a quantity that is fixed within a solve and may differ between solves; return its symbol.

        Args:
            name: what to call it in reports.
            value: its value, where a solve says nothing else: in ``unit``, or with a unit of its own.
            unit: SI unit, for reports.
            domain: ends of the model's domain, in ``unit``: sensitivities hold no further than that.

        Raises:
            InputError: a value that is not finite or lies outside the domain, a plain number with a unit that is not
                SI, or a name declared before.
        """
        self._refuse_again(name)
        (at,), unit, _ = _read(f"parameter '{name}'", name, unit, (value,), None)
        warn_of_slips(f"parameter '{name}'", unit, (value,))
        symbol = ca.MX.sym(name)
        self._parameters.append(Parameter(name, symbol, at, unit, _ends(name, domain)))
        self._program = None
        return symbol

    def minimise(self, objective: Expression, *, over: Over | None = None) -> None:
        """Say what to minimise: a scalar expression of the variables, best of order 1 when summed from parts.

        Args:
            objective: the expression.
            over: ``"worst"`` or ``"mean"``: minimise its largest value, or its mean, within the tolerances of the
                variables, and keep all requirements there. Of the box a fixed sample is taken: 64 designs where each
                has one run, fewer of several and of runs with events, 8 at least; the optimum says how many.

        Raises:
            InputError: not a scalar CasADi expression, or another word.
        """
        if over is not None:
            check_choice("over", over, ("worst", "mean"), ", within the tolerances, or None")
        self._objective = _expression("the objective", objective)
        if self._objective.numel() != 1:
            raise InputError(f"the objective must be one number, not {self._objective.numel()}: sum or average it")
        self._over = over
        self._program = None

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
            name: what to call it in reports.
            expression: scalar or column of the variables.
            at_least: lower limit in ``unit``, or with a unit of its own, such as "120 mm"; or None.
            at_most: upper limit, likewise.
            unit: SI unit of expression and limits, for reports; not needed where the limits have units of their own.
            display: unit in which reports give them, if not a customary one.

        Raises:
            InputError: no limit, or one that is not a number, plain limits with a unit that is not SI, limits that
                contradict each other, no name, or one used before.
        """
        self._refuse_again(name)
        (least, most), unit, display = _read(f"requirement '{name}'", name, unit, (at_least, at_most), display, _SIDES)
        self._requirements.append(
            Requirement(name, _expression(f"'{name}'", expression), least, most, unit, False, display)
        )
        self._program = None

    def solve(
        self,
        *,
        parameters: Mapping[str, float] | None = None,
        search: Search = "auto",
        judge: Judge = "tolerance",
        seed: int = 0,
        compiled: bool = False,
        progress: Progress | None = None,
    ) -> Optimum:
        """Find the best design; the model is built once and kept for further solves.

        Args:
            parameters: values of parameters that differ from the declared ones, by name.
            search: ``"auto"``: over all variables, by a sample, evolution and descents, after which IPOPT optimises
                what can be best; ``"thorough"``: four times as much of it; ``"near"`` or ``"local"``: the optimum of
                the guess's basin, never worse than a guess that meets the requirements, and from any other that of the
                nearest design that does; names of variables: over these alone, the others beginning at the guess; a
                number of designs to try, or a text such as ``"20 s"``. The same search gives the same answer, bit for
                bit, on any number of threads of a machine, one of a number of seconds excepted.
            judge: ``"tolerance"``: optima are compared by the median of their objective within the tolerances of the
                variables, so that one which no workshop can hit is not called best; ``"bare"``: by the objective.
            seed: of the samples; another one searches by others.
            compiled: translate the model into machine code first, by the system's C compiler. That takes seconds, once
                for a model (it is kept in the user's cache folder), and each solve a fraction of its time: for
                repeated solves. Without a compiler the model is interpreted, and a warning says so.
            progress: called with what is being done and the fraction done.

        Returns:
            The best optimum found, re-integrated tightly, with all local optima.

        Raises:
            InputError: nothing to minimise or to vary, an unknown name, or a model without a value at the start.
            InfeasibleDesign: no design meets the requirements; it names those that conflict, and by how much.
            NotConverged: the optimiser stopped without an optimum; it says why and what to do.
        """
        started = time.perf_counter()
        check_choice("judge", judge, ("tolerance", "bare"))
        check_switch("compiled", compiled)
        if progress is not None:
            check_callable("progress", progress, "of what is done and the fraction done")
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise InputError(f"seed = {shown(seed)} must be a whole number, not below 0")
        declared = self.declared
        values = declared.parameter_values(mapping_of("parameters", parameters, "name -> value"))
        if self._program is None or self._program.compiled != compiled:
            self._program, self._boxed = Program(declared, compiled=compiled), None
        request = Request(values, search, judge, seed, progress or silent, started)
        if self._over is None:
            found = solve_program(self._program, request)
        else:
            self._boxed = self._boxed or ToleranceBoxSolver(self._program, self._over)
            found = self._boxed.solve(request)
        own = {p.name: float(value) for p, value in zip(self._parameters, values, strict=True)}
        return replace(found, origin=Origin.now(declarations=declared.plain(own), seed=seed))

    @property
    def declared(self) -> Declarations:
        """All that was declared.

        Raises:
            InputError: nothing to minimise or to vary.
        """
        if self._objective is None:
            raise InputError("nothing to minimise: call design.minimise(...) before design.solve()")
        if not self._variables:
            raise InputError("nothing to choose: declare at least one design.variable(...)")
        return Declarations(tuple(self._variables), tuple(self._parameters), self._objective, tuple(self._requirements))

    def _refuse_again(self, name: str) -> None:
        _check_name(name)
        taken = [*(v.name for v in self._variables), *(p.name for p in self._parameters)]
        if name in [*taken, *(r.name for r in self._requirements)]:
            raise InputError(f"'{name}' is declared already: give each variable, parameter and limit a name of its own")


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
    """Return numbers in SI, their unit, and the unit in which reports give them."""
    check_text(f"unit of '{name}'", unit)
    check_kind(f"display of '{name}'", display, Display | None, "None or a Display, as Display('cm', 0.01)")
    unit, written = unit_of(what, unit, *values)
    numbers = [
        None if value is None and sides is _SIDES else plain_number(what + side, in_si(what + side, value, unit))
        for value, side in zip(values, sides, strict=False)
    ]
    return numbers, unit, display or written


def _ends(name: str, domain: Any) -> tuple[float, float]:
    """Return the ends of a domain, in order."""
    if not (isinstance(domain, tuple) and len(domain) == 2 and all(isinstance(end, int | float) for end in domain)):
        raise InputError(f"domain of '{name}' = {shown(domain)} must be its two ends, as (0.0, math.inf)")
    low, high = map(float, domain)
    if not low < high:
        raise InputError(f"domain of '{name}': its first end {low:g} must be below its second {high:g}")
    return low, high


def _check_name(name: Any) -> None:
    """Refuse what reports could not call anything by."""
    if not isinstance(name, str) or not name.strip() or unprintable(name, allowed=""):
        raise InputError(f"name = {shown(name)} must be a text that says what it is, as 'share height'")


def _expression(what: str, value: Column) -> ca.MX:
    """Return a value as a column of a design's expressions."""
    if isinstance(value, ca.SX):
        raise InputError(f"{what} is an SX expression: build it from this design's own variables, which are MX")
    if is_casadi(value):
        column: Column = ca.vec(ca.MX(value))
        return ca.MX(column)
    try:
        return ca.MX(ca.DM(np.atleast_1d(np.asarray(value, dtype=float))))
    except NOT_NUMBERS:
        raise InputError(f"{what}: {shown(value)} is neither an expression nor a number") from None
