"""Saving results as JSON: the fields to restore them, the page they show, and the question they answer; `load`."""

from __future__ import annotations

import hashlib
import itertools
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, Final, Self

from plough_opt.core.checks import path_of, shown
from plough_opt.core.errors import InputError, short
from plough_opt.core.expressions import ByValue
from plough_opt.core.files import BYTE_ORDER_MARK, exact_text, read_text, write_file
from plough_opt.core.plain_data import from_plain, json_text, to_plain
from plough_opt.core.tables import Page, Readable
from plough_opt.core.units import Display, customary

SCHEMA: Final = 3
"""Version of the layout of saved results; it increases when a key changes its meaning."""

# Largest file read: some hundred times the largest that the commands write.
_MOST_BYTES: Final = 100_000_000
# Kind of saved result -> module and name of its class, below this package.
_CLASSES: Final = {
    "run": "motion.run:Run",
    "machine": "motion.run:Machine",
    "batch": "motion.batch:BatchResult",
    "local optimum": "design.result.optimum:LocalOptimum",
    "optimum": "design.result.optimum:Optimum",
    "rounded optimum": "design.result.optimum:Rounded",
    "trade-off": "studies.tradeoff.result:TradeOff",
    "accuracy study": "studies.accuracy:AccuracyStudy",
    "calibration": "studies.calibration.fit:Fit",
    "robust optimum": "studies.uncertainty.result:RobustOptimum",
}


def versions() -> dict[str, str]:
    """Return the versions of the packages that a result depends on, of Python, and the kind of machine."""
    packages = {name: version(name) for name in ("plough_opt", "casadi", "numpy")}
    return {**packages, "python": platform.python_version(), "machine": platform.machine()}


@dataclass(frozen=True)
class _Head:
    """Entries with which every saved result begins."""

    schema: int
    kind: str
    title: str
    versions: dict[str, str]
    shown: Page


@dataclass(frozen=True)
class Origin:
    """The question that a result answers; empty for a result computed in Python without a title.

    Attributes:
        title: title of the question.
        displays: key or result -> unit in which the question writes it.
        file: name of the problem file, without its folder.
        text: contents of the problem file, with the line ends and the byte order mark of the file.
        sha256: SHA-256 digest of its bytes, computed if empty.
        overrides: changes made by ``--set``, in order.
        data: name of a data file, as written in the problem file -> contents of that file.
        limits: result -> lower and upper limit that the question requires, SI; None for no limit.
        declarations: for a design in Python: its variables, parameters, requirements and objective by name.
        seed: seed of the random samples.
        machine: kind of machine, without its name.
        made: date and time in UTC.

    Raises:
        InputError: the text does not have this digest.
    """

    title: str = ""
    displays: Mapping[str, Display] = field(default_factory=dict)
    file: str = ""
    text: str = ""
    sha256: str = ""
    overrides: tuple[str, ...] = ()
    data: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    declarations: Mapping[str, Mapping[str, str | float | None]] = field(default_factory=dict)
    seed: int | None = None
    machine: str = ""
    made: str = ""

    def __post_init__(self) -> None:
        digest = hashlib.sha256(self.text.encode()).hexdigest() if self.text else ""
        if self.sha256 not in ("", digest):
            raise InputError(f"the text of its problem file was changed: its SHA-256 is not {self.sha256[:12]!r}")
        object.__setattr__(self, "sha256", digest)

    def now(self) -> Origin:
        """Return the origin of a result computed now, on this machine."""
        machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
        return replace(self, machine=machine, made=datetime.now(UTC).isoformat(timespec="seconds"))

    def with_data(self, paths: Iterable[str | Path]) -> Origin:
        """Return the origin with further data files, each under its name without folder.

        A name that another file has gets a number: ``plot.csv``, ``plot-2.csv``.
        """
        data = dict(self.data)
        for path in map(Path, paths):
            taken = {name.casefold() for name in (self.file, *data)}
            names = (f"{path.stem}{'' if k == 1 else f'-{k}'}{path.suffix}" for k in itertools.count(1))
            data[next(name for name in names if name.casefold() not in taken)] = exact_text(path)
        return replace(self, data=data)

    def lines(self, made_by: Mapping[str, str]) -> tuple[str, ...]:
        """Return sentences that say from which file, when and with which versions a result was computed.

        Args:
            made_by: package -> version.
        """
        changed = f", changed by --set {' --set '.join(self.overrides)}" if self.overrides else ""
        seed = "" if self.seed is None else f", seed {self.seed}"
        packages = ", ".join(f"{name} {number}" for name, number in made_by.items())
        file = f"Made from {self.file} (SHA-256 {self.sha256[:12]}){changed}{seed}." if self.file else ""
        when = f"Made at {self.made} on {self.machine} by {packages}." if self.made else ""
        return tuple(line for line in (file, when) if line)

    def problem(self) -> str:
        """Return the problem file, its ``--set`` changes and its data files as one text, or "" if there is none.

        For a design in Python the text lists the declarations, one per line.
        """
        changes = [f"# --set {change}" for change in self.overrides]
        data = [f"# --- {name} ---\n{_lines_of(text)}" for name, text in self.data.items()]
        declared = [f"{name}: " + ", ".join(f"{key} {value}" for key, value in own.items() if value is not None)
                    for name, own in self.declarations.items()]  # fmt: skip
        return "\n".join([*([_lines_of(self.text)] if self.text else []), *changes, *data, *declared])

    def display(self, name: str, unit: str, *values: float) -> Display:
        """Return the unit in which a quantity or a result is shown: the question's, else the customary one.

        Args:
            name: key of the quantity, or the result.
            unit: its SI unit.
            values: all values displayed together, SI.
        """
        return self.displays.get(name) or customary(unit, *values)

    def common(self, unit: str, values: Mapping[str, float]) -> Display:
        """Return one unit for several results displayed together: the first that the question writes.

        Args:
            unit: their SI unit.
            values: result -> value, SI.
        """
        written = (self.displays[name] for name in values if name in self.displays)
        return next(written, None) or customary(unit, *values.values())


