"""Building of a component: a scene by names, over the whole box of its inputs, as many steps as it needs, its results.

Each Function consists of small scalar graphs around one loop over the integration steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.checks import (
    DomainLimit,
    check_kind,
    check_named,
    check_single,
    plain_number,
    shown,
    whole_number,
)
from plough_opt.core.errors import DomainError, InputError, IntegrationError, PloughError
from plough_opt.core.expressions import (
    Column,
    Expression,
    as_number,
    holds_casadi,
    is_casadi,
    is_symbolic,
    map_expressions,
    stacked,
    template_of,
)
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES, Quantity
from plough_opt.exchange.component import (
    Component,
    Input,
    Output,
    Port,
    check_names,
    corner_points,
    identifier,
    interior_points,
    measure_of,
    point_text,
    port_of,
)
from plough_opt.laws.law import too_blunt
from plough_opt.motion import OUTPUTS, Run
from plough_opt.motion.effects.terms import Parameters
from plough_opt.motion.equation import Structure, parameters
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.scene import Scene, duration_of, quantities_of, with_quantities
from plough_opt.motion.simulation import repeat
from plough_opt.motion.solvers import plan
from plough_opt.motion.solvers.checks import refuse_runaway
from plough_opt.motion.solvers.derivatives import derivative_error
from plough_opt.motion.solvers.integrators import Case, Integration, assemble, integration, quasi_static
from plough_opt.motion.solvers.steps import Timeline
from plough_opt.motion.solvers.verified import agreement
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT

DURATION, FRAME, STEEL = BESIDE
# If the frame has no mass, rounding may make the moving mass smaller than the share's by this part.
_MASS_ROUNDING = 1e-12


@dataclass(frozen=True)
class NamedScene:
    """A scene and its duration, with access to quantities by name, such as "share.height" and "scene.duration".

    Args:
        scene: the scene, numeric or symbolic.
        duration: simulated time [s], or None.
        steel_density: density of the share's material [kg/m^3]. The scene's mass is then the sum of "scene.frame_mass"
            and of a share of "scene.steel_density". None: the mass is one quantity, "scene.mass".
        symbols: name -> CasADi symbol in scene and duration, which can be replaced by this name.

    Raises:
        InputError: a share that is heavier than the whole moving mass; a steel density with a symbolic mass or share;
            a symbol that is not in the scene, or one in the scene that is not given.
        DomainError: a density outside its domain.
    """

    scene: Scene
    duration: Expression | None = None
    steel_density: float | None = None
    symbols: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.symbols and not self._expressions:
            raise InputError(f"the scene does not hold the symbol of input '{next(iter(self.symbols))}': it is numeric")
        known = {hash(symbol) for symbol in self.symbols.values()}
        present = [symbol for one in self._expressions if is_symbolic(one) for symbol in ca.symvar(one)]
        if others := {symbol.name() for symbol in present if hash(symbol) not in known}:
            raise InputError(f"the scene holds symbols that are not inputs, {', '.join(sorted(others))}: make each one")
        if self.steel_density is None:
            return
        if holds_casadi((self.scene.mass, self.scene.share)):
            raise InputError("steel_density needs a numeric scene: let the mass expression include the share's")
        BESIDE[STEEL].check(self.steel_density)
        share = self.scene.cone.solid_mass(self.steel_density)
        if self.scene.mass < (1.0 - _MASS_ROUNDING) * share:
            given = f"a share of {self.steel_density:.6g} kg/m^3 has {share:.6g} kg, more than the whole moving mass"
            raise InputError(f"{given} of {self.scene.mass:.6g} kg: give both together, or leave steel_density out")

    @cached_property
    def _expressions(self) -> list[Any]:
        """The CasADi expressions in scene and duration."""
        return [*filter(is_casadi, template_of((self.scene, self.duration))[1])]

    @cached_property
    def _of_symbols(self) -> ca.Function:
        """Function of the symbols that returns the expressions in scene and duration."""
        function = ca.Function("quantities", [*self.symbols.values()], self._expressions)
        return function if function.is_a("SXFunction") else function.expand()

    @cached_property
    def values(self) -> dict[str, Expression]:
        """Name -> value of every quantity of the scene."""
        values = {name: value for name, value in quantities_of(self.scene).items() if value is not None}
        if self.steel_density is not None:
            frame = values.pop("scene.mass") - self.scene.cone.solid_mass(self.steel_density)
            values |= {FRAME: max(float(frame), 0.0), STEEL: self.steel_density}
        return values if self.duration is None else values | {DURATION: self.duration}

    def value(self, name: str) -> Expression:
        """Return a quantity.

        Raises:
            InputError: an unknown name, or a quantity that the scene does not have.
        """
        if name in self.values:
            return self.values[name]
        check_named("no quantity is named {}", name, EVERY)
        if name in (FRAME, STEEL):
            raise InputError(f"'{name}' needs a steel_density, which divides the mass into frame and share: give one")
        if name == "scene.mass":
            raise InputError(f"'scene.mass' follows from steel_density and '{FRAME}': use '{FRAME}'")
        raise InputError(f"the scene has no '{name}': give it one, or leave the name out")

    def replaced(self, changes: Mapping[str, Expression]) -> tuple[Scene, Expression | None]:
        """Return scene and duration with other values, numbers or expressions.

        Args:
            changes: name -> value of every symbol, and of any quantities to change.
        """
        scene, duration = self.scene, self.duration
        if self._expressions:
            given: list[Column] = [changes[name] for name in self.symbols]
            results = iter(self._of_symbols.call(given))
            scene, duration = map_expressions((scene, duration), lambda _: _simple(next(results)))
        own = {name: value for name, value in changes.items() if name not in self.symbols}
        scene = with_quantities(scene, {name: value for name, value in own.items() if name in QUANTITIES})
        if self.steel_density is not None:
            values = {**self.values, **own}
            scene = replace(scene, mass=values[FRAME] + scene.cone.solid_mass(values[STEEL]))
        return scene, own.get(DURATION, duration)


def _simple(value: Expression) -> Expression:
    return value if is_symbolic(value) else float(as_number(value))


MakeScene = Callable[[Mapping[str, Expression]], tuple[Scene, Expression | None]]
"""Values of the inputs by name, numbers or symbols -> scene and duration [s] or None."""

Results = Mapping[str, Callable[[Run], Expression]]
"""Name of each result -> its value in a symbolic run, a scalar or a column."""

_MOST_COMPONENT_STEPS = 50_000
# Limit on the number of times that the number of steps is raised.
_MOST_ROUNDS = 6
# A share retreats if its speed falls below minus this part of its largest speed; less is rounding.
_RETREAT_IN_BOUNDS = 1e-6
_Request = TypeVar("_Request", Input, Output)


@dataclass(frozen=True)
class Scenes:
    """The scenes that a component's inputs describe.

    Attributes:
        name: name of every Function made here.
        inputs: names, units, bounds and values.
        make: values of the inputs -> scene and duration.

    Raises:
        InputError: a scene that fixed steps cannot integrate, or one without a duration.
    """

    name: str
    inputs: tuple[Port, ...]
    make: MakeScene

    def __post_init__(self) -> None:
        effects = self.scene.effects
        if effects.events:
            what = "a share that enters the soil" if effects.entry else "stick and slip"
            raise InputError(
                f"{what} cannot be a component: its events need an adaptive integrator, and a component's steps are"
                " fixed; use contact = Smooth(width) and no entry, or simulate the scene itself"
            )

    @cached_property
    def scene(self) -> Scene:
        """The scene at the inputs' values."""
        return self.at([port.value for port in self.inputs])[0]

    def at(self, x: Sequence[Expression]) -> tuple[Scene, Expression]:
        """Return scene and duration at values of the inputs, given in order.

        Raises:
            InputError: the duration is missing, or it is given for a periodic orbit.
        """
        scene, duration = self.make({port.name: value for port, value in zip(self.inputs, x, strict=True)})
        return scene, duration_of(scene, duration)

    @cached_property
    def _symbolic(self) -> tuple[Any, list[Any], Scene, Expression, Parameters]:
        """Return the CasADi type, a symbol of it for each input; scene, duration and parameters of these symbols."""
        # In MX a law with large sums or loops stays one node; SX would unroll it.
        kind: Any = ca.SX if self.scene.law.scalar else ca.MX
        x = [kind.sym(port.argument) for port in self.inputs]
        scene, duration = self.at(x)
        return kind, x, scene, duration, parameters(scene)

    def function(self, results: Results, steps: int, outputs: int) -> ca.Function:
        """Return results of a run, each a dense column, as a Function of the inputs.

        Inputs that a caller omits have their values.

        Args:
            results: the results by name.
            steps: number of steps of order 8, or of panels of a quasi-static average.
            outputs: number of equal intervals between output times.
        """
        kind, x, scene, duration, p = self._symbolic
        arguments, names = [port.argument for port in self.inputs], list(results)
        options = {"default_in": [port.value for port in self.inputs]}

        def columns(run: Run) -> list[Any]:
            return [ca.densify(ca.vec(kind(result(run)))) for result in results.values()]

        if not scene.effects.motion:
            run = quasi_static(scene, p, duration, self._timeline(steps, outputs), Accuracy())
            return ca.Function(self.name, x, columns(run), arguments, names, options)
        # Three Functions are chained: inputs -> parameters -> motion (the loop over the steps) -> results.
        solver, parameters_of = self._motion(steps, outputs)
        integrate = solver.function
        motion = [kind.sym(f"o{k}", *integrate.size_out(k)) for k in range(integrate.n_out())]
        states, means, variances = motion
        fractions = solver.timeline.output_fractions
        run = assemble(scene, p, duration, fractions, states.T, means, variances, solver.accuracy)
        results_of = ca.Function("results", [*x, *motion], columns(run))
        symbols = [ca.MX.sym(argument) for argument in arguments]
        values = results_of.call([*symbols, *integrate.call(parameters_of.call(symbols))])
        return ca.Function(self.name, symbols, values, arguments, names, options)

    def domain(self) -> tuple[tuple[DomainLimit, ...], ca.Function]:
        """Return the limits of the law of resistance, and a Function from the inputs to the limited values."""
        kind, x, *_ = self._symbolic
        limits = [(limit, value) for limit, value in self.at(x)[0].limits() if is_symbolic(value)]
        column = ca.vertcat(kind(), *(value for _, value in limits))
        return tuple(limit for limit, _ in limits), ca.Function("domain", x, [column])

    def gives_columns(self, results: Results) -> bool:
        """Return whether any result is a column over the output times."""
        # The shortest run has two output times, at start and end: a result with a value at each has two rows.
        function = self.function(results, 1, 1)
        return any(function.numel_out(k) > 1 for k in range(function.n_out()))

    def _motion(self, steps: int, outputs: int) -> tuple[Integration, ca.Function]:
        """Return the integration of a run, and a Function from the inputs to its parameters, the duration last."""
        _, x, scene, duration, p = self._symbolic
        timeline = self._timeline(steps, outputs)
        solver = integration(Structure.of(scene), Accuracy("dop853", steps=timeline.steps), timeline)
        return solver, ca.Function("parameters", x, [stacked(*(p[key] for key in solver.names), duration)])

    def _timeline(self, steps: int, outputs: int) -> Timeline:
        """Return the times of a run of symbols."""
        _, _, scene, duration, _ = self._symbolic
        # Outputs at start and end alone need no interpolation between steps.
        method: str | None = "dop853" if scene.effects.motion and outputs > 1 else None
        return plan.timeline_of(scene, duration, outputs, steps, method)

    def derivative_error(self, steps: int, outputs: int, columns: Sequence[Sequence[float]]) -> float:
        """Return the largest relative error of the motion's derivatives, for columns of its parameters."""
        solver, parameters_of = self._motion(steps, outputs)
        varying = {row for k in range(parameters_of.n_in()) for row in parameters_of.jac_sparsity(0, k).row()}
        # Without output times between the ends only the averages are used: skip the states.
        first = solver.function.numel_out(0) if outputs == 1 else 0
        return derivative_error(solver, first, tuple(sorted(varying)), np.array(columns).T)


