"""Tines with which a scene is compared: given, or estimated from the share with a note."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from plough_opt.core.checks import LEAST, check_domain
from plough_opt.core.errors import InputError
from plough_opt.laws.wedge import Tine
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge

KM_PER_H: Final = 3.6


@dataclass(frozen=True)
class ToolSet:
    """Tines of one shape at one or more depths.

    Attributes:
        depths: [m].
        width: [m].
        rake_angle: [rad]; None when neither given nor known of the share.
        surcharge: [Pa].
        adhesion: [Pa].
        estimates: a sentence for each of them that was estimated.
    """

    depths: tuple[float, ...]
    width: float
    rake_angle: float | None
    surcharge: float
    adhesion: float
    estimates: tuple[str, ...]


def tool_set(
    scene: Scene,
    depth: float | Sequence[float] | None,
    width: float | None,
    rake_angle: float | None,
    surcharge: float,
    adhesion: float,
) -> ToolSet:
    """Return the tines; what is None is estimated from the share.

    Raises:
        DomainError: a value given outside its domain.
        InputError: no depth in a list of them.
    """
    estimates = []
    if depth is None:
        depth = float(scene.share.height)
        estimates.append(f"working depth {depth:.3g} m: the share's height, for none was given")
    if width is None:
        width = 2.0 * float(scene.cone.height * scene.cone.slope)
        estimates.append(f"tool width {width:.3g} m: base diameter of the equivalent cone, for none was given")
    if rake_angle is not None:
        check_domain("rake angle", rake_angle, "rad", above=0.0, at_least=LEAST, at_most=math.pi / 2)
    elif isinstance(scene.share, Wedge):
        rake_angle = float(scene.share.chisel_angle)
        degrees = math.degrees(rake_angle)
        estimates.append(f"rake angle {degrees:.3g} deg: the share's chisel angle, for none was given")
    check_domain("working depth", np.asarray(depth), "m", above=0.0)
    depths = tuple(dict.fromkeys(float(d) for d in np.atleast_1d(depth)))
    if not depths:
        raise InputError("depth = () must name at least one depth, in m")
    # Refuses what is wrong of the rest once, and not in every row.
    upright = Tine(width, depths[0], math.pi / 2, surcharge, adhesion)
    return ToolSet(depths, upright.width, rake_angle, surcharge, adhesion, tuple(estimates))
