"""A scene whose quantities are read and replaced by the names that problem files give them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from plough_opt.core.checks import check_named
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, holds_casadi
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

    Raises:
        InputError: a share that is heavier than all that moves, or one of symbols whose mass shall be known.
        DomainError: a density outside its domain.
    """

    scene: Scene
    duration: Expression | None = None
    steel_density: float | None = None

    def __post_init__(self) -> None:
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
        """Return scene and duration with other values, numbers or symbols, of some quantities that the scene has."""
        scene = with_quantities(self.scene, {name: value for name, value in changes.items() if name in QUANTITIES})
        if self.steel_density is not None:
            values = {**self.values, **changes}
            scene = replace(scene, mass=values[FRAME] + scene.cone.solid_mass(values[STEEL]))
        return scene, changes.get(DURATION, self.duration)
