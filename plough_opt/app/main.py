"""The command `plough-opt`: its arguments and exit status.

Exit status: 0 success; 1 the problem has no solution, or none was found; 2 invalid input; 130 interrupted (a sweep
continues when it is started again).
"""

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from typing import NoReturn

import shtab

from plough_opt.app import calibrate as calibrations
from plough_opt.app import commands, saved
from plough_opt.app import export as exports
from plough_opt.app import sweep as sweeps
from plough_opt.app import waves as strengths
from plough_opt.app.options import add_option, add_shared
from plough_opt.app.page import command as pages
from plough_opt.app.terminal import add_how_much, interruptible, messages, what_was_written
from plough_opt.core.errors import DomainError, InputError, PloughError, printable
from plough_opt.core.process import load_additions, without_notices
from plough_opt.core.screen import Screen

SOLVED, UNSOLVED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    try:
        load_additions()
    except InputError as error:
        _complain("bad input", error)
        return BAD_INPUT
    options = _parser().parse_args(arguments)
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


def _drop_output() -> None:
    """Redirect standard output, which accepts no more text, so that the flush at exit does not fail."""
    with contextlib.suppress(AttributeError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(kind: str, error: object) -> None:
    """Print an error on the error stream."""
    Screen(stderr=True).print_labelled(f"{kind}:", "bold red", str(error), soft_wrap=True)


class _Parser(argparse.ArgumentParser):
    """A parser whose messages, which quote the arguments, are fit for a terminal."""

    def error(self, message: str) -> NoReturn:
        """Print a message on the error stream and exit."""
        super().error(printable(message))


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = _Parser(
        prog="plough-opt", description="Design of subsoiler ploughshares: draft, oscillation, constraints."
    )
    parser.add_argument("--version", action="version", version=f"plough-opt {version('plough_opt')}")
    common = _Parser(add_help=False)
    add_how_much(common)
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    only_json = partial(add_shared, json="print JSON instead of a table")
    none, shells = lambda _verb: None, partial(_add_shell, parser=parser)
    # Name, function that runs the command, function that adds its options, and its line of help.
    for name, run, add, text in (
        ("init", commands.init, commands.add_init, "write a commented problem file to start from"),
        ("soils", commands.soils, only_json, "list the named soils and where their values come from"),
        ("waves", strengths.waves, strengths.add_options, "find the strength waves in a record along a field"),
        ("show", saved.show, saved.add_show, "print a saved result again, and its origin"),
        ("compare", saved.compare, saved.add_compare, "print saved designs or runs side by side"),
        ("schema", commands.schema, none,
         "print the JSON schema of problem files, for completion and checks in an editor"),
        ("completion", commands.completion, shells, "print a script for completion of this command in a shell"),
    ):  # fmt: skip
        verb = verbs.add_parser(name, help=text, parents=[common])
        add(verb)
        verb.set_defaults(run=run)
    # The same for commands that read a problem file.
    for name, run, add, text in (
        ("check", commands.check, commands.add_check, "check a problem file, and show what its scene contains"),
        ("simulate", commands.simulate, commands.add_simulate, "simulate the scene with every variable at its guess"),
        ("optimise", commands.optimise, commands.add_optimise, "find the best share, and the limits that decide it"),
        ("tradeoff", commands.tradeoff, commands.add_tradeoff, "compute the Pareto front of two or three results"),
        ("sweep", sweeps.sweep, sweeps.add_options, "simulate or optimise at every point of a grid or a sample"),
        ("calibrate", calibrations.calibrate, calibrations.add_options, "estimate soil parameters from measured draft"),
        ("export", exports.export, exports.add_options, "write the scene for other tools: C, CasADi, OpenMDAO, FMU"),
        ("report", pages.report, pages.add_options, "write everything about the best share as one HTML page"),
        ("accuracy", commands.accuracy, commands.add_accuracy, "compare error and time of integration methods"),
    ):  # fmt: skip
        verb = verbs.add_parser(name, help=text, parents=[common], aliases=["optimize"] if name == "optimise" else [])
        file = verb.add_argument("file", metavar="FILE", help="problem file (TOML)")
        file.complete = shtab.FILE  # type: ignore[attr-defined]  # makes shtab complete file names
        change = 'change a key of the file, such as scene.tow_speed="2.5 m/s"; a variable becomes fixed; repeatable'
        add_option(verb, "set", 'KEY="VALUE"', change, action="append", default=[])
        add(verb)
        verb.set_defaults(run=run)
    return parser


def _add_shell(verb: argparse.ArgumentParser, parser: argparse.ArgumentParser) -> None:
    """Add the argument of `completion`, and the parser from which it writes the script."""
    verb.add_argument("shell", choices=shtab.SUPPORTED_SHELLS, help="your shell")
    verb.set_defaults(parser=parser)
