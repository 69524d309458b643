"""The results of a function for each of very many soils, at one design of numbers.

The function is called once, with symbols for the uncertain properties; its runs are then simulated by `Batch` if it
can, and the algebra around them is evaluated for all soils at once.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.checks import check_kind, plain_number
from plough_opt.core.errors import InputError, nearest
from plough_opt.core.expressions import Expression, is_quantity, map_expressions
from plough_opt.design import Optimum
from plough_opt.design.nlp import averages_only
from plough_opt.design.split import EmbeddedRun, split
from plough_opt.motion.batch import Batch
from plough_opt.motion.batch.domain_check import DomainCheck
from plough_opt.motion.integrators import integration
from plough_opt.motion.plan import phase, steps_for
from plough_opt.motion.scene import Scene
from plough_opt.motion.terms import Structure, parameters, start_deflection, start_force, start_rate
from plough_opt.soil.soil import Soil
from plough_opt.studies.uncertainty.samples import SoilSamples

Vector = NDArray[np.float64]
Response = Callable[[Soil], Mapping[str, Expression]]

# Relative error of mean and RMS force, far below that of a few thousand samples.
_ERROR = 1e-7
# Soils whose runs are in memory at once if a batch cannot simulate them.
_CHUNK = 256


@dataclass(frozen=True)
class ResponseValues:
    """Results over samples.

    Attributes:
        values: name -> value of each sample with results.
        failures: number of a sample without results -> the reason.
    """

    values: dict[str, Vector]
    failures: dict[int, str]


class Responses:
    """The results of a function of the soil as functions of numbers: design and uncertain properties."""

    def __init__(self, response: Response, soil: Soil, names: Sequence[str]) -> None:
        """Call the function with symbols for the properties of the given names."""
        own: list[Any] = [ca.MX.sym(name) for name in names]
        expressions = response(replace(soil, **dict(zip(names, own, strict=True))))
        self.names = tuple(expressions)
        results = [ca.MX(value) for value in expressions.values()]
        known = {hash(symbol) for symbol in own}
        self._design = [symbol for symbol in ca.symvar(ca.vertcat(*results)) if hash(symbol) not in known]
        self._symbols = [*self._design, *own]
        self._parts = split(results, self._symbols)
        self._algebra = ca.Function("algebra", [*self._symbols, *self._parts.results], list(self._parts.expressions))

    def __call__(self, at: Optimum | Mapping[str, float], samples: SoilSamples) -> ResponseValues:
        """Return the results for each soil at a design.

        Args:
            at: the design: an optimum, or variables and parameters by name.
            samples: the soils.
        """
        design = [_number(at, symbol) for symbol in self._design]
        return self._evaluated(np.hstack([np.tile(design, (len(samples), 1)), samples.values]))

    def _evaluated(self, rows: Vector) -> ResponseValues:
        """Return the results for rows of numbers, the design's first."""
        results, failures = [], self._outside(rows)
        for k in range(len(self._parts.runs)):
            of_run, reasons = self._run(k, rows)
            results.append(of_run)
            failures = reasons | failures
        arguments = [ca.DM(column).T for column in rows.T]
        columns = [np.asarray(value).ravel() for value in self._algebra.call([*arguments, *map(ca.DM, results)])]
        values = [column if column.size == len(rows) else np.full(len(rows), column.item()) for column in columns]
        for bad in np.flatnonzero(~np.all(np.isfinite(values), axis=0)):
            failures.setdefault(int(bad), "a result is not a finite number")
        kept = np.ones(len(rows), dtype=bool)
        kept[list(failures)] = False
        return ResponseValues({name: value[kept] for name, value in zip(self.names, values, strict=True)}, failures)

    def _run(self, number: int, rows: Vector) -> tuple[Vector, dict[int, str]]:
        """Return a run's stacked results, a column for each row of numbers, and the reasons of those without any."""
        run = self._parts.runs[number]
        only_averages = averages_only(run, self._algebra, len(self._symbols) + number)
        structure, method = run.integration.structure, run.integration.accuracy.method
        if only_averages and method == "auto" and structure.orbit == "transient" and not structure.events:
            return self._batched(number, rows)
        return self._mapped(run, self._given[number], rows, only_averages)

    @cached_property
    def _scenes(self) -> list[tuple[DomainCheck, ca.Function]]:
        """Every scene in the results: its domain check, and its quantities and duration from the symbols."""
        scenes = [(run.embedding.template, run.quantities, run.inputs[-1]) for run in self._parts.runs]
        scenes += [
            (label.meaning, carried, ca.MX(1.0))
            for label, carried in self._parts.labels
            if isinstance(label.meaning, Scene)
        ]
        return [
            (
                DomainCheck(template, [None] * quantities.numel()),
                ca.Function("quantities", self._symbols, [ca.densify(ca.vertcat(quantities, duration))]),
            )
            for template, quantities, duration in scenes
        ]

    def _outside(self, rows: Vector) -> dict[int, str]:
        """Return the numbers of the rows outside the model's domain, with the reasons."""
        reasons: dict[int, str] = {}
        arguments = [ca.DM(column).T for column in rows.T]
        for check, quantities in self._scenes:
            values = np.asarray(quantities.call(arguments)[0])
            reasons |= check.reasons(np.tile(values, (1, len(rows))) if values.shape[1] == 1 < len(rows) else values)
        return reasons

    @cached_property
    def _given(self) -> list[ca.Function]:
        return [ca.Function("given", self._symbols, [run.inputs]) for run in self._parts.runs]

    @cached_property
    def _batches(self) -> dict[int, tuple[Batch, ca.Function]]:
        return {}

    def _batched(self, number: int, rows: Vector) -> tuple[Vector, dict[int, str]]:
        """Return the results by a batch."""
        run = self._parts.runs[number]
        if number not in self._batches:
            parts = iter(ca.vertsplit(run.quantities))
            scene: Scene = map_expressions(run.embedding.template, lambda _: next(parts), is_quantity)
            batch = Batch(scene, run.inputs[-1], inputs=self._symbols, error=_ERROR)
            self._batches[number] = batch, _start_values(scene, self._symbols)
        batch, start = self._batches[number]
        result = batch(rows)
        deflection, force = (np.asarray(value).ravel() for value in start.call([ca.DM(c).T for c in rows.T]))
        means, variances = [result.mean_deflection - deflection], [result.displacement_rms**2]
        if run.integration.structure.damper:
            means.append(result.mean_draft - force)
            variances.append(result.force_rms**2)
        if run.integration.structure.ramp:
            means.append(result.tow_power)
        states = sum(output.numel() for output in run.outputs) - len(means) - len(variances)
        return np.vstack([np.zeros((states, len(rows))), *means, *variances]), result.reasons

    def _mapped(
        self, run: EmbeddedRun, given: ca.Function, rows: Vector, only_averages: bool
    ) -> tuple[Vector, dict[int, str]]:
        """Return the results by the method of the run."""
        own = run.integration
        parameters = np.asarray(given.call([ca.DM(column).T for column in rows.T])[0])
        solver, outputs = own, own.timeline.outputs
        if own.accuracy.method == "auto" and own.structure.orbit == "transient":
            fastest = max(phase(dict(zip(own.names, p, strict=False)), p[-1]) for p in parameters.T)
            outputs = 1 if only_averages else outputs
            timeline = replace(own.timeline, outputs=outputs, steps=max(outputs, steps_for(fastest)), aligned=True)
            solver = integration(own.structure, own.accuracy, timeline)
        stacked, size = [], sum(output.numel() for output in run.outputs)
        for start in range(0, parameters.shape[1], _CHUNK):
            chunk = parameters[:, start : start + _CHUNK]
            count = chunk.shape[1]
            results = [np.asarray(result) for result in solver.function.map(count).call([ca.DM(chunk)])]
            column = np.vstack([_per_soil(result, count) for result in results])
            stacked.append(np.vstack([np.zeros((size - len(column), count)), column]))
        every = np.hstack(stacked)
        bad = np.flatnonzero(~np.all(np.isfinite(every), axis=0))
        return every, {int(k): "the motion has no finite result" for k in bad}


def _per_soil(result: Vector, count: int) -> Vector:
    """Return results that lie side by side, some columns for each soil, as one stacked column for each."""
    return result.reshape(result.shape[0], -1, count, order="F").reshape(-1, count, order="F")


def _start_values(scene: Scene, symbols: Sequence[ca.MX]) -> ca.Function:
    """Return the symbols of a scene -> deflection [m] and mount force [N] at its start."""
    structure, known = Structure.of(scene), parameters(scene)
    first = start_force(structure, known)
    force = first + known.get("damping", 0.0) * start_rate(structure, known)
    return ca.Function("start", list(symbols), [ca.MX(start_deflection(structure, known)), ca.MX(force)])


def _number(at: Optimum | Mapping[str, float], symbol: ca.MX) -> float:
    check_kind("the design", at, Optimum | Mapping, "an Optimum, or its values by name")
    values = at.variables if isinstance(at, Optimum) else at
    if symbol.name() in values:
        return plain_number(f"'{symbol.name()}'", values[symbol.name()])
    if isinstance(at, Optimum):
        return float(at(symbol))
    raise InputError(f"the design has no value for '{symbol.name()}': {nearest(symbol.name(), values)}")
