"""`component`: a scene as a CasADi Function of named inputs, with as many steps as their bounds need."""

from collections.abc import Sequence
from typing import Any, TypeVar

import casadi as ca

from plough_opt.core.checks import check_kind, check_single, plain_number, shown
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, holds_casadi, is_count, is_symbolic
from plough_opt.core.quantities import BESIDE, EVERY, Quantity
from plough_opt.exchange.component.box import Box
from plough_opt.exchange.component.function import Component
from plough_opt.exchange.component.ports import Input, Output, Port, check_names, identifier, measure_of, port_of
from plough_opt.exchange.component.scenes import MakeScene, Scenes
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion import OUTPUTS
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene

_Request = TypeVar("_Request", Input, Output)


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
            `Input`s with bounds. The bounds determine the number of steps.
        outputs: names of results, as in problem files ("mean_draft", "deflection"), or `Output`s.
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
        raise InputError(
            f"name = {shown(name)} cannot be the name of a CasADi Function: use letters, digits and underscores"
        )
    requested = _requests(outputs, Output)
    check_names("output", [one.name for one in requested])
    check_names("input or output", [*(port.name for port in inputs), *(one.name for one in requested)])
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, "a po.Accuracy(...)")
    if not accuracy.order_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' cannot be part of a component, whose steps are fixed: use 'auto', or"
            " 'dop853' with a number of steps"
        )
    if not is_count(samples):
        raise InputError(
            f"samples = {shown(samples)} must be a whole number of at least 1: it counts intervals between output times"
        )

    scenes = Scenes(name, tuple(inputs), make_scene)
    measures = [measure_of(one, scenes.scene.law) for one in requested]
    results = {identifier(one.name): value_of for one, (_, value_of) in zip(requested, measures, strict=True)}
    # Averages alone need no output times between start and end.
    intervals = samples if scenes.gives_columns(results) else 1
    resolution, error, warnings = Box(scenes, accuracy, intervals).resolved()
    function = scenes.function(results, resolution)
    values = function.call([port.value for port in inputs])
    output_ports = [
        Port(one.name, unit, one.lower, one.upper, _largest(one, value), value.numel())
        for one, (unit, _), value in zip(requested, measures, values, strict=True)
    ]
    used = Accuracy("dop853", steps=resolution.steps) if scenes.scene.effects.motion else Accuracy()
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
        if not isinstance(one, kind):
            raise InputError(f"{word.lower()} {shown(one)} must be a name, or po.{word}(name, ...)")
    return requests


def _quantity_port(request: Input, named: NamedScene) -> Port:
    """Return the port of a quantity of the scene."""
    value = named.value(request.name)
    if request.value is None and is_symbolic(value):
        raise InputError(
            f"'{request.name}' is an expression in the scene: make its symbol the input, or give the input a value"
        )
    return port_of(request, EVERY[request.name], value)


def _symbol_port(request: Input) -> Port:
    """Return the port of a symbol, whose default value is the middle of its bounds."""
    symbol: Any = request.symbol
    if not (is_symbolic(symbol) and symbol.is_valid_input() and symbol.numel() == 1):
        raise InputError(f"input '{request.name}': its symbol must be a scalar CasADi symbol that the scene contains")
    if request.lower is None or request.upper is None:
        raise InputError(
            f"input '{request.name}' needs lower and upper: a symbol has no value to derive default bounds from"
        )
    middle = (request.lower + request.upper) / 2.0
    return port_of(request, Quantity(request.name, request.name, "", request.unit or "", middle, ()), middle)


def _mass_notes(named: NamedScene, inputs: Sequence[str]) -> tuple[str, ...]:
    """Return a warning if the share's shape varies and the mass does not."""
    mass = named.scene.mass
    mass_varies = named.steel_density is not None or holds_casadi(mass) or "scene.mass" in inputs
    if mass_varies or not named.scene.effects.motion or not any(name.startswith("share.") for name in inputs):
        return ()
    return (f"the moving mass stays {mass:.4g} kg whatever the share's size: give a steel_density to couple them",)
