"""A problem file's scene as JavaScript: what a page needs to compute its results for any values of its quantities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import LARGEST, DomainLimit
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, stacked
from plough_opt.core.labels import limits_of_laws, unlabelled
from plough_opt.core.quantities import EVERY, Quantity
from plough_opt.core.units import Display
from plough_opt.exchange.export.javascript import Source
from plough_opt.motion import Run
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.plan import forced_rate, rates
from plough_opt.motion.run import WITHOUT_RANDOM, Averages, assemble
from plough_opt.motion.scene import Scene
from plough_opt.motion.simulation import GAUSS_POINTS, MORE_POINTS, quasi_static
from plough_opt.motion.steps import Timeline, step
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.problem_file import Problem
from plough_opt.problem_file.measures import measures_of
from plough_opt.problem_file.problem import FileVariable
from plough_opt.soil.soil import compression_test

ROWS: Final = ("travel", "speed", "deflection", "mount_force", "soil_resistance")
"""Results over time, in the order of the JavaScript function `at`."""
AVERAGES: Final = tuple(Averages.__dataclass_fields__)
# Results that every page shows if the law of resistance gives them, besides those that the file names.
_SHOWN: Final = (*AVERAGES, "specific_draft", "loosened_radius", "half_angle", "moving_mass")

# Positions of a slider: about as many as the eye tells apart.
_MOST_POSITIONS: Final = 1000


@dataclass(frozen=True)
class PageModel:
    """A scene that a page can compute.

    Attributes:
        functions: JavaScript that defines the object ``FUNCTIONS``.
        data: what the engine and the controls must know about them, as plain data.
    """

    functions: str
    data: dict[str, Any]


def page_model(problem: Problem) -> PageModel:
    """Return a file's scene as JavaScript.

    Raises:
        InputError: the scene has something that the page cannot compute; the message names it.
    """
    _refuse(problem)
    values = {key: v.guess for key, v in problem.variables.items()} | problem.numbers()
    kind: Any = ca.SX if problem.scene().law.scalar else ca.MX
    x, time, state = kind.sym("x", len(values)), kind.sym("time"), kind.sym("state", 2)
    given = dict(zip(values, ca.vertsplit(x), strict=True))
    with limits_of_laws() as limits:
        scene = problem.scene(given)
        scene.check_reaction()
    moves, structure = scene.effects.motion, Structure.of(scene)
    five = kind.sym("averages", len(AVERAGES))
    wanted = _wanted(problem, scene)
    with unlabelled():
        p = parameters(scene)
        duration = problem.values(given)["scene.duration"]
        ramp = p.get("ramp_time", 0.0) / duration
        rate = rates(p).summed if moves else forced_rate(p)
        run = _at(scene, time, state)
        # What does not change over time, such as the law of resistance, is computed once for a design.
        rows, symbols, constants = ca.extract_parametric(
            ca.densify(stacked(*(_last(getattr(run, name)) for name in ROWS))), x
        )
        functions = {
            "setup": [x, stacked(rate, ramp, scene.stiffness, scene.inertia if moves else 0.0, duration)],
            "limited": [x, stacked(kind(), *(value for _, value in limits))],
            "constants": [x, stacked(kind(), *constants)],
            "at": [x, stacked(kind(), *symbols), time, state, rows],
            "measures": [x, five, stacked(*_measured(problem, replace(run, averages=Averages(*ca.vertsplit(five)))))],
        }
        if moves:
            equation = equation_of(structure)
            means, variances = kind.sym("means", equation.count), kind.sym("variances", equation.squared)
            found = assemble(scene, time, np.ones(1), state.T, means, variances, Accuracy()).averages
            column = stacked(*(p[name] for name in equation.names), duration)
            functions["parameters"] = [x, column]
            functions["averages"] = [x, means, variances, stacked(*(getattr(found, name) for name in AVERAGES))]
    source = Source("the page shows the report only")
    names = {name: source.add(_dense(name, *parts)) for name, parts in functions.items()}
    if moves:
        names |= {"start": source.add(equation_of(structure).start), "step": source.add(step(structure))}
    listed = ", ".join(f"{name}: {own}" for name, own in names.items())
    data = {
        "inputs": [_input(problem, key, value) for key, value in values.items()],
        # A design's requirement has the law's name in front; the command line's message does not.
        "limits": [_limit(replace(limit, name=limit.name.rpartition(": ")[2])) for limit, _ in limits],
        "results": [_result(problem, name, unit) for name, unit in wanted.items()],
        "rows": ROWS,
        "averages": AVERAGES,
        "requirements": _requirements(problem),
        "moves": moves,
        "kinked": structure.kinked,
        "count": equation_of(structure).count if moves else 0,
        "squared": equation_of(structure).squared if moves else 0,
        "outputs": problem.table.scene.outputs,
        "error": problem.accuracy.error or DEFAULT_ERROR,
        "gauss": [_gauss(points) for points in (GAUSS_POINTS, GAUSS_POINTS + MORE_POINTS)],
    }
    return PageModel(f"{source}\nconst FUNCTIONS = {{ {listed} }};\n", data)


def _refuse(problem: Problem) -> None:
    """Raise InputError for what the page cannot compute."""
    effects = problem.scene().effects
    if effects.orbit != "transient":
        raise InputError("the page does not compute periodic orbits, only motions from a start")
    if effects.events:
        what = "the entry of a share" if effects.entry else "stick and slip"
        raise InputError(f"the page does not locate the events of {what}")
    if effects.tow_profile is not None:
        raise InputError("the page does not compute a tow speed that varies over time")
    if effects.own:
        raise InputError("the page does not compute resistances of the user's own")


def _dense(name: str, *parts: Any) -> ca.Function:
    *arguments, result = parts
    return ca.Function(name, arguments, [ca.densify(result)])


def _last(values: Any) -> Any:
    return values[-1] if hasattr(values, "shape") and values.shape != () else values


def _at(scene: Scene, time: Any, state: Any) -> Run:
    """Return the run whose last output is at a time, with a state that has been integrated up to then."""
    if not scene.effects.motion:
        return quasi_static(scene, time, Timeline(1, 1), Accuracy(), 1)
    none = ca.DM.zeros(equation_of(Structure.of(scene)).count)
    return assemble(scene, time, np.ones(1), state.T, none, none, Accuracy())


def _wanted(problem: Problem, scene: Scene) -> dict[str, str]:
    """Return name -> SI unit of the results that the page shows, beside those over time."""
    every = measures_of(problem.table)
    named = dict.fromkeys([*_SHOWN, *problem.table.minimise, *problem.table.require, *problem.table.measures])
    found = {name: every[name].unit.symbol for name in named
             if every[name].given_by(scene.law) and not every[name].everywhere}  # fmt: skip
    return {"objective": "", **found} if problem.table.minimise else found


def _measured(problem: Problem, run: Run) -> list[Expression]:
    """Return the results of a run in the order of `_wanted`."""
    every = measures_of(problem.table)
    own = {"objective": problem.objective, **{name: measure.of for name, measure in every.items()}}
    return [own[name](run) for name in _wanted(problem, run.scene)]


def _input(problem: Problem, key: str, value: float) -> dict[str, Any]:
    """Return name, unit, bounds and domain of a quantity."""
    quantity, variable = EVERY[key], problem.variables.get(key)
    display = problem.origin.display(key, quantity.unit, value)
    limit = _domain(problem, quantity)
    # A quantity without bounds of its own moves between half and twice its value, inside its domain.
    size = abs(value) or 1.0
    low = variable.lower if variable else max(quantity.low, limit.at_least, value - size / 2.0)
    high = variable.upper if variable else min(quantity.high, limit.at_most, value + size)
    return {
        "name": key, "label": called(key), "group": "variables" if variable else quantity.owner, "unit": quantity.unit,
        **shown_in(display), "lower": low, "upper": high, "log": bool(variable and variable.log), "value": value,
        "variable": variable is not None, "steps": _steps(variable), "limit": _limit(limit),
    }  # fmt: skip


def _domain(problem: Problem, quantity: Quantity) -> DomainLimit:
    """Return the domain of a quantity: an ambient pressure also lies in the range of the file's compression test."""
    limit = DomainLimit(
        quantity.called,
        quantity.unit,
        above=quantity.low if quantity.above else -math.inf,
        below=quantity.high if quantity.below else math.inf,
        at_least=-LARGEST if quantity.above else max(quantity.low, -LARGEST),
        at_most=LARGEST if quantity.below else min(quantity.high, LARGEST),
        why=quantity.why,
    )
    test = problem.table.soil.compaction
    if test is None or quantity is not EVERY["soil.ambient_pressure"]:
        return limit
    pressure, _ = compression_test(test.pressure, test.volume_lost)
    return replace(limit, at_least=float(pressure[0]), at_most=float(pressure[-1]),
                   why="the compression test goes no further")  # fmt: skip


