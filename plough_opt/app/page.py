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
from plough_opt.core.errors import InputError, listed
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
from plough_opt.soil.geometry import Wedge

if TYPE_CHECKING:
    from plough_opt.studies.tradeoff import TradeOff
    from plough_opt.studies.tradeoff.front import FrontPoint


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
    if isinstance(question, Scene):
        time = None if duration is None else float(as_number(BESIDE["scene.duration"].read(duration)))
        known = problem_of(question, time, "A scene of Python")
    elif duration is not None:
        raise InputError("only a scene needs a duration: leave it out, or change the problem or design")
    elif isinstance(question, Design):
        made = f"plough_opt {versions()['plough_opt']}, seed {seed}"
        text = _design_page(question.solve(seed=seed), design_model(question), "A design of Python", made)
        return write_file(target, "page", text)
    else:
        known = question if isinstance(question, Problem) else read_problem(question)
    return write_page(known, target, lambda *_: None, seed=seed)


def write_page(problem: Problem, path: Path, notify: Progress, *, seed: int) -> Path:
    """Write the page of a problem; return its path. ``notify`` is told the present step and the fraction done."""
    if problem.table.uncertain is not None:
        raise InputError(
            f"{problem.name}: a report covers one soil: remove the table [uncertain], or use plough-opt optimise"
        )
    if problem.variables and not (problem.table.minimise or problem.table.trade_off):
        raise InputError(f"{problem.name}: nothing to look for: add a table [minimise] or [trade_off]")
    text = page(replace(reported(problem, notify, seed), provenance=provenance(problem, seed)))
    return write_file(path, "page", text)


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

    def shown(self, key: str, value: float, unit: str, digits: int = 4) -> str:
        """Return an SI value as text in the unit of `display`."""
        return nice(self.display(key, unit, value).text(value, digits))


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
    return Report(problem, problem.simulate(None if front is None else _shown(front).variables), front=front)


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
        "question": _question(report), "answer": [_answer(report)], "warnings": _notes(report),
        "traded": [] if front is None else front.page().parts, "response": [response], "share": [_dimensions(report)],
        "accuracy": [_accuracy(report)], "soil": [_soil(report), scene],
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


def _answer(report: Report) -> str:
    """Return the answer as one sentence."""
    best, problem = report.best, report.problem
    if best is None and report.front is not None:
        ends = [f"{called(goal.name)} from {_goal(report, k, 0)} to {_goal(report, k, -1)}"
                for k, goal in enumerate(report.front.goals)]  # fmt: skip
        shown = f"the {_place(report.front)} of the front"
        return f"{len(report.front.points)} efficient designs: {listed(ends)}. Shown below: {shown}."
    if best is None:
        draft = next(cells[1] for cells in report.run.response().rows if cells[0] == "mean draft")
        return f"This share needs a mean draft of {nice(draft)}."
    values = [f"{called(key)} {nice(v.display.text(best.variables[key], 4))}" for key, v in problem.variables.items()]
    state = {"solved": "Best design", "not unique": "A best design (not unique)"}
    found = f"{state.get(best.status, 'Best design found (not confirmed by derivatives)')}: {', '.join(values)}."
    if best.bought is None:
        return found
    chosen = best.bought.variables
    made = (f"{called(key)} {nice(v.display.result(chosen[key]))}" for key, v in problem.variables.items())
    return f"{found} From the catalogue: {', '.join(made)} (objective {best.bought.cost_in_words})."


def _question(report: Report) -> list[str]:
    """Return the design question, one text for each paragraph."""
    problem, table = report.problem, report.problem.table
    if report.best is None and report.front is not None:
        goals = [f"{'more' if goal.maximise else 'less'} {called(goal.name)}" for goal in report.front.goals]
        text = [f"Choose {listed([called(key) for key in problem.variables])} for {listed(goals)}."]
    elif report.best is None:
        return ["What draft does this share need, and how does it move? The file has no variables."]
    else:
        terms = [f"{called(name)} in units of {nice(str(term.per))}" for name, term in table.minimise.items()]
        text = [f"Choose {listed([called(key) for key in problem.variables])} to minimise {' plus '.join(terms)}."]
    limits = [f"{called(name)} {nice(limit.words)}" for name, limit in table.require.items()]
    if limits:
        text.append(f"Required: {listed(limits)}.")
    return text


def _notes(report: Report) -> list[str]:
    """Return all warnings as sentences."""
    notes = [*(report.run.warnings if report.best is None else report.best.page().notes)]
    met = dict.fromkeys(name for item in report.sensitivities for name in item.touching)
    notes += [f"{called(name)} is just met: sensitivities apply to increasing values" for name in met]
    return [f"{text[:1].upper()}{text[1:]}." for text in notes]