def _resolved(scenes: Scenes, accuracy: Accuracy, outputs: int) -> tuple[int, float, tuple[str, ...]]:
    """Return the steps, or panels, that reach the wanted error between the bounds, that error [-], and warnings.

    A number of steps in the accuracy is used as it is.

    Raises:
        DomainError: bounds outside the model's domain, or a motion that is not finite or takes too many steps.
    """
    cases, wanted, runs, notes = _cases(scenes, outputs), accuracy.error or DEFAULT_ERROR, list[Run](), list[str]()

    def error_of(steps: int) -> float:
        runs[:], errors = zip(*(_run(where, case, steps) for where, case in cases.items()), strict=True)
        return float(max(errors))

    def refined(steps: int, error_of: Callable[[int], float], wanted: float) -> tuple[int, float]:
        error = error_of(steps)
        for _ in range(_MOST_ROUNDS):
            if error <= wanted or accuracy.steps is not None or 2 * steps > _MOST_COMPONENT_STEPS:
                break
            # The error of order 8 falls with the eighth power of the steps. Take a tenth more, at most twice as many.
            steps = math.ceil(steps * min(2.0, 1.1 * (error / wanted) ** 0.125))
            error = error_of(steps)
        return steps, error

    moves = scenes.scene.effects.motion
    guesses = {where: _first_guess(case) for where, case in cases.items()}
    fastest = max(guesses, key=guesses.__getitem__)
    if moves and accuracy.steps is None and guesses[fastest] > _MOST_COMPONENT_STEPS:
        raise DomainError(
            f"at {fastest} the share oscillates so fast that the run would take {guesses[fastest]} steps: narrow the"
            " bounds on stiffness and mass, shorten the duration, or use the quasi-static scene"
        )
    steps, error = refined(accuracy.steps or guesses[fastest], error_of, wanted)
    if error > wanted:
        notes.append(f"the wanted relative error {wanted:.1e} was not reached: the estimate is {error:.1e}")
    if moves:
        wanted, columns = accuracy.wanted_derivatives, [case.column for case in cases.values()]
        steps, of_slopes = refined(steps, lambda steps: scenes.derivative_error(steps, outputs, columns), wanted)
        if of_slopes > wanted:
            notes.append(f"derivatives have an error of {of_slopes:.1e}, not the wanted {wanted:.1e}")
    return steps, error, (*_warnings(scenes.scene, dict(zip(cases, runs, strict=True))), *notes)


