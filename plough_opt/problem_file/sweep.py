"""`sweep`: evaluation of a problem file, or of a function, over a grid or a sample."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind, check_named
from plough_opt.core.errors import InputError, about
from plough_opt.core.expressions import Expression, stacked
from plough_opt.core.plain_data import Array
from plough_opt.core.quantities import quantities
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.laws import LAWS
from plough_opt.motion import Run
from plough_opt.motion.batch import RESULTS, UNSTABLE, Batch
from plough_opt.motion.effects import OWN_EFFECTS
from plough_opt.motion.methods import DEFAULT_ERROR, METHODS
from plough_opt.motion.run import Averages
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.checks import BROKEN_WAVE, broken_wave_in_words
from plough_opt.motion.vocabulary import MEASURES, Measure
from plough_opt.problem_file.problem import Problem, longest_period, whole_waves
from plough_opt.problem_file.reading import check_changed
from plough_opt.problem_file.source import read_axis
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT
from plough_opt.studies.sweep import engine
from plough_opt.studies.sweep.engine import Progress
from plough_opt.studies.sweep.pool import Evaluation, WithNotes
from plough_opt.studies.sweep.question import Axis, Range, axis_of, digest_of, points_of
from plough_opt.studies.sweep.result import Sweep

What = Literal["simulate", "optimise"]
Method = Literal["auto", "each", "batch"]

MANY: Final = 10_000
"""Number of points from which a sweep simulates by `Batch`, if `Batch` accepts the scene."""

# Part of a duration by which whole waves may differ from it.
_WAVES_APART: Final = 1e-9


@dataclass(frozen=True)
class ProblemSweep:
    """Plan of a sweep of a problem file.

    Attributes:
        evaluation: the computation at each point.
        axes: quantity -> its values or range, in SI.
        origin: title of the file, and the units in which file and ranges are written.
        count: number of points.
        question: everything that the results depend on, by which a store recognises its own sweep.
        how: sentence that says how the points are computed.
        notes: what the sweep changes in the file.
    """

    evaluation: Simulation | SimulationOfMany | Optimisation
    axes: Mapping[str, Axis]
    origin: Origin
    count: int
    question: Mapping[str, str]
    how: str
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls,
        problem: Problem,
        over: Mapping[str, object],
        what: What = "simulate",
        method: Method = "auto",
        samples: int | None = None,
        seed: int = 0,
    ) -> ProblemSweep:
        """Return the plan of a sweep after all checks that need no results; arguments as in `sweep`."""
        check_named("what = {} is unknown", what, get_args(What))
        check_named("method = {} is unknown", method, get_args(Method))
        if what == "optimise" and method == "batch":
            raise InputError("a batch cannot optimise, only simulate: remove one of the two options")
        axes, displays = _axes(over, samples is not None)
        count = points_of(axes, samples, seed).count
        for end in (0, -1):
            corner = fixed_at(problem, {name: _ends(axis)[end] for name, axis in axes.items()})
            with about("in the sweep:"):
                check_changed(corner)
        if what == "optimise":
            corner.design()
        evaluation, how = _evaluation(problem, tuple(axes), what, method, count)
        fixed = [name for name in axes if what == "optimise" and name in problem.variables]
        notes = [f"'{name}' is a variable of the file: every point fixes it" for name in fixed]
        for name, variable in problem.variables.items():
            low, high = _ends(axes[name]) if name in axes else (variable.lower, variable.upper)
            if low < variable.lower or high > variable.upper:
                notes.append(f"'{name}' is swept outside its bounds in the file, {variable.words}")
        units = quantities()
        shown = {name: displays.get(name, Display(units[name].symbol, 1.0)) for name in axes}
        origin = Origin(problem.title, {**problem.displays, **shown})
        return cls(evaluation, axes, origin, count, _question(problem, axes, what, how), how, tuple(notes))

    def run(self, **rest: Any) -> Sweep:
        """Return the results at every point; arguments as in `sweep`."""
        units = {**self.evaluation.units, **{name: quantities()[name].symbol for name in self.axes}}
        found = engine.sweep(self.evaluation, self.axes, question=self.question, units=units, **rest)
        found.origin, found.how = self.origin, self.how
        return found


def sweep(
    what_to_sweep: Problem | Evaluation,
    over: Mapping[str, object],
    *,
    what: What = "simulate",
    method: Method = "auto",
    samples: int | None = None,
    seed: int = 0,
    store: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    retry: bool = False,
    limit: float | None = None,
    progress: bool | Progress = False,
    units: Mapping[str, str] | None = None,
) -> Sweep:
    """Return the results of a problem, or of a function of named numbers, at every point of a grid or a sample.

    For example::

        problem = po.read_problem("problems/cotton_subsoiler.toml")
        over = {"soil.cohesion": "5..45 kPa:9", "scene.tow_speed": po.Range(1.0, 3.0, 5)}
        result = po.sweep(problem, over, store="out/sweep.db")
        result.table["mean_draft"], list(result.failures)

    Each point is computed from its own values alone, so the numbers are the same, bit for bit on one machine, for any
    executor and number of workers. Each point is stored when it is finished; after an interruption the same call
    continues.

    Args:
        what_to_sweep: a problem, whose quantities are named as in its file; or a picklable function that takes a
            dictionary of the quantities at a point and returns named finite numbers. If it raises an exception, the
            point fails for that reason. A function of an interactive session or a notebook needs cloudpickle.
        over: name -> values: a `Range`, numbers (SI), or for a problem a text such as "5..45 kPa:9",
            "10..1000 kN/m:7 log", "5 kPa, 10 kPa", or "5..45 kPa" for a sample. The last name varies fastest.
        what: for a problem, "simulate" its scene with its variables at their guesses, or "optimise" its design from the
            file's guess at every point; swept variables are fixed.
        method: for simulations, "each" for `simulate`; "batch" for `Batch`, a hundred times as fast, without peaks; or
            "auto" for `Batch` from 10,000 points on, if it accepts the scene.
        samples: number of points of a scrambled Sobol sample of the ranges, preferably a power of two; None for a grid.
        seed: seed of the sample.
        store: an SQLite file that receives every finished point. Points of the same question that it already holds are
            not repeated. One run at a time fills it, and others may read it. None for a temporary file that is deleted
            with the result.
        executor: any `concurrent.futures.Executor`, such as that of a dask client or of mpi4py, which is left running
            (default: processes on all cores of this machine, which end with the sweep).
        workers: number of workers of the executor, so that all have work (default: the cores of this machine).
        retry: repeat points that failed or are undetermined.
        limit: time [s] after which a point has failed and its worker is replaced (default: 3600). Only for the
            processes of this machine, because those of another executor cannot be ended from here.
        progress: True for a bar on the error stream, if that is a terminal; or a function called with the numbers of
            stored points, all points, and failed points.
        units: for a function, name -> unit, for the headings of tables.

    Raises:
        InputError: an invalid quantity, range or argument; a store of another question, or one that is damaged or loses
            rows; a broken executor, or workers that all end too early.
        KeyboardInterrupt: the sweep was interrupted; the message says what is stored.

    Example:
        >>> import plough_opt as po
        >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
        >>> swept = po.sweep(problem, {"soil.cohesion": "5..45 kPa:9"}, store="out/sweep.db")  # doctest: +SKIP
    """
    rest: dict[str, Any] = {
        "samples": samples, "seed": seed, "store": store, "executor": executor, "workers": workers, "retry": retry,
        "limit": limit, "progress": progress,
    }  # fmt: skip
    if isinstance(what_to_sweep, Problem):
        if units is not None:
            raise InputError("units are for functions: a problem file has its own, so remove them")
        return ProblemSweep.of(what_to_sweep, over, what, method, samples, seed).run(**rest)
    if not (isinstance(what, str) and isinstance(method, str) and (what, method) == ("simulate", "auto")):
        raise InputError("what and method are for problem files: remove them to sweep a function")
    return engine.sweep(what_to_sweep, over, units=units, **rest)


def _axes(over: Mapping[str, object], sampled: bool) -> tuple[dict[str, Axis], dict[str, Display]]:
    """Return the values or range of each quantity in SI, and the units of those that are given as text."""
    check_kind("over", over, Mapping, "a dictionary, like {'soil.cohesion': '5..45 kPa:9'}")
    units = quantities()
    axes: dict[str, Axis] = {}
    displays: dict[str, Display] = {}
    for name, given in over.items():
        check_named("{} cannot be swept", name, units)
        if not isinstance(given, str):
            axes[name] = axis_of(name, given)
            continue
        with about(f"'{name}'"):
            axes[name], displays[name] = read_axis(given, units[name], sampled=sampled)
    return axes, displays


def _ends(axis: Axis) -> tuple[float, float]:
    return (axis.lower, axis.upper) if isinstance(axis, Range) else (min(axis), max(axis))


def _evaluation(
    problem: Problem, names: tuple[str, ...], what: What, method: Method, count: int
) -> tuple[Simulation | SimulationOfMany | Optimisation, str]:
    """Return the computation at each point, and a sentence that describes it."""
    if what == "optimise":
        return Optimisation(problem), "each point is a whole optimisation, from the file's guess"
    if method == "batch" or (method == "auto" and count >= MANY):
        many = SimulationOfMany(problem, names)
        try:
            many.build()
        except InputError:
            if method == "batch":
                raise
        else:
            return many, f"simulated by po.Batch, to a relative error of {many.error:.0e}"
    return Simulation(problem), "each point is simulated by po.simulate"


def _question(problem: Problem, axes: Mapping[str, Axis], what: What, how: str) -> dict[str, str]:
    """Return name -> text of every setting and quantity that the results depend on."""
    table = problem.table.model_dump(exclude={"title", "variables", "minimise", "require", "trade_off"})
    found = {"what": what, "computed": how, **_flat(table), **problem.values(), "course": problem.course}
    if what == "optimise":
        chosen = problem.table.model_dump(include={"variables", "minimise", "require"})
        chosen["variables"] = {name: one for name, one in chosen["variables"].items() if name not in axes}
        found |= _flat(chosen)
    texts = {name: str(value) for name, value in found.items() if name not in axes and value is not None}
    files = {f"content of {name}": f"digest {digest_of(text)}" for name, text in problem.data.items()}
    return {**texts, **files, "laws, effects, measures and methods": digest_of((LAWS, OWN_EFFECTS, MEASURES, METHODS))}


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return nested tables as one flat table with dotted names."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        found |= _flat(value, f"{before}{name}.") if isinstance(value, dict) else {f"{before}{name}": value}
    return found


# CasADi is not thread-safe while it builds a graph.
_building = threading.Lock()


@dataclass(frozen=True)
class Simulation:
    """Simulation of a problem's scene by `Problem.simulate`."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        return _units()

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Return the results at a point, with the run's warnings; ``values`` maps quantities to SI values."""
        run = self.problem.simulate(values)
        return WithNotes(_of_run(run), run.warnings)


