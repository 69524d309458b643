"""`sweep`: evaluation of a problem file, or of a function, over a grid or a sample."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Literal, get_args

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_kind, check_named, mapping_of, shown
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import stacked
from plough_opt.core.quantities import quantities
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.motion import Run
from plough_opt.motion.batch import UNSTABLE, Batch
from plough_opt.motion.methods import DEFAULT_ERROR
from plough_opt.motion.run import Averages
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.problem import Problem
from plough_opt.problem_file.ranges import read_axis
from plough_opt.problem_file.reading import check_changed
from plough_opt.studies.sweep.engine import Answer, Plan, Progress
from plough_opt.studies.sweep.points import Axis, axis_of, points_of
from plough_opt.studies.sweep.result import Sweep

What = Literal["simulate", "optimise"]
Method = Literal["auto", "each", "batch"]

MANY: Final = 10_000
"""Number of points from which a sweep simulates by `Batch`, if `Batch` accepts the scene."""


def sweep(
    what_to_sweep: Any,
    over: Mapping[str, object],
    *,
    what: What = "simulate",
    method: Method = "auto",
    samples: int | None = None,
    seed: int = 0,
    file: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool | Progress = False,
    units: Mapping[str, str] | None = None,
) -> Sweep:
    """Return the results of a problem, or of a function of named numbers, at every point of a grid or a sample.

    For example::

        problem = po.read_problem("problems/cotton_subsoiler.toml")
        over = {"soil.cohesion": "5..45 kPa:9", "scene.tow_speed": po.Range(1.0, 3.0, 5)}
        swept = po.sweep(problem, over, file="out/sweep.csv")
        swept.column("mean_draft"), swept.failures

    Each point is computed from its own values alone, so the numbers are the same, bit for bit on one machine, for any
    executor and number of workers. Each point is in the file when it is finished; after an interruption the same call
    continues.

    Args:
        what_to_sweep: a problem, whose quantities are named as in its file; or a picklable function that takes a
            dictionary of the quantities at a point and returns named finite numbers. If it raises an exception, the
            point fails for that reason.
        over: name -> values: a `Range`, numbers (SI), or for a problem a text such as "5..45 kPa:9",
            "10..1000 kN/m:7 log", "5 kPa, 10 kPa", or "5..45 kPa" for a sample. The last name varies fastest.
        what: for a problem, "simulate" its scene with its variables at their guesses, or "optimise" its design from the
            file's guess at every point; swept variables are fixed.
        method: for simulations, "each" for `simulate`; "batch" for `Batch`, much faster, without peaks; or "auto" for
            `Batch` from 10,000 points on, if it accepts the scene.
        samples: number of points of a scrambled Sobol sample of the ranges, preferably a power of two; None for a grid.
        seed: seed of the sample.
        file: a CSV file that receives a row for every finished point. Points of the same question that it already holds
            are not repeated. One run at a time fills it, and others may read it.
        executor: any `concurrent.futures.Executor`, such as that of a dask client or of mpi4py, which is left running
            (default: processes on all cores of this machine, which end with the sweep).
        workers: number of workers of the executor, which decides how many tasks it has at a time (default: the cores of
            this machine).
        progress: True for a bar on the error stream, if that is a terminal; or a function called with a sentence and
            the part of the points that are finished.
        units: for a function, name -> unit, for the headings of tables.

    Raises:
        InputError: an invalid quantity, range or argument; a file of another question or that no sweep wrote; a broken
            executor, or one whose workers end.
        KeyboardInterrupt: the sweep was interrupted; the message says what is finished.

    Example:
        >>> import plough_opt as po
        >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
        >>> swept = po.sweep(problem, {"soil.cohesion": "5..45 kPa:9"}, file="out/sweep.csv")  # doctest: +SKIP
    """
    if isinstance(what_to_sweep, Problem):
        if units is not None:
            raise InputError("units are for functions: a problem file has its own, so remove them")
        plan = plan_of(what_to_sweep, over, what, method, samples, seed)
    else:
        if not callable(what_to_sweep):
            raise InputError(f"{shown(what_to_sweep)} cannot be swept: use a problem, or a function of named numbers")
        if not (isinstance(what, str) and isinstance(method, str) and (what, method) == ("simulate", "auto")):
            raise InputError("what and method are for problem files: remove them to sweep a function")
        check_kind("over", over, Mapping, "a dictionary with names as keys")
        units = mapping_of("units", units, "a name -> its unit")
        points = points_of({name: axis_of(name, given) for name, given in over.items()}, samples, seed)
        name = getattr(what_to_sweep, "__qualname__", type(what_to_sweep).__qualname__)
        plan = Plan(what_to_sweep, tuple(over), points, f"{what_to_sweep.__module__}.{name}", units)
    return plan.run(file=file, executor=executor, workers=workers, progress=progress)


def plan_of(
    problem: Problem,
    over: Mapping[str, object],
    what: What = "simulate",
    method: Method = "auto",
    samples: int | None = None,
    seed: int = 0,
) -> Plan:
    """Return the plan of a problem's sweep after all checks that need no results; arguments as in `sweep`."""
    check_named("what = {} is unknown", what, get_args(What))
    check_named("method = {} is unknown", method, get_args(Method))
    if what == "optimise" and method == "batch":
        raise InputError("a batch cannot optimise, only simulate: remove one of the two options")
    axes, displays = _axes(over, samples is not None)
    points, notes = points_of(axes, samples, seed), list[str]()
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    ends = [fixed_at(problem, dict(zip(axes, end, strict=True))) for end in (low, high)]
    for end in ends:
        with about("in the sweep:"):
            check_changed(end)
    table = problem.table.model_dump(exclude={"title"})
    question = repr([what, table, problem.values(), problem.course, problem.data])
    function: Any = partial(_simulated, problem)
    how = "Each point is simulated by po.simulate"
    if what == "optimise":
        ends[0].design()
        function, how = partial(_optimised, problem), "Each point is a whole optimisation, from the file's guess"
        notes += [
            f"'{key}' is a variable of the file: every point fixes it" for key in axes if key in problem.variables
        ]
    elif method == "batch" or (method == "auto" and len(points) >= MANY):
        many = SimulationOfMany(problem, tuple(axes), question)
        with suppress(*([InputError] if method == "auto" else [])):
            notes += many.built()[0].warnings
            function, how = many, f"Simulated by po.Batch, to a relative error of {many.error:.0e}"
            notes += [f"at an end: {text}" for end in ends for text in end.scene().warnings()]
    for key, least, most in zip(axes, low, high, strict=True):
        variable = problem.variables.get(key)
        if variable is not None and (least < variable.lower or most > variable.upper):
            notes.append(f"'{key}' is swept outside its bounds in the file, {variable.words}")
    units = {key: quantities()[key].symbol for key in axes}
    displays = {**problem.displays, **{key: Display(unit, 1.0) for key, unit in units.items()}, **displays}
    question, origin = f"{question} {axes} {samples} {seed} {how}", Origin(problem.title, displays)
    units = {**_units(problem), **units}
    return Plan(function, tuple(axes), points, question, units, origin, how, tuple(dict.fromkeys(notes)))


