"""Results as JSON files: written with versions and a schema number, read back by `load`."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from plough_opt.accuracy import Accuracy
from plough_opt.design import LocalOptimum, Optimum, Sensitivity
from plough_opt.errors import InputError
from plough_opt.files import ascii_json
from plough_opt.motion import Averages, Run

SCHEMA: Final = 1
"""Number of the layout of saved results; it rises when a key changes its meaning."""

_T = TypeVar("_T")


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("plough_opt", "casadi", "numpy")}
    return {**packages, "python": platform.python_version(), "machine": platform.machine()}


class Saved(BaseModel):
    """What every saved result says about itself."""

    model_config = ConfigDict(
        frozen=True, arbitrary_types_allowed=True, populate_by_name=True, ser_json_inf_nan="strings"
    )

    layout: Annotated[Literal[1], Field(alias="schema")]
    title: str
    versions: dict[str, str]

    def to_json(self) -> str:
        """Return the result as JSON text of ASCII characters; infinite numbers as "Infinity"."""
        return ascii_json(self.model_dump_json(indent=2, by_alias=True))


class SavedRun(Saved):
    """A run of numbers: SI units; arrays over the output times."""

    kind: Literal["run"] = "run"
    accuracy: Accuracy
    error_estimate: float
    seconds: float
    warnings: tuple[str, ...]
    ambient_share: float
    averages: Averages
    peak_force: float
    peak_deflection: float
    specific_draft: float | None
    time: list[float]
    travel: list[float]
    speed: list[float]
    deflection: list[float]
    mount_force: list[float]
    soil_resistance: list[float]

    @classmethod
    def of(cls, run: Run, title: str) -> SavedRun:
        """Take what is worth keeping of a run."""
        arrays = {name: np.asarray(getattr(run, name)).tolist() for name in _ARRAYS}
        own = {name: getattr(run, name) for name in _RUN}
        return cls(
            layout=SCHEMA,
            title=title,
            versions=versions(),
            averages=_floats(run.averages),
            ambient_share=float(run.scene.ambient_share),
            specific_draft=run.specific_draft if run.scene.medium == "plastic" else None,
            **own,
            **arrays,
        )


_ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")
_RUN = ("accuracy", "error_estimate", "seconds", "warnings", "peak_force", "peak_deflection")


class SavedOptimum(Saved):
    """An optimum: variables in SI units, limits, all local optima, and the run at the best one."""

    kind: Literal["optimum"] = "optimum"
    status: str
    seconds: float
    warnings: tuple[str, ...]
    flat_directions: tuple[dict[str, float], ...]
    best: LocalOptimum
    local_optima: tuple[LocalOptimum, ...]
    run: SavedRun
    sensitivities: tuple[Sensitivity, ...] = ()

    @classmethod
    def of(cls, best: Optimum, run: Run, title: str, sensitivities: Sequence[Sensitivity] = ()) -> SavedOptimum:
        """Take what is worth keeping of an optimum, its run and what it was asked."""
        return cls(
            layout=SCHEMA,
            title=title,
            versions=versions(),
            status=best.status,
            seconds=best.seconds,
            warnings=best.warnings,
            flat_directions=best.flat_directions,
            best=best.local_optima[0],
            local_optima=best.local_optima,
            run=SavedRun.of(run, title),
            sensitivities=tuple(sensitivities),
        )


# First bytes of an SQLite file.
_STORE: Final = b"SQLite format 3"
# Kinds of results that are built upon this module -> where what reads them is, imported when such a file is read.
_LATER: Final = {
    "trade-off": ("plough_opt.tradeoff.result", "TradeOff"),
    "accuracy study": ("plough_opt.accuracy_study.result", "AccuracyStudy"),
    "calibration": ("plough_opt.calibration.fit", "Fit"),
    "robust optimum": ("plough_opt.uncertainty.result", "SavedRobust"),
}


def load(path: str | Path) -> Any:
    """Read a result that the command line or ``to_json`` wrote, of whatever kind.

    Returns:
        A `SavedRun`, a `SavedOptimum`, a `TradeOff`, an `AccuracyStudy`, a `Fit` of a calibration, or a `SavedRobust`.

    Raises:
        InputError: no such file, or not a result of this layout.
    """
    if _is_store(Path(path)):
        raise InputError(f"'{path}' is the store of a sweep: po.Sweep.load reads it")
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


def _is_store(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(_STORE)) == _STORE
    except OSError:  # which `read_saved` tells
        return False


class _Kind(BaseModel):
    """What every result says first."""

    kind: str


def read_saved(path: str | Path, name: str, kind: str, validate: Callable[[str], _T]) -> _T:
    """Return what a JSON file holds.

    Args:
        path: the file.
        name: what messages call its content, like "study".
        kind: what it must be, like "an accuracy study".
        validate: pydantic's reader of that kind.

    Raises:
        InputError: no such file, or another kind or layout.
    """
    try:
        return validate(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the {name} '{path}' cannot be read: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "its beginning"
        raise InputError(
            f"'{path}' is not {kind} of this version (schema {SCHEMA}): at {place}: {first['msg']}"
        ) from None


def _floats(averages: Averages) -> Averages:
    return Averages(**{name: float(getattr(averages, name)) for name in Averages.__dataclass_fields__})
