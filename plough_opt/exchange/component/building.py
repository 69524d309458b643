"""`component`: a scene as a Function of named inputs, with as many steps as the bounds on these need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import casadi as ca

from plough_opt.core.domain import check_single, plain_number
from plough_opt.core.errors import DomainError, InputError, nearest
from plough_opt.core.expressions import Expression, as_number, holds_casadi, is_count, is_symbolic, map_expressions
from plough_opt.core.kinds import shown
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES
from plough_opt.core.quantity import Quantity
from plough_opt.exchange.component.box import Box, Make
from plough_opt.exchange.component.function import Component
from plough_opt.exchange.component.graph import graph
from plough_opt.exchange.component.ports import Input, Output, Port, check_names, measure_of, port_of
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantity_of, with_quantities

SAMPLES = 400
"""Default number of intervals between the output times of results at every output time."""

_DURATION, _FRAME, _STEEL = BESIDE
_T = TypeVar("_T", Input, Output)


def component(
    scene: Scene,
    duration: Expression | None = None,
    *,
    inputs: Sequence[str | Input],
    outputs: Sequence[str | Output],
    steel_density: float | None = None,
    accuracy: Accuracy | None = None,
    samples: int = SAMPLES,
    name: str = "share",
) -> Component:
    """Return a scene as one named CasADi Function of some of its quantities.

    Args:
        scene: of numbers, some of which become inputs; or with CasADi symbols, each of which is an `Input`'s.
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
    """
    check_single("a component", (scene, duration))
    steel = None if steel_density is None else plain_number("steel_density", steel_density)
    base = _Base(scene, duration, steel)
    listed = _listed(inputs, Input)
    check_names("input", [one.name for one in listed])
    ports = [_symbol_port(one) if one.symbol is not None else _quantity_port(one, base) for one in listed]
    make, notes = _Scenes(base, listed), base.notes(ports)
    return build(make, ports, outputs, accuracy=accuracy, samples=samples, name=name, notes=notes)


def build(
    make: Make,
    inputs: Sequence[Port],
    outputs: Sequence[str | Output],
    *,
    accuracy: Accuracy | None = None,
    samples: int = SAMPLES,
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
    if not isinstance(accuracy, Accuracy):
        raise InputError(f"accuracy = {shown(accuracy)} must be a po.Accuracy(...)")
    if not accuracy.order_8:
        raise InputError(
            f"accuracy method '{accuracy.method}' cannot be part of a component, whose steps are fixed: use 'auto', or"
            " 'dop853' with a number of steps"
        )
    if not is_count(samples):
        raise InputError(f"samples = {shown(samples)} must be a whole number from 1 on: intervals between output times")
    box = Box(tuple(inputs), make, name)
    measures = [measure_of(one, box.scene.law) for one in wanted]
    results = [of for _, of in measures]
    # A run with two output times shows which results are columns.
    columns = any(size > 1 for size in box.sizes(results))
    resolved = box.resolved(accuracy, samples if columns else 1)
    arguments = [port.argument for port in inputs]
    function = graph(name, arguments, box.make_of_column, results, resolved.resolution)
    ends = [
        Port(one.name, unit, one.lower, one.upper, value=0.0, size=function.numel_out(k))
        for k, (one, (unit, _)) in enumerate(zip(wanted, measures, strict=True))
    ]
    names = [port.argument for port in ends]
    values = [port.value for port in inputs]
    symbols = function.mx_in()
    function = ca.Function(name, symbols, function.call(symbols), arguments, names, {"default_in": values})
    ends = [replace(port, value=_largest(port, value)) for port, value in zip(ends, function.call(values), strict=True)]
    own = Accuracy("dop853", steps=resolved.resolution.steps) if box.scene.effects.motion else Accuracy()
    return Component(function, tuple(inputs), tuple(ends), own, resolved.error, (*resolved.warnings, *notes))


def _largest(port: Port, values: ca.DM) -> float:
    """Return the largest value of an output."""
    if not values.is_regular():
        raise DomainError(f"'{port.name}' has no finite value at the inputs' values: check what it computes")
    return float(ca.mmax(values))


def _listed(given: Any, kind: type[_T]) -> list[_T]:
    """Return inputs or outputs as a list, made from names where names are given; one name alone is a list of one."""
    word = kind.__name__
    if not isinstance(given, str | Sequence):
        raise InputError(f"{word.lower()}s = {shown(given)} must be a list of names, or of po.{word}(name, ...)")
    listed = [kind(one) if isinstance(one, str) else one for one in ([given] if isinstance(given, str) else given)]
    for one in listed:
        if not isinstance(one, kind):
            raise InputError(f"{word.lower()} {shown(one)} must be a name, or po.{word}(name, ...) with more about it")
    return listed


@dataclass(frozen=True)
class _Base:
    """A scene with its duration, and the density of the share's steel if the mass depends on it."""

    scene: Scene
    duration: Expression | None
    steel: float | None

    def __post_init__(self) -> None:
        if self.steel is None:
            return
        if holds_casadi((self.scene.mass, self.scene.share)):
            raise InputError(
                "steel_density belongs to a scene of numbers: this scene's mass or share is an expression, which can"
                " include the share's own mass"
            )
        BESIDE[_STEEL].check(self.steel)
        if self.frame < 0.0:
            raise InputError(
                f"a share of {self.steel:g} kg/m^3 is {-self.frame:.4g} kg heavier than all that moves,"
                f" {self.scene.mass:.4g} kg: raise the scene's mass, or leave steel_density out"
            )

    @property
    def frame(self) -> float:
        """Mass that moves beside the share [kg]."""
        return float(self.scene.mass - self.scene.cone.solid_mass(self.steel))

    def value(self, name: str) -> tuple[Quantity, Expression]:
        """Return a quantity and its value."""
        if self.steel is None and name in (_FRAME, _STEEL):
            raise InputError(
                f"'{name}' needs a steel_density, which divides the mass into frame and share: give that too"
            )
        if self.steel is not None and name == "scene.mass":
            raise InputError(f"'scene.mass' follows from steel_density and '{_FRAME}': use that one")
        if name not in BESIDE:
            if name not in QUANTITIES:
                raise InputError(f"no quantity is named '{name}': {nearest(name, EVERY)}")
            return QUANTITIES[name], quantity_of(self.scene, name)
        value = {_DURATION: self.duration, _FRAME: self.frame if self.steel is not None else None, _STEEL: self.steel}
        if value[name] is None:
            raise InputError(f"'{name}' cannot be an input: the duration is missing")
        return BESIDE[name], value[name]

    def notes(self, ports: Sequence[Port]) -> tuple[str, ...]:
        """Return a warning if the share's shape varies and the mass does not."""
        names = {port.name for port in ports}
        follows = self.steel is not None or holds_casadi(self.scene.mass) or "scene.mass" in names
        if follows or not self.scene.effects.motion or not any(name.startswith("share.") for name in names):
            return ()
        return (
            f"the moving mass stays {self.scene.mass:.4g} kg whatever the share's size; a steel_density couples it",
        )

    def changed(self, changes: Mapping[str, Expression]) -> tuple[Scene, Expression | None]:
        """Return scene and duration with other values."""
        scene = with_quantities(self.scene, {key: value for key, value in changes.items() if key not in BESIDE})
        if self.steel is not None:
            steel = scene.cone.solid_mass(changes.get(_STEEL, self.steel))
            scene = replace(scene, mass=changes.get(_FRAME, self.frame) + steel)
        return scene, changes.get(_DURATION, self.duration)