def _axes(over: Mapping[str, object], sampled: bool) -> tuple[dict[str, Axis], dict[str, Display]]:
    """Return the values or range of each quantity in SI, and the units of those that are given as text."""
    check_kind("over", over, Mapping, "a dictionary, like {'soil.cohesion': '5..45 kPa:9'}")
    units, axes, displays = quantities(), dict[str, Axis](), dict[str, Display]()
    for name, given in over.items():
        check_named("{} cannot be swept", name, units)
        if not isinstance(given, str):
            axes[name] = axis_of(name, given)
            continue
        with about(f"'{name}'"):
            axes[name], displays[name] = read_axis(given, units[name], sampled=sampled)
    return axes, displays


def fixed_at(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return a problem in which some quantities, variables or not, are fixed at given values."""
    left = {key: variable for key, variable in problem.variables.items() if key not in values}
    notes = (f"'{key}' is a variable of the file: it is fixed" for key in problem.variables if key in values)
    fixed = {**problem.fixed, **values}
    return dataclasses.replace(problem, fixed=fixed, variables=left, notes=(*problem.notes, *notes))


def _columns(scene: Scene) -> dict[str, Measure]:
    """Return name -> measure of the results of a scene that become columns of a sweep."""
    law, random = scene.law, scene.effects.random_strength is not None
    single = {name: one for name, one in MEASURES.items() if not one.everywhere}
    return {name: one for name, one in single.items() if (random or not one.random) and one.given_by(law)}


def _units(problem: Problem) -> dict[str, str]:
    """Return name -> SI unit of variables and results."""
    variables = {key: one.unit for key, one in problem.variables.items()}
    margins = {f"margin of {name}": MEASURES[name].unit.symbol for name in problem.table.require}
    own = {name: one.unit.symbol for name, one in MEASURES.items()}
    return {**variables, **margins, **own, "peak_force": "N", "peak_deflection": "m"}


def _of_run(run: Run) -> dict[str, float]:
    own = {name: float(one.of(run)) for name, one in _columns(run.scene).items()}
    return own | {name: getattr(run, name) for name in ("peak_force", "peak_deflection", "error_estimate")}


def _simulated(problem: Problem, values: dict[str, float]) -> Answer:
    """Return the results of a simulation, with its warnings."""
    run = problem.simulate(values)
    return Answer(_of_run(run), run.warnings)


def _optimised(problem: Problem, values: dict[str, float]) -> Answer:
    """Return the optimum and its results, with all warnings."""
    design, symbolic = fixed_at(problem, values).design()
    best = design.solve()  # not `Problem.optimise`, which also looks for the best design in catalogue values
    run = best(symbolic)
    margins = {f"margin of {name}": margin for name, margin in best.margins.items()}
    optimum = {"objective": best.objective, **best.variables, **margins, "local_optima": len(best.local_optima)}
    return Answer(optimum | _of_run(run), (*best.warnings, *run.warnings))


# CasADi is not thread-safe while it builds a graph.
_building = threading.Lock()


@dataclass(frozen=True)
class SimulationOfMany:
    """Simulation of many points at once by `Batch`, to the relative error that the file requires.

    Attributes:
        problem: the problem; `Batch` must accept its scene.
        names: names of the swept quantities.
        question: by which a process recognises what it has compiled.
    """

    problem: Problem = field(compare=False)
    names: tuple[str, ...]
    question: str

    @property
    def error(self) -> float:
        """Required relative error of mean draft and RMS force."""
        return self.problem.accuracy.error or DEFAULT_ERROR

    @lru_cache(maxsize=2)  # noqa: B019
    def built(self) -> tuple[Batch, tuple[str, ...], ca.Function]:
        """Return the batch, the names of results, and a function from inputs and averages to results.

        Raises:
            InputError: `Batch` cannot simulate the scene, or a result needs the whole motion.
        """
        with _building:
            symbols = {name: ca.MX.sym(name) for name in self.names}
            inputs, averages = list(symbols.values()), ca.MX.sym("averages", len(dataclasses.fields(Averages)))
            scene = self.problem.scene(symbols)
            batch = Batch(scene, self.problem.values(symbols).get("scene.duration"), inputs, error=self.error)
            over_time: dict[str, Any] = dict.fromkeys([*Run.__dataclass_fields__][1:10])
            kept = Averages(*ca.vertsplit(averages))
            run, results = Run(scene, **over_time, averages=kept, accuracy=self.problem.accuracy), dict[str, Any]()
            for name, one in _columns(scene).items():
                try:
                    results[name] = one.of(run)
                except (AttributeError, TypeError):
                    raise InputError(f"'{name}' needs the motion over time, which a batch does not keep") from None
            numbers = ca.Function("numbers", [ca.vertcat(*inputs), averages], [stacked(*results.values())])
            return batch, tuple(results), numbers

    def many(self, places: Sequence[Mapping[str, float]]) -> list[Answer]:
        """Return the results at points, with the batch's own error estimate."""
        batch, names, numbers = self.built()
        values = np.array([[*place.values()] for place in places])
        found = batch(values)
        averages = np.stack([getattr(found, one.name) for one in dataclasses.fields(Averages)])
        columns = np.vstack([np.asarray(numbers(values.T, averages)), found.error_estimate])
        missed = f"the wanted relative error {self.error:.1e} was not reached"
        answers = []
        for k, column in enumerate(columns.T.tolist()):
            warnings = [*([missed] if found.missed[k] else []), *([UNSTABLE] if found.unstable[k] else [])]
            results = dict(zip((*names, "error_estimate"), column, strict=True))
            answers.append(Answer(results, warnings, found.reasons.get(k, "")))
        return answers
