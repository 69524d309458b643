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
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.metadata import version
from typing import Any, Final, NoReturn

from plough_opt.core.errors import DomainError, InfeasibleDesign, InputError, PloughError, nearest, printable
from plough_opt.core.process import load_additions, without_notices

_SHARED: Final[dict[str, dict[str, Any]]] = {
    "json": {"action": "store_true", "help": "print JSON (SI units) instead of a table"},
    "plot": {"metavar": "FILE", "help": "write a picture: .png, .svg or .pdf"},
    "csv": {"metavar": "FILE", "help": "write a table of the result (SI units): .csv, or .xlsx"},
    "output": {"metavar": "FILE", "help": "write the whole result as JSON"},
    "seed": {"type": int, "default": 0, "metavar": "N", "help": "seed of the search's samples (default: 0)"},
}


class _Parser(argparse.ArgumentParser):
    """A parser with shorter ways to add options; its messages are fit for a terminal."""

    def error(self, message: str) -> NoReturn:
        """Print a message, which may quote the arguments, on the error stream and exit."""
        if wrong := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            known = re.findall(r"[\w-]+", wrong[2])
            message = f"{message[: wrong.start()]}'{wrong[1]}' is unknown: {nearest(wrong[1], known)}"
        super().error(printable(message))

    def shared(self, *names: str, **helps: str) -> None:
        """Add options that several commands share.

        Args:
            names: names of options with their usual help.
            helps: option -> help text for this command.
        """
        for name in (*names, *helps):
            flags = ["-o", "--output"] if name == "output" else [f"--{name}"]
            self.add_argument(*flags, **(_SHARED[name] | ({"help": helps[name]} if name in helps else {})))

    def results(self, *, by_pandas: bool = True, **helps: str | None) -> None:
        """Add the options of every command that has a result.

        Args:
            by_pandas: whether its table needs pandas, also as CSV.
            helps: option -> help text for this command; None if the command does not have it.
        """
        texts = {name: helps.get(name, _SHARED[name]["help"]) for name in ("json", "csv", "output", "plot")}
        self.shared(**{name: text for name, text in texts.items() if text is not None})
        self.set_defaults(by_pandas=by_pandas)

    def option(self, name: str, value: str, text: str, **more: Any) -> None:
        """Add an option with a value; ``value`` is its placeholder in the help."""
        self.add_argument(f"--{name}", metavar=value, help=text, **more)

    def switch(self, name: str, text: str) -> None:
        """Add an option without a value."""
        self.add_argument(f"--{name}", action="store_true", help=text)

    def choice(self, name: str, choices: Sequence[str], text: str, default: str | None = None) -> None:
        """Add an option whose value is one of a few."""
        self.add_argument(f"--{name}", choices=choices, default=default, help=text)


def _init(verb: _Parser) -> None:
    verb.add_argument("file", metavar="FILE", nargs="?", help="new file to write; it must not exist yet")
    verb.switch("schema", "print the JSON schema of problem files instead, for checks in an editor")
    verb.shared(json="print the path of the file as JSON")


def _show(verb: _Parser) -> None:
    results = "saved results (JSON), or the CSV file of a sweep; several designs or runs are set side by side"
    verb.add_argument("file", metavar="FILE", nargs="+", help=results)
    verb.results(json="print the result as JSON (SI units)")
    verb.switch("problem", "print the problem file and its data instead")


def _check(verb: _Parser) -> None:
    verb.switch("effects", "print which effects are on, and the cost of each")
    verb.results(
        csv="write the quantities, or with --effects the costs (SI units): .csv, or .xlsx",
        plot="draw the share: .png, .svg or .pdf",
    )


def _optimise(verb: _Parser) -> None:
    search = (
        "effort of the search: auto, thorough (four times the designs), near (only the guess's basin), a number of"
        ' designs to sample or a time such as "20 s", after which no further round begins, or the variables to sample,'
        " with commas (default: auto)"
    )
    verb.option("search", "HOW", search, default="auto")
    verb.switch(
        "sensitivity", "print the change of the optimum in per cent for one per cent more of every quantity and limit"
    )
    verb.shared("seed")
    verb.results(csv="write the local optima (SI units): .csv, or .xlsx")


