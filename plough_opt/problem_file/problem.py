"""A problem file after reading and checking, and the scenes, runs, designs and components made from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from plough_opt.core.checks import check_kind, check_named, check_switch, mapping_of
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Expression, as_number, floor, maximum
from plough_opt.core.quantities import BESIDE, EVERY, QUANTITIES
from plough_opt.core.saving import Origin
from plough_opt.core.units import Display
from plough_opt.exchange.building import build
from plough_opt.exchange.component import Component, Input, Output, Port, port_of
from plough_opt.motion import Run, simulate
from plough_opt.motion.effects import SpeedProfile
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file.schema import WAVES, ProblemTable
from plough_opt.soil.geometry import PLANE_SECTIONS_LIMIT, Wedge
from plough_opt.soil.soil import Soil, named_soil
from plough_opt.soil.strength import Spectrum

if TYPE_CHECKING:
    from plough_opt.design import Design, Optimum, Progress
    from plough_opt.design.search.effort import Search
    from plough_opt.studies.tradeoff import TradeOff

# The optimiser and the fronts are imported on use: files are checked and simulated without them.

_READING = "soil.cone_index"
_SIDES = ("lower", "upper", "guess")
# An example of a [trade_off] table, for messages.
TRADED = "[trade_off] with two or three results, such as mean_draft = {} and loosened_radius = { maximise = true }"
# Name of the sum of the [minimise] table.
OBJECTIVE = "objective"
# Part of a wave that is missing by rounding.
_WHOLE: Final = 1e-9


@dataclass(frozen=True)
class FileVariable:
    """A variable as the file declares it, in SI."""

    lower: float
    upper: float
    guess: float
    log: bool
    unit: str
    display: Display
    domain: tuple[float, float]
    tolerance: float | str | None = None
    catalogue: tuple[float, ...] | float | None = None  # values, or a step whose multiples can be made

    @property
    def words(self) -> str:
        """The bounds in words, such as "0.1 m to 0.5 m"."""
        return f"{self.display.text(self.lower)} to {self.display.text(self.upper)}"

    def declared(self, design: Design, name: str, guess: float) -> Expression:
        """Declare the variable in a design under a name and with a guess, and return its symbol."""
        return design.variable(name, guess=guess, lower=self.lower, upper=self.upper, unit=self.unit, log=self.log,
                               tolerance=self.tolerance, domain=self.domain, display=self.display)  # fmt: skip


@dataclass(frozen=True)
class Problem:
    """A design question from a file.

    Attributes:
        name: the file's name.
        table: the file's tables, validated, quantities in SI.
        fixed: key such as "share.height" -> value in SI, of every quantity that is not a variable.
        variables: key -> bounds and guess.
        displays: key or result -> the unit in which the file writes it.
        notes: side effects of overrides, such as a variable that an override fixed.
        readings: sentence on the penetrometer readings that decide the soil, or "".
        spectrum: spectrum of the strength record, if the file names one.
        course: tow speed over time relative to the largest one, which is then scene.tow_speed; None if it is constant.
        text: the whole text of the file.
        data: name of each data file, as the problem file writes it -> its whole text.
        overrides: the changes made to the file, in order.

    Example:
        >>> import plough_opt as po
        >>> list(po.read_problem("problems/cotton_subsoiler.toml").variables)
        ['share.wedge_angle', 'share.height', 'scene.stiffness']
    """

    name: str
    table: ProblemTable
    fixed: Mapping[str, float]
    variables: Mapping[str, FileVariable]
    displays: Mapping[str, Display]
    notes: tuple[str, ...]
    readings: str = ""
    spectrum: Spectrum | None = None
    course: SpeedProfile | None = None
    text: str = field(default="", repr=False)
    data: Mapping[str, str] = field(default_factory=dict, repr=False)
    overrides: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The file's title."""
        return self.table.title

    @property
    def cautions(self) -> tuple[str, ...]:
        """Warnings about values so unusual that their unit is probably wrong, and about catalogues beyond bounds."""
        values = [(key, key, value) for key, value in self.fixed.items()]
        values += [(f"{key} {side}", key, getattr(v, side)) for key, v in self.variables.items() for side in _SIDES]
        slips = ((name, key, value, EVERY[key].slip(value)) for name, key, value in values)
        cautions = [f"{name} = {self.origin.display(key, EVERY[key].unit, value).text(value)}: {slip}"
                    for name, key, value, slip in slips if slip]  # fmt: skip
        for key, v in self.variables.items():
            entries = v.catalogue if isinstance(v.catalogue, tuple) else ()
            if outside := [v.display.text(x) for x in entries if not v.lower <= x <= v.upper]:
                cautions.append(f"the bounds of {key}, {v.words}, leave out of its catalogue {', '.join(outside)}")
        return tuple(cautions)

    @property
    def reliance(self) -> tuple[str, ...]:
        """Warnings that this design relies on what did not hold when tried; see docs/explanation/validation.md."""
        if not self.table.scene.law.slender:
            return ()
        values, wanted = self.values(), {*self.table.minimise, *self.table.goals, *self.table.require}
        varied = {*self.variables, *(self.table.uncertain.soil if self.table.uncertain else ())}
        angle = self.limits.get("half_angle", (None, None))[1]
        front = "loosened_radius" in wanted and "soil.density_ratio" not in values
        ratio = (1.0 - float(as_number(self.scene().soil.density_ratio))) ** -0.5 if front else math.nan
        relied_on = (
            (not values.keys() & {_READING, "soil.strength_factor"},
             "the level of the draft was not measured: computed from the soil's properties it is low by a factor of up"
             " to 3.3 among particles and by more in sand, so give a cone index (soil.cone_index)"),
            ("share.wedge_angle" in self.variables and (angle is None or angle > PLANE_SECTIONS_LIMIT),
             "of two shares with the same base the blunter has less draft here, and the same draft among particles:"
             f" require half_angle at most {math.degrees(PLANE_SECTIONS_LIMIT):.0f} deg"),
            ("scene.stiffness" in self.variables and wanted & {"force_rms", "stationary_force_rms"},
             "a mount softer than its resonance takes 30 to 60 % off the RMS of a rigid share's force here, and took"
             " nothing off among particles: do not count on what a soft mount saves"),
            ("scene.tow_speed" in self.variables and not values.keys() & {"effects.speed_term", "effects.rate_term"},
             "the draft grows by some per cent over the usual speeds, in measurements by much more: calibrate"
             " effects.speed_term to drafts at several speeds"),
            ("soil.ambient_pressure" in varied and self.table.soil.compaction is None,
             "with one density ratio the draft grows in proportion to the ambient pressure, among particles to about"
             " its root: give a compression test (soil.compaction)"),
            (front,
             f"loosened_radius is {ratio:.3g} times the base radius of the cone in this soil, so it measures the size"
             " of the share; among particles displacement has no front: take soil.density_ratio from the width of a"
             " trench across a pass"),
        )  # fmt: skip
        return tuple(sentence for condition, sentence in relied_on if condition)

    @property
    def origin(self) -> Origin:
        """Origin of results of this file that involve no random samples."""
        return self.made()

    def made(self, seed: int | None = None) -> Origin:
        """Return the origin of a result computed now: file, overrides, data, versions and seed.

        Args:
            seed: seed of the random samples, if any.

        Example:
            >>> import plough_opt as po
            >>> po.read_problem("problems/cotton_subsoiler.toml").made(seed=3).file
            'cotton_subsoiler.toml'
        """
        name = Path(self.name).name.encode(errors="replace").decode()  # names of files need not be text
        return Origin(self.title, self.displays, name, self.text, seed=seed, overrides=self.overrides, data=self.data,
                      limits=self.limits).now()  # fmt: skip

    @property
    def limits(self) -> dict[str, tuple[float | None, float | None]]:
        """Name of each required result -> its lower and upper limit in SI, None if absent."""
        return {name: limit.ends(MEASURES[name].unit) for name, limit in self.table.require.items()}

    @property
    def accuracy(self) -> Accuracy:
        """Integration method and its setting, or the relative error to reach."""
        return Accuracy(**self.table.accuracy.model_dump())

    def values(self, changes: Mapping[str, Expression] | None = None) -> dict[str, Expression]:
        """Return key -> value in SI of every quantity: fixed values and guesses, updated by changes.

        With ``average = "whole waves"`` the duration is that of the whole waves that the file's duration holds. A
        change of the property that the cone index decides replaces the cone index.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
            >>> problem.values({"scene.tow_speed": 2.5})["scene.tow_speed"]
            2.5
        """
        changed = mapping_of("changes", changes, "a quantity's key -> its value")
        values = {**self.fixed, **{key: v.guess for key, v in self.variables.items()}, **changed}
        if self.table.soil.adjusted in changed:
            values.pop(_READING, None)
        if self.table.scene.average == "whole waves":
            lengths = [values[key] for name in WAVES if (key := f"{name}.wavelength") in values]
            period = reduce(maximum, lengths) / values["scene.tow_speed"]
            values["scene.duration"] = maximum(floor(values["scene.duration"] / period + _WHOLE), 1.0) * period
        return values

    def scene(self, changes: Mapping[str, Expression] | None = None) -> Scene:
        """Return the scene with the variables at their guesses.

        Args:
            changes: key -> value that replaces the file's, a number or a symbol in SI.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
            >>> problem.scene({"share.height": 0.3}).share.height
            0.3
        """
        values = self.values(changes)
        share = Wedge(
            angle=values["share.wedge_angle"], chisel_angle=values["share.chisel_angle"], height=values["share.height"]
        )
        BESIDE["scene.frame_mass"].check(values["scene.frame_mass"])
        steel = share.equivalent_cone().solid_mass(values["scene.steel_density"])
        return Scene(
            soil=self.soil(values),
            share=share,
            stiffness=values["scene.stiffness"],
            mass=values["scene.frame_mass"] + steel,
            tow_speed=values["scene.tow_speed"],
            effects=self.table.effects.effects(values, self.spectrum, self.course),
            medium=self.table.scene.medium,
        )

    def soil(self, values: Mapping[str, Expression]) -> Soil:
        """Return the soil for the values of all quantities, such as those of `values`.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
            >>> problem.soil(problem.values({"soil.cohesion": 25e3})).cohesion
            25000.0
        """
        own: dict[str, Any] = {key.removeprefix("soil."): x for key, x in values.items() if key.startswith("soil.")}
        table, reading = self.table.soil, own.pop("cone_index", None)
        test = None if "density_ratio" in own else table.compaction
        # A Soil needs some value of the property that the cone index or the test replaces.
        if reading is not None and table.name is None:
            own.setdefault(EVERY[table.adjusted].key, EVERY[table.adjusted].typical)
        if test is not None:
            own["density_ratio"] = EVERY["soil.density_ratio"].typical
        if table.name is None:
            soil = Soil(**own, name="the soil of this file", source=f"values in {self.name}")
        else:
            soil = named_soil(table.name)
            source = f"{soil.source}; changed in {self.name}: {', '.join(sorted(own))}"
            soil = replace(soil, **own, name=f"{soil.name}, changed", source=source) if own else soil
        if test is not None:
            soil = Soil.from_compaction(test.pressure, test.volume_lost, soil)
        return soil if reading is None else Soil.from_cone_index(reading, soil, table.adjust)

    def simulate(self, changes: Mapping[str, float] | None = None) -> Run:
        """Return the numeric run of `scene`.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
            >>> slow, fast = (problem.simulate({"scene.tow_speed": speed}).tow_power for speed in (1.0, 3.0))
            >>> bool(fast > 2.0 * slow)
            True
        """
        return replace(self.run_of(self.scene(changes), self.values(changes)), origin=self.origin)

    def run_of(self, scene: Scene, values: Mapping[str, Expression]) -> Run:
        """Return the run of a scene with the file's accuracy and outputs; the duration is taken from ``values``.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
            >>> len(problem.run_of(problem.scene(), problem.values()).time)
            401
        """
        duration, outputs = values.get("scene.duration"), self.table.scene.outputs
        return simulate(scene, duration, accuracy=self.accuracy, outputs=outputs)

    def design(self, *, parameters: bool = False) -> tuple[Design, Run]:
        """Return the design and its symbolic run.

        Args:
            parameters: declare every fixed quantity as a parameter of the design under its key, so that sensitivities
                of the optimum to it can be computed.

        Raises:
            InputError: the file has no variables or nothing to minimise.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
            >>> design, run = problem.design()
            >>> best = design.solve(search="near")
            >>> bool(abs(best(run.mean_draft) / best(run).mean_draft - 1.0) < 1e-6)
            True
        """
        check_switch("parameters", parameters)
        design, run = self._required(self.table.minimise, "minimise: add a table [minimise]", parameters)
        design.minimise(self.objective(run))
        return design, run

    def objective(self, run: Run) -> Expression:
        """Return the sum of the terms in [minimise].

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
            >>> run = problem.simulate()
            >>> bool(abs(problem.objective(run) - (run.mean_draft + run.force_rms) / 1e3) < 1e-9)
            True
        """
        objective: Expression = 0.0
        for name, term in self.table.minimise.items():
            objective = objective + MEASURES[name].of(run) / MEASURES[name].unit.parse(term.per)
        return objective

    def _required(self, table: object, lacking: str, parameters: bool = False) -> tuple[Design, Run]:
        """Return the design with its requirements but no objective, and its symbolic run.

        Args:
            table: the table that the question needs.
            lacking: end of the sentence that refuses a file without it.
            parameters: as in `design`.

        Raises:
            InputError: the file has no variables, or the table is empty.
        """
        if not self.variables:
            why = "every variable is fixed" if self.notes else "add a table [variables]"
            raise InputError(f"{self.name}: nothing to choose: {why}")
        if not table:
            raise InputError(f"{self.name}: nothing to {lacking}")
        from plough_opt.design import Design

        design = Design()
        symbols = {name: variable.declared(design, name, variable.guess) for name, variable in self.variables.items()}
        scene = self.scene(symbols)
        if parameters:
            for name, x in self.numbers().items():
                symbols[name] = design.parameter(name, x, unit=EVERY[name].unit, domain=EVERY[name].domain)
            whole = self.scene(symbols)
            scene = replace(whole, soil=replace(whole.soil, name=scene.soil.name, source=scene.soil.source))
        run = self.run_of(scene, self.values(symbols))
        for name, (low, high) in self.limits.items():
            unit, display = MEASURES[name].unit.symbol, self.displays.get(name)
            design.require(name, MEASURES[name].of(run), at_least=low, at_most=high, unit=unit, display=display)
        return design, run

    def component(
        self,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        *,
        name: str = "share",
        samples: int | None = None,
    ) -> Component:
        """Return the file's scene as one CasADi Function: see `plough_opt.component`.

        Args:
            inputs: keys of quantities (default: the file's variables). Variables keep their bounds; the bounds of other
                quantities are half and twice the file's value.
            outputs: names of results, or "objective" for the sum of [minimise] (default: all results that the file
                minimises, trades or requires). Requirements become limits of the outputs.
            name: the Function's name.
            samples: number of intervals between the output times of results over time (default: the file's outputs).

        Raises:
            InputError: no inputs or outputs, an unknown name, or a scene that such a Function cannot represent.
            DomainError: bounds outside the model's domain.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/reference.toml", ["effects.motion=false"])
            >>> component = problem.component(outputs=["mean_draft", "loosened_radius"])
            >>> [port.name for port in component.inputs]
            ['share.wedge_angle', 'share.height', 'scene.stiffness']
        """

        def make(changes: Mapping[str, Expression]) -> tuple[Scene, Expression | None]:
            return self.scene(changes), self.values(changes).get("scene.duration")

        ports, results = self._inputs(inputs), self._outputs(outputs)
        samples = self.table.scene.outputs if samples is None else samples
        return build(make, ports, results, accuracy=self.accuracy, samples=samples, name=name)

    def _inputs(self, keys: Sequence[str]) -> list[Port]:
        """Return the ports of the inputs with some keys, or of the variables if there are no keys."""
        check_kind("inputs", keys, list | tuple, "a list of keys")
        if not (keys := keys or tuple(self.variables)):
            raise InputError(f"{self.name}: nothing to vary: name inputs, or give the file a [variables] table")
        values = {**self.numbers(), **{key: v.guess for key, v in self.variables.items()}}
        bounds = {key: Input(key, v.lower, v.upper) for key, v in self.variables.items()}
        for key in keys:
            if isinstance(key, str) and key in EVERY and key not in values:
                raise InputError(f"'{key}' cannot be an input, because {self.name} gives no value for it: add one")
            check_named("no quantity is named {}", key, values)
        return [port_of(bounds.get(key, Input(key)), EVERY[key], values[key]) for key in keys]

    def _outputs(self, names: Sequence[str]) -> list[Output]:
        """Return outputs with some names, or all results that the file names, with its requirements as limits."""
        check_kind("outputs", names, list | tuple, "a list of names")
        table = self.table
        results = dict.fromkeys([*table.minimise, *table.goals, *table.require])
        if not (names := names or [*([OBJECTIVE] if table.minimise else []), *results]):
            raise InputError(f"{self.name} minimises, trades and requires nothing: name outputs")
        outputs = []
        for name in names:
            check_kind("an output", name, str, "the name of a result")
            low, high = self.limits.get(name, (None, None))
            ends = -math.inf if low is None else low, math.inf if high is None else high
            of = self.objective if name == OBJECTIVE and table.minimise else None
            outputs.append(Output(name, *ends, of=of))  # `build` raises InputError for unknown names
        return outputs

    def numbers(self) -> dict[str, float]:
        """Return key -> value of every quantity that is not a variable, including the properties of a named soil.

        A property that follows from another entry of the file, a cone index or a compression test, is left out, and so
        is the duration under a tow speed that varies over time.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml")
            >>> problem.numbers()["soil.cohesion"]
            20000.0
        """
        soil = self.scene().soil
        own = {name: getattr(soil, quantity.key) for name, quantity in QUANTITIES.items() if quantity.owner == "soil"}
        values = {**own, **self.fixed}
        if _READING in self.values():
            del values[self.table.soil.adjusted]
        if self.table.soil.compaction is not None:
            del values["soil.density_ratio"]
        if self.course is not None:  # whose pieces are laid out over the duration
            del values["scene.duration"]
        return {key: float(x) for key, x in values.items() if x is not None and key not in self.variables}

    def optimise(
        self, progress: Progress | None = None, *, parameters: bool = False, search: Search = "auto", seed: int = 0
    ) -> tuple[Optimum, Run]:
        """Return the optimum and its numeric run.

        See `design` for ``parameters``, and `Design.solve` for the other arguments.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"])
            >>> best, run = problem.optimise(search="near")
            >>> [*best.variables]
            ['share.wedge_angle', 'share.height', 'scene.stiffness']
        """
        design, run = self.design(parameters=parameters)
        best = design.solve(search=search, seed=seed, progress=progress)
        origin = self.made(seed)
        run = replace(best(run), origin=origin)
        best = replace(best, run=run, origin=origin)
        catalogues = {name: v.catalogue for name, v in self.variables.items() if v.catalogue is not None}
        return (best.with_catalogues(catalogues) if catalogues else best), run

    def trade_off(self, points: int | None = None, progress: Progress | None = None) -> TradeOff:
        """Return the Pareto front of the results in [trade_off]; [minimise] is ignored.

        Args:
            points: number of positions on the front (default: the file's).
            progress: called with the present step in words and the fraction done.

        Raises:
            InputError: the file has no variables or no [trade_off], or the number of points is out of range.

        Example:
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/draft_against_loosening.toml", ["scene.duration=0.1 s"])
            >>> front = problem.trade_off(points=5)
            >>> [goal.name for goal in front.goals]
            ['mean_draft', 'loosened_radius']
        """
        from plough_opt.studies.tradeoff import Goal, trade_off

        table = self.table.trade_off
        design, run = self._required(table, f"trade: add a table {TRADED}")
        assert table is not None
        goals = [Goal(name, MEASURES[name].of(run), MEASURES[name].unit.symbol, maximise)
                 for name, maximise in self.table.goals.items()]  # fmt: skip
        count = table.points if points is None else points
        return replace(trade_off(design, *goals, points=count, title=self.title, progress=progress), origin=self.origin)
