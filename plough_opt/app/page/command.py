"""`plough-opt report`: everything about a file's best share on one page."""

import argparse
import hashlib
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from plough_opt.app.options import add_shared
from plough_opt.app.terminal import progress, read, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file
from plough_opt.problem_file import Problem


def add_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    verb.add_argument("-o", "--output", required=True, metavar="FILE.html", help="page to write")
    add_shared(verb, "seed", json="print what was written, and what made it, as JSON")
    verb.add_argument("--no-accuracy", action="store_true", help="leave out the study of what accuracy costs")


def report(options: argparse.Namespace) -> None:
    """Optimise a file, or simulate one without variables, and write the page.

    Raises:
        InputError: a mistake in the file, an output that cannot be written, or a file that trades results or whose
            soil is uncertain.
    """
    from plough_opt.app.page.writing import reported, write_page  # the studies are slow to import

    check_file(options.output, ".html", "page")
    problem = read(options)
    _check(problem)
    text = Path(options.file).read_text(encoding="utf-8")
    with progress() as notify:
        found = reported(problem, notify, seed=options.seed, accuracy=not options.no_accuracy)
    found = replace(found, provenance=_provenance(options, text), text=text)
    path = write_page(found, options.output)
    if options.json:
        print(json.dumps({"wrote": [str(path)], "provenance": found.provenance}, indent=2, allow_nan=False))
    wrote(path)


def _check(problem: Problem) -> None:
    if problem.shares:
        problem.scene()  # which says to choose one
    if problem.table.uncertain is not None:
        raise InputError(
            f"{problem.name}: a report is about one soil: leave out the table [uncertain], or take plough-opt optimise"
        )
    if problem.variables and not problem.table.minimise:
        raise InputError(
            f"{problem.name}: a report is about one best design: add a table [minimise], or take plough-opt tradeoff"
        )


def _provenance(options: argparse.Namespace, text: str) -> dict[str, str]:
    """Return what made a report, in words."""
    from plough_opt.core.saving import versions

    changes = {"changed by --set": "; ".join(options.set)} if options.set else {}
    return {
        "file": Path(options.file).name,
        "SHA-256 of the file": hashlib.sha256(text.encode()).hexdigest(),
        **changes,
        "seed of the search": str(options.seed),
        "written": datetime.now().astimezone().isoformat(sep=" ", timespec="minutes"),
        "made by": ", ".join(f"{name} {value}" for name, value in versions().items()),
    }
