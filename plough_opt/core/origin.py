"""Origin: the question behind a result, which identifies it and allows it to be computed again."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version

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
    declarations: Mapping[str, Mapping[str, str | float | None]] = field(default_factory=dict)
    seed: int | None = None
    machine: str = ""
    made: str = ""

    @classmethod
    def now(
        cls,
        title: str = "",
        displays: Mapping[str, Display] | None = None,
        source: tuple[str, str, tuple[str, ...]] = ("", "", ()),
        declarations: Mapping[str, Mapping[str, str | float | None]] | None = None,
        seed: int | None = None,
    ) -> Origin:
        """Return the origin of a result that is made now, on this machine.

        Args:
            title: of the question.
            displays: key or result -> unit in which the question writes it.
            source: of a problem file its name, its text and its overrides.
            declarations: of a design in Python.
            seed: of the samples that were drawn.
        """
        file, text, overrides = source
        digest = hashlib.sha256(text.encode()).hexdigest() if text else ""
        machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
        made = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(
            title, displays or {}, file, text, digest, overrides, declarations or {}, seed, machine, made
        )  # fmt: skip

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
