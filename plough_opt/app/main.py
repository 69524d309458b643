"""The command `plough-opt`: arguments, exit status, and nothing of the physics.

Exit status: 0 solved; 1 the problem has no solution, or none was found; 2 the input is wrong; 130 interrupted: a sweep
goes on when it is asked again.
"""

import argparse
import contextlib
import io
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version

import shtab
from rich.console import Console
from rich.markup import escape

from plough_opt.app import calibrate as calibrations
from plough_opt.app import commands, kept, schemas
from plough_opt.app import export as exports
from plough_opt.app import sweep as sweeps
from plough_opt.app import waves as strengths
from plough_opt.app.messages import add_options, messages, printable
from plough_opt.app.page import command as pages
from plough_opt.app.terminal import interruptible, what_was_written
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
            # A title in a script that the terminal cannot show is no reason to fail; in JSON this is an escape.
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
    add_options(common)
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    init = verbs.add_parser("init", help="write a commented problem file to start from", parents=[common])
    init.add_argument("file", metavar="FILE", help="file to write; it must not exist")
    init.add_argument("--json", action="store_true", help="print what was written as JSON")
    init.set_defaults(run=commands.init)

    soils = verbs.add_parser("soils", help="list the named soils and where their values come from", parents=[common])
    soils.add_argument("--json", action="store_true", help="print JSON instead of a table")
    soils.set_defaults(run=commands.soils)

    verb = verbs.add_parser("waves", help="find the strength waves that a record along a field holds", parents=[common])
    strengths.add_options(verb)
    verb.set_defaults(run=strengths.waves)

    for name, add, text in (
        ("show", kept.add_show, "print a saved result again, and what made it"),
        ("compare", kept.add_compare, "set saved designs or runs side by side"),
    ):
        add(verbs.add_parser(name, help=text, parents=[common]))

    for name, run, text in (
        ("schema", schemas.schema, "print the JSON schema of problem files, by which editors complete and check them"),
        ("completion", schemas.completion, "print a script that lets a shell complete this command"),
    ):
        verb = verbs.add_parser(name, help=text, parents=[common])
        if name == "completion":
            verb.add_argument("shell", choices=shtab.SUPPORTED_SHELLS, help="the shell")
        verb.set_defaults(run=run, parser=parser)

    for name, run, add, text in (
        ("check", commands.check, _add_check, "check a problem file and say what its scene contains"),
        ("simulate", commands.simulate, _add_shown, "simulate the scene with every variable at its guess"),
        ("optimise", commands.optimise, _add_optimise, "find the best share, and say what decided it"),
        ("tradeoff", commands.tradeoff, _add_tradeoff, "trade two or three results against each other: the front"),
        ("sweep", sweeps.sweep, sweeps.add_options, "simulate or optimise at every point of a grid or a sample"),
        ("calibrate", calibrations.calibrate, calibrations.add_options, "find soil parameters from measured draft"),
        ("export", exports.export, exports.add_options, "write the scene for other tools: C, CasADi, OpenMDAO, FMU"),
        ("report", pages.report, pages.add_options, "write everything about the best share as one page for a browser"),
        ("accuracy", commands.accuracy, _add_accuracy, "show what accuracy costs in time: which method to take"),
    ):
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


def _add_shown(verb: argparse.ArgumentParser) -> None:
    """Add the options of a result that is printed and drawn."""
    verb.add_argument("--json", action="store_true", help="print JSON (SI units) instead of a table")
    verb.add_argument("--plot", metavar="FILE", help="write a picture: .png, .svg or .pdf")


def _add_check(verb: argparse.ArgumentParser) -> None:
    """Add the options of a check, and of the comparison with other draft models."""
    verb.add_argument("--effects", action="store_true", help="print what each effect costs, on or off")
    verb.add_argument("--json", action="store_true", help="print the scene's quantities as JSON (SI units)")
    _add_against(verb)


def _add_optimise(verb: argparse.ArgumentParser) -> None:
    """Add the options of an optimisation."""
    verb.add_argument(
        "--search",
        metavar="HOW",
        default="auto",
        help="auto, thorough (four times as much), near (the guess's basin), a number of designs, a time as"
        ' "20 s", or keys of variables, with commas (default: auto)',
    )
    verb.add_argument("--seed", type=int, default=0, metavar="N", help="of the search's samples (default: 0)")
    verb.add_argument(
        "--judge",
        choices=("tolerance", "bare"),
        default="tolerance",
        help="compare optima by their median within the tolerances, or as they are (default: tolerance)",
    )
    verb.add_argument(
        "--sensitivity",
        action="store_true",
        help="print by how many per cent the optimum changes per per cent of every quantity and limit",
    )
    _add_shown(verb)


def _add_tradeoff(verb: argparse.ArgumentParser) -> None:
    """Add the options of a front."""
    _add_shown(verb)
    verb.add_argument("--points", type=int, metavar="N", help="positions on the front (default: the file's)")
    verb.add_argument("--csv", metavar="FILE", help="write a table of all points")
    verb.add_argument("--output", metavar="FILE", help="write everything as JSON")


def _add_against(verb: argparse.ArgumentParser) -> None:
    """Add the options of the comparison with other draft models."""
    verb.add_argument("--against", action="store_true", help="print what other draft models give; next options need it")
    for name, example, text in (
        ("depth", "0.4 m", "working depth, repeatable (default: the share's height)"),
        ("speed", "5 km/h", "speed, repeatable (default: 3, 5, 7, 9 km/h and the tow speed)"),
    ):
        verb.add_argument(f"--{name}", action="append", metavar=f'"{example}"', help=text)
    for name, example, text in (
        ("width", "0.08 m", "width of the tine (default: base diameter of the equivalent cone)"),
        ("rake", "45 deg", "rake angle of the tine (default: the share's chisel angle)"),
        ("adhesion", "2 kPa", "adhesion of soil on the tine (default: none)"),
        ("surcharge", "1 kPa", "pressure on the soil's surface (default: none)"),
        ("rupture-ratio", "2.5", "rupture distance over depth (default: of a plane wedge)"),
    ):
        verb.add_argument(f"--{name}", metavar=f'"{example}"', help=text)
    verb.add_argument("--texture", metavar="NAME", help="fine, medium or coarse, for ASABE D497 (default: all)")
    verb.add_argument("--point", metavar="NAME", help="narrow or winged, for ASABE D497 (default: narrow)")
    verb.add_argument("--plot", metavar="FILE", help="write a picture of it: .png, .svg or .pdf")


def _add_accuracy(verb: argparse.ArgumentParser) -> None:
    """Add the options of the accuracy study."""
    verb.add_argument("--error", type=float, default=1e-6, metavar="E", help="relative error wanted (default: 1e-6)")
    verb.add_argument(
        "--seconds",
        type=float,
        default=1.0,
        metavar="S",
        help="time one use of a method may take, and a tenth of what a solve may take (default: 1)",
    )
    verb.add_argument("--design", action="store_true", help="study the optimum of the design instead of its scene")
    verb.add_argument("--thin", action="store_true", help="try every other setting only")
    _add_shown(verb)
    verb.add_argument("--output", metavar="FILE", help="write every figure as JSON")
