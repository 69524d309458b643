"""Evaluations of a problem file at the points of a sweep: simulations one by one, in batches, or optimisations."""

import dataclasses
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter

import casadi as ca
import numpy as np

from plough_opt.core.expressions import Expression, stacked
from plough_opt.core.plain_data import Array
from plough_opt.motion import Run
from plough_opt.motion.batch import Batch
from plough_opt.motion.methods import DEFAULT_ERROR
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import Problem
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT
from plough_opt.studies.sweep.pool import WithNotes

# CasADi is not thread-safe while it builds a graph.
_building = threading.Lock()


@dataclass(frozen=True)
class Simulation:
    """Simulation of a problem's scene by `Problem.simulate`."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        return _units(self.problem)

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Return the results at a point, with the run's warnings; ``values`` maps quantities to SI values."""
        run = self.problem.simulate(values)
        return WithNotes(_of_run(self.problem, run), run.warnings)


@dataclass(frozen=True)
class Optimisation:
    """Optimisation of a problem, from the file's guess at every point; swept variables are fixed."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        problem = self.problem
        variables = {key: variable.unit for key, variable in problem.variables.items()}
        margins = {f"margin of {name}": measures_of(problem.table)[name].unit.symbol for name in problem.table.require}
        return {**variables, **margins, **_units(problem)}

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Return optimum and results at a point, with all warnings; ``values`` maps quantities to SI values."""
        problem = fixed_at(self.problem, values)
        best, run = problem.optimise()
        assert isinstance(run, Run)  # ProblemSweep.of refuses several shares
        numbers = {
            "objective": best.objective,
            **best.variables,
            **{f"margin of {name}": margin for name, margin in best.margins.items()},
            **_of_run(problem, run),
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
    _built: tuple[Batch, ca.Function] | None = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, object]:
        """Return the state without the compiled batch, which every process builds itself."""
        return {"problem": self.problem, "names": self.names, "_built": None}

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results: those of `Simulation` except peaks, which a batch does not compute."""
        specific = ("specific_draft",) if "loosened_radius" in self._of_scene else ()
        return (*_AVERAGES, *self._of_scene, *specific, "error_estimate")

    @property
    def _of_scene(self) -> dict[str, Callable[[Scene], Expression]]:
        """Results that need no motion and that the scene's law of resistance provides: name -> function of a scene."""
        law, scene = self.problem.table.scene.law, self.problem.scene()
        known = _OF_SCENE | (_OF_RANDOM if scene.effects.random_strength is not None else {})
        return {name: of for name, of in known.items() if MEASURES[name].given_by(law)}

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        return {name: MEASURES[name].unit.symbol for name in self.results if name in MEASURES}

    @property
    def error(self) -> float:
        """Required relative error of mean draft and RMS force."""
        return self.problem.accuracy.error or DEFAULT_ERROR

    def build(self) -> tuple[Batch, ca.Function]:
        """Return the batch, and a function from the quantities to the results that need no motion.

        Raises:
            InputError: `Batch` cannot simulate the scene.
        """
        with _building:
            if self._built is None:
                symbols = {name: ca.MX.sym(name) for name in self.names}
                scene = self.problem.scene(symbols)
                duration = self.problem.values(symbols)["scene.duration"]
                batch = Batch(scene, duration, list(symbols.values()), error=self.error)
                of_scene = stacked(*(of(scene) for of in self._of_scene.values()), scene.ambient_share)
                self._built = batch, ca.Function("of_scene", [ca.vertcat(*symbols.values())], [of_scene])
        return self._built

    def many(self, values: Array) -> tuple[Array, dict[int, str], list[tuple[int, int, tuple[str, ...]]]]:
        """Return results, failures and notes at many points: see `plough_opt.studies.sweep.pool.ManyPoints`."""
        batch, of_scene = self.build()
        found = batch(values)
        *steady, ambient_share = np.asarray(of_scene(values.T))
        of_name = dict(zip(self._of_scene, steady, strict=True))
        columns = [*(getattr(found, name) for name in _AVERAGES), *steady]
        if "loosened_radius" in of_name:
            with np.errstate(all="ignore"):
                columns.append(found.mean_draft / (np.pi * of_name["loosened_radius"] ** 2))
        results = np.column_stack([*columns, found.error_estimate])
        sound = np.isfinite(results).all(axis=1)
        kinds = 2 * (of_name["half_angle"] > PLANE_SECTIONS_LIMIT) + (ambient_share > 0.0)
        notes = []
        for kind in np.unique(kinds[sound]):
            # Scenes of one kind have the same warnings, with numbers that are extreme where these columns are.
            which = np.flatnonzero(sound & (kinds == kind))
            extreme = np.column_stack([values, ambient_share])[which]
            ends = dict.fromkeys([0, *np.argmin(extreme, axis=0).tolist(), *np.argmax(extreme, axis=0).tolist()])
            for k in which[list(ends)]:
                scene = self.problem.scene(dict(zip(self.names, values[k].tolist(), strict=True)))
                points = len(which) if k == which[0] else 0  # All points of a kind are counted with the first.
                notes.append((int(k), points, (*batch.warnings, *scene.warnings())))
        if missed := np.flatnonzero(found.missed).tolist():
            notes.append((missed[0], len(missed), (f"the wanted relative error {self.error:.1e} was not reached",)))
        return results, found.reasons, notes


def fixed_at(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return a problem in which some quantities, variables or not, are fixed at given values."""
    left = {key: variable for key, variable in problem.variables.items() if key not in values}
    notes = (f"'{key}' is a variable of the file: it is fixed" for key in problem.variables if key in values)
    fixed = {**problem.fixed, **values}
    return dataclasses.replace(problem, fixed=fixed, variables=left, notes=(*problem.notes, *notes))


def _of_run(problem: Problem, run: Run) -> dict[str, float]:
    """Return the results of a numeric run that become columns of a sweep."""
    law, random = run.scene.law, run.scene.effects.random_strength is not None
    known = {name: one for name, one in measures_of(problem.table).items() if not one.everywhere}
    chosen = {name: one for name, one in known.items() if (random or not one.random) and one.given_by(law)}
    return {
        **{name: float(one.of(run)) for name, one in chosen.items()},
        "peak_force": run.peak_force,
        "peak_deflection": run.peak_deflection,
        "error_estimate": run.error_estimate,
    }


def _units(problem: Problem) -> dict[str, str]:
    """Return result -> SI unit."""
    own = {name: one.unit.symbol for name, one in measures_of(problem.table).items()}
    return own | {"peak_force": "N", "peak_deflection": "m"}


_AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
_OF_SCENE: dict[str, Callable[[Scene], Expression]] = {
    "loosened_radius": lambda scene: scene.loosened_radius,
    "half_angle": lambda scene: scene.cone.half_angle,
    "moving_mass": lambda scene: scene.mass,
    "added_mass": lambda scene: scene.carried_soil,
}
_OF_RANDOM = {name: attrgetter(name) for name, one in MEASURES.items() if one.random}
