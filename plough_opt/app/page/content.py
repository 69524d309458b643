"""Texts and tables of a report, section by section."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from plough_opt.core.quantities import EVERY, QUANTITIES
from plough_opt.core.tables import Grid
from plough_opt.core.units import Display
from plough_opt.design import Limit, Optimum, Sensitivity
from plough_opt.laws.forces import cone_index
from plough_opt.motion import Run
from plough_opt.motion.vocabulary import called
from plough_opt.problem_file import Problem
from plough_opt.soil.geometry import Wedge
from plough_opt.studies.accuracy.result import AccuracyStudy

# Elasticities, and margins in SI units, below this are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Report:
    """Contents of a report.

    Attributes:
        problem: the file.
        run: run of the best design, or of the file's scene if it has no variables.
        best: the optimum, if the file has variables.
        sensitivities: sensitivities of the optimum, the largest first.
        unknown: reason why there are no sensitivities, or "".
        study: comparison of integration methods on this scene, or None.
        provenance: heading -> text of everything that identifies how the report was made.
        text: text of the problem file.
    """

    problem: Problem
    run: Run
    best: Optimum | None = None
    sensitivities: tuple[Sensitivity, ...] = ()
    unknown: str = ""
    study: AccuracyStudy | None = None
    provenance: dict[str, str] = field(default_factory=dict)
    text: str = ""

    def display(self, key: str, unit: str, *values: float) -> Display:
        """Return the unit in which the file writes a quantity or result, or a customary one for these SI values."""
        return self.problem.origin.display(key, unit, *values)

    def shown(self, key: str, value: float, unit: str, digits: int = 4) -> str:
        """Return an SI value as text in the unit of `display`."""
        return nice(self.display(key, unit, value).text(value, digits))

    @property
    def results(self) -> dict[str, str]:
        """Name -> text of the run's averages and peaks, with one unit for each kind of quantity."""
        return {name: nice(value) for name, value in self.run.response().rows}


def nice(text: str) -> str:
    """Return a quantity for display: superscript powers, ° for degrees, no line break between number and unit."""
    text = re.sub(r"\^([23])", lambda power: "²³"["23".index(power[1])], text)
    return re.sub(r" deg\b", "°", text).replace("*", "·").replace(" ", "\u00a0")


def answer(report: Report) -> str:
    """Return the answer as one sentence."""
    best, problem = report.best, report.problem
    if best is None:
        return f"This share needs a mean draft of {report.results['mean draft']}."
    values = [f"{called(key)} {nice(v.display.text(best.variables[key], 4))}" for key, v in problem.variables.items()]
    state = {"solved": "Best design", "not unique": "A best design (not unique)"}
    return f"{state.get(best.status, 'Best design found (not confirmed by derivatives)')}: {', '.join(values)}."


def cards(report: Report) -> list[tuple[str, str]]:
    """Return (name, text) of the main results, which the page shows first."""
    names = ("mean draft", "RMS of the mount force", "tow power", "mean deflection", "loosened radius")
    return [(name, report.results[name]) for name in names if name in report.results]


def question(report: Report) -> list[str]:
    """Return the design question, one text for each paragraph."""
    problem, table = report.problem, report.problem.table
    if report.best is None:
        return ["What draft does this share need, and how does it move? The file has no variables."]
    terms = [f"{called(name)} in units of {nice(str(term.per))}" for name, term in table.minimise.items()]
    text = [f"Choose {_listed([called(key) for key in problem.variables])} to minimise {' plus '.join(terms)}."]
    limits = [f"{called(name)} {limits_of(problem, name)}" for name in table.require]
    if limits:
        text.append(f"Required: {_listed(limits)}.")
    if report.best.over:
        text.append(f"{report.best.over.capitalize()}.")
    return text


def limits_of(problem: Problem, name: str) -> str:
    """Return a requirement's limits as the file writes them; a requirement not in the file comes from the model."""
    own = problem.table.require.get(name)
    return "domain of the theory" if own is None else ", ".join(map(nice, own.words.split(", ")))


def variables(report: Report) -> list[dict[str, str | float | bool]]:
    """Return name, value, bounds and position between the bounds (0 to 1) of each variable of an optimum."""
    assert report.best is not None  # the page asks only then
    bounds = {limit.name: limit for limit in report.best.limits if limit.kind == "bound"}
    return [
        {
            "name": called(key),
            "value": nice(v.display.text(bounds[key].rounded, 5)),
            "lower": nice(v.display.text(v.lower)),
            "upper": nice(v.display.text(v.upper)),
            "place": _place(bounds[key].rounded, v.lower, v.upper, v.log),
            "active": bounds[key].active,
        }
        for key, v in report.problem.variables.items()
    ]


def requirements(report: Report) -> list[dict[str, str | float | bool]]:
    """Return name, limits, value and margin of each requirement; the margin also as a fraction of the limit.

    The report must be about an optimum.
    """
    assert report.best is not None  # the page asks only then
    return [_requirement(report, limit) for limit in report.best.limits if limit.kind == "requirement"]


