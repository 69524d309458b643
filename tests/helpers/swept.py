"""Functions that the tests sweep, in a module that worker processes can import."""

import math
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from helpers.problem_files import REFERENCE

COMMAND = ("sweep", REFERENCE, "--over", "soil.cohesion=10 kPa, 20 kPa", "--set", "effects.motion=false")


def waves(values):
    """Return numbers that have no short decimal form."""
    return {"sine": math.sin(values["a"]) * values["b"], "root": math.sqrt(values["b"]) / 3.0}


def failing(values):
    """Fail in three ways, and return negative zero."""
    if values["a"] == 1.0:
        raise ValueError("one is,\nnot allowed")
    return {"inverse": 1.0 / values["a"], "half": math.inf if values["a"] == 3.0 else -0.0}


def kills_always(_values):
    """Kill this process, as the system does when it needs memory."""
    os.kill(os.getpid(), signal.SIGKILL)


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


def script_of(table, file, pause, values, executor="None"):
    """Return a script that sweeps `Counted` into a table."""
    return f"""
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from helpers.swept import Counted
import plough_opt as po
if __name__ == "__main__":
    counted, over = Counted(Path({str(file)!r}), {pause}), {{"a": po.Range(0.0, 1.0, {values}), "b": [1.0, 2.0]}}
    po.sweep(counted, over, file={str(table)!r}, workers=2, executor={executor})
"""


def process_of(number):
    """Return state, parent and command of a process, from /proc; the state is "X" if it has ended."""
    try:
        fields = Path("/proc", str(number), "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return fields[0], int(fields[1]), Path("/proc", str(number), "cmdline").read_text(encoding="utf-8")
    except OSError:
        return "X", 0, ""


def rows_of(path):
    """Return the whole lines of a table below its headings, even while others write to it."""
    return path.read_text(encoding="utf-8").rpartition("\n")[0].splitlines()[1:] if path.exists() else []


def until(enough, process=None):
    """Wait until a condition holds; fail if a process ends first."""
    end = time.monotonic() + 60.0
    while not enough():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
