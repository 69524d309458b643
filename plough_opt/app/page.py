"""`plough-opt explore`: one HTML page that loads nothing else: a report on the best share, and any other design.

The report shows the tables that commands print, in words and with units of the file. What the page computes itself is
in `page_model`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from plough_opt.app.page_model import PageModel, design_model, page_model, shown_in, without_random
from plough_opt.app.panels import Panel, changing, deflection_of, force_of
from plough_opt.app.tables import scene_table, sensitivities_of, sensitivity_table
from plough_opt.core.checks import path_of, whole_number
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number
from plough_opt.core.files import COLOURS, check_file, text_of, write_file
from plough_opt.core.process import optional
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES
from plough_opt.core.saving import versions
from plough_opt.core.tables import Grid, Part
from plough_opt.core.units import Display
from plough_opt.design import Design, Optimum, Progress, Sensitivity
from plough_opt.motion import Run
from plough_opt.motion.run import ARRAYS
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.problem_file import Problem, read_problem
from plough_opt.problem_file.written import problem_of, tables_of

if TYPE_CHECKING:
    from plough_opt.studies.tradeoff import TradeOff


def explore(
    question: Problem | str | Path | Scene | Design,
    path: str | Path,
    *,
    duration: float | str | None = None,
    seed: int = 0,
) -> Path:
    """Write the page of a question: its report, and controls that compute any other design in the browser.

    Args:
        question: a problem, the path of its file, a numeric scene, or a design, which is solved. The page of a design
            has its variables, parameters, objective and requirements, but not the motions behind them.
        path: path of the page, ending in .html; an existing file is replaced.
        duration: simulated time of a scene [s], or a text such as "2 s"; omit it for a periodic orbit and for a
            problem, which has its own.
        seed: seed of the search's samples.

    Returns:
        The path.

    Raises:
        InputError: the file has a mistake or an uncertain soil, the scene holds symbols or something that cannot be
            written as a problem file, the duration is missing or given for another question, the design has no
            JavaScript form, or the page cannot be written.
        InfeasibleDesign, NotConverged: as `Design.solve`.

    Example:
        >>> import plough_opt as po
        >>> po.explore("problems/cotton_subsoiler.toml", "out/cotton.html")  # doctest: +SKIP
    """
    optional("jinja2")
    target = check_file(path_of("the page", path), "page", ".html")
    whole_number("seed", seed)
    if duration is not None and not isinstance(question, Scene):
        raise InputError("only a scene needs a duration: leave it out, or change the problem or design")
    if isinstance(question, Design):
        return write_file(target, "page", _design_page(question, seed))
    if isinstance(question, Scene):
        time = None if duration is None else float(as_number(BESIDE["scene.duration"].read(duration)))
        question = problem_of(question, time, "A scene of Python")
    elif not isinstance(question, Problem):
        question = read_problem(question)
    return write_page(question, target, lambda *_: None, seed=seed)


def write_page(problem: Problem, path: Path, notify: Progress, *, seed: int) -> Path:
    """Write the page of a problem; return its path. ``notify`` is told the present step and the fraction done."""
    if problem.table.uncertain is not None:
        raise InputError(
            f"{problem.name}: a report covers one soil: remove the table [uncertain], or use plough-opt optimise"
        )
    if problem.variables and not (problem.table.minimise or problem.table.trade_off):
        raise InputError(f"{problem.name}: nothing to look for: add a table [minimise] or [trade_off]")
    return write_file(
        path, "page", page(replace(reported(problem, notify, seed), provenance=provenance(problem, seed)))
    )


def provenance(problem: Problem, seed: int) -> dict[str, str]:
    """Return heading -> text of everything that identifies how a report was made."""
    changes = {"changed by --set": "; ".join(problem.overrides)} if problem.overrides else {}
    return {
        "file": problem.origin.file,
        "SHA-256 of the file": problem.origin.sha256,
        **changes,
        "seed of the search": str(seed),
        "written": datetime.now().astimezone().isoformat(sep=" ", timespec="minutes"),
        "made by": ", ".join(f"{name} {value}" for name, value in versions().items()),
    }


@dataclass(frozen=True)
class Report:
    """Contents of a report.

    Attributes:
        problem: the file.
        run: run of the best design, or of the file's scene if it has no variables.
        best: the optimum, if the file has variables.
        sensitivities: sensitivities of the optimum, the largest first.
        unknown: reason why there are no sensitivities, or "".
        provenance: heading -> text of everything that identifies how the report was made.
        front: front of the traded results, if the file trades some.
    """

    problem: Problem
    run: Run
    best: Optimum | None = None
    sensitivities: tuple[Sensitivity, ...] = ()
    unknown: str = ""
    provenance: dict[str, str] = field(default_factory=dict)
    front: TradeOff | None = None

    def display(self, key: str, unit: str, *values: float) -> Display:
        """Return the unit in which the file writes a quantity or result, or a customary one for these SI values."""
        return self.problem.origin.display(key, unit, *values)

    @property
    def shown(self) -> tuple[str, Mapping[str, float]]:
        """Name and variables of the design that the page shows: best, knee or middle of the front, or the file's."""
        if self.best is not None:
            return "best", self.best.variables
        return ("file", {}) if self.front is None else shown_of(self.front)


