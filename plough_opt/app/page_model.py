"""A problem file's scene as JavaScript: what a page needs to compute its results for any values of its quantities."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np

from plough_opt.core.checks import LARGEST, DomainLimit, unlabelled
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import gauss_legendre, is_symbolic, stacked
from plough_opt.core.quantities import EVERY, Quantity, wave_table
from plough_opt.core.units import Display, customary
from plough_opt.design import Design
from plough_opt.design.declarations import Parameter, Variable
from plough_opt.exchange.export.javascript import Source
from plough_opt.motion import Run
from plough_opt.motion.effects import Own
from plough_opt.motion.effects.own import slopes
from plough_opt.motion.equation import Structure, equation_of, parameters
from plough_opt.motion.methods import DEFAULT_ERROR, Accuracy
from plough_opt.motion.run import WITHOUT_RANDOM, Averages
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.integrators import assemble, quasi_static
from plough_opt.motion.solvers.orbit import near_orbit
from plough_opt.motion.solvers.plan import forced_rate, rates
from plough_opt.motion.solvers.steps import GAUSS_POINTS, MORE_POINTS, Timeline, step
from plough_opt.motion.vocabulary import MEASURES, called
from plough_opt.problem_file import Problem
from plough_opt.problem_file.problem import FileVariable
from plough_opt.problem_file.written import fixed_variables
from plough_opt.soil.soil import compression_test

ROWS: Final = ("travel", "speed", "deflection", "mount_force", "soil_resistance")
"""Results over time, in the order of the JavaScript function `at`."""
AVERAGES: Final = tuple(Averages.__dataclass_fields__)
# Results that every page shows if the law of resistance gives them, besides those that the file names.
_SHOWN: Final = (*AVERAGES, "specific_draft", "loosened_radius", "half_angle", "moving_mass")

# Combinations of switched effects on a page, all of five effects, and operations of their formulas: about 700 kB.
_MOST_VARIANTS: Final = 31
_MOST_OPERATIONS: Final = 20_000
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


@dataclass(frozen=True)
class Switch:
    """An effect that the page switches.

    Attributes:
        label: its name in tables.
        on: whether the file has it.
        changes: changes of `Effects` that switch it the other way.
        settings: keys of problem files that do so, each with its value there.
    """

    label: str
    on: bool
    changes: Mapping[str, Any]
    settings: tuple[tuple[str, Any], ...]


def switches(problem: Problem) -> list[Switch]:
    """Return the effects that need no value, and those of the file whose value is no variable."""
    effects, listed = problem.scene().effects, list[Switch]()
    for name in ("inertial_drag", "added_mass", "ambient_pressure"):
        on = getattr(effects, name)
        listed.append(Switch(name.replace("_", " "), on, {name: not on}, ((f"effects.{name}", not on),)))
    if effects.start == "rest":
        settings: Any = (("effects.start", "equilibrium"),)
        listed.append(Switch("start at rest", True, {"start": "equilibrium"}, settings))
    waves = [f"{wave_table(k)}.amplitude" for k in range(1, len(effects.waves) + 1)]
    values = {name: [f"effects.{name}"] for name in ("tow_ramp", "damping", "speed_term", "rate_term")}
    for name, keys in {"strength_wave": waves, **values}.items():
        if getattr(effects, name) is not None and not {*keys} & {*problem.variables}:
            settings = tuple((key, f"0 {EVERY[key].unit}" if EVERY[key].unit else 0.0) for key in keys)
            listed.append(Switch(name.replace("_", " "), True, {name: None}, settings))
    return listed


def page_model(problem: Problem) -> PageModel:
    """Return a file's scene as JavaScript, with its effects and with some of them switched.

    Raises:
        InputError: the scene has something that the page cannot compute; the message names it.
    """
    values = {key: v.guess for key, v in problem.variables.items()} | problem.numbers()
    if problem.scene().effects.tow_profile is not None:
        del values["scene.tow_speed"]  # a table over time, which no slider moves
    kind: Any = ca.SX if problem.scene().law.scalar else ca.MX
    x = kind.sym("x", len(values))
    given = dict(zip(values, ca.vertsplit(x), strict=True))
    switched, variants = switches(problem), {"": _variant(problem, given, x, {})}
    operations = variants[""].operations(x)
    subsets = (which for count in range(len(switched)) for which in itertools.combinations(switched, count + 1))
    for which in itertools.islice(subsets, _MOST_VARIANTS):
        changes = {name: value for switch in which for name, value in switch.changes.items()}
        with contextlib.suppress(InputError):  # another effect, or a result of the file, needs this one
            variant = _variant(problem, given, x, changes)
            if (operations := operations + variant.operations(x)) > _MOST_OPERATIONS:
                break
            variants[",".join(str(switched.index(one)) for one in which)] = variant
    declared = fixed_variables(problem) | dict(problem.variables)
    source = Source("the page shows the report only")
    # The formulas of all variants share what they have in common.
    prepared = ca.cse([ca.densify(one) for variant in variants.values() for one in variant.prepared])
    listed = [f"prepare: {source.add(ca.Function('prepare', [x], prepared))}"]
    for key, variant in variants.items():
        names = ", ".join(f"{name}: {source.add(own)}" for name, own in variant.functions.items())
        listed.append(f"{json.dumps(key)}: {{ {names} }}")
    data = {
        "inputs": [_input(problem, key, value, declared.get(key)) for key, value in values.items()],
        "results": [_result(problem, name, unit) for name, (unit, _) in _wanted(problem, problem.scene()).items()],
        "rows": ROWS,
        "averages": AVERAGES,
        "requirements": _requirements(problem),
        "outputs": problem.table.scene.outputs,
        "error": problem.accuracy.error or DEFAULT_ERROR,
        "gauss": [
            dict(zip(("nodes", "weights"), gauss_legendre(points), strict=True))
            for points in (GAUSS_POINTS, GAUSS_POINTS + MORE_POINTS)
        ],
        "switches": [{"label": one.label, "on": one.on, "settings": one.settings} for one in switched],
        "variants": {
            key: variant.data | {"place": k * len(variant.prepared)}
            for k, (key, variant) in enumerate(variants.items())
        },
    }
    return PageModel(f"{source}\nconst FUNCTIONS = {{ {', '.join(listed)} }};\n", data)


def design_model(design: Design) -> PageModel:
    """Return objective and requirements of a design as JavaScript, with the runs as `Design.nlp` writes them.

    Raises:
        InputError: the objective has no JavaScript form; the message names it.
    """
    declared, nlp = design.declared, design.nlp()
    x = ca.MX.sym("x", len(declared.variables) + len(declared.parameters))
    values = ca.vertsplit(x)
    scaled = [variable.scaled(value) for variable, value in zip(declared.variables, values, strict=False)]
    program = ca.Function("program", [nlp.problem["x"], nlp.problem["p"]], [nlp.problem["f"], nlp.problem["g"]])
    f, g = program(stacked(*scaled), stacked(ca.MX(), *values[len(scaled) :]))
    source = Source("the page cannot hold this design")
    name = source.add(ca.Function("whole", [x], [nlp.objective_scale * f, nlp.scales * g]))
    limits = {requirement.name: requirement for requirement in declared.requirements}
    requirements, lows, highs = [], nlp.lbg * nlp.scales, nlp.ubg * nlp.scales
    for key, places in itertools.groupby(range(len(lows)), key=nlp.requirements.__getitem__):
        which, own = [*places], limits.get(key)
        low, high = (None if math.isinf(end[which[0]]) else float(end[which[0]]) for end in (lows, highs))
        unit = shown_in(own.shown if own else customary("", 1.0))
        requirements.append({"name": key, "label": called(key), "low": low, "high": high, "count": len(which), **unit,
                             "words": own.limits_text() if own else "domain of the theory"})  # fmt: skip
    symbols: list[Variable | Parameter] = [*declared.variables, *declared.parameters]
    data = {
        "inputs": [*map(_declared, symbols)],
        "results": [{"name": "objective", "label": "objective", "symbol": "", "factor": 1.0}, *requirements],
        "requirements": requirements, "rows": [], "variants": {"": {}}, "switches": [], "axes": [], "known": "best",
        "objective": True, "certifies": True, "without": "", "file": "", "panels": {}, "tables": None,
    }  # fmt: skip
    return PageModel(f"{source}\nconst FUNCTIONS = {{ whole: {name} }};\n", data)


def _declared(symbol: Variable | Parameter) -> dict[str, Any]:
    """Return name, unit, bounds and domain of a variable or parameter of a design."""
    if isinstance(symbol, Variable):
        low, high = symbol.lower, symbol.upper
        why = "the steps of this page resolve the motion between these bounds"
        limit = DomainLimit(symbol.name, symbol.unit, at_least=low, at_most=high, why=why)
        return _slider(symbol.name, symbol.guess, symbol.shown, "variables", limit, (low, high), bool(symbol.log))
    low, high = max(symbol.domain[0], -LARGEST), min(symbol.domain[1], LARGEST)
    limit = DomainLimit(symbol.name, symbol.unit, at_least=low, at_most=high)
    group, display = symbol.name.rpartition(".")[0] or "parameters", customary(symbol.unit, symbol.value)
    return _slider(symbol.name, symbol.value, display, group, limit, _around(symbol.value, low, high))


def _around(value: float, low: float, high: float) -> tuple[float, float]:
    """Return where a quantity without bounds of its own moves: from half to twice its value, inside its domain."""
    size = abs(value) or 1.0
    return max(low, value - size / 2.0), min(high, value + size)


def _slider(
    name: str,
    value: float,
    display: Display,
    group: str,
    limit: DomainLimit,
    ends: tuple[float, float],
    log: bool = False,
    steps: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Return what the page says of a quantity, its value, and where it moves."""
    return {
        "name": name, "label": called(name), **shown_in(display), "group": group, "variable": group == "variables",
        "limit": _limit(limit), "value": value, "lower": ends[0], "upper": ends[1], "log": log, "steps": steps,
    }  # fmt: skip