def _cases(scenes: Scenes, outputs: int) -> dict[str, Case]:
    """Return values of the inputs in words -> the scene and duration there, at corners and inside the box.

    Raises:
        DomainError: a scene outside the model's domain.
    """
    inputs, cases = scenes.inputs, dict[str, Case]()
    # Panels of a quasi-static average err by rounding, so the corners suffice.
    for x in [*corner_points(inputs), *(interior_points(inputs) if scenes.scene.effects.motion else ())]:
        where = point_text(inputs, x)
        try:
            scene, duration = scenes.at(x.tolist())
            case = Case.of(scene, float(as_number(duration)), outputs)
            scene.check_reaction()
            refuse_runaway(scene, case.duration)
        except PloughError as error:
            raise DomainError(f"at {where}: {error}; give the inputs narrower bounds") from None
        cases[where] = case
    return cases


def _first_guess(case: Case) -> int:
    """Return the steps, or panels, that a scene usually needs."""
    if not case.scene.effects.motion:
        return plan.steps_for(plan.rates_of(case.scene).forced * case.duration)
    return max(plan.steps_for(case.phase, 0.8), plan.fewest_steps(case.p))


def _run(where: str, case: Case, steps: int) -> tuple[Run, float]:
    """Return a scene's run by a number of steps, and its estimated relative error [-].

    Raises:
        DomainError: it has no finite values.
    """
    setting = Accuracy("dop853", steps=steps)
    try:
        if case.scene.effects.motion:
            return agreement(case, setting, plan.finer(setting), 1.0)
        run = repeat(case.scene, case.duration, outputs=case.outputs)
        return run, run.error_estimate or 0.0
    except IntegrationError as failed:
        raise DomainError(f"at {where}: {failed}; give the inputs narrower bounds") from None


