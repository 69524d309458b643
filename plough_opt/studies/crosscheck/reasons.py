"""Why draft models differ on a scene, in sentences with its own numbers."""

import math
from collections.abc import Iterable, Sequence

from plough_opt.laws.cones import ElasticMedium
from plough_opt.motion.scene import Scene
from plough_opt.studies.crosscheck.rows import ModelDraft
from plough_opt.studies.crosscheck.tools import KM_PER_H, ToolSet

# Depth over width at which crescents up to the surface become doubtful.
_DEEP = 6.0


def reasons(
    scene: Scene, tools: ToolSet, own: ModelDraft, others: Sequence[ModelDraft], course: Sequence[float]
) -> tuple[str, ...]:
    """Return the sentences, the most important first."""
    first = "every draft here is a calculation and none a measurement: where two agree, neither is validated"
    if not scene.law.slender:  # what follows is of the plastic gas
        return first, f"the scene's own draft is by {scene.law.label}, and the ratios are to it"
    return (
        first,
        "this model and the spherical cavity know no depth, no free surface and no shank: they give the force on the"
        " point alone; D497 and the wedge models are of a tine that cuts soil up to its surface",
        *_of_speed(own, others, course),
        *_of_pressure(scene),
        *_of_soil(scene, tools),
    )


def _of_speed(own: ModelDraft, others: Sequence[ModelDraft], course: Sequence[float]) -> Iterable[str]:
    if len(course) < 2 or not math.isfinite(own.rise):
        return
    rises: dict[str, list[float]] = {}
    for row in others:
        if math.isfinite(row.rise):
            rises.setdefault(row.model.split(",")[0], []).append(100.0 * row.rise)
    listed = ", ".join(f"{model} {_range(values)} %" for model, values in rises.items())
    yield (
        f"from {KM_PER_H * course[0]:.3g} to {KM_PER_H * course[-1]:.3g} km/h this model's draft rises by"
        f" {100.0 * own.rise:.2g} %, the others' by: {listed}; the inertia of soil pushed aside by a slender point is"
        " small, and here strength does not grow with the rate of loading (a rate term would let it)"
    )


def _of_pressure(scene: Scene) -> Iterable[str]:
    share = float(scene.ambient_share)
    if share > 0.0:
        pressure = float(scene.soil.ambient_pressure) / 1e3
        rest = (1.0 - share) * float(scene.reaction.static)
        yield (
            f"ambient pressure ({pressure:.4g} kPa) carries {100 * share:.0f} % of this model's static draft, without"
            f" it {rest / 1e3:.3g} kN would remain; it counts in the spherical cavity too, while the wedge models feel"
            " only the weight and the strength of the soil"
        )


def _of_soil(scene: Scene, tools: ToolSet) -> Iterable[str]:
    soil = scene.soil
    if soil.youngs_modulus is not None:
        yield (
            "the spherical cavity pushes soil aside in three directions, and soil ahead of its front bears elastically"
            " until it yields; in this model soil moves in two directions and bears p_a alone until the front comes"
        )
    factor = float(soil.strength_factor)
    if factor != 1.0:
        yield (
            f"this model's static draft is {factor:.3g} times what its law makes of cohesion, friction and density"
            " ratio, by the measured strength factor; the other models compute with those properties themselves"
        )
    if isinstance(scene.law, ElasticMedium):
        yield "the scene's medium is elastic, without strength; the other models take the soil's strength all the same"
    if soil.density_profile is not None:
        yield "the other models take the soil's constant densities in the place of its density profile"
    if math.atan(soil.tool_friction) > soil.friction_angle:
        yield "the tool's friction exceeds the soil's: soil would shear in itself, which the wedge models leave out"
    if max(tools.depths) > _DEEP * tools.width:
        yield (
            "deeper than about six widths (a figure not verified) soil fails sideways and not up to the surface:"
            " McKyes-Ali and Swick-Perumpral are doubtful there"
        )
    if scene.effects.own:
        yield "resistances of the scene's own effects are in this model's draft and in no other"


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
