"""The command `optimise` for a file with an uncertain soil: the robust optimum beside the nominal one."""

import argparse

from plough_opt.app.terminal import give, progress
from plough_opt.core.errors import InputError
from plough_opt.problem_file import Problem


def optimise_uncertain(problem: Problem, options: argparse.Namespace) -> None:
    """Solve the robust design, verify it, and report it beside the nominal one."""
    if options.sensitivity:
        raise InputError(
            "--sensitivity is of an optimum for one soil: leave it out, for what the results owe to the uncertain"
            " properties is reported anyway, or leave out the table [uncertain]"
        )
    from plough_opt.problem_file.robust_design import optimise_robust  # scipy.stats is slow to import

    with progress() as notify:
        found = optimise_robust(problem, notify)
    give(options, found.page(), found.to_json, found.plot)