def _warnings(scene: Scene, runs: Mapping[str, Run]) -> Iterator[str]:
    """Yield warnings about the scene at the inputs' values, and about those between the bounds."""
    own = scene.warnings()
    yield from own
    bluntest = max(float(as_number(run.scene.cone.half_angle)) for run in runs.values())
    if scene.law.slender and bluntest > PLANE_SECTIONS_LIMIT and not any("plane sections" in note for note in own):
        yield f"within the bounds the half angle reaches {too_blunt(bluntest)}"
    lowest = {where: float(np.min(run.speed)) for where, run in runs.items()}
    slowest = min(lowest, key=lowest.__getitem__)
    if lowest[slowest] < -_RETREAT_IN_BOUNDS * np.max(np.abs(runs[slowest].speed)):
        where = f"as at {slowest} at up to {-lowest[slowest]:.3g} m/s"
        yield f"within the bounds the share retreats, {where}, and this contact law ignores the gap that it leaves"


def component(
    scene: Scene,
    duration: Expression | None = None,
    *,
    inputs: Sequence[str | Input],
    outputs: Sequence[str | Output],
    steel_density: float | None = None,
    accuracy: Accuracy | None = None,
    samples: int = OUTPUTS,
    name: str = "share",
) -> Component:
    """Return a scene as one CasADi Function of some of its quantities.

    Args:
        scene: a numeric scene, some of whose quantities become inputs; or one with CasADi symbols, each given as the
            symbol of an `Input`.
        duration: simulated time [s]. Omit it for a periodic orbit, which lasts one wavelength of the soil strength.
        inputs: names of quantities, as in problem files ("share.height", "soil.cohesion", "scene.duration"), or
            each an `Input` with bounds. The bounds determine the number of steps.
        outputs: names of results, as in problem files ("mean_draft", "deflection"), or each an `Output`.
        steel_density: density of the share's material [kg/m^3]. The mass then follows the share's volume, the rest of
            the scene's mass is the frame's, and "scene.frame_mass" and "scene.steel_density" can be inputs. Default:
            the mass is constant.
        accuracy: an error to reach, or ``"dop853"`` with a number of steps. Default: a relative error of 1e-8, and
            1e-6 for derivatives, checked at corners of the bounds and at points inside.
        samples: number of equal intervals between the output times, for results with a value at every output time.
        name: the Function's name.

    Raises:
        InputError: an unknown name, an input without bounds, or a scene that cannot be such a Function; the message
            says why.
        DomainError: bounds outside the model's domain.

    Example:
        >>> import plough_opt as po
        >>> soil, cone = po.named_soil("serozem"), po.Cone("10 deg", "25 cm")
        >>> scene = po.Scene(soil, cone, 5e4, 30.0, 2.0, po.Effects(motion=False))
        >>> made = po.component(scene, 1.0, inputs=["share.height"], outputs=["mean_draft"])
        >>> made.outputs[0].unit
        'N'
    """
    duration = None if duration is None else BESIDE["scene.duration"].read(duration)
    check_single("a component", (scene, duration))
    density = None if steel_density is None else plain_number("steel_density", steel_density)
    requested = _requests(inputs, Input)
    check_names("input", [one.name for one in requested])
    symbol_ports = {one.name: _symbol_port(one) for one in requested if one.symbol is not None}
    symbols = {one.name: one.symbol for one in requested if one.symbol is not None}
    named = NamedScene(scene, duration, density, symbols)
    ports = [symbol_ports.get(one.name) or _quantity_port(one, named) for one in requested]
    notes = _mass_notes(named, [port.name for port in ports])
    return build(named.replaced, ports, outputs, accuracy=accuracy, samples=samples, name=name, notes=notes)


