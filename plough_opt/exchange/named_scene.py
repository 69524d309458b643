"""A scene whose quantities are read and replaced by their names in problem files."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca

from plough_opt.core.checks import check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import (
    Column,
    Expression,
    as_number,
    holds_casadi,
    is_casadi,
    is_symbolic,
    map_expressions,
    template_of,
)
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES
from plough_opt.motion.scene import Scene, quantities_of, with_quantities

DURATION, FRAME, STEEL = BESIDE
# If the frame has no mass, rounding may make the moving mass smaller than the share's by this part.
_ROUNDING = 1e-12


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
        self._check_symbols()
        if self.steel_density is None:
            return
        if holds_casadi((self.scene.mass, self.scene.share)):
            raise InputError(
                "steel_density needs a numeric scene: this scene's mass or share is an expression; let the mass"
                " expression include the share's own mass instead"
            )
        BESIDE[STEEL].check(self.steel_density)
        share = self.scene.cone.solid_mass(self.steel_density)
        if self.scene.mass < (1.0 - _ROUNDING) * share:
            raise InputError(
                f"a share of {self.steel_density:.6g} kg/m^3 has {share:.6g} kg, more than the whole moving mass of"
                f" {self.scene.mass:.6g} kg: give the scene the mass of frame and share together, or leave"
                " steel_density out"
            )

    def _check_symbols(self) -> None:
        """Raise InputError unless the given symbols are exactly those in scene and duration."""
        if self.symbols and not self._expressions:
            raise InputError(f"the scene does not hold the symbol of input '{next(iter(self.symbols))}': it is numeric")
        given = {hash(symbol) for symbol in self.symbols.values()}
        present = [symbol for one in self._expressions if is_symbolic(one) for symbol in ca.symvar(one)]
        if others := {symbol.name() for symbol in present if hash(symbol) not in given}:
            raise InputError(
                f"the scene holds symbols that are not inputs ({', '.join(sorted(others))}): make each an Input with"
                " its symbol"
            )

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
