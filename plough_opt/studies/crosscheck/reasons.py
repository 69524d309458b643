"""Sentences of a comparison: what was estimated, and why draft models differ on a scene, with its own numbers."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from plough_opt.laws.cones import ElasticMedium
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge
from plough_opt.studies.crosscheck.comparison import KM_PER_H, ModelDraft

# Depth over width at which crescents up to the surface become doubtful.
_DEEP = 6.0


def estimates(scene: Scene, tine: Mapping[str, Any], point: str, missing: Collection[str]) -> tuple[str, ...]:
    """Return a sentence for each choice that is not the scene's.

    Args:
        scene: the scene.
        tine: its width, rake angle (None: the chisel angle's), surcharge and adhesion, SI units.
        point: of the subsoiler of D497.
        missing: names of the arguments of a comparison that were not given.
    """
    soil, share, slip = scene.soil, scene.share, math.degrees(math.atan(scene.soil.tool_friction))
    chisel = math.degrees(share.chisel_angle) if isinstance(share, Wedge) and tine["rake_angle"] is None else None
    sentences = {
        f"working depth {share.height:.3g} m: the share's height, for none was given": "depth" in missing,
        f"tool width {tine['width']:.3g} m: base diameter of the equivalent cone, for none was given":
            "width" in missing,
        f"rake angle {chisel or 0.0:.3g} deg: the share's chisel angle, for none was given": chisel is not None,
        "soil texture: none was given, so every one of D497 is shown": "texture" in missing,
        f"D497: one shank with a {point} point; textures are fine (clay), medium (loam), coarse (sand)": True,
        "rupture distance of the universal earthmoving equation: the plane wedge's, in place of charts":
            "rupture_ratio" in missing,
        "speeds: none were given; 3, 5, 7, 9 km/h and the tow speed": "speeds" in missing,
        "spherical cavity: rigid soil ahead of the front, for no Young's modulus was given":
            soil.youngs_modulus is None,
        f"surcharge {tine['surcharge'] / 1e3:.3g} kPa and adhesion {tine['adhesion'] / 1e3:.3g} kPa in the wedge"
        f" models; tool friction angle {slip:.3g} deg from the tool friction": True,
    }  # fmt: skip
    return tuple(sentence for sentence, holds in sentences.items() if holds)


def reasons(
    scene: Scene, slimness: float, own: ModelDraft, others: Sequence[ModelDraft], course: Sequence[float]
) -> tuple[str, ...]:
    """Return the sentences, the most important first.

    Args:
        scene: the scene.
        slimness: largest working depth over the tine's width [-].
        own: the drafts of the scene's own law.
        others: those of the other models.
        course: speeds [m/s], rising.
    """
    first = "every draft here is a calculation and none a measurement: where two agree, neither is validated"
    if not scene.law.slender:  # what follows is of the plastic gas
        return first, f"the scene's own draft is by {scene.law.label}, and the ratios are to it"
    return (
        first,
        "this model and the spherical cavity know no depth, no free surface and no shank: they give the force on the"
        " point alone; D497 and the wedge models are of a tine that cuts soil up to its surface",
        *_of_speed(own, others, course),
        *_of_pressure(scene),
        *_of_soil(scene, slimness),
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


def _of_soil(scene: Scene, slimness: float) -> Iterable[str]:
    soil = scene.soil
    factor = float(soil.strength_factor)
    sentences = {
        "the spherical cavity pushes soil aside in three directions, and soil ahead of its front bears elastically"
        " until it yields; in this model soil moves in two directions and bears p_a alone until the front comes":
            soil.youngs_modulus is not None,
        f"this model's static draft is {factor:.3g} times what its law makes of cohesion, friction and density"
        " ratio, by the measured strength factor; the other models compute with those properties themselves":
            factor != 1.0,
        "the scene's medium is elastic, without strength; the other models take the soil's strength all the same":
            isinstance(scene.law, ElasticMedium),
        "the other models take the soil's constant densities in the place of its density profile":
            soil.density_profile is not None,
        "the tool's friction exceeds the soil's: soil would shear in itself, which the wedge models leave out":
            math.atan(soil.tool_friction) > soil.friction_angle,
        "deeper than about six widths (a figure not verified) soil fails sideways and not up to the surface: McKyes-Ali"
        " and Swick-Perumpral are doubtful there":
            slimness > _DEEP,
        "resistances of the scene's own effects are in this model's draft and in no other":
            bool(scene.effects.own),
    }  # fmt: skip
    return (sentence for sentence, holds in sentences.items() if holds)


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