def build(
    make_scene: MakeScene,
    inputs: Sequence[Port],
    outputs: Sequence[str | Output],
    *,
    accuracy: Accuracy | None = None,
    samples: int = OUTPUTS,
    name: str = "share",
    notes: Sequence[str] = (),
) -> Component:
    """Return a component whose scenes a callable makes; `component` describes the other arguments.

    Args:
        make_scene: values of the inputs by name, numbers or symbols -> scene and duration.
        inputs: names, units, bounds and values.
        outputs: names of results, or `Output`s.
        accuracy: error to reach, or steps.
        samples: number of equal intervals between output times.
        name: the Function's name.
        notes: warnings to add to those about the scenes.
    """
    if not isinstance(name, str) or not ca.Function.check_name(name):
        raise InputError(f"name = {shown(name)} cannot be the name of a CasADi Function: use letters, digits, _")
    requested = _requests(outputs, Output)
    check_names("output", [one.name for one in requested])
    check_names("input or output", [*(port.name for port in inputs), *(one.name for one in requested)])
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, "a po.Accuracy(...)")
    if not accuracy.order_8:
        raise InputError(f"method '{accuracy.method}' has no fixed steps, as a component needs: use 'auto' or 'dop853'")
    whole_number("samples", samples, 1)
    scenes = Scenes(name, tuple(inputs), make_scene)
    measures = [measure_of(one, scenes.scene.law) for one in requested]
    results = {identifier(one.name): value_of for one, (_, value_of) in zip(requested, measures, strict=True)}
    # Averages alone need no output times between start and end.
    intervals = samples if scenes.gives_columns(results) else 1
    steps, error, warnings = _resolved(scenes, accuracy, intervals)
    function = scenes.function(results, steps, intervals)
    values = function.call([port.value for port in inputs])
    output_ports = [
        Port(one.name, unit, one.lower, one.upper, _largest(one, value), value.numel())
        for one, (unit, _), value in zip(requested, measures, values, strict=True)
    ]
    used = Accuracy("dop853", steps=steps) if scenes.scene.effects.motion else Accuracy()
    return Component(function, scenes.inputs, tuple(output_ports), used, error, (*warnings, *notes), scenes.domain())