def _lines_of(text: str) -> str:
    """Return the text of a file with single line feeds, and none at its end."""
    return text.removeprefix(BYTE_ORDER_MARK).replace("\r\n", "\n").rstrip()


class Saveable(ByValue, Readable):
    """A dataclass of results that can be saved as JSON and read back.

    Attributes:
        kind: identifies the class in a file.
    """

    kind: ClassVar[str]

    def also_saved(self) -> dict[str, Any]:
        """Return further entries of the file, for other programs that read it."""
        return {}

    def check_saved(self) -> None:
        """Raise ValueError if the fields of a result that was read are inconsistent."""

    @property
    def made_by(self) -> dict[str, str]:
        """Versions of the packages that computed the result, and the kind of machine."""
        return dict(getattr(self, "_made_by", None) or getattr(self, "versions", None) or versions())

    def to_json(self, page: Page | None = None) -> str:
        """Return the result as strictly valid ASCII JSON, in SI units, with infinite numbers as "Infinity".

        Args:
            page: the page to save, if it has more than `page` returns.

        Raises:
            InputError: the result contains something that cannot be saved.

        Example:
            >>> import json
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> json.loads(run.to_json())["kind"]
            'run'
        """
        origin: Origin = getattr(self, "origin", Origin())
        head = to_plain(_Head(SCHEMA, self.kind, origin.title, self.made_by, page or self.shown_page()), _Head)
        read = getattr(self, "_extra", None)  # set if the result was read
        plain = head | to_plain(self.also_saved() if read is None else read) | to_plain(self, type(self))
        return json_text(plain)

    def save(self, path: str | Path) -> Path:
        """Write the result as JSON, creating its folder; `plough_opt.load` reads it back.

        Raises:
            InputError: the result contains something that cannot be saved, or the file cannot be written.

        Example:
            >>> import tempfile
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     path = run.save(f"{folder}/run.json")
            >>> path.name
            'run.json'
        """
        return write_file(path, "result", f"{self.to_json()}\n")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return a result read from a file that `save`, or a command with ``--json``, wrote.

        Raises:
            InputError: the file does not exist, or does not hold a result of this kind and layout.

        Example:
            >>> import tempfile
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     again = po.Run.load(run.save(f"{folder}/run.json"))
            >>> bool(again.mean_draft == run.mean_draft)
            True
        """
        result: Self = _read(path, cls)
        return result


def load(path: str | Path) -> Any:
    """Return a result of any kind that ``save``, or a command with ``--json``, wrote.

    It prints, plots and gives data frames as it did when it was saved. What needs more than data, such as the design
    behind an optimum, is not saved: solve again for it.

    Returns:
        A `Run`, `Machine`, `Optimum`, `LocalOptimum`, `TradeOff`, `AccuracyStudy`, `Fit`, `BatchResult`, or a robust
        optimum.

    Raises:
        InputError: there is no such file, or it is not a saved result of this version.

    Example:
        >>> import tempfile, plough_opt as po
        >>> scene = po.Scene(po.named_soil("serozem"), po.Cone("10 deg", "25 cm"), "50 kN/m", "30 kg", "2 m/s")
        >>> run = po.simulate(scene, "0.1 s")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     again = po.load(run.save(f"{folder}/run.json"))
        >>> str(again) == str(run)
        True
    """
    return _read(path, Saveable)


def _read(path: str | Path, wanted: type) -> Any:
    """Return the result in a JSON file.

    Raises:
        InputError: the file does not exist, is the store of a sweep, or holds another kind or layout.
    """
    from pydantic_core import from_json

    path = path_of("the result", path)
    text = read_text(path, "a saved result", ".json", _MOST_BYTES).removeprefix(BYTE_ORDER_MARK)
    try:
        return _result_of(from_json(text, allow_inf_nan=False), wanted)
    except (ValueError, RecursionError, TypeError) as error:
        kind = getattr(wanted, "kind", "result")
        which = f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} of this version (schema {SCHEMA})"
        why = f"{short(str(error), 200)}; name a file that save or --json wrote"
        raise InputError(f"'{path}' is not {which}: {why}") from None


def _result_of(data: Any, wanted: type) -> Any:
    """Return the result in a parsed JSON document.

    Raises:
        ValueError: the document does not hold a result of this version and class.
    """
    if not isinstance(data, dict) or "schema" not in data:
        raise ValueError("it has no schema")
    if data["schema"] != SCHEMA or isinstance(data["schema"], bool):
        raise ValueError(f"it has schema {shown(data['schema'])}, of another version: compute the result again")
    first = [entry.name for entry in fields(_Head)]
    head: _Head = from_plain(_Head, {key: data[key] for key in first if key in data})
    kind = resolve_name(f"plough_opt.{_CLASSES[head.kind]}") if head.kind in _CLASSES else object
    if not issubclass(kind, wanted):
        raise ValueError(f"it holds {shown(head.kind)}")
    result = from_plain(kind, data)
    result.check_saved()
    extra = {key: own for key, own in data.items() if key not in {*first, *vars(result)}}
    for name, own in (("_shown", head.shown), ("_made_by", head.versions), ("_extra", extra)):
        object.__setattr__(result, name, own)
    return result
