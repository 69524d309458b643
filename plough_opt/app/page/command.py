"""`plough-opt report`: everything about a file's best share on one HTML page."""

import argparse
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from plough_opt.app.options import add_shared
from plough_opt.app.terminal import progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, write_file
from plough_opt.core.process import optional
from plough_opt.problem_file import Problem


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    verb.add_argument("-o", "--output", required=True, metavar="FILE.html", help="page to write")
    add_shared(verb, "seed", json="print the path of the page and its provenance as JSON")
    verb.add_argument("--no-accuracy", action="store_true", help="omit the comparison of integration methods")


def report(options: argparse.Namespace) -> None:
    """Optimise a file (or simulate it if it has no variables), and write the page.

    Raises:
        InputError: the file has a mistake, has several shares, trades results or has an uncertain soil, or the page
            cannot be written.
    """
    optional("jinja2", "report")
    from plough_opt.app.page.writing import page, reported  # the studies are slow to import

    check_file(options.output, "page", ".html")
    problem = read(options)
    _check(problem)
    with progress() as notify:
        found = reported(problem, notify, seed=options.seed, accuracy=not options.no_accuracy)
    found = replace(found, provenance=_provenance(options, problem), text=problem.text)
    path = write_file(options.output, "report", page(found))
    if options.json:
        print(json.dumps({"wrote": [str(path)], "provenance": found.provenance}, indent=2, allow_nan=False))
    wrote(path)


def _check(problem: Problem) -> None:
    """Raise InputError for a file that a report does not cover."""
    if problem.shares:
        problem.scene()  # raises InputError: one share must be chosen
    if problem.table.uncertain is not None:
        raise InputError(
            f"{problem.name}: a report covers one soil: remove the table [uncertain], or use plough-opt optimise"
        )
    if problem.variables and not problem.table.minimise:
        raise InputError(
            f"{problem.name}: a report covers one best design: add a table [minimise], or use plough-opt tradeoff"
        )


def _provenance(options: argparse.Namespace, problem: Problem) -> dict[str, str]:
    """Return heading -> text of everything that identifies how a report was made."""
    from plough_opt.core.saving import versions

    changes = {"changed by --set": "; ".join(options.set)} if options.set else {}
    return {
        "file": Path(options.file).name,
        "SHA-256 of the file": problem.origin.sha256,
        **changes,
        "seed of the search": str(options.seed),
        "written": datetime.now().astimezone().isoformat(sep=" ", timespec="minutes"),
        "made by": ", ".join(f"{name} {value}" for name, value in versions().items()),
    }
