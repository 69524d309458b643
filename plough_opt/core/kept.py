"""Results as JSON: what they were made from, what they showed of themselves, and the fields that make them again."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Final, Self, TypeVar

from plough_opt.core.checks import path_of, shown
from plough_opt.core.errors import InputError, short
from plough_opt.core.files import write_file, write_new
from plough_opt.core.plain import Misfit, fields_of, from_plain, to_plain
from plough_opt.core.tables import Page, Readable
from plough_opt.core.units import Display, customary

SCHEMA: Final = 2
"""Number of the layout of kept results; it rises when a key changes its meaning."""

# Characters of a kept result, some hundred times the longest that the commands write.
_MOST_BYTES: Final = 100_000_000
_HEAD: Final = ("schema", "kind", "title", "versions", "shown")
_Result = TypeVar("_Result", bound="Keepable")


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("plough_opt", "casadi", "numpy")}
    return {**packages, "python": platform.python_version(), "machine": platform.machine()}


@dataclass(frozen=True)
class Origin:
    """The question behind a result; it is empty for a result from Python without a title.

    Attributes:
        title: of the question.
        displays: key or result -> unit in which the question writes it.
        file: name of the problem file, without its folder.
        text: the whole file.
        sha256: of its bytes.
        overrides: what ``--set`` changed in it, in order.
        data: name of a file that it reads, as it is written there -> the whole file.
        limits: result -> ends between which the question requires it, SI, or None.
        declarations: of a design in Python: its variables, parameters, requirements and objective, name by name.
        seed: of the samples that were drawn.
        machine: its kind, without its name.
        made: when, in UTC.
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

    @classmethod
    def now(
        cls,
        title: str = "",
        displays: Mapping[str, Display] | None = None,
        *,
        file: str = "",
        text: str = "",
        seed: int | None = None,
        **more: Any,
    ) -> Origin:
        """Return the origin of a result that is made now, on this machine.

        Args:
            title: of the question.
            displays: key or result -> unit in which the question writes it.
            file: name of the problem file, without its folder.
            text: the whole file.
            seed: of the samples that were drawn.
            more: other attributes.
        """
        digest = hashlib.sha256(text.encode()).hexdigest() if text else ""
        machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
        made = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(title, displays or {}, file, text, digest, seed=seed, machine=machine, made=made, **more)

    def lines(self, made_by: Mapping[str, str]) -> tuple[str, ...]:
        """Return in words what made a result.

        Args:
            made_by: versions of packages.
        """
        changed = f", changed by --set {' --set '.join(self.overrides)}" if self.overrides else ""
        seed = "" if self.seed is None else f", seed {self.seed}"
        packages = ", ".join(f"{name} {number}" for name, number in made_by.items())
        file = f"Made from {self.file} (SHA-256 {self.sha256[:12]}){changed}{seed}." if self.file else ""
        when = f"Made at {self.made} on {self.machine} by {packages}." if self.made else ""
        return tuple(line for line in (file, when) if line)

    def problem(self) -> str:
        """Return the whole problem file, what ``--set`` changed in it, and the files of data that it reads; or "".

        Of a design in Python these are its declarations, a line for each.
        """
        changes = [f"# --set {change}" for change in self.overrides]
        data = [f"# --- {name} ---\n{text.rstrip()}" for name, text in self.data.items()]
        declared = [f"{name}: " + ", ".join(f"{key} {value}" for key, value in own.items() if value is not None)
                    for name, own in self.declarations.items()]  # fmt: skip
        return "\n".join([*([self.text.rstrip()] if self.text else []), *changes, *data, *declared])

    def restore(self, folder: str | Path) -> Path:
        """Write the problem file and the files of data that it reads into a folder; return the problem file's path.

        ``po.read_problem(path, origin.overrides)`` reads it again.

        Raises:
            InputError: a result that is not of a problem file, a file that is there already, or data elsewhere than in
                the problem file's folder.
        """
        if not self.text:
            raise InputError("this result is not of a problem file: its declarations say what it was made from")
        around = path_of("the folder", folder)
        for name in self.data:
            if Path(name).is_absolute() or ".." in Path(name).parts:
                raise InputError(f"the problem reads '{name}', which is not below its folder: move it there")
        for name, text in {**self.data, self.file: self.text}.items():
            (around / name).parent.mkdir(parents=True, exist_ok=True)
            write_new(around / name, "problem file" if name == self.file else "file of data", text)
        return around / self.file

    def display(self, name: str, unit: str, *values: float) -> Display:
        """Return the unit in which a quantity or a result is shown: the question's, else the customary one.

        Args:
            name: key of the quantity, or the result.
            unit: its SI unit.
            values: all that stand beside each other, SI.
        """
        return self.displays.get(name) or customary(unit, *values)

    def common(self, unit: str, values: Mapping[str, float]) -> Display:
        """Return the one unit of results of a kind, that stand beside each other: the first that the question writes.

        Args:
            unit: SI unit.
            values: result -> value, SI.
        """
        written = (self.displays[name] for name in values if name in self.displays)
        return next(written, None) or customary(unit, *values.values())