def _steps(variable: FileVariable | None) -> list[float] | None:
    """Return the values of a variable's catalogue between its bounds; None without one, or if there are too many."""
    if variable is None or variable.catalogue is None:
        return None
    if not isinstance(variable.catalogue, float):
        return sorted(value for value in variable.catalogue if variable.lower <= value <= variable.upper)
    step = variable.catalogue
    first, last = math.ceil(variable.lower / step), math.floor(variable.upper / step)
    return [k * step for k in range(first, last + 1)] if last - first < _MOST_POSITIONS else None


def _limit(limit: DomainLimit) -> dict[str, Any]:
    """Return a limit as plain data, infinite ends as None."""
    return {key: None if isinstance(end, float) and math.isinf(end) else end for key, end in asdict(limit).items()}


def _result(problem: Problem, name: str, unit: str) -> dict[str, Any]:
    display = problem.origin.display(name, unit)
    label = called(name) + (without_random(problem) if name in ("force_rms", "displacement_rms") else "")
    return {"name": name, "label": label, "unit": unit, **shown_in(display)}


def without_random(problem: Problem) -> str:
    """Return what the labels of a motion's RMS and peaks must add, "" if the soil has no random strength."""
    return WITHOUT_RANDOM if problem.scene().effects.random_strength is not None else ""


def shown_in(display: Display) -> dict[str, Any]:
    """Return a unit as plain data."""
    return {"symbol": display.symbol, "factor": display.factor}


def _requirements(problem: Problem) -> list[dict[str, Any]]:
    """Return name and limits of each requirement in the file."""
    every, found = measures_of(problem.table), []
    for name, table in problem.table.require.items():
        low, high = table.ends(every[name].unit)
        everywhere = name in MEASURES and MEASURES[name].everywhere
        found.append({**_result(problem, name, every[name].unit.symbol), "low": low, "high": high,
                      "everywhere": everywhere, "words": table.words})  # fmt: skip
    return found


def _gauss(points: int) -> Mapping[str, list[float]]:
    """Return nodes and weights of a quadrature from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    return {"nodes": ((nodes + 1.0) / 2.0).tolist(), "weights": (weights / 2.0).tolist()}