@dataclass(frozen=True)
class Optimisation:
    """Optimisation of a problem, from the file's guess at every point; swept variables are fixed."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        problem = self.problem
        variables = {key: variable.unit for key, variable in problem.variables.items()}
        margins = {f"margin of {name}": MEASURES[name].unit.symbol for name in problem.table.require}
        return {**variables, **margins, **_units()}

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Return optimum and results at a point, with all warnings; ``values`` maps quantities to SI values."""
        problem = fixed_at(self.problem, values)
        design, symbolic = problem.design()
        best = design.solve()  # not `Problem.optimise`, which also looks for the best design in catalogue values
        run = best(symbolic)
        numbers = {
            "objective": best.objective,
            **best.variables,
            **{f"margin of {name}": margin for name, margin in best.margins.items()},
            **_of_run(run),
            "local_optima": len(best.local_optima),
            "flat_directions": len(best.flat_directions),
            "objective_gap": best.gap,
            "objective_error_estimate": best.error_estimate,
        }
        return WithNotes(numbers, (*best.warnings, *run.warnings))


@dataclass
class SimulationOfMany:
    """Simulation of many points at once by `Batch`, to the relative error that the file requires.

    Attributes:
        problem: the problem; `Batch` must accept its scene.
        names: names of the swept quantities.
    """

    problem: Problem
    names: tuple[str, ...]
    _built: tuple[Batch, Batch | None, ca.Function] | None = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, object]:
        """Return the state without the compiled batch, which every process builds itself."""
        return {"problem": self.problem, "names": self.names, "_built": None}

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results: those of `Simulation` except peaks, which a batch does not compute."""
        return (*_columns(self.problem.scene()), "error_estimate")

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        units = _units()
        return {name: units[name] for name in self.results if name in units}

    @property
    def error(self) -> float:
        """Required relative error of mean draft and RMS force."""
        return self.problem.accuracy.error or DEFAULT_ERROR

    def build(self) -> tuple[Batch, Batch | None, ca.Function]:
        """Return the batch, one over whole strength waves, and a function from inputs and averages to other numbers.

        The function returns the results, half angle, the part of the draft due to ambient pressure, duration and the
        longest strength wave's period.

        Raises:
            InputError: `Batch` cannot simulate the scene, or a result needs the whole motion.
        """
        with _building:
            if self._built is None:
                symbols = {name: ca.MX.sym(name) for name in self.names}
                inputs, averages = list(symbols.values()), ca.MX.sym("averages", len(RESULTS))
                scene, values = self.problem.scene(symbols), self.problem.values(symbols)
                duration = values.get("scene.duration")
                batch, whole = Batch(scene, duration, inputs, error=self.error), None
                period: Expression = 1.0
                if scene.effects.waves and scene.effects.orbit == "transient" and scene.effects.tow_profile is None:
                    whole = Batch(scene, whole_waves(values), inputs, error=self.error)
                    period = longest_period(values)
                results = _of_averages(self.problem, scene, averages)
                further = (scene.cone.half_angle, scene.ambient_share, 0.0 if whole is None else duration, period)
                numbers = ca.Function("numbers", [ca.vertcat(*inputs), averages], [stacked(*results, *further)])
                self._built = batch, whole, numbers
        return self._built

    def many(self, values: Array) -> tuple[Array, dict[int, str], list[tuple[int, int, tuple[str, ...]]]]:
        """Return results, failures and notes at many points: see `plough_opt.studies.sweep.pool.ManyPoints`."""
        batch, whole, numbers = self.build()
        found = batch(values)
        averages = np.stack([getattr(found, name) for name in RESULTS])
        *columns, half_angle, ambient_share, duration, period = np.asarray(numbers(values.T, averages))
        results = np.column_stack([*columns, found.error_estimate])
        sound = np.isfinite(results).all(axis=1)
        kinds = 2 * (half_angle > PLANE_SECTIONS_LIMIT) + (ambient_share > 0.0)
        notes = []
        for kind in np.unique(kinds[sound]):
            # Scenes of one kind have the same warnings, with numbers that are extreme where these columns are.
            which = np.flatnonzero(sound & (kinds == kind))
            for k, points in _extremes(which, np.column_stack([values, ambient_share])[which]):
                scene = self.problem.scene(dict(zip(self.names, values[k].tolist(), strict=True)))
                notes.append((k, points, (*batch.warnings, *scene.warnings())))
        count = np.floor(duration / period * (1.0 + _WAVES_APART))
        broken = np.flatnonzero(sound & (count >= 1.0) & (count * period < duration * (1.0 - _WAVES_APART)))
        if whole is not None and broken.size:
            change = 100.0 * (averages[0, broken] / whole(values[broken]).mean_draft - 1.0)
            changed = np.abs(change) > BROKEN_WAVE
            percent = dict(zip(broken[changed].tolist(), change[changed].tolist(), strict=True))
            for k, points in _extremes(broken[changed], change[changed, None]):
                words = broken_wave_in_words(percent[k], int(count[k]), float(count[k] * period[k]))
                notes.append((k, points, (words,)))
        if missed := np.flatnonzero(found.missed).tolist():
            notes.append((missed[0], len(missed), (f"the wanted relative error {self.error:.1e} was not reached",)))
        if unstable := np.flatnonzero(found.unstable).tolist():
            notes.append((unstable[0], len(unstable), (UNSTABLE,)))
        return results, found.reasons, notes


def _extremes(which: NDArray[np.int_], columns: Array) -> list[tuple[int, int]]:
    """Return the first point and those with an extreme in a column, each with a number of points that it stands for.

    The first stands for all.

    Args:
        which: numbers of the points.
        columns: values at these points.
    """
    if not which.size:
        return []
    ends = dict.fromkeys([0, *np.argmin(columns, axis=0).tolist(), *np.argmax(columns, axis=0).tolist()])
    return [(int(which[end]), len(which) if end == 0 else 0) for end in ends]


def _of_averages(problem: Problem, scene: Scene, averages: ca.MX) -> list[Expression]:
    """Return the results of a run of which only the averages are known.

    Raises:
        InputError: a result needs more.
    """
    over_time: dict[str, Any] = dict.fromkeys([*Run.__dataclass_fields__][1:10])
    run = Run(scene, **over_time, averages=Averages(*ca.vertsplit(averages)), accuracy=problem.accuracy)
    found = []
    for name, one in _columns(scene).items():
        try:
            found.append(one.of(run))
        except (AttributeError, TypeError):
            raise InputError(f"'{name}' needs the motion over time, which a batch does not keep") from None
    return found


def fixed_at(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return a problem in which some quantities, variables or not, are fixed at given values."""
    left = {key: variable for key, variable in problem.variables.items() if key not in values}
    notes = (f"'{key}' is a variable of the file: it is fixed" for key in problem.variables if key in values)
    fixed = {**problem.fixed, **values}
    return dataclasses.replace(problem, fixed=fixed, variables=left, notes=(*problem.notes, *notes))


def _columns(scene: Scene) -> dict[str, Measure]:
    """Return name -> measure of the results of a scene that become columns of a sweep."""
    law, random = scene.law, scene.effects.random_strength is not None
    known = {name: one for name, one in MEASURES.items() if not one.everywhere}
    return {name: one for name, one in known.items() if (random or not one.random) and one.given_by(law)}


def _of_run(run: Run) -> dict[str, float]:
    """Return the results of a numeric run that become columns of a sweep."""
    own = {name: float(one.of(run)) for name, one in _columns(run.scene).items()}
    return own | {name: getattr(run, name) for name in ("peak_force", "peak_deflection", "error_estimate")}


def _units() -> dict[str, str]:
    """Return result -> SI unit."""
    own = {name: one.unit.symbol for name, one in MEASURES.items()}
    return own | {"peak_force": "N", "peak_deflection": "m"}
