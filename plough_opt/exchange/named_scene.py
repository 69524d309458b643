"""A scene whose quantities are read and replaced by the names that problem files give them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.checks import check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, as_number, holds_casadi, is_symbolic, map_expressions
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of, with_quantities

DURATION, FRAME, STEEL = BESIDE
# Part of the share's mass by which all that moves may seem lighter where the frame has no mass: rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class NamedScene:
    """A scene and its duration by the names of their quantities, as "share.height" and "scene.duration".

    Args:
        scene: numeric or symbols.
        duration: simulated time [s], or None.
        steel_density: of the share [kg/m^3]. The scene's mass then is that of "scene.frame_mass" and of a share of
            "scene.steel_density". None: it is a quantity of its own, "scene.mass".
        symbols: CasADi symbols in scene and duration, by names under which they are replaced too.

    Raises:
        InputError: a share that is heavier than all that moves, or one of symbols whose mass shall be known; symbols
            that the scene does not hold, or others that it holds.
        DomainError: a density outside its domain.
    """

    scene: Scene
    duration: Expression | None = None
    steel_density: float | None = None
    symbols: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_symbols()
        if self.steel_density is None:
            return
        if holds_casadi((self.scene.mass, self.scene.share)):
            raise InputError(
                "steel_density belongs to a numeric scene: this scene's mass or share is an expression, which can"
                " include the share's own mass"
            )
        BESIDE[STEEL].check(self.steel_density)
        share = self.scene.cone.solid_mass(self.steel_density)
        if self.scene.mass < (1.0 - _ROUNDING) * share:
            raise InputError(
                f"a share of {self.steel_density:.6g} kg/m^3 has {share:.6g} kg, more than the {self.scene.mass:.6g} kg"
                " of all that moves: give the scene the mass of frame and share together, or leave steel_density out"
            )

    def _check_symbols(self) -> None:
        """Raise InputError unless the symbols are those of scene and duration."""
        if self.symbols and not self._expressions:
            raise InputError(
                f"the scene does not hold the symbol of input '{next(iter(self.symbols))}': it is made of numbers"
            )
        known = {hash(symbol) for symbol in self.symbols.values()}
        held = [symbol for one in self._expressions if is_symbolic(one) for symbol in ca.symvar(one)]
        if others := {symbol.name() for symbol in held if hash(symbol) not in known}:
            raise InputError(
                f"the scene holds symbols that are not inputs ({', '.join(sorted(others))}): make each an Input with"
                " its symbol"
            )

    @cached_property
    def _expressions(self) -> list[Any]:
        """The CasADi expressions in scene and duration."""
        found: list[Any] = []

        def collect(expression: Expression) -> Expression:
            found.append(expression)
            return expression

        map_expressions((self.scene, self.duration), collect)
        return found

    @cached_property
    def _of_symbols(self) -> ca.Function:
        """The expressions in scene and duration as a Function of the symbols."""
        function = ca.Function("quantities", [*self.symbols.values()], self._expressions)
        return function if function.is_a("SXFunction") else function.expand()

    @cached_property
    def values(self) -> dict[str, Expression]:
        """Every quantity that the scene has, by name."""
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
            raise InputError(
                f"'{name}' needs a steel_density, which divides the mass into frame and share: give that too"
            )
        if name == "scene.mass":
            raise InputError(f"'scene.mass' follows from steel_density and '{FRAME}': use that one")
        raise InputError(f"the scene has no '{name}': give it one, or leave the name out")

    def replaced(self, changes: Mapping[str, Expression]) -> tuple[Scene, Expression | None]:
        """Return scene and duration with other values, numbers or expressions.

        Args:
            changes: values by name, of every symbol, and of quantities that the scene has.
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
