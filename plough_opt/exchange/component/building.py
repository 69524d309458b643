"""`component`: a scene as a Function of named inputs, with as many steps as the bounds on these need."""

from collections.abc import Sequence
from typing import Any, TypeVar

import casadi as ca

from plough_opt.core.checks import check_kind, check_single, plain_number, shown
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, holds_casadi, is_count, is_symbolic
from plough_opt.core.quantities import BESIDE, EVERY, Quantity
from plough_opt.exchange.component.box import Box
from plough_opt.exchange.component.function import Component
from plough_opt.exchange.component.ports import Input, Output, Port, check_names, identifier, measure_of, port_of
from plough_opt.exchange.component.scenes import Make, Scenes
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion import OUTPUTS
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.scene import Scene

_T = TypeVar("_T", Input, Output)


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
    """Return a scene as one named CasADi Function of some of its quantities.

    Args:
        scene: numeric, some of which become inputs; or with CasADi symbols, each of which is an `Input`'s.
        duration: simulated time [s]; leave it out for a lasting orbit, whose duration is that of one wavelength.
        inputs: names of quantities, as in problem files ("share.height", "soil.cohesion", "scene.duration"), or
            `Input`s with bounds. The number of steps follows from the bounds.
        outputs: names of results, as in problem files ("mean_draft", "deflection"), or `Output`s.
        steel_density: of the share [kg/m^3]. The mass then depends on the share's volume, the rest of the scene's mass
            is the frame's, and "scene.frame_mass" and "scene.steel_density" can be inputs. Default: a constant mass.
        accuracy: an error to reach, or ``"dop853"`` with a number of steps; default: a relative error of 1e-8, of
            derivatives 1e-6, checked at corners of the bounds and points inside.
        samples: number of equal intervals between output times of results at every output time.
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
    steel = None if steel_density is None else plain_number("steel_density", steel_density)
    listed = _listed(inputs, Input)
    check_names("input", [one.name for one in listed])
    own = {one.name: _symbol_port(one) for one in listed if one.symbol is not None}
    named = NamedScene(scene, duration, steel, {one.name: one.symbol for one in listed if one.symbol is not None})
    ports = [own[one.name] if one.name in own else _quantity_port(one, named) for one in listed]
    notes = _mass_notes(named, [port.name for port in ports])
    return build(named.replaced, ports, outputs, accuracy=accuracy, samples=samples, name=name, notes=notes)


def build(
    make: Make,
    inputs: Sequence[Port],
    outputs: Sequence[str | Output],
    *,
    accuracy: Accuracy | None = None,
    samples: int = OUTPUTS,
    name: str = "share",
    notes: Sequence[str] = (),
) -> Component:
    """Return a component of a callable that makes scenes of its inputs; the other arguments are those of `component`.

    Args:
        make: values of the inputs by name, numbers or symbols -> scene and duration.
        inputs: names, units, bounds and values.
        outputs: names of results, or `Output`s.
        accuracy: error to reach, or steps.
        samples: number of equal intervals between output times.
        name: the Function's name.
        notes: warnings beside those of the scenes.
    """
    if not isinstance(name, str) or not ca.Function.check_name(name):
        raise InputError(
            f"name = {shown(name)} cannot be the name of a CasADi Function: use letters, digits and underscores"
        )
    wanted = _listed(outputs, Output)
    check_names("output", [one.name for one in wanted])
    check_names("input or output", [*(port.name for port in inputs), *(one.name for one in wanted)])
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, "a po.Accuracy(...)")
    if not accuracy.order_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' cannot be part of a component, whose steps are fixed: use 'auto', or"
            " 'dop853' with a number of steps"
        )
    if not is_count(samples):
        raise InputError(f"samples = {shown(samples)} must be a whole number from 1 on: intervals between output times")
    scenes = Scenes(name, tuple(inputs), make)
    measures = {identifier(one.name): measure_of(one, scenes.scene.law) for one in wanted}
    results = {argument: of for argument, (_, of) in measures.items()}
    resolved = Box(scenes, accuracy, samples if scenes.gives_columns(results) else 1).resolved()
    function = scenes.function(results, resolved.resolution)
    values = function.call([port.value for port in inputs])
    ends = [
        Port(one.name, unit, one.lower, one.upper, _largest(one, value), value.numel())
        for one, (unit, _), value in zip(wanted, measures.values(), values, strict=True)
    ]
    own = Accuracy("dop853", steps=resolved.resolution.steps) if scenes.scene.effects.motion else Accuracy()
    return Component(function, scenes.inputs, tuple(ends), own, resolved.error, (*resolved.warnings, *notes))


def _largest(output: Output, values: ca.DM) -> float:
    """Return the largest value of an output."""
    if not values.is_regular():
        raise DomainError(f"'{output.name}' has no finite value at the inputs' values: check what it computes")
    return float(ca.mmax(values))


def _listed(given: Any, kind: type[_T]) -> list[_T]:
    """Return inputs or outputs as a list, made from names where names are given; one name alone is a list of one."""
    word = kind.__name__
    check_kind(f"{word.lower()}s", given, str | Sequence, f"a list of names, or of po.{word}(name, ...)")
    listed = [kind(one) if isinstance(one, str) else one for one in ([given] if isinstance(given, str) else given)]
    for one in listed:
        if not isinstance(one, kind):
            raise InputError(f"{word.lower()} {shown(one)} must be a name, or po.{word}(name, ...) with more about it")
    return listed


def _quantity_port(one: Input, named: NamedScene) -> Port:
    """Return the port of a quantity of the scene."""
    value = named.value(one.name)
    if is_symbolic(value) and one.value is None:
        raise InputError(f"'{one.name}' is an expression of the scene: make its symbol the input, or give it a value")
    return port_of(one, EVERY[one.name], float(as_number(value)) if one.value is None else one.value)


def _symbol_port(one: Input) -> Port:
    """Return the port of a symbol."""
    symbol: Any = one.symbol
    if not (is_symbolic(symbol) and symbol.is_valid_input() and symbol.numel() == 1):
        raise InputError(f"input '{one.name}': its symbol must be a scalar CasADi symbol, of which the scene is made")
    if one.lower is None or one.upper is None:
        raise InputError(
            f"input '{one.name}' needs lower and upper: a symbol has no value from which they could follow"
        )
    middle = (one.lower + one.upper) / 2.0
    return port_of(one, Quantity(one.name, one.name, "", one.unit or "", middle, ()), middle)


def _mass_notes(named: NamedScene, inputs: Sequence[str]) -> tuple[str, ...]:
    """Return a warning if the share's shape varies and the mass does not."""
    mass = named.scene.mass
    follows = named.steel_density is not None or holds_casadi(mass) or "scene.mass" in inputs
    if follows or not named.scene.effects.motion or not any(name.startswith("share.") for name in inputs):
        return ()
    return (f"the moving mass stays {mass:.4g} kg whatever the share's size; a steel_density couples it",)
