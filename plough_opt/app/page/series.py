"""Data of a report's pictures: charts, the share in three dimensions, the motion."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from plough_opt.app.page.content import Report, nice
from plough_opt.app.run_picture import Panel, changing
from plough_opt.core.files import COLOURS
from plough_opt.core.units import Display
from plough_opt.design.landscape import FEASIBLE
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import called
from plough_opt.soil.solid import Solid
from plough_opt.studies.accuracy.result import Entry, Question

_BLUE, _RED, _GREEN, _, _ORANGE, _SKY, _GREY = COLOURS
# Sides of the polygon that represents a cone's base: a circle at the resolution of a screen.
_SIDES: Final = 96
# Significant digits of the data: more than a screen resolves.
_DIGITS: Final = 6
# Designs of the search that are drawn: more would hide each other.
_MOST_DESIGNS: Final = 1500


def charts(report: Report) -> list[dict[str, Any]]:
    """Return the charts of force, deflection and speed over time, except those that are constant."""
    return [_chart(report.run, panel) for panel in changing(report.run)]


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
        "title": _sentence(panel.name),
        "says": f"{_sentence(panel.name)} over {run.duration:.3g} s: {'; '.join(extremes)}.",
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


def search(report: Report) -> list[dict[str, Any]]:
    """Return a chart for each variable: the objective of the designs of the search, with the local optima."""
    best = report.best
    if best is None or best.search is None or not len(best.search.objective):
        return []
    found = best.search
    # Omit designs far above the optima, so that these can be told apart, and infeasible ones far below them.
    feasible = found.objective[found.violation <= FEASIBLE]
    median = np.quantile(feasible, [0.5]) if len(feasible) else [0.0]
    high = max(*(one.objective for one in best.local_optima), *median)
    low = best.objective - 0.25 * (high - best.objective)
    shown = (found.objective <= high) & (found.objective >= low)
    step = max(1, int(np.sum(shown)) // _MOST_DESIGNS)
    rows = np.flatnonzero(shown)[::step]
    meets = found.violation[rows] <= FEASIBLE
    charts = []
    for number, (key, variable) in enumerate(report.problem.variables.items()):
        values = found.values[rows, number] / variable.display.factor
        optima = best.local_optima
        charts.append({
            "id": f"search{number}",
            "title": _sentence(called(key)),
            "says": f"Objective of {len(rows)} of the {found.designs} designs tried, over the {called(key)};"
                    f" the best lies at {variable.display.text(best.variables[key], 4)}.",
            "x": {"label": called(key), "unit": _unit(variable.display), "log": variable.log},
            "y": {"label": "objective", "unit": ""},
            "groups": _drawn(
                _group("fails a requirement", "#b5bcc2", 3, values[~meets], found.objective[rows][~meets]),
                _group("meets all requirements", _SKY, 4, values[meets], found.objective[rows][meets]),
                _group("other local optima", _RED, 9, [one.variables[key] / variable.display.factor
                                                       for one in optima[1:]], [one.objective for one in optima[1:]]),
                _group("best", "#000000", 11, [best.variables[key] / variable.display.factor], [best.objective]),
            ),
        })  # fmt: skip
    return charts


def study(report: Report) -> list[dict[str, Any]]:
    """Return a chart for each question of the accuracy study: error over time of every method."""
    if report.study is None:
        return []
    found = []
    for number, question in enumerate(report.study.questions):
        entries, front = report.study.of(question), report.study.front(question)
        rest = [entry for entry in entries if entry not in front]
        default = [entry for entry in entries if (entry.method, entry.setting) == question.default]
        found.append({
            "id": f"accuracy{number}",
            "title": _sentence(question.title),
            "says": _sentence(report.study.advise(question)),
            "x": {"label": "time of one use", "unit": "ms", "log": True},
            "y": {"label": "relative error", "unit": "", "log": True},
            "groups": _drawn(
                _methods("worse in both", _GREY, 6, rest, question),
                _methods("efficient", _BLUE, 8, front, question),
                _methods("the default", "#000000", 13, default, question),
            ),
            "lines": [{"label": "required", "value": report.study.wanted, "colour": _RED, "dash": "dash"}],
        })  # fmt: skip
    return found


def _drawn(*groups: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the groups that are not empty, so that the legend names only those."""
    return [group for group in groups if group["x"]]


def _methods(label: str, colour: str, size: int, entries: Sequence[Entry], question: Question) -> dict[str, Any]:
    """Return a group of methods as points of error over time."""
    # A logarithmic axis cannot show an error of 0, so errors below the last digit are drawn at 1e-17.
    errors = [max(entry.errors[question.error], 1e-17) for entry in entries]
    names = [entry.label for entry in entries]
    return _group(label, colour, size, [1e3 * entry.seconds for entry in entries], errors) | {"names": names}


def _group(label: str, colour: str, size: int, x: Iterable[float], y: Iterable[float]) -> dict[str, Any]:
    return {"label": label, "colour": colour, "size": size, "x": _short(x), "y": _short(y)}


def bodies(report: Report) -> list[dict[str, Any]]:
    """Return triangle meshes of the share, its cone and the compacted soil around it, in metres."""
    scene = report.run.scene
    cone = scene.cone.mesh(segments=_SIDES)
    found = [
        _body("share", "Share", _BLUE, 1.0, scene.share.mesh(), edges=True),
        _body("cone", "Equivalent cone", _GREY, 1.0, cone, edges=False),
    ]
    if not scene.law.lacks("loosened_radius"):
        radius = float(scene.loosened_radius) / cone.vertices[1:, 1:].max()
        front = Solid(cone.vertices * [1.0, radius, radius], cone.polygons[:_SIDES], _SIDES)
        found.append(_body("front", "Compacted soil", _ORANGE, 0.3, front, edges=False))
    return found


def _body(key: str, label: str, colour: str, opacity: float, solid: Solid, *, edges: bool) -> dict[str, Any]:
    lines = {tuple(sorted(pair)) for p in solid.polygons for pair in zip(p, (*p[1:], p[0]), strict=True)}
    return {
        "id": key,
        "label": label,
        "colour": colour,
        "opacity": opacity,
        "smooth": not edges,
        "vertices": _short(solid.vertices.ravel()),
        "triangles": solid.triangles.ravel().tolist(),
        "edges": [number for pair in sorted(lines) for number in pair] if edges else [],
    }


def motion(run: Run) -> dict[str, Any]:
    """Return the motion of strut and share over time; empty if nothing changes."""
    scene = run.scene
    if not changing(run):
        return {}
    path = np.asarray(run.travel) + np.asarray(run.deflection)
    waves = [
        {"amplitude": float(wave.amplitude), "wavelength": float(wave.wavelength), "phase": float(wave.phase)}
        for wave in scene.effects.waves
    ]
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


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _unit(display: Display) -> str:
    """Return the symbol of a unit for an axis."""
    return nice(f" {display.symbol}").strip("\u00a0")


def _short(values: Iterable[float]) -> list[float]:
    """Return numbers rounded to the digits that a picture can show."""
    return [float(f"{value:.{_DIGITS}g}") for value in np.asarray(values, dtype=float).ravel()]