def _requirement(report: Report, limit: Limit) -> dict[str, str | float | bool]:
    margin = 0.0 if limit.active or abs(limit.margin) < _ROUNDING else limit.margin
    size = max(abs(limit.value), abs(limit.value + margin), _ROUNDING)
    return {
        "name": called(limit.name),
        "limits": limits_of(report.problem, limit.name),
        "value": report.shown(limit.name, limit.rounded, limit.unit),
        "margin": report.shown(limit.name, margin, limit.unit, 3),
        "part": min(1.0, max(0.0, margin / size)),
        "percent": f"{100.0 * margin / size:.3g} %",
        "active": limit.active,
        "met": margin >= 0.0,
    }


def response(report: Report) -> Grid:
    """Return a table of the averages and peaks of the run."""
    return Grid.pairs("Averages over the run, and peaks", *report.results.items())


def share(report: Report) -> Grid:
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
        ("half angle of the cone", angle.text(float(cone.half_angle), 4)),
        ("base radius of the cone", length.text(float(cone.height * cone.slope), 4)),
        ("moving mass, frame and share", f"{float(report.run.scene.mass):.4g} kg"),
    ]
    return Grid.pairs("Dimensions", *((name, nice(value)) for name, value in rows))


def optima(report: Report) -> Grid | None:
    """Return a table of the local optima, if there are several."""
    best = report.best
    if best is None or len(best.local_optima) < 2:
        return None
    keys = report.problem.variables
    grid = Grid.of("Local optima found, best first", "", "objective", *map(called, keys))
    for one in best.local_optima:
        values = (nice(v.display.text(one.variables[key], 5)) for key, v in keys.items())
        grid.row(one.name, f"{one.objective:.6g}", *values)
    return grid


def scene(report: Report) -> Grid:
    """Return a table of the fixed quantities and effects of the scene."""
    fixed = report.problem.fixed
    rows = [
        (called(key), report.shown(key, x, EVERY[key].unit)) for key, x in fixed.items() if EVERY[key].owner != "soil"
    ]
    effects = report.problem.table.effects
    rows += [("contact", effects.contact.replace("_", " and ")), ("start", effects.start)]
    if effects.orbit != "transient":
        rows.append(("orbit", effects.orbit.replace("_", " ")))
    return Grid.pairs("Fixed in the scene", *rows)


def soil(report: Report) -> Grid:
    """Return a table of the properties of the soil."""
    own = report.run.scene.soil
    rows = []
    for name, quantity in QUANTITIES.items():
        value = getattr(own, quantity.key, None) if quantity.owner == "soil" else None
        if value is not None:
            rows.append((quantity.meaning, report.shown(name, float(value), quantity.unit, 5)))
    if not report.run.scene.law.lacks("cone_index"):
        rows.append(("cone index of a penetrometer", nice(f"{float(cone_index(own)) / 1e3:.4g} kPa")))
        share = 100.0 * float(report.run.scene.ambient_share)
        rows.append(("part of the static draft due to ambient pressure", f"{share:.0f} %"))
    return Grid.pairs(own.name, *rows)


def sensitivities(report: Report) -> list[dict[str, str | float]]:
    """Return the changes for one per cent more of each quantity or limit, the largest first."""
    found = [one for one in report.sensitivities if one.elasticity is not None and abs(one.elasticity) > _ROUNDING]
    largest = max((abs(one.elasticity or 0.0) for one in found), default=1.0)
    return [
        {
            "name": called(one.name),
            "value": report.shown(one.name.partition(" ")[0], one.value, one.unit),
            "percent": f"{one.elasticity:+.3g}\u00a0%",
            "part": (one.elasticity or 0.0) / largest,
            "moves": ", ".join(_moves(one)) or "nothing",
        }
        for one in found
    ]


def _moves(one: Sensitivity) -> list[str]:
    return [
        f"{called(name)} {elasticity:+.2g}\u00a0%"
        for name, elasticity in one.elasticities.items()
        if elasticity is not None and abs(elasticity) > _ROUNDING
    ]


def accuracy(report: Report) -> Grid:
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


def notes(report: Report) -> list[str]:
    """Return all warnings as sentences."""
    found = [*(report.best.warnings if report.best else ()), *report.run.warnings]
    if report.best is not None:
        for direction in report.best.flat_directions:
            names = _listed([called(name) for name, change in direction.items() if change])
            found.append(f"the optimum is not unique: the result does not change along {names}; fix one of these")
        for name in dict.fromkeys(name for one in report.sensitivities for name in one.touching):
            found.append(f"{called(name)} is just met: sensitivities apply to increasing values")
    return [f"{text[:1].upper()}{text[1:]}." for text in dict.fromkeys(found)]


def searched(report: Report) -> str:
    """Return a sentence on the search, or ""."""
    text = "" if report.best is None or report.best.search is None else str(report.best.search)
    for key in sorted(EVERY, key=len, reverse=True):
        text = text.replace(key, EVERY[key].called)
    return text


def _place(value: float, lower: float, upper: float, log: bool) -> float:
    """Return the position of a value between bounds, from 0 to 1."""
    if log:
        value, lower, upper = math.log(value), math.log(lower), math.log(upper)
    return (value - lower) / (upper - lower)


def _listed(words: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)
