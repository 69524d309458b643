"""Comparison with other draft models: calculations beside each other, which do not validate each other."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.checks import array_of, check_domain, check_kind, check_named, check_single
from plough_opt.core.errors import DomainError, InputError
from plough_opt.core.expressions import Expression, as_number, holds_casadi
from plough_opt.core.files import figure_of_size, line_style, shared_legend, written
from plough_opt.core.tables import Grid, data_frame
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
from plough_opt.laws.cones import spherical_cavity_draft
from plough_opt.laws.tines import POINTS, TEXTURES, asabe_draft, godwin_draft, mckyes_ali_draft, swick_perumpral_draft
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Comparison", "ModelDraft", "Tine", "asabe_draft", "compare", "godwin_draft", "mckyes_ali_draft",
    "spherical_cavity_draft", "swick_perumpral_draft",
]  # fmt: skip

KM_PER_H: Final = 3.6
"""Kilometres per hour in a metre per second."""

# Ratio of the largest to the smallest draft beyond which the axis is logarithmic, to separate the small ones.
_LARGEST_LINEAR_RATIO = 8.0
# Characters of a title per inch of the picture's width.
_CHARACTERS_PER_INCH = 9
_USUAL_SPEEDS = tuple(speed / KM_PER_H for speed in (3.0, 5.0, 7.0, 9.0))


@dataclass(frozen=True)
class ModelDraft:
    """Drafts of one model at the speeds of a comparison.

    Attributes:
        model: name of the model.
        depth: working depth [m], or None for a model without one.
        drafts: draft at each speed [N]; NaN outside the model's domain.
        refusal: reason for NaNs, or "".
        source: source of its equations.
        standing: clause that says which parts are not verified.
        band: fraction of a draft by which it may be wrong in either direction according to its source.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> po.crosscheck.compare(scene).own.model
        'this model'
    """

    model: str
    depth: float | None
    drafts: tuple[float, ...]
    refusal: str
    source: str
    standing: str
    band: float = 0.0

    @property
    def rise(self) -> float:
        """Relative growth of the draft from the lowest to the highest speed [-]; NaN without two drafts."""
        return self.drafts[-1] / self.drafts[0] - 1.0 if len(self.drafts) > 1 and self.drafts[0] else math.nan


@dataclass(frozen=True)
class Comparison:
    """Drafts of several models at the same speeds, beginning with this toolkit's model.

    They are not measurements, and agreement of two models validates neither.

    Attributes:
        scene: description of the scene.
        speeds: speeds [m/s], increasing.
        own: quasi-static mean draft of the scene by this toolkit's model.
        others: the other models; those with a working depth occur once for each depth.
        estimates: sentences that say which values the scene does not give, and how they were estimated.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> len(po.crosscheck.compare(scene).others) > 3
        True
    """

    scene: str
    speeds: tuple[float, ...]
    own: ModelDraft
    others: tuple[ModelDraft, ...]
    estimates: tuple[str, ...]

    @property
    def depths(self) -> tuple[float, ...]:
        """The working depths [m]."""
        return tuple(dict.fromkeys(row.depth for row in self.others if row.depth is not None))

    @property
    def refusals(self) -> tuple[str, ...]:
        """Sentences about models that do not have a value at every speed."""
        rows = (self.own, *self.others)
        return tuple(dict.fromkeys(f"{row.model}{_at(row)}: {row.refusal}" for row in rows if row.refusal))

    @property
    def standings(self) -> tuple[str, ...]:
        """Parts of each model that are not verified, with its source."""
        return tuple(dict.fromkeys(f"{row.model.split(',')[0]}: {row.standing} ({row.source})" for row in self.others))

    def ratios(self, row: ModelDraft) -> tuple[float, ...]:
        """Return the ratios of a model's drafts to this toolkit's at the same speeds [-]; NaN if either is NaN.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> found = po.crosscheck.compare(scene, speeds=[1.0, 2.0])
            >>> found.ratios(found.own)
            (1.0, 1.0)
        """
        pairs = zip(row.drafts, self.own.drafts, strict=True)
        return tuple(theirs / ours if ours else math.nan for theirs, ours in pairs)

    def table(self) -> Grid:
        """Return a table of drafts in kN, in brackets their ratios to this model's, and their rise with the speed.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> po.crosscheck.compare(scene, speeds=[1.0, 2.0]).table().columns[0].heading
            'model'
        """
        speeds = [f"{KM_PER_H * speed:.3g} km/h" for speed in self.speeds]
        title = "Mean draft in kN, ratio to this model's: calculated, not measured"
        table = Grid.of(title, "model", "depth", *speeds, "rise")
        table.row(self.own.model, "none", *map(_kilo, self.own.drafts), _percent(self.own.rise), end=True)
        for row in self.others:
            cells = (
                f"{_kilo(draft)} ({ratio:.2f})" if math.isfinite(ratio) else _kilo(draft)
                for draft, ratio in zip(row.drafts, self.ratios(row), strict=True)
            )
            table.row(row.model, "none" if row.depth is None else f"{row.depth:.3g} m", *cells, _percent(row.rise))
            if row.band:
                ends = ([_kilo(draft * (1.0 + sign * row.band)) for sign in (-1, 1)] for draft in row.drafts)
                table.row(f"  its band of ±{100.0 * row.band:.0f} %", "", *map(" to ".join, ends), "")
        return table

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each model, depth and speed in SI units, NaN where a model has no draft.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> po.crosscheck.compare(scene, speeds=[1.0, 2.0]).to_dataframe()["ratio"].tolist()[:2]
            [1.0, 1.0]
        """
        rows = [
            (row.model, math.nan if row.depth is None else row.depth, speed, draft, ratio)
            for row in (self.own, *self.others)
            for speed, draft, ratio in zip(self.speeds, row.drafts, self.ratios(row), strict=True)
        ]
        columns = dict(zip(("model", "depth", "speed", "draft", "ratio"), zip(*rows, strict=True), strict=True))
        return data_frame(columns, {"depth": "m", "speed": "m/s", "draft": "N"})

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw draft over speed, one panel per depth, and write the picture to a file if a path is given.

        Raises:
            InputError: the file's ending is not a picture format, or the file cannot be written.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> po.crosscheck.compare(scene, speeds=[1.0, 2.0]).plot().axes[0].get_xlabel()
            'speed [km/h]'
        """
        return written(_figure_of(self), path)


def _kilo(force: float) -> str:
    return f"{force / 1e3:.3g}" if math.isfinite(force) else "-"


def _percent(part: float) -> str:
    return f"{100.0 * part:.2g} %" if math.isfinite(part) else "-"


def _at(row: ModelDraft) -> str:
    return "" if row.depth is None else f" at {row.depth:.3g} m"


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
        Drafts, ratios and estimates. Drafts outside a model's domain are NaN, with the reason.

    Raises:
        InputError: the scene holds symbols, or texture or point is unknown.
        DomainError: an argument is outside every model's domain.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> found = po.crosscheck.compare(scene, depth=0.3, speeds=[1.0, 2.0])
        >>> found.speeds
        (1.0, 2.0)
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    if holds_casadi((scene, depth, width, rake_angle, speeds, rupture_ratio, surcharge, adhesion)):
        raise InputError("a comparison needs numbers: evaluate the scene with best(scene) first")
    check_named("point = {} does not exist in D497", point, POINTS)
    if texture is not None:
        check_named("texture = {} does not exist in D497", texture, TEXTURES)
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

    def draft(law: ResistanceLaw, speed: float) -> Expression:
        return law.reaction(dataclasses.replace(at, speed=speed)).at(speed)

    others = tuple(
        ModelDraft(name, d, *_drafts(partial(draft, law), course), law.source, law.standing, law.band)
        for name, d, law in (*rows, *((_short(law), None, law) for law in laws))
    )
    name = "this model" if scene.law.slender else f"this scene, {scene.law.label}"
    # The scene's quasi-static mean over whole wavelengths of the soil strength.
    drafts = _drafts(lambda speed: dataclasses.replace(scene, tow_speed=speed).steady_resistance, course)
    ours = ModelDraft(name, None, *drafts, scene.law.source, scene.law.standing)
    given = {"depth": depth, "width": width, "texture": texture, "rupture_ratio": rupture_ratio, "speeds": speeds}
    estimates = _estimates(scene, tine, point, [name for name, value in given.items() if value is None])
    return Comparison(scene.describe(), course, ours, others, estimates)


def _several(what: str, unit: str, given: float | Sequence[float], **domain: Any) -> tuple[float, ...]:
    """Return one or several numbers without duplicates, checked by `check_domain` with the given keywords."""
    refusal = f"{what} = {{}} must be one or more numbers, in {unit}"
    values = array_of(given, refusal, lambda array: array.size).ravel()
    check_domain(what, values, unit, **domain)
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
        earthmoving = UniversalEarthmoving(depth, **tine, rupture_ratio=rupture_ratio)
        for law in (McKyesAli(depth, **tine), earthmoving, SwickPerumpral(depth, **tine)):
            yield _short(law), depth, law
    yield _short(SphericalCavity), None, SphericalCavity()


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


def _estimates(scene: Scene, tine: dict[str, Any], point: str, missing: Sequence[str]) -> tuple[str, ...]:
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


# --- the picture ---


def _figure_of(comparison: Comparison) -> Figure:
    """Return the picture. A model has the same colour and marker in every panel."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    panels = comparison.depths or (None,)
    figure = figure_of_size(5.2 * len(panels) + 3.6, 5.0)
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, depth in zip(grid, panels, strict=True):
        _draw(axes, comparison, depth)
    drafts = [d for row in (comparison.own, *comparison.others) for d in row.drafts if math.isfinite(d) and d > 0.0]
    if drafts and max(drafts) > _LARGEST_LINEAR_RATIO * min(drafts):
        grid[0].set_yscale("log")
        grid[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        grid[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        grid[0].yaxis.set_minor_formatter(NullFormatter())
    else:
        grid[0].set_ylim(bottom=0.0)
    grid[0].set_ylabel("mean draft [kN]")
    shared_legend(figure, grid, loc="outside right upper")
    title = textwrap.fill(comparison.scene, int(_CHARACTERS_PER_INCH * figure.get_figwidth()))
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    return figure


def _draw(axes: Axes, comparison: Comparison, depth: float | None) -> None:
    """Draw the models at a depth, and those without one."""
    speeds, ours = [KM_PER_H * speed for speed in comparison.speeds], comparison.own
    models = list(dict.fromkeys(row.model for row in comparison.others))
    # A model may have values at one depth only.
    drawn = {row.model for row in comparison.others if not all(map(math.isnan, row.drafts))}
    axes.plot(speeds, [draft / 1e3 for draft in ours.drafts], color="black", linewidth=2.2, label=ours.model)
    for row in (row for row in comparison.others if row.depth in (depth, None)):
        own = line_style(models.index(row.model))
        name = row.model if row.model in drawn else f"{row.model}: outside its domain"
        axes.plot(speeds, [draft / 1e3 for draft in row.drafts], **own, markersize=5, linewidth=1.2, label=name)
        if row.band:
            low, high = ([part * draft / 1e3 for draft in row.drafts] for part in (1.0 - row.band, 1.0 + row.band))
            label = f"band of ±{100.0 * row.band:.0f} %"
            axes.fill_between(speeds, low, high, color=own["color"], alpha=0.12, lw=0.0, label=label)
    axes.set(xlabel="speed [km/h]", title="" if depth is None else f"working depth {depth:.3g} m")
    axes.grid(visible=True, alpha=0.3)
