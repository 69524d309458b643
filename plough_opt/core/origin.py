"""Origin: the question behind a result, which identifies it and allows it to be computed again."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from plough_opt.core.errors import InputError
from plough_opt.core.files import write_new
from plough_opt.core.kinds import path_of
from plough_opt.core.units import Display, customary


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
        for name, text in self.data.items():
            (around / name).parent.mkdir(parents=True, exist_ok=True)
            write_new(around / name, "file of data", text)
        around.mkdir(parents=True, exist_ok=True)
        return write_new(around / self.file, "problem file", self.text)

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