def _largest(output: Output, values: ca.DM) -> float:
    """Return the largest value of an output."""
    if not values.is_regular():
        raise DomainError(f"'{output.name}' has no finite value at the inputs' values: check its definition")
    return float(ca.mmax(values))


def _requests(given: Any, kind: type[_Request]) -> list[_Request]:
    """Return requested inputs or outputs as a list; a name stands for an input or output with defaults."""
    word = kind.__name__
    check_kind(f"{word.lower()}s", given, str | Sequence, f"a list of names, or of po.{word}(name, ...)")
    requests = [kind(one) if isinstance(one, str) else one for one in ([given] if isinstance(given, str) else given)]
    for one in requests:
        check_kind(word.lower(), one, kind, f"a name, or po.{word}(name, ...)")
    return requests


def _quantity_port(request: Input, named: NamedScene) -> Port:
    """Return the port of a quantity of the scene."""
    value = named.value(request.name)
    if request.value is None and is_symbolic(value):
        raise InputError(f"'{request.name}' is an expression in the scene: make its symbol the input, or give a value")
    return port_of(request, EVERY[request.name], value)


def _symbol_port(request: Input) -> Port:
    """Return the port of a symbol, whose default value is the middle of its bounds."""
    symbol: Any = request.symbol
    if not (is_symbolic(symbol) and symbol.is_valid_input() and symbol.numel() == 1):
        raise InputError(f"input '{request.name}': its symbol must be a scalar CasADi symbol that the scene contains")
    if request.lower is None or request.upper is None:
        raise InputError(f"input '{request.name}' needs lower and upper: a symbol has no value to derive them from")
    middle = (request.lower + request.upper) / 2.0
    return port_of(request, Quantity(request.name, "", request.unit or "", middle, request.name, ()), middle)


def _mass_notes(named: NamedScene, inputs: Sequence[str]) -> tuple[str, ...]:
    """Return a warning if the share's shape varies and the mass does not."""
    mass = named.scene.mass
    mass_varies = named.steel_density is not None or holds_casadi(mass) or "scene.mass" in inputs
    if mass_varies or not named.scene.effects.motion or not any(name.startswith("share.") for name in inputs):
        return ()
    return (f"the moving mass stays {mass:.4g} kg whatever the share's size: give a steel_density to couple them",)