def shown_of(front: TradeOff) -> tuple[str, Mapping[str, float]]:
    """Return name and variables of the point of a front that the page shows: its knee, or one in the middle."""
    knee = front.knee
    return ("middle", front.points[len(front.points) // 2].variables) if knee is None else ("knee", knee.variables)


def reported(problem: Problem, notify: Progress, seed: int = 0) -> Report:
    """Return the contents of a report, without its provenance.

    Args:
        problem: the file.
        notify: called with the present step in words and the fraction done.
        seed: seed of the search's samples.
    """
    front = problem.trade_off(progress=notify) if problem.variables and problem.table.trade_off else None
    if problem.variables and problem.table.minimise:
        best, run = problem.optimise(notify, parameters=True, seed=seed)
        return Report(problem, run, best, *sensitivities_of(best, notify), front=front)
    notify("simulating", 0.0)
    return Report(problem, problem.simulate(None if front is None else shown_of(front)[1]), front=front)


def page(report: Report) -> str:
    """Return a report as HTML.

    All texts of the file and of the results are escaped. The page's content security policy forbids all requests.

    Raises:
        InputError: jinja2 is not installed.
    """
    model, why = None, ""
    try:
        model = page_model(report.problem)
    except InputError as refusal:
        why = str(refusal)
    charts = [_chart(report.run, panel) for panel in changing(report.run)]
    shown = {"charts": charts, "front": _front(report), "motion": motion(report.run)}
    sections = {name: [*map(_in_words, parts)] for name, parts in _sections(report).items()}
    data = shown | {"model": model and _explored(report, model)}
    return rendered("page.html", report=report, sections=sections, data=data, model=model, why=why)


def _sections(report: Report) -> dict[str, Sequence[Part]]:
    """Return the tables and sentences of each section of the report."""
    best, front = report.best, report.front
    response = replace(report.run.response(), title="Averages over the run, and peaks")
    scene = scene_table(report.problem, report.run.scene, report.problem.fixed, "Fixed in the scene")
    sections: dict[str, Sequence[Part]] = {
        "warnings": _notes(report), "traded": [] if front is None else front.page().parts,
        "response": [response], "soil": [_soil(report), scene],
    }  # fmt: skip
    if best is None:
        return sections | dict.fromkeys(("design", "sensitivities"), ())
    grid = sensitivity_table(report.problem, report.sensitivities)
    unknown = f"Not available: {report.unknown or 'no quantity changes the objective'}."
    return sections | {
        "design": replace(best, run=None).page().parts, "sensitivities": [grid if grid.rows else unknown],
    }  # fmt: skip


def _in_words(part: Part) -> Part:
    """Return a table or a sentence with words in place of keys, and quantities for display."""
    if isinstance(part, str):
        for key in sorted(EVERY, key=len, reverse=True):
            part = part.replace(key, EVERY[key].called)
        return part
    columns = tuple(replace(column, heading=called(column.heading)) for column in part.columns)
    rows = [(called(name), *map(nice, cells)) for name, *cells in part.rows]
    return replace(part, columns=columns, rows=rows)


def nice(text: str) -> str:
    """Return a quantity for display: superscript powers, ° for degrees, no line break between number and unit."""
    text = re.sub(r"\^([23])", lambda power: "²³"["23".index(power[1])], text)
    return re.sub(r" deg\b", "°", text).replace("*", "·").replace(" ", "\u00a0")


def _notes(report: Report) -> list[str]:
    """Return all warnings as sentences."""
    notes = [*(report.run.warnings if report.best is None else report.best.page().notes)]
    met = dict.fromkeys(name for item in report.sensitivities for name in item.touching)
    notes += [f"{called(name)} is just met: sensitivities apply to increasing values" for name in met]
    return [f"{text[:1].upper()}{text[1:]}." for text in notes]


def _soil(report: Report) -> Grid:
    """Return a table of the properties of the soil."""
    soil, rows = report.run.scene.soil, []
    for name, quantity in QUANTITIES.items():
        value = getattr(soil, quantity.key, None) if quantity.owner == "soil" else None
        if value is not None:
            text = report.display(name, quantity.unit, float(value)).text(float(value), 5)
            rows.append((quantity.meaning, nice(text)))
    return Grid.pairs(soil.name, *rows)


# --- data of the pictures and controls -------------------------------------------------------------------------

_BLUE, _RED, _GREEN, _PURPLE = COLOURS[:4]
# Significant digits of the data: more than a screen resolves.
_DIGITS: Final = 6


def _chart(run: Run, panel: Panel) -> dict[str, Any]:
    """Return the chart of a panel over time."""
    unit = panel.unit
    extremes = [
        f"{label} from {unit.text(float(np.min(values)), 3)} to {unit.text(float(np.max(values)), 3)}"
        for label, (values, _, _) in panel.lines.items()
    ]
    lines = [(f"limit of {words}", end, _RED, "") for words, end in panel.limits]
    band: tuple[float, ...] = ()
    if panel.mean is not None:
        name, mean, rms = panel.mean
        lines.insert(0, (f"{name} ± RMS", mean, "#000000", "dash"))
        band = mean - rms, mean + rms
    return {
        "id": panel.name,
        "title": panel.name.capitalize(),
        "says": f"{panel.name.capitalize()} over {run.duration:.3g} s: {'; '.join(extremes)}.",
        "x": {"label": "time", "unit": "s", "values": _short(run.time)},
        "y": {"label": panel.name, "unit": _unit(unit)},
        "series": [
            {"label": label, "colour": colour, "dash": "dash" * dashed, "values": _short(values / unit.factor)}
            for label, (values, colour, dashed) in panel.lines.items()
        ],
        "band": [end / unit.factor for end in band],
        "lines": [
            {"label": label, "value": value / unit.factor, "colour": colour, "dash": dash}
            for label, value, colour, dash in lines
        ],
    }


def _group(label: str, colour: str, size: int, x: Iterable[float], y: Iterable[float]) -> dict[str, Any]:
    return {"label": label, "colour": colour, "size": size, "x": _short(x), "y": _short(y)}


def motion(run: Run) -> dict[str, Any]:
    """Return the motion of strut and share over time; empty if nothing changes."""
    scene = run.scene
    if not changing(run):
        return {}
    path = np.asarray(run.travel) + np.asarray(run.deflection)
    of_wave = ("amplitude", "wavelength", "phase")
    waves = [{name: float(getattr(wave, name)) for name in of_wave} for wave in scene.effects.waves]
    length = run.origin.common("m", {"deflection": run.peak_deflection})
    return {
        "time": _short(run.time),
        "strut": _short(path),
        "deflection": _short(run.deflection),
        "force": _short(np.asarray(run.mount_force)),
        "waves": waves,
        "height": float(scene.cone.height),
        "radius": float(scene.cone.height * scene.cone.slope),
        "front": 0.0 if scene.law.lacks("loosened_radius") else float(scene.loosened_radius),
        "unit": {"symbol": _unit(length), "factor": length.factor},
    }


def _front(report: Report) -> list[dict[str, Any]]:
    """Return a chart of a front of two results."""
    front = report.front
    if front is None or len(front.goals) != 2:
        return []
    axes, columns = [], []
    for goal, values in zip(front.goals, front.objectives.T, strict=True):
        unit = report.display(goal.name, goal.unit, *values)
        axes.append({"label": called(goal.name), "unit": _unit(unit)})
        columns.append(values / unit.factor)
    groups = [_group("efficient", _BLUE, 7, *columns)]
    if front.knee is not None:
        place = front.points.index(front.knee)
        groups.append(_group("knee", _RED, 12, *([values[place]] for values in columns)))
    says = f"{axes[1]['label']} over {axes[0]['label']} of {len(front.points)} efficient designs."
    return [{"id": "front", "title": "Front", "says": says, "x": axes[0], "y": axes[1], "groups": groups}]


def _explored(report: Report, model: PageModel) -> dict[str, Any]:
    """Return what the page's controls must know: its model, the best design, the file, and units over time."""
    problem, best, front = report.problem, report.best, report.front
    name, variables = report.shown
    panels = {panel.name: {"label": panel.name, "rows": [next(iter(panel.lines)).replace(" ", "_")],
                           **shown_in(panel.unit)}
              for panel in (force_of(report.run), deflection_of(report.run))}  # fmt: skip
    results = [
        one | shown_in(report.display(one["name"], one["unit"], float(MEASURES[one["name"]].of(report.run))))
        if one["name"] in MEASURES else one for one in model.data["results"]
    ]  # fmt: skip
    return {
        **model.data,
        "results": results,
        "best": variables,
        "known": name,
        "marks": [
            _marks("other optima", _GREEN, best.local_optima[1:] if best else ()),
            _marks("front", _PURPLE, front.points if front else ()),
        ],
        "axes": [goal.name for goal in front.goals][:2] if front and not best else [],
        "objective": bool(problem.table.minimise),
        "command": "optimise" if best else "tradeoff" if front else "simulate",
        "certifies": name != "file",
        "orbit": problem.scene().effects.orbit != "transient",
        "panels": panels,
        "without": without_random(problem),
        "units": ARRAYS,
        "file": problem.origin.file,
        "overrides": problem.overrides,
        "tables": tables_of(problem),
    }


def _marks(label: str, colour: str, designs: Iterable[Any]) -> dict[str, Any]:
    """Return designs that Python computed, for the page's landscape."""
    return {"label": label, "colour": colour, "designs": [dict(design.variables) for design in designs]}


def _design_page(design: Design, seed: int) -> str:
    """Return the page of a design as HTML."""
    best, model = design.solve(seed=seed), design_model(design)
    optima = [_marks("other optima", _GREEN, best.local_optima[1:])]
    more = {"marks": optima, "best": best.variables, "error": max(best.gap, best.error_estimate)}
    data = {"charts": [], "front": [], "model": model.data | more}
    made = f"plough_opt {versions()['plough_opt']}, seed {seed}"
    return rendered("design.html", title="A design of Python", best=best, made=made, data=data, model=model)


def rendered(name: str, **values: Any) -> str:
    """Return a template of the folder `assets` as HTML; InputError without jinja2."""
    jinja = optional("jinja2")
    around = jinja.Environment(autoescape=True, loader=jinja.FunctionLoader(asset), undefined=jinja.StrictUndefined,
                               trim_blocks=True, lstrip_blocks=True)  # fmt: skip
    around.filters |= {"called": called, "nice": nice}
    text: str = around.get_template(name).render(asset=asset, **values)
    return text


def asset(name: str) -> str:
    """Return the text of one of the files that make up the page."""
    return text_of("plough_opt.app", f"assets/{name}")


def _unit(display: Display) -> str:
    """Return the symbol of a unit for an axis."""
    return nice(f" {display.symbol}").strip("\u00a0")


def _short(values: Iterable[float]) -> list[float]:
    """Return numbers rounded to the digits that a picture can show."""
    return [float(f"{value:.{_DIGITS}g}") for value in np.asarray(values, dtype=float).ravel()]
