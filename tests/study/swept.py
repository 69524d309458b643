"""Functions that the tests sweep: a module, so that worker processes can import them."""

import math
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path


def waves(values):
    """Return numbers without a short decimal form."""
    return {"sine": math.sin(values["a"]) * values["b"], "root": math.sqrt(values["b"]) / 3.0}


def failing(values):
    """Fail in three ways, and return zero with a sign."""
    if values["a"] == 1.0:
        raise ValueError("one is not allowed")
    return {"inverse": 1.0 / values["a"], "half": math.inf if values["a"] == 3.0 else -0.0}


def all_fail(values):
    raise KeyError(values["a"])


def two_names(values):
    return {"x": 1.0} if values["a"] < 2.0 else {"y": 1.0}


@dataclass(frozen=True)
class Deadly:
    """Kill the process at one point always, and at another the first time."""

    file: Path

    def __call__(self, values):
        if values["a"] == 5.0:
            os.kill(os.getpid(), signal.SIGKILL)
        if values["a"] == 2.0 and not self.file.exists():
            self.file.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return waves({"a": values["a"], "b": 2.0})


@dataclass(frozen=True)
class Counted:
    """`waves`, with a line in a file for every call and a pause."""

    file: Path
    pause: float = 0.0

    def __call__(self, values):
        # Short lines appended by one write each do not mix, whichever processes write them.
        line = f"{values['a']!r} {values['b']!r}\n".encode()
        descriptor = os.open(self.file, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(descriptor, line)
        os.close(descriptor)
        time.sleep(self.pause)
        return waves(values)
