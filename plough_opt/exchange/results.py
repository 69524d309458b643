"""Results as JSON files: written with versions and a schema number, read back by `load`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import MISSING, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Generic, Literal, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    TypeAdapter,
    ValidationError,
    create_model,
)
from pydantic_core import from_json

from plough_opt.core.errors import InputError, short
from plough_opt.core.files import ascii_json, write_file
from plough_opt.core.kinds import path_of, shown
from plough_opt.core.origin import Origin, versions
from plough_opt.core.tables import Page, Readable, data_frame
from plough_opt.design import LocalOptimum, Optimum, Sensitivity
from plough_opt.motion import Averages, Run
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.run import OUTPUTS
from plough_opt.motion.vocabulary import quantities_of

if TYPE_CHECKING:
    import pandas

SCHEMA: Final = 1
"""Number of the layout of saved results; it rises when a key changes its meaning."""

_T = TypeVar("_T")


class Saved(BaseModel):
    """What every saved result says about itself."""

    model_config = ConfigDict(
        frozen=True, arbitrary_types_allowed=True, populate_by_name=True, ser_json_inf_nan="strings"
    )

    layout: Annotated[Literal[1], Field(alias="schema")]
    title: str
    versions: dict[str, str]
    origin: Origin = Origin()

    def to_json(self) -> str:
        """Return the result as JSON text of ASCII characters; infinite numbers as "Infinity"."""
        return ascii_json(self.model_dump_json(indent=2, by_alias=True))


def _checked(averages: Averages) -> Averages:
    """Return averages, which a scene of symbols has too, as those of numbers.

    Raises:
        ValueError: one is no finite number.
    """
    for name in Averages.__dataclass_fields__:
        value = getattr(averages, name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise ValueError(f"{name} must be a finite number")
    return averages


class Kept(Readable, Saved):
    """A saved result that holds what it showed of itself, and shows it again."""

    shown: Page = Page("")

    def page(self) -> Page:
        """Return what the result showed of itself when it was saved."""
        return self.shown

    def save(self, path: str | Path) -> Path:
        """Write the result as JSON, making its folder.

        Raises:
            InputError: the place cannot be written.
        """
        return write_file(path, "result", self.to_json() + "\n")


class SavedRun(Kept):
    """A run of numbers: SI units; arrays over the output times.

    Attributes:
        quantities: of the scene, by the names that problem files give them.
        scene: the scene in words, and its effects.
    """

    kind: Literal["run"] = "run"
    accuracy: Accuracy
    error_estimate: float
    seconds: FiniteFloat
    warnings: tuple[str, ...]
    ambient_share: FiniteFloat
    averages: Annotated[Averages, AfterValidator(_checked)]
    peak_force: FiniteFloat
    peak_deflection: FiniteFloat
    specific_draft: FiniteFloat | None
    time: list[FiniteFloat]
    travel: list[FiniteFloat]
    speed: list[FiniteFloat]
    deflection: list[FiniteFloat]
    mount_force: list[FiniteFloat]
    soil_resistance: list[FiniteFloat]
    quantities: dict[str, FiniteFloat] = {}
    scene: tuple[str, str] = ("", "")

    @classmethod
    def of(cls, run: Run, title: str = "") -> SavedRun:
        """Take what is worth keeping of a run."""
        arrays = {name: np.asarray(getattr(run, name)).tolist() for name in _ARRAYS}
        own = {name: getattr(run, name) for name in _RUN}
        return cls(
            layout=SCHEMA,
            title=title or run.origin.title,
            versions=versions(),
            origin=run.origin,
            shown=run.page(),
            quantities={name: float(x) for name, x in quantities_of(run.scene).items() if x is not None},
            scene=(run.scene.describe(), repr(run.scene.effects)),
            averages=_floats(run.averages),
            ambient_share=float(run.scene.ambient_share),
            specific_draft=None if run.scene.law.lacks("loosened_radius") else run.specific_draft,
            **own,
            **arrays,
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each output time, SI; ``attrs["units"]`` has the units.

        Raises:
            InputError: pandas is not installed.
        """
        return data_frame({name: getattr(self, name) for name in _ARRAYS}, OUTPUTS)


_ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")
_RUN = ("accuracy", "error_estimate", "seconds", "warnings", "peak_force", "peak_deflection")


class SavedOptimum(Kept):
    """An optimum: variables in SI units, limits, all local optima, and the run at the best one."""

    kind: Literal["optimum"] = "optimum"
    status: str
    seconds: float
    warnings: tuple[str, ...]
    flat_directions: tuple[dict[str, float], ...]
    best: LocalOptimum
    local_optima: tuple[LocalOptimum, ...]
    run: SavedRun | None = None
    sensitivities: tuple[Sensitivity, ...] = ()
    search: str = ""
    over: str = ""

    @classmethod
    def of(
        cls, best: Optimum, run: Run | None = None, title: str = "", sensitivities: Sequence[Sensitivity] = ()
    ) -> SavedOptimum:
        """Take what is worth keeping of an optimum, its run if it has one, and what it was asked."""
        run = run or (best.run if isinstance(best.run, Run) else None)
        return cls(
            layout=SCHEMA,
            title=title or best.origin.title,
            versions=versions(),
            origin=best.origin,
            shown=best.page(),
            status=best.status,
            seconds=best.seconds,
            warnings=best.warnings,
            flat_directions=best.flat_directions,
            best=best.local_optima[0],
            local_optima=best.local_optima,
            run=None if run is None else SavedRun.of(run, title),
            sensitivities=tuple(sensitivities),
            search=str(best.search or ""),
            over=best.over,
        )


class Form(Generic[_T]):
    """The JSON form of a dataclass of results: its fields, and the kind by which `load` finds it.

    Args:
        result: the dataclass.
        kind: its kind in a file.
        unsaved: fields that are left out.
    """

    def __init__(self, result: type[_T], kind: str, unsaved: Collection[str] = ()) -> None:
        types = get_type_hints(result)
        own: Any = {
            field.name: (types[field.name], ... if field.default is MISSING else field.default)
            for field in fields(cast(Any, result))
            if field.name not in (*unsaved, *Saved.model_fields)
        }
        literal: Any = Literal[kind]
        self._result = result
        self._model = create_model(f"Saved{result.__name__}", __base__=Saved, kind=(literal, kind), **own)
        self._names = [name for name in self._model.model_fields if name not in ("layout", "kind")]

    def to_json(self, result: _T, **changed: Any) -> str:
        """Return a result, some fields of which may be changed, as JSON text with versions and a schema number."""
        values = {name: getattr(result, name) for name in self._names} | changed
        return self._model(layout=SCHEMA, **values).to_json()

    def load(self, path: str | Path, name: str, kind: str) -> _T:
        """Read a result from a file; the arguments are those of `read_saved`."""
        saved = read_saved(path, name, kind, self._model.model_validate_json)
        return self._result(**{name: getattr(saved, name) for name in self._names})


# Characters of a saved result, some hundred times the longest that the commands write.
_MOST_BYTES: Final = 100_000_000
# What nothing may be known of: a motion that cannot be predicted, and what data do not determine -> texts of its ends.
_MAY_BE_INFINITE: Final = {
    **dict.fromkeys(("error_estimate", "standard_error", "sigma", "errors"), ("Infinity",)),
    "interval": ("Infinity", "-Infinity"),
}
# First bytes of an SQLite file.
_STORE: Final = b"SQLite format 3"
# Kinds of results that are built upon this module -> where what reads them is, imported when such a file is read.
_LATER: Final = {
    "trade-off": ("plough_opt.studies.tradeoff.result", "TradeOff"),
    "accuracy study": ("plough_opt.studies.accuracy.result", "AccuracyStudy"),
    "calibration": ("plough_opt.studies.calibration.fit", "Fit"),
    "robust optimum": ("plough_opt.studies.uncertainty.result", "SavedRobust"),
}


