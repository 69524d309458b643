"""What accuracy costs: error against time of the methods that can simulate a scene, effort against chance of a design.

The reference of a scene is a run with finer steps, or a tighter tolerance, than any setting compared with it; its own
error is the estimate of `simulate`. The reference of a design is the best design that any of its searches finds.
"""

from __future__ import annotations

import contextlib
import copy
import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from plough_opt.core.checks import check_domain, check_kind, check_text, plain_number, whole_number
from plough_opt.core.errors import InfeasibleDesign, InputError, NotConverged, PloughError
from plough_opt.core.expressions import as_number, holds_casadi, map_expressions
from plough_opt.core.files import figure_with_panels, written
from plough_opt.core.plain_data import MaybeInfinite
from plough_opt.core.process import available, without_notices
from plough_opt.core.saving import Origin, Saveable, versions
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.design import Design, Optimum, Progress
from plough_opt.motion import Run, simulate
from plough_opt.motion.methods import DEFAULT_ERROR, METHODS, Accuracy, adaptive
from plough_opt.motion.scene import Scene, duration_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from plough_opt.design.search.effort import Search

# Numbers of steps of a method, over the number that it takes by itself, and tolerances. The references are finer.
_FACTORS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
_TOLERANCES: Final = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-12)
_FINER, _TIGHTER = 16.0, 1e-13
# Errors that "auto" is asked for, beside the default and the wanted one.
_ERRORS: Final = (1e-3, 1e-6, 1e-10)
# Times of one use are the least of several, as other work only adds to them.
_REPETITIONS = 7
# Efforts of a search, from the basin of the guess to four times the default.
_EFFORTS: Final[tuple[Search, ...]] = ("near", 250, 1000, "auto", "thorough")
# Smallest error of a motion, which logarithmic axes could not show below, and relative error of IPOPT's optima.
_ROUNDING, _OPTIMA = 1e-15, 1e-9


