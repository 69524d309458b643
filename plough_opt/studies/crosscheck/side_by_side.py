"""Comparison of a scene with other draft models, whose further inputs are given or estimated."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from plough_opt.core.checks import array_of, check_domain, check_kind, check_named, check_single, shown
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, holds_casadi
from plough_opt.laws import (
    AsabeD497,
    McKyesAli,
    ResistanceLaw,
    ShareInSoil,
    SphericalCavity,
    SwickPerumpral,
    Tine,
    UniversalEarthmoving,
)
from plough_opt.laws.asabe import POINTS, TEXTURES
from plough_opt.motion.scene import Scene
from plough_opt.studies.crosscheck.comparison import KM_PER_H, Comparison, ModelDraft
from plough_opt.studies.crosscheck.reasons import estimates, reasons

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
    """Return the quasi-static mean draft of a numeric scene by this toolkit's model and by other models.

    Args:
        scene: scene whose soil, share and effects are used; its mount and motion are ignored.
        depth: working depth or depths [m]; default: the share's height.
        width: width of the tine [m]; default: the base diameter of the equivalent cone.
        rake_angle: rake angle of the tine [rad], above 0 and at most 90 degrees; default: the share's chisel angle.
        texture: ``"fine"``, ``"medium"`` or ``"coarse"``, for ASABE D497; default: all three.
        point: ``"narrow"`` or ``"winged"``, for ASABE D497.
        speeds: speeds [m/s]; default: 3, 5, 7 and 9 km/h and the tow speed.
        rupture_ratio: m of the universal earthmoving equation, at least 1; default: that of a plane wedge.
        surcharge: pressure on the soil's surface [Pa].
        adhesion: adhesion of soil on the tine [Pa].
        laws: further resistance laws, such as your own.

    Returns:
        Drafts, ratios, estimates and reasons. Drafts outside a model's domain are NaN, with the reason.

    Raises:
        InputError: the scene holds symbols, or texture or point is unknown.
        DomainError: an argument is outside every model's domain.
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    if holds_casadi((scene, depth, width, rake_angle, speeds, rupture_ratio, surcharge, adhesion)):
        raise InputError("a comparison needs numbers: evaluate the scene with best(scene) first")
    for name, value, known in (("texture", texture, TEXTURES), ("point", point, POINTS)):
        if not (value is None and name == "texture"):
            check_named(f"{name} = {{}} does not exist in D497", value, known)
    check_single("a comparison", (width, rake_angle, rupture_ratio, surcharge, adhesion))
    if rupture_ratio is not None:
        check_domain("rupture distance ratio m", rupture_ratio, at_least=1.0)
    check_kind("laws", laws, list | tuple, "a list of resistance laws")
    for law in laws:
        check_kind("laws: one of them", law, ResistanceLaw, "a resistance law, such as McKyesAli(depth=0.35)")
    given_speeds: Any = (*_USUAL_SPEEDS, scene.tow_speed) if speeds is None else speeds
    course = tuple(sorted(_several("speed", "m/s", given_speeds, at_least=0.0)))
    depths = _several("working depth", "m", float(scene.share.height) if depth is None else depth, above=0.0)
    tine_width = 2.0 * float(scene.cone.height * scene.cone.slope) if width is None else width
    # Check the tine here once, so that invalid dimensions raise an error and are not reported in every row.
    Tine(tine_width, depths[0], math.pi / 2 if rake_angle is None else rake_angle, surcharge, adhesion)
    tine = {"width": tine_width, "rake_angle": rake_angle, "surcharge": surcharge, "adhesion": adhesion}
    rows = _rows(depths, tine, tuple(TEXTURES) if texture is None else (texture,), point, rupture_ratio)

    soil = scene.soil if scene.effects.ambient_pressure else dataclasses.replace(scene.soil, ambient_pressure=0.0)
    at = ShareInSoil(scene.share, scene.cone, soil, 0.0)
    others = tuple(
        ModelDraft(name, d, *_drafts(partial(_steady, law, at), course), law.source, law.standing, law.band)
        for name, d, law in (*rows, *((_short(law), None, law) for law in laws))
    )
    name = "this model" if scene.law.slender else f"this scene, {scene.law.label}"
    # The scene's quasi-static mean over whole wavelengths of the soil strength.
    drafts = _drafts(lambda speed: dataclasses.replace(scene, tow_speed=speed).steady_resistance, course)
    own = ModelDraft(name, None, *drafts, scene.law.source, scene.law.standing)
    given = {"depth": depth, "width": width, "texture": texture, "rupture_ratio": rupture_ratio, "speeds": speeds}
    return Comparison(
        scene=scene.describe(),
        speeds=course,
        own=own,
        others=others,
        estimates=estimates(scene, tine, point, [name for name, value in given.items() if value is None]),
        reasons=reasons(scene, max(depths) / tine_width, own, others, course),
    )


def _several(what: str, unit: str, given: float | Sequence[float], **domain: Any) -> tuple[float, ...]:
    """Return one or several numbers without duplicates, checked by `check_domain` with the given keywords."""
    values = np.atleast_1d(array_of(given, f"{what} = {shown(given)} must be one or more numbers, in {unit}")).ravel()
    check_domain(what, values, unit, **domain)
    if not values.size:
        raise InputError(f"{what} = () must name at least one {what.split()[-1]}, in {unit}")
    return tuple(dict.fromkeys(values.tolist()))


def _short(law: ResistanceLaw | type[ResistanceLaw]) -> str:
    return law.label.removeprefix("the ")


def _rows(
    depths: Sequence[float], tine: dict[str, Any], textures: Sequence[str], point: str, rupture_ratio: float | None
) -> Iterator[tuple[str, float | None, ResistanceLaw]]:
    """Yield name, working depth [m] and law of each row; the law without a depth is last."""
    for depth in depths:
        for texture in textures:
            yield f"{AsabeD497.label}, {point}, {texture}", depth, AsabeD497(texture, point, depth=depth)
        wedges = (
            McKyesAli(depth, **tine),
            UniversalEarthmoving(depth, **tine, rupture_ratio=rupture_ratio),
            SwickPerumpral(depth, **tine),
        )
        for law in wedges:
            yield _short(law), depth, law
    yield _short(SphericalCavity), None, SphericalCavity()


def _steady(law: ResistanceLaw, at: ShareInSoil, speed: float) -> Expression:
    """Return a law's draft [N] for a share that slides steadily at a speed [m/s]."""
    return law.reaction(dataclasses.replace(at, speed=speed)).at(speed)


def _drafts(draft: Callable[[float], Expression], speeds: Sequence[float]) -> tuple[tuple[float, ...], str]:
    """Return a model's draft at each speed, NaN outside its domain, and the first reason for a NaN or ""."""
    drafts, refusal = [], ""
    for speed in speeds:
        try:
            drafts.append(float(as_number(draft(speed))))
        except DomainError as error:
            drafts.append(math.nan)
            refusal = refusal or str(error)
    return tuple(drafts), refusal
