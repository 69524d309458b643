"""Functions that the tests sweep, in a module that worker processes can import."""

import math
import os
import signal
import sqlite3
import time
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import plough_opt as po
from helpers.problem_files import REFERENCE

COMMAND = ("sweep", REFERENCE, "--over", "soil.cohesion=10 kPa, 20 kPa", "--set", "effects.motion=false")


def waves(values):
    """Return numbers that have no short decimal form."""
    return {"sine": math.sin(values["a"]) * values["b"], "root": math.sqrt(values["b"]) / 3.0}


def sweep_waves():
    """Return the roots of `waves` from a sweep with a worker process."""
    return po.sweep(waves, {"a": [1.0, 2.0], "b": [2.0, 8.0]}, workers=1).column("root").tolist()


def failing(values):
    """Fail in three ways, and return negative zero."""
    if values["a"] == 1.0:
        raise ValueError("one is not allowed")
    return {"inverse": 1.0 / values["a"], "half": math.inf if values["a"] == 3.0 else -0.0}


def failing_at_one(values):
    """Return `waves`, except at a = 1."""
    if values["a"] == 1.0:
        raise ValueError("one is not allowed")
    return waves(values)


def two_names(values):
    return {"x": 1.0} if values["a"] < 2.0 else {"y": 1.0}


def end():
    """Kill this process, as the system does when it needs memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def kills_always(_values):
    end()


def fork_and_die(file):
    """Die and leave behind a child that has all open files of this process."""
    child = os.fork()
    if child == 0:
        time.sleep(60.0)
        os._exit(0)
    Path(file).write_text(str(child))
    end()


def refuse():
    raise RuntimeError("not here")


class Unreadable:
    """Callable that cannot be unpickled."""

    __call__ = two_names

    def __reduce__(self):
        return refuse, ()


@dataclass(frozen=True)
class Deadly:
    """Kill the process at a = 5, unless there is a file "cured", and at a = 2 the first time."""

    file: Path

    def __call__(self, values):
        if values["a"] in (2.0, 5.0):
            deaths = self.file.read_text() if self.file.exists() else ""
            cured = self.file.with_name("cured").exists()
            if (values["a"] == 5.0 and not cured) or (values["a"] == 2.0 and "2.0" not in deaths):
                self.file.write_text(f"{deaths}{values['a']} ")
                end()
        return waves({"a": values["a"], "b": 2.0})


@dataclass(frozen=True)
class Counted:
    """`waves`, with a pause and a line in a file for every call."""

    file: Path
    pause: float = 0.0

    def __call__(self, values):
        # Short lines that are appended by one write each do not mix, even between processes.
        line = f"{values['a']!r} {values['b']!r}\n".encode()
        with self.file.open("ab", buffering=0) as file:
            file.write(line)
        time.sleep(self.pause)
        return waves(values)


def script_of(store, file, pause, values, executor="None"):
    """Return a script that sweeps `Counted` into a store; it imports only what that needs."""
    return f"""
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from helpers.swept import Counted
from plough_opt.studies.sweep.question import Range
from plough_opt.studies.sweep.engine import sweep
if __name__ == "__main__":
    counted, over = Counted(Path({str(file)!r}), {pause}), {{"a": Range(0.0, 1.0, {values}), "b": [1.0, 2.0]}}
    sweep(counted, over, store={str(store)!r}, workers=2, executor={executor})
"""


def process_of(number):
    """Return state, parent and command of a process, from /proc; the state is "X" if it has ended."""
    try:
        fields = Path("/proc", str(number), "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return fields[0], int(fields[1]), Path("/proc", str(number), "cmdline").read_text(encoding="utf-8")
    except OSError:
        return "X", 0, ""


def workers_of(parent):
    """Return the workers of a sweep that a process has started."""
    every = ((int(entry.name), *process_of(entry.name)) for entry in Path("/proc").iterdir() if entry.name.isdigit())
    return [number for number, _, by, command in every if by == parent and "plough_opt.studies.sweep.pool" in command]


def stored(path, columns="point"):
    """Return columns of the points in a store, even while others write to it."""
    if path.exists():
        # Until the table exists it cannot be read.
        with closing(sqlite3.connect(path, timeout=60.0)) as connection, suppress(sqlite3.OperationalError):
            return connection.execute(f"SELECT {columns} FROM points ORDER BY point").fetchall()
    return []


def until(enough, process=None):
    """Wait until a condition holds; fail if a process ends first."""
    end = time.monotonic() + 60.0
    while not enough():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)


def hangs_at_two(values):
    """Return `waves`, except at a = 2, where it does not return."""
    if values["a"] == 2.0:
        time.sleep(3600.0)
    return waves({"a": values["a"], "b": 1.0})