@dataclass(frozen=True)
class _Variant:
    """The scene of the file with some effects switched.

    Attributes:
        prepared: what does not change over time: orders of magnitude, limited values, constants, parameters.
        functions: functions of constants and parameters.
        data: what the engine must know about it.
    """

    prepared: tuple[Any, Any, Any, Any]
    functions: dict[str, ca.Function]
    data: dict[str, Any]

    def operations(self, x: Any) -> int:
        """Return the number of operations of what is prepared."""
        return int(ca.Function("prepared", [x], ca.cse([ca.densify(one) for one in self.prepared])).n_instructions())


def _variant(problem: Problem, given: Mapping[str, Any], x: Any, changes: Mapping[str, Any]) -> _Variant:
    """Return the scene at symbols x, which stand for the quantities ``given``, with changed effects.

    Raises:
        InputError: effects exclude each other, or the file asks for a result that needs one of them.
    """
    kind: Any = type(x)
    scene = problem.scene(given)
    scene = replace(scene, effects=replace(scene.effects, **changes))
    scene.check_reaction()
    limits = [(limit, value) for limit, value in scene.limits() if is_symbolic(value)]
    moves, structure = scene.effects.motion, Structure.of(scene)
    equation = equation_of(structure) if moves else None
    states, count, squared = (equation.states, equation.count, equation.squared) if equation else (2, 0, 0)
    time, state, five = kind.sym("time"), kind.sym("state", states), kind.sym("five", len(AVERAGES))
    means, variances = kind.sym("means", count), kind.sym("variances", squared)
    # Resistances of the user's own decide the first number of steps by their slopes at the file's values.
    usual = problem.scene()
    own = slopes(Own.of(usual), parameters(usual)) if usual.effects.own else {}
    with unlabelled():
        p = parameters(scene)
        duration = scene.wave_period if structure.orbit != "transient" else problem.values(given)["scene.duration"]
        rate = rates(p | own).summed if moves else forced_rate(p)
        none = ca.DM.zeros(count)
        run = (
            assemble(scene, p, time, np.ones(1), state.T, none, none, Accuracy())
            if moves
            else quasi_static(scene, p, time, Timeline(1, 1), Accuracy(), 1)
        )
        averaged = replace(run, averages=Averages(*ca.vertsplit(five)))
        last = (getattr(run, name) for name in (*ROWS, "mode"))
        results = [
            stacked(*(values[-1] if getattr(values, "shape", ()) else values for values in last)),
            stacked(*(of(averaged) for _, of in _wanted(problem, scene).values())),
        ]
        if moves:
            run = assemble(scene, p, time, np.ones(1), state.T, means, variances, Accuracy())
            results.append(stacked(*(getattr(run.averages, name) for name in AVERAGES)))
        # What does not change over time, such as the law of resistance, is computed once for a design.
        found = [ca.extract_parametric(ca.densify(one), x) for one in results]
    parts, symbols, constants = zip(*found, strict=True)
    c = stacked(kind(), *itertools.chain(*symbols))
    functions = {"at": _dense("at", x, c, time, state, parts[0]), "measures": _dense("measures", x, c, five, parts[1])}
    column: Any = kind()
    if equation:
        column = stacked(*(p[name] for name in equation.names), duration)
        functions |= {"averages": _dense("averages", x, c, means, variances, parts[2]), "start": equation.start,
                      "step": step(equation)}  # fmt: skip
        if equation.events is not None:
            functions["events"] = equation.events
        if structure.orbit != "transient":
            functions["orbit"] = near_orbit(equation)
    profile = scene.effects.tow_profile
    kinks = [p.get("ramp_time", 0.0), *(profile.times if profile else ())]
    inertia = scene.inertia if moves else 0.0
    setup = stacked(rate, scene.stiffness, inertia, duration, *(time / duration for time in kinks))
    data = {
        "moves": moves, "kinked": structure.kinked, "count": count, "squared": squared,
        "nodes": int(equation.rate.n_nodes()) if equation else 0,
        # A design's requirement has the law's name in front; the command line's message does not.
        "limits": [_limit(replace(limit, name=limit.name.rpartition(": ")[2])) for limit, _ in limits],
    }  # fmt: skip
    limited = stacked(kind(), *(value for _, value in limits))
    return _Variant((setup, limited, stacked(kind(), *itertools.chain(*constants)), column), functions, data)


