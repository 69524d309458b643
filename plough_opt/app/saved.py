"""`plough-opt show` and `compare`: saved results printed again, and several side by side."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plough_opt.app.tables import runs_of
from plough_opt.app.terminal import check_outputs, console, give, wrote
from plough_opt.core.errors import InputError, printable
from plough_opt.core.quantities import EVERY
from plough_opt.core.saving import Origin, is_store, load
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import OBJECTIVE_DIGITS, RESULT_DIGITS, Display
from plough_opt.design import LocalOptimum
from plough_opt.motion import Run
from plough_opt.motion.machine import Machine
from plough_opt.motion.scene import quantities_of
from plough_opt.motion.vocabulary import called
from plough_opt.studies.sweep.result import Sweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A relative difference below this is rounding.
_ROUNDING = 1e-9
# SI unit -> results of a run that `compare` shows in one common unit.
_RESULTS = {
    "N": ("mean_draft", "force_rms", "peak_force"),
    "m": ("mean_deflection", "displacement_rms", "peak_deflection"),
    "W": ("tow_power",),
}


def show(options: argparse.Namespace) -> None:
    """Print a saved result again, and its origin."""
    path = Path(options.file)
    check_outputs(options)
    if is_store(path):
        if options.problem or options.restore:
            raise InputError("the store of a sweep has no problem file, only its settings: --json prints these")
        with Sweep.load(path) as swept:
            give(options, swept.page(), swept.to_json, swept.plot, swept.to_dataframe, swept.to_csv)
        return
    found = load(path)
    origin: Origin = getattr(found, "origin", Origin())
    if options.problem:
        print(printable(origin.problem()))
    else:
        give(options, found.shown_page(), found.to_json, found.plot, found.to_dataframe)
        for line in () if options.json else origin.lines(found.made_by):
            console().print(line, soft_wrap=True)
    if options.restore is not None:
        wrote(origin.restore(options.restore))


def compare(options: argparse.Namespace) -> None:
    """Print saved designs or runs side by side: overrides, variables, requirements and results."""
    if len(options.file) < 2:
        raise InputError("compare needs two or more saved results: name another file")
    check_outputs(options)
    saved = {_column(path, options.file): load(path) for path in options.file}
    for name, one in saved.items():
        if not _runs(one) and _design(one) is None:
            raise InputError(f"'{name}' contains neither a design nor a run: name results of optimise or simulate")
    numbers = {name: _numbers(one) for name, one in saved.items()}
    origins = {name: one.origin for name, one in saved.items() if hasattr(one, "origin")}
    changed = {name: " ".join(origin.overrides) or "nothing" for name, origin in origins.items()}
    notes = tuple(f"{name}: {origins[name].file}, changed by --set: {text}" for name, text in changed.items())
    page = Page(f"{len(saved)} results side by side", (_table(saved, numbers), *notes))
    plain = {name: {key: value for key, (value, _) in own.items()} for name, own in numbers.items()}
    give(
        options,
        page,
        lambda: json.dumps(plain, indent=2, allow_nan=False),
        lambda: _figure(saved),
        lambda: _frame(plain),
    )


def _frame(numbers: Mapping[str, Mapping[str, float]]) -> Any:
    """Return a data frame with a row for each quantity and a column for each result, in SI units."""
    names = [*dict.fromkeys(name for own in numbers.values() for name in own)]
    columns = {file: [own.get(name) for name in names] for file, own in numbers.items()}
    return data_frame({"quantity": names, **columns}, {})


def _figure(saved: Mapping[str, Any]) -> Figure:
    """Return the picture of all designs, or of all runs if there are no designs."""
    from plough_opt.app import plots

    designs = {name: design for name, one in saved.items() if (design := _design(one)) is not None}
    if designs:
        return plots.plot_designs(designs)
    runs = {f"{name} {share}".rstrip(): run for name, one in saved.items() for share, run in _runs(one).items()}
    return plots.plot_forces(runs)


def _column(path: str, paths: list[str]) -> str:
    """Return the heading of a column: the file's name, or its whole path if another file has the same name."""
    return path if sum(Path(other).name == Path(path).name for other in paths) > 1 else Path(path).name


def _design(saved: Any) -> LocalOptimum | None:
    """Return the best design of a result, or None."""
    best = getattr(saved, "best", saved)
    return best if isinstance(best, LocalOptimum) else None


def _runs(saved: Any) -> Mapping[str, Run]:
    """Return share -> run of a result, with "" for an unnamed share; empty if it has no run."""
    run = saved if isinstance(saved, Run | Machine) else getattr(saved, "run", None)
    return {} if run is None else runs_of(run)


def _numbers(saved: Any) -> dict[str, tuple[float, Display | None]]:
    """Return name -> (value in SI, unit to show it in) of quantities, objective, variables, requirements and results.

    The unit of a quantity is None, because `_table` chooses one for all results.
    """
    design = _design(saved)
    found: dict[str, tuple[float, Display | None]] = {}
    results: dict[str, tuple[float, Display | None]] = {}
    for share, run in _runs(saved).items():
        before = f"{share}." if share else ""
        given = quantities_of(run.scene)
        found |= {before + name: (float(value), None) for name, value in given.items() if value is not None}
        for unit, names in _RESULTS.items():
            own = {name: float(getattr(run, name)) for name in names}
            display = run.origin.common(unit, own)
            results |= {before + name: (value, display) for name, value in own.items()}
    if design is not None:
        found["objective"] = design.objective, Display("", 1.0)
        found |= {limit.name: (limit.value, limit.shown) for limit in design.limits}
    return found | results


def _difference(values: Sequence[float | None], display: Display) -> str:
    """Return by how much the second value, or of several the largest from the smallest, differs from the first."""
    given = [x for x in values if x is not None]
    if len(given) < 2:
        return ""
    change = given[1] - given[0] if len(values) == 2 else max(given) - min(given)
    if abs(change) <= _ROUNDING * max(map(abs, given)):
        return "0 %"
    return f"{100.0 * change / abs(given[0]):+.3g} %" if given[0] else display.text(change, 3)


def _table(saved: Mapping[str, Any], numbers: Mapping[str, Mapping[str, tuple[float, Display | None]]]) -> Grid:
    """Return a table with a row for each result and each quantity that differs; each row has one unit."""
    grid = Grid.of("", "", *saved, "difference" if len(saved) == 2 else "largest difference")
    for key in dict.fromkeys(key for own in numbers.values() for key in own):
        cells = [own.get(key) for own in numbers.values()]
        values = [None if cell is None else cell[0] for cell in cells]
        display = next((cell[1] for cell in reversed(cells) if cell is not None and cell[1] is not None), None)
        if display is None:
            if len(set(values)) == 1:
                continue  # a quantity with the same value everywhere
            quantity = EVERY[key if key in EVERY else key.partition(".")[2]]
            origin = next(run.origin for one in saved.values() for run in _runs(one).values())
            display = origin.display(quantity.name, quantity.unit, *(x for x in values if x is not None))
        decides = [(design := _design(one)) is not None and key in design.active for one in saved.values()]
        digits = OBJECTIVE_DIGITS if key == "objective" else RESULT_DIGITS
        texts = [
            "" if x is None else f"{display.text(x, digits)}{' *' * own}"
            for x, own in zip(values, decides, strict=True)
        ]
        grid.row(called(key), *texts, _difference(values, display))
    grid.caption = "* this limit decides the design" if any("*" in cell for row in grid.rows for cell in row) else ""
    return grid
