"""Sentences of a comparison: which values were estimated, and why the models differ for this scene."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from plough_opt.laws.cones import ElasticMedium
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge
from plough_opt.studies.crosscheck.comparison import KM_PER_H, ModelDraft

# Depth over width beyond which crescents up to the surface are doubtful.
_DEEP = 6.0


def estimates(scene: Scene, tine: Mapping[str, Any], point: str, missing: Collection[str]) -> tuple[str, ...]:
    """Return a sentence for each value that does not come from the scene.

    Args:
        scene: the scene.
        tine: its width, rake angle (None for the chisel angle), surcharge and adhesion, SI units.
        point: point of the subsoiler of D497.
        missing: names of the arguments of `compare` that were not given.
    """
    soil, share, slip = scene.soil, scene.share, math.degrees(math.atan(scene.soil.tool_friction))
    chisel = math.degrees(share.chisel_angle) if isinstance(share, Wedge) and tine["rake_angle"] is None else None
    sentences = {
        f"working depth {share.height:.3g} m: the share's height, because none was given": "depth" in missing,
        f"tool width {tine['width']:.3g} m: base diameter of the equivalent cone, because none was given":
            "width" in missing,
        f"rake angle {chisel or 0.0:.3g} deg: the share's chisel angle, because none was given": chisel is not None,
        "soil texture: none was given, so all textures of D497 are shown": "texture" in missing,
        f"D497: one shank with a {point} point; textures are fine (clay), medium (loam), coarse (sand)": True,
        "rupture distance of the universal earthmoving equation: that of a plane wedge instead of the charts":
            "rupture_ratio" in missing,
        "speeds: none were given; 3, 5, 7, 9 km/h and the tow speed": "speeds" in missing,
        "spherical cavity: rigid soil ahead of the front, because the soil has no Young's modulus":
            soil.youngs_modulus is None,
        f"surcharge {tine['surcharge'] / 1e3:.3g} kPa and adhesion {tine['adhesion'] / 1e3:.3g} kPa in the wedge"
        f" models; tool friction angle {slip:.3g} deg from the tool friction": True,
    }  # fmt: skip
    return tuple(sentence for sentence, holds in sentences.items() if holds)


def reasons(
    scene: Scene, slimness: float, own: ModelDraft, others: Sequence[ModelDraft], course: Sequence[float]
) -> tuple[str, ...]:
    """Return the sentences, most important first.

    Args:
        scene: the scene.
        slimness: largest working depth over the tine's width [-].
        own: drafts of the scene's own law.
        others: drafts of the other models.
        course: speeds [m/s], increasing.
    """
    first = "all drafts here are calculated, not measured: agreement of two models validates neither"
    if not scene.law.slender:  # the further reasons hold for the plastic gas
        return first, f"the scene's own draft is that of {scene.law.label}, and the ratios refer to it"
    return (
        first,
        "this model and the spherical cavity ignore working depth, the free surface and the shank: they give the force"
        " on the point alone; D497 and the wedge models describe a tine that cuts soil up to the surface",
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
        " small, and in this model strength does not depend on the rate of loading (unless a rate term is added)"
    )


def _of_pressure(scene: Scene) -> Iterable[str]:
    share = float(scene.ambient_share)
    if share > 0.0:
        pressure = float(scene.soil.ambient_pressure) / 1e3
        rest = (1.0 - share) * float(scene.reaction.static)
        yield (
            f"ambient pressure ({pressure:.4g} kPa) carries {100 * share:.0f} % of this model's static draft; without"
            f" it {rest / 1e3:.3g} kN would remain; the spherical cavity includes it too, and the wedge models include"
            " only the weight and the strength of the soil"
        )


def _of_soil(scene: Scene, slimness: float) -> Iterable[str]:
    soil = scene.soil
    factor = float(soil.strength_factor)
    sentences = {
        "the spherical cavity pushes soil aside in three directions, and the soil ahead of its front carries load"
        " elastically until it yields; in this model soil moves in two directions and carries only p_a ahead of the"
        " front":
            soil.youngs_modulus is not None,
        f"the measured strength factor multiplies this model's static draft by {factor:.3g}; the other models use"
        " cohesion, friction and density ratio without it":
            factor != 1.0,
        "the scene's medium is elastic, without strength; the other models still use the soil's strength":
            isinstance(scene.law, ElasticMedium),
        "the other models use the soil's constant densities instead of its density profile":
            soil.density_profile is not None,
        "the tool friction exceeds the soil's internal friction: the soil itself would shear, which the wedge models"
        " ignore":
            math.atan(soil.tool_friction) > soil.friction_angle,
        "deeper than about six widths (a figure not verified) soil fails sideways and not up to the surface: McKyes-Ali"
        " and Swick-Perumpral are doubtful there":
            slimness > _DEEP,
        "resistances of the scene's own effects are included in this model's draft only":
            bool(scene.effects.own),
    }  # fmt: skip
    return (sentence for sentence, holds in sentences.items() if holds)


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