def _dense(name: str, *parts: Any) -> ca.Function:
    *arguments, result = parts
    return ca.Function(name, arguments, [ca.densify(result)])


def _wanted(problem: Problem, scene: Scene) -> dict[str, tuple[str, Callable[[Run], Any]]]:
    """Return name -> SI unit and function of a run, of the results that the page shows, beside those over time."""
    names = dict.fromkeys([*_SHOWN, *problem.table.minimise, *problem.table.require])
    measures = {name: MEASURES[name] for name in names}
    own = {name: (measure.unit.symbol, measure.of) for name, measure in measures.items()
           if measure.given_by(scene.law) and not measure.everywhere}  # fmt: skip
    return {"objective": ("", problem.objective), **own} if problem.table.minimise else own


def _input(problem: Problem, key: str, value: float, variable: FileVariable | None) -> dict[str, Any]:
    """Return name, unit, bounds and domain of a quantity, which may be a variable or one that an override fixed."""
    quantity = EVERY[key]
    display = problem.origin.display(key, quantity.unit, value)
    limit = _domain(problem, quantity)
    ends = _around(value, max(quantity.low, limit.at_least), min(quantity.high, limit.at_most))
    if variable:
        ends = min(value, variable.lower), max(value, variable.upper)
    group = "variables" if key in problem.variables else quantity.owner
    return _slider(key, value, display, group, limit, ends, bool(variable and variable.log), _steps(variable))


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
    requirements = []
    for name, table in problem.table.require.items():
        measure = MEASURES[name]
        low, high = table.ends(measure.unit)
        requirements.append({**_result(problem, name, measure.unit.symbol), "low": low, "high": high,
                             "everywhere": measure.everywhere, "words": table.words})  # fmt: skip
    return requirements
