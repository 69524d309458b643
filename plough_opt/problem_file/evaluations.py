"""Evaluations of a problem file at a point of a sweep: a simulation, one of very many, or a whole optimisation."""

import dataclasses
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TypeVar

import casadi as ca
import numpy as np

from plough_opt.core.errors import IntegrationError, PloughError
from plough_opt.core.expressions import Expression, stacked
from plough_opt.motion import Run
from plough_opt.motion.accuracy import DEFAULT_ERROR
from plough_opt.motion.batch import Batch
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.own_measures import measures_of
from plough_opt.problem_file.problem import Problem
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT
from plough_opt.studies.sweep.work import Array, WithNotes

# CasADi's graphs are built by one thread at a time.
_building = threading.Lock()
_T = TypeVar("_T")


@dataclass(frozen=True)
class Simulation:
    """The response of a problem's scene, as `Problem.simulate` finds it."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        return _units(self.problem)

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Simulate at a point."""
        run = _solved(lambda: self.problem.simulate(values))
        return WithNotes(_of_run(self.problem, run), run.warnings)


@dataclass(frozen=True)
class Optimisation:
    """The best share of a problem, from the file's guess at every point; a variable that is swept is fixed there."""

    problem: Problem

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        problem = self.problem
        variables = {key: variable.unit for key, variable in problem.variables.items()}
        margins = {f"margin of {name}": measures_of(problem.table)[name].unit.symbol for name in problem.table.require}
        return {**variables, **margins, **_units(problem)}

    def __call__(self, values: dict[str, float]) -> WithNotes:
        """Optimise at a point."""
        problem = fixed_at(self.problem, values)
        best, run = _solved(problem.optimise)
        assert isinstance(run, Run)  # several shares are refused before a sweep begins
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
    """The response of very many designs by `Batch`, to the error that the file wants.

    Attributes:
        problem: whose scene a batch accepts.
        names: the quantities that are swept.
    """

    problem: Problem
    names: tuple[str, ...]
    _built: tuple[Batch, ca.Function] | None = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, object]:
        """Leave behind what every process builds itself."""
        return {"problem": self.problem, "names": self.names, "_built": None}

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results: those of `Simulation` without peaks, which a batch does not find."""
        specific = ("specific_draft",) if "loosened_radius" in self._of_scene else ()
        return (*_AVERAGES, *self._of_scene, *specific, "error_estimate")

    @property
    def _of_scene(self) -> dict[str, Callable[[Scene], Expression]]:
        """The results without motion that the scene's law of resistance gives."""
        law, scene = self.problem.table.scene.law, self.problem.scene()
        known = _OF_SCENE | (_OF_RANDOM if scene.effects.random_strength is not None else {})
        return {name: of for name, of in known.items() if MEASURES[name].given_by(law)}

    @property
    def units(self) -> dict[str, str]:
        """Result -> SI unit."""
        return {name: MEASURES[name].unit.symbol for name in self.results if name in MEASURES}

    @property
    def error(self) -> float:
        """Wanted relative error of mean draft and RMS force."""
        return self.problem.accuracy.error or DEFAULT_ERROR

    def build(self) -> tuple[Batch, ca.Function]:
        """Return the batch, and the results that need no motion as a function of the quantities.

        Raises:
            InputError: a scene that a batch does not follow.
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
        """Simulate at points: see `plough_opt.studies.sweep.work.ManyPoints`."""
        batch, of_scene = self.build()
        found = batch(values)
        averages = [getattr(found, name) for name in _AVERAGES]
        *steady, ambient_share = np.asarray(of_scene(values.T))
        of_name = dict(zip(self._of_scene, steady, strict=True))
        specific = []
        if "loosened_radius" in of_name:
            with np.errstate(all="ignore"):
                specific = [found.mean_draft / (np.pi * of_name["loosened_radius"] ** 2)]
        results = np.column_stack([*averages, *steady, *specific, found.error_estimate])
        sound = ~found.failed
        kinds = 2 * (of_name["half_angle"] > PLANE_SECTIONS_LIMIT) + (ambient_share > 0.0)
        notes = []
        for kind in np.unique(kinds[sound]):
            # Scenes of one kind have the same warnings but for their numbers.
            which = np.flatnonzero(sound & (kinds == kind))
            scene = self.problem.scene(dict(zip(self.names, values[which[0]].tolist(), strict=True)))
            notes.append((int(which[0]), len(which), (*batch.warnings, *scene.warnings())))
        if missed := np.flatnonzero(found.missed).tolist():
            notes.append((missed[0], len(missed), (f"the wanted relative error {self.error:.1e} was not reached",)))
        return results, found.reasons, notes


def fixed_at(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return a problem with some quantities fixed, variables or not."""
    left = {key: variable for key, variable in problem.variables.items() if key not in values}
    notes = (f"'{key}' is a variable of the file: it is fixed" for key in problem.variables if key in values)
    fixed = {**problem.fixed, **values}
    return dataclasses.replace(problem, fixed=fixed, variables=left, notes=(*problem.notes, *notes))


def _of_run(problem: Problem, run: Run) -> dict[str, float]:
    """Return what is worth a column of a numeric run."""
    law, random = run.scene.law, run.scene.effects.random_strength is not None
    known = {name: one for name, one in measures_of(problem.table).items() if not one.everywhere}
    chosen = {name: one for name, one in known.items() if (random or not one.random) and one.given_by(law)}
    return {
        **{name: float(one.of(run)) for name, one in chosen.items()},
        "peak_force": run.peak_force,
        "peak_deflection": run.peak_deflection,
        "error_estimate": run.error_estimate,
    }


def _solved(compute: Callable[[], _T]) -> _T:
    """Return what is computed; what CasADi cannot do is a failure of the point."""
    try:
        return compute()
    except PloughError:
        raise
    except RuntimeError as error:
        raise IntegrationError(f"CasADi stopped: {str(error).strip().splitlines()[-1]}") from None


def _units(problem: Problem) -> dict[str, str]:
    """Return the unit of every result that has one."""
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
