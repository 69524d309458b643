"""Readings from CSV files: penetrometer profiles over depth, and records of strength along a path."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import LARGEST, LEAST, array_of, check_text, pair_of, path_of, plain_number, shown
from plough_opt.core.errors import InputError, about
from plough_opt.core.files import exact_text
from plough_opt.core.quantities import QUANTITIES
from plough_opt.core.tables import check_rising, columns_of, readings_of, table_of
from plough_opt.core.units import Unit
from plough_opt.motion.effects import SpeedProfile
from plough_opt.motion.effects.profile import profile_of
from plough_opt.problem_file.ranges import read_axis
from plough_opt.problem_file.schema import RANDOM
from plough_opt.problem_file.source import Source
from plough_opt.soil.strength import Spectrum, StrengthRecord, strength_spectrum
from plough_opt.studies.sweep.points import Range

Vector = NDArray[np.float64]

_INSERTIONS = "'insertion, depth [cm], cone_index [kPa]', or 'depth [cm], cone_index [kPa], cone_index [kPa]'"
_COURSE = 'a table like { time = ["0 s", "4 s"], speed = ["0 km/h", "9 km/h"] }'
_RECORD = "'position [m], cone_index [kPa]', or 'time [s], cone_index [kPa]'"
# With fewer insertions their standard deviation is too uncertain to fit a distribution to.
_FEWEST = 3


@dataclass(frozen=True)
class Penetrometer:
    """Cone index of each insertion, averaged over a range of depth.

    Attributes:
        name: the file.
        insertions: mean cone index of each insertion over the range of depth [Pa].

    Raises:
        InputError: there are no insertions, or a cone index is not above 0.

    Example:
        >>> import plough_opt as po
        >>> readings = po.read_penetrometer("problems/insertions.csv", (0.25, 0.45))
        >>> len(readings.insertions)
        8
    """

    name: str
    insertions: Vector

    def __post_init__(self) -> None:
        check_text("the name of a penetrometer's file", self.name)
        wrong = f"{self.name}: insertions = {{}} must be cone indices above 0 in Pa, one for each insertion"

        def valid(values: Vector) -> bool:
            return values.ndim == 1 and values.size > 0 and bool(np.all((values >= LEAST) & (values <= LARGEST)))

        object.__setattr__(self, "insertions", array_of(self.insertions, wrong, valid))

    @property
    def mean(self) -> float:
        """Mean of the insertions [Pa]."""
        return float(np.mean(self.insertions))

    @property
    def spread(self) -> float:
        """Standard deviation between the insertions [Pa].

        Raises:
            InputError: fewer than three insertions.
        """
        if len(self.insertions) < _FEWEST:
            raise InputError(f"a spread needs {_FEWEST} insertions, but {self.name} has {len(self.insertions)}")
        return float(np.std(self.insertions, ddof=1))

    def distribution(self) -> Any:
        """Return a scipy.stats lognormal distribution with the insertions' mean and spread [Pa].

        Raises:
            InputError: there are fewer than three insertions, or all are equal.

        Example:
            >>> import plough_opt as po
            >>> readings = po.read_penetrometer("problems/insertions.csv", (0.25, 0.45))
            >>> bool(abs(readings.distribution().mean() / readings.mean - 1.0) < 1e-9)
            True
        """
        if self.spread == 0.0:
            raise InputError(f"{self.name}: all insertions have the same mean, so nothing is uncertain")
        return lognormal(self.mean, self.spread)


def lognormal(mean: float, std: float) -> Any:
    """Return a scipy.stats lognormal distribution with a given mean and standard deviation."""
    from scipy import stats  # slow to import, and rarely needed

    width = math.sqrt(math.log1p((std / mean) ** 2))
    return stats.lognorm(width, scale=mean * math.exp(-0.5 * width**2))


def read_penetrometer(path: str | Path, depth: tuple[float, float]) -> Penetrometer:
    """Read a penetrometer's CSV file and average every insertion over a range of depth.

    The first line that is neither empty nor begins with ``#`` names the columns with their units: ``depth`` and
    ``cone_index``. Several insertions have one column ``cone_index`` each, or share one beside a column ``insertion``
    with their numbers. Depths must increase within an insertion; between readings the cone index is interpolated
    linearly.

    Args:
        path: the file.
        depth: shallowest and deepest depth [m]; every insertion must cover this range.

    Returns:
        The mean cone index of every insertion. Pass its ``mean`` to `Soil.from_cone_index`, or its ``distribution()``,
        multiplied by ``strength_factor / mean``, to a `SoilDistribution`.

    Raises:
        InputError: the file does not exist, a column or cell is invalid (each listed with its line), or an insertion
            does not cover the range.

    Example:
        >>> import plough_opt as po
        >>> po.read_penetrometer("problems/insertions.csv", (0.25, 0.45)).mean > 1e5
        True
    """
    low, high = pair_of("depth", depth)
    plain_number("the shallowest depth", low, "m", at_least=0.0)

    def fit(count: Counter[str]) -> bool:
        return count["depth"] == 1 <= count["cone_index"] and count["insertion"] * count["cone_index"] <= 1

    lines, columns = _columns(path, {"depth": "m", "cone_index": "Pa", "insertion": ""}, fit, _INSERTIONS)
    depths, indices = columns["depth"][:, 0], columns["cone_index"]
    # An insertion is a column, or the rows with its number.
    which = columns["insertion"][:, 0] if "insertion" in columns else np.zeros(len(depths))
    means = []
    for label, column in product(dict.fromkeys(which.tolist()), range(indices.shape[1])):
        own = which == label
        check_rising(Path(path), lines[own].tolist(), depths[own], "depths of an insertion")
        with about(f"{path}, insertion {label if 'insertion' in columns else column + 1:g}:"):
            means.append(_mean(depths[own], indices[own, column], low, high))
    return Penetrometer(str(path), np.array(means))


def _columns(
    path: str | Path, units: Mapping[str, str], fit: Callable[[Counter[str]], bool], example: str
) -> tuple[NDArray[np.int_], dict[str, Vector]]:
    """Return the numbers of a CSV file's lines, and name -> values in SI, shape (lines, columns of this name).

    Args:
        path: the file.
        units: name of each column that it may have -> SI unit.
        fit: whether columns of these names, with their numbers, belong together.
        example: of such columns, for messages.
    """
    path = path_of("the file of readings", path)
    place, headings, rows = readings_of(path, example)
    columns = columns_of(place, headings, {name: Unit(unit) for name, unit in units.items()})
    names = [name for name, _ in columns]
    if not fit(Counter(names)):
        raise InputError(f"{place}: columns {', '.join(names)} are not what is needed: name them as {example}")

    def check(k: int, value: float, cell: str) -> None:
        if value < 0.0 and names[k] in ("depth", "cone_index"):
            raise InputError(f"{cell} must be at least 0")

    table = table_of(path, rows, columns, check)
    return np.array([line for line, _ in rows]), {name: table[:, np.array(names) == name] for name in names}


def average_readings(source: Source, folder: Path) -> str:
    """Replace the keys penetrometer and depth in [soil] by the mean cone index, and return a sentence that says so.

    A distribution "penetrometer" of the cone index in [uncertain] becomes the lognormal one of the insertions.
    """
    soil = source.data.get("soil")
    if not isinstance(soil, dict) or not {"penetrometer", "depth"} & {*soil}:
        return ""
    if ("soil", "cone_index") in source.overridden:
        return ""
    with source.noting(("soil", "penetrometer")):
        if "cone_index" in soil:
            raise InputError("both a cone index and a penetrometer's file are given: remove one")
        written, depth = soil.get("penetrometer"), soil.get("depth")
        if not isinstance(written, str) or not isinstance(depth, str):
            raise InputError('penetrometer = "FILE.csv" and depth = "25..45 cm" belong together: give both')
        try:
            between, _ = read_axis(depth, Unit("m"), sampled=True)
        except InputError:
            raise InputError(f'depth = "{depth}" is not a range of depths: write it like "25..45 cm"') from None
        assert isinstance(between, Range)  # which read_axis returns for samples
        readings = read_penetrometer(folder / written, (between.lower, between.upper))
        source.read_files[written] = exact_text(folder / written)
        soil["cone_index"] = f"{readings.mean / 1e6!r} MPa"
        uncertain = source.written("uncertain")
        entry = uncertain.get("soil.cone_index") if isinstance(uncertain, dict) else None
        if isinstance(entry, dict) and entry.get("distribution") == "penetrometer":
            entry |= {"distribution": "lognormal", "mean": f"{readings.mean!r} Pa", "std": f"{readings.spread!r} Pa"}
        count = len(readings.insertions)
        return f"{readings.mean / 1e6:.4g} MPa, mean of {count} insertion{'s' * (count > 1)} over {depth} in {written}"
    return ""


def _mean(depth: Vector, pressure: Vector, low: float, high: float) -> float:
    """Return the mean of a curve between two depths [Pa]."""
    if not (depth[0] <= low and high <= depth[-1]):
        cover = f"{100 * depth[0]:.4g} to {100 * depth[-1]:.4g} cm, not {100 * low:.4g} to {100 * high:.4g} cm"
        raise InputError(f"its readings cover {cover}: narrow the depth, or remove this insertion")
    inner = (depth > low) & (depth < high)
    places = np.r_[low, depth[inner], high]
    mean = float(np.trapezoid(np.interp(places, depth, pressure), places) / (high - low))
    if not mean > 0.0:
        raise InputError("its mean cone index is 0, which no soil has: check the readings")
    return mean


def read_strength_record(path: str | Path, *, tow_speed: float | None = None) -> StrengthRecord:
    """Return a record of soil strength along a path, read from a CSV file.

    The first line that is neither empty nor begins with ``#`` names two columns with their units: ``position`` or
    ``time``, and ``cone_index``.

    Args:
        path: the file.
        tow_speed: speed of the instrument, if the readings are over time [m/s].

    Raises:
        InputError: the file does not exist, a column or cell is invalid (each listed with its line), or times are given
            without a speed.
        DomainError: the speed is below 0.

    Example:
        >>> import plough_opt as po
        >>> len(po.read_strength_record("problems/transect.csv").position) > 100
        True
    """

    def fit(count: Counter[str]) -> bool:
        return count["position"] + count["time"] == 1 == count["cone_index"]

    lines, columns = _columns(path, {"position": "m", "time": "s", "cone_index": "Pa"}, fit, _RECORD)
    along = "time" if "time" in columns else "position"
    position = columns[along][:, 0]
    check_rising(Path(path), lines.tolist(), position, along)
    if along == "time" and tow_speed is None:
        raise InputError(f"{path}: readings over time need the tow speed, which turns times into positions")
    speed = plain_number("tow speed", QUANTITIES["scene.tow_speed"].read(tow_speed)) if along == "time" else 1.0
    return StrengthRecord(position * speed, columns["cone_index"][:, 0], str(path))


def course_of_file(source: Source) -> SpeedProfile | None:
    """Replace a table of times and tow speeds in [scene] by the largest speed, and return the course relative to it."""
    written = source.written("scene.tow_speed")
    if not isinstance(written, dict):
        return None
    source.data["scene"]["tow_speed"] = "1 m/s"  # as long as the table is not read
    with source.noting(("scene", "tow_speed"), prefix="'scene.tow_speed' "):
        columns: list[Any] = [written.get(name) for name in ("time", "speed")]
        lengths = {len(column) if isinstance(column, list) else 0 for column in columns}
        if len(written) != 2 or len(lengths) > 1 or max(lengths) < 2:
            raise InputError(f"= {shown(written)} must be a speed, or {_COURSE}")
        times, speeds = ([*map(Unit(unit).parse, own)] for unit, own in zip(("s", "m/s"), columns, strict=True))
        largest, profile = profile_of((times, speeds))
        if source.written("scene.average") == "whole waves":
            raise InputError('varies, and average = "whole waves" needs a constant speed: remove one of the two')
        source.data["scene"]["tow_speed"] = columns[1][speeds.index(largest)]
        return profile
    return None


def spectrum_of_file(source: Source, table: Any, folder: Path) -> Spectrum | None:
    """Return the spectrum of the record that the table of random strength names, or None; note what is wrong."""
    random = table.effects.random_strength
    if random is None or random.record is None:
        return None
    with source.noting((*RANDOM.split("."), "record")):
        record = read_strength_record(folder / random.record)
        source.read_files[random.record] = exact_text(folder / random.record)
        return strength_spectrum(record, base_diameter=random.base_diameter or 0.0)
    return None
