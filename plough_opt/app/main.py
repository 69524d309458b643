"""The command `plough-opt`: arguments, exit status, and nothing of the physics.

Exit status: 0 solved; 1 the problem has no solution, or none was found; 2 the input is wrong; 130 interrupted: a sweep
continues when it is started again.
"""

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version

import shtab
from rich.console import Console
from rich.markup import escape

from plough_opt.app import calibrate as calibrations
from plough_opt.app import commands, kept
from plough_opt.app import export as exports
from plough_opt.app import sweep as sweeps
from plough_opt.app import waves as strengths
from plough_opt.app.options import add_shared
from plough_opt.app.page import command as pages
from plough_opt.app.terminal import add_how_much, interruptible, messages, printable, what_was_written
from plough_opt.core.errors import DomainError, InputError, PloughError
from plough_opt.core.process import load_additions, without_notices

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
            # A title in a script that the terminal cannot show must not make a command fail; in JSON this is an escape.
            stream.reconfigure(errors="backslashreplace")
    try:
        with interruptible(), without_notices(), messages(options):
            options.run(options)
        if sys.stdout is not None:  # which whoever starts the process may have closed
            sys.stdout.flush()
    except (InputError, DomainError) as error:
        _complain("bad input", error)
        return BAD_INPUT
    except PloughError as error:
        _complain("no solution", error)
        return UNSOLVED
    except KeyboardInterrupt as stop:
        # A sweep says what is stored.
        _complain("stopped", stop.args[0] if stop.args else what_was_written())
        return INTERRUPTED
    except BrokenPipeError:  # whoever read the output has seen enough; nothing is left to flush at exit
        _drop_output()
    except OSError as error:
        _complain("output", error)
        _drop_output()
        return BAD_INPUT
    return SOLVED


def _drop_output() -> None:
    """Leave nothing to be flushed at exit into a stream that takes no more; one that is not a file has nothing."""
    with contextlib.suppress(AttributeError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(kind: str, error: object) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[bold red]{kind}:[/] {escape(printable(str(error)))}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="plough-opt", description="Design of subsoiler ploughshares: draft, oscillation, constraints."
    )
    parser.add_argument("--version", action="version", version=f"plough-opt {version('plough_opt')}")
    common = argparse.ArgumentParser(add_help=False)
    add_how_much(common)
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    only_json = partial(add_shared, json="print JSON instead of a table")
    none, shells = lambda _verb: None, partial(_add_shell, parser=parser)
    # Name, what runs it, what adds its options, and its line of help.
    for name, run, add, text in (
        ("init", commands.init, commands.add_init, "write a commented problem file to start from"),
        ("soils", commands.soils, only_json, "list the named soils and where their values come from"),
        ("waves", strengths.waves, strengths.add_options, "find the strength waves that a record along a field holds"),
        ("show", kept.show, kept.add_show, "print a saved result again, and what made it"),
        ("compare", kept.compare, kept.add_compare, "set saved designs or runs side by side"),
        ("schema", commands.schema, none, "print the JSON schema of problem files, by which editors complete and check"
         " them"),
        ("completion", commands.completion, shells, "print a script that lets a shell complete this command"),
    ):  # fmt: skip
        verb = verbs.add_parser(name, help=text, parents=[common])
        add(verb)
        verb.set_defaults(run=run)
    # The same of commands that read a problem file.
    for name, run, add, text in (
        ("check", commands.check, commands.add_check, "check a problem file and say what its scene contains"),
        ("simulate", commands.simulate, commands.add_simulate, "simulate the scene with every variable at its guess"),
        ("optimise", commands.optimise, commands.add_optimise, "find the best share, and say what decided it"),
        ("tradeoff", commands.tradeoff, commands.add_tradeoff, "trade two or three results against each other: the"
         " front"),
        ("sweep", sweeps.sweep, sweeps.add_options, "simulate or optimise at every point of a grid or a sample"),
        ("calibrate", calibrations.calibrate, calibrations.add_options, "find soil parameters from measured draft"),
        ("export", exports.export, exports.add_options, "write the scene for other tools: C, CasADi, OpenMDAO, FMU"),
        ("report", pages.report, pages.add_options, "write everything about the best share as one page for a browser"),
        ("accuracy", commands.accuracy, commands.add_accuracy, "show what accuracy costs in time: which method to"
         " take"),
    ):  # fmt: skip
        verb = verbs.add_parser(name, help=text, parents=[common], aliases=["optimize"] if name == "optimise" else [])
        file = verb.add_argument("file", metavar="FILE", help="problem file (TOML)")
        file.complete = shtab.FILE  # type: ignore[attr-defined]  # by which shtab completes names of files
        verb.add_argument(
            "--set",
            action="append",
            default=[],
            metavar='KEY="VALUE"',
            help='change a key of the file, like scene.tow_speed="2.5 m/s"; a variable is fixed by it; repeatable',
        )
        add(verb)
        verb.set_defaults(run=run)
    return parser


def _add_shell(verb: argparse.ArgumentParser, parser: argparse.ArgumentParser) -> None:
    """Add the shell of a script, and the command line that it completes."""
    verb.add_argument("shell", choices=shtab.SUPPORTED_SHELLS, help="the shell")
    verb.set_defaults(parser=parser)
