"""The table of what an optimum owes to every quantity of its file, and to the limits that decide it."""

from collections.abc import Sequence
from dataclasses import replace

from plough_opt.app.messages import LOG
from plough_opt.app.report import shown
from plough_opt.core.errors import InputError, NotConverged
from plough_opt.core.tables import Grid, Page
from plough_opt.design import Optimum, Progress, Sensitivity
from plough_opt.problem_file import Problem

# Smaller elasticities are the rounding of none.
_NONE = 1e-9


def sensitivities_of(best: Optimum, notify: Progress) -> tuple[Sensitivity, ...]:
    """Return all sensitivities of an optimum, or none and a note that says why it has none."""
    notify("sensitivities", 1.0)
    try:
        return best.every_sensitivity()
    except (InputError, NotConverged) as error:
        LOG.info("note: no sensitivities: %s", error)
        return ()


def with_sensitivities(page: Page, problem: Problem, found: Sequence[Sensitivity]) -> Page:
    """Return a page with elasticities of the best objective and of the variables, by size, and how far they hold."""
    if not found:
        return page
    names = [key.rpartition(".")[2] for key in problem.variables]
    table = Grid.of(
        "Change in per cent for one per cent more, solved again; the same limits decide from ... to ...",
        "quantity or limit", "value", "objective", *names, "same limits from", "to", fold=("quantity or limit",),
    )  # fmt: skip
    for item in found:
        moves = [_percent(item.elasticity), *(_percent(item.elasticities[key]) for key in problem.variables)]
        key = item.name.partition(" ")[0]
        ends = [_end(problem, key, item, end) for end in (item.valid_from, item.valid_to)]
        table.row(item.name, shown(problem, key, item.value, item.unit), *moves, *ends)
    met = dict.fromkeys(name for item in found for name in item.touching)
    notes = (f"{name} is just met: the figures are for values that grow" for name in met)
    return replace(page, parts=(*page.parts, table), notes=(*page.notes, *notes))


def _percent(elasticity: float | None) -> str:
    if elasticity is None:
        return "value 0"
    return "0" if abs(elasticity) < _NONE else f"{elasticity:+.3g}"


def _end(problem: Problem, key: str, item: Sensitivity, end: float | None) -> str:
    """Return an end of a range; none where it is beyond zero, where no quantity of a file can go."""
    return "" if end is None or end * item.value <= 0.0 else shown(problem, key, end, item.unit)