def _shown(front: TradeOff) -> FrontPoint:
    """Return the point of a front that the page shows: its knee, or one in the middle."""
    return front.knee or front.points[len(front.points) // 2]


def _place(front: TradeOff) -> str:
    return "middle" if front.knee is None else "knee"


def _goal(report: Report, goal: int, point: int) -> str:
    """Return the value of a traded result at a point of the front."""
    assert report.front is not None  # the page asks only then
    axis = report.front.goals[goal]
    return report.shown(axis.name, float(report.front.objectives[point, goal]), axis.unit)


def _dimensions(report: Report) -> Grid:
    """Return a table of the dimensions of the share and of its cone."""
    body, cone = report.run.scene.share, report.run.scene.cone
    assert isinstance(body, Wedge)  # as of every problem file
    length = report.display("share.height", "m", float(cone.height))
    angle = report.display("share.wedge_angle", "rad")
    rows = [
        ("wedge angle", angle.text(float(body.angle), 4)),
        ("chisel angle", angle.text(float(body.chisel_angle), 4)),
        ("area of the two faces", f"{1e4 * body.area:.4g} cm^2"),
        ("angle between the faces, as drawn", angle.text(body.opening, 4)),
        ("height", length.text(float(cone.height), 4)),
        ("base radius of the cone", length.text(float(cone.height * cone.slope), 4)),
    ]
    return Grid.pairs("Dimensions", *((name, nice(value)) for name, value in rows))


def _soil(report: Report) -> Grid:
    """Return a table of the properties of the soil."""
    soil, rows = report.run.scene.soil, []
    for name, quantity in QUANTITIES.items():
        value = getattr(soil, quantity.key, None) if quantity.owner == "soil" else None
        if value is not None:
            rows.append((quantity.meaning, report.shown(name, float(value), quantity.unit, 5)))
    return Grid.pairs(soil.name, *rows)


def _accuracy(report: Report) -> Grid:
    """Return a table of error estimates and computing times."""
    run, best = report.run, report.best
    rows = [
        ("integration", f"{run.accuracy.method}, {len(run.time) - 1} intervals over {run.duration:g} s"),
        ("estimated relative error of every result", f"{run.error_estimate:.0e}"),
        ("time of the run and its check", f"{run.seconds:.2g} s"),
    ]
    if best is not None:
        rows += [
            ("difference of the objective between two accurate integrations", f"{best.error_estimate:.0e}, relative"),
            ("difference between this objective and the optimiser's own", f"{best.gap:.0e}, relative"),
            ("time of the search and the solve", f"{best.seconds:.2g} s"),
        ]
    return Grid.pairs("Errors and computing times", *rows)


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
    found = report.front
    if found is None or len(found.goals) != 2:
        return []
    axes = [report.display(goal.name, goal.unit, *found.objectives[:, k]) for k, goal in enumerate(found.goals)]
    columns = [found.objectives[:, k] / axis.factor for k, axis in enumerate(axes)]
    x, y = ({"label": called(goal.name), "unit": _unit(axis)} for goal, axis in zip(found.goals, axes, strict=True))
    groups = [_group("efficient", _BLUE, 7, *columns)]
    if found.knee is not None:
        place = found.points.index(found.knee)
        groups.append(_group("knee", _RED, 12, *([one[place]] for one in columns)))
    says = f"{y['label']} over {x['label']} of {len(found.points)} efficient designs."
    return [{"id": "front", "title": "Front", "says": says, "x": x, "y": y, "groups": groups}]


def _explored(report: Report, model: PageModel) -> dict[str, Any]:
    """Return what the page's controls must know: its model, the best design, the file, and units over time."""
    problem, best, knee = report.problem, report.best, report.front and _shown(report.front)
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
        "best": best.variables if best else knee.variables if knee else {},
        "known": "best" if best else _place(report.front) if report.front else "file",
        "marks": [
            _marks("other optima", _GREEN, [one.variables for one in (best.local_optima[1:] if best else ())]),
            _marks("front", _PURPLE, [one.variables for one in (report.front.points if report.front else ())]),
        ],
        "axes": [goal.name for goal in report.front.goals][:2] if report.front and not best else [],
        "objective": bool(problem.table.minimise),
        "command": "optimise" if best else "tradeoff" if knee else "simulate",
        "certifies": bool(best or knee),
        "orbit": problem.scene().effects.orbit != "transient",
        "panels": panels,
        "without": without_random(problem),
        "units": ARRAYS,
        "file": problem.origin.file,
        "overrides": problem.overrides,
        "tables": tables_of(problem),
    }


def _marks(label: str, colour: str, designs: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Return designs that Python computed, for the page's landscape."""
    return {"label": label, "colour": colour, "designs": [dict(one) for one in designs]}


def _design_page(best: Optimum, model: PageModel, title: str, made: str) -> str:
    """Return the page of a design as HTML; ``made`` identifies how it was made."""
    optima = [_marks("other optima", _GREEN, [one.variables for one in best.local_optima[1:]])]
    known = {"marks": optima, "best": best.variables, "error": max(best.gap, best.error_estimate)}
    shown = {"charts": [], "front": [], "model": model.data | known}
    return rendered(
        "design.html",
        title=title,
        best=best,
        made=made,
        data=shown,
        model=model,
    )


def rendered(name: str, **values: Any) -> str:
    """Return a template of the folder `assets` as HTML; InputError without jinja2."""
    jinja = optional("jinja2")
    around = jinja.Environment(autoescape=True, loader=jinja.FunctionLoader(asset), undefined=jinja.StrictUndefined,
                               trim_blocks=True, lstrip_blocks=True)  # fmt: skip
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
