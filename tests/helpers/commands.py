"""The command line, run in this process."""

import contextlib
import io
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from plough_opt.app.main import main


@dataclass(frozen=True)
class Outcome:
    """Outcome of a command: exit status and the two streams."""

    status: int
    out: str
    err: str

    @property
    def said(self):
        """The error stream as one line, however it was wrapped."""
        return " ".join(self.err.split())


def call(*arguments):
    """Run a command, neither stream a terminal."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return Outcome(status, out.getvalue(), err.getvalue())


def printed(*arguments):
    """Return what a command that succeeds prints."""
    done = call(*arguments)
    assert done.status == 0, done.err
    return done.out


def line_of_a_page(line, *more):
    """Run a line such as "plough-opt check FILE > TEXT" with more arguments; return what it prints."""
    command, _, target = line.partition(" > ")
    program, *arguments = shlex.split(command)
    assert program == "plough-opt"
    out = printed(*arguments, *more)
    if target:
        Path(target).write_text(out, encoding="utf-8")
    return out


def cells(out, row):
    """Return the cells of the one table row that begins with a name."""
    (found,) = re.findall(rf"^│ {re.escape(row)} +│(.*)│$", out, flags=re.MULTILINE)
    return [cell.strip() for cell in found.split("│")]
