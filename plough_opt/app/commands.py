"""Commands on problem files, saved results and measurements; each writes its files last, when nothing else can fail."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shlex
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from plough_opt.app import tables
from plough_opt.app.terminal import LOG, check_outputs, console, give, progress, quiet, read, wrote
from plough_opt.core.checks import check_named, plain_number
from plough_opt.core.compiler import cache_folder
from plough_opt.core.errors import InputError, NotConverged, about, printable
from plough_opt.core.files import check_file, drawn, write_new
from plough_opt.core.plain_data import json_text
from plough_opt.core.process import optional
from plough_opt.core.quantities import EVERY, QUANTITIES, quantities
from plough_opt.core.saving import Origin, load
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.core.units import OBJECTIVE_DIGITS, RESULT_DIGITS, Display, Unit
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.formats import FORMATS, Request
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.motion.effect_costs import effect_costs
from plough_opt.motion.run import Machine
from plough_opt.motion.scene import Scene, quantities_of
from plough_opt.motion.vocabulary import called
from plough_opt.problem_file import Problem, template
from plough_opt.problem_file.ranges import with_unit
from plough_opt.problem_file.schema import file_schema
from plough_opt.soil.soil import named_soil, soil_names

if TYPE_CHECKING:
    from plough_opt.design import LocalOptimum
    from plough_opt.design.search.effort import Search
    from plough_opt.problem_file.sweep import What
    from plough_opt.studies.calibration import Fit, Measurements


_DESIGNS: Final = {
    "best": "the best design", "catalogue": "the best design from the catalogue", "guess": "the guesses",
}  # fmt: skip


def init(options: argparse.Namespace) -> None:
    """Write the template to a new file, or print the JSON schema of problem files."""
    if options.schema:
        print(json_text(file_schema()))
        return
    if options.file is None:
        raise InputError("init needs the name of the new file, or --schema")
    path = write_new(options.file, "problem file", template())
    if options.json:
        print(json_text({"wrote": [str(path)]}))
    else:
        console().print(f"wrote {path}; next: plough-opt optimise {shlex.quote(str(path))}", soft_wrap=True)


def soils(options: argparse.Namespace) -> None:
    """List the named soils."""
    check_outputs(options)
    found = [named_soil(name) for name in soil_names()]
    properties = [{**asdict(soil), "cone_index": cone_index(soil)} for soil in found]
    units = {one.key: one.unit for one in QUANTITIES.values() if one.owner == "soil"} | {"cone_index": "Pa"}
    columns = {key: [one[key] for one in properties] for key in properties[0]}
    give(options, tables.soils_page(found), lambda: json_text(properties), None, lambda: data_frame(columns, units))


def check(options: argparse.Namespace) -> None:
    """Check a file, and print the contents of its scene at the guess, and what else the options ask for."""
    problem = read(options)
    values = {key: float(value) for key, value in problem.values().items()}
    scene = problem.scene()
    notes = [*dict.fromkeys((*problem.notes, *problem.cautions, *scene.warnings(), *problem.reliance))]
    laws = tables.drafts_by_law(scene)
    plain: dict[str, Any] = {"title": problem.title, "quantities": values, "laws": laws, "notes": notes}
    page = tables.check_page(problem, laws)
    columns = {"quantity": [*values], "value": [*values.values()], "unit": [EVERY[key].unit for key in values]}
    frame: Callable[[], Any] = partial(data_frame, columns, {})
    if options.effects:
        costs = effect_costs(scene, values.get("scene.duration"))
        page = replace(page, parts=(*page.parts, *tables.effects_parts(costs)))
        plain["effects"] = rows = [asdict(cost) for cost in costs]
        frame = partial(data_frame, {key: [row[key] for row in rows] for key in rows[0]}, {})
    give(options, page, lambda: json_text(plain), lambda: drawn("plot_share", scene), frame)


def simulate(options: argparse.Namespace) -> None:
    """Simulate a file's scene with every variable at its guess."""
    problem = read(options)
    with progress() as notify:
        notify("simulating", 0.0)
        run = problem.simulate()
    page = tables.run_page(problem, run)
    give(options, page, lambda: run.to_json(page), run.plot, run.to_dataframe)


