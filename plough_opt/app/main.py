"""The command `plough-opt`: what it runs, and its exit status.

Exit status: 0 success; 1 the problem has no solution, or none was found; 2 invalid input; 130 interrupted (a sweep
continues when it is started again).
"""

import argparse
import contextlib
import io
import json
import os
import sys
from collections.abc import Sequence

from plough_opt.app.options import parser
from plough_opt.core.errors import DomainError, InfeasibleDesign, InputError, PloughError
from plough_opt.core.process import load_additions, without_notices

SOLVED, UNSOLVED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        load_additions()
    except InputError as error:
        _complain("bad input", error)
        return BAD_INPUT
    options = parser().parse_args(arguments)
    from plough_opt.app.terminal import interruptible, messages, what_was_written

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Escape characters of a title that the terminal cannot encode, instead of failing.
            stream.reconfigure(errors="backslashreplace")
    try:
        with interruptible(), without_notices(), messages(options):
            options.run(options)
        if sys.stdout is not None:  # None if the parent process closed it
            sys.stdout.flush()
    except (InputError, DomainError) as error:
        _complain("bad input", error)
        return BAD_INPUT
    except PloughError as error:
        _complain("no solution", error)
        if isinstance(error, InfeasibleDesign):
            _give_conflicts(options, error)
        return UNSOLVED
    except KeyboardInterrupt as stop:
        # A sweep puts what it has stored into the exception.
        _complain("stopped", stop.args[0] if stop.args else what_was_written())
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output stopped early, as head does: not an error
        _drop_output()
    except OSError as error:
        _complain("output", error)
        _drop_output()
        return BAD_INPUT
    return SOLVED


def _give_conflicts(options: argparse.Namespace, error: InfeasibleDesign) -> None:
    """Print the conflicts of an infeasible design as JSON under --json, and write them with --output."""
    from plough_opt.app.terminal import messages, wrote
    from plough_opt.core.files import write_file
    from plough_opt.core.plain_data import to_plain

    plain = {"kind": "infeasible design", "message": str(error), **to_plain(vars(error))}
    text = json.dumps(plain, indent=2, allow_nan=False)
    if options.json:
        print(text)
    if hasattr(options, "by_pandas") and options.output is not None:  # other commands write no JSON there
        with messages(options):
            wrote(write_file(options.output, "output", f"{text}\n"))


def _drop_output() -> None:
    """Redirect standard output, which accepts no more text, so that the flush at exit does not fail."""
    with contextlib.suppress(AttributeError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(kind: str, error: object) -> None:
    """Print an error on the error stream."""
    from plough_opt.core.screen import Screen

    Screen(stderr=True).print_labelled(f"{kind}:", "bold red", str(error), soft_wrap=True)
