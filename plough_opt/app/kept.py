"""`plough-opt show` and `compare`: results that were kept, as they were printed, and designs side by side."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from plough_opt.app.terminal import check_outputs, console, print_page, wrote
from plough_opt.core.errors import InputError
from plough_opt.core.quantities import EVERY
from plough_opt.core.tables import Grid, Page
from plough_opt.core.units import Display
from plough_opt.design import LocalOptimum
from plough_opt.exchange.results import SavedRun, is_store, load
from plough_opt.motion.vocabulary import called
from plough_opt.studies.sweep.result import Sweep

# Results of a run that are set side by side.
_AVERAGES = {"mean_draft": "N", "force_rms": "N", "mean_deflection": "m", "displacement_rms": "m", "tow_power": "W"}


def add_show(verb: argparse.ArgumentParser) -> None:
    """Add the options of `show`."""
    verb.add_argument("file", metavar="FILE", help="a saved result (JSON), or the store of a sweep")
    verb.add_argument("--json", action="store_true", help="print the result as JSON (SI units)")
    verb.set_defaults(run=show)


def add_compare(verb: argparse.ArgumentParser) -> None:
    """Add the options of `compare`."""
    verb.add_argument("file", metavar="FILE", nargs="+", help="saved designs or runs (JSON), two or more")
    verb.add_argument("--json", action="store_true", help="print JSON (SI units) instead of a table")
    verb.add_argument("--plot", metavar="FILE", help="write a picture: .png, .svg or .pdf")
    verb.set_defaults(run=compare)


def show(options: argparse.Namespace) -> None:
    """Print a saved result again, and what made it."""
    path = Path(options.file)
    if is_store(path):
        with Sweep.load(path) as swept:
            if options.json:
                print(swept.to_json())
            else:
                print_page(console(), swept.page())
        return
    found = load(path)
    if options.json:
        print(found.to_json())
        return
    print_page(console(), found.page())
    for line in found.origin.lines(found.versions) if hasattr(found, "origin") else ():
        console().print(line, markup=False, soft_wrap=True)


def compare(options: argparse.Namespace) -> None:
    """Set saved designs, or runs, side by side: what was changed, variables, requirements, results."""
    if len(options.file) < 2:
        raise InputError("compare sets two or more saved results side by side: name another file")
    check_outputs(options)
    found = {_name(path, options.file): load(path) for path in options.file}
    for name, one in found.items():
        if not isinstance(_run(one), SavedRun) and _design(one) is None:
            raise InputError(f"'{name}' holds neither a design nor a run: compare what optimise or simulate saved")
    if options.json:
        print(json.dumps({name: _numbers(one) for name, one in found.items()}, indent=2, allow_nan=False))
    else:
        changed = {name: " ".join(one.origin.overrides) or "nothing" for name, one in found.items()}
        notes = tuple(f"{name}: {one.origin.file}, changed by --set: {changed[name]}" for name, one in found.items())
        print_page(console(), Page(f"{len(found)} results side by side", (_table(found), *notes)))
    if options.plot is not None:
        from plough_opt.app import plots

        designs = {name: design for name, one in found.items() if (design := _design(one)) is not None}
        if designs:
            figure = plots.plot_designs(designs)
        else:
            figure = plots.plot_forces({name: (one.time, one.mount_force) for name, one in found.items()})
        wrote(plots.save(figure, options.plot))


def _name(path: str, paths: list[str]) -> str:
    """Return what a column is called: the file's name, or its path where several have that."""
    return path if sum(Path(other).name == Path(path).name for other in paths) > 1 else Path(path).name


def _design(saved: Any) -> LocalOptimum | None:
    """Return the best design of a saved result, if it has one."""
    best = getattr(saved, "best", None)
    return best if isinstance(best, LocalOptimum) else None


def _run(saved: Any) -> SavedRun | None:
    """Return the run of a saved result, if it has one."""
    run = saved if isinstance(saved, SavedRun) else getattr(saved, "run", None)
    return run if isinstance(run, SavedRun) else None


def _numbers(saved: Any) -> dict[str, float]:
    """Return the numbers of a saved result, SI: quantities, objective, variables, requirements and averages."""
    design, run = _design(saved), _run(saved)
    found: dict[str, float] = {}
    if run is not None:
        found |= run.quantities
    if design is not None:
        found |= {"objective": design.objective, **{limit.name: limit.value for limit in design.limits}}
    if run is not None:
        found |= {name: getattr(run.averages, name) for name in _AVERAGES}
        found |= {"peak_force": run.peak_force, "peak_deflection": run.peak_deflection}
    return found


def _table(found: dict[str, Any]) -> Grid:
    """Return a row for each number that differs, or is a result; each row has one unit."""
    grid = Grid.of("", "", *found)
    numbers = {name: _numbers(one) for name, one in found.items()}
    units = {name: unit for one in found.values() for name, unit in _units(one).items()}
    for key in dict.fromkeys(key for own in numbers.values() for key in own):
        values = [own.get(key) for own in numbers.values()]
        if key not in units and len(set(values)) == 1:
            continue  # a quantity that all have alike
        unit = EVERY[key].unit if key in EVERY else ""
        origin = next(iter(found.values())).origin
        display = units.get(key) or origin.display(key, unit, *(x for x in values if x is not None))
        decides = [_decides(one, key) for one in found.values()]
        grid.row(called(key), *("" if x is None else f"{display.text(x, 6)}{mark}"
                                          for x, mark in zip(values, decides, strict=True)))  # fmt: skip
    grid.caption = "* this limit decides the design" if any("*" in cell for row in grid.rows for cell in row) else ""
    return grid


def _decides(saved: Any, key: str) -> str:
    """Return a mark on a limit that decides a design."""
    design = _design(saved)
    return " *" if design is not None and key in design.active else ""


def _units(saved: Any) -> dict[str, Display]:
    """Return the unit in which each result of a saved one is shown."""
    design, run = _design(saved), _run(saved)
    found: dict[str, Display] = {}
    if run is not None:
        forces = {"mean_draft": run.averages.mean_draft, "mount_force": run.peak_force}
        lengths = {"deflection": run.peak_deflection, "mean_deflection": run.averages.mean_deflection}
        common = {"N": saved.origin.common("N", forces), "m": saved.origin.common("m", lengths)}
        common["W"] = saved.origin.common("W", {"tow_power": run.averages.tow_power})
        found |= {name: common[unit] for name, unit in _AVERAGES.items()}
        found |= {"peak_force": common["N"], "peak_deflection": common["m"]}
    if design is not None:
        found |= {"objective": Display("", 1.0), **{limit.name: limit.shown for limit in design.limits}}
    return found