def optimise(options: argparse.Namespace) -> None:
    """Find the best share of a file, or with an uncertain soil the robust and the nominal optimum."""
    problem = read(options)
    if problem.table.uncertain is not None:
        _optimise_robust(problem, options)
        return
    with progress() as notify:
        search = _search_of(options.search)
        best, run = problem.optimise(notify, parameters=options.sensitivity, search=search, seed=options.seed)
        found, unknown = tables.sensitivities_of(best, notify) if options.sensitivity else ((), "")
    if unknown:
        LOG.info("note: no sensitivities: %s", unknown)
    best = replace(best, sensitivities=found)
    page = best.page()
    parts = (*page.parts, *tables.further_results(problem, run))
    if found:
        parts = (*parts, tables.sensitivity_table(problem, found))
    met = dict.fromkeys(name for item in found for name in item.touching)
    notes = (*page.notes, *(f"{name} is just met: the figures apply to increasing values" for name in met))
    page = replace(page, parts=parts, notes=notes)
    give(options, page, lambda: best.to_json(page), best.plot, best.to_dataframe)


def _optimise_robust(problem: Problem, options: argparse.Namespace) -> None:
    if options.sensitivity:
        raise InputError("--sensitivity needs one soil: remove it, or remove the table [uncertain]")
    from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

    with progress() as notify:
        found = optimise_robust(problem, notify)
    give(options, found.page(), found.to_json, found.plot, found.to_dataframe)


def _search_of(text: str) -> Search:
    """Return the search that a text describes: a word, a number of designs, a time, or keys of variables."""
    if text.strip().isdecimal():
        return int(text)
    return tuple(part.strip() for part in text.split(",")) if "," in text else text


def tradeoff(options: argparse.Namespace) -> None:
    """Compute the front of the two or three results that a file trades."""
    problem = read(options)
    with progress() as notify:
        front = problem.trade_off(options.points, notify)
    give(options, front.page(), front.to_json, front.plot, front.to_dataframe, front.to_csv)


def accuracy(options: argparse.Namespace) -> None:
    """Compare error and time of integration methods on a file's scene at its guess, or on its design."""
    problem = read(options)
    from plough_opt.studies.accuracy import study_accuracy, study_design

    with progress() as notify:
        common: dict[str, Any] = {"wanted": options.error, "title": problem.title, "progress": notify}
        if options.design:
            study = study_design(problem.design()[0], limit=10.0 * options.seconds, **common)
        else:
            duration: Any = problem.values().get("scene.duration")
            study = study_accuracy(problem.scene(), duration, allowance=options.seconds, **common)
    nominal = ("the study uses the nominal soil and ignores its uncertainty",) if problem.table.uncertain else ()
    study = replace(study, origin=problem.origin, notes=(*study.notes, *nominal))
    give(options, study.page(), study.to_json, study.plot, study.to_dataframe)


def explore(options: argparse.Namespace) -> None:
    """Write the page of a file, and open it in the browser unless a path is given.

    Raises:
        InputError: the file has a mistake, an uncertain soil, or the page
            cannot be written.
    """
    from plough_opt.app.page import provenance, write_page

    target = _cached(options.file) if options.output is None else check_file(options.output, "page", ".html")
    optional("jinja2")  # before anything is read
    problem = read(options)
    with progress() as notify:
        path = write_page(problem, target, notify, seed=options.seed)
    if options.json:
        print(json_text({"wrote": [str(path)], "provenance": provenance(problem, options.seed)}))
    elif options.output is None:
        webbrowser.open(f"{path.resolve().as_uri()}#explore")
    wrote(path)