class Keepable(Readable):
    """A result that can be kept as JSON and be read back; a dataclass.

    Attributes:
        kind: by which a file says what it holds.
        unkept: names of fields that only compute further, and are None in a result that was read.
    """

    kind: ClassVar[str]
    unkept: ClassVar[frozenset[str]] = frozenset()

    def also_kept(self) -> dict[str, Any]:
        """Return what a file says beside the fields, for others who read it."""
        return {}

    def check_kept(self) -> None:
        """Refuse fields that do not go with each other, of a result that was read.

        Raises:
            ValueError: such fields.
        """

    @property
    def made_by(self) -> dict[str, str]:
        """Versions of the packages that made the result, and the machine."""
        return dict(getattr(self, "_made_by", None) or getattr(self, "versions", None) or versions())

    def to_json(self, page: Page | None = None) -> str:
        """Return the result as strictly valid JSON of ASCII characters, SI units, infinite numbers as "Infinity".

        Args:
            page: what it shows of itself, where that is more than `page` says.

        Raises:
            InputError: something in it that is not data.
        """
        origin: Origin = getattr(self, "origin", Origin())
        own = (SCHEMA, self.kind, origin.title, self.made_by, to_plain(page or self.shown_page(), Page))
        beside = getattr(self, "_beside", None)  # of a result that was read
        beside = to_plain(self.also_kept()) if beside is None else beside
        plain = dict(zip(_HEAD, own, strict=True)) | beside | to_plain(self, type(self))
        return json.dumps(plain, indent=2, allow_nan=False)

    def save(self, path: str | Path) -> Path:
        """Write the result as JSON, making its folder; `plough_opt.load` reads it back.

        Raises:
            InputError: something in it that is not data, or a place that cannot be written.
        """
        return write_file(path, "result", f"{self.to_json()}\n")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result that `save`, or a command with ``--json``, wrote.

        Raises:
            InputError: no such file, or not a result of this kind and layout.
        """
        return read_result(path, {cls.kind: cls})


def read_result(path: str | Path, kinds: dict[str, type[_Result]]) -> _Result:
    """Return the result that a JSON file holds.

    Args:
        path: the file.
        kinds: what it may hold: kind -> class.

    Raises:
        InputError: no such file, or another kind or layout.
    """
    path = path_of("the result", path)
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"the result {shown(str(path), 200)} cannot be read: {short(str(error), 200)}") from None
    if len(content) > _MOST_BYTES:
        raise InputError(f"the result '{path}' is too long: at most {_MOST_BYTES // 1_000_000} MB can be read")
    try:
        return _result_of(_parsed(text), kinds)
    except (ValueError, RecursionError, TypeError) as error:
        place = error.place if isinstance(error, Misfit) else ""
        kind = next(iter(kinds)) if len(kinds) == 1 else "result"
        wanted = f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
        raise InputError(
            f"'{path}' is not {wanted} of this version (schema {SCHEMA}): at {short(place or 'its beginning')}:"
            f" {short(str(error), 200)}; name another file, or write it anew"
        ) from None


def _result_of(data: Any, kinds: dict[str, type[_Result]]) -> _Result:
    """Return the result that a document holds.

    Raises:
        ValueError: not a document of these kinds.
    """
    if not isinstance(data, dict):
        raise Misfit("", "Input should be an object")
    for key, known in (("schema", [SCHEMA]), ("kind", [*kinds])):
        if data.get(key) not in known or isinstance(data[key], bool):
            raise Misfit(key, f"{key} = {data.get(key)!r:.60}: Input should be {' or '.join(map(repr, known))}")
    found: _Result = from_plain(kinds[data["kind"]], data)
    found.check_kept()
    from_plain(str, data.get("title"), "title")
    for name, hint, key in (("_shown", Page, "shown"), ("_made_by", dict[str, str], "versions")):
        object.__setattr__(found, name, from_plain(hint, data.get(key), key))
    beside = {key: own for key, own in data.items() if key not in _HEAD and key not in fields_of(type(found))}
    object.__setattr__(found, "_beside", beside)
    return found


def _parsed(text: str) -> Any:
    """Return strictly valid JSON.

    Raises:
        ValueError: not JSON, NaN, or a number beyond all floats.
    """

    def refuse(constant: str) -> Any:
        raise ValueError(f"Invalid JSON: {constant}")

    try:
        data = json.loads(text, parse_constant=refuse)
    except ValueError as error:
        raise ValueError(f"Invalid JSON: {error}") from None
    rest = [data]
    while rest:
        value = rest.pop()
        if isinstance(value, dict | list):
            rest += value.values() if isinstance(value, dict) else value
        elif isinstance(value, int | float) and not abs(value) <= sys.float_info.max:
            raise ValueError("a number is beyond all floats")
    return data