def _tradeoff(verb: _Parser) -> None:
    verb.option("points", "N", "positions on the front (default: the file's)", type=int)
    verb.results(by_pandas=False)


def _sweep(verb: _Parser) -> None:
    over = (
        'quantity and its values: soil.cohesion="5..45 kPa:9", scene.stiffness="10..1000 kN/m:7 log",'
        ' scene.tow_speed="1 m/s, 2 m/s"; repeatable, for all combinations'
    )
    verb.option("over", 'KEY="RANGE"', over, action="append", required=True)
    verb.option("samples", "N", "size of a Sobol sample of the ranges, preferably a power of two", type=int)
    verb.switch("optimise", "optimise at every point instead of simulating")
    how = "simulate each point by itself, or many at once by po.Batch (default: decided by their number)"
    verb.choice("method", ("auto", "each", "batch"), how, "auto")
    verb.option("workers", "N", "processes on this machine (default: all cores)", type=int)
    verb.option("scheduler", "ADDRESS", "use the workers of a dask scheduler: tcp://host:8786")
    verb.shared(seed="seed of the sample (default: 0)")
    csv = "write a row for each finished point, and continue there (default: a file named after the sweep)"
    verb.results(by_pandas=False, csv=csv, plot="draw every result: .png, .svg or .pdf")


def _calibrate(verb: _Parser) -> None:
    data = "CSV file of one measured result, with names and units in its header; repeatable"
    verb.option("data", "FILE.csv", data, action="append", required=True)
    unknown = (
        'quantity to estimate, with its bounds: soil.cohesion="1..80 kPa"; repeatable (default: the [variables] of the'
        " file that are not columns of the data)"
    )
    verb.option("unknown", 'KEY="RANGE"', unknown, action="append", default=[])
    known = 'separate measurement of an unknown, with one standard deviation: soil.friction_angle="28 +- 1 deg"'
    verb.option("known", 'KEY="VALUE"', known, action="append", default=[])
    verb.choice(
        "loss", ("squares", "soft_l1"), "loss; soft_l1 gives outliers less weight (default: squares)", "squares"
    )
    errors = "errors whose sigma is not stated: constant, or proportional to the result (default: constant)"
    verb.choice("errors", ("constant", "relative"), errors, "constant")
    verb.option("level", "P", "confidence level of the intervals (default: 0.95)", type=float, default=0.95)
    part = "also fit to the other rows, and predict this part of them: 1/3, 0.3 or 30 %%"
    verb.option("hold-out", "PART", part)
    by = "hold out rows together that have one value in this column: share.wedge_angle (default: single rows)"
    verb.option("hold-out-by", "KEY", by)
    seed = "seed of the rows that are held out (default: 1)"
    plot = "draw the residuals, or with --hold-out the predicted rows: .png, .svg or .pdf"
    verb.option("seed", "N", seed, type=int, default=1)
    verb.results(plot=plot, csv="write the fitted rows (SI units): .csv, or .xlsx")


def _export(verb: _Parser) -> None:
    from plough_opt.exchange.export.formats import FORMATS

    verb.shared(json="print the paths of the files as JSON")
    formats = "; ".join(f"{name}: {one}" for name, one in FORMATS.items())
    verb.add_argument("--to", required=True, choices=FORMATS, metavar="FORMAT", help=formats)
    verb.add_argument("-o", "--output", metavar="PATH", help="file or folder to write", required=True)
    verb.option("inputs", "NAMES", "inputs, such as share.height,soil.cohesion (default: the variables)")
    results = "results, such as mean_draft,force_rms (default: those that the file minimises, trades and requires)"
    verb.option("outputs", "NAMES", results)
    verb.option("description", "FILE.json", "for casadi: also write names, units and bounds here")
    verb.option("name", "NAME", "name of the function or model (default: share)")
    strut = "for an FMU: whether its input is the strut's speed or position (default: speed)"
    verb.choice("strut", ("speed", "position"), strut)
    verb.switch("sources", "for an FMU: only its C source, which needs no compiler")
    angle = "for a part: angle between the share's faces (default: gives the block the mass that the model uses)"
    verb.option("opening", '"90 deg"', angle)
    verb.option("thickness", '"10 mm"', "for a part: thickness of a bent plate (default: a solid block)")
    verb.choice("body", ("share", "cone"), "for a part: which body (default: share)")
    at = (
        "for a part: the best design, that from the file's catalogue, or the variables' guesses (default: the first of"
        " catalogue, best and guess that the file has)"
    )
    verb.choice("at", ("best", "catalogue", "guess"), at)