def _quantity_port(one: Input, base: _Base) -> Port:
    """Return the port of a quantity of the scene."""
    quantity, value = base.value(one.name)
    if is_symbolic(value) and one.value is None:
        raise InputError(f"'{one.name}' is an expression of the scene: make its symbol the input, or give it a value")
    return port_of(one, quantity, float(as_number(value)) if one.value is None else one.value)


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


class _Scenes:
    """Makes scenes of a component's inputs: first the scene's symbols are replaced, then quantities set by name."""

    def __init__(self, base: _Base, inputs: Sequence[Input]) -> None:
        """Take the scene, and the inputs, of which some may be its symbols."""
        self._base = base
        self._symbols = {one.name: one.symbol for one in inputs if one.symbol is not None}
        self._expressions = self._function_of_symbols()

    def __call__(self, values: Mapping[str, Expression]) -> tuple[Scene, Expression | None]:
        """Return scene and duration at values of the inputs, numbers or symbols."""
        base = self._base
        if self._expressions is not None:
            results = iter(self._expressions.call([values[name] for name in self._symbols]))
            scene, duration = map_expressions((base.scene, base.duration), lambda _: _simple(next(results)))
            base = replace(base, scene=scene, duration=duration)
        return base.changed({name: value for name, value in values.items() if name not in self._symbols})

    def _function_of_symbols(self) -> ca.Function | None:
        """Return all expressions in the scene as a Function of its symbols; None for a scene of numbers.

        Raises:
            InputError: symbols of inputs that the scene does not hold, or others that it holds.
        """
        expressions: list[Any] = []

        def collect(expression: Expression) -> Expression:
            expressions.append(expression)
            return expression

        map_expressions((self._base.scene, self._base.duration), collect)
        if not expressions:
            if self._symbols:
                raise InputError(
                    f"the scene does not hold the symbol of input '{next(iter(self._symbols))}': it is made of numbers"
                )
            return None
        symbols: list[Any] = list(self._symbols.values())
        known = {hash(symbol) for symbol in symbols}
        others = {s.name() for e in expressions if is_symbolic(e) for s in ca.symvar(e) if hash(s) not in known}
        if others:
            raise InputError(
                f"the scene holds symbols that are not inputs ({', '.join(sorted(others))}): make each an Input with"
                " its symbol"
            )
        function = ca.Function("quantities", symbols, expressions)
        return function if function.is_a("SXFunction") else function.expand()


def _simple(value: Expression) -> Expression:
    return value if is_symbolic(value) else float(as_number(value))