def _cached(file: str) -> Path:
    """Return the path of a file's page in the user's cache folder."""
    digest = hashlib.sha256(os.path.realpath(file).encode(errors="surrogateescape")).hexdigest()[:16]
    return cache_folder() / "pages" / f"{Path(file).stem}-{digest}.html"


def sweep(options: argparse.Namespace) -> None:
    """Simulate or optimise a file at every point of a grid or a sample; resume an interrupted sweep."""
    from plough_opt.problem_file.sweep import plan_of  # the engine of sweeps is slow to import

    if options.scheduler is not None and options.workers is not None:
        raise InputError("--workers start on this machine, but --scheduler has its own: remove one of the two")
    if options.scheduler is not None:
        optional("distributed")  # before anything is read
    over = _over(options)
    problem = read(options)
    what: What = "optimise" if options.optimise else "simulate"
    plan = plan_of(problem, over, what, options.method, options.samples, options.seed)
    for note in plan.notes:
        LOG.info("note: %s", note)
    file = options.csv or ""
    if not file.lower().endswith(".csv"):  # so that the same command goes on
        digest = hashlib.sha256(plan.question.encode(errors="surrogatepass")).hexdigest()[:8]
        file = f"{Path(options.file).stem}-{digest}.sweep.csv"
    with _executor(options.scheduler) as (executor, workers):
        swept = plan.run(file=file, executor=executor, workers=workers or options.workers, progress=not quiet())
    give(options, swept.page(), swept.to_json, swept.plot, swept.to_dataframe, swept.to_csv)
    if swept.failed == len(swept):
        raise NotConverged("every point failed; the reasons are in the table", "failed")


def _over(options: argparse.Namespace) -> dict[str, object]:
    """Return quantity -> its values as text."""
    fixed = {text.partition("=")[0].strip() for text in options.set}
    over: dict[str, object] = {}
    for text in options.over:
        name, _, written = (part.strip() for part in text.partition("="))
        if not (name and written):
            raise InputError(f'--over {text}: expected KEY=RANGE, like soil.cohesion="5..45 kPa:9"')
        if name in over:
            raise InputError(f"--over {text}: '{name}' is swept twice: remove one")
        if name in fixed:
            raise InputError(f"--over {text}: '{name}' is also fixed by --set: remove one of the two")
        over[name] = written.strip("\"'")  # quotes that a shell left
    return over