@without_notices()
def study_accuracy(
    scene: Scene,
    duration: float | None = None,
    *,
    wanted: float = 1e-6,
    outputs: int = 40,
    allowance: float = 1.0,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return error against time of every method that can simulate a scene, at several settings.

    Args:
        scene: scene with numbers and a motion.
        duration: simulated time [s]; None for a periodic orbit.
        wanted: relative error that the advice is for [-], from 1e-15 to 0.1.
        outputs: number of equal intervals between output times, at which mount forces are compared.
        allowance: processor time that one run may take [s]; finer settings of a method that exceeds it are left out.
        title: title of the scene, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the scene holds symbols or has no motion, the duration is missing or is given for a periodic orbit,
            an argument has the wrong type, or ``outputs`` is out of range.
        DomainError: the duration, the wanted error or the allowance is out of range.
        IntegrationError: no method integrates the scene.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> po.study_accuracy(scene, "0.1 s", allowance=0.01).duration
        0.1
    """
    check_kind("the scene", scene, Scene, "a numeric Scene")
    _check(wanted, title)
    check_domain("time allowed to a method", plain_number("allowance", allowance), "s", above=0.0)
    whole_number("outputs", outputs, 1)
    if holds_casadi(scene):
        scene = map_expressions(scene, lambda value: float(as_number(value)))
    if not scene.effects.motion:
        raise InputError("a quasi-static scene has no motion to integrate, and so there is no method to choose")
    duration = plain_number("duration", duration_of(scene, duration))
    tell = progress or (lambda _what, _fraction: None)
    simulated = duration if scene.effects.orbit == "transient" else None

    def run(accuracy: Accuracy) -> Run:
        return simulate(scene, simulated, accuracy=accuracy, outputs=outputs)

    tell("integrating the reference", 0.0)
    reference = _reference(run, wanted)
    entries: list[MethodResult] = []
    for number, method in enumerate(METHODS):
        tell(f"timing {method}", (1.0 + number) / (1.0 + len(METHODS)))
        entries += _timed(run, method, wanted, allowance, reference)
    floor = max(float(reference.error_estimate or 0.0), _ROUNDING)
    return AccuracyStudy(title, duration, wanted, floor, tuple(entries), (), _versions())


@without_notices()
def study_design(
    design: Design,
    *,
    wanted: float = 1e-6,
    seeds: int = 8,
    limit: float = 10.0,
    title: str = "",
    progress: Progress | None = None,
) -> AccuracyStudy:
    """Return how often searches of growing effort find the best design, and in what time.

    Every effort is an argument of `Design.solve`. A search is right if the objective exceeds the least one found by any
    search of the study by no more than the wanted error, since no other truth is known.

    Args:
        design: design with an objective.
        wanted: relative error of the objective [-], from 1e-15 to 0.1.
        seeds: number of searches of each effort, each with its own seed.
        limit: time of one search [s] after which no larger effort is tried.
        title: title of the design, for reports.
        progress: called with what is being done and the fraction done.

    Raises:
        InputError: the design has no objective or no variables.
        DomainError: an argument is outside its range.
        InfeasibleDesign: no design meets the requirements.
        NotConverged: the optimiser stopped without an optimum.

    Example:
        >>> import plough_opt as po
        >>> design = po.Design()
        >>> height = design.variable("height", guess="250 mm", lower="100 mm", upper="500 mm")
        >>> design.require("half of it", height / 2.0, at_least="60 mm")
        >>> design.minimise(height**2)
        >>> best = design.solve(search="near")
        >>> study = po.study_design(design, seeds=3)  # doctest: +SKIP
    """
    check_kind("the design", design, Design, "a Design")
    _check(wanted, title)
    whole_number("seeds", seeds, 1)
    check_domain("time allowed to a search", plain_number("limit", limit), "s", above=0.0)
    tell = progress or (lambda _what, _fraction: None)
    design = copy.copy(design)  # its programs are its own, so that the caller's design stays as it is
    tell("building the program", 0.0)
    design.solve(search="near")  # raises if there is no design, and imports what searches need
    found: dict[Search, tuple[list[Optimum | None], float]] = {}
    for number, search in enumerate(_EFFORTS):
        tell(f"searching: {search}", number / len(_EFFORTS))
        # A search from the guess alone has no seed, but is timed as often.
        optima, times = zip(*(_solved(design, search, seed) for seed in range(seeds)), strict=True)
        found[search] = list(optima), median(times)
        if found[search][1] > limit:
            break
    least = min(best.objective for optima, _ in found.values() for best in optima if best is not None)
    entries = tuple(_searched(search, *trial, least, wanted) for search, trial in found.items())
    return AccuracyStudy(title, None, wanted, _OPTIMA, entries, (), _versions())


@dataclass(frozen=True)
class MethodResult:
    """Result of one method with one setting, or of one effort of a search.

    Attributes:
        method: name of the method, or ``"search"``.
        setting: setting as text, such as ``"tolerance 1e-09"``, ``"40 steps"`` or ``"auto"``.
        seconds: least processor time of a run, or median time of a search [s]; infinite for a failure.
        errors: relative errors by name [-], the first of which ranks; empty for a failure.
        failure: reason why there is no result, or None.
        designs: median number of designs that a search tries.
        right: part of the searches that find the best design [-].
    """

    method: str
    setting: str
    seconds: MaybeInfinite
    errors: Mapping[str, MaybeInfinite] = field(default_factory=dict)
    failure: str | None = None
    designs: int = 0
    right: float = 0.0

    @property
    def label(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}" if self.setting else self.method

    @property
    def error(self) -> float:
        """Error that ranks [-]; infinite for a failure."""
        return next(iter(self.errors.values()), math.inf)


@dataclass(frozen=True, repr=False, eq=False)
class AccuracyStudy(Saveable):
    """Error against time of every method that can simulate a scene, or effort against chance of a design's searches.

    Times depend on the machine and its load; their ratios are more reliable.

    Attributes:
        title: title of the scene or design.
        duration: simulated time [s]; None for a design.
        wanted: relative error that the advice is for [-].
        floor: estimated error of the reference itself [-].
        entries: entry of every method and setting, or of every effort; failures with their reasons.
        notes: remarks on the question.
        versions: versions of packages, and the machine.
        origin: the question that the study answers.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> study = po.study_accuracy(scene, "0.1 s", allowance=0.01)
        >>> len(study.entries) > 3
        True
    """

    title: str
    duration: float | None
    wanted: float
    floor: float
    entries: tuple[MethodResult, ...]
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    origin: Origin = field(default=Origin())
    kind = "accuracy study"

    @property
    def front(self) -> list[MethodResult]:
        """Entries that no other beats in both time and error, fastest first; errors below the reference's are equal."""
        front: list[MethodResult] = []
        for entry in sorted(self._done, key=lambda entry: (entry.seconds, entry.error)):
            if not front or max(entry.error, self.floor) < max(front[-1].error, self.floor):
                front.append(entry)
        return front

    @property
    def cheapest(self) -> MethodResult | None:
        """Fastest entry that reaches the wanted error, for a design with every seed; None if there is none."""
        good = (e for e in self._done if e.error <= self.wanted)
        return min(good, key=lambda entry: entry.seconds, default=None)

    @property
    def advice(self) -> str:
        """Sentence on the cheapest entry that reaches the wanted error, and on the default."""
        best, wanted = self.cheapest, f"{self.wanted:.3g}"
        if best is None:
            nearest = min(self._done, key=lambda entry: entry.error, default=None)
            if nearest is None:
                return f"nothing tried gives a result: {self.refusals[0]}"
            text = f"nothing tried reaches {wanted}; the nearest is {_told(nearest)}"
        else:
            text = f"for {wanted} take {_told(best)}"
        default = next((entry for entry in self._done if self._is_default(entry)), None)
        if default is not None:
            text += "; that is the default" if default is best else f"; the default, {_told(default)}"
        return f"{text}."

    @property
    def refusals(self) -> tuple[str, ...]:
        """Sentence for each reason why entries have no result."""
        labels: dict[str, list[str]] = {}
        for entry in self.entries:
            if entry.failure is not None:
                labels.setdefault(entry.failure, []).append(entry.label)
        return tuple(f"no result of {'; '.join(who)}: {reason}" for reason, who in labels.items())

    @property
    def _done(self) -> list[MethodResult]:
        return [entry for entry in self.entries if entry.failure is None]

    def _is_default(self, entry: MethodResult) -> bool:
        return (entry.method, entry.setting) in (("auto", f"error {DEFAULT_ERROR:.3g}"), ("search", "auto"))

    def table(self) -> Grid:
        """Return a table of the entries, fastest first, efficient ones marked.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", allowance=0.01)
            >>> study.table().columns[1].heading
            'method and setting'
        """
        names = [*next((entry.errors for entry in self._done), {})]
        more = ("designs tried", "best found") if self.duration is None else ()
        title = "Effort against chance" if more else f"Error against time (of the reference: {self.floor:.0e})"
        headings = "method and setting", "time", *more, *(f"error of {name}" for name in names)
        table = Grid.of(title, "", *headings, left=["method and setting"])
        table.caption = f"* efficient: nothing else is both faster and more exact in {names[0]}" if names else ""
        for entry in sorted(self._done, key=lambda entry: entry.seconds):
            chance = (str(entry.designs), f"{100.0 * entry.right:.0f} %") if more else ()
            errors = (f"{error:.0e}" if error else "0" for error in entry.errors.values())
            label = f"{entry.label} (default)" if self._is_default(entry) else entry.label
            table.row("*" if entry in self.front else "", label, _duration(entry.seconds), *chance, *errors)
        return table

    def page(self) -> Page:
        """Return a report: the table, entries without a result, notes and advice.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", allowance=0.01)
            >>> study.advice in study.page().parts
            True
        """
        timed = "Times are the least of several runs of simulate, each with its check."
        if self.duration is None:
            timed = (
                "Times are medians over the seeds, errors the largest of any seed, relative to the best design found."
            )
        notes = (*self.refusals, *(f"note: {note}" for note in self.notes))
        footer = ", ".join(map(" ".join, self.versions.items()))
        return Page("What accuracy costs", (self.table(), timed, *notes, self.advice), (), footer, self.title)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each entry: times [s] and relative errors [-], NaN where there is none.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", allowance=0.01)
            >>> len(study.to_dataframe()) == len(study.entries)
            True
        """
        names = "method", "setting", "seconds", "designs", "right", "failure"
        columns: dict[str, Any] = {name: [getattr(entry, name) for entry in self.entries] for name in names}
        for key in dict.fromkeys(key for entry in self.entries for key in entry.errors):
            columns[f"error of {key}"] = [entry.errors.get(key, math.nan) for entry in self.entries]
        return data_frame(columns, {"seconds": "s"})

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw error against time on logarithmic axes, or for a design the chance of each effort against its time.

        Args:
            path: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: no entry has a result, or the file has no known picture format or cannot be written.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> po.study_accuracy(scene, "0.1 s", allowance=0.01).plot().axes[0].get_xlabel()
            'time [s]'
        """
        figure, (axes,) = figure_with_panels(1, 1, (7.5, 5.0))
        self.draw(axes)
        axes.legend(fontsize="small")
        return written(figure, path)

    def draw(self, axes: Any) -> None:
        """Draw the study on axes of matplotlib, each method with a label for a legend.

        Raises:
            InputError: no entry has a result.

        Example:
            >>> from matplotlib.figure import Figure
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> axes = Figure().subplots()
            >>> po.study_accuracy(scene, "0.1 s", allowance=0.01).draw(axes)
            >>> axes.get_yscale()
            'log'
        """
        if not self._done:
            raise InputError(f"the accuracy study of {self.title!r} has no error to draw: {'; '.join(self.refusals)}")
        axes.set(xscale="log", xlabel="time [s]", title=self.title)
        axes.grid(alpha=0.25)
        if self.duration is None:
            axes.plot([e.seconds for e in self._done], [e.right for e in self._done], "o-", label="searches")
            for entry in self._done:
                axes.annotate(entry.setting, (entry.seconds, entry.right), textcoords="offset points", xytext=(4, -12))
            axes.set(ylabel="part of the searches that find the best design", ylim=(-0.05, 1.05))
            return
        for method, marker in zip(METHODS, cycle("os^vDPX<"), strict=False):
            if points := [(e.seconds, max(e.error, _ROUNDING)) for e in self._done if e.method == method]:
                axes.plot(*zip(*points, strict=True), linewidth=1.0, marker=marker, label=method)
        front = [(entry.seconds, max(entry.error, self.floor)) for entry in self.front]
        axes.step(*zip(*front, strict=True), where="post", color="#F0C808", linewidth=6.0, alpha=0.7, zorder=1,
                  label="efficient front")  # fmt: skip
        axes.axhline(self.wanted, color="black", linestyle="--", linewidth=1.0, label="wanted error")
        axes.axhspan(0.0, self.floor, facecolor="#DDDDDD", zorder=0, label="below the reference's own error")
        axes.set(yscale="log", ylabel="relative error of mean draft and RMS force", ylim=(0.3 * _ROUNDING, None))

    def also_saved(self) -> dict[str, Any]:
        """Return the advice."""
        return {"advice": self.advice}


def errors_of(run: Run, reference: Run) -> dict[str, float]:
    """Return the relative errors of a run [-].

    That of ``"averages"`` is the larger one of mean draft and RMS force, relative to the larger of the two; that of
    ``"forces"`` the largest one of the mount force at the outputs, relative to the largest force.
    """
    averages = [np.array([of.mean_draft, of.force_rms], dtype=float) for of in (run, reference)]
    forces = [np.asarray(of.mount_force, dtype=float) for of in (run, reference)]
    pairs = {"averages": averages, "forces": forces}
    return {name: _over(np.max(np.abs(own - true)), np.max(np.abs(true))) for name, (own, true) in pairs.items()}


def _over(difference: float, size: float) -> float:
    return float(difference / size) if size > 0.0 else float(difference)


def _reference(run: Callable[[Accuracy], Run], wanted: float) -> Run:
    """Return a run that is tighter than any setting compared with it: the first whose estimate is small, or the least.

    Raises:
        PloughError: no method integrates the scene.
    """
    best, failure = None, None
    for method in ("dop853", "erk", "rosenbrock"):
        try:
            if method in adaptive():
                found = run(Accuracy(method, tolerance=_TIGHTER))
            else:
                found = run(Accuracy(method, steps=math.ceil(_FINER * (run(Accuracy(method)).accuracy.steps or 1))))
        except PloughError as error:
            failure = failure or error
            continue
        estimate = float(found.error_estimate or 0.0)
        best = found if best is None or estimate < float(best.error_estimate or 0.0) else best
        if estimate <= 0.01 * wanted:
            break
    if best is None:
        assert failure is not None  # each method gave a run or failed
        raise failure
    return best


def _settings(run: Callable[[Accuracy], Run], method: str, wanted: float) -> Iterator[Accuracy]:
    """Yield the settings of a method from coarse to fine."""
    if method == "auto":
        errors = {*_ERRORS, DEFAULT_ERROR, max(wanted, 1e-12)}
        yield from (Accuracy(error=error) for error in sorted(errors, reverse=True))
    elif METHODS[method].adaptive:
        yield from (Accuracy(method, tolerance=tolerance) for tolerance in _TOLERANCES)
    else:
        usual = run(Accuracy(method)).accuracy.steps or 1
        steps = dict.fromkeys(math.ceil(usual * factor) for factor in _FACTORS)
        yield from (Accuracy(method, steps=count) for count in steps)


def _timed(
    run: Callable[[Accuracy], Run], method: str, wanted: float, allowance: float, reference: Run
) -> Iterator[MethodResult]:
    """Yield the entries of a method, until a setting takes longer than it may or the method cannot do the scene."""
    try:
        settings = [*_settings(run, method, wanted)]
    except PloughError as error:
        yield MethodResult(method, "", math.inf, failure=str(error))
        return
    for place, accuracy in enumerate(settings):
        setting = _setting(accuracy)
        try:
            errors, seconds = errors_of(run(accuracy), reference), math.inf
            for _ in range(_REPETITIONS):
                started = time.process_time()
                run(accuracy)
                seconds = min(seconds, time.process_time() - started)
                if seconds > allowance / _REPETITIONS:
                    break
        except InputError as error:  # of all settings alike
            yield MethodResult(method, "", math.inf, failure=str(error))
            return
        except PloughError as error:
            yield MethodResult(method, setting, math.inf, failure=str(error))
            continue
        yield MethodResult(method, setting, seconds, errors)
        if seconds > allowance and place + 1 < len(settings):
            finer = f"{_setting(settings[place + 1])} and finer"
            yield MethodResult(method, finer, math.inf, failure=f"{setting} took {seconds:.2g} s already")
            return


def _setting(accuracy: Accuracy) -> str:
    if accuracy.steps is not None:
        return f"{accuracy.steps} steps"
    return f"error {accuracy.error:.3g}" if accuracy.error is not None else f"tolerance {accuracy.tolerance:.3g}"


def _solved(design: Design, search: Search, seed: int) -> tuple[Optimum | None, float]:
    """Return the optimum that a search finds, or None, and its time [s]."""
    began, best = time.perf_counter(), None
    with contextlib.suppress(InfeasibleDesign, NotConverged):
        best = design.solve(search=search, seed=seed)
    return best, time.perf_counter() - began


def _searched(
    search: Search, optima: Sequence[Optimum | None], seconds: float, least: float, wanted: float
) -> MethodResult:
    """Return the entry of an effort, given the least objective that any search found."""
    setting = f"{search} designs" if isinstance(search, int) else str(search)
    found = [best for best in optima if best is not None]
    if not found:
        return MethodResult("search", setting, math.inf, failure="no seed led to an optimum")
    excess = [_over(best.objective - least, abs(least)) for best in found]
    right = sum(error <= wanted for error in excess) / len(optima)
    designs = int(median([best.search.designs for best in found if best.search] or [0]))
    return MethodResult("search", setting, seconds, {"objective": max(excess)}, designs=designs, right=right)


def _told(entry: MethodResult) -> str:
    chance = f", best design found by {100.0 * entry.right:.0f} %" if entry.method == "search" else ""
    return f"{entry.label} ({_duration(entry.seconds)}, error {entry.error:.0e}{chance})"


def _duration(seconds: float) -> str:
    if seconds >= 1.0:
        return f"{seconds:.3g} s"
    return f"{1e3 * seconds:.3g} ms"


def _check(wanted: float, title: str) -> None:
    check_text("title", title)
    check_domain("wanted error", plain_number("wanted", wanted), at_least=1e-15, at_most=0.1)


def _versions() -> dict[str, str]:
    """Return versions of packages, and the machine."""
    machine = {"platform": platform.platform(), "processors": str(available())}
    return {**versions(), "scipy": version("scipy"), **machine}