def _explore(verb: _Parser) -> None:
    where = "page to write, which is then not opened (default: one in the user's cache folder, which is opened)"
    verb.add_argument("-o", "--output", metavar="FILE.html", help=where)
    verb.shared("seed", json="print the path of the page and its provenance as JSON, and open nothing")


def _accuracy(verb: _Parser) -> None:
    verb.option("error", "E", "relative error to reach (default: 1e-6)", type=float, default=1e-6)
    limit = "time limit of one run of a method; a search may take ten times as long (default: 1)"
    verb.option("seconds", "S", limit, type=float, default=1.0)
    verb.switch("design", "study how often searches of growing effort find the best design instead")
    verb.results()


def _reading(verb: _Parser) -> None:
    verb.add_argument("file", metavar="FILE", help="problem file (TOML)")
    change = 'change a key of the file, such as scene.tow_speed="2.5 m/s"; a variable becomes fixed; repeatable'
    verb.option("set", 'KEY="VALUE"', change, action="append", default=[])


# Name -> line of help, and what adds the options; a function of the same name in `commands` runs it.
_COMMANDS: Final[dict[str, tuple[str, Callable[[_Parser], None]]]] = {
    "init": ("write a commented problem file to start from", _init),
    "soils": ("list the named soils and where their values come from", partial(_Parser.results, plot=None)),
    "show": ("print a saved result again with its origin, or several side by side", _show),
    "check": ("check a problem file, and show what its scene contains", _check),
    "simulate": ("simulate the scene with every variable at its guess",
                 partial(_Parser.results, csv="write the motion at every output time: .csv, or .xlsx")),
    "optimise": ("find the best share, and the limits that decide it", _optimise),
    "tradeoff": ("compute the Pareto front of two or three results", _tradeoff),
    "sweep": ("simulate or optimise at every point of a grid or a sample", _sweep),
    "calibrate": ("estimate soil parameters from measured draft", _calibrate),
    "export": ("write the scene for other tools: C, CasADi, OpenMDAO, FMU", _export),
    "explore": ("open one HTML page: the report, and what computes any other design", _explore),
    "accuracy": ("compare error and time of integration methods", _accuracy),
}  # fmt: skip


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    every = _Parser(prog="plough-opt", description="Design of subsoiler ploughshares: draft, oscillation, constraints.")
    every.add_argument("--version", action="version", version=f"plough-opt {version('plough_opt')}")
    verbs = every.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, (text, add) in _COMMANDS.items():
        verb = verbs.add_parser(name, help=text, aliases=["optimize"] if name == "optimise" else [])
        how_much = verb.add_mutually_exclusive_group()
        quiet = "hide progress, notes and names of written files"
        how_much.add_argument("-q", "--quiet", action="store_true", help=quiet)
        verbose = "show each step with its time; -vv also every solve and run"
        how_much.add_argument("-v", "--verbose", action="count", default=0, help=verbose)
        if name not in ("init", "soils", "show"):
            _reading(verb)
        add(verb)
        verb.set_defaults(function=name)
    return every


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
            commands = import_module("plough_opt.app.commands")
            if not gc.isenabled():  # by the entry point
                gc.freeze()  # No pass looks at the modules again: a tenth of the time of an optimisation.
                gc.enable()
            getattr(commands, options.function)(options)
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
    from plough_opt.core.plain_data import json_text, to_plain

    plain = {"kind": "infeasible design", "message": str(error), **to_plain(vars(error))}
    text = json_text(plain)
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

    Screen(stderr=True).print_labelled(f"{kind}:", "bold red", str(error))