@contextmanager
def _executor(address: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """Yield the executor of a dask scheduler and the number of its workers' threads; None without an address."""
    if address is None:
        yield None, None
        return
    distributed = optional("distributed")
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: no dask scheduler answers at this address ({error})") from None
    with client:
        threads = sum(client.ncores().values())
        if threads == 0:
            raise InputError(f"--scheduler {address}: it has no workers; start some with: dask worker {address}")
        yield client.get_executor(pure=False), threads


def export(options: argparse.Namespace) -> None:
    """Write a file's scene for another tool; write nothing if anything fails."""
    settings = _settings(options)
    problem = read(options)
    values: dict[str, Any] = problem.values()
    bought = any(variable.catalogue is not None for variable in problem.variables.values())
    if options.at == "catalogue" and not bought:
        raise InputError(f"--at catalogue: no variable of {problem.name} has a catalogue or a step: add one")
    best = "catalogue" if bought else "best"
    at = options.at or (best if problem.variables and problem.table.minimise else "guess")
    request = Request(
        path=options.output,
        name=options.name or "share",
        component=partial(_component, problem, options),
        scene=problem.scene(),
        best=None if at == "guess" else partial(_best, problem, bought=at == "catalogue"),
        design=_DESIGNS[at] if problem.variables else "the file",
        steel_density=values["scene.steel_density"],
        duration=values.get("scene.duration"),
        options=settings,
    )
    said, after = FORMATS[options.to].write(request)
    paths = [Path(path) for path in (options.output, options.description) if path is not None]
    if options.json:
        print(json_text({"wrote": [*map(str, paths)], "says": said, "next": after}))
        return
    if said:
        console().print(said, soft_wrap=True)
    for path in paths:
        wrote(path)
    if after:
        console().print(f"next: {after}", soft_wrap=True)


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Return the format's options; raise InputError for other options and for a path that cannot be written."""
    chosen = FORMATS[options.to]
    chosen.check(options.output)
    for name in sorted({name for own in FORMATS.values() for name in own.options} - {*chosen.options}):
        if getattr(options, name):
            others = ", ".join(other for other, own in FORMATS.items() if name in own.options)
            raise InputError(f"--{name} cannot be used with --to {options.to}, only with {others}")
    if options.description is not None:
        check_file(options.description, "description", ".json")
    settings = {name: getattr(options, name) for name in chosen.options}
    for name, unit in {"opening": "rad", "thickness": "m"}.items():
        if settings.get(name) is not None:
            with about(f"--{name}"):
                settings[name] = Unit(unit).parse(settings[name])
    return settings


def _component(problem: Problem, options: argparse.Namespace) -> Component:
    """Return the component of the named inputs and outputs."""
    with progress() as notify:
        notify("building the component", 0.0)
        inputs, outputs = (
            () if names is None else tuple(map(str.strip, names.split(",")))
            for names in (options.inputs, options.outputs)
        )
        return problem.component(inputs, outputs, name=options.name or "share")


def _best(problem: Problem, *, bought: bool) -> Scene:
    """Return the scene of the best design, from the catalogue or not, or of the robust one if the soil is uncertain."""
    with progress() as notify:
        if problem.table.uncertain is not None:
            from plough_opt.problem_file.uncertain import optimise_robust  # scipy.stats is slow to import

            return problem.scene(optimise_robust(problem, notify).best.variables)
        best, run = problem.optimise(notify)
    if not bought:
        return run.scene
    if best.bought is None:
        raise NotConverged(f"{best.warnings[-1]}; --at best exports the best design without it", "catalogue")
    return problem.scene(best.bought.variables)


def show(options: argparse.Namespace) -> None:
    """Print a saved result again, with its origin, or several side by side."""
    check_outputs(options)
    if len(options.file) > 1:
        _compare(options)
        return
    path = Path(options.file[0])
    if path.suffix.lower() == ".csv":
        from plough_opt.studies.sweep.result import Sweep

        if options.problem:
            raise InputError("the file of a sweep does not hold its problem: --json prints a summary")
        swept = Sweep.load(path)
        give(options, swept.page(), swept.to_json, swept.plot, swept.to_dataframe, swept.to_csv)
        return
    saved = load(path)
    origin: Origin = getattr(saved, "origin", Origin())
    if options.problem:
        print(printable(origin.problem()))
        return
    give(options, saved.shown_page(), saved.to_json, saved.plot, saved.to_dataframe)
    for line in () if options.json else origin.lines(saved.made_by):
        console().print(line, soft_wrap=True)


def _compare(options: argparse.Namespace) -> None:
    """Print saved designs or runs side by side: overrides, variables, requirements and results."""
    from plough_opt.design import LocalOptimum

    if options.problem:
        raise InputError("--problem prints the file of one result: name one")
    names = [Path(path).name for path in options.file]
    paths = {path if names.count(name) > 1 else name: path for path, name in zip(options.file, names, strict=True)}
    designs: dict[str, LocalOptimum] = {}
    runs: dict[str, Run | Machine] = {}
    notes = []
    for name, path in paths.items():
        saved = load(path)
        best = getattr(saved, "best", saved)
        run = getattr(best, "run", best)
        designs |= {name: best} if isinstance(best, LocalOptimum) else {}
        runs |= {name: run} if isinstance(run, Run | Machine) else {}
        if not (name in designs or name in runs):
            raise InputError(f"'{name}' contains neither a design nor a run: name results of optimise or simulate")
        if origin := getattr(saved, "origin", None):
            notes.append(f"{name}: {origin.file}, changed by --set: {' '.join(origin.overrides) or 'nothing'}")
    rows: dict[str, dict[str, tuple[float, Display]]] = {}  # quantity -> result -> value and its unit
    for name in paths:
        for key, value, display in _numbers(designs.get(name), runs.get(name)):
            rows.setdefault(key, {})[name] = value, display
    plain = {name: {key: row[name][0] for key, row in rows.items() if name in row} for name in paths}
    columns = {name: [own.get(key) for key in rows] for name, own in plain.items()}
    parts = {f"{name} {share}".rstrip(): part for name, run in runs.items() for share, part in _shares(run).items()}
    page = Page(f"{len(paths)} results side by side", (_side_by_side(rows, [*paths], designs), *notes))
    plot = partial(drawn, "plot_designs", designs) if designs else partial(drawn, "plot_runs", parts)
    give(options, page, lambda: json_text(plain), plot, lambda: data_frame({"quantity": [*rows], **columns}, {}))


def _shares(run: Run | Machine | None) -> Mapping[str, Run]:
    """Return share -> run, with "" for an unnamed share."""
    return run.runs if isinstance(run, Machine) else {} if run is None else {"": run}


# Results set side by side, by their unit.
_SIDE_BY_SIDE: Final = {
    "mean_draft": "N", "force_rms": "N", "peak_force": "N", "tow_power": "W",
    "mean_deflection": "m", "displacement_rms": "m", "peak_deflection": "m",
}  # fmt: skip


def _numbers(design: LocalOptimum | None, run: Run | Machine | None) -> Iterator[tuple[str, float, Display]]:
    """Yield name, value in SI and unit of quantities, objective, variables, requirements and results."""
    shares = {f"{share}." if share else "": part for share, part in _shares(run).items()}
    for before, part in shares.items():
        for name, value in quantities_of(part.scene).items():
            if value is not None:
                yield before + name, float(value), part.origin.display(name, EVERY[name].unit, float(value))
    if design is not None:
        yield "objective", design.objective, Display("", 1.0)
        yield from ((limit.name, limit.value, limit.shown) for limit in design.limits)
    for before, part in shares.items():
        for name, unit in _SIDE_BY_SIDE.items():
            alike = {other: float(getattr(part, other)) for other, its in _SIDE_BY_SIDE.items() if its == unit}
            yield before + name, alike[name], part.origin.common(unit, alike)


def _side_by_side(
    rows: Mapping[str, Mapping[str, tuple[float, Display]]], names: list[str], designs: Mapping[str, LocalOptimum]
) -> Grid:
    """Return a row for the objective, each limit, and what else differs; a row has the unit of the first result."""
    grid = Grid.of("", "", *names, "difference" if len(names) == 2 else "largest difference")
    designed = {"objective", *(limit.name for design in designs.values() for limit in design.limits)}
    for key, row in rows.items():
        values = [value for value, _ in row.values()]
        if len(values) == len(names) and len({*values}) == 1 and key not in designed:
            continue
        display = next(iter(row.values()))[1]
        digits = OBJECTIVE_DIGITS if key == "objective" else RESULT_DIGITS
        texts = {name: display.text(value, digits) for name, (value, _) in row.items()}
        texts |= {name: f"{texts[name]} *" for name, design in designs.items() if key in design.active}
        change = values[-1] - values[0] if len(names) == 2 else max(values) - min(values)
        if abs(change) <= 1e-9 * max(map(abs, values)):
            difference = "0 %" if len(values) > 1 else ""
        else:
            difference = f"{100.0 * change / abs(values[0]):+.3g} %" if values[0] else display.text(change, 3)
        grid.row(called(key), *(texts.get(name, "") for name in names), difference)
    grid.caption = "* this limit decides the design" if any("*" in cell for row in grid.rows for cell in row) else ""
    return grid


# --- measurements: unknown quantities ---


def calibrate(options: argparse.Namespace) -> None:
    """Estimate a file's unknowns from measurements, and report which of them the data determine."""
    problem = read(options)
    from plough_opt.studies.calibration import calibrate as run
    from plough_opt.studies.calibration import read_measurements

    plain_number("level", options.level, above=0.0, below=1.0, why="0.95 is usual")
    if options.hold_out_by is not None and options.hold_out is None:
        raise InputError("--hold-out-by belongs to --hold-out: add a part of the rows, such as --hold-out 1/3")
    files: dict[Path, Measurements] = {}  # so that a file given twice is the same object, which `run` refuses
    data = [files.setdefault(Path(path).resolve(), read_measurements(path)) for path in options.data]
    unknown = _unknowns(options.unknown)
    if unknown is None and not problem.variables:
        raise InputError(f'{problem.name}: add a table [variables], or --unknown soil.cohesion="1..80 kPa"')
    free = {*(unknown or problem.variables), *(key for measured in data for key in measured.conditions)}
    if left := [key for key in problem.variables if key not in free]:
        LOG.info("note: variables of the file fixed at their guesses: %s", ", ".join(left))
    data += map(_known, options.known)
    with progress() as notify:
        notify("calibrating", 0.0)
        fit = run(problem, data, unknown, loss=options.loss, errors=options.errors)
        fit = replace(fit, origin=fit.origin.with_data(options.data), level=options.level)
        notify("intervals", 0.5)
        page, text, plot = fit.page(), fit.to_json(), fit.plot
        if options.hold_out is not None:
            held = _held_out(fit, options)
            page, plot = replace(page, parts=(*page.parts, held.words())), held.plot
            text = json_text(json.loads(text) | {"held_out": json.loads(held.to_json())})
    give(options, page, lambda: text, plot, fit.to_dataframe)


def _held_out(fit: Fit, options: argparse.Namespace) -> Fit:
    """Return the fit without the rows that the options hold out, which it predicts."""
    written = options.hold_out.strip()
    try:
        part = float(Fraction(written.removesuffix("%").strip())) / (100.0 if written.endswith("%") else 1.0)
    except (ValueError, ZeroDivisionError):
        raise InputError(f"--hold-out {written}: expected a part of the rows, like 1/3, 0.3 or 30 %") from None
    return fit.hold_out(part, by=options.hold_out_by, seed=options.seed, level=options.level)


def _unknowns(written: list[str]) -> dict[str, tuple[str, str]] | None:
    """Return key -> (lower, upper) as the command line gives them, or None."""
    bounds: dict[str, tuple[str, str]] = {}
    for text in written:
        key, *ends = _split("--unknown", text, ("..",), 'soil.cohesion="1..80 kPa"')
        if key in bounds:
            raise InputError(f"--unknown {text}: '{key}' is given twice: remove one")
        bounds[key] = ends[0], ends[1]
    return bounds or None


def _known(text: str) -> Measurements:
    """Return a separate measurement of an unknown as measurements of one row."""
    from plough_opt.studies.calibration import Measurements

    key, *written = _split("--known", text, ("+-", "±"), 'soil.friction_angle="28 +- 1 deg"')
    unit = quantities()[key]
    with about(f"--known {text}: '{key}'"):
        value, sigma = map(unit.parse, written)
    return Measurements(key, [value], sigma=sigma, name=f"--known {key}")


def _split(option: str, text: str, marks: Sequence[str], example: str) -> tuple[str, str, str]:
    """Return a key and the two quantities around a mark; the first takes the unit of the second if it has none."""
    key, _, written = (part.strip() for part in text.partition("="))
    mark = next((mark for mark in marks if mark in written), marks[0])
    first, _, second = (part.strip() for part in written.strip("\"'").partition(mark))
    if not (first and second):
        raise InputError(f"{option} {text}: expected KEY=..., like {example}")
    check_named(f"{option} {text}: {{}} cannot be an unknown", key, quantities())
    return key, with_unit(first, second), second
