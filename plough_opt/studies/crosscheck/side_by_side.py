"""Set other draft models beside a scene: what they need and the scene lacks is given, or estimated and said so."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from plough_opt.core.checks import check_domain, check_kind, check_named, check_single
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import holds_casadi
from plough_opt.laws import (
    AsabeD497,
    McKyesAli,
    ResistanceLaw,
    ShareInSoil,
    SphericalCavity,
    SwickPerumpral,
    UniversalEarthmoving,
)
from plough_opt.laws.asabe import POINTS, TEXTURES
from plough_opt.laws.law import force_of
from plough_opt.motion.scene import Scene
from plough_opt.soil.soil import Soil
from plough_opt.studies.crosscheck.comparison import Comparison
from plough_opt.studies.crosscheck.reasons import reasons
from plough_opt.studies.crosscheck.rows import model_draft
from plough_opt.studies.crosscheck.tools import KM_PER_H, ToolSet, tool_set

_USUAL_SPEEDS = tuple(speed / KM_PER_H for speed in (3.0, 5.0, 7.0, 9.0))


def compare(
    scene: Scene,
    *,
    depth: float | Sequence[float] | None = None,
    width: float | None = None,
    rake_angle: float | None = None,
    texture: str | None = None,
    point: str = "narrow",
    speeds: float | Sequence[float] | None = None,
    rupture_ratio: float | None = None,
    surcharge: float = 0.0,
    adhesion: float = 0.0,
    laws: Sequence[ResistanceLaw] = (),
) -> Comparison:
    """Return the drafts of other models beside this one's quasi-static mean draft of a numeric scene.

    Args:
        scene: its soil, share and effects; the mount and its motion do not enter.
        depth: working depth or depths [m]; estimated by the share's height.
        width: of the tine [m]; estimated by the base diameter of the equivalent cone.
        rake_angle: of the tine [rad], above 0 to 90 degrees; estimated by the share's chisel angle.
        texture: ``"fine"``, ``"medium"`` or ``"coarse"``, for ASABE D497; without it all three are shown.
        point: ``"narrow"`` or ``"winged"``, for ASABE D497.
        speeds: [m/s]; without them 3, 5, 7 and 9 km/h and the tow speed.
        rupture_ratio: m of the universal earthmoving equation, at least 1; estimated by a plane wedge.
        surcharge: on the soil's surface [Pa].
        adhesion: of soil on the tine [Pa].
        laws: further laws of resistance, such as a user's own.

    Returns:
        Drafts, ratios, estimates and reasons. What lies outside a model's domain is NaN, with the reason.

    Raises:
        InputError: a scene with symbols, or an unknown texture or point.
        DomainError: an argument that is outside every model's domain.
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    if holds_casadi((scene, depth, width, rake_angle, speeds, rupture_ratio, surcharge, adhesion)):
        raise InputError("a comparison is of numbers: evaluate the scene with best(scene) first")
    for name, value, known in (("texture", texture, TEXTURES), ("point", point, POINTS)):
        if not (value is None and name == "texture"):
            check_named(f"{name} = {{}} is none of D497", value, known)
    check_single("a comparison", [x for x in (width, rake_angle, rupture_ratio, surcharge, adhesion) if x is not None])
    if rupture_ratio is not None:
        check_domain("rupture distance ratio m", rupture_ratio, at_least=1.0)
    check_kind("laws", laws, list | tuple, "a list of resistance laws")
    for law in laws:
        check_kind("laws: one of them", law, ResistanceLaw, "a resistance law, as McKyesAli(depth=0.35)")
    tools = tool_set(scene, depth, width, rake_angle, surcharge, adhesion)
    course = _speeds(scene, speeds)
    soil = scene.soil if scene.effects.ambient_pressure else dataclasses.replace(scene.soil, ambient_pressure=0.0)
    name = "this model" if scene.law.slender else f"this scene, {scene.law.label}"
    own = model_draft(name, None, lambda v: _own_draft(scene, v), course, scene.law.source, scene.law.standing)
    textures = tuple(TEXTURES) if texture is None else (texture,)
    others = []
    given = ((law.label.removeprefix("the "), None, law) for law in laws)
    for name, d, law in (*_laws(tools, textures, point, rupture_ratio), *given):
        draft = partial(_steady, law, ShareInSoil(scene.share, scene.cone, soil, 0.0))
        others.append(model_draft(name, d, draft, course, law.source, law.standing, law.band))
    estimates = (
        *tools.estimates,
        *_estimates(soil, tools, texture, point, rupture_ratio, speeds),
    )
    return Comparison(
        scene=scene.describe(),
        speeds=course,
        own=own,
        others=tuple(others),
        estimates=estimates,
        reasons=reasons(scene, tools, own, others, course),
    )


def _own_draft(scene: Scene, speed: float) -> float:
    """Return the quasi-static mean draft [N] over whole waves of the soil's strength."""
    return float(dataclasses.replace(scene, tow_speed=speed).steady_resistance)


def _steady(law: ResistanceLaw, at: ShareInSoil, speed: float) -> float:
    """Return a law's draft [N] of a share that slides steadily at a speed [m/s]."""
    return float(force_of(law, dataclasses.replace(at, speed=speed)))


def _speeds(scene: Scene, speeds: float | Sequence[float] | None) -> tuple[float, ...]:
    given = (*_USUAL_SPEEDS, float(scene.tow_speed)) if speeds is None else np.ravel(np.asarray(speeds))
    check_domain("speed", np.asarray(given), "m/s", at_least=0.0)
    if not len(given):
        raise InputError("speeds = () must name at least one speed, in m/s")
    return tuple(sorted({float(speed) for speed in given}))


def _laws(
    tools: ToolSet, textures: Sequence[str], point: str, rupture_ratio: float | None
) -> Iterator[tuple[str, float | None, ResistanceLaw]]:
    """Yield name, working depth and law of each row; laws without a depth last."""
    for depth in tools.depths:
        for texture in textures:
            standard = AsabeD497(texture, point, depth=depth)
            yield f"{standard.label}, {point}, {texture}", depth, standard
        tine = depth, tools.width, tools.rake_angle, tools.surcharge, tools.adhesion
        for law in (McKyesAli(*tine), UniversalEarthmoving(*tine, rupture_ratio), SwickPerumpral(*tine)):
            yield law.label.removeprefix("the "), depth, law
    yield SphericalCavity.label.removeprefix("the "), None, SphericalCavity()


def _estimates(
    soil: Soil,
    tools: ToolSet,
    texture: str | None,
    point: str,
    rupture_ratio: float | None,
    speeds: float | Sequence[float] | None,
) -> tuple[str, ...]:
    """Return a sentence for each choice that is neither the scene's nor that of the tool set."""
    found = []
    if texture is None:
        found.append("soil texture: none was given, so every one of D497 is shown")
    found.append(f"D497: one shank with a {point} point; textures are fine (clay), medium (loam), coarse (sand)")
    if rupture_ratio is None:
        found.append("rupture distance of the universal earthmoving equation: the plane wedge's, in place of charts")
    if speeds is None:
        found.append("speeds: none were given; 3, 5, 7, 9 km/h and the tow speed")
    if soil.youngs_modulus is None:
        found.append("spherical cavity: rigid soil ahead of the front, for no Young's modulus was given")
    found.append(
        f"surcharge {tools.surcharge / 1e3:.3g} kPa and adhesion {tools.adhesion / 1e3:.3g} kPa in the wedge models;"
        f" tool friction angle {math.degrees(math.atan(soil.tool_friction)):.3g} deg from the tool friction"
    )
    return tuple(found)
