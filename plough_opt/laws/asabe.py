"""Draft of a subsoiler by ASABE D497 from depth, speed and soil texture."""

from dataclasses import dataclass, field
from typing import Final

from plough_opt.core.checks import check_domain, check_named
from plough_opt.core.expressions import Expression
from plough_opt.core.labels import limited_in_designs
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction

POINTS: Final = {"narrow": (226.0, 0.0, 1.8), "winged": (294.0, 0.0, 2.4)}
"""Point -> A, B, C of D497's subsoiler rows, for N, km/h and cm; a winged point is 30 cm wide. Not verified."""

TEXTURES: Final = {"fine": 1.0, "medium": 0.70, "coarse": 0.45}
"""Soil texture (clay, loam, sand) -> factor F. Not verified."""

_KM_PER_H, _CM = 3.6, 100.0
_LABEL = "ASABE D497"


@dataclass(frozen=True)
class AsabeD497(ResistanceLaw):
    """`asabe_draft` as a law: F0 and Fd depend on depth and texture, but not on soil properties or the share's angles.

    Args:
        texture: ``"fine"`` (clay), ``"medium"`` (loam) or ``"coarse"`` (sand).
        point: ``"narrow"`` or ``"winged"``.
        shanks: number of shanks.
        depth: tillage depth [m]; default: the share's height.
    """

    texture: str = "medium"
    point: str = "narrow"
    shanks: Expression = field(default=1.0, metadata={"unit": ""})
    depth: Expression | None = field(default=None, metadata={"unit": "m"})

    label = _LABEL
    source = "ASABE D497.7, Agricultural machinery management data"
    standing = "coefficients not verified against the standard's text, which is said to allow +-50 %"
    band = 0.5

    def reaction(self, at: ShareInSoil) -> SoilReaction:
        """Return F0 [N] and Fd [N s^2/m^2]; the subsoiler's rows do not have a term linear in the speed."""
        depth = at.share.height if self.depth is None else self.depth
        static = asabe_draft(depth, 0.0, self.texture, point=self.point, shanks=self.shanks)
        check_domain("speed", at.speed, "m/s", at_least=0.0)
        _, _, squared = POINTS[self.point]
        drag = TEXTURES[self.texture] * squared * _KM_PER_H**2 * self.shanks * (_CM * depth)
        return SoilReaction(static=static, drag=drag)


@limited_in_designs(_LABEL)
def asabe_draft(
    depth: Expression, speed: Expression, texture: str, *, point: str = "narrow", shanks: Expression = 1.0
) -> Expression:
    """Return the draft [N] F (A + B S + C S^2) N T of a subsoiler, with S in km/h and T in cm.

    Source: ASABE D497.7. The form and its units agree with a published worked example for a chisel plough. The
    coefficients of the subsoiler's rows are not verified against the standard's text. The draft does not depend on tool
    width, rake angle, or the soil's density and strength.

    Args:
        depth: tillage depth T [m], above 0.
        speed: S [m/s], at least 0.
        texture: ``"fine"`` (clay), ``"medium"`` (loam) or ``"coarse"`` (sand).
        point: ``"narrow"`` or ``"winged"``.
        shanks: number N of shanks.

    Raises:
        InputError: the texture or the point is unknown.
        DomainError: depth, speed or number of shanks lies outside its domain.
    """
    check_named("no soil texture of D497 is named {}", texture, TEXTURES)
    check_named("no subsoiler point of D497 is named {}", point, POINTS)
    depth = check_domain("working depth", depth, "m", above=0.0)
    speed = check_domain("speed", speed, "m/s", at_least=0.0)
    shanks = check_domain("number of shanks", shanks, above=0.0)
    return draft_of_row(POINTS[point], TEXTURES[texture], depth, speed, shanks)


def draft_of_row(
    row: tuple[float, float, float], texture: float, depth: Expression, speed: Expression, size: Expression
) -> Expression:
    """Return the draft [N] for any row of D497.

    Args:
        row: A, B and C.
        texture: factor F.
        depth: tillage depth [m].
        speed: [m/s].
        size: width or number of tools, as the row requires.
    """
    a, b, c = row
    s = _KM_PER_H * speed
    return texture * (a + b * s + c * s**2) * size * (_CM * depth)