def load(path: str | Path) -> Any:
    """Read a result that the command line or ``to_json`` wrote, of whatever kind.

    Returns:
        A `SavedRun`, a `SavedOptimum`, a `TradeOff`, an `AccuracyStudy`, a `Fit` of a calibration, or a `SavedRobust`.

    Raises:
        InputError: no such file, or not a result of this layout.
    """
    path = path_of("the result", path)
    if is_store(path):
        raise InputError(f"{shown(str(path), 200)} is the store of a sweep: po.Sweep.load reads it")
    kind = read_saved(path, "result", "a result", _Kind.model_validate_json).kind
    if kind in _LATER:
        module, name = _LATER[kind]
        found = getattr(import_module(module), name)
        if hasattr(found, "load"):
            return found.load(path)
        return read_saved(path, "result", "a result", found.model_validate_json)
    either: TypeAdapter[SavedRun | SavedOptimum] = TypeAdapter(
        Annotated[SavedRun | SavedOptimum, Field(discriminator="kind")]
    )
    return read_saved(path, "result", "a result", either.validate_json)


def is_store(path: Path) -> bool:
    """Return whether a file is the store of a sweep."""
    try:
        with path.open("rb") as file:
            return file.read(len(_STORE)) == _STORE
    except OSError:  # which `read_saved` tells
        return False


class _Kind(BaseModel):
    """What every result says first."""

    kind: str


def read_saved(path: str | Path, name: str, kind: str, validate: Callable[..., _T]) -> _T:
    """Return what a JSON file holds.

    Args:
        path: the file.
        name: what messages call its content, like "study".
        kind: what it must be, like "an accuracy study".
        validate: pydantic's reader of that kind, which is asked to take neither a text nor a switch for a number.

    Raises:
        InputError: no such file, or another kind or layout.
    """
    try:
        with Path(path).open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"the {name} {shown(str(path), 200)} cannot be read: {short(str(error), 200)}") from None
    if len(content) > _MOST_BYTES:
        raise InputError(f"the {name} '{path}' is too long: at most {_MOST_BYTES // 1_000_000} MB can be read")
    try:
        found = validate(json.dumps(_parsed(text)), strict=True)
    except ValueError as error:
        place, why = "its beginning", str(error)
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            place, why = ".".join(map(str, first["loc"])) or place, first["msg"]
        raise InputError(
            f"'{path}' is not {kind} of this version (schema {SCHEMA}): at {short(place)}: {short(why, 200)}; name"
            " another file, or write it anew"
        ) from None
    return found


def _parsed(text: str) -> Any:
    """Return JSON with the text "Infinity" as a number, where a result may be infinite and nowhere else.

    Raises:
        ValueError: not JSON, NaN, or a number beyond all floats.
    """
    try:
        data = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise ValueError(f"Invalid JSON: {error}") from None
    rest = [data]
    while rest:
        value = rest.pop()
        if isinstance(value, dict | list):
            rest += value.values() if isinstance(value, dict) else value
        elif isinstance(value, int | float) and not abs(value) <= sys.float_info.max:
            raise ValueError("a number is beyond all floats")
    return _with_infinity(data)


def _with_infinity(data: Any, ends: tuple[str, ...] = ()) -> Any:
    """Return parsed JSON with numbers for the texts that `_MAY_BE_INFINITE` allows.

    Args:
        data: what JSON holds.
        ends: the texts that stand for a number in it.
    """
    if isinstance(data, list):
        return [_with_infinity(value, ends) for value in data]
    if isinstance(data, dict):
        return {key: _with_infinity(value, _MAY_BE_INFINITE.get(key, ends)) for key, value in data.items()}
    return float(data) if isinstance(data, str) and data in ends else data


def _floats(averages: Averages) -> Averages:
    return Averages(**{name: float(getattr(averages, name)) for name in Averages.__dataclass_fields__})
