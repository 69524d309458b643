"""The table of a benchmark run, which compares tools with plough_opt, and the clocks that fill it."""

import json
import math
import os
import platform
import re
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas

HERE = Path(__file__).resolve().parent
# Least time of a measurement [s], far above the cost and the resolution of the clock.
_LEAST = 0.02
# Calls that take longer than this [s] are repeated less often.
_PATIENCE = 1.0


@dataclass(frozen=True)
class Spent:
    """Processor time and wall time [s]; other processes on the machine lengthen the latter."""

    cpu: float
    wall: float

    def per(self, count):
        """Return the time of one of ``count`` calls."""
        return Spent(self.cpu / count, self.wall / count)


@dataclass(frozen=True)
class Row:
    """One tool at one task; ``first`` is the time of the first call in a fresh process, without imports."""

    task: str
    tool: str
    spent: Spent
    error: float | None = None
    first: Spent | None = None
    note: str = ""


@dataclass(frozen=True)
class Growth:
    """Cost at several sizes of a task."""

    what: str
    sizes: tuple[float, ...]
    costs: tuple[float, ...]
    unit: str = "s"

    @property
    def exponent(self):
        """Power of the size with which the cost grows."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.costs), 1)[0])


@dataclass
class Contest:
    """Everything that a run has measured."""

    rows: list[Row] = field(default_factory=list)
    growths: list[Growth] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)

    def hold(self, task, tools, rounds=5):
        """Time tools in turns and add their rows; the first tool is our own, with which the others are compared.

        Args:
            task: its name in the table.
            tools: name -> function, its error, a note and, if the first call in a fresh process is timed too, that
                call's imports and statement.
            rounds: see `race`.
        """
        spent = race({name: function for name, (function, *_) in tools.items()}, rounds)
        for name, (_, error, note, *call) in tools.items():
            self.rows.append(Row(task, name, spent[name], error, fresh(*call) if call else None, note))

    def ratio(self, row, which="spent"):
        """Return the processor time of a row divided by our own, or None."""
        own = next(getattr(r, which) for r in self.rows if r.task == row.task)
        mine = getattr(row, which)
        return None if own is None or mine is None else mine.cpu / own.cpu

    def content(self):
        """Return everything as JSON has it."""
        rows = [
            asdict(r) | {"cpu_over_ours": self.ratio(r), "first_over_ours": self.ratio(r, "first")} for r in self.rows
        ]
        growths = [asdict(g) | {"exponent": g.exponent} for g in self.growths]
        return {"when": _now(), "machine": machine(), "rows": rows, "growth": growths, "missing": self.missing}

    def write(self, path):
        """Write everything as JSON."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.content(), indent=1) + "\n")

    def show(self):
        """Print two tables: times [s], also in units of our own, and costs with the power with which they grow."""
        content = self.content()
        print("", f"{content['when']}, {content['machine']}", sep="\n")
        tables = (
            pandas.json_normalize(content["rows"]).drop(columns="first", errors="ignore"),
            pandas.DataFrame(content["growth"]),
        )
        for table in tables:
            if len(table):
                table = table.explode(["sizes", "costs"]) if "sizes" in table else table
                print(table.to_string(index=False, na_rep="", float_format="{:.3g}".format))
        print(*(f"left out: {name}: {why}" for name, why in self.missing.items()), sep="\n")


def _now():
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


def machine():
    """Return a description of this machine."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.+)$", info.read_text() if info.exists() else "", flags=re.MULTILINE)
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    name = names[0] if names else platform.processor()
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}{load}"


def race(contestants, rounds=7):
    """Return the median times of functions, called in turns after a warm-up, so that noise affects all of them alike.

    Functions that take seconds are called at most three times.
    """
    often, turns = {}, {}
    for name, function in contestants.items():
        function()
        began = time.perf_counter()
        function()
        taken = time.perf_counter() - began
        often[name] = max(1, math.ceil(_LEAST / taken))
        turns[name] = rounds if taken < _PATIENCE else 3
    found = {name: [] for name in contestants}
    for turn in range(rounds):
        for name, function in contestants.items():
            if turn < turns[name]:
                found[name].append(_clocked(function, often[name]))
    return {name: median(spent) for name, spent in found.items()}


def solved_anew(design, **options):
    """Solve a design again without what it remembers of its last certified optimum."""
    if design._program is not None:
        design._program.exact._tight.cache_clear()
    return design.solve(**options)


def _clocked(function, often):
    """Return the time of one of several calls."""
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(often):
        function()
    return Spent(time.process_time() - cpu, time.perf_counter() - wall).per(often)


def median(spent):
    """Return the medians of several times."""
    return Spent(statistics.median(s.cpu for s in spent), statistics.median(s.wall for s in spent))


_FRESH = """
import sys, time
sys.path.insert(0, {here!r})
{setup}
cpu, wall = time.process_time(), time.perf_counter()
{statement}
print("spent", time.process_time() - cpu, time.perf_counter() - wall)
"""


def fresh(setup, statement, rounds=3):
    """Return the median time of the first execution of a statement in a new process, after imports."""
    code = _FRESH.format(here=str(HERE), setup=setup, statement=statement)
    found = []
    for _ in range(rounds):
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, capture_output=True, text=True)
        found.append(Spent(*map(float, done.stdout.splitlines()[-1].split()[1:])))
    return median(found)
