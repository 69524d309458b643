"""The command `plough-opt`: its arguments, what it runs, and its exit status.

Nothing here imports the rooms of the package, so that help needs no numerical library.

Exit status: 0 success; 1 the problem has no solution, or none was found; 2 invalid input; 130 interrupted (a sweep
continues when it is started again).
"""

import argparse
import contextlib
import gc
import io
import os
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Any, NoReturn

from plough_opt.core.errors import DomainError, InfeasibleDesign, InputError, PloughError, nearest, printable
from plough_opt.core.files import text_of
from plough_opt.core.process import load_additions, without_notices
from plough_opt.exchange.export.formats import FORMATS

SOLVED, UNSOLVED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """A parser whose messages are fit for a terminal; ``type`` of an option may be "int" or "float"."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.register("type", "int", int)
        self.register("type", "float", float)

    def error(self, message: str) -> NoReturn:
        """Print a message, which may quote the arguments, on the error stream and exit."""
        if wrong := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            choices = re.findall(r"[\w-]+", wrong[2])
            message = f"{message[: wrong.start()]}'{wrong[1]}' is unknown: {nearest(wrong[1], choices)}"
        super().error(printable(message))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, as `commands.toml` describes it."""
    table = tomllib.loads(text_of("plough_opt.app", "commands.toml"))
    formats = "; ".join(f"{name}: {own}" for name, own in FORMATS.items())
    table["commands"]["export"]["options"]["--to FORMAT"] = formats, {"required": True, "choices": FORMATS}
    whole = _Parser(prog="plough-opt", description="Design of subsoiler ploughshares: draft, oscillation, constraints.")
    whole.add_argument("--version", action="version", version=f"plough-opt {version('plough_opt')}")
    verbs = whole.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, command in table["commands"].items():
        verb = verbs.add_parser(name, help=command["help"], aliases=["optimize"] if name == "optimise" else [])
        verb.set_defaults(function=name)
        _add(verb.add_mutually_exclusive_group(), table["words"])
        groups = [table[group] for group in command.get("shares", [])]
        _add(verb, {key: about for group in (*groups, command.get("options", {})) for key, about in group.items()})
    return whole


def _add(verb: Any, options: Mapping[str, Any]) -> None:
    """Add options, such as "-o --output FILE" -> help, or (help, settings of argparse), to a parser or group."""
    for written, about in options.items():
        text, settings = (about, {}) if isinstance(about, str) else about
        words = written.split(" ")
        flags = [word for word in words if word.startswith("-")] or words[:1]
        if value := " ".join(words[len(flags) :]):
            settings = {"metavar": value} | settings
        elif "choices" not in settings:
            settings = {"action": "store_true"} | settings
        verb.add_argument(*flags, help=text, **settings)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    options = argparse.Namespace()
    try:
        load_additions()
        options = parser().parse_args(arguments)
        _run(options)
    except PloughError as error:
        wrong = isinstance(error, InputError | DomainError)
        _complain("bad input" if wrong else "no solution", error)
        if isinstance(error, InfeasibleDesign):
            _give_conflicts(options, error)
        return BAD_INPUT if wrong else UNSOLVED
    except KeyboardInterrupt as stop:
        from plough_opt.app.terminal import what_was_written

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


def _run(options: argparse.Namespace) -> None:
    """Run the command that the options name."""
    from plough_opt.app.terminal import interruptible, messages

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Escape characters of a title that the terminal cannot encode, instead of failing.
            stream.reconfigure(errors="backslashreplace")
    with interruptible(), without_notices(), messages(options):
        commands = import_module("plough_opt.app.commands")
        if not gc.isenabled():  # by the entry point
            gc.freeze()  # No pass looks at the modules again: a tenth of the time of an optimisation.
            gc.enable()
        getattr(commands, options.function)(options)
    if sys.stdout is not None:  # None if the parent process closed it
        sys.stdout.flush()


def _give_conflicts(options: argparse.Namespace, error: InfeasibleDesign) -> None:
    """Print the conflicts of an infeasible design as JSON under --json, and write them with --output."""
    from plough_opt.app.terminal import messages, wrote
    from plough_opt.core.files import write_file
    from plough_opt.core.plain_data import json_text, to_plain

    plain = {"kind": "infeasible design", "message": str(error), **to_plain(vars(error))}
    text = json_text(plain)
    if options.json:
        print(text)
    if hasattr(options, "csv") and options.output is not None:  # other commands write no JSON there
        with messages(options):
            wrote(write_file(options.output, "output", f"{text}\n"))


def _drop_output() -> None:
    """Redirect standard output, which accepts no more text, so that the flush at exit does not fail."""
    with contextlib.suppress(AttributeError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(kind: str, error: object) -> None:
    """Print an error on the error stream."""
    from plough_opt.core.screen import Screen

    Screen(stderr=True).print_labelled(f"{kind}:", "bold red", str(error))
